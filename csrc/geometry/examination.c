/* A system examined at one state: its derivatives, the rank of mu = phi_v, whether M =
 * L_vv is positive definite, and whether D is involutive.
 *
 * Eigenvalues and singular values are those of products with the Cholesky factor L of M = L L^T:
 * of M on R^n the squares of those of L, of M on ker mu those of X L with the rows of X an
 * orthonormal basis, of mu in the mass metric those of mu L^-T.  An M that is not positive definite
 * is made so by a multiple of the identity, which is subtracted from the eigenvalues again. */
#include "geometry/geometry.h"

#include <gsl/gsl_linalg.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

/* A derivative may be off by this much, relative to 1 + its size.  The differences are far better,
 * unless the function oscillates within 1/80 of the unit of q; then smaller ones are taken. */
static const double derivative_tolerance = 1e-7;

/* Errors of roundoff in sums of terms that were computed in a few operations. */
static const double sum_tolerance = 1e-12;

/* Curvature that comes from roundoff and differences, relative to the terms that cancel, and as
 * 1/length. */
static const double curvature_tolerance = 1e-8, curvature_floor = 1e-10;

typedef enum callback { POTENTIAL, LAGRANGIAN, FORCE, CONSTRAINT } callback;

/* What callbacks give: values, and derivatives in the order in which findings are reported.  Phi is
 * mu v where the constraints are linear. */
enum { V, L, F, PHI, V_Q, V_QQ, L_Q, L_V, L_QQ, L_VQ, L_VV, L_VT, F_Q, F_V, PHI_V, PHI_Q, PHI_T,
       OUTPUTS };

typedef struct output {
    const char *name;
    callback callback;
    size_t of;        /* of a derivative: what it is the derivative of, and by what */
    dal__moves moves;
    unsigned missing; /* the flag of a definition that it is not given */
    size_t found;     /* where in a dal_check its dal_difference stands; 0: it is a value */
} output;

static const output outputs[OUTPUTS] = {
    [V] = {.name = "V", .callback = POTENTIAL},
    [L] = {.name = "L", .callback = LAGRANGIAN},
    [F] = {.name = "f", .callback = FORCE},
    [PHI] = {.name = "phi", .callback = CONSTRAINT},
    [V_Q] = {"V_q", POTENTIAL, V, MOVES_Q, DAL_MISSING_V_Q, offsetof(dal_check, V_q)},
    [V_QQ] = {"V_qq", POTENTIAL, V_Q, MOVES_Q, DAL_MISSING_V_QQ, offsetof(dal_check, V_qq)},
    [L_Q] = {"L_q", LAGRANGIAN, L, MOVES_Q, 0, offsetof(dal_check, L_q)},
    [L_V] = {"L_v", LAGRANGIAN, L, MOVES_V, 0, offsetof(dal_check, L_v)},
    [L_QQ] = {"L_qq", LAGRANGIAN, L_Q, MOVES_Q, DAL_MISSING_L_QQ, offsetof(dal_check, L_qq)},
    [L_VQ] = {"L_vq", LAGRANGIAN, L_V, MOVES_Q, DAL_MISSING_L_VQ, offsetof(dal_check, L_vq)},
    [L_VV] = {"L_vv", LAGRANGIAN, L_V, MOVES_V, DAL_MISSING_L_VV, offsetof(dal_check, L_vv)},
    [L_VT] = {"L_vt", LAGRANGIAN, L_V, MOVES_T, DAL_MISSING_L_VT, offsetof(dal_check, L_vt)},
    [F_Q] = {"f_q", FORCE, F, MOVES_Q, DAL_MISSING_F_Q, offsetof(dal_check, f_q)},
    [F_V] = {"f_v", FORCE, F, MOVES_V, DAL_MISSING_F_V, offsetof(dal_check, f_v)},
    [PHI_V] = {"phi_v", CONSTRAINT, PHI, MOVES_V, 0, offsetof(dal_check, phi_v)},
    [PHI_Q] = {"phi_q", CONSTRAINT, PHI, MOVES_Q, DAL_MISSING_PHI_Q, offsetof(dal_check, phi_q)},
    [PHI_T] = {"phi_t", CONSTRAINT, PHI, MOVES_T, DAL_MISSING_PHI_T, offsetof(dal_check, phi_t)},
};

/* An entry of a derivative, and what the last distance said of it. */
typedef struct entry {
    dal_difference found;
    double before, gap_before, best; /* slope and kink; how well two slopes have agreed */
    bool settled;
} entry;

typedef struct examination {
    dal_mechanics mech;
    const dal_system *system;
    const double *x, *q, *v;      /* the state, and its halves */
    size_t n, m;
    dal_check found;
    double *point, *other;        /* [n]: a moved q, and a velocity that is not in D */
    const double *velocity;       /* [n], and the time: where what is differenced stands */
    double t, time;               /* the time of the state comes first */
    const output *judged;         /* the derivative that is compared with differences */
    double *given[OUTPUTS];       /* as the callbacks give them */
    double *value, *slope;        /* [n] scratch of the differences */
    double *bend, *height, least; /* [n] how far slopes on both sides differ; the largest values */
    entry *entries;               /* [n] of a column */
    const char *unjudged;         /* a derivative that differences do not tell, or NULL */
    double *later[OUTPUTS];       /* and at another time; only some are there */
    double *forms;                /* [m*n] */
    double *phi;                  /* [m] */
    double *factor, lift;         /* [n*n] L of M + lift times the identity */
    double *rows, *squares;       /* [n*n], [n]: whose singular values are sought */
    double *QR, *tau;             /* [n*m], [m]: mu^T = Q R */
    double *X;                    /* [(n-m)*n] rows: an orthonormal basis of ker mu */
    double *N;                    /* [(n-m)*m*n] N(q, X_k) = d(mu X_k)/dq */
} examination;

