/* The discrete Lagrangian and constraint of a pair of nodes, with their derivatives.
 *
 * A pair is (q0, w) rather than (q0, q1) inside: derivatives by w = (q1 - q0)/h do not grow as h
 * goes to 0.  So K = dp^-/dw = -h D_1 D_2 L_d and B = dphi_d/dw = h D_2 phi_d, which for rho^beta
 * are those of dal_step_equations. */
#include "discrete/discrete.h"

#include <math.h>
#include <string.h>

int dal_discrete_new(dal_discrete **discrete, const dal_system *system,
                     const dal_difference_map *lagrangian, const dal_difference_map *constraint,
                     dal_error *error)
{
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!discrete || !system || !lagrangian)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", !discrete ? "discrete"
                         : !system ? "system" : "lagrangian");
    const dal_difference_map *const of_constraint = constraint ? constraint : lagrangian;
    const double betas[] = {lagrangian->beta, of_constraint->beta};
    for (size_t i = 0; i < 2; i++)
        if (!(betas[i] >= 0.0 && betas[i] <= 1.0))
            return dal__fail(error, DAL_EINVAL, "%s->beta = %g is not in [0, 1]",
                             i ? "constraint" : "lagrangian", betas[i]);

    const size_t n = system->def.n, m = system->def.m;
    const size_t nn = dal__times(n, n), mn = dal__times(m, n);
    arena memory = {0};
    dal_discrete shape = {.n = n, .m = m}, *self;
    double **const vectors[] = {&shape.q0, &shape.q1, &shape.w, &shape.node, &shape.force,
                                &shape.L_v, &shape.minus, &shape.plus, &shape.momentum,
                                &shape.velocity, &shape.point, &shape.value};
    double **const matrices[] = {&shape.L_qq, &shape.L_vq, &shape.L_vv, &shape.f_q, &shape.f_v,
                                 &shape.X, &shape.X_scale, &shape.Y, &shape.Y_scale, &shape.K,
                                 &shape.K_scale, &shape.bend};
    double **const forms[] = {&shape.phi_v, &shape.phi_q, &shape.B, &shape.B_scale, &shape.muk};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    dal__rho_reserve(&shape.lagrangian, lagrangian, n, &memory);
    dal__rho_reserve(&shape.constraint, of_constraint, n, &memory);
    dal__rho_reserve(&shape.moved, lagrangian, n, &memory);
    dal__root_reserve(&shape.root, dal__times(2, n), &memory); /* m < n */
    dal__reserve_doubles(&memory, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(&memory, DAL_LENGTH(matrices), matrices, nn);
    dal__reserve_doubles(&memory, DAL_LENGTH(forms), forms, mn);
    dal__reserve(&memory, &shape.phi, m, sizeof(double));
    dal__reserve(&memory, &shape.state, dal__times(2, n), sizeof(double));
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    dal__rho_bind(&self->lagrangian);
    dal__rho_bind(&self->constraint);
    dal__rho_bind(&self->moved);
    *discrete = self;
    return DAL_SUCCESS;
}

void dal_discrete_free(dal_discrete *discrete)
{
    if (!discrete) return;
    arena memory = discrete->arena; /* the object lies inside it */
    dal__release(&memory);
}

const dal_error *dal_discrete_error(const dal_discrete *discrete) { return &discrete->mech.error; }
dal_error *dal__discrete_error(dal_discrete *discrete) { return &discrete->mech.error; }

/* ---- pairs -------------------------------------------------------------------------------- */

int dal__discrete_step_size(dal_discrete *d, double h)
{
    if (isfinite(h) && h != 0.0) return DAL_SUCCESS;
    return dal__fail(&d->mech.error, DAL_EINVAL, "h = %g: expected a finite step, not 0", h);
}

int dal__discrete_require(dal_discrete *d, double h, const char *name0, const double *q0,
                          const char *name1, const double *q1)
{
    int status = dal__discrete_step_size(d, h);
    if (!status) status = dal__require_finite(&d->mech, name0, d->n, q0);
    if (!status) status = dal__require_finite(&d->mech, name1, d->n, q1);
    return status;
}

dal__pair dal__discrete_pair(dal_discrete *d, double h, const double *q0, const double *q1)
{
    for (size_t i = 0; i < d->n; i++) d->w[i] = (q1[i] - q0[i]) / h;
    return (dal__pair){h, q0, q1, d->w};
}

