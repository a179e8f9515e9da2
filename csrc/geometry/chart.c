/* Charts of D: the Ehresmann connection A, psi and its derivative, the ODE, the
 * multipliers and the schemes in the coordinates xi = (q, v_independent).
 *
 * mu is phi_v, and B its dependent columns.  What is solved with B is the residual phi, so that D
 * is kept to roundoff and affine constraints need no formula of their own. */
#include "geometry/geometry.h"
#include "dalembert/residual.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* A choice by pivoting is left when no entry of A exceeds EXCHANGE in the units 1/sqrt(M_ii), which
 * bounds its condition by EXCHANGE sqrt(1 + m (n-m)); it is kept up to LIMIT sqrt(1 + m (n-m)). */
static const double EXCHANGE = 1.25, LIMIT = 10.0;

void dal__chart_reserve(dal_chart *chart, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m, twice = dal__times(2, n);
    const size_t thrice = dal__times(3, n), nn = dal__times(n, n), mn = dal__times(m, n);
    size_t **const places[] = {&chart->other_place, &chart->last_place, &chart->place,
                               &chart->former, &chart->owner};
    chart->mech.eval.dense = true;
    dal__mechanics_reserve(&chart->mech, system, a);
    DAL__RESERVE(a, n, &chart->w, &chart->R1, &chart->step);
    DAL__RESERVE(a, m, &chart->branch, &chart->right, &chart->solution, &chart->R2, &chart->kappa,
                 &chart->other_branch);
    DAL__RESERVE(a, nn, &chart->K);
    DAL__RESERVE(a, mn, &chart->A, &chart->slope);
    DAL__RESERVE(a, dal__times(m, twice), &chart->tableau);
    DAL__RESERVE(a, twice, &chart->x, &chart->y);
    DAL__RESERVE(a, thrice, &chart->first, &chart->second);
    dal__linear_reserve(&chart->B, m, a);
    dal__linear_reserve(&chart->G, n, a);
    for (size_t k = 0; k < DAL_LENGTH(places); k++) dal__reserve(a, places[k], n, sizeof(size_t));
}

void dal__chart_bind(dal_chart *chart, const dal_system *system)
{
    chart->n = system->def.n;
    chart->m = system->def.m;
    chart->width = 2 * chart->n - chart->m;
    dal__mechanics_bind(&chart->mech, system);
}

int dal_chart_new(dal_chart **chart, const dal_system *system, dal_error *error)
{
    dal_chart shape = {0}, *self;
    int status = DAL__REQUIRE(error, {"chart", chart}, {"system", system});
    if (status) return status;
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    dal__chart_reserve(&shape, system, &shape.arena);
    status = dal__allocate(&shape.arena, error);
    if (status) return status;
    *self = shape;
    dal__chart_bind(self, system);
    *chart = self;
    return DAL_SUCCESS;
}

void dal_chart_free(dal_chart *chart)
{
    if (chart) dal__release(&chart->arena);
}

const dal_error *dal_chart_error(const dal_chart *chart) { return &chart->mech.error; }

int dal_chart_input(dal_chart *chart, const double *u)
{
    return chart ? dal_mechanics_input(&chart->mech, u) : DAL_EINVAL;
}

const size_t *dal_chart_dependent(const dal_chart *chart)
{
    return chart && chart->chosen ? chart->place : NULL;
}

const size_t *dal_chart_independent(const dal_chart *chart)
{
    return chart && chart->chosen ? chart->place + chart->m : NULL;
}

static dal_constraint_kind kind(const dal_chart *chart)
{
    return chart->mech.eval.system->def.kind;
}

int dal__chart_ready(dal_chart *chart)
{
    if (chart->chosen) return DAL_SUCCESS;
    return dal__fail(&chart->mech.error, DAL_EINVAL, "the chart has no dependent coordinates yet; "
                     "choose them first");
}

/* What public functions ask for first: finite t and x[2n]; */
static int require_point(dal_chart *chart, double t, const double *x)
{
    if (!chart) return DAL_EINVAL;
    return DAL__REQUIRE_FINITE(&chart->mech.error, {"t", 1, &t}, {"x", 2 * chart->n, x});
}