/* Where the first thing that is wrong is said; NULL after that. */
static dal_error *open_finding(examination *ex)
{
    return ex->found.finding.text[0] ? NULL : &ex->found.finding;
}

/* ---- derivatives ------------------------------------------------------------------------- */

/* y <- the outputs of a callback that are not NULL there. */
static int call(examination *ex, callback callback, double t, const double *q, const double *v,
                double *const y[OUTPUTS])
{
    evaluator *const e = &ex->mech.eval;
    dal_error *const error = &ex->mech.error;
    const dal__jet jet = {y[L], y[L_Q], y[L_V], y[L_QQ], y[L_VQ], y[L_VV], y[L_VT]};
    switch (callback) {
    case POTENTIAL: return dal__potential(e, t, q, y[V], y[V_Q], y[V_QQ], error);
    case LAGRANGIAN: return dal__lagrangian(e, t, q, v, &jet, error);
    case FORCE: return dal__force(e, t, q, v, y[F], y[F_Q], y[F_V], error);
    default: return dal__constraint(e, t, q, v, y[PHI], y[PHI_V], y[PHI_Q], y[PHI_T], error);
    }
}

/* What is differenced, with the one of t, q and v that moves. */
static int call_moved(const double *moved, double *value, void *ctx)
{
    examination *const ex = ctx;
    const output *const d = ex->judged;
    double *y[OUTPUTS] = {0};
    y[d->of] = value;
    return call(ex, d->callback, d->moves == MOVES_T ? *moved : ex->time,
                d->moves == MOVES_Q ? moved : ex->q, d->moves == MOVES_V ? moved : ex->velocity, y);
}

/* How many numbers an output is, or rows of a derivative of it. */
static size_t rows_of(const examination *ex, size_t output)
{
    return output == V || output == L ? 1 : output == PHI ? ex->m : ex->n;
}

/* slope <- differences by component j of the point, of order 4, over a distance d; bend <- the
 * slope ahead minus that behind, of order 1; height <- the largest of the values. */
static int difference(examination *ex, size_t j, size_t rows, double d)
{
    static const int offsets[5] = {0, 1, -1, 2, -2};
    static const double weights[5] = {0.0, 8.0, -8.0, -1.0, 1.0};
    static const double bends[5] = {-2.0, 1.0, 1.0, 0.0, 0.0};
    const double centre = ex->point[j];
    int status = DAL_SUCCESS;
    for (size_t i = 0; i < rows; i++) {
        ex->slope[i] = ex->bend[i] = 0.0;
        ex->height[i] = ex->least;
    }
    for (int k = 0; k < 5 && !status; k++) {
        ex->point[j] = centre + offsets[k] * d;
        status = call_moved(ex->point, ex->value, ex);
        for (size_t i = 0; i < rows && !status; i++) {
            if (!isfinite(ex->value[i])) status = DAL_EDOMAIN;
            ex->slope[i] += weights[k] * ex->value[i] / (12.0 * d);
            ex->bend[i] += bends[k] * ex->value[i] / d;
            ex->height[i] = fmax(ex->height[i], fabs(ex->value[i]));
        }
    }
    ex->point[j] = centre;
    return status;
}

/* The worst finding is a wrong entry, and of these, or if there is none, the one that is off
 * most. */
static void keep_worst(dal_difference *worst, const dal_difference *found)
{
    const size_t unjudged = worst->unjudged;
    if (!worst->checked || found->wrong > worst->wrong
        || (found->wrong == worst->wrong && found->error > worst->error)) *worst = *found;
    worst->unjudged = unjudged;
}

/* Whether entry e of a derivative agrees with its differences over the distance d: with the first
 * of them up to their roundoff, or with any that have hardly any.  It is wrong if they converge to
 * something else: two that follow each other agree far better with each other than with it.  At a
 * kink, where the slopes on both sides do not get closer with d, it may be either of these.  Where
 * differences do not converge, or leave the domain, there is nothing to judge by. */
static bool agrees(const examination *ex, entry *e, double d, bool first)
{
    const size_t i = e->found.row;
    const double here = ex->slope[i], gap = fabs(ex->bend[i]), far = fabs(e->found.given - here);
    const double rounding = 32.0 * DAL_ROUNDOFF * ex->height[i] / d;
    const double allowed = derivative_tolerance * (1.0 + fabs(here));
    const double change = fabs(here - e->before) + rounding;
    const bool is_right = first ? far <= allowed + rounding
                                : far <= allowed && rounding <= 0.1 * allowed;
    const bool is_kink = gap > 0.5 * e->gap_before + allowed + rounding && gap > far;
    const bool is_off = !is_right && !is_kink && far > 4.0 * change
                     && change < e->best && e->best > 0.1 * allowed;
    if (is_right || is_off) {
        e->best = change;
        e->found.expected = here;
        e->found.error = far / (1.0 + fabs(here));
        e->found.wrong = is_off;
        e->found.unjudged = 0;
    }
    e->before = here;
    e->gap_before = gap;
    return is_right;
}

