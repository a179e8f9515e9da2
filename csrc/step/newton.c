/* One beta-step of any system by Newton on all unknowns (w, kappa).
 *
 * It does what kernel.h leaves to it, and steps with different maps for L and for D.  The matrix
 * [[K, -mu_k^T], [B, 0]] is reduced to the m x m Schur complement S = B K^-1 mu_k^T.  The guess is
 * the last step, scaled by h; where that fails, the state itself. */
#include "step/newton.h"

#include "dalembert/residual.h"
#include "discrete/discrete.h"

#include <math.h>
#include <string.h>

void dal__newton_reserve(newton *solver, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m;
    const bool sparse = system->sparse && !system->full_newton;
    solver->whole.eval.dense = true;
    if (system->full_newton) dal__mechanics_reserve(&solver->whole, system, a);
    const size_t mn = sparse && system->rows ? dal_rows_entries(system->rows) : dal__times(m, n);
    double **const vectors[] = {&solver->rate, &solver->R1, &solver->y};
    double **const multipliers[] = {&solver->lambda, &solver->R2, &solver->r};
    double **const unknowns[] = {&solver->z, &solver->step};
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve_doubles(a, DAL_LENGTH(unknowns), unknowns, n + m);
    dal__reserve(a, &solver->x, dal__times(2, n), sizeof(double));
    dal__reserve(a, &solver->B, mn, sizeof(double));
    dal__reserve(a, &solver->KZ, mn, sizeof(double));
    if (!sparse) dal__linear_reserve(&solver->K, n, a);
    dal__linear_reserve_pattern(&solver->S, m, sparse ? system->pattern : NULL, a);
}

void dal__newton_bind(newton *solver, const dal_system *system, int max_iterations)
{
    solver->n = system->def.n;
    solver->m = system->def.m;
    solver->max_iterations = max_iterations;
    if (system->full_newton) dal__mechanics_bind(&solver->whole, system);
}

void dal__newton_forget(newton *solver) { solver->warm = false; }

size_t dal__newton_save(const newton *solver, double *values)
{
    const size_t n = solver->rate ? solver->n : 0, m = solver->rate ? solver->m : 0;
    if (!values) return 1 + n + m;
    values[0] = solver->warm;
    for (size_t i = 0; i < n; i++) values[1 + i] = solver->rate[i];
    for (size_t a = 0; a < m; a++) values[1 + n + a] = solver->lambda[a];
    return 1 + n + m;
}

void dal__newton_restore(newton *solver, const double *values)
{
    const size_t n = solver->rate ? solver->n : 0, m = solver->rate ? solver->m : 0;
    solver->warm = values[0] != 0.0;
    for (size_t i = 0; i < n; i++) solver->rate[i] = values[1 + i];
    for (size_t a = 0; a < m; a++) solver->lambda[a] = values[1 + n + a];
}

/* The sizes of S, as in factor_S of stage.h: losses where mu and a phi_q cancel in B count. */
static void size_S(newton *s)
{
    const dal_mechanics *const mech = s->mech;
    const size_t n = s->n, m = s->m;
    const dal_rows *const rows = mech->eval.rows;
    for (size_t a = 0; a < m; a++) {
        const size_t begin = rows ? rows->first[a] : a * n;
        const size_t end = rows ? rows->first[a + 1] : begin + n;
        double row = 0.0, terms = 0.0, most = 0.0;
        for (size_t e = begin; e < end; e++) {
            const size_t i = rows ? rows->column[e] : e - begin;
            const double mu = mech->forms.mu[e], entry = fabs(mu) + fabs(s->B[e] - mu);
            row += entry * mech->metric.unit[i];
            terms += entry * fabs(s->KZ[e]);
            most = fmax(most, fabs(s->KZ[e]) * mech->metric.per_unit[i]);
        }
        s->S.sizes[a] = m > 1 ? row : terms;
        s->S.sizes[m + a] = m > 1 ? most : 1.0;
    }
}

/* y <- K^-1 R1 and KZ <- the rows K^-1 mu_k^a, where K = M is diagonal. */
static void divide_by_mass(newton *s)
{
    const double *const inverse = s->mech->eval.system->mass_inverse;
    const dal_rows *const rows = s->mech->eval.rows;
    for (size_t i = 0; i < s->n; i++) s->y[i] = inverse[i] * s->R1[i];
    for (size_t e = 0; e < dal__entries(&s->mech->eval); e++)
        s->KZ[e] = inverse[rows ? rows->column[e] : e % s->n] * s->mech->muk[e];
}

/* The same by the factors of K; the sign of its determinant. */
static int divide_by_K(newton *s)
{
    const int sign = dal__linear_factor(&s->K);
    if (sign == 0) return 0;
    dal__linear_solve(&s->K, s->R1, s->y);
    for (size_t a = 0; a < s->m; a++)
        dal__linear_solve(&s->K, s->mech->muk + a * s->n, s->KZ + a * s->n);
    return sign;
}

/* step <- the Newton step of w and kappa, from R1, R2, K, B and mu_k; *sign <- that of the
 * determinant of the matrix. */
