/* The discrete Lagrangian and constraint of a pair of nodes, with their derivatives.
 *
 * A pair is (q0, w) rather than (q0, q1) inside: derivatives by w = (q1 - q0)/h do not grow as h
 * goes to 0.  So K = dp^-/dw = -h D_1 D_2 L_d and B = dphi_d/dw = h D_2 phi_d, which for rho^beta
 * are those of dal_step_equations. */
#include "discrete/discrete.h"

#include <math.h>

int dal_discrete_new(dal_discrete **discrete, const dal_system *system,
                     const dal_difference_map *lagrangian, const dal_difference_map *constraint,
                     dal_error *error)
{
    int status = DAL__REQUIRE(error, {"discrete", discrete}, {"system", system},
                              {"lagrangian", lagrangian});
    if (status) return status;
    const dal_difference_map *const of_constraint = constraint ? constraint : lagrangian;
    const double betas[] = {lagrangian->beta, of_constraint->beta};
    for (size_t i = 0; i < 2; i++)
        if (!(betas[i] >= 0.0 && betas[i] <= 1.0))
            return dal__fail(error, DAL_EINVAL, "%s->beta = %g: expected a number in [0, 1]",
                             i ? "constraint" : "lagrangian", betas[i]);

    const size_t n = system->def.n, m = system->def.m;
    arena memory = {0};
    dal_discrete shape = {.n = n, .m = m}, *self;
    dal__reserve(&memory, &self, 1, sizeof *self);
    shape.mech.eval.dense = true;
    dal__mechanics_reserve(&shape.mech, system, &memory);
    dal__rho_reserve(&shape.lagrangian, lagrangian, n, &memory);
    dal__rho_reserve(&shape.constraint, of_constraint, n, &memory);
    dal__rho_reserve(&shape.moved, lagrangian, n, &memory);
    dal__root_reserve(&shape.root, dal__times(2, n), &memory); /* m <= n */
    DAL__RESERVE(&memory, n, &shape.q0, &shape.q1, &shape.w, &shape.force, &shape.L_v,
                 &shape.minus, &shape.plus, &shape.momentum, &shape.velocity, &shape.point,
                 &shape.value);
    DAL__RESERVE(&memory, dal__times(n, n), &shape.L_qq, &shape.L_vq, &shape.L_vv, &shape.f_q,
                 &shape.f_v, &shape.X.sum, &shape.X.scale, &shape.Y.sum, &shape.Y.scale,
                 &shape.K.sum, &shape.K.scale, &shape.bend);
    DAL__RESERVE(&memory, dal__times(m, n), &shape.phi_v, &shape.phi_q, &shape.B.sum,
                 &shape.B.scale, &shape.muk);
    DAL__RESERVE(&memory, m, &shape.phi);
    DAL__RESERVE(&memory, dal__times(2, n), &shape.state);
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    dal__rho_bind(&self->lagrangian, &self->mech.error);
    dal__rho_bind(&self->constraint, &self->mech.error);
    dal__rho_bind(&self->moved, &self->mech.error);
    *discrete = self;
    return DAL_SUCCESS;
}

void dal_discrete_free(dal_discrete *discrete)
{
    if (discrete) dal__release(&discrete->arena);
}

const dal_error *dal_discrete_error(const dal_discrete *discrete) { return &discrete->mech.error; }

int dal_discrete_input(dal_discrete *discrete, const double *u)
{
    return discrete ? dal_mechanics_input(&discrete->mech, u) : DAL_EINVAL;
}

/* ---- pairs -------------------------------------------------------------------------------- */

int dal__discrete_require(dal_discrete *d, const char *name_t, double t, double h,
                          const char *name_x, const double *x)
{
    const int status = DAL__REQUIRE_FINITE(&d->mech.error, {name_t, 1, &t}, {name_x, 2 * d->n, x});
    return status ? status : dal__require_step(&d->mech.error, h);
}

int dal__discrete_open(dal_discrete *d, double t, double h, const char *name0, const double *q0,
                       const char *name1, const double *q1, dal__pair *pair)
{
    if (!d) return DAL_EINVAL;
    int status = DAL__REQUIRE_FINITE(&d->mech.error, {"t", 1, &t}, {name0, d->n, q0},
                                     {name1, d->n, q1});
    if (!status) status = dal__require_step(&d->mech.error, h);
    if (!status) *pair = dal__discrete_pair(d, h, q0, q1);
    return status;
}

dal__pair dal__discrete_pair(dal_discrete *d, double h, const double *q0, const double *q1)
{
    for (size_t i = 0; i < d->n; i++) d->w[i] = (q1[i] - q0[i]) / h;
    return (dal__pair){h, q0, q1, d->w};
}