/* The entries of column j of the matrix given[rows*columns] against differences over smaller and
 * smaller distances. */
static int examine_column(examination *ex, const double *given, size_t j, size_t columns,
                          size_t rows)
{
    enum { DISTANCES = 14 };
    double d = dal__spacing(ex->point[j]);
    bool any = true;
    for (size_t i = 0; i < rows; i++)
        ex->entries[i] = (entry){.before = (double)NAN, .gap_before = (double)NAN,
                                 .best = (double)INFINITY,
                                 .found = {.given = given[i * columns + j], .row = i, .column = j,
                                           .checked = 1, .unjudged = 1}};
    for (int k = 0; k < DISTANCES && any; k++, d /= 8.0) {
        if (d <= 16.0 * DAL_ROUNDOFF * fabs(ex->point[j])) break;
        const int status = difference(ex, j, rows, d);
        if (status == DAL_EDOMAIN) continue;
        if (status) return status;
        any = false;
        for (entry *e = ex->entries; e < ex->entries + rows; e++) {
            if (!e->settled) e->settled = agrees(ex, e, d, k == 0);
            any = any || !e->settled;
        }
    }
    return DAL_SUCCESS;
}

static dal_difference *difference_of(examination *ex, const output *d)
{
    return (dal_difference *)((char *)&ex->found + d->found);
}

/* Values that are differenced are known to a few roundings of this, even if they are smaller: a
 * differenced gradient has lost the spacing's worth of digits before, and the terms of phi may
 * cancel. */
static double least_height(const examination *ex, const output *d)
{
    if (d->of == V_Q && ex->system->def.missing & DAL_MISSING_V_Q)
        return 0x1p12 * fabs(*ex->given[V]);
    if (d->of != PHI) return 0.0;
    return dal__largest(ex->n, ex->velocity) * dal__largest(ex->m * ex->n, ex->given[PHI_V]);
}

/* The matrix given[rows*n], or [rows] in time, against differences. */
static int compare(examination *ex, const output *d, const double *given)
{
    const double *const centre = d->moves == MOVES_T ? &ex->time
                               : d->moves == MOVES_V ? ex->velocity : ex->q;
    const size_t columns = d->moves == MOVES_T ? 1 : ex->n, rows = rows_of(ex, d->of);
    dal_difference *const worst = difference_of(ex, d);
    ex->judged = d;
    ex->least = least_height(ex, d);
    dal__copy(columns, centre, ex->point);
    for (size_t j = 0; j < columns; j++) {
        const int status = examine_column(ex, given, j, columns, rows);
        if (status) return status;
        for (const entry *e = ex->entries; e < ex->entries + rows; e++)
            if (e->found.unjudged) worst->unjudged++;
            else keep_worst(worst, &e->found);
    }
    return DAL_SUCCESS;
}

static void judge(examination *ex, const output *d)
{
    static const char *const by[] = {[MOVES_Q] = "q", [MOVES_V] = "v", [MOVES_T] = "t"};
    const dal_difference *const worst = difference_of(ex, d);
    const bool is_product = d->of == PHI && ex->system->def.kind == DAL_LINEAR;
    if (worst->unjudged && !ex->unjudged) ex->unjudged = d->name;
    if (!worst->wrong) return;
    const dal__entry entry = {NULL, d->name, worst->row, worst->column, worst->given};
    dal__fail_entry(open_finding(ex), DAL_EINVAL, &entry, " is given as %.10g, but finite "
                    "differences of %s in %s give %.10g (error %.1e)", worst->given,
                    is_product ? "phi_v v" : outputs[d->of].name, by[d->moves], worst->expected,
                    worst->error);
}

/* phi_v of linear constraints is what there is: nothing to compare it with. */
static bool is_compared(const examination *ex, const output *d)
{
    const dal_system_def *const def = &ex->system->def;
    return d->found && !(def->missing & d->missing) && (d->moves != MOVES_T || def->time_dependent)
        && (d != &outputs[PHI_V] || def->kind != DAL_LINEAR);
}

/* What depends on v is examined at two velocities, because at the given one, which may be 0, it may
 * vanish altogether.  The other one was not asked for, so what is not defined there is passed over.
 * Each has a time of its own, for what vanishes at time 0. */
enum { VELOCITIES = 2 };

static void stand_at(examination *ex, int k)
{
    ex->velocity = k == 0 ? ex->v : ex->other;
    ex->time = ex->t + k;
}

static bool passed_over(int k, int status) { return k > 0 && status == DAL_EDOMAIN; }

