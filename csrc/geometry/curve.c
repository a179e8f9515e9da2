/* Curves inside D: between two states with the cut-off functions, and through the rows of
 * a run. */
#include "geometry/geometry.h"
#include "dalembert/lu.h"

#include <math.h>
#include <string.h>

void dal_cutoff(double tau, double *chi0, double *chi1, double *slope)
{
    static const double pi = 3.14159265358979323846;
    /* w = |cot(pi tau)|; s and 1/2 - s are exact where their form is used */
    const double s = tau <= 0.5 ? tau : 1.0 - tau;
    const double w = s < 0.25 ? 1.0 / tan(pi * s) : tan(pi * (0.5 - s));
    const bool inside = tau > 0.0 && tau < 1.0 && w <= 370.0;
    const double e = isnan(tau) ? tau : inside ? exp(-2.0 * w) : 0.0;
    const double large = 1.0 / (1.0 + e), small = e / (1.0 + e);
    if (chi0) *chi0 = tau <= 0.5 ? large : small;
    if (chi1) *chi1 = tau <= 0.5 ? small : large;
    if (slope) *slope = e == 0.0 ? 0.0 : -2.0 * pi * (1.0 + w * w) * large * small;
}

int dal_chart_curve(dal_chart *chart, double t, const double *x1, const double *x2, double tau,
                    double *x)
{
    if (!chart) return DAL_EINVAL;
    const size_t n = chart->n;
    double chi0, chi1;
    int status = DAL__REQUIRE_FINITE(&chart->mech.error, {"x", 0, x}, {"t", 1, &t},
                                     {"x1", 2 * n, x1}, {"x2", 2 * n, x2}, {"tau", 1, &tau});
    if (!status) status = dal__chart_ready(chart);
    if (status) return status;
    dal_cutoff(tau, &chi0, &chi1, NULL);
    for (size_t i = 0; i < 2 * n; i++) chart->x[i] = chi0 * x1[i] + chi1 * x2[i];
    dal__chart_drop(chart, chart->x, chart->y);
    status = dal__chart_lift(chart, t, chart->y);
    if (!status) dal__copy(2 * n, chart->x, x);
    return status;
}

/* ---- through the rows of a run ------------------------------------------------------------- */

typedef struct rows {
    double t0, h, shift;
    size_t count;
    const double *x; /* [count*2n] */
} rows;

/* How far beyond the rows a time may lie, in parts of what they span: an end that was meant. */
static const double SLACK = 1e-9;

static double time_of(const rows *r, size_t k) { return r->t0 + (double)k * r->h; }

/* Whether t is the time of row k but for its rounding. */
static bool is_time_of(const rows *r, size_t k, double t)
{
    const double size = fabs(r->t0) + (double)k * fabs(r->h);
    return fabs(t - time_of(r, k)) <= 4.0 * DAL_ROUNDOFF * size;
}

static int require_row(dal_chart *chart, const rows *r, size_t k)
{
    const double *const row = r->x + k * 2 * chart->n;
    for (size_t i = 0; i < 2 * chart->n; i++)
        if (!isfinite(row[i]))
            return dal__fail(&chart->mech.error, DAL_EINVAL, "x[%zu] = %g is not finite in row %zu",
                             i, row[i], k);
    return DAL_SUCCESS;
}

/* end[3n] <- (q - shift v, v, vdot) of row k. */
static int load_end(dal_chart *chart, const rows *r, size_t k, double *end)
{
    const size_t n = chart->n;
    const double *const row = r->x + k * 2 * n;
    const int status = require_row(chart, r, k);
    if (status) return status;
    dal__move(n, row, -r->shift, row + n, end);
    dal__copy(n, row + n, end + n);
    return dal_acceleration(&chart->mech, time_of(r, k), end, end + 2 * n);
}

/* chart->x <- the polynomials at s, 0 and 1 at the ends of the interval. */
static void evaluate_polynomials(dal_chart *chart, double h, double s)
{
    const size_t n = chart->n;
    const double *const p = chart->first, *const r = chart->second;
    const double left = 1.0 - s, ss = s * s, sss = ss * s;
    const double q_end = sss * (10.0 - 15.0 * s + 6.0 * ss);
    const double q_rate = s - sss * (6.0 - 8.0 * s + 3.0 * ss);
    const double q_rate_end = -sss * (4.0 - 7.0 * s + 3.0 * ss);
    const double q_bend = 0.5 * ss * left * left * left, q_bend_end = 0.5 * sss * left * left;
    const double v_end = ss * (3.0 - 2.0 * s), v_rate = s * left * left, v_rate_end = -ss * left;
    for (size_t i = 0; i < n; i++) {
        const double v = p[n + i], w = r[n + i], a = p[2 * n + i], b = r[2 * n + i];
        chart->x[i] = p[i] + ((r[i] - p[i]) * q_end + h * (v * q_rate + w * q_rate_end)
                              + h * h * (a * q_bend + b * q_bend_end));
        chart->x[n + i] = v + ((w - v) * v_end + h * (a * v_rate + b * v_rate_end));
    }
}

