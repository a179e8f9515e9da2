/* The records of the family beta: sub-steps {beta, fraction}, one after the other. */
#include "step/beta.h"

#include <math.h>
#include <string.h>

/* One symmetric step of size g, as sub-steps. */
#define MIDPOINT(g) {0.5, g}
#define LEAPFROG(g) {0.0, (g) / 2}, {1.0, (g) / 2}

/* Symmetric compositions: the coefficients to 30 digits, each applied to a base step. */
#define SUZUKI4(STEP) \
    STEP(0.414490771794375737142354062861), STEP(0.414490771794375737142354062861), \
    STEP(-0.657963087177502948569416251443), STEP(0.414490771794375737142354062861), \
    STEP(0.414490771794375737142354062861)
#define YOSHIDA4(STEP) \
    STEP(1.35120719195965763404768780897), STEP(-1.70241438391931526809537561794), \
    STEP(1.35120719195965763404768780897)
#define KL6(STEP) \
    STEP(0.392161444007314139279250555181), STEP(0.33259913678935943859974864032), \
    STEP(-0.706246172557639359809964819475), STEP(0.0822135962935508002314904474488), \
    STEP(0.798543990934829963398950353049), STEP(0.0822135962935508002314904474488), \
    STEP(-0.706246172557639359809964819475), STEP(0.33259913678935943859974864032), \
    STEP(0.392161444007314139279250555181)
#define KL8(STEP) \
    STEP(0.130202483088890080878817632263), STEP(0.561162981775108384561964407702), \
    STEP(-0.389474962644847286408078598646), STEP(0.15884190655515560089621074563), \
    STEP(-0.395903894133237577336231539022), STEP(0.184539640978315707091832541389), \
    STEP(0.25837438768632204729397910986), STEP(0.295011723609310298870966240492), \
    STEP(-0.605508533830034511698921079335), STEP(0.295011723609310298870966240492), \
    STEP(0.25837438768632204729397910986), STEP(0.184539640978315707091832541389), \
    STEP(-0.395903894133237577336231539022), STEP(0.15884190655515560089621074563), \
    STEP(-0.389474962644847286408078598646), STEP(0.561162981775108384561964407702), \
    STEP(0.130202483088890080878817632263)

static const dal_substep leapfrog[] = {LEAPFROG(1.0)};
static const dal_substep leapfrog_mirror[] = {{1.0, 0.5}, {0.0, 0.5}};
static const dal_substep leapfrog_suzuki4[] = {SUZUKI4(LEAPFROG)};
static const dal_substep leapfrog_yoshida4[] = {YOSHIDA4(LEAPFROG)};
static const dal_substep leapfrog_kl6[] = {KL6(LEAPFROG)};
static const dal_substep leapfrog_kl8[] = {KL8(LEAPFROG)};
static const dal_substep midpoint_suzuki4[] = {SUZUKI4(MIDPOINT)};
static const dal_substep midpoint_yoshida4[] = {YOSHIDA4(MIDPOINT)};
static const dal_substep midpoint_kl6[] = {KL6(MIDPOINT)};
static const dal_substep midpoint_kl8[] = {KL8(MIDPOINT)};

#define SUBSTEPS(array) .count = sizeof(array) / sizeof(array)[0], .substeps = array

static const char paper[] = "Jimenez and Scheurle, arXiv 1407.2116";
static const char suzuki[] = "Suzuki, Phys. Lett. A 146 (1990) 319";
static const char yoshida[] = "Yoshida, Phys. Lett. A 150 (1990) 262";
static const char kahan_li[] = "Kahan and Li, Math. Comp. 66 (1997) 1089";

/* s = 0 throughout: a scheme's own multiplier is a mean over the step, so it differs from lambda at
 * the end of the step by O(h). */