/* or somewhere for the output of this name to go, a choice, and these; */
static int require_state(dal_chart *chart, const char *name, const double *output, double t,
                         const double *x)
{
    if (!chart) return DAL_EINVAL;
    int status = dal__require_finite(&chart->mech, name, 0, output);
    if (!status) status = dal__chart_ready(chart);
    return status ? status : require_point(chart, t, x);
}

/* or the output, and what dal__chart_state asks for, which is done then. */
static int require_xi(dal_chart *chart, const char *name, const double *output, double t,
                      const double *xi)
{
    if (!chart) return DAL_EINVAL;
    const int status = dal__require_finite(&chart->mech, name, 0, output);
    return status ? status : dal__chart_state(chart, t, xi);
}

/* The names of count coordinates with commas between them, cut off where text[size] ends. */
static void write_names(const dal_chart *chart, const size_t *place, size_t count, size_t size,
                        char *text)
{
    size_t used = 0;
    text[0] = '\0';
    for (size_t k = 0; k < count && used + 1 < size; k++) {
        const int length = snprintf(text + used, size - used, "%s%s", k ? ", " : "",
                                    dal_system_coordinate(chart->mech.eval.system, place[k]));
        if (length < 0) return;
        used += (size_t)length;
    }
}

/* ---- A and B ----------------------------------------------------------------------------- */

static void gather_B(dal_chart *chart, const double *mu)
{
    for (size_t a = 0; a < chart->m; a++)
        for (size_t b = 0; b < chart->m; b++)
            chart->B.A[a * chart->m + b] = mu[a * chart->n + chart->place[b]];
}

int dal__chart_factor(dal_chart *chart, const double *mu)
{
    const size_t m = chart->m;
    double *const sizes = chart->B.sizes;
    gather_B(chart, mu);
    for (size_t a = 0; a < m; a++) {
        sizes[a] = 0.0;
        sizes[m + a] = chart->mech.metric.per_unit[chart->place[a]];
        for (size_t b = 0; b < m; b++)
            sizes[a] += fabs(chart->B.A[a * m + b]) * chart->mech.metric.unit[chart->place[b]];
    }
    if (dal__linear_factor(&chart->B)) return DAL_SUCCESS;
    char names[128];
    write_names(chart, chart->place, m, sizeof names, names);
    dal__fail(&chart->mech.error, DAL_ESINGULAR, "the coordinates %s cannot be the dependent ones "
              "here, because their columns of mu form a singular matrix", names);
    dal__build_Z(&chart->mech, mu);
    dal__name_dependent(&chart->mech, mu, chart->mech.gram.Z, dal__rank_lost(&chart->mech),
                        &chart->mech.error);
    return DAL_ESINGULAR;
}

/* phi, mu, the metric, and phi_q if wanted at x[2n], and B factored. */
static int build_B(dal_chart *chart, double t, const double *x, bool slopes)
{
    const int status = dal__forms_at(&chart->mech, t, 0.0, x, slopes);
    return status ? status : dal__chart_factor(chart, chart->mech.forms.mu);
}

/* result[a*stride] <- B^-1 times the column of forms[m*n]. */
static void solve_column(dal_chart *chart, const double *forms, size_t column, double *result,
                         size_t stride)
{
    for (size_t a = 0; a < chart->m; a++) chart->right[a] = forms[a * chart->n + column];
    dal__linear_solve(&chart->B, chart->right, chart->solution);
    for (size_t a = 0; a < chart->m; a++) result[a * stride] = chart->solution[a];
}

/* A of mu, whose B is factored. */
static void build_A(dal_chart *chart)
{
    const size_t free = chart->n - chart->m;
    for (size_t j = 0; j < free; j++)
        solve_column(chart, chart->mech.forms.mu, chart->place[chart->m + j], chart->A + j, free);
}

int dal_chart_connection(dal_chart *chart, double t, const double *x, double *A, double *B)
{
    int status = require_state(chart, "x", x, t, x);
    if (!status) status = build_B(chart, t, x, false);
    if (status) return status;
    const size_t n = chart->n, m = chart->m;
    build_A(chart);
    gather_B(chart, chart->mech.forms.mu);
    return DAL__DELIVER(&chart->mech.error, {"A", m * (n - m), chart->A, A},
                        {"B", m * m, chart->B.A, B});
}