/* All derivatives that a callback gives.  Linear and affine constraints are defined for every v. */
static int examine_derivatives(examination *ex, callback of)
{
    const bool partial = of != CONSTRAINT || ex->system->def.kind == DAL_NONLINEAR;
    double *y[OUTPUTS];
    for (size_t k = 0; k < OUTPUTS; k++) /* what is missing is not asked for, */
        y[k] = ex->system->def.missing & outputs[k].missing ? NULL : ex->given[k];
    y[V_Q] = ex->given[V_Q]; /* but for the values that V_qq is compared with */
    for (int k = 0; k < (of == POTENTIAL ? 1 : VELOCITIES); k++) {
        stand_at(ex, k);
        int status = call(ex, of, ex->time, ex->q, ex->velocity, y);
        for (size_t i = 0; !status && i < OUTPUTS; i++)
            if (outputs[i].callback == of && is_compared(ex, &outputs[i]))
                status = compare(ex, &outputs[i], y[i]);
        if (status && !(partial && passed_over(k, status))) return status;
    }
    for (size_t i = 0; i < OUTPUTS; i++)
        if (outputs[i].callback == of && outputs[i].found) judge(ex, &outputs[i]);
    return DAL_SUCCESS;
}

/* A derivative phi_q that is not given is 0 in the entries that a sparsity leaves out, or steps
 * would difference some columns for others. */
static int examine_sparsity(examination *ex)
{
    const dal_system_def *const def = &ex->system->def;
    const output *const d = &outputs[PHI_Q];
    dal_difference *const worst = difference_of(ex, d);
    if (!def->sparsity || !(def->missing & d->missing)) return DAL_SUCCESS;
    for (int k = 0; k < VELOCITIES; k++) {
        double *const y[OUTPUTS] = {[PHI_V] = ex->given[PHI_V], [PHI_Q] = ex->given[PHI_Q]};
        const size_t *row = def->sparsity->row, *column = def->sparsity->column;
        const size_t *const end = row + def->sparsity->entries;
        stand_at(ex, k);
        int status = call(ex, CONSTRAINT, ex->time, ex->q, ex->velocity, y);
        for (size_t i = 0; !status && i < ex->m * ex->n; i++) {
            const bool is_there = row < end && *row * ex->n + *column == i;
            if (is_there) row++, column++;
            else y[PHI_Q][i] = 0.0;
        }
        if (!status) status = compare(ex, d, y[PHI_Q]);
        if (status && !(def->kind == DAL_NONLINEAR && passed_over(k, status))) return status;
    }
    if (worst->wrong)
        dal__fail(open_finding(ex), DAL_EINVAL, "sparsity: entry (%zu, %zu) is missing, but finite "
                  "differences of %s in q give %.10g", worst->row, worst->column,
                  def->kind == DAL_LINEAR ? "phi_v v" : "phi", worst->expected);
    else *worst = (dal_difference){0}; /* nothing was given */
    return DAL_SUCCESS;
}

/* ---- time -------------------------------------------------------------------------------- */

/* L and phi with what y asks for, at the velocity where the examination stands. */
static int call_both(examination *ex, double t, double *const y[OUTPUTS])
{
    const int status = call(ex, LAGRANGIAN, t, ex->q, ex->velocity, y);
    return status ? status : call(ex, CONSTRAINT, t, ex->q, ex->velocity, y);
}

/* What does not depend on time gives the same bits at another one, which is the period of nothing.
 * What is not defined there is passed over; second derivatives follow the first. */
static int examine_time(examination *ex)
{
    static const double after = 0.6180339887498949;
    static const size_t told[] = {PHI, PHI_V, L, L_Q, L_V};
    const size_t n = ex->n, m = ex->m, counts[] = {m, m * n, 1, n, n};
    double *now[OUTPUTS] = {0};
    for (size_t i = 0; i < DAL_LENGTH(told); i++) now[told[i]] = ex->given[told[i]];
    for (int k = 0; k < VELOCITIES && !ex->system->def.time_dependent; k++) {
        const char *which = NULL;
        stand_at(ex, k);
        int status = call_both(ex, ex->time, now);
        if (!status) status = call_both(ex, ex->time + after, ex->later);
        if (status == DAL_EDOMAIN) continue;
        if (status) return status;
        for (size_t i = 0; i < DAL_LENGTH(told); i++)
            if (dal__largest_difference(counts[i], now[told[i]], ex->later[told[i]]) > 0.0)
                which = outputs[told[i]].callback == CONSTRAINT ? "constraint"
                      : ex->system->mass ? "potential" : "lagrangian";
        if (which)
            dal__fail(open_finding(ex), DAL_EINVAL, "%s returns different numbers at t = %g and t "
                      "= %g: declare the system time_dependent", which, ex->time + after,
                      ex->time);
    }
    return DAL_SUCCESS;
}

/* ---- linearity --------------------------------------------------------------------------- */

/* phi[m] and mu[m*n] at q and v; either may be NULL. */
static int constraint_at(examination *ex, const double *q, const double *v, double *phi, double *mu)
{
    return dal__constraint(&ex->mech.eval, ex->t, q, v, phi, mu, NULL, NULL, &ex->mech.error);
}

/* The change of mu from one velocity to the other, which must vanish unless the constraints are
 * nonlinear.  Leaves mu in the forms of mech. */