int dal_discrete_state(dal_discrete *d, double h, const double *q0, const double *q1, double *x)
{
    dal__pair pair;
    int status = dal__discrete_open(d, 0.0, h, "q0", q0, "q1", q1, &pair);
    if (!status) status = dal__require_finite(&d->mech, "x", 0, x);
    if (!status) status = dal__rho_at(&d->constraint, &pair, false);
    if (status) return status;
    dal__copy(d->n, d->constraint.g, x);
    dal__copy(d->n, d->constraint.f, x + d->n);
    return DAL_SUCCESS;
}

int dal_discrete_nodes(dal_discrete *d, double t, double h, const double *x, double *q0,
                       double *q1)
{
    if (!d) return DAL_EINVAL;
    int status = DAL__REQUIRE_FINITE(&d->mech.error, {"q0", 0, q0}, {"q1", 0, q1});
    if (!status) status = dal__discrete_require(d, "t", t, h, "x", x);
    return status ? status : dal__rho_invert(d, t, h, x, q0, q1);
}

/* ---- the discrete Lagrangian -------------------------------------------------------------- */

/* C[rows*n] += factor A B with A[rows*n], or A^T with A[n*n], and B[n*n], whose scale may be NULL:
 * |B|. */
static void add_product(size_t rows, size_t n, double factor, const double *A, bool transpose,
                        dal__terms B, dal__terms C)
{
    for (size_t i = 0; i < rows; i++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0.0, scale = 0.0;
            for (size_t k = 0; k < n; k++) {
                const double a = transpose ? A[k * n + i] : A[i * n + k], b = B.sum[k * n + j];
                sum += a * b;
                scale += fabs(a) * (B.scale ? B.scale[k * n + j] : fabs(b));
            }
            C.sum[i * n + j] += factor * sum;
            C.scale[i * n + j] += fabs(factor) * scale;
        }
}

/* The derivatives of a function of (g, f): by_g[rows*n], and by_f[rows*n] or its transpose, each
 * with a factor. */
typedef struct slopes {
    double factor_g;
    const double *by_g;
    double factor_f;
    const double *by_f;
    bool transpose;
} slopes;

/* C[rows*n] += factor_g by_g g_r + factor_f by_f f_r: the chain rule through rho, with the g_r and
 * f_r of the node q1 if last, else of q0. */
static void add_chain(const dal__rho *rho, bool last, size_t rows, const slopes *of, dal__terms C)
{
    const dal__terms g_r = {last ? rho->g_1 : rho->g_0, NULL};
    const dal__terms f_r = {last ? rho->f_1 : rho->f_0, NULL};
    add_product(rows, rho->n, of->factor_g, of->by_g, false, g_r, C);
    add_product(rows, rho->n, of->factor_f, of->by_f, of->transpose, f_r, C);
}

static void clear(size_t count, dal__terms C)
{
    dal__clear(count, C.sum);
    dal__clear(count, C.scale);
}

/* p[n] <- factor (h g_r^T F + f_r^T L_v), f_r as it is stored. */
static void build_momentum(const dal_discrete *d, double factor, double h, const double *g_r,
                           const double *f_r, double *p)
{
    const size_t n = d->n;
    for (size_t i = 0; i < n; i++) {
        double sum = 0.0;
        for (size_t k = 0; k < n; k++)
            sum += h * g_r[k * n + i] * d->force[k] + f_r[k * n + i] * d->L_v[k];
        p[i] = 0.0 + factor * sum; /* not -0 */
    }
}

/* D_1 L_d as a function of q1 with F and L_v held, to be differenced. */
static int value_held(const double *q1, double *value, void *ctx)
{
    dal_discrete *const d = ctx;
    const dal__pair pair = {d->held.h, d->held.q0, q1, NULL};
    const int status = dal__rho_at(&d->moved, &pair, true);
    if (status) return status;
    build_momentum(d, 1.0, pair.h, d->moved.g_0, d->moved.f_0, value);
    return DAL_SUCCESS;
}

int dal__discrete_bend(dal_discrete *d, dal__function f, double factor, const double *point)
{
    const size_t n = d->n;
    dal__copy(n, point, d->point);
    const int status = dal__jacobian(f, d, n, d->point, n, d->value, d->bend);
    for (size_t k = 0; !status && k < n * n; k++) {
        d->K.sum[k] -= factor * d->bend[k];
        d->K.scale[k] += fabs(factor * d->bend[k]);
    }
    return status;
}

