/* Whether h is too large: an estimate of the error of the state at the end of a run.
 *
 * Steps are made again from a state of the run, two of 3h/2 for three of h.  For order p the two
 * states at the end differ by (3/2)^p - 1 times the error of the steps of h.
 *
 * 1. In a run of SHORT steps or more these are samples, windows of some dozens of steps.  Their
 *    errors, interpolated between them, are added up, as if none grew or died out.  A sum of at
 *    most SUSPECTED is the estimate, unless the state is now GROWN times as large as it was.
 * 2. Else, and in shorter runs, the whole run is made again, or its first MOST steps.  An error of
 *    at most CLEAR is the estimate.
 * 3. Else steps of 3h/2 may be too long to tell, or unstable where those of h are not.  The run is
 *    made again with two steps of h/2 for one of h: the states differ by 1 - 2^-p times the error.
 *    This estimate is warned of; that of 2 where steps of h/2 cannot be made.
 *
 * Where nothing does work a change of the energy by more than CHANGED of the largest kinetic energy
 * leads to 2 as well, and is the estimate if no step can be made again.
 *
 * Inputs may change from step to step, and 3h/2 is not for them: windows take h/2, then comes 3.
 * No step leaves a trace elsewhere than here: see remake.c. */
#include "run/events.h"
#include "run/run.h"

#include <math.h>
#include <string.h>

enum {
    SHORT = 1000,  /* a run of fewer steps is made again */
    LEAST = 6,     /* one of fewer is not */
    MOST = 99999,  /* steps that are made again in one piece; a multiple of 3 */
    WINDOW = 24,   /* steps of a window near the start; they grow as the root of the steps made */
    APART = 24,    /* from one window to the next, in windows: 2.8 % of the steps are made more */
    APART_HALVED = 60,
    LOOKS = 16,    /* at sizes, while the number of steps grows by a factor e */
};
static const double SUSPECTED = 0.002, CLEAR = 0.01, CHANGED = 0.04;
static const double GROWN = 10.0;      /* a motion that has left its size since the last window */
static const double SMALL = 1e-3;      /* a size is at least this part of the largest of its kind */
static const double RESOLUTION = 1e-9; /* and of the coordinates themselves */

/* ---- sizes ------------------------------------------------------------------------------ */

static void see(dal__guard *g, size_t n, const double *x)
{
    for (size_t i = 0; i < 2 * n; i++) {
        g->low[i] = fmin(g->low[i], x[i]);
        g->high[i] = fmax(g->high[i], x[i]);
    }
}

/* The size of number i of a state: of q the way it has gone, of v the largest. */
static double size_of(const dal__guard *g, size_t n, size_t i)
{
    return i < n ? g->high[i] - g->low[i] : fmax(fabs(g->low[i]), fabs(g->high[i]));
}

/* The largest of the q, or of the v. */
static double largest(const dal__guard *g, size_t n, size_t begin)
{
    double found = 0.0;
    for (size_t i = begin; i < begin + n; i++) found = fmax(found, size_of(g, n, i));
    return found;
}

/* The largest of d[2n], each in units of its size. */
static double measure(const dal__guard *g, size_t n, const double *d)
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

/* ---- steps that are made again ----------------------------------------------------------- */

/* By how much the difference has to be divided. */
static double contraction(const dal_run *run)
{
    const int p = run->stepper->scheme.order;
    return run->stepper->guard.halved ? 1.0 - pow(0.5, p) : pow(1.5, p) - 1.0;
}

/* From x at t, for steps number `first` of the run on, `span` of them. */
static void start(dal_run *run, double t, const double *x, size_t first, size_t span)
{
    dal__guard *const g = &run->stepper->guard;
    g->t = t;
    g->first = first;
    g->span = span;
    g->at = 0;
    dal__remake_start(run->stepper, t, (g->halved ? 0.5 : 1.5) * g->h, x);
}

