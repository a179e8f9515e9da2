/* Reversible steps: of h = eps / rho, where rho is a variable of its own, moved by
 *   rho += eps G(x),   G = dlog(sigma)/dt,
 * from the middle of a step to that of the next, so that it follows the rate sigma of the motion
 * (E. Hairer, G. Soederlind, SIAM J. Sci. Comput. 26 (2005) 1838).  G is odd in v and the schemes
 * are symmetric: with v turned round, or eps, the same steps lead back.
 *
 * There are two monitors sigma, with s^2 = |v|^2 + v0^2 and v0 a velocity of the start.  Where V_qq
 * is given and is not 0 at the start,
 *   sigma^2 = tr(C^-1 mu' M^-1 mu'^T) + hypot(|M^-1 V_qq|, |M^-1 V_q|^2 / s^2),
 * mu' the derivative of mu by the time less its part along mu, |A|^2 = tr(A A): how fast D turns,
 * and the rates of small oscillations, or, where V_qq vanishes on the way, what V_q does to v.
 * Else, by the acceleration a and the jerk j,
 *   sigma^2 = |a|^2 / s^2 + |j| / s.
 * Lengths are those of M.  So neither changes with mu -> B(q) mu, nor in other coordinates A q; and
 * with another unit of time they change as a rate does. */
#include "step/step.h"

#include <math.h>
#include <string.h>

/* G is a difference of two sigma, in the middles between x and where the motion is after +-REACH h.
 * A shorter way would put roundoff into G, and a much longer one the form of the motion. */
#define REACH 0x1p-4
/* This h is eps over the mean of the rho before and after x, found in so many passes: by the step
 * before alone the way back would have another G.  The jerk is that of the pass before. */
enum { PASSES = 2, PASSES_OF_JERK = 4 };
#define LEAST 0.02         /* of sigma at the start, since sigma may vanish */
#define MOST_RAISED 0x1p60 /* by how much a first guess of sigma may be too small */
/* With rho / sigma beyond these bounds eps was too large; rho, on its way to 0, is then reset.  For
 * all records it stays in 0.9 to 1.1 up to MOST_EPS. */
#define LOW 0.625
#define HIGH 1.6
#define MOST_EPS 0.2

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
        return dal__fail(error, DAL_EUNSUPPORTED, "reversible steps of \"%s\": they are those of "
                         "symmetric compositions with moved nodes, as bm4, bm6, leapfrog-kl8; a "
                         "pair of sub-steps costs less than to find its size", scheme->name);
    double sum = 0.0;
    for (size_t j = 0; j < count; j++) sum += fabs(dal__scheme_substep(scheme, j).fraction);
    *eps = fmin(MOST_EPS, 1.0 / sum);
    return DAL_SUCCESS;
}

/* What the system has for which reversible steps were not tried; NULL: nothing. */
static const char *untried(const dal_system *system)
{
    const dal_system_def *const def = &system->def;
    if (def->force) return "a force";
    if (!dal__is_autonomous(system)) return "functions of the time";
    if (!system->mass) return "a mass that depends on q, or terms of L that are linear "
                                 "in v";
    if (def->kind != DAL_LINEAR) return "constraints that are not linear";
    return def->sparsity ? "a sparsity" : NULL;
}

int dal__reversible_make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    dal__reversible *const of = &self->reversible;
    const size_t n = self->mech.n, mn = dal__times(self->mech.m, n);
    const char *const strange = untried(self->motion.system);
    double own;
    const int status = dal_scheme_eps(&self->scheme, &own, error);
    if (status) return status;
    if (options->tolerance != 0.0 || options->h_max != 0.0)
        return dal__fail(error, DAL_EINVAL, "options.eps = %g with tolerance = %g and h_max = %g: "
                         "these are of error-controlled steps; expected 0", options->eps,
                         options->tolerance, options->h_max);
    if (!(options->eps > 0.0 && options->eps <= MOST_EPS))
        return dal__fail(error, DAL_EINVAL, "options.eps = %g: expected a positive number up to "
                         "%g; that of \"%s\" is %.3g", options->eps, MOST_EPS, self->scheme.name,
                         own);
    if (strange)
        return dal__fail(error, DAL_EUNSUPPORTED, "reversible steps of the system \"%s\": it has "
                         "%s", dal_system_name(self->motion.system), strange);
    arena *const memory = &self->vary.arena;
    DAL__RESERVE(memory, mn, &of->frame, &of->raised, &of->turned);
    DAL__RESERVE(memory, mn > n ? mn : n, &of->scratch);
    DAL__RESERVE(memory, dal__times(n, n), &of->hessian, &of->scaled);
    DAL__RESERVE(memory, dal__times(2, n), &of->field, &of->away, &of->there);
    DAL__RESERVE(memory, n, &of->jerk);
    of->eps = options->eps;
    return dal__vary_make(self, error);
}