const dal_scheme dal__beta_records[DAL__BETA_RECORDS] = {
    {.name = "leapfrog", SUBSTEPS(leapfrog), .order = 2, .symmetric = 1, .reference = paper,
     .help = "beta 0 then 1 at half steps: V explicit, m unknowns; the default choice"},
    {.name = "midpoint", .beta = 0.5, .order = 2, .symmetric = 1, .reference = paper,
     .help = "beta 1/2 (DAELd2): implicit; exact energy for quadratic V and symmetric constraints"},
    {.name = "explicit", .beta = 0.0, .order = 1, .reference = paper,
     .help = "beta 0 (DAELd1): no iteration at all; first order, energy drifts"},
    {.name = "endpoint", .beta = 1.0, .order = 1, .reference = paper,
     .help = "beta 1 (Facil): the adjoint of explicit; its nodes keep D as well"},
    {.name = "leapfrog-mirror", SUBSTEPS(leapfrog_mirror), .order = 2, .symmetric = 1,
     .reference = paper,
     .help = "beta 1 then 0 at half steps: V at the ends of the step, as RATTLE"},
    {.name = "midpoint-nodes", .beta = 0.5, .nodes = DAL_KEPT_NODES, .order = 1, .reference = paper,
     .help = "midpoint at the original nodes: keeps D_eps, order 1 in the state"},
    {.name = "explicit-nodes", .beta = 0.0, .nodes = DAL_KEPT_NODES, .order = 1, .reference = paper,
     .help = "explicit at the original nodes: keeps D_eps"},
    {.name = "endpoint-nodes", .beta = 1.0, .nodes = DAL_KEPT_NODES, .order = 1, .reference = paper,
     .help = "endpoint at the original nodes: they are its states, D_eps is D"},
    {.name = "leapfrog-suzuki4", SUBSTEPS(leapfrog_suzuki4), .order = 4, .symmetric = 1,
     .reference = suzuki, .help = "order 4 from 5 leapfrog steps, small error constant"},
    {.name = "leapfrog-yoshida4", SUBSTEPS(leapfrog_yoshida4), .order = 4, .symmetric = 1,
     .reference = yoshida, .help = "order 4 from 3 leapfrog steps, larger error constant"},
    {.name = "leapfrog-kl6", SUBSTEPS(leapfrog_kl6), .order = 6, .symmetric = 1,
     .reference = kahan_li, .help = "order 6 from 9 leapfrog steps"},
    {.name = "leapfrog-kl8", SUBSTEPS(leapfrog_kl8), .order = 8, .symmetric = 1,
     .reference = kahan_li, .help = "order 8 from 17 leapfrog steps: for high accuracy"},
    {.name = "midpoint-suzuki4", SUBSTEPS(midpoint_suzuki4), .order = 4, .symmetric = 1,
     .reference = suzuki, .help = "order 4 from 5 midpoint steps, small error constant"},
    {.name = "midpoint-yoshida4", SUBSTEPS(midpoint_yoshida4), .order = 4, .symmetric = 1,
     .reference = yoshida, .help = "order 4 from 3 midpoint steps, larger error constant"},
    {.name = "midpoint-kl6", SUBSTEPS(midpoint_kl6), .order = 6, .symmetric = 1,
     .reference = kahan_li, .help = "order 6 from 9 midpoint steps"},
    {.name = "midpoint-kl8", SUBSTEPS(midpoint_kl8), .order = 8, .symmetric = 1,
     .reference = kahan_li, .help = "order 8 from 17 midpoint steps"},
};

/* "0.3" or "0.3-nodes": the beta-scheme of that number. */
int dal__beta_parse(dal_scheme *scheme, const char *name)
{
    const char *end;
    const double beta = dal__parse_number(name, &end);
    const bool kept = strcmp(end, "-nodes") == 0;
    if ((*end != '\0' && !kept) || !(beta >= 0.0 && beta <= 1.0)) return 0;
    const bool moved_midpoint = beta == 0.5 && !kept;
    *scheme = (dal_scheme){.beta = beta, .nodes = kept ? DAL_KEPT_NODES : DAL_MOVED_NODES,
                           .order = moved_midpoint ? 2 : 1, .symmetric = moved_midpoint,
                           .help = "the beta-scheme of this number", .reference = paper};
    return 1;
}

int dal__beta_check(const dal_scheme *scheme, dal_error *error)
{
    const size_t count = dal__scheme_count(scheme);
    double sum = 0.0, size = 0.0;
    if (scheme->count > 0 && !scheme->substeps)
        return dal__fail(error, DAL_EINVAL, "scheme.count = %zu and scheme.substeps is NULL",
                         scheme->count);
    if (scheme->nodes != DAL_MOVED_NODES && scheme->nodes != DAL_KEPT_NODES)
        return dal__fail(error, DAL_EINVAL, "scheme.nodes = %d is neither DAL_MOVED_NODES nor "
                         "DAL_KEPT_NODES", (int)scheme->nodes);
    if (scheme->nodes == DAL_KEPT_NODES && count > 1)
        return dal__fail(error, DAL_EINVAL, "scheme has %zu sub-steps: kept nodes need a single "
                         "one", count);
    for (size_t j = 0; j < count; j++) {
        const dal_substep step = dal__scheme_substep(scheme, j);
        if (!(step.beta >= 0.0 && step.beta <= 1.0))
            return dal__fail(error, DAL_EINVAL, "sub-step %zu: beta = %g is not in [0, 1]", j,
                             step.beta);
        if (!isfinite(step.fraction) || step.fraction == 0.0)
            return dal__fail(error, DAL_EINVAL, "sub-step %zu: fraction = %g is zero or not finite",
                             j, step.fraction);
        sum += step.fraction;
        size += fabs(step.fraction);
    }
    /* coefficients printed with 15 digits are welcome */
    if (!(fabs(sum - 1.0) <= 1e-14 * (1.0 + size)))
        return dal__fail(error, DAL_EINVAL, "the fractions of the sub-steps sum to %.17g, not to 1",
                         sum);
    return DAL_SUCCESS;
}
