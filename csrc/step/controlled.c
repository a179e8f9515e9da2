/* Error-controlled steps: each as long as its estimated error allows.
 *
 * The embedded estimate e = O(h^(q+1)) costs nothing, and says too much: the error of a step is
 * O(h^(p+1)), some 1e2 to 1e6 times less, depending on the system and its motion.  So the error is
 * taken as c e^a, a = (p+1)/(q+1), with a factor c that is measured now and then: two steps are
 * compared with one of twice the length, whose error is 2^p times theirs, far above roundoff.
 *
 * The tolerance is for the state after some hundred steps; one step may use only a part of it.
 *
 * A step begins where the one before ended, at t0, and its h is the difference of two times, t0 and
 * the rounded t0 + h: so times do not gather roundoff, whatever the steps. */
#include "step/controlled.h"

#include "step/stepper.h"

#include <math.h>
#include <string.h>

/* h changes by SAFETY r^-(GAIN/(p+1)) of the error r of a step in units of what it may be, and the
 * memory of the step before; within limits. */
#define SAFETY 0.9
#define GAIN 0.7
#define MEMORY 0.4
#define LEAST 0.2
#define MOST 5.0
#define LEAST_AFTER_FAILURE 0.1
/* An error that says nothing about h: of roundoff, or of a step that failed. */
#define SMALLEST 1e-4
#define FAILED 1e10
/* The error of a step that is counted as uncontrolled, in units of what it may be: the factor
 * within which a tolerance is kept. */
#define BEYOND 30.0
enum { ATTEMPTS = 60 };
#define LEAST_TOLERANCE 1e-14
#define MOST_TOLERANCE 0.1
/* A step may have this part of tolerance^((p+1)/p): a motion takes some tolerance^(-1/p) steps.
 * Measured: so the state at t = 100 is mostly within a factor 30 of the tolerance. */
#define PART 0.5
/* The roundoff of an estimate, and of the difference of two states, is below so many u times the
 * sum of its weights: twice the measured value. */
#define ROUNDOFF 64.0
/* A steady error E leaves h as it is where SAFETY E^-((GAIN-MEMORY)/(p+1)) = 1.  The allowed
 * estimate must be 23 times the roundoff for order 10, less for lower orders, or h never grows. */
#define FAR_FROM_NOISE 32.0
#define MOST_NOISE 1e4 /* in units of what it is where coordinates are of size 1 */
/* Steps after which c is measured: some at the beginning, then every so many.  It grows at once
 * and falls slowly, and until it is known it is large. */
enum { EARLY = 8, OFTEN = 64 };
#define FIRST_RATIO 1.0

static bool wanted(const dal_options *options)
{
    return options->tolerance != 0.0 || options->h_max != 0.0;
}

static int make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    const dal_family *const family = self->family;
    const double tolerance = options->tolerance, h_max = options->h_max;
    if (!(h_max >= 0.0))
        return dal__fail(error, DAL_EINVAL, "options.h_max = %g: expected a positive number, or 0 "
                         "for no limit", h_max);
    if (self->scheme.nodes == DAL_KEPT_NODES)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support error-controlled "
                         "steps, because its D_eps depends on h; choose a scheme with moved nodes",
                         self->scheme.name);
    double noise = 0.0;
    int q = 0, status = DAL_SUCCESS;
    if (family->estimates) status = family->estimates(self->method, &q, &noise, error);
    if (status) return status;
    if (q == 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support error-controlled "
                         "steps, because it has no error estimate; choose a composition, for "
                         "example leapfrog-kl8", self->scheme.name);
    if (!(tolerance >= LEAST_TOLERANCE && tolerance <= MOST_TOLERANCE))
        return dal__fail(error, DAL_EINVAL, "options.tolerance = %g: expected a number from %g "
                         "(roundoff) to %g", tolerance, LEAST_TOLERANCE, MOST_TOLERANCE);
    const int order = self->scheme.order > q ? self->scheme.order : q;
    dal__controlled *made, shape = {.q = q, .order = order, .tolerance = tolerance, .h_max = h_max,
                                    .noise = noise * ROUNDOFF * DAL_ROUNDOFF,
                                    .allowed = PART * pow(tolerance, (order + 1.0) / order)};
    dal__reserve(&self->variable.arena, &made, 1, sizeof *made);
    DAL__RESERVE(&self->variable.arena, 2 * self->mech.n, &shape.estimate, &shape.field);
    dal__snapshot_reserve(self, &shape.after, &self->variable.arena);
    status = dal__variable_make(self, error);
    if (status) return status;
    *made = shape;
    self->control_data = made;
    self->guards.allowed = tolerance;
    return DAL_SUCCESS;
}