/* ---- D and V -------------------------------------------------------------------------------- */

/* The rows of mu[m*n] <- others of the same span, orthonormal in M^-1; raised[m*n] <- M^-1 times
 * them.  What is done to them is done to those of other[m*n], or NULL. */
static int make_orthonormal(dal_stepper *self, double *mu, double *raised, double *other)
{
    const size_t n = self->mech.n;
    for (size_t a = 0; a < self->mech.m; a++) {
        double *const row = mu + a * n, *const up = raised + a * n;
        for (size_t k = 0; k < 2 * a; k++) { /* twice all before it, for roundoff */
            const size_t b = k % a * n;
            const double part = dal__dot(n, row, raised + b);
            dal__add(n, -part, mu + b, row);
            if (other) dal__add(n, -part, other + b, other + a * n);
        }
        dal__accelerate(&self->mech, row, up);
        const double length = sqrt(dal__dot(n, row, up));
        if (!(length > 0.0 && isfinite(length)))
            return dal__fail(&self->mech.error, DAL_ESINGULAR, "row %zu of mu, less its part along "
                             "those before, has the length %g", a, length);
        for (size_t i = 0; i < n; i++) {
            row[i] /= length;
            up[i] /= length;
            if (other) other[a * n + i] /= length;
        }
    }
    return DAL_SUCCESS;
}

/* The sum of the squares in M^-1 of the rows of A[m*n], less their parts in the span of the frame;
 * A is destroyed. */
static double square_across(dal_stepper *self, const dal__reversible *of, double *A)
{
    const size_t n = self->mech.n, m = self->mech.m;
    double *const up = self->mech.step, sum = 0.0;
    for (size_t a = 0; a < m; a++) {
        double *const row = A + a * n;
        for (size_t k = 0; k < 2 * m; k++) {
            const size_t b = k % m * n;
            dal__add(n, -dal__dot(n, row, of->raised + b), of->frame + b, row);
        }
        dal__accelerate(&self->mech, row, up);
        sum += dal__dot(n, row, up);
    }
    return sum;
}

/* frame[m*n] <- the forms at q, orthonormal, raised[m*n] <- M^-1 times them. */
static int find_frame(dal_stepper *self, double t, const double *q, double *frame, double *raised)
{
    dal_mechanics *const mech = &self->mech;
    if (mech->m == 0) return DAL_SUCCESS;
    const int status =
        dal__constraint(&mech->eval, t, q, q, NULL, frame, NULL, NULL, &mech->error);
    return status ? status : make_orthonormal(self, frame, raised, NULL);
}

/* *turn <- the square of the angular velocity of D where q moves with w[n]. */
static int find_turn(dal_stepper *self, const dal__reversible *of, double t, const double *q,
                     const double *w, double *turn)
{
    dal_mechanics *const mech = &self->mech;
    const size_t n = mech->n, m = mech->m;
    double *const slopes = mech->forms.dmu, *const unit = of->jerk;
    *turn = 0.0;
    if (m == 0) return DAL_SUCCESS;
    for (size_t i = 0; i < n; i++) { /* d(mu e_i)/dq w is the derivative of mu_i */
        dal__clear(n, unit);
        unit[i] = 1.0;
        const int status = dal__constraint(&mech->eval, t, q, unit, NULL, i ? NULL : of->frame,
                                           slopes, NULL, &mech->error);
        if (status) return status;
        for (size_t a = 0; a < m; a++) of->turned[a * n + i] = dal__dot(n, slopes + a * n, w);
    }
    const int status = make_orthonormal(self, of->frame, of->raised, of->turned);
    if (!status) *turn = square_across(self, of, of->turned);
    return status;
}

