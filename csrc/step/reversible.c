/* Reversible steps: of h = eps / rho, where rho is a variable of its own, moved by
 *   rho += eps G(x),   G = dlog(sigma)/dt,
 * from the middle of a step to that of the next, so that it follows the rate sigma of the motion
 * (E. Hairer, G. Soederlind, SIAM J. Sci. Comput. 26 (2005) 1838).  G is odd in v and the schemes
 * are symmetric: with v turned round, or eps, the same steps lead back.
 *
 * The rate, by the acceleration a and the jerk j, lengths being those of M, is
 *   sigma^2 = own^2 + fastest^2 (LEAST^2 + BY_SPEED^2 |v|^2 / v0^2),
 *   own^4 = (|a|^2 / s^2)^2 + (|j| / s)^2,   s^2 = |v|^2 + v0^2,
 * where v0 and fastest are the largest |v| and own so far.  The last term bounds the distance of a
 * step: own vanishes where nothing pushes, just before a wall too.  sigma is smooth where own is
 * not 0, or rho would lose it: G says nothing of a jump.
 *
 * Neither a start nor a first encounter has a scale.  A step that was too long, by the embedded
 * estimate of its error or by sigma where it ends, is made again by half; so steps may begin with
 * any size, and grow to that of sigma. */
#include "step/reversible.h"

#include "step/scheme.h"
#include "step/stepper.h"

#include <math.h>

/* G is a difference of two sigma, in the middles between x and where the motion is after +-REACH h.
 * A shorter way would put roundoff into G, and a much longer one the form of the motion. */
#define REACH 0x1p-4
/* This h is eps over the mean of the rho before and after x, found, as the jerk is, in so many
 * passes.  Using only the previous step would make G differ in the reverse direction. */
enum { PASSES = 4 };
#define LEAST 0.02
#define BY_SPEED 0.36 /* a rate that crosses 0 then changes by at most half of itself in a step */
/* With rho / sigma beyond these bounds eps was too large.  For all records it stays in 0.9 to 1.1
 * up to MOST_EPS. */
#define LOW 0.625
#define HIGH 1.6
#define MOST_EPS 0.2
#define USUAL 0.8 /* of 1 over the sum of the sizes of the sub-steps: the energy is kept to 1e-6 */
/* Largest estimated error of a step, in units of s: of a step of REGULAR times of the motion, or of
 * MOST_ERROR; and the part of it that is allowed while the scales are being found. */
#define MOST_ERROR 1e-3
#define REGULAR 0.25
#define FIRST_PART 0.01
#define ROUNDOFF 64.0   /* of an estimate, as in controlled.c */
#define NEW_SCALE 1.05  /* growth of the square of a scale in a step that makes it so */
#define FIRST 1e-4      /* the first step, in times that the initial state has */
enum { ATTEMPTS = 200 };

/* ---- which steps ---------------------------------------------------------------------------- */

/* Whether the sub-steps read backwards are the adjoints of theirs. */
static bool is_palindrome(const dal_scheme *scheme)
{
    const size_t count = dal__scheme_count(scheme);
    for (size_t j = 0; j < count; j++) {
        const dal_substep one = dal__scheme_substep(scheme, j);
        const dal_substep other = dal__scheme_substep(scheme, count - 1 - j);
        if (one.beta + other.beta != 1.0 || fabs(one.fraction - other.fraction) > 1e-14)
            return false;
    }
    return true;
}

int dal_scheme_eps(const dal_scheme *scheme, double *eps, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"scheme", scheme}, {"eps", eps});
    if (status) return status;
    const size_t count = dal__scheme_count(scheme);
    if (!dal__scheme_family(scheme)->rescale || count < 3 || scheme->nodes != DAL_MOVED_NODES
        || !is_palindrome(scheme))
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support reversible "
                         "steps; choose a symmetric composition of at least three sub-steps with "
                         "moved nodes, for example bm4, bm6 or leapfrog-kl8", scheme->name);
    double sum = 0.0;
    for (size_t j = 0; j < count; j++) sum += fabs(dal__scheme_substep(scheme, j).fraction);
    *eps = fmin(MOST_EPS, USUAL / sum);
    return DAL_SUCCESS;
}

