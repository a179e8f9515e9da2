/* The discrete Lagrange-d'Alembert equations, and the maps that they define: on pairs of
 * nodes, and on states. */
#include "discrete/discrete.h"
#include "dalembert/residual.h"

#include <math.h>

static bool is_nonlinear(const dal_discrete *d)
{
    return d->mech.eval.system->def.kind == DAL_NONLINEAR;
}

/* That of q_k, where t is that of the pair before. */
static double time_of_node(const dal_discrete *d, double t, double h)
{
    return t + (1.0 - d->constraint.map.beta) * h;
}

/* The node q_k between the pair at time t and the next. */
static void stand_at_node(dal_discrete *d, double t, double h, const double *node)
{
    d->t = t;
    d->mech.start.h = h;
    d->mech.start.middle = time_of_node(d, t, h);
    d->mech.start.v = d->velocity;
    dal__copy(d->n, node, d->mech.node);
}

/* The equations after the pair at time t: its p^+, its velocity, and mu_k where that is known. */
static int begin(dal_discrete *d, double t, const dal__pair *pair)
{
    int status = dal__discrete_momenta(d, t, true, pair, NULL, d->momentum, false);
    if (!status) status = dal__rho_at(&d->constraint, pair, false);
    if (status) return status;
    dal__copy(d->n, d->constraint.f, d->velocity);
    stand_at_node(d, t, pair->h, pair->q1);
    return is_nonlinear(d) ? DAL_SUCCESS : dal__reaction_forms(&d->mech, d->velocity, d->muk);
}

/* The pair (q_k, q_k + h w), in d->q1. */
static dal__pair next_pair(dal_discrete *d, const double *w)
{
    const double h = d->mech.start.h, *const node = d->mech.node;
    dal__move(d->n, node, h, w, d->q1);
    return (dal__pair){h, node, d->q1, w};
}

/* mu_k^T kappa as a function of w, to be differenced. */
static int value_reaction(const double *w, double *value, void *ctx)
{
    dal_discrete *const d = ctx;
    const size_t n = d->n;
    const dal__pair pair = next_pair(d, w);
    int status = dal__rho_at(&d->constraint, &pair, false);
    if (!status) status = dal__chetaev_forms(&d->mech, d->constraint.f, d->phi_q);
    if (status) return status;
    dal__clear(n, value);
    dal__add_reaction(n, d->m, 1.0, d->phi_q, d->kappa, value);
    return DAL_SUCCESS;
}

/* What the equations need of the pair after: p^-, phi_d and mu_k, with K and B if derivative. */
static int evaluate(dal_discrete *d, const dal__pair *pair, bool derivative)
{
    const double t = d->t + d->mech.start.h;
    const bool nonlinear = is_nonlinear(d);
    int status = dal__discrete_momenta(d, t, true, pair, d->minus, NULL, derivative);
    if (!status && derivative && nonlinear) {
        status = dal__discrete_bend(d, value_reaction, 1.0, pair->w);
        next_pair(d, pair->w); /* the differences moved it */
    }
    if (!status) status = dal__discrete_constraint(d, t, pair, derivative);
    if (status || !nonlinear) return status;
    return dal__chetaev_forms(&d->mech, d->constraint.f, d->muk);
}

/* root.J of n + m equations <- [[K, -mu_k^T], [B, 0]], and the scale of its entries. */
static void assemble(dal_discrete *d)
{
    const size_t n = d->n, m = d->m, N = n + m;
    double *const J = d->root.J.A, *const scale = d->root.scale;
    d->root.J.size = N;
    dal__clear(N * N, J);
    dal__clear(N * N, scale);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            J[i * N + j] = d->K.sum[i * n + j];
            scale[i * N + j] = d->K.scale[i * n + j];
        }
    for (size_t a = 0; a < m; a++)
        for (size_t i = 0; i < n; i++) {
            J[i * N + n + a] = -d->muk[a * n + i];
            J[(n + a) * N + i] = d->B.sum[a * n + i];
            scale[i * N + n + a] = fabs(d->muk[a * n + i]);
            scale[(n + a) * N + i] = d->B.scale[a * n + i];
        }
}

/* Of the step equations at z = (w, kappa), kappa = h lambda. */
static int find_step(dal__newton *equations)
{
    dal_discrete *const d = equations->ctx;
    const size_t n = d->n, m = d->m;
    const double *const w = d->root.z, *const kappa = w + n;
    double *const residual = d->root.residual;
    const dal__pair pair = next_pair(d, w);
    d->kappa = kappa;
    const int status = evaluate(d, &pair, true);
    if (status) return status;
    dal__move(n, d->minus, -1.0, d->momentum, residual);
    dal__add_reaction(n, m, -1.0, d->muk, kappa, residual);
    dal__copy(m, d->phi, residual + n);
    const dal__term terms[] = {{1.0, d->minus}, {1.0, d->momentum}};
    equations->base = dal__base_of_w(&d->mech, d->velocity, 2, terms, d->muk, kappa);
    assemble(d);
    if (!dal__root_step(&d->root, "the matrix [[D1 D2 L_d, mu^T], [D2 phi_d, 0]] is singular",
                        &d->mech.error))
        return DAL_SUCCESS;
    if (!dal__name_rank_lost(&d->mech, d->muk) && !dal__name_rank_lost(&d->mech, d->phi_v))
        dal__add_words(&d->mech.error, DAL__RANK_OR_H);
    return DAL_ESINGULAR;
}

