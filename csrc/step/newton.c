/* One beta-step of any system by Newton on all unknowns (w, kappa).
 *
 * It does what kernel.h does not: a Lagrangian other than v^T M v / 2 - V, generalized forces,
 * affine and nonlinear constraints.  The matrix [[K, -mu_k^T], [B, 0]] is reduced to the m x m
 * Schur complement S = B K^-1 mu_k^T.  The guess is the last step, scaled by h; where that fails,
 * the state itself. */
#include "step/step.h"
#include "dalembert/lu.h"
#include "dalembert/residual.h"

#include <math.h>
#include <string.h>

void dal__newton_reserve(newton *solver, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m;
    const size_t nn = dal__times(n, n), mn = dal__times(m, n), mm = dal__times(m, m);
    double **const vectors[] = {&solver->rate, &solver->w, &solver->R1, &solver->y, &solver->step};
    double **const multipliers[] = {&solver->lambda, &solver->kappa, &solver->R2, &solver->r,
                                    &solver->d};
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve(a, &solver->x, dal__times(2, n), sizeof(double));
    dal__reserve(a, &solver->B, mn, sizeof(double));
    dal__reserve(a, &solver->KZ, mn, sizeof(double));
    dal__reserve(a, &solver->K, nn, sizeof(double));
    dal__reserve(a, &solver->K_sizes, dal__times(5, n), sizeof(double));
    dal__reserve(a, &solver->S, mm, sizeof(double));
    dal__reserve(a, &solver->S_sizes, dal__times(5, m), sizeof(double));
    dal__reserve(a, &solver->K_row, n, sizeof(size_t));
    dal__reserve(a, &solver->S_row, m, sizeof(size_t));
}

void dal__newton_bind(newton *solver, const dal_system *system, int max_iterations)
{
    solver->n = system->def.n;
    solver->m = system->def.m;
    solver->max_iterations = max_iterations;
}

void dal__newton_forget(newton *solver) { solver->warm = false; }

/* step and d <- the Newton step of w and kappa, from R1, R2, K, B and mech->muk; *sign <- that of
 * the determinant of the matrix. */
static int solve_linear(newton *s, dal_mechanics *mech, int *sign)
{
    const size_t n = s->n, m = s->m;
    for (size_t i = 0; i < n; i++) s->R1[i] = -s->R1[i];
    *sign = dal_lu_factor(n, s->K, s->K_sizes, s->K_row);
    if (*sign == 0)
        return dal__fail(&mech->error, DAL_ESINGULAR, "the derivative K of the equations of motion "
                         "in v' is singular: h is too large here");
    dal_lu_solve(n, s->K, s->K_row, s->R1, s->y);
    for (size_t a = 0; a < m; a++)
        dal_lu_solve(n, s->K, s->K_row, mech->muk + a * n, s->KZ + a * n);
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < m; b++)
            s->S[a * m + b] = dal__dot(n, s->B + a * n, s->KZ + b * n);
    for (size_t a = 0; a < m; a++) {
        s->S_sizes[a] = dal_residual_form(n, mech->unit, s->B + a * n);
        s->S_sizes[m + a] = dal_residual_speed(n, mech->per_unit, s->KZ + a * n);
    }
    *sign *= dal_lu_factor(m, s->S, s->S_sizes, s->S_row);
    if (*sign == 0)
        return dal__fail(&mech->error, DAL_ESINGULAR, "the Schur complement B K^-1 mu_k^T is "
                         "singular: the constraints lose rank, or h is too large here");
    for (size_t a = 0; a < m; a++) s->r[a] = -(s->R2[a] + dal__dot(n, s->B + a * n, s->y));
    dal_lu_solve(m, s->S, s->S_row, s->r, s->d);
    memcpy(s->step, s->y, n * sizeof *s->step);
    for (size_t a = 0; a < m; a++)
        for (size_t i = 0; i < n; i++) s->step[i] += s->KZ[a * n + i] * s->d[a];
    return DAL_SUCCESS;
}

/* From the guess in w and kappa to the solution.  A step that leaves the domain of a callback is
 * halved. */
static int iterate(newton *s, dal_mechanics *mech, dal_stats *stats)
{
    enum { HALVINGS = 40 };
    const size_t n = s->n, m = s->m;
    dal__progress p = {0};
    int halvings = 0;
    for (p.iteration = 1; p.iteration <= s->max_iterations; p.iteration++) {
        int status, sign = 1;
        while ((status = dal__step_at(mech, s->w, s->kappa, s->R1, s->R2, s->K, s->K_sizes, s->B))
                   == DAL_EDOMAIN && p.iteration > 1 && halvings++ < HALVINGS) {
            for (size_t i = 0; i < n; i++) s->w[i] -= s->step[i] *= 0.5;
            dal__newton_halve(&p);
            stats->halvings++;
        }
        if (!status) status = solve_linear(s, mech, &sign);
        if (status) return status;
        stats->iterations++;
        for (size_t i = 0; i < n; i++) s->w[i] += s->step[i];
        for (size_t a = 0; a < m; a++) s->kappa[a] += s->d[a];
        p.scale = dal_residual_extent(n, mech->per_unit, s->w) + dal__step_base(mech);
        p.extent = dal__sum_of_sizes(n, mech->q);
        const dal__verdict verdict =
            dal__newton_judge(&p, dal_residual_extent(n, mech->per_unit, s->step));
        if (sign < 0 && verdict != DAL__LOST)
            return dal__fail(&mech->error, DAL_ENOCONV, DAL__BRANCH_TEXT);
        if (verdict == DAL__DONE) return DAL_SUCCESS;
        if (verdict == DAL__LOST) break;
    }
    if (p.size <= DBL_MAX && p.iteration <= s->max_iterations)
        return dal__fail(&mech->error, DAL_ENOCONV, DAL__LOST_TEXT, p.travelled, p.first, p.scale);
    return dal__fail(&mech->error, DAL_ENOCONV, "Newton did not converge in %d iterations: last "
                     "change %.3g of %.3g; try a smaller h",
                     p.iteration - (p.size <= DBL_MAX), p.size, p.scale);
}

int dal__newton_step(newton *solver, dal_mechanics *mech, double t, double beta, double h,
                     bool kept, double *x, double *kappa, dal_stats *stats)
{
    newton *const s = solver;
    const size_t n = s->n, m = s->m;
    const double *const v = x + n;
    int status = dal__step_begin(mech, t, beta, h, kept, x);
    if (status) return status;
    bool solved = false;
    if (s->warm) {
        for (size_t i = 0; i < n; i++) s->w[i] = v[i] + h * s->rate[i];
        for (size_t a = 0; a < m; a++) s->kappa[a] = h * s->lambda[a];
        status = iterate(s, mech, stats);
        solved = status == DAL_SUCCESS;
        if (status == DAL_EUSER) return status;
        if (status) stats->full_newtons++;
    }
    if (!solved) {
        memcpy(s->w, v, n * sizeof *s->w);
        memset(s->kappa, 0, m * sizeof *s->kappa);
        status = iterate(s, mech, stats);
    }
    if (!status) status = dal__step_settle(mech, s->w, s->x, &stats->worst_residual);
    if (status) return status;
    for (size_t i = 0; i < n; i++) s->rate[i] = (s->w[i] - v[i]) / h;
    for (size_t a = 0; a < m; a++) s->lambda[a] = s->kappa[a] / h;
    s->warm = true;
    memcpy(x, s->x, 2 * n * sizeof *x);
    memcpy(kappa, s->kappa, m * sizeof *kappa);
    return DAL_SUCCESS;
}