/* What V does at q: |M^-1 V_qq|, and the square of |M^-1 V_q|. */
typedef struct pull {
    double size, square;
} pull;

static int find_pull(dal_stepper *self, const dal__reversible *of, double t, const double *q,
                     pull *at)
{
    dal_mechanics *const mech = &self->mech;
    const size_t n = mech->n;
    double sum = 0.0, *const V_q = mech->force, *const f = mech->step;
    *at = (pull){0};
    if (!mech->eval.system->def.potential) return DAL_SUCCESS;
    const int status = dal__potential(&mech->eval, t, q, NULL, V_q, of->hessian, &mech->error);
    if (status) return status;
    dal__accelerate(mech, V_q, f);
    at->square = dal__dot(n, V_q, f);
    for (size_t i = 0; i < n; i++)
        dal__accelerate(mech, of->hessian + i * n, of->scaled + i * n);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) sum += of->scaled[i * n + j] * of->scaled[j * n + i];
    at->size = sqrt(fmax(0.0, sum));
    return DAL_SUCCESS;
}

/* v^T M v. */
static double square(dal_stepper *self, const double *v)
{
    dal__weigh(&self->mech, v, self->mech.step);
    return dal__dot(self->mech.n, v, self->mech.step);
}

/* ---- sigma ---------------------------------------------------------------------------------- */

/* away <- where the motion leads from x, where its field and jerk are known, in a time. */
static void move(const dal_stepper *self, const dal__reversible *of, const double *x, double time)
{
    const size_t n = self->mech.n;
    for (size_t i = 0; i < n; i++) {
        of->away[i] = x[i] + time * (x[n + i] + 0.5 * time * of->field[n + i]);
        of->away[n + i] = x[n + i] + time * (of->field[n + i] + 0.5 * time * of->jerk[i]);
    }
}

/* sigma^2 by V, where D turns and the velocity is v. */
static double by_forms(dal_stepper *self, const dal__reversible *of, const pull *at, double turn,
                       const double *v)
{
    return turn + hypot(at->size, at->square / (square(self, v) + of->speed)) + of->floor;
}

/* sigma^2[2] <- that in the middle between x, where V does what at says, and where the motion is
 * after time and -time. */
static int look_at_forms(dal_stepper *self, const dal__reversible *of, double t, const double *x,
                         double time, const pull *at, double sigma2[2])
{
    const size_t n = self->mech.n;
    for (int side = 0; side < 2; side++) {
        pull there;
        move(self, of, x, side ? -time : time);
        int status = find_pull(self, of, t, of->away, &there);
        if (!status) status = find_frame(self, t, of->away, of->turned, of->scratch);
        if (status) return status;
        const pull mean = {0.5 * (at->size + there.size), 0.5 * (at->square + there.square)};
        for (size_t i = 0; i < n; i++) of->away[i] = 0.5 * (x[n + i] + of->away[n + i]);
        const double turn = square_across(self, of, of->turned) / (time * time);
        sigma2[side] = by_forms(self, of, &mean, turn, of->away);
    }
    return DAL_SUCCESS;
}

/* sigma^2 by the jerk, in the middle between x and away, a time apart. */
static double by_jerk(dal_stepper *self, const dal__reversible *of, const double *x, double time)
{
    const size_t n = self->mech.n;
    const double *const a0 = of->field + n, *const a1 = of->there + n;
    double *const w = self->mech.w;
    for (size_t i = 0; i < n; i++) w[i] = 0.5 * (x[n + i] + of->away[n + i]);
    const double s = sqrt(square(self, w) + of->speed);
    for (size_t i = 0; i < n; i++) w[i] = 0.5 * (a0[i] + a1[i]);
    const double a = square(self, w);
    for (size_t i = 0; i < n; i++) w[i] = (a1[i] - a0[i]) / time;
    return (a / s + sqrt(fmax(0.0, square(self, w)))) / s;
}