static int compare_forms(examination *ex)
{
    const size_t n = ex->n, m = ex->m;
    const double *const mu = ex->mech.forms.mu;
    const bool nonlinear = ex->system->def.kind == DAL_NONLINEAR;
    int status = constraint_at(ex, ex->q, ex->v, NULL, ex->mech.forms.mu);
    if (status) return status;
    status = constraint_at(ex, ex->q, ex->other, NULL, ex->forms);
    if (nonlinear && passed_over(1, status)) return DAL_SUCCESS;
    if (status) return status;
    ex->found.linearity = 0.0;
    for (size_t k = 0; k < m * n; k++) {
        const double change = fabs(ex->forms[k] - mu[k]);
        const dal__entry entry = {NULL, "phi_v", k / n, k % n, mu[k]};
        if (!nonlinear && change > sum_tolerance * fabs(mu[k]))
            dal__fail_entry(open_finding(ex), DAL_EINVAL, &entry, " is %.10g at v and %.10g at "
                            "another velocity: mu must not depend on v unless the constraints are "
                            "declared nonlinear", mu[k], ex->forms[k]);
        ex->found.linearity = fmax(ex->found.linearity, change);
    }
    return DAL_SUCCESS;
}

/* *sum <- mu^a v, *scale <- the sum of the absolute values of its terms. */
static void weigh(const examination *ex, size_t a, const double *v, double *sum, double *scale)
{
    *sum = *scale = 0.0;
    for (size_t i = 0; i < ex->n; i++) {
        const double term = ex->mech.forms.mu[a * ex->n + i] * v[i];
        *sum += term;
        *scale += fabs(term);
    }
}

/* phi of linear constraints, where the callback gives it, is mu v. */
static int examine_linear(examination *ex)
{
    dal__forget(ex->m, ex->phi);
    const int returned = dal__call_constraint(&ex->mech.eval, ex->t, ex->q, ex->other, ex->phi,
                                              ex->forms, NULL, NULL);
    if (returned)
        return dal__fail(&ex->mech.error, dal__callback_status(returned), "constraint returned %d "
                         "when called for phi", returned);
    for (size_t a = 0; a < ex->m; a++) {
        double sum, scale;
        weigh(ex, a, ex->other, &sum, &scale);
        if (isfinite(ex->phi[a]) && fabs(ex->phi[a] - sum) > sum_tolerance * scale)
            dal__fail(open_finding(ex), DAL_EINVAL, "phi[%zu] is given as %.10g, but phi_v v is "
                      "%.10g: expected phi = mu v for linear constraints", a, ex->phi[a], sum);
    }
    return DAL_SUCCESS;
}

/* a = phi - mu v of affine constraints is the same at both velocities. */
static int examine_affine(examination *ex)
{
    int status = constraint_at(ex, ex->q, ex->v, ex->phi, NULL);
    if (!status) status = constraint_at(ex, ex->q, ex->other, ex->value, NULL);
    for (size_t a = 0; !status && a < ex->m; a++) {
        double here, there, scale_here, scale_there;
        weigh(ex, a, ex->v, &here, &scale_here);
        weigh(ex, a, ex->other, &there, &scale_there);
        const double scale = fabs(ex->phi[a]) + fabs(ex->value[a]) + scale_here + scale_there;
        here = ex->phi[a] - here;
        there = ex->value[a] - there;
        if (fabs(there - here) > sum_tolerance * scale)
            dal__fail(open_finding(ex), DAL_EINVAL, "phi[%zu] - (phi_v v)[%zu] is %.10g at v and "
                      "%.10g at another velocity: the affine term must not depend on v", a, a, here,
                      there);
    }
    return status;
}

static int examine_linearity(examination *ex)
{
    const dal_constraint_kind kind = ex->system->def.kind;
    const int status = compare_forms(ex);
    if (status || kind == DAL_NONLINEAR) return status;
    return kind == DAL_LINEAR ? examine_linear(ex) : examine_affine(ex);
}

/* ---- rank and definiteness --------------------------------------------------------------- */

/* INFINITY of nothing. */
static double smallest(size_t count, const double *x)
{
    double least = (double)INFINITY;
    for (size_t i = 0; i < count; i++) least = fmin(least, x[i]);
    return least;
}

/* The smallest eigenvalue of A A^T; destroys A[count*n]. */
static double smallest_eigenvalue(examination *ex, size_t count, double *A)
{
    const double unit = dal__singular_values(count, ex->n, A, ex->squares);
    const double least = smallest(count, ex->squares);
    return count > 0 ? unit * unit * least : least;
}

static int examine_mass(examination *ex)
{
    const size_t n = ex->n;
    double *const factor = ex->factor, *const M = ex->given[L_VV], *y[OUTPUTS] = {[L_VV] = M};
    const int status = call(ex, LAGRANGIAN, ex->t, ex->q, ex->v, y);
    if (status) return status;
    dal__copy(n * n, M, factor);
    /* always, of constant mass */
    const bool definite = dal__cholesky(n, factor, ex->squares, NULL, NULL);
    if (!definite) { /* no eigenvalue is larger than n times the largest entry */
        ex->lift = 2.0 * (double)n * fmax(dal__largest(n * n, M), DBL_MIN);
        dal__copy(n * n, M, factor);
        for (size_t i = 0; i < n; i++) factor[i * n + i] += ex->lift;
        dal__cholesky(n, factor, ex->squares, NULL, NULL);
    }
    dal__copy(n * n, factor, ex->rows);
    ex->found.mass_min = smallest_eigenvalue(ex, n, ex->rows) - ex->lift;
    if (!definite)
        dal__fail(open_finding(ex), DAL_EINVAL, "L_vv is not positive definite: its smallest "
                  "eigenvalue is %g", ex->found.mass_min);
    return DAL_SUCCESS;
}