int dal_discrete_state(dal_discrete *discrete, double h, const double *q0, const double *q1,
                       double *x)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    if (!x) return dal__null_argument(&d->mech, "x");
    int status = dal__discrete_require(d, h, "q0", q0, "q1", q1);
    if (status) return status;
    const dal__pair pair = dal__discrete_pair(d, h, q0, q1);
    status = dal__rho_at(&d->constraint, &pair, false, &d->mech.error);
    if (status) return status;
    memcpy(x, d->constraint.g, d->n * sizeof *x);
    memcpy(x + d->n, d->constraint.f, d->n * sizeof *x);
    return DAL_SUCCESS;
}

int dal_discrete_nodes(dal_discrete *discrete, double t, double h, const double *x, double *q0,
                       double *q1)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    if (!q0 || !q1) return dal__null_argument(&d->mech, q0 ? "q1" : "q0");
    int status = dal__require_finite(&d->mech, "t", 1, &t);
    if (!status) status = dal__discrete_step_size(d, h);
    if (!status) status = dal__require_finite(&d->mech, "x", 2 * d->n, x);
    if (!status) status = dal__rho_invert(d, t, h, x, d->q0, d->q1);
    if (status) return status;
    memcpy(q0, d->q0, d->n * sizeof *q0);
    memcpy(q1, d->q1, d->n * sizeof *q1);
    return DAL_SUCCESS;
}

/* ---- the discrete Lagrangian -------------------------------------------------------------- */

/* Which factor of a product is a diagonal matrix: the slopes of rho^beta are. */
typedef enum diagonal { NEITHER, THE_FIRST, THE_SECOND } diagonal;

/* C[rows*n] += factor A B with A[rows*n], or A^T with A[n*n], and B[n*n]; C_scale += the sum of the
 * sizes of the terms, where B_scale is that of B, or NULL: |B|. */
static void add_product(size_t rows, size_t n, double factor, diagonal which, const double *A,
                        bool transpose, const double *B, const double *B_scale, double *C,
                        double *C_scale)
{
    for (size_t i = 0; i < rows; i++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0.0, scale = 0.0;
            const size_t first = which == NEITHER ? 0 : which == THE_FIRST ? i : j;
            const size_t end = which == NEITHER ? n : first + 1;
            for (size_t k = first; k < end; k++) {
                const double a = transpose ? A[k * n + i] : A[i * n + k], b = B[k * n + j];
                sum += a * b;
                scale += fabs(a) * (B_scale ? B_scale[k * n + j] : fabs(b));
            }
            C[i * n + j] += factor * sum;
            C_scale[i * n + j] += fabs(factor) * scale;
        }
}

/* p[n] += factor (h g_r^T F + f_r^T L_v), f_r as it is stored. */
static void add_momentum(const dal_discrete *d, double factor, double h, const double *g_r,
                         const double *f_r, double *p)
{
    const size_t n = d->n;
    for (size_t i = 0; i < n; i++) {
        double sum = 0.0;
        for (size_t k = 0; k < n; k++)
            sum += h * g_r[k * n + i] * d->force[k] + f_r[k * n + i] * d->L_v[k];
        p[i] += factor * sum;
    }
}

/* D_1 L_d as a function of q1 with F and L_v held, to be differenced. */
typedef struct held {
    dal_discrete *d;
    double h;
    const double *q0;
} held;

static int value_held(const double *q1, double *value, void *ctx)
{
    const held *const is = ctx;
    dal_discrete *const d = is->d;
    const dal__pair pair = {is->h, is->q0, q1, NULL};
    const int status = dal__rho_at(&d->moved, &pair, true, &d->mech.error);
    if (status) return status;
    memset(value, 0, d->n * sizeof *value);
    add_momentum(d, 1.0, is->h, d->moved.g_0, d->moved.f_0, value);
    return DAL_SUCCESS;
}