/* For at most so many steps of the run; false if they cannot be made. */
static bool go(dal_run *run, size_t budget)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    const size_t width = run->inputs ? stepper->motion.system->def.inputs : 0;
    while (g->at < g->span && budget > 0) {
        const size_t left = g->span - g->at;
        size_t some = left < budget ? left : budget, steps = some;
        if (g->halved) {
            if (run->inputs) {
                some = 1;
                dal__copy(width, run->inputs + (g->first + g->at) / dal__hold(run) * width,
                          stepper->mech.eval.own_input);
            }
            steps = 2 * some;
        } else if (left >= 3) {
            steps = some < 3 ? 2 : some / 3 * 2;
            some = steps / 2 * 3;
        } else if (stepper->motion.h != g->h) { /* the last steps are those of the run */
            dal__remake_start(stepper, g->t + (double)g->at * g->h, g->h, stepper->motion.x);
        }
        if (!dal__remake_steps(stepper, steps)) return false;
        g->at += some;
        budget -= some < budget ? some : budget;
    }
    return true;
}

/* d[2n] <- the error of the state x, after all of these steps. */
static void compare(const dal_run *run, const double *x, double *d)
{
    const dal_stepper *const stepper = run->stepper;
    const double by = contraction(run);
    for (size_t i = 0; i < 2 * stepper->mech.n; i++) d[i] = (stepper->motion.x[i] - x[i]) / by;
}

/* ---- windows ---------------------------------------------------------------------------- */

static size_t window_at(size_t step)
{
    return (size_t)(WINDOW / 6 * sqrt(1.0 + (double)step / SHORT)) * 6;
}

static void plan_window(const dal_run *run)
{
    dal__guard *const g = &run->stepper->guard;
    g->open = false;
    g->window = window_at(run->done - g->begin);
    g->next = run->done + (run->inputs ? APART_HALVED - 1 : APART - 1) * g->window;
}

static void add_window(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
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
    g->remade += g->window;
    plan_window(run);
}

/* ---- the run ---------------------------------------------------------------------------- */

/* From the state now on the steps may be made again in one piece. */
static void begin_piece(const dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    memcpy(g->from, stepper->motion.x, 2 * stepper->mech.n * sizeof *g->from);
    g->piece = run->done;
    g->piece_t = dal_stepper_time(stepper);
}

void dal__guard_begin(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    const dal_scheme *const scheme = &stepper->scheme;
    dal__guard *const g = &stepper->guard;
    const size_t N = 2 * stepper->mech.n;
    if (g->run == run && (run->done > 0 || run->stored > 0)) return;
    g->run = run;
    run->checks = 0;
    g->on = !run->unchecked && !dal__run_varies(run) && scheme->order > 0
         && scheme->nodes == DAL_MOVED_NODES && dal_stepper_saved(stepper) > 0;
    g->h = stepper->motion.h;
    g->begin = g->covered = g->seen = run->done;
    g->remade = 0;
    g->whole = g->over = g->checking = g->failed = false;
    g->halved = run->inputs;
    g->error = 0.0;
    memcpy(g->low, stepper->motion.x, N * sizeof *g->low);
    memcpy(g->high, stepper->motion.x, N * sizeof *g->high);
    dal__clear(N, g->sum);
    dal__clear(N, g->rate);
    begin_piece(run);
    g->open = false;
    g->window = WINDOW;
    g->next = SIZE_MAX;
    if (run->steps - run->done < SHORT) return;
    g->next = run->done;
    dal__guard_look(run);
}

size_t dal__guard_stop(const dal_run *run)
{
    const dal__guard *const g = &run->stepper->guard;
    const size_t window = g->open ? g->next + g->window : g->next, most = g->piece + MOST;
    size_t stop = g->seen < window ? g->seen : window;
    if (!g->on) return SIZE_MAX;
    if (most > run->done && most < stop) stop = most;
    return stop > run->done ? stop - run->done : 1;
}