/* ---- the choice -------------------------------------------------------------------------- */

/* Elimination of column j by row a of the tableau, which then belongs to it. */
static void eliminate(dal_chart *chart, size_t a, size_t j)
{
    const size_t n = chart->n;
    double *const T = chart->tableau;
    const double pivot = T[a * n + j];
    for (size_t k = 0; k < n; k++) T[a * n + k] /= pivot;
    for (size_t b = 0; b < chart->m; b++)
        if (b != a) dal__add(n, -T[b * n + j], T + a * n, T + b * n);
    chart->owner[a] = j;
}

/* Whether coordinate k belongs to a row. */
static bool is_owned(const dal_chart *chart, size_t k)
{
    for (size_t a = 0; a < chart->m; a++)
        if (chart->owner[a] == k) return true;
    return false;
}

/* The largest entry of the tableau outside the columns that belong to a row, in all rows or in
 * those that own none; it is in row *a and column *j. */
static double largest_entry(const dal_chart *chart, bool all, size_t *a, size_t *j)
{
    double most = 0.0;
    for (size_t k = 0; k < chart->n; k++) {
        if (is_owned(chart, k)) continue;
        for (size_t b = 0; b < chart->m; b++) {
            const double entry = fabs(chart->tableau[b * chart->n + k]);
            if (!(entry > most) || (!all && chart->owner[b] < chart->n)) continue;
            most = entry;
            *a = b;
            *j = k;
        }
    }
    return most;
}

/* owner <- the dependent coordinates: [A, I] by Gauss and Jordan, then exchanges, each of which
 * makes |det B| larger by the entry of A that it removes. */
static int pivot_columns(dal_chart *chart)
{
    const size_t n = chart->n, m = chart->m;
    double *const T = chart->tableau;
    size_t a = 0, j = 0;
    for (size_t b = 0; b < m; b++) { /* the size of a form means nothing */
        double most = 0.0;
        for (size_t k = 0; k < n; k++) {
            T[b * n + k] = chart->mech.forms.mu[b * n + k] / sqrt(dal__mass_at(&chart->mech, k));
            most = fmax(most, fabs(T[b * n + k]));
        }
        for (size_t k = 0; most > 0.0 && k < n; k++) T[b * n + k] /= most;
        chart->owner[b] = n; /* none */
    }
    for (size_t rank = 0; rank < m; rank++) {
        if (!(largest_entry(chart, false, &a, &j) > 0.0)) {
            dal_mechanics *const mech = &chart->mech;
            dal__fail(&mech->error, DAL_ESINGULAR, "no choice of dependent coordinates is "
                      "possible: mu has rank %zu instead of %zu", rank, m);
            dal__build_Z(mech, mech->forms.mu);
            dal__name_dependent(mech, mech->forms.mu, mech->gram.Z, dal__rank_lost(mech),
                                &mech->error);
            return DAL_ESINGULAR;
        }
        eliminate(chart, a, j);
    }
    /* far more than are ever needed; a matrix without full rank could go on for ever */
    for (size_t left = 4 * m * n; left > 0 && largest_entry(chart, true, &a, &j) > EXCHANGE; left--)
        eliminate(chart, a, j);
    return DAL_SUCCESS;
}

/* place <- owner, ascending, and then the rest. */
static void arrange(dal_chart *chart)
{
    size_t dependent = 0, independent = chart->m;
    for (size_t k = 0; k < chart->n; k++)
        chart->place[is_owned(chart, k) ? dependent++ : independent++] = k;
}

static int check_dependent(dal_chart *chart, const size_t *dependent)
{
    for (size_t a = 0; a < chart->m; a++) {
        if (dependent[a] >= chart->n)
            return dal__fail(&chart->mech.error, DAL_EINVAL, "dependent[%zu] = %zu: expected an "
                             "index below n = %zu", a, dependent[a], chart->n);
        for (size_t b = 0; b < a; b++)
            if (dependent[a] == dependent[b])
                return dal__fail(&chart->mech.error, DAL_EINVAL, "dependent[%zu] and "
                                 "dependent[%zu] are both %zu: expected different coordinates", b,
                                 a, dependent[a]);
    }
    return DAL_SUCCESS;
}

