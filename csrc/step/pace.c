/* Error-controlled steps: each as long as its embedded estimate of the error allows.
 *
 * A step begins where the one before ended, at t0, and its h is the difference of two times, t0 and
 * the rounded t0 + h: so times do not gather roundoff, whatever the steps. */
#include "step/step.h"

#include <math.h>
#include <string.h>

/* h changes by SAFETY e^-(GAIN/(q+1)) of the error e in units of the tolerance, and the memory of
 * the step before; within limits. */
#define SAFETY 0.9
#define GAIN 0.7
#define MEMORY 0.4
#define LEAST 0.2
#define MOST 5.0
#define LEAST_AFTER_FAILURE 0.1
/* An error that says nothing about h: of roundoff, or of a step that failed. */
#define SMALLEST 1e-4
#define FAILED 1e10
enum { ATTEMPTS = 60 };
#define MOST_TOLERANCE 0.1
/* The roundoff of an estimate is below so many u, times the sum of its weights: twice of what was
 * seen.  The tolerance is at least four times that. */
#define ROUNDOFF 64.0

int dal__pace_make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    dal__pace *const pace = &self->pace;
    const dal_family *const family = self->family;
    const double tolerance = options ? options->tolerance : 0.0;
    const double h_max = options ? options->h_max : 0.0;
    if (tolerance == 0.0 && h_max == 0.0) return DAL_SUCCESS;
    if (!(h_max >= 0.0))
        return dal__fail(error, DAL_EINVAL, "options.h_max = %g: expected a positive number, or 0 "
                         "for none", h_max);
    if (self->scheme.nodes == DAL_KEPT_NODES)
        return dal__fail(error, DAL_EUNSUPPORTED, "error-controlled steps of \"%s\": its D_eps "
                         "depends on h, so that each step would leave that of the one before",
                         self->scheme.name);
    double noise = 0.0;
    int q = 0, status = DAL_SUCCESS;
    if (family->estimates) status = family->estimates(self->method, &q, &noise, error);
    if (status) return status;
    if (q == 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "error-controlled steps of \"%s\": it has no "
                         "estimate of its error; compositions have one, as leapfrog-kl8",
                         self->scheme.name);
    noise *= ROUNDOFF * DAL_ROUNDOFF;
    if (!(tolerance >= 4.0 * noise && tolerance <= MOST_TOLERANCE))
        return dal__fail(error, DAL_EINVAL, "options.tolerance = %g: expected %.2g, below which "
                         "the estimate of \"%s\" is roundoff, to %g", tolerance, 4.0 * noise,
                         self->scheme.name, MOST_TOLERANCE);
    pace->q = q;
    pace->noise = noise / tolerance;
    const size_t N = 2 * self->mech.n, kept = family->save ? family->save(self->method, NULL) : 0;
    DAL__RESERVE(&pace->arena, N, &pace->estimate, &pace->field);
    DAL__RESERVE(&pace->arena, N + self->mech.m, &pace->before);
    DAL__RESERVE(&pace->arena, kept, &pace->memory);
    pace->tolerance = tolerance;
    pace->h_max = h_max > 0.0 ? h_max : (double)INFINITY;
    return dal__allocate(&pace->arena, error);
}

void dal__pace_start(dal_stepper *self)
{
    if (self->pace.q == 0) return;
    self->pace.h = self->motion.h;
    self->pace.error = 1.0;
    self->pace.until = copysign((double)INFINITY, self->motion.h);
}

/* ---- the first step ------------------------------------------------------------------------- */

/* The largest component of a rate of x[2n], in units of the tolerance of a step. */
static double size(const dal_stepper *self, const double *x, const double *rate)
{
    const size_t N = 2 * self->mech.n;
    double largest = 0.0;
    for (size_t i = 0; i < N; i++) largest = fmax(largest, fabs(rate[i]) / (1.0 + fabs(x[i])));
    return largest / self->pace.tolerance;
}

/* A first step by the rates of x and of its rates (Hairer, Norsett, Wanner 1993, II.4). */
int dal__pace_first(dal_stepper *self, double t, double ahead, const double *x, double *h)
{
    dal__pace *const pace = &self->pace;
    const size_t N = 2 * self->mech.n;
    double *const f = pace->estimate, *const there = pace->before, *const change = pace->field;
    int status = dal_field(&self->mech, t, x, f);
    if (status) return status;
    const double place = size(self, x, x), speed = size(self, x, f);
    const double small = place > 1e-5 && speed > 1e-5 ? 0.01 * place / speed : 1e-6;
    const double one = ahead * fmin(small, pace->h_max);
    dal__move(N, x, one, f, there);
    double turn = 0.0;
    status = dal_field(&self->mech, t + one, there, change);
    if (status == DAL_EUSER) return status;
    for (size_t i = 0; i < N; i++) change[i] -= f[i];
    if (!status) turn = size(self, x, change) / fabs(one);
    const double rate = fmax(speed, turn);
    const double two = rate > 1e-15 ? pow(0.01 / rate, 1.0 / (pace->q + 1.0)) : 1e3 * small;
    *h = ahead * fmin(fmin(100.0 * small, two), pace->h_max);
    return DAL_SUCCESS;
}

/* ---- a step --------------------------------------------------------------------------------- */