/* Rank of mu with rows whose largest entry is 1, so that constraints may have different units. */
static size_t rank_of(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t a = 0; a < m; a++) {
        const double *const form = mu + a * n;
        const double unit = dal__largest(n, form);
        for (size_t i = 0; i < n; i++) ex->rows[a * n + i] = unit > 0.0 ? form[i] / unit : 0.0;
    }
    dal__singular_values(m, n, ex->rows, ex->squares);
    const double least = 4.0 * (double)n * DBL_EPSILON * sqrt(dal__largest(m, ex->squares));
    size_t rank = 0;
    for (size_t a = 0; a < m; a++) rank += sqrt(ex->squares[a]) > least;
    return rank;
}

/* Condition of mu L^-T, whose rows are y = L^-1 mu^a. */
static double condition_of(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t a = 0; a < m; a++) {
        double *const y = ex->rows + a * n;
        for (size_t i = 0; i < n; i++)
            y[i] = (mu[a * n + i] - dal__dot(i, ex->factor + i * n, y)) / ex->factor[i * n + i];
    }
    dal__singular_values(m, n, ex->rows, ex->squares);
    const double least = smallest(m, ex->squares);
    return least > 0.0 ? sqrt(dal__largest(m, ex->squares) / least) : (double)INFINITY;
}

/* X and R from mu^T = Q R: the columns of Q after the first m are orthogonal to the forms. */
static void split(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t i = 0; i < n; i++)
        for (size_t a = 0; a < m; a++) ex->QR[i * m + a] = mu[a * n + i];
    gsl_matrix_view QR = gsl_matrix_view_array(ex->QR, n, m);
    gsl_vector_view tau = gsl_vector_view_array(ex->tau, m);
    gsl_linalg_QR_decomp(&QR.matrix, &tau.vector);
    dal__clear((n - m) * n, ex->X);
    for (size_t k = 0; k < n - m; k++) {
        double *const x = ex->X + k * n;
        gsl_vector_view column = gsl_vector_view_array(x, n);
        x[m + k] = 1.0;
        gsl_linalg_QR_Qvec(&QR.matrix, &tau.vector, &column.vector);
    }
}

/* The smallest eigenvalue of X M X^T = (X L)(X L)^T - lift X X^T. */
static double kernel_min(examination *ex)
{
    const size_t n = ex->n, count = ex->n - ex->m;
    for (size_t k = 0; k < count; k++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0.0; /* L is lower triangular */
            for (size_t i = j; i < n; i++) sum += ex->X[k * n + i] * ex->factor[i * n + j];
            ex->rows[k * n + j] = sum;
        }
    return smallest_eigenvalue(ex, count, ex->rows) - ex->lift;
}

/* In the metric of M, if it is one. */
static void name_dependent(examination *ex, dal_error *finding)
{
    dal_mechanics *const mech = &ex->mech;
    const double *Z = mech->forms.mu;
    if (ex->lift == 0.0 && !dal__build_metric(mech, ex->t, ex->q, ex->v)) {
        dal__build_Z(mech, mech->forms.mu);
        Z = mech->gram.Z;
    }
    dal__name_dependent(mech, mech->forms.mu, Z, dal__rank_lost(mech), finding);
}

/* Of the forms of mech.  Also asks for lambda: C, which all schemes invert, squares the condition
 * of mu. */
static int examine_rank(examination *ex)
{
    dal_mechanics *const mech = &ex->mech;
    dal_check *const found = &ex->found;
    found->rank = rank_of(ex, mech->forms.mu);
    if (ex->lift == 0.0) found->condition = condition_of(ex, mech->forms.mu);
    if (found->rank < ex->m) {
        const bool nonlinear = ex->system->def.kind == DAL_NONLINEAR;
        dal_error *const finding = open_finding(ex);
        dal__fail(finding, DAL_EINVAL, nonlinear ? "phi_v has rank %zu instead of %zu at this "
                  "velocity" : "mu has rank %zu instead of %zu", found->rank, ex->m);
        name_dependent(ex, finding);
        if (finding && nonlinear)
            dal__add_words(finding, "; a constraint quadratic in v, for example, has phi_v = 0 at "
                           "rest");
        return DAL_SUCCESS;
    }
    split(ex, mech->forms.mu);
    found->kernel_min = kernel_min(ex);
    if (!(found->mass_min > 0.0 && found->kernel_min > 0.0))
        dal__fail(open_finding(ex), DAL_EINVAL, "M is not positive definite on ker mu: its "
                  "smallest eigenvalue there is %g", found->kernel_min);
    const int status = dal_multipliers(mech, ex->t, ex->x, mech->lambda);
    if (status != DAL_ESINGULAR) return status;
    dal_error *const finding = open_finding(ex);
    dal__fail(finding, DAL_EINVAL, "mu M^-1 mu^T is singular to working precision: the condition "
              "of mu is %.3g", found->condition);
    name_dependent(ex, finding);
    return DAL_SUCCESS;
}

/* ---- involutivity ------------------------------------------------------------------------ */

