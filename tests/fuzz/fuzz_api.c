/* fuzz_api.c - the C API called at random, a libFuzzer target (./dev fuzz).
 *
 * The input is a tape of bytes.  The first ones make a system: a built-in one, or one with
 * polynomial and trigonometric callbacks, perhaps deformed.  The rest are calls: which function,
 * and its arguments.  A callback may fail once, in any of the ways that callbacks fail, and asks to
 * stop when it has been called often enough.  After every call
 *   - inputs are as they were; after a failed one so are outputs and states (rules 3 and 4),
 *   - after a successful one what was put out is finite where it has to be,
 *   - after successful steps the state lies in the set that the scheme keeps, see check_residual.
 * The sanitizers and GSL's handler, which aborts, see the rest. */
#include "dalembert/discrete.h"
#include "dalembert/ensemble.h"
#include "dalembert/study.h"
#include "step/stepper.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MOST_N = 6,
    MOST_M = 4,
    MOST_CALLS = 40,            /* of functions, for one input */
    MOST_EVALUATIONS = 5000,    /* of callbacks, for one input; the next ones ask to stop */
    MOST_ROWS = 12,
    MOST_BUFFERS = 16
};

/* Ends the program: libFuzzer keeps the input. */
#define MUST(condition, ...) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "%s:%d: %s: ", __FILE__, __LINE__, #condition); \
            fprintf(stderr, __VA_ARGS__); \
            fputc('\n', stderr); \
            abort(); \
        } \
    } while (0)

/* ---- the tape ----------------------------------------------------------------------------- */

typedef struct tape {
    const uint8_t *at, *end;
    uint32_t seed; /* not 0: bytes are drawn, and at and end are not looked at */
    bool tame;     /* numbers are ordinary */
} tape;

/* 0 where the tape has ended. */
static unsigned next_byte(tape *t)
{
    if (t->seed == 0) return t->at < t->end ? *t->at++ : 0u;
    t->seed ^= t->seed << 13;
    t->seed ^= t->seed >> 17;
    t->seed ^= t->seed << 5;
    return t->seed >> 24;
}

/* A tape that one byte of t stands for: what needs many numbers does not need many bytes. */
static tape drawn_from(tape *t)
{
    const unsigned byte = next_byte(t);
    return (tape){.seed = 2654435761u * (byte + 1u), .tame = byte % 4 != 3};
}

static unsigned next_below(tape *t, unsigned count) { return next_byte(t) % count; }

static bool seldom(tape *t) { return next_byte(t) % 64 == 63; }

/* Of the size of 1, a multiple of 1/16. */
static double next_ordinary(tape *t) { return (double)(int8_t)next_byte(t) / 16.0; }

static double next_extreme(tape *t)
{
    static const double values[] = {
        0.0, -0.0, NAN, INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, DBL_MIN, 0x1p-1074, 1e308, 1e200,
        -1e200, 1e155, 1e100, 1e-100, 1e-155, 1e-200, -1e-300, 1e16, 1e-16, 1e30, 1e-30, 1e8,
        -1e-8};
    return values[next_below(t, sizeof values / sizeof values[0])];
}