/* d->K: by F and L_v at rho, whose derivatives are known, then by the second derivatives of rho. */
static int form_K(dal_discrete *d, bool forced, const dal__pair *pair)
{
    const size_t n = d->n, nn = n * n;
    const double h = pair->h;
    dal__rho *const rho = &d->lagrangian;
    const diagonal slope = rho->map.map ? NEITHER : THE_SECOND;
    const diagonal outer = rho->map.map ? NEITHER : THE_FIRST;
    double *const zeroed[] = {d->X, d->X_scale, d->Y, d->Y_scale, d->K, d->K_scale};
    for (size_t i = 0; i < sizeof zeroed / sizeof *zeroed; i++)
        memset(zeroed[i], 0, nn * sizeof *zeroed[i]);
    /* X = h dF/dw, Y = dL_v/dw */
    add_product(n, n, h * h, slope, d->L_qq, false, rho->g_1, NULL, d->X, d->X_scale);
    add_product(n, n, h, slope, d->L_vq, true, rho->f_1, NULL, d->X, d->X_scale);
    if (forced) {
        add_product(n, n, h * h, slope, d->f_q, false, rho->g_1, NULL, d->X, d->X_scale);
        add_product(n, n, h, slope, d->f_v, false, rho->f_1, NULL, d->X, d->X_scale);
    }
    add_product(n, n, h, slope, d->L_vq, false, rho->g_1, NULL, d->Y, d->Y_scale);
    add_product(n, n, 1.0, slope, d->L_vv, false, rho->f_1, NULL, d->Y, d->Y_scale);
    add_product(n, n, -1.0, outer, rho->g_0, true, d->X, d->X_scale, d->K, d->K_scale);
    add_product(n, n, -1.0, outer, rho->f_0, true, d->Y, d->Y_scale, d->K, d->K_scale);
    if (!rho->map.map) return DAL_SUCCESS;
    held is = {d, h, pair->q0};
    memcpy(d->point, pair->q1, n * sizeof *d->point);
    for (size_t j = 0; j < n; j++) {
        const int status =
            dal__difference(value_held, &is, d->point, j, n, d->value, d->bend + j, n);
        if (status) return status;
    }
    for (size_t k = 0; k < nn; k++) {
        d->K[k] -= h * d->bend[k];
        d->K_scale[k] += fabs(h * d->bend[k]);
    }
    return DAL_SUCCESS;
}

/* That of g of the pair at time t. */
static double time_of_L(const dal_discrete *d, double t, double h)
{
    return t + (d->lagrangian.map.beta - d->constraint.map.beta) * h;
}

int dal__discrete_momenta(dal_discrete *d, double t, bool forced, const dal__pair *pair,
                          double *minus, double *plus, bool derivative)
{
    const size_t n = d->n;
    const double h = pair->h;
    dal__rho *const rho = &d->lagrangian;
    const double time = time_of_L(d, t, h);
    const bool push = forced && d->mech.eval.system->def.force;
    int status = dal__rho_at(rho, pair, true, &d->mech.error);
    if (status) return status;
    const dal__jet wanted = {.L_q = d->force, .L_v = d->L_v,
                             .L_qq = derivative ? d->L_qq : NULL,
                             .L_vq = derivative ? d->L_vq : NULL,
                             .L_vv = derivative ? d->L_vv : NULL};
    status = dal__lagrangian(&d->mech.eval, time, rho->g, rho->f, &wanted, &d->mech.error);
    if (!status && push)
        status = dal__force(&d->mech.eval, time, rho->g, rho->f, d->value,
                            derivative ? d->f_q : NULL, derivative ? d->f_v : NULL,
                            &d->mech.error);
    if (status) return status;
    for (size_t i = 0; push && i < n; i++) d->force[i] += d->value[i];
    if (minus) memset(minus, 0, n * sizeof *minus);
    if (plus) memset(plus, 0, n * sizeof *plus);
    if (minus) add_momentum(d, -1.0, h, rho->g_0, rho->f_0, minus);
    if (plus) add_momentum(d, 1.0, h, rho->g_1, rho->f_1, plus);
    return derivative ? form_K(d, push, pair) : DAL_SUCCESS;
}

int dal_discrete_lagrangian(dal_discrete *discrete, double t, double h, const double *q0,
                            const double *q1, double *L_d, double *D1, double *D2, double *D12)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    const size_t n = d->n;
    double L = 0.0;
    int status = dal__require_finite(&d->mech, "t", 1, &t);
    if (!status) status = dal__discrete_require(d, h, "q0", q0, "q1", q1);
    if (status) return status;
    const dal__pair pair = dal__discrete_pair(d, h, q0, q1);
    status = dal__discrete_momenta(d, t, false, &pair, d->minus, d->plus, D12 != NULL);
    const dal__jet wanted = {.L = &L};
    if (!status)
        status = dal__lagrangian(&d->mech.eval, time_of_L(d, t, h), d->lagrangian.g,
                                 d->lagrangian.f, &wanted, &d->mech.error);
    if (status) return status;
    L *= h;
    for (size_t i = 0; i < n; i++) d->minus[i] = -d->minus[i];
    for (size_t k = 0; D12 && k < n * n; k++) d->K[k] /= -h;
    return DAL__DELIVER(&d->mech.error, {"L_d", 1, &L, L_d}, {"D1", n, d->minus, D1},
                        {"D2", n, d->plus, D2}, {"D12", n * n, d->K, D12});
}

