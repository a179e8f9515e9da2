/* The records of the family beta: sub-steps {beta, fraction}, one after the other. */
#include "step/beta.h"
#include "step/scheme.h"

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
#define SS10(STEP) \
    STEP(0.0787957225216864192639076793383), STEP(0.313096103415108527764812471920), \
    STEP(0.0279183832350780661095202732659), STEP(-0.229592841593907094151213396801), \
    STEP(0.130962061077164863174656859292), STEP(-0.269733405654510714344609732217), \
    STEP(0.0749733431558914356661371056391), STEP(0.111993423999810204889575080737), \
    STEP(0.366133449546226751193148123537), STEP(-0.399105630136035897878629810584), \
    STEP(0.103087398527471077315802769995), STEP(0.411430873955890237820704118977), \
    STEP(-0.00486636058313526176219565930774), STEP(-0.392033353708639906448081936430), \
    STEP(0.0519425029624496470371829048314), STEP(0.0506650907599244963358743425097), \
    STEP(0.0496743706397298790545688006667), STEP(0.0493177357595945379176800092605), \
    STEP(0.0496743706397298790545688006667), STEP(0.0506650907599244963358743425097), \
    STEP(0.0519425029624496470371829048314), STEP(-0.392033353708639906448081936430), \
    STEP(-0.00486636058313526176219565930774), STEP(0.411430873955890237820704118977), \
    STEP(0.103087398527471077315802769995), STEP(-0.399105630136035897878629810584), \
    STEP(0.366133449546226751193148123537), STEP(0.111993423999810204889575080737), \
    STEP(0.0749733431558914356661371056391), STEP(-0.269733405654510714344609732217), \
    STEP(0.130962061077164863174656859292), STEP(-0.229592841593907094151213396801), \
    STEP(0.0279183832350780661095202732659), STEP(0.313096103415108527764812471920), \
    STEP(0.0787957225216864192639076793383)

/* Symmetric compositions of explicit and endpoint, its adjoint, in turn. */
#define IN_TURN(a, b) {0.0, a}, {1.0, b}
static const dal_substep bm4[] = {
    IN_TURN(0.0792036964311956694336634958883, 0.130311410182166351840409144141),
    IN_TURN(0.222861495867607636640652167432, -0.366713269047425644915767225288),
    IN_TURN(0.324648188689706109547656926986, 0.109688477876749877453385490841),
    IN_TURN(0.109688477876749877453385490841, 0.324648188689706109547656926986),
    IN_TURN(-0.366713269047425644915767225288, 0.222861495867607636640652167432),
    IN_TURN(0.130311410182166351840409144141, 0.0792036964311956694336634958883),
};
static const dal_substep bm6[] = {
    IN_TURN(0.0502627644003926860212216544021, 0.0985536835006505458996793511335),
    IN_TURN(0.314960616927693269163384369000, -0.447346482695476916612229795599),
    IN_TURN(0.492426372489874979581126847724, -0.425118767797690521430868951131),
    IN_TURN(0.237063913978121606631740462212, 0.195602488600051990895927508671),
    IN_TURN(0.346358189850728143935487232262, -0.362762779254345784085468678675),
    IN_TURN(-0.362762779254345784085468678675, 0.346358189850728143935487232262),
    IN_TURN(0.195602488600051990895927508671, 0.237063913978121606631740462212),
    IN_TURN(-0.425118767797690521430868951131, 0.492426372489874979581126847724),
    IN_TURN(-0.447346482695476916612229795599, 0.314960616927693269163384369000),
    IN_TURN(0.0985536835006505458996793511335, 0.0502627644003926860212216544021),
};

static const dal_substep leapfrog[] = {LEAPFROG(1.0)};
static const dal_substep leapfrog_mirror[] = {{1.0, 0.5}, {0.0, 0.5}};
static const dal_substep leapfrog_suzuki4[] = {SUZUKI4(LEAPFROG)};
static const dal_substep leapfrog_yoshida4[] = {YOSHIDA4(LEAPFROG)};
static const dal_substep leapfrog_kl6[] = {KL6(LEAPFROG)};
static const dal_substep leapfrog_kl8[] = {KL8(LEAPFROG)};
static const dal_substep leapfrog_ss10[] = {SS10(LEAPFROG)};
static const dal_substep midpoint_suzuki4[] = {SUZUKI4(MIDPOINT)};
static const dal_substep midpoint_yoshida4[] = {YOSHIDA4(MIDPOINT)};
static const dal_substep midpoint_kl6[] = {KL6(MIDPOINT)};
static const dal_substep midpoint_kl8[] = {KL8(MIDPOINT)};
static const dal_substep midpoint_ss10[] = {SS10(MIDPOINT)};

#define SUBSTEPS(array) .count = sizeof(array) / sizeof(array)[0], .substeps = array