static double longest(const dal__controlled *data)
{
    return data->h_max > 0.0 ? data->h_max : (double)INFINITY;
}

static int check(dal_stepper *self, double t, double h)
{
    return dal__stepper_check_times(self, t, isinf(h) ? copysign(fmax(1.0, fabs(t)), h) : h);
}

/* ---- the first step ------------------------------------------------------------------------- */

/* The largest component of a change of x[2n], relative to 1 + |x_i|; infinite for NaN. */
static double size(size_t N, const double *x, const double *change)
{
    double largest = 0.0;
    for (size_t i = 0; i < N; i++) {
        const double part = fabs(change[i]) / (1.0 + fabs(x[i]));
        if (!(part <= largest)) largest = isnan(part) ? HUGE_VAL : part;
    }
    return largest;
}

/* A first step by the rates of x and of its rates (Hairer, Norsett, Wanner 1993, II.4), all at time
 * t: where the motion is to end is not known yet. */
static int find_first(dal_stepper *self, double t, double direction, const double *x, double *h)
{
    dal__controlled *const data = self->control_data;
    const size_t N = 2 * self->mech.n;
    double *const f = data->estimate, *const there = self->variable.before.x;
    double *const change = data->field;
    int status = dal_field(&self->mech, t, x, f);
    if (status) return status;
    const double tolerance = data->tolerance;
    const double place = size(N, x, x) / tolerance, speed = size(N, x, f) / tolerance;
    const double small = place > 1e-5 && speed > 1e-5 ? 0.01 * place / speed : 1e-6;
    const double one = direction * fmin(small, longest(data));
    dal__move(N, x, one, f, there);
    double curvature = 0.0;
    status = dal_field(&self->mech, t, there, change);
    if (status == DAL_EUSER) return status;
    for (size_t i = 0; i < N; i++) change[i] -= f[i];
    if (!status) curvature = size(N, x, change) / tolerance / fabs(one);
    const double rate = fmax(speed, curvature);
    const double two = rate > 1e-15 ? pow(0.01 / rate, 1.0 / (data->q + 1.0)) : 1e3 * small;
    *h = direction * fmin(fmin(100.0 * small, two), longest(data));
    return DAL_SUCCESS;
}

static int start(dal_stepper *self, double t, double h, const double *x, double *first)
{
    dal__controlled *const data = self->control_data;
    const int status = isinf(h) ? find_first(self, t, copysign(1.0, h), x, first) : DAL_SUCCESS;
    if (status) return status;
    if (!isinf(h)) *first = h;
    data->h = *first;
    data->error = 1.0;
    data->error_ratio = FIRST_RATIO;
    data->seen = 0.0;
    return DAL_SUCCESS;
}

/* ---- a step --------------------------------------------------------------------------------- */

/* One step from t; *estimate <- the size of the embedded estimate. */
static int attempt(dal_stepper *self, double t, double h, double *estimate)
{
    dal__controlled *const data = self->control_data;
    dal_motion *const motion = &self->motion;
    motion->estimate = data->estimate;
    const int status = dal__variable_step(self, t, h);
    motion->estimate = NULL;
    if (!status) *estimate = size(2 * self->mech.n, motion->x, data->estimate);
    return status;
}