void dal__guard_look(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    const size_t N = 2 * stepper->mech.n, here = run->done;
    const double *const x = stepper->motion.x;
    if (!g->on) return;
    if (here >= g->seen) {
        see(g, stepper->mech.n, x);
        const size_t apart = (g->next < SIZE_MAX ? 8 : 1) + (here - g->begin) / LOOKS;
        const size_t left = run->steps > here ? run->steps - here : 0;
        g->seen = here + (left < 2 * LOOKS && apart > 2 ? 2 : apart); /* a motion may grow */
    }
    if (run->events && run->events->landed) { /* the steps before lead elsewhere */
        begin_piece(run);
        if (g->open) plan_window(run);
    }
    if (here == g->piece + MOST) {
        memcpy(g->far, x, N * sizeof *g->far);
        for (size_t i = 0; i < N; i++)
            g->far_sum[i] = g->sum[i] + g->rate[i] * (double)(here - g->covered);
    }
    if (g->open && here == g->next + g->window) add_window(run);
    else if (!g->open && here >= g->next) {
        g->open = true;
        g->next = here;
        g->window_t = dal_stepper_time(stepper);
        memcpy(g->x, x, N * sizeof *g->x);
    }
}

/* The change of the energy, as part of the largest kinetic energy; 0 where work is done. */
static double change_of_energy(const dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    const dal__jump *const jump = &stepper->jump;
    double before = 0.0, after = 0.0;
    if (!jump->looking || !(jump->kinetic > 0.0)) return 0.0;
    dal__remake_begin(stepper); /* for its counters */
    int status = dal__energy(&stepper->mech, 0.0, stepper->guard.from, &before);
    if (!status) status = dal__energy(&stepper->mech, 0.0, stepper->motion.x, &after);
    dal__remake_end(stepper);
    return status ? 0.0 : fabs(after - before) / jump->kinetic;
}

/* Whether the run is to be made again; the estimate by samples is known then. */
static bool is_suspect(const dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    const size_t N = 2 * stepper->mech.n, steps = run->done - g->begin;
    see(g, stepper->mech.n, stepper->motion.x);
    g->elapsed = fabs((double)steps * g->h);
    for (size_t i = 0; i < N; i++) g->sum[i] += g->rate[i] * (double)(run->done - g->covered);
    if (g->remade > 0) g->error = measure(g, stepper->mech.n, g->sum);
    const bool grown = largest(g, stepper->mech.n, 0) > GROWN * g->far_q
                    || largest(g, stepper->mech.n, stepper->mech.n) > GROWN * g->far_v;
    return steps < SHORT || g->failed || grown || !(g->error <= SUSPECTED)
        || change_of_energy(run) > CHANGED;
}

/* The whole piece is made again: its error, and whether that is the estimate. */
static bool conclude(const dal_run *run, const double *x)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    const size_t n = stepper->mech.n;
    const bool part = g->span < run->done - g->piece;
    const double more = part ? measure(g, n, g->sum) / measure(g, n, g->far_sum) : 1.0;
    compare(run, x, g->error_of);
    g->error = measure(g, n, g->error_of);
    const bool told = g->halved || g->error <= CLEAR;
    if (isfinite(more)) g->error *= more;
    g->remade = g->span;
    g->whole = true;
    return told;
}

void dal__guard_check(dal_run *run, size_t budget)
{
    dal_stepper *const stepper = run->stepper;
    dal__guard *const g = &stepper->guard;
    const size_t steps = run->done - g->piece, span = steps < MOST ? steps : MOST;
    if (!g->on || g->over) return;
    if (!g->checking && (!is_suspect(run) || steps < LEAST)) {
        g->over = true;
        return;
    }
    dal__remake_begin(stepper);
    if (g->checking) dal__remake_resume(stepper);
    else start(run, g->piece_t, g->from, g->piece, span);
    g->checking = true;
    while (!g->over) {
        bool made = go(run, budget);
        if (made && g->at < span) break;
        made = made && conclude(run, span < steps ? g->far : stepper->remake.here.x);
        g->over = made || g->halved;
        if (g->over) break;
        g->halved = true;
        start(run, g->piece_t, g->from, g->piece, span);
        if (budget < SIZE_MAX) break;
    }
    if (!g->over) dal__remake_pause(stepper);
    dal__remake_end(stepper);
    run->checks = g->over ? 0 : span - g->at;
    if (!g->over || g->whole) return;
    g->error = change_of_energy(run);
    g->whole = g->error > CHANGED;
    if (!g->whole) g->error = 0.0;
    g->remade = 0;
}
