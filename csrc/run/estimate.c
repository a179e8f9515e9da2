/* Whether h is too large: an estimate of the error of the state at the end of a run.
 *
 * Some steps are computed again, from a state of the run, with the size r h.  For order p the two
 * final states differ by |r^p - 1| times the error of the steps of h.
 *
 * 1. A run of SHORT steps or more is sampled: r = 2 in windows of some dozens of steps.  The errors
 *    are interpolated between the windows and added up, as if none grew or died out.  The sum is
 *    the estimate if it is at most SUSPECTED and the state has not grown by GROWN since.
 * 2. Otherwise, and for shorter runs, the whole run or its first MOST steps are computed again.
 *    The first r is 8, 4 or 2, where an error of CLEAR gives a difference of about a sixth.  The
 *    estimate is accepted if it is at most CLEAR, at the end and at the marks on the way.
 * 3. Otherwise r is halved, down to 1/2: long steps can be too inaccurate to compare with, or
 *    unstable where those of h are not.  The last r whose steps converge gives the estimate.
 *
 * Windows can miss short and violent phases, as when a disc falls nearly flat.  Case 2 therefore
 * also applies if the energy of a conservative system, checked every 64 steps, is off by CHANGED of
 * the largest kinetic energy, or if some 64 steps need TOILED times as many iterations as others.
 *
 * The error is INFINITY if no other step converges.
 *
 * A part of the run is estimated after a reset (case 2), and in a resumed run.  Its error is no
 * estimate for the whole run, and is reported only if it exceeds DAL_LARGE_ERROR.
 *
 * Inputs may change from step to step, so that r > 1 is impossible: windows use r = 1/2, then
 * case 3 applies.  The motion is restored afterwards: see remake.c. */
#include "run/events.h"
#include "run/run.h"

#include <math.h>
#include <string.h>

enum {
    SHORT = 1000,  /* a run of fewer steps is computed again as a whole */
    LEAST = 6,     /* runs of fewer steps have no estimate */
    FOLD = 8,      /* the largest r, and the steps between the first marks */
    MOST = 8192 * DAL__MARKS, /* of a piece that is computed again; 2^k FOLD DAL__MARKS */
    WINDOW = 24,   /* steps of the first windows; later ones grow as the root of the step number */
    APART = 24,    /* distance of windows in windows: 2 % more steps */
    APART_HALVED = 60,
    LOOKS = 16,    /* updates of the sizes while the number of steps grows by a factor e */
};
static const double SUSPECTED = 0.002, CHANGED = 0.01, TOILED = 2.5;
static const double CLEAR = 0.01, NEAR = 0.15; /* the error; the difference that shows it */
static const double GROWN = 10.0;      /* growth of the sizes since the last window */
static const double SMALL = 1e-3;      /* least size, by the largest of the q, or of the v */
static const double RESOLUTION = 1e-9; /* least size, relative to the largest coordinate */

/* ---- sizes ------------------------------------------------------------------------------ */

static void see(dal__estimate *g, size_t n, const double *x)
{
    for (size_t i = 0; i < 2 * n; i++) {
        g->low[i] = fmin(g->low[i], x[i]);
        g->high[i] = fmax(g->high[i], x[i]);
    }
}

/* The size of entry i of a state: the range of a q, the largest |v|. */
static double size_of(const dal__estimate *g, size_t n, size_t i)
{
    return i < n ? g->high[i] - g->low[i] : fmax(fabs(g->low[i]), fabs(g->high[i]));
}

/* The largest size among the n entries from `begin` on. */
static double largest(const dal__estimate *g, size_t n, size_t begin)
{
    double found = 0.0;
    for (size_t i = begin; i < begin + n; i++) found = fmax(found, size_of(g, n, i));
    return found;
}

/* The largest |d_i| of d[2n], relative to the size of entry i. */
static double measure(const dal__estimate *g, size_t n, const double *d)
{
    double far = 0.0, found = 0.0;
    for (size_t i = 0; i < n; i++) far = fmax(far, fmax(fabs(g->low[i]), fabs(g->high[i])));
    for (size_t begin = 0; begin < 2 * n; begin += n) {
        const double resolved = begin == 0 ? RESOLUTION * far : RESOLUTION * far / g->elapsed;
        const double least = fmax(resolved, SMALL * largest(g, n, begin));
        for (size_t i = begin; i < begin + n; i++) {
            const double part = fabs(d[i]) / fmax(size_of(g, n, i), least);
            if (d[i] != 0.0 && !(part <= found)) found = isnan(part) ? (double)INFINITY : part;
        }
    }
    return found;
}

