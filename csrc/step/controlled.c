/* Error-controlled steps: each as long as its estimated error allows.
 *
 * The embedded estimate e = O(h^(q+1)) costs nothing, and says too much: the error of a step is
 * O(h^(p+1)), some 1e2 to 1e6 times less, as the system and its motion want it.  So the error is
 * taken as c e^a, a = (p+1)/(q+1), with a factor c that is measured now and then: two steps are
 * compared with one of twice the length, whose error is 2^p times theirs, far above roundoff.
 *
 * The tolerance is that of the state after some hundred steps: of one step it is a part.
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
/* The roundoff of an estimate is below so many u, times the sum of its weights: twice of what was
 * seen; and that of the difference of two states. */
#define ROUNDOFF 64.0
/* A steady error E leaves h as it is where SAFETY E^-((GAIN-MEMORY)/(p+1)) = 1: for an estimate of
 * roundoff to be below, the one that is allowed has to be 23 times as large for order 10, less for
 * others. */
#define FAR_FROM_NOISE 32.0
#define MOST_NOISE 1e4 /* in units of what it is where coordinates are of size 1 */
/* Steps after which c is measured: some at the beginning, then every so many.  It grows at once
 * and falls slowly, and until it is known it is large. */
enum { EARLY = 8, OFTEN = 64 };
#define FIRST_SHARE 1.0

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
    dal__pace *made, shape = {.q = q, .order = order, .noise = noise * ROUNDOFF * DAL_ROUNDOFF,
                              .tolerance = tolerance, .h_max = h_max,
                              .allowed = PART * pow(tolerance, (order + 1.0) / order)};
    dal__reserve(&self->vary.arena, &made, 1, sizeof *made);
    DAL__RESERVE(&self->vary.arena, 2 * self->mech.n, &shape.estimate, &shape.field);
    dal__snapshot_reserve(self, &shape.after, &self->vary.arena);
    status = dal__vary_make(self, error);
    if (status) return status;
    *made = shape;
    self->controlled = made;
    self->guards.allowed = tolerance;
    return DAL_SUCCESS;
}