/* chart->x[2n] <- the state at time t and s of the interval whose ends are loaded; *pivoted: the
 * choice is that of its middle. */
static int interpolate(dal_chart *chart, double t, double h, double s, bool *pivoted)
{
    double condition = 0.0;
    int status = DAL_SUCCESS;
    if (!*pivoted) {
        evaluate_polynomials(chart, h, 0.5);
        status = dal_chart_choose(chart, t + (0.5 - s) * h, NULL, chart->x);
        if (status) return status;
        *pivoted = true;
    }
    evaluate_polynomials(chart, h, s);
    status = dal__chart_condition(chart, t, chart->x, &condition);
    if (!status && !dal__chart_keeps(chart, condition)) {
        *pivoted = false;
        status = dal_chart_choose(chart, t, NULL, chart->x);
    }
    if (status) return status;
    dal__chart_drop(chart, chart->x, chart->y);
    return dal__chart_lift(chart, t, chart->y);
}

/* chart->x in D at time t moves to its node q + shift v.  That rounds q; what it does to the
 * residual at q - shift v is mended. */
static int move_to_node(dal_chart *chart, double t, double shift)
{
    dal__add(chart->n, shift, chart->x + chart->n, chart->x);
    return shift != 0.0 ? dal__chart_mend(chart, t, shift) : DAL_SUCCESS;
}

static int check_times(dal_chart *chart, const rows *r, size_t count, const double *t)
{
    const double end = time_of(r, r->count - 1);
    const double low = fmin(r->t0, end), high = fmax(r->t0, end);
    const double slack = SLACK * fmax(fabs(r->h), high - low);
    for (size_t k = 0; k < count; k++)
        if (!(t[k] >= low - slack && t[k] <= high + slack))
            return dal__fail(&chart->mech.error, DAL_EINVAL, "t = %.12g is outside the stored "
                             "states: expected a time from %.12g to %.12g", t[k], r->t0, end);
    return DAL_SUCCESS;
}

/* The ends of an interval stay loaded from one state to the next. */
static int follow(dal_chart *chart, const rows *r, size_t count, const double *t, double *out,
                  size_t *changes, size_t *done)
{
    dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n, last = r->count - 1;
    size_t interval = SIZE_MAX;
    bool pivoted = false, any = false;
    *changes = 0;
    for (*done = 0; *done < count; out += 2 * n, ++*done) {
        const double now = t[*done], place = fmin(fmax((now - r->t0) / r->h, 0.0), (double)last);
        const size_t nearest = (size_t)(place + 0.5);
        if (last == 0 || is_time_of(r, nearest, now)) {
            const int status = require_row(chart, r, nearest);
            if (status) return status;
            dal__copy(2 * n, r->x + nearest * 2 * n, out);
            continue;
        }
        size_t here = (size_t)place;
        if (here == last) here--;
        int status = DAL_SUCCESS;
        if (here != interval) {
            status = load_end(chart, r, here, chart->first);
            if (!status) status = load_end(chart, r, here + 1, chart->second);
            interval = here;
            pivoted = false;
        }
        const double s = (now - time_of(r, here)) / r->h;
        if (!status) status = interpolate(chart, now, r->h, s, &pivoted);
        if (!status) status = move_to_node(chart, now, r->shift);
        if (!status) status = dal__require_output(&mech->error, "the state", 2 * n, chart->x);
        if (status) return status;
        dal__copy(2 * n, chart->x, out);
        if (any && memcmp(chart->last_place, chart->place, n * sizeof *chart->place)) ++*changes;
        memcpy(chart->last_place, chart->place, n * sizeof *chart->place);
        any = true;
    }
    return DAL_SUCCESS;
}

int dal_chart_interpolate(dal_chart *chart, double t0, double h, double shift, size_t rows_count,
                          const double *x, size_t count, const double *t, double *out,
                          size_t *changes, size_t *done)
{
    if (done) *done = 0;
    if (!chart) return DAL_EINVAL;
    dal_error *const error = &chart->mech.error;
    const rows r = {t0, h, shift, rows_count, x};
    size_t changed = 0, made = 0;
    /* where no time is asked for, t and out may be NULL */
    int status = DAL__REQUIRE_FINITE(error, {"x", 0, x}, {"t", 0, count > 0 ? t : x},
                                     {"out", 0, count > 0 ? out : x}, {"t0", 1, &t0},
                                     {"shift", 1, &shift});
    if (status) return status;
    if (rows_count == 0) return dal__fail(error, DAL_EINVAL, "rows = 0: expected at least one row");
    status = dal__require_step(error, h);
    if (!status) status = check_times(chart, &r, count, t);
    if (status) return status;
    const bool chosen = chart->chosen;
    size_t *const place = chart->place;
    double *const branch = chart->branch;
    chart->place = chart->other_place;
    chart->branch = chart->other_branch;
    status = follow(chart, &r, count, t, out, &changed, &made);
    chart->place = place;
    chart->branch = branch;
    chart->chosen = chosen;
    if (done) *done = made;
    if (!status && changes) *changes = changed;
    return status;
}