/* ---- steps computed again ---------------------------------------------------------------- */

/* Start to compute `span` steps again: from x at t, step number `first` of the run. */
static void start(dal_run *run, double t, const double *x, size_t first, size_t span)
{
    dal__estimate *const g = &run->stepper->estimate;
    g->t = t;
    g->first = first;
    g->span = span;
    g->at = 0;
    g->worst = 0.0;
    dal__remake_start(run->stepper, t, g->h, x, g->ratio * g->h);
}

/* Kept nodes are compared after a shift to the moved nodes, where the scheme has this order. */
static int order_of(const dal_stepper *stepper)
{
    const dal_scheme *const scheme = &stepper->scheme;
    return scheme->nodes == DAL_KEPT_NODES && scheme->beta == 0.5 ? 2 : scheme->order;
}

/* The ratio of the difference of the two states to the error. */
static double scale(const dal_run *run)
{
    return fabs(pow(run->stepper->estimate.ratio, order_of(run->stepper)) - 1.0);
}

/* d[2n] <- the estimated error of the state x of the run. */
static void compare(const dal_run *run, const double *x, double *d)
{
    const dal_stepper *const stepper = run->stepper;
    const dal__estimate *const g = &stepper->estimate;
    const double by = scale(run);
    const size_t n = stepper->mech.n;
    const double back = stepper->shift * (g->h - stepper->motion.h); /* of kept nodes */
    for (size_t i = 0; i < 2 * n; i++) d[i] = (stepper->motion.x[i] - x[i]) / by;
    if (back != 0.0) dal__add(n, back / by, stepper->motion.x + n, d);
}

/* Compute at most `budget` steps of the run again; false if one of them fails. */
static bool go(dal_run *run, size_t budget)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const size_t width = run->inputs ? stepper->motion.system->def.inputs : 0;
    const size_t fold = g->ratio > 1.0 ? (size_t)g->ratio : 1; /* steps of the run in one */
    while (g->at < g->span && budget > 0) {
        const size_t left = g->span - g->at, ahead = g->apart - g->at % g->apart;
        size_t some = left < budget ? left : budget, steps;
        if (some > ahead) some = ahead;
        if (g->ratio < 1.0) {
            if (run->inputs) {
                some = 1;
                dal__copy(width, run->inputs + (g->first + g->at) / dal__input_steps(run) * width,
                          stepper->mech.eval.own_input);
            }
            steps = 2 * some;
        } else if (left >= fold) {
            steps = some > fold ? some / fold : 1;
            some = steps * fold;
        } else { /* fewer are left than one long step covers */
            if (stepper->motion.h != g->h)
                dal__remake_start(stepper, g->t + (double)g->at * g->h, g->ratio * g->h,
                                  stepper->motion.x, g->h);
            steps = some;
        }
        if (!dal__remake_steps(stepper, steps)) return false;
        g->remade += steps;
        g->at += some;
        budget -= some < budget ? some : budget;
        if (g->checking && some == ahead && g->at <= g->marks * g->apart) {
            compare(run, g->mark + 2 * stepper->mech.n * (g->at / g->apart - 1), g->error_of);
            g->worst = fmax(g->worst, measure(g, stepper->mech.n, g->error_of));
        }
    }
    return true;
}

/* ---- windows ---------------------------------------------------------------------------- */

static size_t window_at(size_t step)
{
    return (size_t)(WINDOW / 2 * sqrt(1.0 + (double)step / SHORT)) * 2;
}

static void plan_window(const dal_run *run)
{
    dal__estimate *const g = &run->stepper->estimate;
    g->open = false;
    g->window = window_at(run->done - g->begin);
    g->next = run->done + (run->inputs ? APART_HALVED - 1 : APART - 1) * g->window;
}

static void add_window(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const size_t N = 2 * stepper->mech.n;
    dal__remake_begin(stepper);
    start(run, g->window_t, g->x, run->done - g->window, g->window);
    const bool made = go(run, SIZE_MAX);
    const double window = (double)g->window, between = (double)(g->next - g->covered);
    if (made) compare(run, stepper->remake.here.x, g->error_of);
    dal__remake_end(stepper);
    g->failed = g->failed || !made;
    for (size_t i = 0; made && i < N; i++) {
        const double error = fabs(g->error_of[i]), rate = error / window;
        g->sum[i] += error + 0.5 * between * (rate + g->rate[i]);
        g->rate[i] = rate;
        if (!isfinite(g->sum[i])) g->failed = true;
    }
    see(g, stepper->mech.n, stepper->motion.x);
    g->far_q = largest(g, stepper->mech.n, 0);
    g->far_v = largest(g, stepper->mech.n, stepper->mech.n);
    g->covered = run->done;
    plan_window(run);
}