static double longest(const dal__pace *pace)
{
    return pace->h_max > 0.0 ? pace->h_max : (double)INFINITY;
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
static int find_first(dal_stepper *self, double t, double ahead, const double *x, double *h)
{
    dal__pace *const pace = self->controlled;
    const size_t N = 2 * self->mech.n;
    double *const f = pace->estimate, *const there = self->vary.before.x;
    double *const change = pace->field;
    int status = dal_field(&self->mech, t, x, f);
    if (status) return status;
    const double tolerance = pace->tolerance;
    const double place = size(N, x, x) / tolerance, speed = size(N, x, f) / tolerance;
    const double small = place > 1e-5 && speed > 1e-5 ? 0.01 * place / speed : 1e-6;
    const double one = ahead * fmin(small, longest(pace));
    dal__move(N, x, one, f, there);
    double turn = 0.0;
    status = dal_field(&self->mech, t, there, change);
    if (status == DAL_EUSER) return status;
    for (size_t i = 0; i < N; i++) change[i] -= f[i];
    if (!status) turn = size(N, x, change) / tolerance / fabs(one);
    const double rate = fmax(speed, turn);
    const double two = rate > 1e-15 ? pow(0.01 / rate, 1.0 / (pace->q + 1.0)) : 1e3 * small;
    *h = ahead * fmin(fmin(100.0 * small, two), longest(pace));
    return DAL_SUCCESS;
}

static int start(dal_stepper *self, double t, double h, const double *x, double *first)
{
    dal__pace *const pace = self->controlled;
    const int status = isinf(h) ? find_first(self, t, copysign(1.0, h), x, first) : DAL_SUCCESS;
    if (status) return status;
    if (!isinf(h)) *first = h;
    pace->h = *first;
    pace->error = 1.0;
    pace->share = FIRST_SHARE;
    pace->seen = 0.0;
    return DAL_SUCCESS;
}

/* ---- a step --------------------------------------------------------------------------------- */

/* One step from t; *estimate <- the size of the embedded estimate. */
static int attempt(dal_stepper *self, double t, double h, double *estimate)
{
    dal__pace *const pace = self->controlled;
    dal_motion *const motion = &self->motion;
    motion->estimate = pace->estimate;
    const int status = dal__vary_step(self, t, h);
    motion->estimate = NULL;
    if (!status) *estimate = size(2 * self->mech.n, motion->x, pace->estimate);
    return status;
}

/* The roundoff of the estimate, as far as it is known. */
static double roundoff(const dal__pace *pace) { return fmax(pace->noise, pace->seen); }

/* The error of a step by its estimate, in units of what it may be.  An estimate that is roundoff is
 * so for any h: it has to look small, for the next step to be longer.  *beyond <- the same in units
 * of what the tolerance alone allows. */
static double error_of(const dal__pace *pace, double estimate, double *beyond)
{
    const double power = (pace->order + 1.0) / (pace->q + 1.0);
    const double least = pace->share * pow(FAR_FROM_NOISE * roundoff(pace), power);
    const double error = pace->share * pow(estimate, power);
    *beyond = error / pace->allowed;
    return error / fmax(pace->allowed, least);
}

/* What the estimates of a step and of one of twice the length tell of their roundoff: one that does
 * not grow with h is nothing else, as where coordinates have become large. */
static void look_at_roundoff(dal__pace *pace, double estimate, double twice)
{
    const bool grows = twice > estimate * pow(2.0, 0.5 * (pace->q + 1.0));
    const bool small = estimate < MOST_NOISE * pace->noise;
    pace->seen = grows || !small ? 0.5 * pace->seen : fmax(pace->seen, estimate);
}

/* Change of v by the rounding of q' and t, where D is not linear: no h makes an estimate
 * less.  Whether that was not known. */
static bool look_at_moves(dal_stepper *self, double t)
{
    dal__pace *const pace = self->controlled;
    dal_mechanics *const mech = &self->mech;
    const double *const v = self->motion.x + mech->n;
    if (mech->eval.system->def.kind == DAL_LINEAR) return false;
    if (dal__forms_at(mech, t, 0.0, self->motion.x, false)) return false;
    double unit = 0.0;
    for (size_t i = 0; i < mech->n; i++)
        unit = fmax(unit, mech->metric.unit[i] / (1.0 + fabs(v[i])));
    const double noise = pace->noise / ROUNDOFF * unit * dal__velocity_moves(mech, t, 0.0, v);
    if (!(noise > roundoff(pace) && noise < HUGE_VAL)) return false;
    pace->seen = noise;
    return true;
}

/* After a step of h from t: c by two steps and one of twice the length, whose error is
 * its difference to theirs; the motion stays where it is.  What is all roundoff, or cannot be made,
 * says nothing. */
static int measure_share(dal_stepper *self, double t, double h, double estimate)
{
    dal__pace *const pace = self->controlled;
    dal_motion *const motion = &self->motion;
    const size_t N = 2 * self->mech.n;
    double *const difference = pace->field;
    double twice;
    dal__snapshot_take(self, &pace->after);
    int status = attempt(self, t + h, h, &twice);
    if (!status) {
        memcpy(difference, motion->x, N * sizeof *difference);
        dal__snapshot_restore(self, &self->vary.before);
        status = attempt(self, t, 2.0 * h, &twice);
    }
    if (!status) {
        for (size_t i = 0; i < N; i++) difference[i] -= motion->x[i];
        const double error = size(N, motion->x, difference);
        const double share = error / pow(twice, (pace->order + 1.0) / (pace->q + 1.0));
        look_at_roundoff(pace, estimate, twice);
        if (twice > roundoff(pace) && error > ROUNDOFF * DAL_ROUNDOFF && share < HUGE_VAL)
            pace->share = pace->share == FIRST_SHARE || share > pace->share
                              ? share : sqrt(share * pace->share);
    }
    dal__snapshot_restore(self, &pace->after);
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
    const dal__pace *const pace = self->controlled;
    const double left = self->until - t;
    h = copysign(fmin(fabs(h), longest(pace)), h);
    if (fabs(h) >= fabs(left)) {
        const double last = dal__vary_last(self, t);
        if (t + last == self->until) return last;
        h = 0.75 * left; /* no number leads there from t, and from there one does */
    } else if (2.0 * fabs(h) > fabs(left)) {
        h = 0.5 * left;
    }
    return (t + h) - t;
}

/* The change of h after an error, of which the step before had another. */
static double change(const dal__pace *pace, double error)
{
    const double power = 1.0 / (pace->order + 1.0);
    return fmin(fmax(SAFETY * pow(fmax(error, SMALLEST), -GAIN * power)
                         * pow(pace->error, MEMORY * power), LEAST), MOST);
}

static int one_step(dal_stepper *self)
{
    dal__pace *const pace = self->controlled;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), power = 1.0 / (pace->order + 1.0);
    double h = pace->h;
    dal__snapshot_take(self, &self->vary.before);
    for (int k = 1;; k++) {
        const double length = fit(self, t, h);
        const bool whole = fabs(length) >= fabs(h) - 4.0 * DAL_ROUNDOFF * (fabs(t) + fabs(h));
        double estimate = 0.0, error = FAILED, beyond = 0.0;
        int status = length == 0.0 || !isfinite(length) ? DAL_ENOCONV
                                                       : attempt(self, t, length, &estimate);
        if (!status && is_time(self, t, length)) status = measure_share(self, t, length, estimate);
        if (!status) error = error_of(pace, estimate, &beyond);
        if (!status && error > 1.0 && look_at_moves(self, t + length))
            error = error_of(pace, estimate, &beyond);
        if (!status && error <= 1.0) {
            const double factor = change(pace, error);
            const double next = length * (k > 1 ? fmin(factor, 1.0) : factor);
            /* a step that was cut short says less than the size that was meant */
            pace->h = whole || fabs(next) > fabs(h) ? next : h;
            pace->error = fmax(error, SMALLEST);
            motion->stats->uncontrolled += beyond > BEYOND;
            return DAL_SUCCESS;
        }
        if (!(error < FAILED)) error = FAILED;
        h = length * fmax(LEAST_AFTER_FAILURE, SAFETY * pow(error, -power));
        /* steps of some roundings of t would come closer to the edge of a domain for ever */
        const bool hopeless = k == ATTEMPTS || fabs(h) <= 16.0 * DAL_ROUNDOFF * fabs(t);
        dal__snapshot_restore(self, &self->vary.before);
        motion->t0 = t;
        motion->first = motion->steps;
        if (dal__is_final(status) || (hopeless && status)) return status;
        if (hopeless)
            return dal__fail(motion->error, DAL_ENOCONV, "no step is short enough: with h = %g the "
                             "estimated error is %g times the tolerance %g", length, error,
                             pace->tolerance);
        motion->stats->rejected++;
    }
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    (void)steps; /* one at a time */
    return dal__vary_advance(self, one_step, &((const dal__pace *)self->controlled)->h, made);
}

static void save(dal_stepper *self, dal__archive *a)
{
    dal__pace *const pace = self->controlled;
    dal__archive_same(a, "tolerance", pace->tolerance);
    dal__archive_same(a, "h_max", pace->h_max);
    dal__archive_ahead(a, &pace->h);
    dal__archive_positive(a, &pace->error);
    dal__archive_positive(a, &pace->share);
    dal__archive_real(a, &pace->seen);
}

const dal__control dal__controlled_steps = {
    .name = "error-controlled steps", .varies = true, .wanted = wanted, .make = make,
    .check = check, .start = start, .step = step, .save = save};