static int solve_linear(newton *s, int *sign)
{
    dal_mechanics *const mech = s->mech;
    const size_t n = s->n, m = s->m;
    double *const d = s->step + n;
    for (size_t i = 0; i < n; i++) s->R1[i] = -s->R1[i];
    *sign = 1;
    if (mech->eval.sparse) divide_by_mass(s);
    else *sign = divide_by_K(s);
    if (*sign == 0)
        return dal__fail(&mech->error, DAL_ESINGULAR, "the derivative K of the equations of motion "
                         "in v' is singular: h is too large here");
    dal__linear_multiply(&s->S, mech->eval.rows, n, s->B, s->KZ);
    size_S(s);
    *sign *= dal__linear_factor(&s->S);
    s->inverse = dal__linear_log_inverse(&s->S);
    if (*sign == 0) {
        dal__fail(&mech->error, DAL_ESINGULAR, "the Schur complement B K^-1 mu_k^T is singular");
        if (!dal__name_rank_lost(mech, mech->muk) && !dal__name_rank_lost(mech, mech->forms.mu))
            dal__add_words(&mech->error, DAL__RANK_OR_H);
        return DAL_ESINGULAR;
    }
    for (size_t a = 0; a < m; a++) s->r[a] = -(s->R2[a] + dal__row_dot(mech, s->B, a, s->y));
    dal__linear_solve(&s->S, s->r, d);
    memcpy(s->step, s->y, n * sizeof *s->step);
    for (size_t a = 0; a < m; a++) dal__row_add(mech, d[a], s->KZ, a, s->step);
    return DAL_SUCCESS;
}

static int find_step(dal__newton *equations)
{
    newton *const s = equations->ctx;
    const bool sparse = s->mech->eval.sparse;
    int status = dal__step_at(s->mech, s->z, s->z + s->n, s->R1, s->R2, sparse ? NULL : s->K.A,
                              sparse ? NULL : s->K.sizes, s->B);
    if (!status) status = solve_linear(s, &equations->sign);
    if (status) return status;
    equations->base = s->mech->start.base;
    s->stats->iterations++;
    return DAL_SUCCESS;
}

static double moves(void *ctx) { return dal__step_moves(((newton *)ctx)->mech); }

/* From the guess in z to the solution. */
static int iterate(newton *s)
{
    dal__newton equations = {.find_step = find_step, .moves = moves, .ctx = s,
                             .size = s->n + s->m, .measured = s->n, .n = s->n,
                             .per_unit = s->mech->metric.per_unit, .z = s->z, .step = s->step,
                             .most = s->max_iterations};
    const int status = dal__newton_run(&equations, &s->mech->error);
    if (status == DAL_ENOCONV && equations.sign < 0) dal__name_turned(s->mech);
    s->stats->halvings += (size_t)equations.progress.halvings;
    return status;
}

/* dal__newton_step, by s->mech. */
static int make_step(newton *s, double t, double end, double alpha, double beta, double h,
                     bool kept, double *x, double *kappa)
{
    const size_t n = s->n, m = s->m;
    const double *const v = x + n;
    dal_mechanics *const mech = s->mech;
    dal_stats *const stats = s->stats;
    int status = dal__step_begin(mech, t, end, alpha, beta, h, kept, x);
    if (status) return status;
    bool solved = false;
    if (s->warm) {
        for (size_t i = 0; i < n; i++) s->z[i] = v[i] + h * s->rate[i];
        for (size_t a = 0; a < m; a++) s->z[n + a] = h * s->lambda[a];
        status = iterate(s);
        solved = status == DAL_SUCCESS;
        if (status == DAL_EUSER) return status;
        if (status) stats->full_newtons++;
    }
    if (!solved) {
        memcpy(s->z, v, n * sizeof *s->z);
        memset(s->z + n, 0, m * sizeof *s->z);
        status = iterate(s);
    }
    if (!status) status = dal__step_settle(mech, s->z, s->x, &stats->worst_residual);
    if (status) return status;
    for (size_t i = 0; i < n; i++) s->rate[i] = (s->x[n + i] - v[i]) / h;
    for (size_t a = 0; a < m; a++) s->lambda[a] = s->z[n + a] / h;
    s->warm = true;
    memcpy(x, s->x, 2 * n * sizeof *x);
    memcpy(kappa, s->z + n, m * sizeof *kappa);
    return DAL_SUCCESS;
}

int dal__newton_step(newton *solver, dal_mechanics *mech, double t, double end, double alpha,
                     double beta, double h, bool kept, double *x, double *kappa, dal_stats *stats)
{
    newton *const s = solver;
    evaluator *const given = &mech->eval, *const own = &s->whole.eval;
    const bool full_newton = given->system->full_newton;
    s->mech = full_newton ? &s->whole : mech;
    s->stats = stats;
    if (!full_newton) return make_step(s, t, end, alpha, beta, h, kept, x, kappa);
    own->input = given->input;
    own->calls = given->calls;
    const int status = make_step(s, t, end, alpha, beta, h, kept, x, kappa);
    given->calls = own->calls;
    mech->error = s->whole.error;
    return status;
}