/* The same by the jerk, which is that of the pass before, and then of this one. */
static int look_at_jerk(dal_stepper *self, const dal__reversible *of, double t, const double *x,
                        double time, double sigma2[2])
{
    const size_t n = self->mech.n;
    double *const later = of->scratch;
    for (int side = 0; side < 2; side++) {
        move(self, of, x, side ? -time : time);
        const int status = dal_field(&self->mech, t, of->away, of->there);
        if (status) return status;
        if (side == 0) dal__copy(n, of->there + n, later);
        sigma2[side] = by_jerk(self, of, x, time) + of->floor;
    }
    for (size_t i = 0; i < n; i++) of->jerk[i] = (later[i] - of->there[n + i]) / (2.0 * time);
    return DAL_SUCCESS;
}

/* ---- starts --------------------------------------------------------------------------------- */

/* begin->rho <- sigma at x by the monitor by the jerk, from a first guess of it. */
static int start_by_jerk(dal_stepper *self, double t, const double *x, double guess,
                         dal__reversible *begin)
{
    double both[2];
    int status = dal_field(&self->mech, t, x, begin->field);
    dal__clear(self->mech.n, begin->jerk);
    for (int pass = 0; !status && pass < 2; pass++)
        status = look_at_jerk(self, begin, t, x, REACH * begin->eps / guess, both);
    if (!status) begin->rho = sqrt(0.5 * (both[0] + both[1]));
    return status;
}

int dal__reversible_land(dal_stepper *self, double t, const double *x, dal__reversible *begin)
{
    const double *const v = x + self->mech.n;
    pull at;
    double turn;
    begin->part = 0.0;
    if (begin->by_jerk) return start_by_jerk(self, t, x, begin->rho, begin);
    int status = find_pull(self, begin, t, x, &at);
    if (!status) status = find_turn(self, begin, t, x, v, &turn);
    if (!status) begin->rho = sqrt(by_forms(self, begin, &at, turn, v));
    return status;
}

/* *rate <- itself or a multiple 2^k of it, so that in a time of up to 1 / rate the motion from x,
 * where its field is known, changes the acceleration by at most half of itself, or of rate v. */
static int raise_rate(dal_stepper *self, const dal__reversible *of, double t, const double *x,
                      double *rate)
{
    const size_t n = self->mech.n;
    const double a2 = square(self, of->field + n), v2 = square(self, x + n);
    double *const change = self->mech.w, next = *rate * MOST_RAISED;
    dal__clear(n, of->jerk);
    for (const double least = *rate; next >= least; next *= 0.5) { /* the first such time */
        move(self, of, x, 1.0 / next);
        const int status = dal_field(&self->mech, t, of->away, of->there);
        if (status == DAL_EUSER) return status;
        for (size_t i = 0; i < n; i++) change[i] = of->there[n + i] - of->field[n + i];
        if (status || !(square(self, change) <= 0.25 * fmax(a2, next * next * v2))) break;
        *rate = next;
    }
    return DAL_SUCCESS;
}

/* *rate <- a first guess of sigma, without a scale of time: by V_qq, and how fast D turns with v,
 * or, from rest, with the acceleration. */
static int guess_rate(dal_stepper *self, const dal__reversible *of, double t, const double *x,
                      double *rate)
{
    const size_t n = self->mech.n;
    pull at;
    double turn, bend = 0.0;
    int status = find_pull(self, of, t, x, &at);
    if (!status) status = find_turn(self, of, t, x, x + n, &turn);
    if (!status) status = dal_field(&self->mech, t, x, of->field);
    if (!status) status = find_turn(self, of, t, x, of->field + n, &bend);
    if (status) return status;
    *rate = sqrt(at.size + turn + sqrt(bend));
    if (*rate > 0.0 && isfinite(*rate)) return raise_rate(self, of, t, x, rate);
    return dal__fail(&self->mech.error, DAL_EDOMAIN, "nothing at the initial state says how fast "
                     "the motion changes, and so how long a reversible step is (V_qq and the "
                     "turning of D have a rate of %g): start elsewhere, or take steps of h", *rate);
}