/* d->K: by F and L_v at rho, whose derivatives are known, then by the second derivatives of rho. */
static int build_K(dal_discrete *d, bool forced, const dal__pair *pair)
{
    const size_t n = d->n;
    const double h = pair->h;
    dal__rho *const rho = &d->lagrangian;
    clear(n * n, d->X);
    clear(n * n, d->Y);
    clear(n * n, d->K);
    add_chain(rho, true, n, &(slopes){h * h, d->L_qq, h, d->L_vq, true}, d->X);
    if (forced) add_chain(rho, true, n, &(slopes){h * h, d->f_q, h, d->f_v, false}, d->X);
    add_chain(rho, true, n, &(slopes){h, d->L_vq, 1.0, d->L_vv, false}, d->Y);
    add_product(n, n, -1.0, rho->g_0, true, d->X, d->K);
    add_product(n, n, -1.0, rho->f_0, true, d->Y, d->K);
    d->held = *pair;
    return rho->map.map ? dal__discrete_bend(d, value_held, h, pair->q1) : DAL_SUCCESS;
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
    int status = dal__rho_at(rho, pair, true);
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
    if (push) dal__add(n, 1.0, d->value, d->force);
    if (minus) build_momentum(d, -1.0, h, rho->g_0, rho->f_0, minus);
    if (plus) build_momentum(d, 1.0, h, rho->g_1, rho->f_1, plus);
    return derivative ? build_K(d, push, pair) : DAL_SUCCESS;
}

int dal_discrete_lagrangian(dal_discrete *d, double t, double h, const double *q0,
                            const double *q1, double *L_d, double *D1, double *D2, double *D12)
{
    dal__pair pair;
    double L = 0.0;
    const dal__jet wanted = {.L = &L};
    int status = dal__discrete_open(d, t, h, "q0", q0, "q1", q1, &pair);
    if (!status)
        status = dal__discrete_momenta(d, t, false, &pair, d->minus, d->plus, D12 != NULL);
    if (!status)
        status = dal__lagrangian(&d->mech.eval, time_of_L(d, t, h), d->lagrangian.g,
                                 d->lagrangian.f, &wanted, &d->mech.error);
    if (status) return status;
    const size_t n = d->n;
    L *= h;
    for (size_t i = 0; i < n; i++) d->minus[i] = -d->minus[i];
    for (size_t k = 0; D12 && k < n * n; k++) d->K.sum[k] /= -h;
    return DAL__DELIVER(&d->mech.error, {"L_d", 1, &L, L_d}, {"D1", n, d->minus, D1},
                        {"D2", n, d->plus, D2}, {"D12", n * n, d->K.sum, D12});
}

int dal_discrete_momenta(dal_discrete *d, double t, double h, const double *q0, const double *q1,
                         double *minus, double *plus)
{
    dal__pair pair;
    int status = dal__discrete_open(d, t, h, "q0", q0, "q1", q1, &pair);
    if (!status) status = dal__discrete_momenta(d, t, true, &pair, d->minus, d->plus, false);
    if (status) return status;
    return DAL__DELIVER(&d->mech.error, {"minus", d->n, d->minus, minus},
                        {"plus", d->n, d->plus, plus});
}

int dal_discrete_momentum(dal_discrete *d, double t, double h, const double *q0, const double *q1,
                          const double *xi0, const double *xi1, double *minus, double *plus)
{
    if (!d) return DAL_EINVAL;
    int status = DAL__REQUIRE_FINITE(&d->mech.error, {"xi0", d->n, xi0}, {"xi1", d->n, xi1});
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
    int status = dal__rho_at(rho, pair, derivative);
    if (!status)
        status = dal__constraint(&d->mech.eval, t, rho->g, rho->f, d->phi, d->phi_v,
                                 derivative ? d->phi_q : NULL, NULL, &d->mech.error);
    if (status || !derivative) return status;
    clear(m * n, d->B);
    add_chain(rho, true, m, &(slopes){pair->h, d->phi_q, 1.0, d->phi_v, false}, d->B);
    return DAL_SUCCESS;
}

int dal_discrete_constraint(dal_discrete *d, double t, double h, const double *q0,
                            const double *q1, double *phi_d, double *D1, double *D2)
{
    dal__pair pair;
    int status = dal__discrete_open(d, t, h, "q0", q0, "q1", q1, &pair);
    if (!status) status = dal__discrete_constraint(d, t, &pair, true);
    if (status) return status;
    const size_t mn = d->m * d->n;
    const dal__terms left = {d->muk, d->B.scale};
    for (size_t k = 0; k < mn; k++) d->B.sum[k] /= h;
    clear(mn, left);
    add_chain(&d->constraint, false, d->m,
              &(slopes){1.0, d->phi_q, 1.0 / h, d->phi_v, false}, left);
    return DAL__DELIVER(&d->mech.error, {"phi_d", d->m, d->phi, phi_d}, {"D1", mn, left.sum, D1},
                        {"D2", mn, d->B.sum, D2});
}