static void start_branch(dal_chart *chart, const double *x)
{
    for (size_t a = 0; a < chart->m; a++) chart->branch[a] = x[chart->n + chart->place[a]];
}

int dal_chart_choose(dal_chart *chart, double t, const size_t *dependent, const double *x)
{
    int status = require_point(chart, t, x);
    if (!status && dependent) status = check_dependent(chart, dependent);
    if (!status) status = dal__forms_at(&chart->mech, t, 0.0, x, false);
    if (!status && !dependent) status = pivot_columns(chart);
    if (status) return status;
    const size_t n = chart->n, m = chart->m;
    if (dependent && m > 0) memcpy(chart->owner, dependent, m * sizeof *dependent);
    memcpy(chart->former, chart->place, n * sizeof *chart->place);
    arrange(chart);
    status = dal__chart_factor(chart, chart->mech.forms.mu);
    if (status) {
        memcpy(chart->place, chart->former, n * sizeof *chart->place);
        return status;
    }
    chart->chosen = true;
    start_branch(chart, x);
    return DAL_SUCCESS;
}

int dal__chart_condition(dal_chart *chart, double t, const double *x, double *condition)
{
    const size_t n = chart->n, m = chart->m, free = n - m;
    const int status = dal__forms_at(&chart->mech, t, 0.0, x, false);
    if (status) return status;
    *condition = (double)INFINITY;
    const dal_error before = chart->mech.error;
    if (dal__chart_factor(chart, chart->mech.forms.mu)) { /* an answer, not a failure */
        chart->mech.error = before;
        return DAL_SUCCESS;
    }
    build_A(chart);
    for (size_t a = 0; a < m; a++)
        for (size_t j = 0; j < free; j++) {
            const size_t d = chart->place[a], i = chart->place[m + j];
            chart->A[a * free + j] *= sqrt(dal__mass_at(&chart->mech, d)
                                           / dal__mass_at(&chart->mech, i));
        }
    const double unit = dal__singular_values(m, free, chart->A, chart->right);
    *condition = hypot(1.0, unit * sqrt(dal__largest(m, chart->right)));
    return DAL_SUCCESS;
}

int dal_chart_condition(dal_chart *chart, double t, const double *x, double *condition)
{
    const int status = require_state(chart, "condition", condition, t, x);
    return status ? status : dal__chart_condition(chart, t, x, condition);
}

bool dal__chart_keeps(const dal_chart *chart, double condition)
{
    const double m = (double)chart->m, free = (double)(chart->n - chart->m);
    return condition <= LIMIT * sqrt(1.0 + m * free);
}

int dal_chart_renew(dal_chart *chart, double t, const double *x, int *changed)
{
    char from[128] = "", to[128];
    double condition = (double)INFINITY;
    int status = require_point(chart, t, x);
    if (!status && chart->chosen) status = dal__chart_condition(chart, t, x, &condition);
    if (status) return status;
    const size_t n = chart->n, m = chart->m;
    if (dal__chart_keeps(chart, condition)) {
        start_branch(chart, x);
        if (changed) *changed = 0;
        return DAL_SUCCESS;
    }
    const bool first = !chart->chosen;
    if (!first) write_names(chart, chart->place, m, sizeof from, from);
    status = dal_chart_choose(chart, t, NULL, x);
    if (status) return status;
    const bool other = memcmp(chart->former, chart->place, n * sizeof *chart->place) != 0;
    if (changed) *changed = first || other;
    write_names(chart, chart->place, m, sizeof to, to);
    if (!first && other)
        dal__fail(&chart->mech.error, DAL_SUCCESS, "the dependent coordinates change from %s "
                  "(condition %.3g here) to %s", from, condition, to);
    return DAL_SUCCESS;
}

/* ---- psi --------------------------------------------------------------------------------- */

void dal__chart_drop(const dal_chart *chart, const double *x, double *xi)
{
    const size_t n = chart->n, m = chart->m;
    dal__copy(n, x, xi);
    for (size_t j = m; j < n; j++) chart->step[j] = x[n + chart->place[j]];
    dal__copy(n - m, chart->step + m, xi + n);
}