int dal__reversible_start(dal_stepper *self, double t, const double *x, dal__reversible *begin)
{
    const size_t n = self->mech.n;
    double rate;
    pull at;
    int status = guess_rate(self, begin, t, x, &rate);
    if (!status) status = find_pull(self, begin, t, x, &at);
    if (status) return status;
    begin->by_jerk = at.size == 0.0 || (self->motion.system->def.missing & DAL_MISSING_V_QQ);
    begin->speed = square(self, x + n) + square(self, begin->field + n) / (rate * rate);
    begin->floor = 0.0;
    begin->rho = rate;
    if (!(begin->speed > 0.0))
        return dal__fail(&self->mech.error, DAL_EDOMAIN, "the initial state is at rest and stays "
                         "there: a reversible step has no size");
    status = dal__reversible_land(self, t, x, begin);
    if (status) return status;
    const double least = LEAST * fmax(begin->rho, rate);
    begin->floor = least * least;
    begin->rho = hypot(begin->rho, least);
    return DAL_SUCCESS;
}

/* ---- steps ---------------------------------------------------------------------------------- */

/* *change <- that of rho between the middles of the last step and the next, *sigma <- at x. */
static int find_change(dal_stepper *self, double t, double *change, double *sigma)
{
    const dal__reversible *const of = &self->reversible;
    const double *const x = self->motion.x;
    const bool forms = !of->by_jerk;
    double mean = of->rho;
    pull at = {0};
    int status = dal_field(&self->mech, t, x, of->field);
    dal__clear(self->mech.n, of->jerk);
    if (!status && forms) status = find_pull(self, of, t, x, &at);
    if (!status && forms) status = find_frame(self, t, x, of->frame, of->raised);
    for (int pass = 0; !status && pass < (forms ? PASSES : PASSES_OF_JERK); pass++) {
        const double time = REACH * of->eps / mean;
        double both[2];
        status = forms ? look_at_forms(self, of, t, x, time, &at, both)
                       : look_at_jerk(self, of, t, x, time, both);
        if (status) break;
        const double later = sqrt(both[0]), sooner = sqrt(both[1]);
        *sigma = 0.5 * (later + sooner);
        *change = dal__stepper_ahead(self) * of->eps * (later - sooner) / (*sigma * time);
        mean = of->rho + 0.5 * *change;
        if (!(mean >= LOW * *sigma)) mean = *sigma;
    }
    *change *= 0.5 * (of->part + 1.0);
    return status;
}

int dal__reversible_step(dal_stepper *self)
{
    dal__reversible *const of = &self->reversible;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), left = self->vary.until - t;
    double change = 0.0, sigma = 0.0;
    motion->error->text[0] = '\0';
    int status = find_change(self, t, &change, &sigma);
    if (status) return status;
    const double next = of->rho + change;
    const bool reset = !(next >= LOW * sigma && next <= HIGH * sigma);
    const double rho = reset ? sigma : next;
    const double whole = dal__stepper_ahead(self) * of->eps / rho;
    /* what would be left of 1e-9 h is not worth a step */
    const bool last = fabs(whole) >= (1.0 - 1e-9) * fabs(left);
    const double h = last ? dal__vary_last(self, t) : (t + whole) - t;
    if (!(fabs(h) > 0.0 && isfinite(h)))
        return dal__fail(motion->error, DAL_EDOMAIN, "sigma = %g: a step of h = %g from t = %.17g "
                         "is none", sigma, whole, t);
    dal__remember(self, &self->vary.before);
    status = dal__vary_step(self, t, h);
    if (status) {
        dal__go_back(self, &self->vary.before);
        return status;
    }
    of->rho = rho;
    of->part = last ? fmin(1.0, h / whole) : 1.0;
    if (reset) motion->stats->resets++;
    return DAL_SUCCESS;
}