static double moves(void *ctx)
{
    const dal_discrete *const d = ctx;
    const size_t n = d->n;
    const double h = d->mech.start.h;
    double sum = dal__forms_move(&d->mech, d->phi_v, d->phi_q, d->constraint.g,
                                 NULL, 0.0);
    for (size_t k = 0; k < n * n; k++)
        sum += (fabs(d->L_vq[k]) + fabs(h * d->L_qq[k]) + fabs(h * d->f_q[k]))
             * fabs(d->lagrangian.g[k % n]) * d->mech.metric.unit[k / n];
    return sum;
}

/* d->root.z <- (w, kappa) of the pair after the given one, which is at time t. */
static int solve(dal_discrete *d, double t, const dal__pair *pair)
{
    const size_t n = d->n, m = d->m;
    dal__newton equations = {.find_step = find_step, .moves = moves, .ctx = d, .size = n + m,
                             .measured = n, .n = n, .per_unit = d->mech.metric.per_unit,
                             .z = d->root.z, .step = d->root.step};
    int status = begin(d, t, pair);
    if (!status) status = dal__build_metric(&d->mech, t, d->constraint.g, d->velocity);
    if (status) return status;
    dal__copy(n, pair->w, d->root.z);
    dal__clear(m, d->root.z + n);
    return dal__newton_run(&equations, &d->mech.error);
}

/* d->q1 <- the node that the root leads to from q; returns its multipliers. */
static const double *leave_root(dal_discrete *d, const double *q)
{
    double *const lambda = d->root.z + d->n;
    dal__move(d->n, q, d->mech.start.h, d->root.z, d->q1);
    for (size_t a = 0; a < d->m; a++) lambda[a] /= d->mech.start.h;
    return lambda;
}

/* ---- the equations ------------------------------------------------------------------------ */

int dal_discrete_residual(dal_discrete *d, double t, double h, const double *q_before,
                          const double *q, const double *q_after, const double *lambda,
                          double *residual)
{
    dal__pair pair;
    int status = dal__discrete_open(d, t, h, "q_before", q_before, "q", q, &pair);
    if (!status) /* without constraints lambda may be NULL */
        status = DAL__REQUIRE_FINITE(&d->mech.error, {"residual", 0, residual},
                                     {"q_after", d->n, q_after},
                                     {"lambda", d->m, d->m > 0 ? lambda : q});
    if (!status) status = begin(d, t, &pair);
    if (status) return status;
    const size_t n = d->n, m = d->m;
    double *const sides = d->root.residual;
    pair = dal__discrete_pair(d, h, q, q_after);
    status = evaluate(d, &pair, false);
    if (status) return status;
    dal__move(n, d->momentum, -1.0, d->minus, sides);
    dal__add_reaction(n, m, h, d->muk, lambda, sides);
    dal__copy(m, d->phi, sides + n);
    return DAL__DELIVER(&d->mech.error, {"residual", n + m, sides, residual});
}

/* Of the matrix that was assembled, in the order of the arguments. */
static void examine(dal_discrete *d, int *sign, double *logarithm, double *condition)
{
    const size_t N = d->root.J.size;
    double *const squares = d->root.residual, sum = 0.0, most = 0.0, least = HUGE_VAL;
    dal__linear_balance(&d->root.J, d->root.scale);
    *sign = dal__linear_factor(&d->root.J);
    assemble(d);
    const double unit = dal__singular_values(N, N, d->root.J.A, squares);
    for (size_t k = 0; k < N; k++) {
        sum += log(unit) + 0.5 * log(squares[k]);
        most = fmax(most, squares[k]);
        least = fmin(least, squares[k]);
    }
    *logarithm = *sign ? sum : -HUGE_VAL;
    *condition = *sign && least > 0.0 ? sqrt(most / least) : HUGE_VAL;
}