int dal_discrete_momenta(dal_discrete *discrete, double t, double h, const double *q0,
                         const double *q1, double *minus, double *plus)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    int status = dal__require_finite(&d->mech, "t", 1, &t);
    if (!status) status = dal__discrete_require(d, h, "q0", q0, "q1", q1);
    if (status) return status;
    const dal__pair pair = dal__discrete_pair(d, h, q0, q1);
    status = dal__discrete_momenta(d, t, true, &pair, d->minus, d->plus, false);
    if (status) return status;
    return DAL__DELIVER(&d->mech.error, {"minus", d->n, d->minus, minus},
                        {"plus", d->n, d->plus, plus});
}

int dal_discrete_momentum(dal_discrete *discrete, double t, double h, const double *q0,
                          const double *q1, const double *xi0, const double *xi1, double *minus,
                          double *plus)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    int status = dal__require_finite(&d->mech, "xi0", d->n, xi0);
    if (!status) status = dal__require_finite(&d->mech, "xi1", d->n, xi1);
    if (!status) status = dal_discrete_momenta(d, t, h, q0, q1, NULL, NULL);
    if (status) return status;
    const double before = dal__dot(d->n, d->minus, xi0), after = dal__dot(d->n, d->plus, xi1);
    return DAL__DELIVER(&d->mech.error, {"minus", 1, &before, minus}, {"plus", 1, &after, plus});
}

/* ---- the discrete constraint -------------------------------------------------------------- */

int dal__discrete_constraint(dal_discrete *d, double t, const dal__pair *pair, bool derivative)
{
    const size_t n = d->n, m = d->m;
    dal__rho *const rho = &d->constraint;
    int status = dal__rho_at(rho, pair, derivative, &d->mech.error);
    if (!status)
        status = dal__constraint(&d->mech.eval, t, rho->g, rho->f, d->phi, d->phi_v,
                                 derivative ? d->phi_q : NULL, NULL, &d->mech.error);
    if (status || !derivative) return status;
    const diagonal slope = rho->map.map ? NEITHER : THE_SECOND;
    memset(d->B, 0, m * n * sizeof *d->B);
    memset(d->B_scale, 0, m * n * sizeof *d->B_scale);
    add_product(m, n, pair->h, slope, d->phi_q, false, rho->g_1, NULL, d->B, d->B_scale);
    add_product(m, n, 1.0, slope, d->phi_v, false, rho->f_1, NULL, d->B, d->B_scale);
    return DAL_SUCCESS;
}

int dal_discrete_constraint(dal_discrete *discrete, double t, double h, const double *q0,
                            const double *q1, double *phi_d, double *D1, double *D2)
{
    if (!discrete) return DAL_EINVAL;
    dal_discrete *const d = discrete;
    const size_t n = d->n, mn = d->m * n;
    int status = dal__require_finite(&d->mech, "t", 1, &t);
    if (!status) status = dal__discrete_require(d, h, "q0", q0, "q1", q1);
    if (status) return status;
    const dal__pair pair = dal__discrete_pair(d, h, q0, q1);
    status = dal__discrete_constraint(d, t, &pair, true);
    if (status) return status;
    const diagonal slope = d->constraint.map.map ? NEITHER : THE_SECOND;
    double *const left = d->muk;
    memset(left, 0, mn * sizeof *left);
    add_product(d->m, n, 1.0, slope, d->phi_q, false, d->constraint.g_0, NULL, left, d->B_scale);
    add_product(d->m, n, 1.0 / h, slope, d->phi_v, false, d->constraint.f_0, NULL, left,
                d->B_scale);
    for (size_t k = 0; k < mn; k++) d->B[k] /= h;
    return DAL__DELIVER(&d->mech.error, {"phi_d", d->m, d->phi, phi_d}, {"D1", mn, left, D1},
                        {"D2", mn, d->B, D2});
}