/* Not more than 2 n u: steps have twice that. */
static bool is_in_D(const dal_chart *chart)
{
    const dal_mechanics *const mech = &chart->mech;
    return dal__relative_residual(mech, mech->forms.mu, mech->forms.phi, chart->x + chart->n,
                                  NULL)
        <= 2.0 * (double)chart->n * DAL_ROUNDOFF;
}

/* v[n]_dependent -= B^-1 phi. */
static void move_dependent(dal_chart *chart, double *v)
{
    dal__linear_solve(&chart->B, chart->mech.forms.phi, chart->solution);
    for (size_t a = 0; a < chart->m; a++) v[chart->place[a]] -= chart->solution[a];
}

int dal__chart_mend(dal_chart *chart, double t, double shift)
{
    enum { MENDS = 3 };
    dal_mechanics *const mech = &chart->mech;
    for (int pass = 1;; pass++) {
        const int status = dal__forms_at(mech, t, shift, chart->x, false);
        if (status) return status;
        if (is_in_D(chart) || pass > MENDS) return DAL_SUCCESS;
        move_dependent(chart, chart->x + chart->n);
    }
}

static double moves(void *ctx)
{
    dal_chart *const chart = ctx;
    return dal__velocity_moves(&chart->mech, chart->t, 0.0, chart->x + chart->n);
}

/* Of v in chart->x where the constraints are nonlinear, of which only v_dependent moves; and it
 * stands still where the residual is roundoff, so that what is in D already keeps its bits. */
static int find_step(dal__newton *equations)
{
    dal_chart *const chart = equations->ctx;
    int status = dal__forms_at(&chart->mech, chart->t, 0.0, chart->x, false);
    if (status) return status;
    dal__clear(chart->n, equations->step);
    if (is_in_D(chart)) return DAL_SUCCESS;
    status = dal__chart_factor(chart, chart->mech.forms.mu);
    if (!status) move_dependent(chart, equations->step);
    return status;
}

/* Where the constraints are not nonlinear the first solution is exact but for roundoff. */
int dal__chart_lift(dal_chart *chart, double t, const double *xi)
{
    const size_t n = chart->n, m = chart->m;
    double *const x = chart->x, *const v = x + n;
    int status;
    dal__copy(n, xi, x);
    for (size_t j = m; j < n; j++) v[chart->place[j]] = xi[n + j - m];
    if (kind(chart) == DAL_NONLINEAR) {
        chart->t = t;
        dal__newton equations = {.find_step = find_step, .moves = moves, .ctx = chart, .size = n,
                                 .measured = n, .n = n,
                                 .per_unit = chart->mech.metric.per_unit, .z = v,
                                 .step = chart->step,
                                 .advice = "the constraint may have no solution with these "
                                           "independent velocities"};
        status = dal__newton_run(&equations, &chart->mech.error);
    } else {
        for (size_t a = 0; a < m; a++) v[chart->place[a]] = 0.0;
        status = build_B(chart, t, x, false);
        if (!status) move_dependent(chart, v);
    }
    if (status || dal__all_finite(2 * n, x)) return status;
    return dal__fail(&chart->mech.error, DAL_EDOMAIN, "the dependent velocities overflow");
}

int dal__chart_state(dal_chart *chart, double t, const double *xi)
{
    int status = dal__chart_ready(chart);
    if (!status)
        status = DAL__REQUIRE_FINITE(&chart->mech.error, {"t", 1, &t}, {"xi", chart->width, xi});
    if (status) return status;
    for (size_t a = 0; a < chart->m; a++) chart->x[chart->n + chart->place[a]] = chart->branch[a];
    return dal__chart_lift(chart, t, xi);
}

int dal_chart_lift(dal_chart *chart, double t, const double *xi, double *x)
{
    const int status = require_xi(chart, "x", x, t, xi);
    if (!status) dal__copy(2 * chart->n, chart->x, x);
    return status;
}

int dal_chart_drop(dal_chart *chart, const double *x, double *xi)
{
    const int status = require_state(chart, "xi", xi, 0.0, x);
    if (!status) dal__chart_drop(chart, x, xi);
    return status;
}