/* The length of the vector orthogonal to D that mu maps to r: that of R^-T r; destroys r[m]. */
static double length_across(const examination *ex, double *r)
{
    const size_t m = ex->m;
    const double *const R = ex->QR;
    double square = 0.0;
    for (size_t a = 0; a < m; a++) {
        for (size_t b = 0; b < a; b++) r[a] -= R[b * m + a] * r[b];
        r[a] /= R[a * m + a];
        square += r[a] * r[a];
    }
    return sqrt(square);
}

/* Vector fields X, Y in D have mu [X, Y] = N(q,X) Y - N(q,Y) X.  *curvature <- the length of [X, Y]
 * across D, the largest over the basis; *scale <- that of its two terms, the largest.  Neither
 * depends on how mu is scaled or combined. */
static int examine_curvature(examination *ex, const double *q, double *curvature, double *scale)
{
    dal_mechanics *const mech = &ex->mech;
    const size_t n = ex->n, m = ex->m, count = n - m;
    int status = constraint_at(ex, q, ex->v, NULL, mech->forms.mu);
    if (status) return status;
    split(ex, mech->forms.mu);
    for (size_t k = 0; k < count && !status; k++)
        status = dal__constraint(&mech->eval, ex->t, q, ex->X + k * n, NULL, NULL,
                                 ex->N + k * m * n, NULL, &mech->error);
    if (status) return status;
    double *const here = ex->value, *const there = ex->slope, *const bracket = ex->phi;
    *curvature = *scale = 0.0;
    for (size_t k = 0; k < count; k++)
        for (size_t l = 0; l < k; l++) {
            dal__apply(m, n, ex->N + k * m * n, ex->X + l * n, here);
            dal__apply(m, n, ex->N + l * m * n, ex->X + k * n, there);
            dal__move(m, here, -1.0, there, bracket);
            *curvature = fmax(*curvature, length_across(ex, bracket));
            *scale = fmax(*scale, fmax(length_across(ex, here), length_across(ex, there)));
        }
    return DAL_SUCCESS;
}

static bool is_flat(double curvature, double scale)
{
    return curvature <= curvature_tolerance * scale + curvature_floor;
}

/* The curvature may vanish at a single point; so D counts as integrable only if that is so at some
 * points nearby as well, as far as they are in the domain of the constraint. */
static int examine_involutivity(examination *ex)
{
    enum { NEARBY = 4 };
    double scale;
    if (ex->n - ex->m == 1) { /* a single field commutes with itself */
        ex->found.curvature = 0.0;
        ex->found.integrable = 1;
        return DAL_SUCCESS;
    }
    int status = examine_curvature(ex, ex->q, &ex->found.curvature, &scale);
    if (status) return status;
    bool flat = is_flat(ex->found.curvature, scale);
    for (int k = 1; k <= NEARBY && flat; k++) {
        double curvature;
        for (size_t i = 0; i < ex->n; i++)
            ex->point[i] = ex->q[i] + 0.1 * (1.0 + fabs(ex->q[i])) * cos((double)(i + 1) * k);
        status = examine_curvature(ex, ex->point, &curvature, &scale);
        if (status == DAL_EDOMAIN) continue;
        if (status) return status;
        flat = is_flat(curvature, scale);
    }
    ex->found.integrable = flat;
    return DAL_SUCCESS;
}

/* ---- the report -------------------------------------------------------------------------- */

static int examine_constraint(examination *ex)
{
    dal_check *const found = &ex->found;
    const bool linear = ex->system->def.kind == DAL_LINEAR;
    /* phi_q of linear constraints is that of phi_v v, so phi_v comes first */
    int status = linear ? examine_linearity(ex) : examine_derivatives(ex, CONSTRAINT);
    if (!status) status = linear ? examine_derivatives(ex, CONSTRAINT) : examine_linearity(ex);
    if (!status) status = examine_sparsity(ex);
    if (!status) status = examine_rank(ex);
    bool consistent = true;
    /* where no inputs are given they are 0 */
    if (ex->system->def.driven) dal__clear(ex->system->def.inputs, ex->mech.eval.own_input);
    if (!status && found->mass_min > 0.0) /* else there is no metric to measure in */
        status = dal__lies_in_D(&ex->mech, ex->t, 0.0, ex->x, &found->residual, &consistent);
    if (!status && linear && !ex->system->def.driven && found->rank == ex->m)
        status = examine_involutivity(ex);
    if (!status && !consistent)
        dal__fail(open_finding(ex), DAL_EINVAL, "(q, v) violates the constraint%s: relative "
                  "residual %.3g, allowed %g", ex->system->def.driven ? " with inputs 0" : "",
                  found->residual, DAL_CONSISTENT);
    return status;
}

/* Without constraints D is all of TQ. */
static void examine_no_constraint(examination *ex)
{
    ex->found.kernel_min = ex->found.mass_min;
    ex->found.linearity = ex->found.residual = ex->found.curvature = 0.0;
    ex->found.condition = 1.0;
    ex->found.integrable = 1;
}