/* What the system has for which reversible steps were not tried; NULL: nothing. */
static const char *untried(const dal_system *system)
{
    const dal_system_def *const def = &system->def;
    if (def->force) return "a force";
    if (def->driven) return "inputs in its constraints";
    if (!dal__is_autonomous(system)) return "an explicit dependence on time";
    if (!system->mass) return "a mass that depends on q, or terms of L that are linear "
                                 "in v";
    if (def->kind != DAL_LINEAR) return "constraints that are not linear";
    return def->sparsity ? "a sparsity" : NULL;
}

static bool wanted(const dal_options *options) { return options->eps != 0.0; }

static int make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    const size_t n = self->mech.n;
    const char *const strange = untried(self->motion.system);
    double own;
    const int status = dal_scheme_eps(&self->scheme, &own, error);
    if (status) return status;
    if (options->tolerance != 0.0 || options->h_max != 0.0)
        return dal__fail(error, DAL_EINVAL, "options.eps = %g with tolerance = %g and h_max = %g: "
                         "expected 0 for both, which are for error-controlled steps", options->eps,
                         options->tolerance, options->h_max);
    if (!(options->eps > 0.0 && options->eps <= MOST_EPS))
        return dal__fail(error, DAL_EINVAL, "options.eps = %g: expected a positive number up to "
                         "%g; the default for \"%s\" is %.3g", options->eps, MOST_EPS,
                         self->scheme.name, own);
    if (strange)
        return dal__fail(error, DAL_EUNSUPPORTED, "system \"%s\" does not support reversible "
                         "steps, because it has %s", dal_system_name(self->motion.system),
                         strange);
    double noise = 0.0;
    int q = 0;
    const int seen = self->family->estimates(self->method, &q, &noise, error);
    if (seen) return seen;
    if (q == 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support reversible "
                         "steps, because it has no error estimate; choose a composition of one "
                         "map, for example bm6", self->scheme.name);
    dal__reversible *made, shape = {.eps = options->eps,
                                    .most_error = fmax(MOST_ERROR, pow(REGULAR, q + 1.0)),
                                    .noise = noise * ROUNDOFF * DAL_ROUNDOFF};
    dal__reserve(&self->variable.arena, &made, 1, sizeof *made);
    DAL__RESERVE(&self->variable.arena, dal__times(2, n), &shape.field, &shape.away, &shape.there,
                 &shape.jerk, &shape.estimate);
    const int failed = dal__variable_make(self, error);
    if (failed) return failed;
    *made = shape;
    self->control_data = made;
    return DAL_SUCCESS;
}

static int check(dal_stepper *self, double t, double h)
{
    if (isinf(h)) return dal__stepper_check_times(self, t, copysign(fmax(1.0, fabs(t)), h));
    return dal__fail(&self->error, DAL_EINVAL, "h = %g: expected INFINITY or -INFINITY, the "
                     "direction of reversible steps, which find their own size", h);
}

/* ---- sigma ---------------------------------------------------------------------------------- */

/* |w|^2 = w^T M w. */
static double square(dal_stepper *self, const double *w)
{
    dal__weigh(&self->mech, w, self->mech.step);
    return dal__dot(self->mech.n, w, self->mech.step);
}

/* own^2 and |v|^2 in the middle between x, where the field is known, and a time later. */
typedef struct rates {
    double own2, v2;
} rates;