int dal_chart_split(dal_chart *chart, double t, const double *x, double *hor, double *ver)
{
    int status = require_state(chart, "x", x, t, x);
    if (status) return status;
    const size_t n = chart->n;
    dal__copy(2 * n, x, chart->x);
    dal__chart_drop(chart, x, chart->y);
    status = dal__chart_lift(chart, t, chart->y);
    if (status) return status;
    dal__move(n, x + n, -1.0, chart->x + n, chart->w);
    return DAL__DELIVER(&chart->mech.error, {"hor", n, chart->x + n, hor},
                        {"ver", n, chart->w, ver});
}

int dal_chart_jacobian(dal_chart *chart, double t, const double *xi, double *J, double *left)
{
    int status = require_xi(chart, "xi", xi, t, xi);
    if (!status) status = build_B(chart, t, chart->x, true);
    if (status) return status;
    const size_t n = chart->n, m = chart->m, width = chart->width;
    const size_t *const place = chart->place;
    const dal__forms *const at = &chart->mech.forms;
    for (size_t k = 0; J && k < width; k++) /* B^-1 [phi_q, phi_v of the independent ones] */
        solve_column(chart, k < n ? at->dmu : at->mu, k < n ? k : place[m + k - n],
                     chart->tableau + k, width);
    status = dal__require_output(&chart->mech.error, "J", J ? m * width : 0, chart->tableau);
    if (status) return status;
    if (J) {
        dal__clear(2 * n * width, J);
        for (size_t i = 0; i < n; i++) J[i * width + i] = 1.0;
        for (size_t j = m; j < n; j++) J[(n + place[j]) * width + n + j - m] = 1.0;
        for (size_t a = 0; a < m; a++)
            for (size_t k = 0; k < width; k++) /* 0, and not -0 */
                J[(n + place[a]) * width + k] = 0.0 - chart->tableau[a * width + k];
    }
    if (left) {
        dal__clear(2 * n * width, left);
        for (size_t i = 0; i < n; i++) left[i * 2 * n + i] = 1.0;
        for (size_t j = m; j < n; j++) left[(n + j - m) * 2 * n + n + place[j]] = 1.0;
    }
    return DAL_SUCCESS;
}

int dal_chart_field(dal_chart *chart, double t, const double *xi, double *xidot)
{
    int status = require_xi(chart, "xidot", xidot, t, xi);
    if (!status) status = dal_field(&chart->mech, t, chart->x, chart->y);
    if (!status) dal__chart_drop(chart, chart->y, xidot);
    return status;
}

/* ---- multipliers ------------------------------------------------------------------------- */

void dal__chart_reduce(const dal_chart *chart, const double *mu, const double *given,
                       double *result)
{
    for (size_t b = 0; b < chart->m; b++) {
        result[b] = 0.0;
        for (size_t a = 0; a < chart->m; a++)
            result[b] += mu[a * chart->n + chart->place[b]] * given[a];
    }
}

/* result[m] <- B^T given[m], the multipliers of [A, I] from those of mu; or back, B^-T given. */
static int transform(dal_chart *chart, double t, const double *x, bool back, const double *given,
                     double *result)
{
    static const char *const names[] = {"lambda", "lambda_E"};
    int status = require_state(chart, names[!back], result, t, x);
    if (status) return status;
    const size_t m = chart->m;
    if (m > 0) status = dal__require_finite(&chart->mech, names[back], m, given);
    if (!status) status = build_B(chart, t, x, false);
    if (status) return status;
    if (back) {
        dal__copy(m, given, chart->right);
        dal__linear_solve_transposed(&chart->B, chart->right, chart->solution);
    } else {
        dal__chart_reduce(chart, chart->mech.forms.mu, given, chart->solution);
    }
    return DAL__DELIVER(&chart->mech.error, {names[!back], m, chart->solution, result});
}

int dal_chart_multipliers(dal_chart *chart, double t, const double *x, const double *lambda,
                          double *lambda_E)
{
    return transform(chart, t, x, false, lambda, lambda_E);
}

int dal_chart_multipliers_back(dal_chart *chart, double t, const double *x,
                               const double *lambda_E, double *lambda)
{
    return transform(chart, t, x, true, lambda_E, lambda);
}