static void summarize(const examination *ex, dal_error *summary)
{
    char agree[160], shape[128];
    const dal_check *const found = &ex->found;
    snprintf(agree, sizeof agree, "the given derivatives agree with finite differences%s%s%s",
             ex->unjudged ? " (not judged everywhere: " : "", ex->unjudged ? ex->unjudged : "",
             ex->unjudged ? ")" : "");
    if (ex->m == 0) {
        dal__fail(summary, DAL_SUCCESS, "%s; no constraints", agree);
        return;
    }
    if (ex->system->def.driven && ex->system->def.kind == DAL_LINEAR)
        snprintf(shape, sizeof shape, "D changes with the inputs");
    else if (ex->system->def.kind != DAL_LINEAR)
        snprintf(shape, sizeof shape, "the constraints are %s in v%s",
                 ex->system->def.kind == DAL_AFFINE ? "affine" : "nonlinear", ex->n == ex->m
                 ? ", one for each coordinate: they prescribe the velocity" : "");
    else if (ex->n == ex->m)
        snprintf(shape, sizeof shape, "D has dimension 0: the system cannot move");
    else if (ex->n - ex->m == 1)
        snprintf(shape, sizeof shape, "D has dimension 1, which is always integrable");
    else if (found->integrable)
        snprintf(shape, sizeof shape, "D is integrable here and nearby: the constraints may be "
                 "holonomic");
    else
        snprintf(shape, sizeof shape, "D is not integrable: its curvature here is %.3g",
                 found->curvature);
    dal__fail(summary, DAL_SUCCESS, "%s; mu has rank %zu and condition %.3g; (q, v) satisfies the "
              "constraint to %.1e; %s", agree, found->rank, found->condition, found->residual,
              shape);
    summary->output = "D";
    summary->end = strlen(summary->text);
    summary->begin = summary->end - strlen(shape);
}

static void reserve(examination *ex, arena *a)
{
    const size_t n = ex->n, m = ex->m, nn = dal__times(n, n), mn = dal__times(m, n);
    ex->mech.eval.dense = true;
    dal__mechanics_reserve(&ex->mech, ex->system, a);
    for (size_t k = 0; k < OUTPUTS; k++)
        DAL__RESERVE(a, outputs[k].found ? dal__times(rows_of(ex, outputs[k].of), n)
                                         : rows_of(ex, k), &ex->given[k]);
    DAL__RESERVE(a, n, &ex->later[L], &ex->later[L_Q], &ex->later[L_V], &ex->later[PHI]);
    DAL__RESERVE(a, mn, &ex->later[PHI_V]);
    DAL__RESERVE(a, n, &ex->point, &ex->other, &ex->value, &ex->slope, &ex->bend, &ex->height,
                 &ex->squares);
    dal__reserve(a, &ex->entries, n, sizeof *ex->entries);
    DAL__RESERVE(a, m, &ex->phi, &ex->tau);
    DAL__RESERVE(a, mn, &ex->forms, &ex->QR);
    DAL__RESERVE(a, nn, &ex->factor, &ex->rows);
    DAL__RESERVE(a, dal__times(n - m, n), &ex->X);
    DAL__RESERVE(a, dal__times(n - m, mn), &ex->N);
}

/* A velocity in general position, of the size of v; and inputs, of the size 1. */
static void choose_other(examination *ex)
{
    const double size = 1.0 + dal__largest(ex->n, ex->v);
    double *const u = ex->mech.eval.own_input;
    for (size_t i = 0; i < ex->system->def.inputs; i++) u[i] = cos((double)(i + 1));
    for (size_t i = 0; i < ex->n; i++)
        ex->other[i] = ex->v[i] + size * (1.0 + 0.5 * sin((double)(i + 1)));
}

int dal_system_check(const dal_system *system, double t, const double *x, dal_check *report,
                     dal_error *error)
{
    int status = DAL__REQUIRE(error, {"system", system}, {"report", report});
    if (status) return status;
    const size_t n = system->def.n;
    status = DAL__REQUIRE_FINITE(error, {"x", 2 * n, x}, {"t", 1, &t});
    if (status) return status;
    examination ex = {.system = system, .t = t, .x = x, .q = x, .v = x + n, .n = n,
                      .m = system->def.m};
    dal_check *const found = &ex.found;
    arena memory = {0};
    reserve(&ex, &memory);
    status = dal__allocate(&memory, error);
    if (status) return status;
    dal__mechanics_bind(&ex.mech, system);
    choose_other(&ex);

    const double unknown = (double)NAN; /* stays where the examination does not come to an end */
    found->linearity = found->condition = found->mass_min = found->kernel_min = unknown;
    found->residual = found->curvature = unknown;
    status = examine_time(&ex);
    if (!status && !system->mass) status = examine_derivatives(&ex, LAGRANGIAN);
    if (!status) status = examine_mass(&ex);
    if (!status && system->def.potential) status = examine_derivatives(&ex, POTENTIAL);
    if (!status && system->def.force) status = examine_derivatives(&ex, FORCE);
    if (!status && ex.m == 0) examine_no_constraint(&ex);
    if (!status && ex.m > 0) status = examine_constraint(&ex);
    dal__fail_because(error, status, &ex.mech.error, "%s", "");
    if (status) found->finding = ex.mech.error;
    found->passed = !found->finding.text[0];
    if (found->passed) summarize(&ex, &found->finding);
    dal__release(&memory);
    if (status == DAL_SUCCESS || status == DAL_EDOMAIN) *report = *found;
    return status;
}