static int look(dal_stepper *self, double t, double time, double v02, rates *at)
{
    const dal__reversible *const of = self->control_data;
    const size_t n = self->mech.n;
    const double *const x = self->motion.x, *const a0 = of->field + n, *const a1 = of->there + n;
    double *const w = self->mech.w;
    for (size_t i = 0; i < n; i++) { /* without the jerk v leaves D, where a depends on mu */
        of->away[i] = x[i] + time * (x[n + i] + 0.5 * time * a0[i]);
        of->away[n + i] = x[n + i] + time * (a0[i] + 0.5 * time * of->jerk[i]);
    }
    const int status = dal_field(&self->mech, t, of->away, of->there);
    if (status) return status;
    for (size_t i = 0; i < n; i++) w[i] = 0.5 * (x[n + i] + of->away[n + i]);
    at->v2 = square(self, w);
    const double s2 = at->v2 + v02;
    for (size_t i = 0; i < n; i++) w[i] = 0.5 * (a0[i] + a1[i]);
    const double a2 = square(self, w);
    for (size_t i = 0; i < n; i++) w[i] = (a1[i] - a0[i]) / time;
    dal__add(n, 0.5, w, of->jerk + n);
    at->own2 = hypot(a2 / s2, sqrt(square(self, w) / s2));
    return DAL_SUCCESS;
}

/* after, a copy of what the motion knew before its last step, <- with the scales of its state now;
 * *sigma <- the rate there, *change <- that of rho in a whole step. */
static int measure(dal_stepper *self, double t, dal__reversible *after, double *sigma,
                   double *change)
{
    const size_t n = self->mech.n;
    double mean = after->rho;
    dal__clear(2 * n, after->jerk);
    int status = dal_field(&self->mech, t, self->motion.x, after->field);
    after->speed = fmax(after->speed, square(self, self->motion.x + n));
    for (int pass = 0; !status && pass < PASSES; pass++) {
        const double time = REACH * after->eps / mean;
        rates side[2] = {{0}};
        double rate[2];
        for (int k = 0; !status && k < 2; k++)
            status = look(self, t, k ? -time : time, after->speed, &side[k]);
        dal__copy(n, after->jerk + n, after->jerk);
        dal__clear(n, after->jerk + n);
        if (after->fastest > 0.0)
            after->fastest = fmax(after->fastest, 0.5 * (side[0].own2 + side[1].own2));
        for (int k = 0; k < 2; k++)
            rate[k] = sqrt(side[k].own2
                           + after->fastest * (LEAST * LEAST
                                               + BY_SPEED * BY_SPEED * side[k].v2 / after->speed));
        *sigma = 0.5 * (rate[0] + rate[1]);
        *change = *sigma > 0.0 ? dal__stepper_direction(self) * after->eps * (rate[0] - rate[1])
                                     / (*sigma * time) : 0.0;
        mean = after->rho + 0.5 * *change;
        if (!(mean >= LOW * after->rho)) mean = after->rho;
    }
    return status;
}

/* ---- steps ---------------------------------------------------------------------------------- */

static int start(dal_stepper *self, double t, double h, const double *x, double *first)
{
    const size_t n = self->mech.n;
    dal__reversible *const begin = self->control_data;
    const int status = dal_field(&self->mech, t, x, begin->field);
    if (status) return status;
    const double q = sqrt(square(self, x)), v = sqrt(square(self, x + n));
    const double a = sqrt(square(self, begin->field + n));
    if (v == 0.0 && a == 0.0)
        return dal__fail(&self->mech.error, DAL_EDOMAIN, "the initial state is at rest and stays "
                         "there, so reversible steps have no size; use a fixed h");
    const double times[] = {q / v, sqrt(q / a)};
    double time = HUGE_VAL;
    for (size_t i = 0; i < DAL_LENGTH(times); i++)
        if (times[i] > 0.0) time = fmin(time, times[i]);
    time = fmax(FIRST * (isinf(time) ? 1.0 : time), 0x1p-40 * fabs(t));
    begin->rho = begin->eps / time;
    begin->speed = begin->fastest = 0.0;
    begin->settled = false;
    *first = copysign(begin->eps / begin->rho, h);
    return DAL_SUCCESS;
}

/* One step of h from t; *error <- its size beyond roundoff, *after, *sigma and *change as in
 * measure. */