/* The roundoff of the estimate, as far as it is known. */
static double roundoff(const dal__controlled *data) { return fmax(data->noise, data->seen); }

/* The error of a step by its estimate, in units of what it may be.  An estimate that is roundoff is
 * so for any h: it has to look small, for the next step to be longer.  *beyond <- the same in units
 * of what the tolerance alone allows. */
static double error_of(const dal__controlled *data, double estimate, double *beyond)
{
    const double power = (data->order + 1.0) / (data->q + 1.0);
    const double least = data->error_ratio * pow(FAR_FROM_NOISE * roundoff(data), power);
    const double error = data->error_ratio * pow(estimate, power);
    *beyond = error / data->allowed;
    return error / fmax(data->allowed, least);
}

/* What the estimates of a step and of one of twice the length tell of their roundoff: one that does
 * not grow with h is nothing else, as where coordinates have become large. */
static void look_at_roundoff(dal__controlled *data, double estimate, double twice)
{
    const bool grows = twice > estimate * pow(2.0, 0.5 * (data->q + 1.0));
    const bool small = estimate < MOST_NOISE * data->noise;
    data->seen = grows || !small ? 0.5 * data->seen : fmax(data->seen, estimate);
}

/* Change of v by the rounding of q' and t, where D is not linear: no h makes an estimate
 * less.  Whether that was not known. */
static bool look_at_moves(dal_stepper *self, double t)
{
    dal__controlled *const data = self->control_data;
    dal_mechanics *const mech = &self->mech;
    const double *const v = self->motion.x + mech->n;
    if (mech->eval.system->def.kind == DAL_LINEAR) return false;
    if (dal__forms_at(mech, t, 0.0, self->motion.x, false)) return false;
    double unit = 0.0;
    for (size_t i = 0; i < mech->n; i++)
        unit = fmax(unit, mech->metric.unit[i] / (1.0 + fabs(v[i])));
    const double noise = data->noise / ROUNDOFF * unit * dal__velocity_moves(mech, t, 0.0, v);
    if (!(noise > roundoff(data) && noise < HUGE_VAL)) return false;
    data->seen = noise;
    return true;
}

/* After a step of h from t: c by two steps and one of twice the length, whose error is
 * its difference to theirs; the motion stays where it is.  What is all roundoff, or cannot be made,
 * says nothing. */
static int measure_share(dal_stepper *self, double t, double h, double estimate)
{
    dal__controlled *const data = self->control_data;
    dal_motion *const motion = &self->motion;
    const size_t N = 2 * self->mech.n;
    double *const difference = data->field;
    double twice;
    dal__snapshot_take(self, &data->after);
    int status = attempt(self, t + h, h, &twice);
    if (!status) {
        memcpy(difference, motion->x, N * sizeof *difference);
        dal__snapshot_restore(self, &self->variable.before);
        status = attempt(self, t, 2.0 * h, &twice);
    }
    if (!status) {
        for (size_t i = 0; i < N; i++) difference[i] -= motion->x[i];
        const double error = size(N, motion->x, difference);
        const double ratio = error / pow(twice, (data->order + 1.0) / (data->q + 1.0));
        look_at_roundoff(data, estimate, twice);
        if (twice > roundoff(data) && error > ROUNDOFF * DAL_ROUNDOFF && ratio < HUGE_VAL)
            data->error_ratio = data->error_ratio == FIRST_RATIO || ratio > data->error_ratio
                              ? ratio : sqrt(ratio * data->error_ratio);
    }
    dal__snapshot_restore(self, &data->after);
    return dal__is_final(status) ? status : DAL_SUCCESS;
}

/* Whether c is measured after this step, where there is room for another. */
static bool is_time(const dal_stepper *self, double t, double h)
{
    const size_t steps = self->motion.steps;
    const double left = self->until - t;
    return (steps == 0 || steps == EARLY || steps % OFTEN == 0) && 2.0 * fabs(h) <= fabs(left);
}