/* ---- the run ---------------------------------------------------------------------------- */

/* The piece that can be computed again begins at the present state. */
static void begin_piece(const dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    memcpy(g->from, stepper->motion.x, 2 * stepper->mech.n * sizeof *g->from);
    g->piece = run->done;
    g->piece_t = dal_stepper_time(stepper);
    g->marks = 0;
    g->apart = FOLD;
}

/* The step at which the next mark is stored. */
static size_t next_mark(const dal__estimate *g)
{
    return g->marks * g->apart == MOST ? SIZE_MAX : g->piece + (g->marks + 1) * g->apart;
}

/* Store the state as a mark to compare with; if there is no room, drop every second mark. */
static void set_mark(const dal_run *run)
{
    dal__estimate *const g = &run->stepper->estimate;
    const size_t N = 2 * run->stepper->mech.n;
    if (g->marks == DAL__MARKS) {
        for (size_t k = 0; 2 * k < DAL__MARKS; k++)
            memmove(g->mark + k * N, g->mark + (2 * k + 1) * N, N * sizeof *g->mark);
        g->marks /= 2;
        g->apart *= 2;
    }
    if (run->done < next_mark(g)) return;
    memcpy(g->mark + g->marks++ * N, run->stepper->motion.x, N * sizeof *g->mark);
    if (run->done - g->piece == MOST) g->sum_of_most = measure(g, run->stepper->mech.n, g->sum);
}

void dal__estimate_begin(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    const dal_scheme *const scheme = &stepper->scheme;
    dal__estimate *const g = &stepper->estimate;
    const size_t N = 2 * stepper->mech.n;
    if (g->run == run && (run->done > 0 || run->stored > 0)) return;
    g->run = run;
    run->checks = 0;
    g->on = !run->unchecked && !dal__run_varies(run) && scheme->order > 0
         && dal_stepper_saved(stepper) > 0;
    g->h = stepper->motion.h;
    g->begin = g->covered = g->seen = run->done;
    g->remade = 0;
    g->whole = g->over = g->checking = g->failed = false;
    g->ratio = run->inputs ? 0.5 : 2.0;
    g->error = (double)NAN;
    g->looked = stepper->motion.steps;
    g->iterations = stepper->motion.stats->iterations;
    g->least_effort = (double)INFINITY;
    g->most_effort = 0.0;
    memcpy(g->low, stepper->motion.x, N * sizeof *g->low);
    memcpy(g->high, stepper->motion.x, N * sizeof *g->high);
    for (size_t k = 0; run->x && k < run->stored; k++) see(g, stepper->mech.n, run->x + k * N);
    dal__clear(N, g->sum);
    dal__clear(N, g->rate);
    begin_piece(run);
    g->open = false;
    g->window = WINDOW;
    g->next = SIZE_MAX;
    if (run->steps - run->done < SHORT) return;
    g->next = run->done;
    dal__estimate_look(run);
}

size_t dal__estimate_stop(const dal_run *run)
{
    const dal__estimate *const g = &run->stepper->estimate;
    const size_t window = g->open ? g->next + g->window : g->next, mark = next_mark(g);
    size_t stop = g->seen < window ? g->seen : window;
    if (!g->on) return SIZE_MAX;
    if (mark < stop) stop = mark;
    return stop > run->done ? stop - run->done : 1;
}

void dal__estimate_look(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const size_t N = 2 * stepper->mech.n, here = run->done;
    const double *const x = stepper->motion.x;
    if (!g->on) return;
    g->elapsed = fabs((double)(here - g->begin) * g->h);
    if (here >= g->seen) {
        see(g, stepper->mech.n, x);
        const size_t apart = (g->next < SIZE_MAX ? 8 : 1) + (here - g->begin) / LOOKS;
        const size_t left = run->steps > here ? run->steps - here : 0;
        g->seen = here + (left < 2 * LOOKS && apart > 2 ? 2 : apart); /* sizes may grow */
    }
    if (run->events && run->events->landed) { /* a reset */
        begin_piece(run);
        if (g->open) plan_window(run);
    }
    if (here == next_mark(g)) set_mark(run);
    if (g->open && here == g->next + g->window) add_window(run);
    else if (!g->open && here >= g->next) {
        g->open = true;
        g->next = here;
        g->window_t = dal_stepper_time(stepper);
        memcpy(g->x, x, N * sizeof *g->x);
    }
}