/* What is remembered of the steps before, to begin one again. */
static void remember(dal_stepper *self)
{
    dal__pace *const pace = &self->pace;
    const dal_motion *const motion = &self->motion;
    const size_t N = 2 * self->mech.n;
    memcpy(pace->before, motion->x, N * sizeof *pace->before);
    memcpy(pace->before + N, motion->impulse, self->mech.m * sizeof *pace->before);
    pace->worst = motion->stats->worst_residual;
    if (self->family->save) self->family->save(self->method, pace->memory);
}

static void take_back(dal_stepper *self)
{
    dal__pace *const pace = &self->pace;
    dal_motion *const motion = &self->motion;
    const size_t N = 2 * self->mech.n;
    memcpy(motion->x, pace->before, N * sizeof *pace->before);
    memcpy(motion->impulse, pace->before + N, self->mech.m * sizeof *pace->before);
    motion->stats->steps = motion->steps;
    motion->stats->worst_residual = pace->worst;
    if (self->family->restore) self->family->restore(self->method, pace->memory);
}

/* One attempt from t; *error <- in units of the tolerance. */
static int attempt(dal_stepper *self, double t, double h, double *error)
{
    dal__pace *const pace = &self->pace;
    dal_motion *const motion = &self->motion;
    const size_t N = 2 * self->mech.n;
    size_t done = 0;
    if (self->family->rescale) self->family->rescale(self->method, h / motion->h);
    motion->t0 = t;
    motion->h = h;
    motion->first = motion->steps;
    motion->estimate = pace->estimate;
    motion->error->text[0] = '\0';
    const int status = self->family->advance(self->method, motion, 1, &done);
    motion->estimate = NULL;
    *error = FAILED;
    if (status) return status;
    *error = 0.0;
    for (size_t i = 0; i < N; i++) {
        const double e = fabs(pace->estimate[i]) / (1.0 + fabs(motion->x[i]));
        if (!(e <= *error)) *error = isnan(e) ? HUGE_VAL : e;
    }
    *error /= pace->tolerance;
    return DAL_SUCCESS;
}

/* The length of a step of about h from t: not beyond the end, nor so that a short one is left. */
static double fit(const dal__pace *pace, double t, double h)
{
    const double left = pace->until - t;
    if (fabs(h) > pace->h_max) h = copysign(pace->h_max, h);
    if (fabs(h) < fabs(left)) {
        if (2.0 * fabs(h) > fabs(left)) h = 0.5 * left;
        return (t + h) - t;
    }
    for (int ahead = -1; ahead <= 1; ahead += 2) { /* t + left may be rounded to its neighbour */
        const double next = nextafter(left, ahead * (double)INFINITY);
        if (t + left != pace->until && t + next == pace->until) return next;
    }
    return left;
}

/* The change of h after an error, of which the step before had another. */
static double change(const dal__pace *pace, double error)
{
    const double power = 1.0 / (pace->q + 1.0);
    return fmin(fmax(SAFETY * pow(fmax(error, SMALLEST), -GAIN * power)
                         * pow(pace->error, MEMORY * power), LEAST), MOST);
}

int dal__pace_step(dal_stepper *self)
{
    dal__pace *const pace = &self->pace;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), last = motion->h;
    double h = pace->h, error = 0.0, power = 1.0 / (pace->q + 1.0);
    remember(self);
    for (int k = 1;; k++) {
        const double length = fit(pace, t, h);
        const bool whole = fabs(length) >= fabs(h) * (1.0 - 1e-9);
        int status = length == 0.0 || !isfinite(length) ? DAL_ENOCONV
                                                       : attempt(self, t, length, &error);
        if (!status && error <= 1.0) {
            const double wanted = change(pace, error);
            /* where it is all roundoff a shorter step would gain nothing */
            const double factor = error <= pace->noise ? fmax(wanted, 1.0) : wanted;
            const double next = length * (k > 1 ? fmin(factor, 1.0) : factor);
            /* a step that was cut short says less than the size that was meant */
            pace->h = whole || fabs(next) > fabs(h) ? next : h;
            pace->error = fmax(error, SMALLEST);
            return DAL_SUCCESS;
        }
        const bool hopeless = k == ATTEMPTS || fabs(length) <= 16.0 * DAL_ROUNDOFF * fabs(t);
        take_back(self);
        motion->t0 = t;
        motion->h = last;
        motion->first = motion->steps;
        if (status == DAL_EUSER || status == DAL_STOPPED || status == DAL_EINVAL) return status;
        if (hopeless && status) return status;
        if (hopeless)
            return dal__fail(motion->error, DAL_ENOCONV, "a step of h = %g has an estimated error "
                             "of %g times the tolerance %g", length, error, pace->tolerance);
        if (!(error < FAILED)) error = FAILED;
        h = length * fmax(LEAST_AFTER_FAILURE, SAFETY * pow(error, -power));
        motion->stats->rejected++;
    }
}

int dal_stepper_until(dal_stepper *stepper, double t)
{
    if (!stepper) return DAL_EINVAL;
    dal_error *const error = &stepper->error;
    if (stepper->pace.q == 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "the steps are of h, without error control: "
                         "they end where they end");
    const int status = dal__stepper_started(stepper);
    if (status) return status;
    const double now = dal_stepper_time(stepper), ahead = stepper->pace.h > 0.0 ? 1.0 : -1.0;
    if (!(ahead * (t - now) >= 0.0))
        return dal__fail(error, DAL_EINVAL, "t = %g lies before the time of the stepper, %g, in "
                         "the direction of its steps", t, now);
    stepper->pace.until = t;
    return DAL_SUCCESS;
}
