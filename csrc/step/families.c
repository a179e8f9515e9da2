/* The schemes of all families, by number and by name. */
#include "step/scheme.h"

#include "system/system.h"

#include <stdio.h>
#include <string.h>

#define FAMILY(name) extern const dal_family dal__family_##name;
DAL_FAMILIES
#undef FAMILY
#define FAMILY(name) &dal__family_##name,
const dal_family *const dal__families[] = {DAL_FAMILIES NULL};

size_t dal_scheme_count(void)
{
    size_t count = 0;
    for (size_t f = 0; dal__families[f]; f++) count += dal__families[f]->count;
    return count;
}

int dal_scheme_at(dal_scheme *scheme, size_t i)
{
    for (size_t f = 0; scheme && dal__families[f]; i -= dal__families[f++]->count)
        if (i < dal__families[f]->count) {
            *scheme = dal__families[f]->schemes[i];
            return DAL_SUCCESS;
        }
    return DAL_EINVAL;
}

/* List the names of all schemes in text[size], truncated if it is too short. */
static void list_schemes(size_t size, char *text)
{
    dal_scheme scheme;
    size_t used = 0;
    for (size_t i = 0; used < size && !dal_scheme_at(&scheme, i); i++)
        used += (size_t)snprintf(text + used, size - used, "%s%s", i ? ", " : "", scheme.name);
    for (size_t f = 0; used < size && dal__families[f]; f++)
        if (dal__families[f]->help)
            used += (size_t)snprintf(text + used, size - used, ", %s", dal__families[f]->help);
}

int dal_scheme_find(dal_scheme *scheme, const char *name, dal_error *error)
{
    char wanted[sizeof scheme->name], names[440];
    const int status = DAL__REQUIRE(error, {"scheme", scheme}, {"name", name});
    if (status) return status;
    const bool fits = strlen(name) < sizeof wanted;
    dal_scheme found;
    snprintf(wanted, sizeof wanted, "%s", name);
    for (char *c = wanted; *c; c++)
        if (*c == '_') *c = '-';
    for (size_t i = 0; fits && !dal_scheme_at(&found, i); i++)
        if (strcmp(found.name, wanted) == 0) {
            *scheme = found;
            return DAL_SUCCESS;
        }
    for (size_t f = 0; fits && dal__families[f]; f++)
        if (dal__families[f]->parse && dal__families[f]->parse(&found, wanted)) {
            snprintf(found.name, sizeof found.name, "%s", wanted);
            *scheme = found;
            return DAL_SUCCESS;
        }
    list_schemes(sizeof names, names);
    return dal__fail(error, DAL_EINVAL, "there is no scheme \"%.40s\"; choose one of: %s", name,
                     names);
}

const dal_family *dal__scheme_family(const dal_scheme *scheme)
{
    return scheme->family ? scheme->family : dal__families[0];
}

const char *dal_scheme_family(const dal_scheme *scheme)
{
    return dal__scheme_family(scheme)->name;
}

/* FNV-1a. */
static uint64_t digest(uint64_t hash, size_t size, const void *bytes)
{
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ ((const unsigned char *)bytes)[i]) * UINT64_C(0x100000001b3);
    return hash;
}

double dal__digest_text(const char *text)
{
    return (double)(digest(UINT64_C(0xcbf29ce484222325), strlen(text), text) >> 11);
}

double dal__scheme_identify(const dal_system *system, const dal_scheme *scheme)
{
    const char *const family = dal_scheme_family(scheme);
    const char *const name = dal_system_name(system);
    const size_t n = system->def.n;
    const int kinds[] = {(int)scheme->nodes, (int)system->def.kind, system->def.time_dependent,
                         system->def.force != NULL};
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    hash = digest(hash, strlen(family) + 1, family);
    hash = digest(hash, strlen(name) + 1, name);
    hash = digest(hash, sizeof kinds, kinds);
    hash = digest(hash, system->parameters * sizeof(double), system->def.ctx);
    const size_t masses = !system->mass ? 0 : system->masses ? n : n * n;
    const dal_sparsity *const sparsity = system->def.sparsity;
    const size_t entries = sparsity ? sparsity->entries : 0;
    hash = digest(hash, masses * sizeof(double), system->mass);
    hash = digest(hash, entries * sizeof(size_t), sparsity ? sparsity->row : NULL);
    hash = digest(hash, entries * sizeof(size_t), sparsity ? sparsity->column : NULL);
    for (size_t j = 0; j < dal__scheme_count(scheme); j++) {
        const dal_substep s = dal__scheme_substep(scheme, j);
        hash = digest(hash, sizeof s, &s);
    }
    return (double)(hash >> 11); /* a double holds 53 bits */
}