int dal_discrete_regularity(dal_discrete *d, double t, double h, const double *q,
                            const double *q_after, double *matrix, int *sign,
                            double *logarithm, double *condition)
{
    dal__pair pair;
    int s, status = dal__discrete_open(d, t, h, "q", q, "q_after", q_after, &pair);
    if (!status) status = dal__discrete_momenta(d, t + h, true, &pair, NULL, NULL, true);
    if (!status) status = dal__discrete_constraint(d, t + h, &pair, true);
    if (status) return status;
    stand_at_node(d, t, h, q);
    status = dal__reaction_forms(&d->mech, d->constraint.f, d->muk);
    if (status) return status;
    const size_t n = d->n, N = n + d->m;
    double l, c, *const J = d->root.J.A;
    assemble(d);
    status = dal__require_output(&d->mech.error, "matrix", N * N, J);
    if (!status) status = dal__require_output(&d->mech.error, "terms of matrix", N * N,
                                              d->root.scale);
    if (status) return status;
    examine(d, &s, &l, &c);
    if (n % 2 == 1 && h > 0.0) s = -s; /* of (-1/h)^n */
    assemble(d);
    for (size_t i = 0; i < N; i++)
        for (size_t j = 0; j < N; j++) J[i * N + j] *= (i < n ? -1.0 : 1.0) / (j < n ? h : 1.0);
    status = DAL__DELIVER(&d->mech.error, {"matrix", N * N, J, matrix});
    if (status) return status;
    if (sign) *sign = s;
    if (logarithm) *logarithm = l - (double)n * log(fabs(h));
    if (condition) *condition = c;
    return DAL_SUCCESS;
}

/* ---- maps --------------------------------------------------------------------------------- */

int dal_discrete_step(dal_discrete *d, double t, double h, double *q0, double *q1, double *lambda)
{
    dal__pair pair;
    int status = dal__discrete_open(d, t, h, "q0", q0, "q1", q1, &pair);
    if (!status) status = solve(d, t, &pair);
    if (status) return status;
    const double *const multipliers = leave_root(d, q1);
    return DAL__DELIVER(&d->mech.error, {"q0", d->n, q1, q0}, {"q1", d->n, d->q1, q1},
                        {"lambda", d->m, multipliers, lambda});
}

static int require_on_constraint(dal_discrete *d, double t, const dal__pair *pair)
{
    int status = dal__discrete_constraint(d, t, pair, false);
    if (!status) status = dal__build_metric(&d->mech, t, d->constraint.g, d->constraint.f);
    dal__copy(d->n, d->constraint.g, d->mech.forms.q);
    if (!status) status = dal__measure_moves(&d->mech, t, 0.0, d->constraint.f);
    const double *const moves = d->mech.forms.moves;
    if (status || dal__is_consistent(&d->mech, d->phi_v, d->phi, d->constraint.f, moves))
        return status;
    return dal__fail(&d->mech.error, DAL_EOFFD, "the first pair of nodes violates the discrete "
                     "constraint: relative residual %.3g, allowed %g",
                     dal__relative_residual(&d->mech, d->phi_v, d->phi, d->constraint.f, moves),
                     DAL_CONSISTENT);
}

int dal_discrete_run(dal_discrete *d, double t0, double h, size_t steps, double *nodes,
                     double *lambda, size_t *done)
{
    if (done) *done = 0;
    if (!d) return DAL_EINVAL;
    const size_t n = d->n;
    int status = dal__discrete_require(d, "t0", t0, h, "nodes", nodes);
    if (status) return status;
    dal__pair pair = dal__discrete_pair(d, h, nodes, nodes + n);
    status = require_on_constraint(d, t0, &pair);
    for (size_t k = 0; !status && k < steps; k++) {
        pair.q0 = nodes + k * n;
        pair.q1 = pair.q0 + n;
        status = solve(d, t0 + (double)k * h, &pair);
        if (status) break;
        const double *const multipliers = leave_root(d, pair.q1);
        dal__copy(n, d->root.z, d->w);
        status = DAL__DELIVER(&d->mech.error, {"q1", n, d->q1, nodes + (k + 2) * n},
                              {"lambda", d->m, multipliers, lambda ? lambda + k * d->m : NULL});
        if (done && !status) *done = k + 1;
    }
    return status;
}

int dal__discrete_advance(dal_discrete *d, double t, double h, double *x, double *lambda,
                          double *worst)
{
    const size_t n = d->n;
    double *const node = d->mech.node;
    int status = dal__discrete_require(d, "t", t, h, "x", x);
    if (!status) status = dal__rho_invert(d, t, h, x, d->q0, node);
    if (status) return status;
    dal__pair pair = dal__discrete_pair(d, h, d->q0, node);
    if (!d->constraint.map.map) pair.w = x + n;
    status = solve(d, t, &pair);
    if (status) return status;
    const double *const multipliers = leave_root(d, node);
    pair = (dal__pair){h, node, d->q1, d->root.z};
    status = dal__require_output(&d->mech.error, "q1", n, d->q1);
    if (!status) status = dal__rho_at(&d->constraint, &pair, false);
    if (status) return status;
    /* Corrected as a step with beta = 0, whose state stands at its node. */
    dal__copy(n, d->constraint.g, node);
    dal__copy(n, d->constraint.f, d->w);
    d->mech.start = (dal__start){.end = t + h, .h = h};
    status = dal__step_settle(&d->mech, d->w, d->state, worst);
    if (status) return status;
    return DAL__DELIVER(&d->mech.error, {"x", 2 * n, d->state, x},
                        {"lambda", d->m, multipliers, lambda});
}

int dal_discrete_advance(dal_discrete *d, double t, double h, double *x, double *lambda)
{
    double unused = 0.0;
    return d ? dal__discrete_advance(d, t, h, x, lambda, &unused) : DAL_EINVAL;
}