static const char paper[] = "Jimenez and Scheurle, arXiv 1407.2116";
static const char suzuki[] = "Suzuki, Phys. Lett. A 146 (1990) 319";
static const char yoshida[] = "Yoshida, Phys. Lett. A 150 (1990) 262";
static const char kahan_li[] = "Kahan and Li, Math. Comp. 66 (1997) 1089";
static const char blanes_moan[] = "Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313";
static const char sofroniou[] = "Sofroniou and Spaletta, Optim. Methods Softw. 20 (2005) 597";

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
     .help = "beta 1 (Facil): the adjoint of explicit; its original nodes satisfy D too"},
    {.name = "leapfrog-mirror", SUBSTEPS(leapfrog_mirror), .order = 2, .symmetric = 1,
     .reference = paper,
     .help = "beta 1 then 0 at half steps: V at the ends of the step, as RATTLE"},
    {.name = "midpoint-nodes", .beta = 0.5, .nodes = DAL_KEPT_NODES, .order = 1, .reference = paper,
     .help = "midpoint at the original nodes: satisfies D_eps, order 1 in the state"},
    {.name = "explicit-nodes", .beta = 0.0, .nodes = DAL_KEPT_NODES, .order = 1, .reference = paper,
     .help = "explicit at the original nodes: satisfies D_eps"},
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
    {.name = "leapfrog-ss10", SUBSTEPS(leapfrog_ss10), .order = 10, .symmetric = 1,
     .reference = sofroniou, .help = "order 10 from 35 leapfrog steps: to roundoff, at large h"},
    {.name = "bm4", SUBSTEPS(bm4), .order = 4, .symmetric = 1, .reference = blanes_moan,
     .help = "order 4 from 6 pairs of explicit and endpoint: small error constant"},
    {.name = "bm6", SUBSTEPS(bm6), .order = 6, .symmetric = 1, .reference = blanes_moan,
     .help = "order 6 from 10 pairs of explicit and endpoint: small error constant"},
    {.name = "midpoint-suzuki4", SUBSTEPS(midpoint_suzuki4), .order = 4, .symmetric = 1,
     .reference = suzuki, .help = "order 4 from 5 midpoint steps, small error constant"},
    {.name = "midpoint-yoshida4", SUBSTEPS(midpoint_yoshida4), .order = 4, .symmetric = 1,
     .reference = yoshida, .help = "order 4 from 3 midpoint steps, larger error constant"},
    {.name = "midpoint-kl6", SUBSTEPS(midpoint_kl6), .order = 6, .symmetric = 1,
     .reference = kahan_li, .help = "order 6 from 9 midpoint steps"},
    {.name = "midpoint-kl8", SUBSTEPS(midpoint_kl8), .order = 8, .symmetric = 1,
     .reference = kahan_li, .help = "order 8 from 17 midpoint steps"},
    {.name = "midpoint-ss10", SUBSTEPS(midpoint_ss10), .order = 10, .symmetric = 1,
     .reference = sofroniou, .help = "order 10 from 35 midpoint steps"},
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
                           .help = "the beta-scheme with this beta", .reference = paper};
    return 1;
}

int dal__beta_check(const dal_scheme *scheme, dal_error *error)
{
    const size_t count = dal__scheme_count(scheme);
    double sum = 0.0, size = 0.0;
    if (scheme->count > 0 && !scheme->substeps)
        return dal__fail(error, DAL_EINVAL, "scheme.count = %zu, but scheme.substeps is NULL",
                         scheme->count);
    if (scheme->nodes != DAL_MOVED_NODES && scheme->nodes != DAL_KEPT_NODES)
        return dal__fail(error, DAL_EINVAL, "scheme.nodes = %d: expected DAL_MOVED_NODES or "
                         "DAL_KEPT_NODES", (int)scheme->nodes);
    if (scheme->nodes == DAL_KEPT_NODES && count > 1)
        return dal__fail(error, DAL_EINVAL, "scheme.count = %zu: expected a single sub-step with "
                         "kept nodes", count);
    for (size_t j = 0; j < count; j++) {
        const dal_substep step = dal__scheme_substep(scheme, j);
        if (!(step.beta >= 0.0 && step.beta <= 1.0))
            return dal__fail(error, DAL_EINVAL, "sub-step %zu: beta = %g, expected a number in [0, "
                             "1]", j, step.beta);
        if (!isfinite(step.fraction) || step.fraction == 0.0)
            return dal__fail(error, DAL_EINVAL, "sub-step %zu: fraction = %g, expected a finite "
                             "number other than 0", j, step.fraction);
        sum += step.fraction;
        size += fabs(step.fraction);
    }
    /* coefficients printed with 15 digits are welcome */
    if (!(fabs(sum - 1.0) <= 1e-14 * (1.0 + size)))
        return dal__fail(error, DAL_EINVAL, "the fractions of the sub-steps sum to %.17g, not to 1",
                         sum);
    return DAL_SUCCESS;
}