static double next_number(tape *t)
{
    const unsigned kind = t->tame ? 0 : next_byte(t);
    double value;
    if (kind < 230) return next_ordinary(t);
    if (kind < 244) return next_extreme(t);
    if (kind < 250) return ldexp(next_ordinary(t), (int)next_byte(t) - 128);
    uint64_t bits = 0;
    for (int i = 0; i < 8; i++) bits = bits << 8 | next_byte(t);
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* ---- a system whose callbacks come from the tape ------------------------------------------- */

typedef enum fault_kind { NONE, REFUSE, STOP, WRITE_NAN, WRITE_INF, WRITE_NOTHING, LIE } fault_kind;

typedef struct faults {
    fault_kind kind;
    unsigned at, calls; /* the fault strikes in this call of a callback */
} faults;

/* c sin(w q_j + p), or c q_j^2 for w = 0. */
typedef struct term {
    double c, w, p;
    unsigned j;
} term;

typedef struct recipe {
    size_t n, m;
    const dal_system *inner; /* a built-in system whose callbacks are called, or NULL */
    double mass[MOST_N], spring[MOST_N];
    term inertia[MOST_N];    /* of a general Lagrangian: M_ii(q) = mass_i + this */
    term well;               /* part of the potential */
    double constant[MOST_M][MOST_N];
    term form[MOST_M][MOST_N], drift[MOST_M];
    double bend[MOST_M];     /* phi += bend v_n^2, of nonlinear constraints */
    dal_constraint_kind kind;
    double drag, drive;
    size_t inputs;           /* of the force: each pushes all coordinates */
    double speed;            /* all but the force is what it was at time 0 at q + speed t */
    dal_sparsity sparsity;   /* of linear constraints of our own; or no entries: all */
    size_t row[MOST_M * MOST_N], column[MOST_M * MOST_N];
    faults fault;
    bool quiet;              /* no fault, no end: the checks look at the state */
} recipe;

static double value_of(const term *a, const double *q)
{
    const double s = q[a->j];
    return a->w == 0.0 ? a->c * s * s : a->c * sin(a->w * s + a->p);
}

static double slope_of(const term *a, const double *q)
{
    const double s = q[a->j];
    return a->w == 0.0 ? 2.0 * a->c * s : a->c * a->w * cos(a->w * s + a->p);
}

static double bend_of(const term *a, const double *q)
{
    return a->w == 0.0 ? 2.0 * a->c : -a->w * a->w * value_of(a, q);
}

/* Whether this call of a callback is the one that fails; too many calls end with STOP. */
static fault_kind strike(recipe *r)
{
    if (r->quiet) return NONE;
    const unsigned call = r->fault.calls++;
    if (call > MOST_EVALUATIONS) return STOP;
    return call == r->fault.at ? r->fault.kind : NONE;
}

static void spoil(fault_kind kind, size_t count, double *output)
{
    if (!output || count == 0) return;
    if (kind == WRITE_NAN || kind == STOP || kind == REFUSE) output[count - 1] = NAN;
    if (kind == WRITE_INF) output[0] = -INFINITY;
    if (kind == LIE) output[count / 2] = 3.0 - 2.0 * output[count / 2];
}

static int answer(fault_kind kind) { return kind == REFUSE ? 1 : kind == STOP ? -1 : 0; }

/* point[n] <- q + speed t, and so df/dt = speed sum_j df/dq_j. */
static void move(const recipe *r, double t, const double *q, double *point)
{
    for (size_t i = 0; i < r->n; i++) point[i] = q[i] + r->speed * t;
}

static void add_up(const recipe *r, size_t rows, const double *slopes, double *rates)
{
    for (size_t i = 0; i < rows; i++) {
        rates[i] = 0.0;
        for (size_t j = 0; j < r->n; j++) rates[i] += r->speed * slopes[i * r->n + j];
    }
}

static int potential(double t, const double *place, double *V, double *V_q, double *V_qq,
                     void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    const size_t n = r->n, j = r->well.j;
    double q[MOST_N + 2];
    move(r, t, place, q);
    if (fault == WRITE_NOTHING) return 0;
    if (r->inner) {
        const dal_system_def *const def = &r->inner->def;
        const int returned = def->potential(0.0, q, V, V_q, V_qq, def->ctx);
        if (returned) return returned;
    } else {
        if (V) *V = value_of(&r->well, q);
        if (V_qq) memset(V_qq, 0, n * n * sizeof *V_qq);
        for (size_t i = 0; i < n; i++) {
            if (V) *V += r->spring[i] * q[i] * q[i] / 2 + q[i] * q[i] * q[i] * q[i] / 8;
            if (V_q) V_q[i] = r->spring[i] * q[i] + q[i] * q[i] * q[i] / 2;
            if (V_qq) V_qq[i * n + i] = r->spring[i] + 1.5 * q[i] * q[i];
        }
        if (V_q) V_q[j] += slope_of(&r->well, q);
        if (V_qq) V_qq[j * n + j] += bend_of(&r->well, q);
    }
    spoil(fault, 1, V);
    spoil(fault, n, V_q);
    spoil(fault, n * n, V_qq);
    return answer(fault);
}

/* L = sum_i M_ii(q) v_i^2 / 2 - V(q). */
static int own_lagrangian(recipe *r, const double *q, const double *v, double *L, double *L_q,
                          double *L_v, double *L_qq, double *L_vq, double *L_vv)
{
    const size_t n = r->n;
    double V;
    recipe calm = *r;
    calm.quiet = true;
    potential(0.0, q, L ? &V : NULL, L_q, L_qq, &calm);
    if (L) *L = -V;
    for (size_t i = 0; L_q && i < n; i++) L_q[i] = -L_q[i];
    for (size_t k = 0; L_qq && k < n * n; k++) L_qq[k] = -L_qq[k];
    if (L_vq) memset(L_vq, 0, n * n * sizeof *L_vq);
    if (L_vv) memset(L_vv, 0, n * n * sizeof *L_vv);
    for (size_t i = 0; i < n; i++) {
        const term *const a = &r->inertia[i];
        const double M = r->mass[i] + value_of(a, q), M_q = slope_of(a, q);
        if (L) *L += M * v[i] * v[i] / 2;
        if (L_q) L_q[a->j] += M_q * v[i] * v[i] / 2;
        if (L_v) L_v[i] = M * v[i];
        if (L_qq) L_qq[a->j * n + a->j] += bend_of(a, q) * v[i] * v[i] / 2;
        if (L_vq) L_vq[i * n + a->j] += M_q * v[i];
        if (L_vv) L_vv[i * n + i] = M;
    }
    return 0;
}

static int lagrangian(double t, const double *place, const double *v, double *L, double *L_q,
                      double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                      void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    const size_t n = r->n;
    double q[MOST_N + 2], turns[(MOST_N + 2) * (MOST_N + 2)];
    double *const slopes = L_vt && !L_vq ? turns : L_vq;
    if (fault == WRITE_NOTHING) return 0;
    int returned = 0;
    move(r, t, place, q);
    if (r->inner) {
        const dal_system_def *const def = &r->inner->def;
        returned = def->lagrangian(0.0, q, v, L, L_q, L_v, L_qq, slopes, L_vv, NULL, def->ctx);
    } else {
        returned = own_lagrangian(r, q, v, L, L_q, L_v, L_qq, slopes, L_vv);
    }
    if (returned) return returned;
    if (L_vt) add_up(r, n, slopes, L_vt);
    spoil(fault, 1, L);
    spoil(fault, n, L_q);
    spoil(fault, n, L_v);
    spoil(fault, n * n, L_qq);
    spoil(fault, n * n, L_vq);
    spoil(fault, n * n, L_vv);
    spoil(fault, n, L_vt);
    return answer(fault);
}

static void own_constraint(const recipe *r, const double *q, const double *v, double *phi,
                           double *phi_v, double *phi_q)
{
    const size_t n = r->n, last = n - 1;
    if (phi_q) memset(phi_q, 0, r->m * n * sizeof *phi_q);
    for (size_t a = 0; a < r->m; a++) {
        double sum = 0.0;
        for (size_t i = 0; i < n; i++) {
            const term *const form = &r->form[a][i];
            const double mu = r->constant[a][i] + value_of(form, q);
            sum += mu * v[i];
            if (phi_v) phi_v[a * n + i] = mu;
            if (phi_q) phi_q[a * n + form->j] += slope_of(form, q) * v[i];
        }
        if (r->kind != DAL_LINEAR) {
            sum += value_of(&r->drift[a], q);
            if (phi_q) phi_q[a * n + r->drift[a].j] += slope_of(&r->drift[a], q);
        }
        if (r->kind == DAL_NONLINEAR) {
            sum += r->bend[a] * v[last] * v[last];
            if (phi_v) phi_v[a * n + last] += 2.0 * r->bend[a] * v[last];
        }
        if (phi) phi[a] = sum;
    }
}

/* The entries of the sparsity, of A[m*n] that has all. */
static void compress(const recipe *r, const double *A, double *entries)
{
    for (size_t e = 0; entries && e < r->sparsity.entries; e++)
        entries[e] = A[r->row[e] * r->n + r->column[e]];
}

static int constraint(double t, const double *place, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    double q[MOST_N + 2], turns[(MOST_N + 2) * (MOST_N + 2)];
    double *slopes = phi_t && !phi_q ? turns : phi_q;
    if (fault == WRITE_NOTHING) return 0;
    move(r, t, place, q);
    if (r->inner) {
        const dal_system_def *const def = &r->inner->def;
        const int returned = def->constraint(0.0, q, v, phi, phi_v, slopes, NULL, def->ctx);
        if (returned) return returned;
    } else if (r->sparsity.entries > 0) {
        double mu[MOST_M * MOST_N];
        own_constraint(r, q, v, phi, mu, turns);
        compress(r, mu, phi_v);
        compress(r, turns, phi_q);
        slopes = turns;
    } else {
        own_constraint(r, q, v, phi, phi_v, slopes);
    }
    const size_t entries = r->sparsity.entries > 0 ? r->sparsity.entries : r->m * r->n;
    if (phi_t) add_up(r, r->m, slopes, phi_t);
    spoil(fault, r->m, phi);
    spoil(fault, entries, phi_v);
    spoil(fault, entries, phi_q);
    spoil(fault, r->m, phi_t);
    return answer(fault);
}

/* f_i = -drag v_i + drive sin(t + q_i) + u_0 + u_1 + ... */
static int force(double t, const double *q, const double *v, const double *u, double *f,
                 double *f_q, double *f_v, void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    const size_t n = r->n;
    if (fault == WRITE_NOTHING) return 0;
    if (f_q) memset(f_q, 0, n * n * sizeof *f_q);
    if (f_v) memset(f_v, 0, n * n * sizeof *f_v);
    double pushed = 0.0;
    for (size_t k = 0; k < r->inputs; k++) pushed += u[k];
    for (size_t i = 0; i < n; i++) {
        if (f) f[i] = -r->drag * v[i] + r->drive * sin(t + q[i]) + pushed;
        if (f_q) f_q[i * n + i] = r->drive * cos(t + q[i]);
        if (f_v) f_v[i * n + i] = -r->drag;
    }
    spoil(fault, n, f);
    spoil(fault, n * n, f_q);
    spoil(fault, n * n, f_v);
    return answer(fault);
}

/* g_a = sin(q_a) v_(a+1), after the last one v_0, a deformation that stays linear. */
static int deformation(double t, const double *q, const double *v, double *g, double *g_v,
                       double *g_q, double *g_t, void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    const size_t n = r->n, m = r->m;
    if (fault == WRITE_NOTHING) return 0;
    if (g_v) memset(g_v, 0, m * n * sizeof *g_v);
    if (g_q) memset(g_q, 0, m * n * sizeof *g_q);
    for (size_t a = 0; a < m; a++) {
        const size_t next = (a + 1) % n;
        if (g) g[a] = sin(q[a]) * v[next];
        if (g_v) g_v[a * n + next] = sin(q[a]);
        if (g_q) g_q[a * n + a] = cos(q[a]) * v[next];
        if (g_t) g_t[a] = 0.0;
    }
    spoil(fault, m, g);
    spoil(fault, m * n, g_v);
    spoil(fault, m * n, g_q);
    return answer(fault);
}

/* g = q0 + beta (q1 - q0), f = (q1 - q0 + bend (q1 - q0)^2)/h; its derivatives are right, and ctx
 * is the recipe. */
static int own_map(double h, const double *q0, const double *q1, double *g, double *f, double *g_0,
                   double *g_1, double *f_0, double *f_1, void *ctx)
{
    recipe *const r = ctx;
    const fault_kind fault = strike(r);
    const size_t n = r->n;
    double *const derivatives[] = {g_0, g_1, f_0, f_1};
    if (fault == WRITE_NOTHING) return 0;
    for (size_t k = 0; k < 4; k++)
        if (derivatives[k]) memset(derivatives[k], 0, n * n * sizeof(double));
    for (size_t i = 0; i < n; i++) {
        const double d = q1[i] - q0[i], bend = 0.125 * r->bend[0];
        if (g) g[i] = q0[i] + 0.5 * d;
        if (f) f[i] = (d + bend * d * d) / h;
        if (g_0) g_0[i * n + i] = 0.5;
        if (g_1) g_1[i * n + i] = 0.5;
        if (f_0) f_0[i * n + i] = -(1.0 + 2.0 * bend * d) / h;
        if (f_1) f_1[i * n + i] = (1.0 + 2.0 * bend * d) / h;
    }
    spoil(fault, n, g);
    spoil(fault, n, f);
    return answer(fault);
}

/* ---- the world that a tape plays in --------------------------------------------------------- */

/* An array handed to the library, of just the size that it needs, with what was in it before. */
typedef struct buffer {
    double *now, *before;
    size_t count;
    bool constant;        /* an input */
    bool finite;          /* after a success it has to be */
    bool goes_on;         /* a state that the world takes over */
    size_t row;           /* not 0: rows of this size, *done + extra of which may be written */
    size_t extra;
} buffer;

typedef struct world {
    tape t;
    recipe r;
    size_t n, m;
    dal_system *inner, *base, *system; /* base: of a deformed one, else NULL */
    dal_mechanics *mechanics;
    dal_chart *chart;
    dal_flow *flow;
    dal_discrete *discrete;
    dal_stepper *stepper;
    dal_embedding *embedding;
    dal_scheme scheme;
    dal_substep substeps[4], own[4]; /* of the scheme chosen last, and of that of the stepper */
    double *x;                 /* [2n] a state that calls take and leave */
    double h;                  /* of the stepper */
    bool started;
    buffer buffers[MOST_BUFFERS];
    size_t used;
    size_t done;               /* what the last call said, where it was asked */
    const char *call;
} world;

static double *keep_buffer(world *w, size_t count, bool constant, bool finite)
{
    MUST(w->used < MOST_BUFFERS, "too many");
    const size_t bytes = (count ? count : 1) * sizeof(double);
    buffer *const b = &w->buffers[w->used++];
    *b = (buffer){.now = malloc(bytes), .before = malloc(bytes), .count = count,
                  .constant = constant, .finite = finite};
    MUST(b->now && b->before, "memory");
    return b->now;
}

static double *remember(world *w)
{
    const buffer *const b = &w->buffers[w->used - 1];
    memcpy(b->before, b->now, b->count * sizeof(double));
    return b->now;
}

/* An output of count numbers that nobody has written; NULL now and then. */
static double *out_of(world *w, size_t count, bool finite)
{
    if (seldom(&w->t)) return NULL;
    double *const x = keep_buffer(w, count, false, finite);
    for (size_t i = 0; i < count; i++) x[i] = -77.25 - (double)i;
    return remember(w);
}

static double *out(world *w, size_t count) { return out_of(w, count, true); }

/* Rows of which a failed call may have written some. */
static double *rows(world *w, size_t count, size_t row, size_t extra)
{
    double *const x = out_of(w, count * row, true);
    if (x && row > 0) {
        w->buffers[w->used - 1].row = row;
        w->buffers[w->used - 1].extra = extra;
    }
    return x;
}

static void fill(world *w, size_t count, double *x)
{
    tape drawn = drawn_from(&w->t), *const t = next_below(&w->t, 4) == 3 ? &w->t : &drawn;
    for (size_t i = 0; i < count; i++) x[i] = next_number(t);
}

/* An input of count numbers. */
static double *in(world *w, size_t count)
{
    if (seldom(&w->t)) return NULL;
    double *const x = keep_buffer(w, count, true, false);
    fill(w, count, x);
    return remember(w);
}

/* A state [2n]: that of the world, or one from the tape. */
static double *state_of(world *w, bool constant)
{
    if (seldom(&w->t)) return NULL;
    double *const x = keep_buffer(w, 2 * w->n, constant, !constant);
    memcpy(x, w->x, 2 * w->n * sizeof *x);
    if (next_below(&w->t, 4) == 3) fill(w, 2 * w->n, x);
    w->buffers[w->used - 1].goes_on = !constant;
    return remember(w);
}

static double *state(world *w) { return state_of(w, true); }

/* A state that the call changes; the world goes on with it. */
static double *changed(world *w) { return state_of(w, false); }

/* Numbers that the call changes. */
static double *moved(world *w, size_t count)
{
    double *const x = in(w, count);
    if (x) {
        w->buffers[w->used - 1].constant = false;
        w->buffers[w->used - 1].finite = true;
    }
    return x;
}

/* How many steps or rows. */
static size_t some(world *w) { return next_below(&w->t, MOST_ROWS); }

static double step_size(world *w)
{
    return next_below(&w->t, 8) == 7 ? next_number(&w->t) : next_ordinary(&w->t) / 8.0;
}

/* In [0, 1] but for one in eight. */
static double beta(world *w)
{
    return next_below(&w->t, 8) == 7 ? next_number(&w->t) : next_below(&w->t, 9) / 8.0;
}

static size_t *done(world *w)
{
    w->done = 0;
    return &w->done;
}

/* What every call owes, from what it returned. */
static void settle(world *w, int status)
{
    MUST(status >= DAL_EZENO && status <= DAL_STOPPED, "%s returned %d", w->call, status);
    for (size_t k = 0; k < w->used; k++) {
        buffer *const b = &w->buffers[k];
        const size_t written = b->row ? (w->done + b->extra) * b->row : 0;
        const bool untouched = b->constant || status < 0;
        if (untouched && written < b->count)
            MUST(memcmp(b->now + written, b->before + written,
                        (b->count - written) * sizeof(double)) == 0,
                 "%s returned %d and changed array %zu", w->call, status, k);
        for (size_t i = 0; b->finite && status == 0 && i < b->count; i++)
            MUST(isfinite(b->now[i]), "%s succeeded with %g in array %zu", w->call, b->now[i], k);
        if (b->goes_on && status == 0) memcpy(w->x, b->now, b->count * sizeof(double));
        free(b->now);
        free(b->before);
    }
    w->used = 0;
}

/* ---- the calls ------------------------------------------------------------------------------- */

/* The status of function(...), whose name is kept for what is said about it. */
#define CALL(function, ...) (w->call = #function, function(__VA_ARGS__))

static int call_system(world *w)
{
    const size_t count = dal_system_invariants(w->system);
    dal_check check;
    dal_error error;
    switch (next_below(&w->t, 4)) {
    case 0:
        return CALL(dal_system_check, w->system, next_ordinary(&w->t), state(w), &check, &error);
    case 1: return CALL(dal_system_exact, w->system, next_number(&w->t), state(w), changed(w));
    case 2: return CALL(dal_system_state, w->system, changed(w));
    default:
        return CALL(dal_system_invariant, w->system, next_number(&w->t), state(w), out(w, count));
    }
}

static int call_mechanics(world *w)
{
    const size_t n = w->n, m = w->m;
    const double t = next_ordinary(&w->t);
    dal_mechanics *const a = w->mechanics;
    switch (next_below(&w->t, 15)) {
    case 0: return CALL(dal_energy, a, t, state(w), out(w, 1));
    case 1: return CALL(dal_power, a, t, state(w), out(w, 1), out(w, 1));
    case 2: return CALL(dal_metric, a, t, state(w), out(w, n * n));
    case 3: return CALL(dal_residual, a, t, step_size(w), state(w), out(w, m));
    case 4: return CALL(dal_relative_residual, a, t, step_size(w), state(w), out(w, 1));
    case 5: return CALL(dal_gram, a, t, state(w), out(w, m * m));
    case 6: return CALL(dal_multipliers, a, t, state(w), out(w, m));
    case 7: return CALL(dal_acceleration, a, t, state(w), out(w, n));
    case 8: return CALL(dal_field, a, t, state(w), out(w, 2 * n));
    case 9:
        return CALL(dal_perturbed, a, t, next_number(&w->t), state(w), in(w, 2 * n),
                    out(w, 2 * n), out(w, m));
    case 10: return CALL(dal_project, a, t, step_size(w), changed(w), out(w, 1));
    case 11: {
        unsigned char keep[MOST_N + 2];
        for (size_t i = 0; i < n; i++) keep[i] = (unsigned char)next_below(&w->t, 2);
        return CALL(dal_consistent, a, t, keep, changed(w), out(w, 1));
    }
    case 12:
        return CALL(dal_step_equations, a, t, beta(w), step_size(w), state(w), in(w, n),
                    in(w, m), out(w, n), out(w, m), out(w, n * n), out(w, m * n), out(w, m * n));
    case 13: return CALL(dal_mechanics_input, a, in(w, w->r.inputs));
    default: {
        const size_t count = some(w);
        return CALL(dal_trajectory, a, t, next_number(&w->t), step_size(w), count,
                    in(w, count * 2 * n), in(w, count * w->r.inputs), rows(w, count, 1, 0),
                    rows(w, count, m, 0), rows(w, count, m, 0), rows(w, count, 1, 0), done(w));
    }
    }
}

static int call_chart(world *w)
{
    const size_t n = w->n, m = w->m, xi = 2 * n - m;
    dal_chart *const a = w->chart;
    const double t = next_ordinary(&w->t);
    int moves;
    size_t changes;
    switch (next_below(&w->t, 17)) {
    case 0: {
        size_t dependent[MOST_N + 2] = {0};
        for (size_t k = 0; k < m; k++) dependent[k] = next_below(&w->t, (unsigned)n + 1);
        return CALL(dal_chart_choose, a, t, dependent, state(w));
    }
    case 1:
    case 2: return CALL(dal_chart_choose, a, t, NULL, state(w));
    case 3: return CALL(dal_chart_condition, a, t, state(w), out_of(w, 1, false));
    case 4: return CALL(dal_chart_renew, a, t, state(w), &moves);
    case 5: return CALL(dal_chart_connection, a, t, state(w), out(w, m * (n - m)), out(w, m * m));
    case 6: return CALL(dal_chart_split, a, t, state(w), out(w, n), out(w, n));
    case 7: return CALL(dal_chart_lift, a, t, in(w, xi), changed(w));
    case 8: return CALL(dal_chart_drop, a, state(w), out(w, xi));
    case 9:
        return CALL(dal_chart_jacobian, a, t, in(w, xi), out(w, 2 * n * xi), out(w, 2 * n * xi));
    case 10: return CALL(dal_chart_field, a, t, in(w, xi), out(w, xi));
    case 11: return CALL(dal_chart_multipliers, a, t, state(w), in(w, m), out(w, m));
    case 12: return CALL(dal_chart_multipliers_back, a, t, state(w), in(w, m), out(w, m));
    case 13:
        return CALL(dal_chart_step, a, t, beta(w), step_size(w), moved(w, xi), out(w, m));
    case 15: return CALL(dal_chart_input, a, in(w, w->r.inputs));
    case 14:
        return CALL(dal_chart_curve, a, t, state(w), state(w), next_number(&w->t), changed(w));
    default: {
        const size_t given = some(w), count = some(w);
        const double h = step_size(w), length = h * ((double)given - 1.0), shift = step_size(w);
        double *const times = keep_buffer(w, count, true, false);
        for (size_t i = 0; i < count; i++)
            times[i] = t + length * beta(w);
        remember(w);
        return CALL(dal_chart_interpolate, a, t, h, shift, given, in(w, given * 2 * n), count,
                    times, rows(w, count, 2 * n, 0), &changes, done(w));
    }
    }
}

static int call_flow(world *w)
{
    static const double tolerances[] = {1e-13, 1e-10, 1e-6, 1e-3, 0.1};
    const size_t n = w->n, m = w->m;
    const unsigned which = next_below(&w->t, 6);
    if (which == 0 || !w->flow) {
        const unsigned bits = next_byte(&w->t);
        const double tolerance =
            seldom(&w->t) ? next_number(&w->t) : tolerances[next_below(&w->t, 5)];
        dal_flow *fresh = NULL;
        const int status =
            CALL(dal_flow_new, &fresh, w->system, (dal_flow_method)(bits % 4),
                 (dal_flow_coordinates)(bits / 4 % 3), tolerance, NULL);
        MUST((status == 0) == (fresh != NULL), "dal_flow_new returned %d", status);
        if (status) return status;
        dal_flow_free(w->flow);
        w->flow = fresh;
        if (which == 0) return status;
    }
    const double t = next_ordinary(&w->t), h = step_size(w);
    switch (which) {
    case 1: return CALL(dal_flow_apply, w->flow, t, t + 4.0 * h, changed(w), out(w, 1));
    case 2: return CALL(dal_flow_apply, w->flow, t, next_number(&w->t), changed(w), NULL);
    case 5: return CALL(dal_flow_input, w->flow, in(w, w->r.inputs));
    case 3: {
        const size_t steps = some(w);
        double *const x = keep_buffer(w, (steps + 1) * 2 * n, false, true);
        for (size_t i = 0; i < (steps + 1) * 2 * n; i++) x[i] = i < 2 * n ? w->x[i] : -77.25;
        remember(w);
        w->buffers[w->used - 1].row = 2 * n;
        w->buffers[w->used - 1].extra = 1;
        return CALL(dal_flow_trajectory, w->flow, t, h, steps, x, done(w));
    }
    default:
        return CALL(dal_exact_velocity, w->flow, t, h, in(w, n), in(w, n), out(w, n), out(w, m));
    }
}

static dal_difference_map a_map(world *w)
{
    dal_difference_map map = {.beta = beta(w)};
    if (next_below(&w->t, 4) == 3) {
        map.map = own_map;
        map.ctx = &w->r;
        map.differenced = (int)next_below(&w->t, 2);
    }
    return map;
}

static int call_discrete(world *w)
{
    const size_t n = w->n, m = w->m;
    const unsigned which = next_below(&w->t, 14);
    if (which == 0 || !w->discrete) {
        const dal_difference_map lagrangian = a_map(w), other = a_map(w);
        dal_discrete *fresh = NULL;
        const int status = CALL(dal_discrete_new, &fresh, w->system, &lagrangian,
                                next_below(&w->t, 2) ? &other : NULL, NULL);
        MUST((status == 0) == (fresh != NULL), "dal_discrete_new returned %d", status);
        if (status) return status;
        dal_discrete_free(w->discrete);
        w->discrete = fresh;
        if (which == 0) return status;
    }
    dal_discrete *const a = w->discrete;
    const double t = next_ordinary(&w->t), h = step_size(w);
    int sign;
    switch (which) {
    case 1: return CALL(dal_discrete_state, a, h, in(w, n), in(w, n), changed(w));
    case 2: return CALL(dal_discrete_nodes, a, t, h, state(w), out(w, n), out(w, n));
    case 3:
        return CALL(dal_discrete_lagrangian, a, t, h, in(w, n), in(w, n), out(w, 1), out(w, n),
                    out(w, n), out(w, n * n));
    case 4:
        return CALL(dal_discrete_constraint, a, t, h, in(w, n), in(w, n), out(w, m),
                    out(w, m * n), out(w, m * n));
    case 5: return CALL(dal_discrete_momenta, a, t, h, in(w, n), in(w, n), out(w, n), out(w, n));
    case 6:
        return CALL(dal_discrete_momentum, a, t, h, in(w, n), in(w, n), in(w, n), in(w, n),
                    out(w, 1), out(w, 1));
    case 7:
        return CALL(dal_discrete_residual, a, t, h, in(w, n), in(w, n), in(w, n), in(w, m),
                    out(w, n + m));
    case 8:
        return CALL(dal_discrete_regularity, a, t, h, in(w, n), in(w, n),
                    out(w, (n + m) * (n + m)), &sign, out_of(w, 1, false), out_of(w, 1, false));
    case 13: return CALL(dal_discrete_input, a, in(w, w->r.inputs));
    case 9: return CALL(dal_discrete_step, a, t, h, moved(w, n), moved(w, n), out(w, m));
    case 10: {
        const size_t steps = some(w);
        double *const nodes = moved(w, (steps + 2) * n);
        if (nodes) {
            w->buffers[w->used - 1].row = n;
            w->buffers[w->used - 1].extra = 2;
        }
        return CALL(dal_discrete_run, a, t, h, steps, nodes, rows(w, steps, m, 0), done(w));
    }
    default: return CALL(dal_discrete_advance, a, t, h, changed(w), out(w, m));
    }
}

/* Any record: named ones, and ones of our own that may not be valid. */
static int choose_scheme(world *w, dal_scheme *scheme)
{
    static const char *const bases[] = {"explicit", "midpoint", "endpoint", "0.3", "leapfrog",
                                        "leapfrog-mirror", "leapfrog-suzuki4", "midpoint-yoshida4",
                                        "midpoint-kl6", "leapfrog-kl8", "midpoint-nodes",
                                        "endpoint-nodes", "0.7-nodes", "explicit-nodes", "0",
                                        "1e9"};
    const unsigned which = next_byte(&w->t);
    if (which < 160) return dal_scheme_find(scheme, bases[which % DAL_LENGTH(bases)], NULL);
    if (which < 200) return dal_scheme_at(scheme, which - 160);
    const size_t count = next_below(&w->t, DAL_LENGTH(w->substeps) + 1);
    double rest = 1.0;
    for (size_t k = 0; k < count; k++) {
        w->substeps[k].beta = beta(w);
        w->substeps[k].fraction = k + 1 == count ? rest : next_ordinary(&w->t) / 4.0;
        rest -= w->substeps[k].fraction;
    }
    *scheme = (dal_scheme){.name = "own", .beta = beta(w), .count = count,
                           .substeps = w->substeps, .nodes = (dal_nodes)next_below(&w->t, 3),
                           .order = (int)next_below(&w->t, 4)};
    return DAL_SUCCESS;
}

/* After successful steps the state is finite and lies in the set that the scheme keeps.  Of kept
 * nodes that is D_eps, and rounding of q alone can move q - shift v away from it; then the
 * statistics have to say so. */
static void check_residual(world *w)
{
    const double *const x = dal_stepper_state(w->stepper);
    const bool kept = w->scheme.nodes == DAL_KEPT_NODES;
    double bound = DAL_RESIDUAL_BOUND(w->n), shift = 0.0, worst = 0.0;
    for (size_t i = 0; i < 2 * w->n; i++)
        MUST(isfinite(x[i]), "%s succeeded with %g in the state", w->call, x[i]);
    if (w->r.fault.kind == LIE || w->m == 0) return;
    if (kept) {
        dal_stats stats;
        dal_stepper_stats(w->stepper, &stats);
        bound = fmax(bound, stats.worst_residual);
        MUST(dal_scheme_shift(&w->scheme, &shift) == 0, "of a scheme that made steps");
        shift *= w->h;
    }
    w->r.quiet = true;
    const int status =
        dal_relative_residual(w->mechanics, dal_stepper_time(w->stepper), shift, x, &worst);
    w->r.quiet = false;
    MUST(status == 0, "no residual at a state that %s gave: %d", w->call, status);
    MUST(worst <= bound, "%s keeps D to %g, n = %zu, with %s", w->call, worst, w->n,
         w->scheme.name);
}

/* Where a stepper stands. */
typedef struct standing {
    size_t steps;
    double t, x[2 * (MOST_N + 2)];
} standing;

static standing standing_of(const world *w)
{
    dal_stats stats;
    standing s = {.t = dal_stepper_time(w->stepper)};
    dal_stepper_stats(w->stepper, &stats);
    s.steps = stats.steps;
    memcpy(s.x, dal_stepper_state(w->stepper), 2 * w->n * sizeof(double));
    return s;
}

static int observe(size_t step, double t, const double *x, void *ctx)
{
    const world *const w = ctx;
    MUST(isfinite(t), "at step %zu", step);
    for (size_t i = 0; i < 2 * w->n; i++) MUST(isfinite(x[i]), "observed at step %zu", step);
    return step == 7 ? 1 : step == 11 ? -1 : 0;
}

static int call_new_stepper(world *w)
{
    dal_stepper *fresh = NULL;
    dal_scheme scheme = {0};
    const unsigned bits = next_byte(&w->t);
    const dal_options options = {.max_iterations = (int)(bits / 32) - 1,
                                 .keep_energy = bits / 2 % 4 == 3};
    int status = CALL(choose_scheme, w, &scheme);
    if (status) return status;
    status = CALL(dal_stepper_new, &fresh, w->system, &scheme, bits % 2 ? &options : NULL, NULL);
    MUST((status == 0) == (fresh != NULL), "dal_stepper_new returned %d", status);
    if (status) return status;
    dal_stepper_free(w->stepper);
    w->stepper = fresh;
    if (bits / 16 % 2 && !scheme.family) dal__beta_any_sizes(fresh);
    w->scheme = scheme;
    if (scheme.substeps == w->substeps) { /* which the next choice writes over */
        memcpy(w->own, w->substeps, sizeof w->own);
        w->scheme.substeps = w->own;
    }
    w->started = false;
    return status;
}

static int call_start(world *w)
{
    static const dal_consistency ways[] = {DAL_PROJECT, DAL_PROJECT, DAL_CHECK, DAL_ASSUME};
    const standing before = standing_of(w);
    const double h = step_size(w);
    const dal_initial initial = w->scheme.nodes == DAL_KEPT_NODES
                                    ? (dal_initial)(1 + next_below(&w->t, 4))
                                    : DAL_INITIAL_NONE;
    const int status = CALL(dal_stepper_start, w->stepper, next_ordinary(&w->t), h, state(w),
                            ways[next_below(&w->t, 4)], initial);
    const standing after = standing_of(w);
    if (status < 0 && w->started)
        MUST(memcmp(&before, &after, sizeof before) == 0, "a start that failed (%d)", status);
    if (status == 0) {
        w->h = h;
        w->started = true;
    }
    return status;
}

static int call_stepper(world *w)
{
    const unsigned which = next_below(&w->t, 8);
    int status;
    if (which == 0 || !w->stepper) {
        status = call_new_stepper(w);
        if (status || which == 0) return status;
        settle(w, status);
    }
    if (which == 1 || !w->started) {
        status = call_start(w);
        if (status || which == 1) return status;
        settle(w, status);
    }
    const size_t n = w->n, m = w->m;
    if (which == 2) settle(w, CALL(dal_stepper_input, w->stepper, in(w, w->r.inputs)));
    const standing before = standing_of(w);
    const bool reacts = !w->stepper->family->no_reaction; /* else reactions are NaN */
    size_t made = 0, asked = 1;
    if (which < 4) {
        status = CALL(dal_step, w->stepper, out_of(w, m, reacts));
        made = status == 0;
    } else if (which < 6) {
        asked = 5 * some(w);
        status = CALL(dal_advance, w->stepper, asked, out_of(w, m, reacts), &made);
    } else {
        const size_t stride = 1 + next_below(&w->t, 3), count = some(w);
        asked = stride * count;
        double *const x = out(w, (count + 1) * 2 * n);
        double *const reactions = out_of(w, count * m, reacts);
        for (size_t k = 0; k < w->used; k++) {
            const bool states = w->buffers[k].now == x;
            w->buffers[k].row = states ? 2 * n : m;
            w->buffers[k].extra = states;
        }
        (void)reactions;
        status = CALL(dal_integrate, w->stepper, asked, stride, x, reactions,
                      which == 7 ? observe : NULL, w, &made);
        MUST(made % stride == 0, "%zu steps of stride %zu", made, stride);
        w->done = made / stride;
    }
    MUST(made <= asked && (status != 0 || made == asked), "%zu of %zu", made, asked);
    const standing after = standing_of(w);
    MUST(after.steps - before.steps >= made, "%zu of %zu", made, after.steps - before.steps);
    if (after.steps > before.steps) check_residual(w);
    else MUST(memcmp(&before, &after, sizeof before) == 0, "%s failed (%d)", w->call, status);
    if (next_below(&w->t, 2)) memcpy(w->x, after.x, 2 * n * sizeof(double));
    return status;
}

/* An event: a plane in the states, which may do what it should not when it is asked once more. */
typedef struct plane {
    const world *w;
    double normal[2 * (MOST_N + 2)], offset;
    int asked, breaks; /* at this call; 0: never */
    unsigned how;
} plane;

static int misbehaves(plane *p, double *value)
{
    if (p->breaks == 0 || ++p->asked != p->breaks) return 0;
    if (p->how % 3 == 2) *value = (double)NAN;
    return p->how % 3 == 2 ? 0 : p->how % 3 == 1 ? 1 : -1;
}

static int plane_value(double t, const double *x, double *g, void *ctx)
{
    plane *const p = ctx;
    MUST(isfinite(t), "an event");
    *g = -p->offset;
    for (size_t i = 0; i < 2 * p->w->n; i++) *g += p->normal[i] * x[i];
    return misbehaves(p, g);
}

static int bounce(double t, double *x, void *ctx)
{
    plane *const p = ctx;
    for (size_t i = p->w->n; i < 2 * p->w->n; i++) x[i] = -x[i];
    return misbehaves(p, x);
}

/* A run with events, resets and times, in parts; it is where its counters say. */
static int call_run(world *w)
{
    enum { EVENTS = 3, TIMES = 6 };
    if (!w->started || seldom(&w->t)) return call_stepper(w);
    const size_t n = w->n, stride = 1 + next_below(&w->t, 3), steps = stride * some(w);
    const size_t count = next_below(&w->t, EVENTS + 1);
    plane planes[EVENTS];
    dal_event list[EVENTS];
    double times[TIMES], at[TIMES * 2 * (MOST_N + 2)], x[3 * MOST_ROWS * 2 * (MOST_N + 2)];
    for (size_t k = 0; k < count; k++) {
        const unsigned bits = next_byte(&w->t);
        planes[k] = (plane){.w = w, .offset = next_ordinary(&w->t), .how = bits,
                            .breaks = bits % 4 == 3 ? 1 + (int)next_below(&w->t, 20) : 0};
        for (size_t i = 0; i < 2 * n; i++) planes[k].normal[i] = next_ordinary(&w->t) / 8.0;
        list[k] = (dal_event){.g = plane_value, .direction = (int)(bits / 4 % 3) - 1,
                              .terminal = bits / 16 % 8 == 7 ? 1 + bits % 2 : 0,
                              .reset = bits / 32 % 2 ? bounce : NULL,
                              .consistency = (dal_consistency)(bits % 3), .ctx = &planes[k],
                              .reset_ctx = &planes[k]};
    }
    dal_events *events = NULL;
    int status = CALL(dal_events_new, &events, w->stepper, &w->scheme, list, count, NULL);
    MUST((status == 0) == (events != NULL), "dal_events_new returned %d", status);
    if (status) return status;
    const standing before = standing_of(w);
    const size_t asked = next_below(&w->t, TIMES);
    for (size_t k = 0; k < asked; k++)
        times[k] = before.t + (double)steps * w->h * (double)k / TIMES;
    dal_run run = {.stepper = w->stepper, .steps = steps, .stride = stride, .x = x,
                   .events = events, .times = asked > 0 ? times : NULL, .time_count = asked,
                   .x_at_times = at};
    do status = CALL(dal_run_go, &run, 1 + next_below(&w->t, 8));
    while (status == 0 && run.done < steps && w->t.at < w->t.end);
    const standing after = standing_of(w);
    MUST(after.steps == before.steps + run.done, "%zu and %zu", after.steps, run.done);
    MUST(run.done <= steps && run.stored <= steps / stride + 1, "%zu of %zu", run.done, steps);
    for (size_t i = 0; i < run.stored * 2 * n; i++) MUST(isfinite(x[i]), "row %zu", i / (2 * n));
    for (size_t i = 0; i < run.times_done * 2 * n; i++)
        MUST(isfinite(at[i]), "time %zu", i / (2 * n));
    if (status == 0 && run.done == steps)
        MUST(run.times_done == asked, "%zu times", run.times_done);
    dal_events_free(events);
    if (run.done > 0 && status != DAL_EUSER && status != DAL_EDOMAIN) check_residual(w);
    if (run.done == 0) MUST(memcmp(&before, &after, sizeof before) == 0, "%d", status);
    return status;
}

/* A member of an ensemble by itself, without faults: the same rows. */
static void check_member(world *w, const dal_scheme *scheme, const dal_members *members, size_t k,
                         const double *rows)
{
    const size_t N = 2 * w->n, stride = members->stride;
    double alone[MOST_ROWS * 2 * (MOST_N + 2)];
    dal_stepper *stepper;
    size_t done = 0;
    MUST(dal_stepper_new(&stepper, w->system, scheme, NULL, NULL) == 0, "member %zu", k);
    int status = dal_stepper_start(stepper, members->t0, *members->h, members->x + k * N,
                                   members->consistency, members->initial);
    const bool started = status == 0;
    if (started)
        status = dal_integrate(stepper, *members->steps, stride, alone, NULL, NULL, NULL, &done);
    MUST(status == members->status[k], "member %zu: %d alone, %d", k, status, members->status[k]);
    const size_t good = started ? done / stride + 1 : 0;
    MUST(memcmp(alone, rows, good * N * sizeof *rows) == 0, "member %zu", k);
    dal_stepper_free(stepper);
}

/* Members with other initial data, with and without faults of the callbacks. */
static int call_ensemble(world *w)
{
    enum { MEMBERS = 3 };
    const size_t N = 2 * w->n, stride = 1 + next_below(&w->t, 3);
    const size_t steps = stride * next_below(&w->t, 4), rows = steps / stride + 1;
    double x[MEMBERS * 2 * (MOST_N + 2)], states[MEMBERS * MOST_ROWS * 2 * (MOST_N + 2)];
    double energy[MEMBERS * MOST_ROWS];
    size_t done[MEMBERS];
    int statuses[MEMBERS];
    dal_scheme scheme = {0};
    int status = CALL(choose_scheme, w, &scheme);
    if (status) return status;
    const double h = step_size(w), t0 = next_ordinary(&w->t);
    for (size_t k = 0; k < MEMBERS; k++) {
        const double factor = next_below(&w->t, 4) ? 1.0 + (double)k / 8.0 : next_number(&w->t);
        for (size_t i = 0; i < N; i++) x[k * N + i] = i < w->n ? w->x[i] : factor * w->x[i];
    }
    const dal_members members = {
        .count = MEMBERS, .x = x, .x_next = N, .h = &h, .steps = &steps, .t0 = t0,
        .stride = stride, .consistency = (dal_consistency)next_below(&w->t, 3),
        .initial = scheme.nodes == DAL_KEPT_NODES ? (dal_initial)(1 + next_below(&w->t, 4))
                                                  : DAL_INITIAL_NONE,
        .states = states, .energy = energy, .done = done, .status = statuses};
    const bool calm = !scheme.family && next_below(&w->t, 2); /* flows may be long */
    w->r.quiet = calm;
    status = CALL(dal_ensemble_run, w->system, &scheme, NULL, &members, 0, MEMBERS, NULL, NULL,
                  NULL);
    for (size_t k = 0; !status && k < MEMBERS; k++) {
        const double *const own = states + k * rows * N;
        MUST(statuses[k] <= 0 && done[k] <= steps, "member %zu: %d", k, statuses[k]);
        MUST((statuses[k] == 0) == (done[k] == steps && isfinite(own[rows * N - 1])) || steps == 0,
             "member %zu: %d after %zu steps", k, statuses[k], done[k]);
        if (calm) check_member(w, &scheme, &members, k, own);
    }
    w->r.quiet = false;
    return status;
}

static int call_study(world *w)
{
    dal_order_point points[6] = {0};
    dal_order order = {0};
    dal_scheme scheme = {0};
    size_t steps[6];
    const int status = CALL(choose_scheme, w, &scheme);
    if (status) return status;
    const size_t count = next_below(&w->t, DAL_LENGTH(steps) + 1);
    for (size_t k = 0; k < count; k++) steps[k] = next_below(&w->t, 12);
    const double t0 = next_ordinary(&w->t);
    const dal_order_def def = {.t0 = t0, .t_end = t0 + step_size(w), .x0 = state(w),
                               .steps = steps, .count = count,
                               .initial = scheme.nodes == DAL_KEPT_NODES
                                              ? (dal_initial)(1 + next_below(&w->t, 4))
                                              : DAL_INITIAL_NONE};
    return CALL(dal_order_study, w->system, &scheme, &def, points, &order, NULL);
}

static int call_embedding(world *w)
{
    const size_t xi = 2 * w->n - w->m;
    const unsigned which = next_below(&w->t, 8);
    if (which == 0 || !w->embedding) {
        dal_embedding *fresh = NULL;
        dal_scheme scheme = {0};
        int status = CALL(choose_scheme, w, &scheme);
        if (status) return status;
        const dal_embedding_def def = {.scheme = &scheme, .h = step_size(w),
                                       .order = (int)next_below(&w->t, 4),
                                       .numerical = (int)next_below(&w->t, 2)};
        status = CALL(dal_embedding_new, &fresh, w->system, &def, NULL);
        MUST((status == 0) == (fresh != NULL), "dal_embedding_new returned %d", status);
        if (status) return status;
        dal_embedding_free(w->embedding);
        w->embedding = fresh;
        w->r.quiet = true;
        dal_chart_choose(dal_embedding_chart(fresh), 0.0, NULL, w->x);
        w->r.quiet = false;
        if (which == 0) return status;
    }
    dal_embedding *const a = w->embedding;
    const double tau = next_below(&w->t, 8) == 7 ? next_number(&w->t)
                                                 : fabs(next_ordinary(&w->t));
    switch (which) {
    case 1:
    case 2: return CALL(dal_chart_choose, dal_embedding_chart(a), tau, NULL, state(w));
    case 3: return CALL(dal_embedding_curve, a, tau, in(w, xi), out(w, xi));
    case 4: return CALL(dal_embedding_source, a, tau, in(w, xi), out(w, xi));
    case 5: return CALL(dal_embedding_field, a, tau, in(w, xi), out(w, xi));
    case 6: return CALL(dal_embedding_limit, a, in(w, xi), out(w, xi));
    default: return CALL(dal_embedding_flow, a, tau, tau + step_size(w), moved(w, xi));
    }
}

/* ---- the world ------------------------------------------------------------------------------- */

static term next_term(tape *t, size_t n)
{
    const term a = {.c = next_below(t, 2) ? next_number(t) : 0.0, .w = next_number(t),
                    .p = next_ordinary(t), .j = next_below(t, (unsigned)n)};
    return a;
}

static faults next_faults(tape *t)
{
    const unsigned kind = next_byte(t), high = next_byte(t), low = next_byte(t);
    return (faults){.kind = kind < 160 ? NONE : (fault_kind)(kind % (LIE + 1)),
                    .at = (256 * high + low) % 2048};
}

static int make_builtin(world *w, dal_system_def *def)
{
    tape *const t = &w->t;
    recipe *const r = &w->r;
    const size_t which = next_below(t, (unsigned)dal_builtin_count());
    const char *const name = dal_builtin_name(which);
    dal_system *plain = NULL;
    if (dal_system_builtin(&plain, name, NULL, NULL, 0, NULL)) return -1;
    const char *const parameter = dal_system_parameter_name(plain, 0);
    const double value = next_number(t);
    dal_system_free(plain);
    const size_t count = parameter && seldom(t);
    if (dal_system_builtin(&w->inner, name, &parameter, &value, count, NULL)) return -1;
    if (dal_system_n(w->inner) > MOST_N + 2) return -1;
    r->inner = w->inner;
    *def = w->inner->def;
    r->n = def->n;
    r->m = def->m;
    if (def->potential) def->potential = potential;
    if (def->lagrangian) def->lagrangian = lagrangian;
    if (def->constraint) def->constraint = constraint;
    if (def->force) return -1;
    def->exact = NULL;
    def->invariants = 0;
    return 0;
}

/* Some two thirds of the entries, each a function of its own coordinate. */
static void make_sparse(recipe *r, dal_system_def *def)
{
    size_t entries = 0;
    if (r->m == 0 || r->kind != DAL_LINEAR) return;
    for (size_t a = 0; a < r->m; a++)
        for (size_t i = 0; i < r->n; i++) {
            r->form[a][i].j = (unsigned)i;
            if ((a + i) % 3 == 2) {
                r->constant[a][i] = r->form[a][i].c = 0.0;
                continue;
            }
            r->row[entries] = a;
            r->column[entries++] = i;
        }
    r->sparsity = (dal_sparsity){entries, r->row, r->column};
    def->sparsity = &r->sparsity;
}

static void make_own(world *w, dal_system_def *def, double *mass, unsigned how)
{
    tape *const given = &w->t;
    recipe *const r = &w->r;
    const size_t n = r->n = 1 + next_below(given, MOST_N);
    const size_t m = r->m = next_below(given, (unsigned)(n < MOST_M ? n + 1 : MOST_M + 1));
    const unsigned shape = next_byte(given);
    r->kind = m == 0 ? DAL_LINEAR : (dal_constraint_kind)(next_byte(given) % 3);
    tape drawn = drawn_from(given), *const t = next_below(given, 4) == 3 ? given : &drawn;
    for (size_t i = 0; i < n; i++) {
        r->mass[i] = mass[i * n + i] = 1.0 + (seldom(t) ? next_number(t) : 0.0);
        r->spring[i] = next_number(t);
        r->inertia[i] = next_term(t, n);
        r->inertia[i].c *= 0.5;
    }
    r->well = next_term(t, n);
    for (size_t a = 0; a < m; a++) {
        for (size_t i = 0; i < n; i++) {
            r->constant[a][i] = next_below(t, 2) ? next_number(t) : a == i ? 1.0 : 0.0;
            r->form[a][i] = next_term(t, n);
        }
        r->drift[a] = next_term(t, n);
        r->bend[a] = next_number(t);
    }
    r->drag = next_number(t);
    r->drive = next_number(t);
    r->inputs = (shape & 12) == 12 ? next_below(t, 3) : 0;
    *def = (dal_system_def){.n = n, .m = m, .kind = r->kind,
                            .mass = shape & 1 ? NULL : mass,
                            .lagrangian = shape & 1 ? lagrangian : NULL,
                            .potential = !(shape & 1) && shape & 2 ? potential : NULL,
                            .constraint = m ? constraint : NULL,
                            .force = (shape & 12) == 12 ? force : NULL, .inputs = r->inputs};
    def->time_dependent = (shape & 192) == 192;
    if (def->time_dependent) r->speed = next_ordinary(given);
    if ((shape & 48) == 48) def->missing = next_byte(given);
    if (how > 0 && def->mass) {
        def->mass = NULL;
        def->masses = r->mass;
    }
    if (how > 1) make_sparse(r, def);
}

/* The system of the tape and what stands on it; false if there is none. */
static bool make_world(world *w)
{
    dal_system_def def;
    double mass[MOST_N * MOST_N] = {0};
    const unsigned kind = next_byte(&w->t);
    w->r.fault = next_faults(&w->t);
    if (kind % 3 == 0) {
        if (make_builtin(w, &def)) return false;
    } else {
        make_own(w, &def, mass, kind / 24 % 4);
    }
    def.ctx = &w->r;
    def.ctx_size = 0;
    def.compiled = NULL;
    if (dal_system_new(&w->system, &def, NULL)) return false;
    w->n = w->r.n;
    w->m = w->r.m;
    if (kind / 3 % 8 == 7 && w->m > 0) {
        w->base = w->system;
        w->system = NULL;
        const int status =
            kind & 128 ? dal_system_deform_nodes(&w->system, w->base, next_number(&w->t), NULL)
                       : dal_system_deform(&w->system, w->base, deformation, &w->r,
                                           next_number(&w->t), def.kind, 0, NULL);
        if (status) return false;
    }
    if (dal_mechanics_new(&w->mechanics, w->system, NULL)) return false;
    if (dal_chart_new(&w->chart, w->system, NULL)) return false;
    w->x = calloc(2 * w->n, sizeof(double));
    if (!w->x) return false;
    fill(w, 2 * w->n, w->x);
    w->r.quiet = true;
    dal_system_state(w->system, w->x);
    dal_project(w->mechanics, 0.0, 0.0, w->x, NULL);
    dal_chart_choose(w->chart, 0.0, NULL, w->x);
    w->r.quiet = false;
    return true;
}

static void free_world(world *w)
{
    dal_embedding_free(w->embedding);
    dal_stepper_free(w->stepper);
    dal_discrete_free(w->discrete);
    dal_flow_free(w->flow);
    dal_chart_free(w->chart);
    dal_mechanics_free(w->mechanics);
    dal_system_free(w->system);
    dal_system_free(w->base);
    dal_system_free(w->inner);
    free(w->x);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static int (*const calls[])(world *) = {
        call_stepper, call_stepper, call_run,     call_mechanics, call_mechanics, call_chart,
        call_chart,   call_flow,    call_discrete, call_discrete, call_system,    call_study,
        call_embedding, call_ensemble};
    world w = {.t = {.at = data, .end = data + size}};
    if (make_world(&w))
        for (size_t k = 0; k < MOST_CALLS && w.t.at < w.t.end; k++)
            settle(&w, calls[next_below(&w.t, DAL_LENGTH(calls))](&w));
    free_world(&w);
    return 0;
}