static int attempt(dal_stepper *self, double t, double h, double *error, dal__reversible *after,
                   double *sigma, double *change)
{
    dal_motion *const motion = &self->motion;
    motion->estimate = after->estimate;
    int status = dal__variable_step(self, t, h);
    motion->estimate = NULL;
    if (!status) status = measure(self, t, after, sigma, change);
    if (status) return status;
    for (size_t i = 0; i < 2 * self->mech.n; i++) {
        const double size = fabs(after->estimate[i]) - after->noise * fabs(motion->x[i]);
        after->estimate[i] = copysign(fmax(size, 0.0), after->estimate[i]);
    }
    const double q2 = square(self, after->estimate) / (h * h);
    const double v2 = square(self, after->estimate + self->mech.n);
    *error = sqrt(fmax(q2, v2) / after->speed);
    return DAL_SUCCESS;
}

static int one_step(dal_stepper *self)
{
    dal__reversible *const of = self->control_data;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), left = self->until - t;
    dal__reversible now = *of;
    size_t resets = 0;
    dal__snapshot_take(self, &self->variable.before);
    for (int k = 1;; k++) {
        const double whole = dal__stepper_direction(self) * now.eps / now.rho;
        /* what would be left of 1e-9 h is not worth a step */
        const bool last = fabs(whole) >= (1.0 - 1e-9) * fabs(left);
        const double h = last ? dal__variable_last(self, t) : (t + whole) - t;
        dal__reversible after = now;
        double error = 0.0, sigma = 0.0, change = 0.0;
        int status = DAL_EDOMAIN;
        if (fabs(h) > 0.0 && isfinite(h))
            status = attempt(self, t, h, &error, &after, &sigma, &change);
        const bool scaled = now.fastest > 0.0;
        const bool learns = !now.settled || after.fastest > NEW_SCALE * now.fastest
                         || after.speed > NEW_SCALE * now.speed;
        if (!status && error <= now.most_error * (learns ? FIRST_PART : 1.0)
            && (!scaled || now.rho >= LOW * sigma)) {
            const double part = last ? fmin(1.0, h / whole) : 1.0; /* rho is of the middle */
            double next = now.rho + part * change;
            const bool lost = !(next >= LOW * sigma && next <= HIGH * sigma);
            if (lost || learns) {
                next = scaled ? sigma + 0.5 * change : 0.0;
                after.settled = next >= 0.5 * now.rho; /* steps grow by no more */
                if (!after.settled) next = 0.5 * now.rho;
            }
            resets += lost && !learns;
            after.rho = next;
            *of = after;
            motion->stats->resets += resets;
            return DAL_SUCCESS;
        }
        dal__snapshot_restore(self, &self->variable.before);
        const bool hopeless = k == ATTEMPTS || !(fabs(h) > 16.0 * DAL_ROUNDOFF * fabs(t));
        if (dal__is_final(status) || (hopeless && motion->error->text[0])) return status;
        if (hopeless)
            return dal__fail(motion->error, DAL_ENOCONV, "no reversible step from t = %.17g is "
                             "short enough: with h = %g the estimated error is %g of the motion; "
                             "its rate of change is %g", t, h, error, sigma);
        motion->stats->rejected++;
        now.rho = 2.0 * now.eps / fabs(h);
        resets += !learns;
        now.fastest = fmax(now.fastest, now.rho * now.rho / 16.0);
    }
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    (void)steps; /* one at a time */
    return dal__variable_advance(self, one_step, &self->motion.h, made);
}

static void land(dal_stepper *self) { ((dal__reversible *)self->control_data)->settled = false; }

static void save(dal_stepper *self, dal__archive *a)
{
    dal__reversible *const of = self->control_data;
    dal__archive_same(a, "eps", of->eps);
    dal__archive_positive(a, &of->rho);
    dal__archive_size(a, &of->speed);
    dal__archive_size(a, &of->fastest);
    dal__archive_flag(a, &of->settled);
}

const dal__step_control dal__reversible_steps = {
    .name = "reversible steps", .varies = true, .wanted = wanted, .make = make, .check = check,
    .start = start, .step = step, .land = land, .save = save};