/* Whether the run has to be computed again; sets the estimate by windows. */
static bool is_suspect(const dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const dal__energy_jump *const jump = &stepper->energy_jump;
    const size_t N = 2 * stepper->mech.n, steps = run->done - g->begin;
    see(g, stepper->mech.n, stepper->motion.x);
    for (size_t i = 0; i < N; i++) g->sum[i] += g->rate[i] * (double)(run->done - g->covered);
    g->error = g->covered > g->begin ? measure(g, stepper->mech.n, g->sum) : (double)NAN;
    const bool grown = largest(g, stepper->mech.n, 0) > GROWN * g->far_q
                    || largest(g, stepper->mech.n, stepper->mech.n) > GROWN * g->far_v;
    return steps < SHORT || g->failed || grown || !(g->error <= SUSPECTED)
        || jump->strayed > CHANGED * jump->kinetic
        || g->most_effort > TOILED * g->least_effort;
}

/* Set the error of the piece that was computed again; true if it is accepted. */
static bool conclude(const dal_run *run, const double *x)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const size_t n = stepper->mech.n;
    const bool part = g->span < run->done - g->piece;
    const double more = part ? measure(g, n, g->sum) / g->sum_of_most : 1.0;
    compare(run, x, g->error_of);
    g->error = measure(g, n, g->error_of);
    const double clear = fmin(CLEAR, NEAR / scale(run));
    const bool told = g->ratio < 1.0 || fmax(g->worst, g->error) <= clear;
    if (isfinite(more)) g->error *= more;
    g->whole = true;
    return told;
}

/* The first r for a piece of `span` steps, and the one after `ratio`. */
static double first_ratio(const dal_run *run, size_t span)
{
    const int p = order_of(run->stepper);
    const double wanted = p == 1 ? 8.0 : p == 2 ? 4.0 : 2.0, few = 0.25 * (double)span;
    return run->inputs ? 0.5 : few >= wanted ? wanted : few >= 4.0 ? 4.0 : 2.0;
}

static double next_ratio(double ratio) { return ratio > 2.0 ? 0.5 * ratio : 0.5; }

/* If the run ended in a jump of v to new inputs, apply the same jump before comparing. */
static bool apply_jump(dal_stepper *stepper)
{
    dal__copy(stepper->motion.system->def.inputs, stepper->remake.input,
              stepper->mech.eval.own_input);
    return dal__stepper_enter_D(stepper) == DAL_SUCCESS;
}

/* Discard the error of a part of the run, unless steps computed again show that h is too large. */
static void discard_part(dal__estimate *g)
{
    if (g->whole ? g->piece == 0 || g->error > DAL_LARGE_ERROR : g->begin == 0) return;
    g->error = (double)NAN;
    g->whole = false;
}

void dal__estimate_check(dal_run *run, size_t budget)
{
    dal_stepper *const stepper = run->stepper;
    dal__estimate *const g = &stepper->estimate;
    const size_t steps = run->done - g->piece, span = steps < MOST ? steps : MOST;
    if (!g->on || g->over) return;
    if (!g->checking && (!is_suspect(run) || steps < LEAST)) {
        g->over = true;
        discard_part(g);
        return;
    }
    dal__remake_begin(stepper);
    if (g->checking) {
        dal__remake_resume(stepper);
    } else {
        g->ratio = first_ratio(run, span);
        start(run, g->piece_t, g->from, g->piece, span);
    }
    g->checking = true;
    while (!g->over) {
        bool made = go(run, budget);
        if (made && g->at < span) break;
        const double *const x = span < steps ? g->mark + (g->marks - 1) * 2 * stepper->mech.n
                                             : stepper->remake.here.x;
        made = made && (span < steps || apply_jump(stepper)) && conclude(run, x);
        g->over = made || g->ratio < 1.0;
        if (g->over) break;
        g->ratio = next_ratio(g->ratio);
        start(run, g->piece_t, g->from, g->piece, span);
        if (budget < SIZE_MAX) break;
    }
    if (!g->over) dal__remake_pause(stepper);
    dal__remake_end(stepper);
    run->checks = g->over ? 0 : span - g->at;
    if (!g->over) return;
    if (!g->whole) g->error = (double)INFINITY;
    g->whole = true;
    discard_part(g);
}
