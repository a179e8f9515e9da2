/* The record of a scheme: its sub-steps, and what follows from them. */
#include "step/scheme.h"

#include "system/system.h"

#include <math.h>

double dal__parse_number(const char *text, const char **end)
{
    double digits = 0.0, scale = 1.0;
    bool any = false, behind_point = false;
    for (;; text++) {
        if (*text == '.' && !behind_point) {
            behind_point = true;
        } else if (*text >= '0' && *text <= '9') {
            digits = 10.0 * digits + (*text - '0');
            scale *= behind_point ? 10.0 : 1.0;
            any = true;
        } else {
            break;
        }
    }
    const bool exponent_follows = (*text == 'e' || *text == 'E') && text[1] == '-' &&
                                  text[2] >= '0' && text[2] <= '9';
    if (any && exponent_follows) {
        int exponent = 0;
        for (text += 2; *text >= '0' && *text <= '9' && exponent < 1000; text++)
            exponent = 10 * exponent + (*text - '0');
        for (; exponent > 0; exponent--) scale *= 10.0;
    }
    *end = text;
    return any ? digits / scale : (double)NAN;
}

size_t dal__scheme_count(const dal_scheme *scheme) { return scheme->count ? scheme->count : 1; }

dal_substep dal__scheme_substep(const dal_scheme *scheme, size_t j)
{
    return scheme->count ? scheme->substeps[j] : (dal_substep){scheme->beta, 1.0};
}

int dal__scheme_check_plain(const dal_scheme *scheme, const char *family, dal_error *error)
{
    if (scheme->nodes == DAL_MOVED_NODES && scheme->count == 0) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "scheme.nodes = %d, scheme.count = %zu: expected "
                     "DAL_MOVED_NODES and no sub-steps for the family %s", (int)scheme->nodes,
                     scheme->count, family);
}

int dal_scheme_is_explicit(const dal_scheme *scheme, const dal_system *system)
{
    if (!scheme || !system || scheme->family) return 0;
    if (!system->mass || system->def.force || system->def.kind == DAL_NONLINEAR) return 0;
    for (size_t j = 0; j < dal__scheme_count(scheme); j++)
        if (dal__scheme_substep(scheme, j).beta != 0.0) return 0;
    return 1;
}

int dal_scheme_shift(const dal_scheme *scheme, double *shift)
{
    if (!scheme || !shift) return DAL_EINVAL;
    if (scheme->family || dal__scheme_count(scheme) > 1) return DAL_EUNSUPPORTED;
    *shift = 1.0 - dal__scheme_substep(scheme, 0).beta;
    return DAL_SUCCESS;
}