/* The length of a step of about h from t: not beyond the end, nor so that a short one is left. */
static double fit(const dal_stepper *self, double t, double h)
{
    const dal__controlled *const data = self->control_data;
    const double left = self->until - t;
    h = copysign(fmin(fabs(h), longest(data)), h);
    if (fabs(h) >= fabs(left)) {
        const double last = dal__variable_last(self, t);
        if (t + last == self->until) return last;
        h = 0.75 * left; /* no number leads there from t, and from there one does */
    } else if (2.0 * fabs(h) > fabs(left)) {
        h = 0.5 * left;
    }
    return (t + h) - t;
}

/* The change of h after an error, of which the step before had another. */
static double change(const dal__controlled *data, double error)
{
    const double power = 1.0 / (data->order + 1.0);
    return fmin(fmax(SAFETY * pow(fmax(error, SMALLEST), -GAIN * power)
                         * pow(data->error, MEMORY * power), LEAST), MOST);
}

static int one_step(dal_stepper *self)
{
    dal__controlled *const data = self->control_data;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), power = 1.0 / (data->order + 1.0);
    double h = data->h;
    dal__snapshot_take(self, &self->variable.before);
    for (int k = 1;; k++) {
        const double length = fit(self, t, h);
        const bool whole = fabs(length) >= fabs(h) - 4.0 * DAL_ROUNDOFF * (fabs(t) + fabs(h));
        double estimate = 0.0, error = FAILED, beyond = 0.0;
        int status = length == 0.0 || !isfinite(length) ? DAL_ENOCONV
                                                       : attempt(self, t, length, &estimate);
        if (!status && is_time(self, t, length)) status = measure_share(self, t, length, estimate);
        if (!status) error = error_of(data, estimate, &beyond);
        if (!status && error > 1.0 && look_at_moves(self, t + length))
            error = error_of(data, estimate, &beyond);
        if (!status && error <= 1.0) {
            const double factor = change(data, error);
            const double next = length * (k > 1 ? fmin(factor, 1.0) : factor);
            /* a step that was cut short says less than the size that was meant */
            data->h = whole || fabs(next) > fabs(h) ? next : h;
            data->error = fmax(error, SMALLEST);
            motion->stats->uncontrolled += beyond > BEYOND;
            return DAL_SUCCESS;
        }
        if (!(error < FAILED)) error = FAILED;
        h = length * fmax(LEAST_AFTER_FAILURE, SAFETY * pow(error, -power));
        /* steps of some roundings of t would come closer to the edge of a domain for ever */
        const bool hopeless = k == ATTEMPTS || fabs(h) <= 16.0 * DAL_ROUNDOFF * fabs(t);
        dal__snapshot_restore(self, &self->variable.before);
        motion->t0 = t;
        motion->first = motion->steps;
        if (dal__is_final(status) || (hopeless && status)) return status;
        if (hopeless)
            return dal__fail(motion->error, DAL_ENOCONV, "no step is short enough: with h = %g the "
                             "estimated error is %g times the tolerance %g", length, error,
                             data->tolerance);
        motion->stats->rejected++;
    }
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    const dal__controlled *const data = self->control_data;
    (void)steps; /* one at a time */
    return dal__variable_advance(self, one_step, &data->h, made);
}

static void save(dal_stepper *self, dal__archive *a)
{
    dal__controlled *const data = self->control_data;
    dal__archive_same(a, "tolerance", data->tolerance);
    dal__archive_same(a, "h_max", data->h_max);
    dal__archive_ahead(a, &data->h);
    dal__archive_positive(a, &data->error);
    dal__archive_positive(a, &data->error_ratio);
    dal__archive_real(a, &data->seen);
}

const dal__step_control dal__controlled_steps = {
    .name = "error-controlled steps", .varies = true, .wanted = wanted, .make = make,
    .check = check, .start = start, .step = step, .save = save};
