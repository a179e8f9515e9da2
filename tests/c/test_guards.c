/* What holds the guards of the steps.  First of all steps of random systems against the same
 * equations solved in long double: with and without V, steady, with kept nodes, from rest, far from
 * the origin and in other units. */
#include "fixtures.h"
#include "check.h"

typedef long double real;

enum { MOST_N = 5, MOST_M = 3, MOST = MOST_N + MOST_M };

/* ---- a random system ----------------------------------------------------------------------
 * In s_i = q_i / unit_i:  mu^a_i = (c_ai + b_ai s_k + d_ai sin(f_ai s_j + p_ai)) / unit_i, k and j
 * drawn too;  V = sum_i w_i r_i^2/2 + e_i r_i^4 + g_i cos(r_i + r_(i+1)) with r
 * = s - home. */

typedef struct form {
    double constant, slope, wave, frequency, phase;
    size_t of_slope, of_wave;
} form;

typedef struct drawn {
    size_t n, m;
    double mass[MOST_N * MOST_N], unit[MOST_N];
    form mu[MOST_M][MOST_N];
    double weight[MOST_M]; /* of a form, where the library asks for it: a power of two */
    size_t constraint_calls, potential_calls;
    double home[MOST_N], spring[MOST_N], quartic[MOST_N], ripple[MOST_N];
} drawn;

/* phi_q[m*n], or NULL, is d(mu c)/dq of the vector c[n]. */
static void forms_at(const drawn *s, const real *q, const real *c, real *mu, real *phi_q)
{
    const size_t n = s->n;
    for (size_t k = 0; phi_q && k < s->m * n; k++) phi_q[k] = 0.0L;
    for (size_t a = 0; a < s->m; a++)
        for (size_t i = 0; i < n; i++) {
            const form *const f = &s->mu[a][i];
            const size_t k = f->of_slope, j = f->of_wave;
            const real angle = f->frequency * (q[j] / s->unit[j]) + f->phase;
            mu[a * n + i] = (f->constant + f->slope * (q[k] / s->unit[k]) + f->wave * sinl(angle))
                          / s->unit[i];
            if (!phi_q) continue;
            phi_q[a * n + k] += f->slope / (real)s->unit[k] / s->unit[i] * c[i];
            phi_q[a * n + j] += f->wave * f->frequency * cosl(angle) / s->unit[j] / s->unit[i]
                              * c[i];
        }
}

static void gradient_at(const drawn *s, const real *q, real *V_q, real *V_qq)
{
    const size_t n = s->n;
    for (size_t i = 0; i < n; i++) V_q[i] = 0.0L;
    for (size_t k = 0; k < n * n; k++) V_qq[k] = 0.0L;
    for (size_t i = 0; i < n; i++) {
        const size_t j = (i + 1) % n;
        const real ui = s->unit[i], uj = s->unit[j];
        const real x = q[i] / ui - s->home[i], y = q[j] / uj - s->home[j];
        const real slope = -s->ripple[i] * sinl(x + y), bend = -s->ripple[i] * cosl(x + y);
        V_q[i] += (s->spring[i] * x + 4.0L * s->quartic[i] * x * x * x + slope) / ui;
        V_q[j] += slope / uj;
        V_qq[i * n + i] += (s->spring[i] + 12.0L * s->quartic[i] * x * x + bend) / ui / ui;
        V_qq[i * n + j] += bend / ui / uj;
        V_qq[j * n + i] += bend / ui / uj;
        V_qq[j * n + j] += bend / uj / uj;
    }
}

/* What the library calls: the values in long double, rounded once. */
static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    drawn *const s = ctx;
    const size_t n = s->n, m = s->m;
    real at[MOST_N] = {0}, along[MOST_N] = {0}, mu[MOST_M * MOST_N], slope[MOST_M * MOST_N];
    for (size_t i = 0; i < n; i++) {
        at[i] = q[i];
        along[i] = v[i];
    }
    forms_at(s, at, along, mu, slope);
    s->constraint_calls++;
    for (size_t k = 0; k < m * n; k++) {
        if (phi_v) phi_v[k] = (double)mu[k] * s->weight[k / n];
        if (phi_q) phi_q[k] = (double)slope[k] * s->weight[k / n];
    }
    for (size_t a = 0; phi && a < m; a++) {
        real sum = 0.0L;
        for (size_t i = 0; i < n; i++) sum += mu[a * n + i] * along[i];
        phi[a] = (double)sum * s->weight[a];
    }
    return 0;
}

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    drawn *const s = ctx;
    const size_t n = s->n;
    real at[MOST_N] = {0}, gradient[MOST_N], hessian[MOST_N * MOST_N];
    for (size_t i = 0; i < n; i++) at[i] = q[i];
    gradient_at(s, at, gradient, hessian);
    s->potential_calls++;
    if (V) *V = 0.0; /* nobody asks for it here */
    for (size_t i = 0; V_q && i < n; i++) V_q[i] = (double)gradient[i];
    for (size_t k = 0; V_qq && k < n * n; k++) V_qq[k] = (double)hessian[k];
    return 0;
}

/* Nothing, but for it a system is a general one, whose stages are those of momentum.h. */
static int no_push(double t, const double *q, const double *v, const double *u, double *f,
                   double *f_q, double *f_v, void *ctx)
{
    return zero_force(((const drawn *)ctx)->n, f, f_q, f_v);
}

typedef struct draw {
    bool potential, steady, kept, rest, general;
    int units; /* 10^-units to 10^units */
    double far, fast, wave, beta, h;
    int steps;
} draw;

static void draw_system(drawn *s, const draw *d, unsigned *seed)
{
    const size_t n = 2 + (size_t)(4.0 * fabs(next_number(seed))) % 4; /* 2 ... 5 */
    const size_t limit = d->steady ? n - 1 : n; /* m < limit */
    const size_t m = (size_t)(4.0 * fabs(next_number(seed))) % (limit < 4 ? limit : 4);
    *s = (drawn){.n = n, .m = m};
    const bool full = !d->steady && next_number(seed) > 0.0;
    for (size_t i = 0; i < n; i++) {
        s->unit[i] = pow(10.0, round(d->units * next_number(seed)));
        s->spring[i] = 1.0 + next_number(seed);
        s->home[i] = (d->far - 1.0) * next_number(seed);
        s->quartic[i] = 0.1 * fabs(next_number(seed));
        s->ripple[i] = next_number(seed);
    }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            const double entry = i == j ? 1.5 + next_number(seed) : 0.1 * next_number(seed);
            s->mass[i * n + j] = i == j || full ? entry / (s->unit[i] * s->unit[j]) : 0.0;
            s->mass[j * n + i] = s->mass[i * n + j];
        }
    for (size_t a = 0; a < m; a++) s->weight[a] = 1.0;
    for (size_t a = 0; a < m; a++)
        for (size_t i = 0; i < n; i++) {
            form *const f = &s->mu[a][i];
            f->constant = (a == i ? 1.5 : 0.0) + 0.3 * next_number(seed);
            f->slope = d->far > 1.0 || d->fast > 1.0 ? 0.0 : 0.3 * next_number(seed);
            f->wave = d->wave * next_number(seed);
            f->frequency = 1.0 + fabs(next_number(seed));
            f->phase = next_number(seed);
            f->of_slope = (size_t)(n * fabs(next_number(seed))) % n;
            f->of_wave = (size_t)(n * fabs(next_number(seed))) % n;
            if (!d->steady) continue;
            f->of_slope = f->of_wave = n - 1; /* which no reaction pushes */
            if (i == n - 1) f->constant = f->slope = f->wave = 0.0;
        }
}

/* ---- one beta-step in long double ---------------------------------------------------------- */

/* A[N*N] <- its inverse; false if a pivot is 0. */
static bool invert(size_t N, real *A)
{
    real B[MOST][2 * MOST];
    for (size_t i = 0; i < N; i++)
        for (size_t j = 0; j < N; j++) {
            B[i][j] = A[i * N + j];
            B[i][N + j] = i == j ? 1.0L : 0.0L;
        }
    for (size_t k = 0; k < N; k++) {
        size_t best = k;
        real most = 0.0L;
        for (size_t i = k; i < N; i++) { /* relative to its row: units may be far apart */
            real row = 0.0L;
            for (size_t j = k; j < N; j++) row = fmaxl(row, fabsl(B[i][j]));
            if (fabsl(B[i][k]) <= most * row) continue;
            most = fabsl(B[i][k]) / row;
            best = i;
        }
        if (!(most > 0.0L)) return false;
        for (size_t j = 0; j < 2 * N; j++) {
            const real entry = B[k][j];
            B[k][j] = B[best][j];
            B[best][j] = entry;
        }
        for (size_t i = 0; i < N; i++) {
            const real factor = B[i][k] / B[k][k];
            for (size_t j = k; i != k && j < 2 * N; j++) B[i][j] -= factor * B[k][j];
        }
    }
    for (size_t i = 0; i < N; i++)
        for (size_t j = 0; j < N; j++) A[i * N + j] = B[i][N + j] / B[i][i];
    return true;
}

typedef struct step {
    real q[MOST_N], v[MOST_N], node[MOST_N]; /* q~, v, q_k */
    real w[MOST_N], kappa[MOST_M], end[MOST_N]; /* v', kappa, q~' */
    real error[MOST]; /* what a rounding of every term does to w and kappa */
} step;

/* How much f changes when q doubles, to first order. */
static real turn_of(const drawn *s, const form *f, const real *q)
{
    const real x = q[f->of_slope] / s->unit[f->of_slope], y = q[f->of_wave] / s->unit[f->of_wave];
    const real bend = f->wave * f->frequency * cosl(f->frequency * y + f->phase);
    return fabsl(f->slope * x) + fabsl(bend * y);
}

/* Newton from w, kappa with step h. */
static bool solve(const drawn *s, const draw *d, real h, step *t)
{
    const size_t n = s->n, m = s->m, N = n + m;
    const real beta = d->beta;
    real muk[MOST_M * MOST_N], mu[MOST_M * MOST_N], slope[MOST_M * MOST_N], J[MOST * MOST];
    real start[MOST_N] = {0}, end[MOST_N] = {0};
    real before[MOST_N * MOST_N] = {0}, hessian[MOST_N * MOST_N] = {0};
    real R[MOST], size[MOST], extent[MOST_N], speed = 0.0L; /* |w| and |v| of residual.h */
    if (d->potential) gradient_at(s, t->q, start, before);
    for (size_t i = 0; i < n; i++) t->node[i] = t->q[i] + (1.0L - beta) * h * t->v[i];
    forms_at(s, t->node, t->v, muk, NULL);
    for (int iteration = 0; iteration < 40; iteration++) {
        for (size_t i = 0; i < n; i++) t->end[i] = t->node[i] + beta * h * t->w[i];
        forms_at(s, t->end, t->w, mu, slope);
        if (d->potential) gradient_at(s, t->end, end, hessian);
        for (size_t i = 0; i < n; i++) /* a kept node is rounded, and q~' is found from it */
            extent[i] = fabsl(t->end[i]) + fabsl(t->node[i])
                      + (d->kept ? fabsl((1.0L - beta) * h * t->w[i]) : 0.0L);
        for (size_t k = 0; k < N * N; k++) J[k] = 0.0L;
        for (size_t i = 0; i < n; i++)
            speed = fmaxl(speed, (fabsl(t->w[i]) + fabsl(t->v[i])) * sqrtl(s->mass[i * n + i]));
        for (size_t i = 0; i < n; i++) {
            const real pull = h * (beta * start[i] + (1.0L - beta) * end[i]);
            R[i] = pull;
            size[i] = fabsl(h * beta * start[i]) + fabsl(h * (1.0L - beta) * end[i]);
            for (size_t j = 0; j < n; j++) {
                const real M = s->mass[i * n + j], V = h * (1.0L - beta) * hessian[i * n + j];
                R[i] += M * (t->w[j] - t->v[j]);
                size[i] += fabsl(M) * speed / sqrtl(s->mass[j * n + j]) + fabsl(V) * extent[j];
                if (d->kept) size[i] += fabsl(h * beta * before[i * n + j] * t->q[j]); /* as q~' */
                J[i * N + j] = M + V * beta * h;
            }
            for (size_t a = 0; a < m; a++) {
                R[i] -= muk[a * n + i] * t->kappa[a];
                size[i] += fabsl(muk[a * n + i] * t->kappa[a])
                         + turn_of(s, &s->mu[a][i], t->node) / s->unit[i] * fabsl(t->kappa[a]);
                J[i * N + n + a] = -muk[a * n + i];
            }
        }
        for (size_t a = 0; a < m; a++) {
            R[n + a] = size[n + a] = 0.0L;
            for (size_t i = 0; i < n; i++) {
                const real form = mu[a * n + i], turn = slope[a * n + i];
                R[n + a] += form * t->w[i];
                size[n + a] += fabsl(form) * speed / sqrtl(s->mass[i * n + i])
                             + fabsl(turn) * extent[i];
                J[(n + a) * N + i] = form + beta * h * turn;
            }
        }
        if (!invert(N, J)) return false;
        real largest = 0.0L;
        for (size_t k = 0; k < N; k++) {
            real change = 0.0L;
            t->error[k] = 0.0L;
            for (size_t l = 0; l < N; l++) {
                change -= J[k * N + l] * R[l];
                t->error[k] += fabsl(J[k * N + l]) * size[l] * U;
            }
            if (k < n) t->w[k] += change;
            else t->kappa[k - n] += change;
            if (!(fabsl(change) <= 1e-3L * t->error[k])) largest = 1.0L;
        }
        if (largest == 0.0L) return true;
    }
    return false;
}

/* The solution that grows out of (v, 0) as h does. */
static bool follow(const drawn *s, const draw *d, step *t)
{
    enum { PARTS = 8 };
    memcpy(t->w, t->v, sizeof t->w);
    memset(t->kappa, 0, sizeof t->kappa);
    for (int part = 1; part <= PARTS; part++) {
        if (part > 1) /* a line through the start */
            for (size_t i = 0; i < s->n; i++)
                t->w[i] += (t->w[i] - t->v[i]) / (part - 1);
        for (size_t a = 0; part > 1 && a < s->m; a++) t->kappa[a] *= (real)part / (part - 1);
        if (!solve(s, d, d->h * (real)part / PARTS, t)) return false;
    }
    return true;
}

/* The largest error of the step from x to x1, lambda, over what rounding may do; or -1 if there is
 * no solution to compare with. */
static double judge(const drawn *s, const draw *d, const double *x, const double *x1,
                    const double *lambda)
{
    const size_t n = s->n;
    const real shift = d->kept ? (1.0L - d->beta) * d->h : 0.0L;
    step t;
    real worst = 0.0L, speed = 0.0L, lost = 0.0L;
    for (size_t i = 0; i < n; i++) {
        t.v[i] = x[n + i];
        t.q[i] = x[i] - shift * t.v[i];
    }
    if (!follow(s, d, &t)) return -1.0;
    for (size_t i = 0; i < n; i++) { /* rounding alone decides, as after a blow-up */
        const real mass = sqrtl(s->mass[i * n + i]);
        speed = fmaxl(speed, fabsl(t.w[i]) * mass);
        lost = fmaxl(lost, t.error[i] * mass);
    }
    if (!(lost <= 1e-9L * speed)) return -1.0;
    for (size_t i = 0; i < n; i++) {
        const real end = t.end[i] + shift * t.w[i];
        const real moved = U * (fabsl(t.q[i]) + fabsl(end)) + fabsl(d->h) * t.error[i];
        worst = fmaxl(worst, fabsl(x1[n + i] - t.w[i]) / (t.error[i] + 1e-300L));
        worst = fmaxl(worst, fabsl(x1[i] - end) / (moved + 1e-300L));
    }
    for (size_t a = 0; a < s->m; a++)
        worst = fmaxl(worst, fabsl(lambda[a] * d->h - t.kappa[a]) / (t.error[n + a] + 1e-300L));
    return (double)worst;
}

typedef struct tally {
    size_t judged, refused;
    size_t above, untold; /* states whose residual is above its bound, or above worst_residual */
    double worst;
    dal_stats sum;
} tally;

static void add_stats(dal_stepper *stepper, dal_stats *sum)
{
    const dal_stats stats = stats_of(stepper);
    sum->steps += stats.steps;
    sum->constraint_calls += stats.constraint_calls;
    sum->potential_calls += stats.potential_calls;
    sum->full_newtons += stats.full_newtons;
    sum->corrections += stats.corrections;
}

/* The system s as a stepper at x[2n] or, where D is, near it; NULL if it cannot start there. */
static dal_stepper *start_drawn(drawn *s, const draw *d, const double *x, dal_system **system)
{
    const dal_system_def def = {.n = s->n, .m = s->m, .mass = s->mass, .ctx = s, .name = "drawn",
                                .potential = d->potential ? potential : NULL,
                                .constraint = s->m > 0 ? constraint : NULL,
                                .force = d->general ? no_push : NULL,
                                .steady = d->steady && s->m > 0 ? DAL_STEADY_DECLARED : 0};
    const dal_scheme scheme = {.name = "drawn", .beta = d->beta,
                               .nodes = d->kept ? DAL_KEPT_NODES : DAL_MOVED_NODES};
    *system = new_system(&def);
    dal_stepper *const stepper = open_stepper(*system, &scheme, NULL);
    if (!dal_stepper_start(stepper, 0.0, d->h, x, DAL_PROJECT,
                           d->kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE)) {
        const dal_stats stats = stats_of(stepper);
        s->constraint_calls = stats.constraint_calls;
        s->potential_calls = stats.potential_calls;
        return stepper;
    }
    return NULL;
}

static void draw_state(const drawn *s, const draw *d, unsigned *seed, double *x)
{
    for (size_t i = 0; i < s->n; i++) {
        x[i] = (s->home[i] + next_number(seed)) * s->unit[i];
        x[s->n + i] = d->rest ? 0.0 : d->fast * next_number(seed) * s->unit[i];
    }
}

static void run(const draw *d, unsigned seed, tally *count)
{
    drawn s;
    double x[2 * MOST_N], lambda[MOST_M], most = 0.0; /* residual so far */
    dal_system *system = NULL;
    draw_system(&s, d, &seed);
    draw_state(&s, d, &seed, x);
    dal_stepper *const stepper = start_drawn(&s, d, x, &system);
    for (int k = 0; stepper && k < d->steps; k++) {
        memcpy(x, dal_stepper_state(stepper), 2 * s.n * sizeof *x);
        if (dal_step(stepper, lambda)) {
            count->refused++;
            break;
        }
        const double *const y = dal_stepper_state(stepper);
        const size_t calls[2] = {s.constraint_calls, s.potential_calls};
        const double residual = residual_of(system, d->kept ? (1.0 - d->beta) * d->h : 0.0, y);
        most = fmax(most, residual);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.constraint_calls == calls[0] && stats.potential_calls == calls[1]);
        s.constraint_calls = calls[0]; /* those of residual_of are not the stepper's */
        count->above += residual > DAL_RESIDUAL_BOUND(s.n);
        count->untold += most > (1.0 + 1e-12) * stats.worst_residual;
        const double found = judge(&s, d, x, y, lambda);
        if (found < 0.0) continue;
        count->judged++;
        count->worst = fmax(count->worst, found);
    }
    if (stepper) add_stats(stepper, &count->sum);
    release(system);
}

static draw nth_draw(unsigned k)
{
    static const double betas[2][4] = {{0.0, 0.5, 1.0, 0.3}, {0.0, 0.5, 1.0, 0.999}};
    static const double steps[] = {0.01, -0.1, 0.4, 1.0};
    return (draw){.potential = k & 1, .steady = k >> 1 & 1, .kept = k >> 2 & 1,
                  .rest = k >> 3 & 1, .units = k >> 4 & 1 ? 2 : 0, .far = k >> 5 & 1 ? 1e4 : 1.0,
                  .fast = 1.0, .wave = 0.5, .beta = betas[k >> 3 & 1][k >> 6 & 3],
                  .h = steps[k >> 8 & 3], .steps = 5, .general = k >> 10 & 1};
}

/* Every step that is a success is the solution that belongs to small h, within what rounding may
 * do; what is stored lies in D; and this costs no more than it has to, without V, with V, and in
 * systems that the step routine is not for. */
static void test_steps(unsigned systems)
{
    static const double most[3][4] = {{1.60, 0.0, 0.0, 0.041}, {2.52, 5.40, 0.123, 0.048},
                                      {4.42, 2.89, 0.065, 0.075}};
    tally counts[3] = {{0}};
    for (unsigned k = 0; k < systems; k++) {
        const draw d = nth_draw(k);
        run(&d, k + 1, &counts[d.general ? 2 : d.potential]);
    }
    for (size_t kind = 0; kind < 3; kind++) {
        const tally *const count = &counts[kind];
        const dal_stats *const sum = &count->sum;
        const double steps = (double)sum->steps;
        CHECK_NEAR(count->worst, 0.0, 25.0);
        CHECK(5 * count->judged > 4 * sum->steps && 50 * count->refused <= systems);
        CHECK(count->above == 0 && count->untold == 0);
        CHECK((double)sum->constraint_calls <= most[kind][0] * steps);
        CHECK((double)sum->potential_calls <= most[kind][1] * steps);
        CHECK((double)sum->full_newtons <= most[kind][2] * steps);
        CHECK((double)sum->corrections <= most[kind][3] * steps);
        CHECK(sum->corrections > 0);
    }
}

/* Steps so large that their equations have several solutions: what is found is the right one. */
static void test_large_steps(void)
{
    tally count = {0};
    for (unsigned k = 0; k < 256; k++) {
        draw d = nth_draw(k);
        d.potential = d.steady = d.kept = d.rest = false;
        d.units = 0;
        d.far = 1.0;
        d.beta = 0.3;
        d.h = 4.5;
        d.steps = 1;
        run(&d, k + 1, &count);
    }
    CHECK_NEAR(count.worst, 0.0, 25.0);
    CHECK(count.refused <= 5);
}

/* The steps of newton.c; and where next to all of V acts at the start of the step after. */
static void test_other_steps(void)
{
    tally count = {0};
    for (unsigned k = 0; k < 2048; k += brief() ? 16 : 1) {
        draw d = nth_draw(k % 1024);
        d.h = fmin(d.h, 0.4); /* beyond it other solutions come into reach */
        d.general = k < 1024;
        if (!d.general) d.kept = false, d.beta = 0.999;
        run(&d, k + 1, &count);
    }
    CHECK_NEAR(count.worst, 0.0, 25.0);
    CHECK(count.above == 0 && count.untold == 0 && count.refused <= 5);
}

/* So far out that a rounding of q moves the forms by more than 1e-11, in any units: a step ends
 * where no better one is to be had. */
static void test_far(void)
{
    tally count = {0};
    for (unsigned k = 0; k < 1024; k++) {
        draw d = nth_draw(k);
        d.far = 1e9;
        d.units = k & 1 ? 9 : 0;
        if (d.beta == 0.0) d.beta = 0.7;
        if (d.h < 0.4) d.h = 0.7;
        run(&d, k + 1, &count);
    }
    CHECK(count.above == 0 && count.untold == 0 && count.refused <= 5);
}

/* Kept nodes so far from their q~' that a rounding of them turns the forms there: no better step is
 * to be had, and the residual knows it. */
static void test_lost_nodes(void)
{
    tally count = {0};
    for (unsigned k = 0; k < 512; k++) {
        draw d = nth_draw(k);
        d.fast = 1e8;
        d.wave = 0.005;
        d.kept = true;
        d.potential = d.steady = d.rest = false;
        d.units = 0;
        d.far = 1.0;
        d.h = 1.0;
        run(&d, k + 1, &count);
    }
    CHECK(count.untold == 0 && count.above == 0);
}

/* The same motion, to the last bit, and the same decisions in other units of coordinates and
 * forms. */
static void test_units(unsigned systems)
{
    for (unsigned k = 0; k < systems; k++) {
        const draw d = nth_draw(k);
        unsigned seed = k + 1;
        int unit[MOST_N], weight[MOST_M];
        double x[2 * MOST_N], lambda[2][MOST_M];
        dal_system *system[2] = {NULL, NULL};
        dal_stepper *stepper[2];
        dal_stats stats[2];
        drawn s[2];
        draw_system(&s[0], &d, &seed);
        draw_state(&s[0], &d, &seed, x);
        s[1] = s[0];
        const size_t n = s[0].n, m = s[0].m;
        for (size_t i = 0; i < n; i++) unit[i] = (int)(100.0 * next_number(&seed));
        for (size_t a = 0; a < m; a++) weight[a] = (int)(100.0 * next_number(&seed));
        stepper[0] = start_drawn(&s[0], &d, x, &system[0]);
        for (size_t a = 0; a < m; a++) s[1].weight[a] = ldexp(1.0, weight[a]);
        for (size_t i = 0; i < n; i++) {
            s[1].unit[i] = ldexp(s[0].unit[i], unit[i]);
            x[i] = ldexp(x[i], unit[i]);
            x[n + i] = ldexp(x[n + i], unit[i]);
            for (size_t j = 0; j < n; j++)
                s[1].mass[i * n + j] = ldexp(s[0].mass[i * n + j], -unit[i] - unit[j]);
        }
        stepper[1] = start_drawn(&s[1], &d, x, &system[1]);
        CHECK(!stepper[0] == !stepper[1]);
        for (int step = 0; stepper[0] && stepper[1] && step < d.steps; step++) {
            const int status = dal_step(stepper[0], lambda[0]);
            CHECK(dal_step(stepper[1], lambda[1]) == status);
            const double *const y = dal_stepper_state(stepper[0]);
            const double *const z = dal_stepper_state(stepper[1]);
            for (size_t i = 0; i < 2 * n; i++) CHECK(ldexp(y[i], unit[i % n]) == z[i]);
            for (size_t a = 0; !status && a < m; a++)
                CHECK(ldexp(lambda[0][a], -weight[a]) == lambda[1][a]);
            dal_stepper_stats(stepper[0], &stats[0]);
            dal_stepper_stats(stepper[1], &stats[1]);
            CHECK(stats[0].worst_residual == stats[1].worst_residual);
            CHECK(stats[0].iterations == stats[1].iterations);
            CHECK(stats[0].corrections == stats[1].corrections);
        }
        release(system[0]);
    }
}

/* ---- how long the Hessian is left out ------------------------------------------------------ */

/* V = -5 q, and a soft wall: 10 q^2/2 more where q > 0. */
static int wall(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double in = q[0] > 0.0 ? q[0] : 0.0;
    (void)ctx;
    if (V) *V = -5.0 * q[0] + 5.0 * in * in;
    if (V_q) *V_q = -5.0 + 10.0 * in;
    if (V_qq) *V_qq = in > 0.0 ? 10.0 : 0.0;
    return 0;
}

/* V = k q^4/4. */
static int quartic(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double k = *(const double *)ctx;
    if (V) *V = k * pow(q[0], 4.0) / 4.0;
    if (V_q) *V_q = k * pow(q[0], 3.0);
    if (V_qq) *V_qq = 3.0 * k * q[0] * q[0];
    return 0;
}

static dal_stepper *start_in_line(dal_potential_fn V, double *k, double beta, double h,
                                  const double *x)
{
    static const double mass[1] = {1.0};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = V, .ctx = k};
    const dal_scheme scheme = {.name = "line", .beta = beta};
    return start_stepper(new_system(&def), &scheme, h, x);
}

/* The largest error of v' - v = -h (beta V_q(q) + (1-beta) V_q(q')) in steps, in roundings of what
 * stands there. */
static double worst_balance(dal_potential_fn V, double *k, double beta, double h, double q)
{
    enum { STEPS = 1000 };
    const double start[2] = {q, 0.3};
    double x[2], worst = 0.0, before, after;
    dal_stepper *const stepper = start_in_line(V, k, beta, h, start);
    const double *const y = dal_stepper_state(stepper);
    for (int step = 0; step < STEPS; step++) {
        memcpy(x, y, sizeof x);
        CHECK(dal_step(stepper, NULL) == 0);
        V(0.0, x, NULL, &before, NULL, k);
        V(0.0, y, NULL, &after, NULL, k);
        const real sum = (real)y[1] - x[1] + (real)h * ((real)beta * before
                                                        + (1.0L - (real)beta) * after);
        const real size = fabs(y[1]) + fabs(x[1])
                        + h * (fabs(x[0]) + fabs(y[0]) + fabs(before) + fabs(after));
        worst = fmax(worst, (double)fabsl(sum / size) / U);
    }
    return worst;
}

/* Every step is balanced: the first in a wall as those of the free fall before it; where the next
 * step gives V_q(q') far more weight than this one; and after the full Newton iteration. */
static void test_balance(void)
{
    double k = 1.0;
    for (double h = 0.01; h < 0.5; h *= 1.25) {
        CHECK_NEAR(worst_balance(wall, NULL, 0.5, h, -10.0), 0.0, 8.0);
        CHECK_NEAR(worst_balance(spring, &k, 1.0 - 1e-5, h, 1.0), 0.0, 8.0);
    }
    for (double h = 0.5; h < 1.5; h += 0.01) /* by the full Newton iteration */
        CHECK_NEAR(worst_balance(quartic, &k, 0.5, h, 1.0), 0.0, 8.0);
}

/* Midpoint steps keep the energy of a spring.  What an iteration leaves has one sign: after so many
 * steps it would stand out from the sum of their roundings. */
static void test_energy_of_spring(void)
{
    enum { STEPS = 200000 };
    const double steps[] = {0.014784, 0.0338851, 0.104079}, x[2] = {1.0, 0.3};
    for (size_t j = 0; j < 3; j++) {
        double k = 1.0;
        dal_stepper *const stepper = start_in_line(spring, &k, 0.5, steps[j], x);
        CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
        const double *const y = dal_stepper_state(stepper);
        const real change = ((real)y[0] * y[0] + (real)y[1] * y[1]) / 1.09L - 1.0L;
        CHECK_NEAR((double)change / U, 0.0, 20.0 * sqrt((double)STEPS));
        release(stepper);
    }
}

/* One midpoint step of a spring: corrections without the Hessian shrink by c = h^2 k/4, and
 * v' (1 + c) = v (1 - c) - h k q.  Ten of them do it, or the full matrix takes over; at once where
 * they do not halve. */
static void test_corrections(void)
{
    const double x[2] = {1.0, 0.5}, contraction[] = {0.004, 0.3, 0.7};
    for (size_t j = 0; j < 3; j++) {
        const double c = contraction[j];
        double k = 4.0 * c;
        dal_stepper *const stepper = start_in_line(spring, &k, 0.5, 1.0, x);
        CHECK(dal_step(stepper, NULL) == 0);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.full_newtons == (j > 0));
        CHECK(j == 1 ? stats.iterations > 10 : stats.iterations <= 9);
        CHECK_NEAR(dal_stepper_state(stepper)[1], (0.5 * (1.0 - c) - k) / (1.0 + c), 8 * U);
        release(stepper);
    }
}

/* A spring that stops in the step, v = h k q/(1-c): its velocity is the rounding of what it was. */
static void test_stop(void)
{
    for (double c = 0.001; c < 0.01; c += 0.001) {
        double k = 4.0 * c;
        const double x[2] = {1.0, k / (1.0 - c)};
        dal_stepper *const stepper = start_in_line(spring, &k, 0.5, 1.0, x);
        CHECK(dal_step(stepper, NULL) == 0);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.full_newtons == 0);
        CHECK_NEAR(dal_stepper_state(stepper)[1], 0.0, 4 * U * k);
        release(stepper);
    }
}

/* M + h^2 V_qq/4 = 1 + c for a spring: where it is 0 there is no step, and beyond no small h leads
 * to it. */
static void test_negative_spring(void)
{
    const struct {
        double c;
        int status;
        const char *words;
    } cases[] = {{-0.9, DAL_SUCCESS, ""},
                 {-1.0 + U, DAL_ESINGULAR, "the derivative K of the equations"},
                 {-1.0, DAL_ESINGULAR, "the derivative K of the equations"},
                 {-1.1, DAL_ENOCONV, DAL__BRANCH_TEXT}};
    for (size_t j = 0; j < sizeof cases / sizeof *cases; j++) {
        const double x[2] = {1.0, 0.5}, c = cases[j].c;
        double k = 4.0 * c;
        dal_stepper *const stepper = start_in_line(spring, &k, 0.5, 1.0, x);
        CHECK(dal_step(stepper, NULL) == cases[j].status);
        CHECK(strstr(dal_stepper_error(stepper)->text, cases[j].words) != NULL);
        if (!cases[j].status)
            CHECK_NEAR(dal_stepper_state(stepper)[1], (0.5 * (1.0 - c) - k) / (1.0 + c), 400 * U);
        release(stepper);
    }
}

/* V = (a x^2 + b y^2)/2; a and b are the ctx. */
static int two_springs(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *const k = ctx;
    if (V) *V = (k[0] * q[0] * q[0] + k[1] * q[1] * q[1]) / 2.0;
    for (size_t i = 0; V_q && i < 2; i++) V_q[i] = k[i] * q[i];
    if (V_qq) V_qq[0] = k[0], V_qq[1] = V_qq[2] = 0.0, V_qq[3] = k[1];
    return 0;
}

/* A stiff spring beside a soft one, or none, is no reason to call the matrix singular. */
static void test_stiff_beside_soft(void)
{
    static const double mass[4] = {1, 0, 0, 1}, x[4] = {1.0, 1.0, 0.5, 0.5};
    for (int with = 0; with < 2; with++) {
        double k[2] = {4e20, with ? 0.4 : 0.0};
        const dal_system_def def = {.n = 2, .mass = mass, .potential = two_springs, .ctx = k};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = start_named(system, "midpoint", 1.0, x);
        CHECK(dal_step(stepper, NULL) == 0);
        for (size_t i = 0; i < 2; i++) {
            const double c = k[i] / 4.0, exact = (0.5 * (1.0 - c) - k[i]) / (1.0 + c);
            CHECK_NEAR(dal_stepper_state(stepper)[2 + i], exact, 16 * U * fabs(exact));
        }
        release(system);
    }
}

/* V = G q - g log q where q > 0; its domain ends there. */
typedef struct slope {
    double G, g;
} slope;

static int towards_an_end(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const slope *const s = ctx;
    if (!(q[0] > 0.0)) return 1;
    if (V) *V = s->G * q[0] - s->g * log(q[0]);
    if (V_q) *V_q = s->G - s->g / q[0];
    if (V_qq) *V_qq = s->g / (q[0] * q[0]);
    return 0;
}

static dal_stepper *start_on_slope(slope *s, int iterations, double v)
{
    static const double mass[1] = {1.0};
    const double x[2] = {1.0, v};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = towards_an_end, .ctx = s};
    const dal_scheme scheme = find_scheme("midpoint");
    const dal_options options = {.max_iterations = iterations};
    dal_stepper *const stepper = open_stepper(new_system(&def), &scheme, &options);
    CHECK(dal_stepper_start(stepper, 0.0, 1.0, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    return stepper;
}

/* A midpoint step from q = 1 at rest with h = 1: v' = 2 (x - 1) where x = q' is the positive root
 * of 2 x^2 + b x + c = 0, b = G - g/2 - 2, c = -g/2.  Newton's steps lead out of the domain and are
 * halved, 40 times at most, and as many iterations are made as may be. */
static void test_halvings(void)
{
    const struct {
        double G, g;
        int status;
    } cases[] = {{10, 0.5, 0}, {100, 0.5, 0}, {1000, 0.5, 0}, {3.8, 3e-4, 0},
                 {1e4, 0.5, DAL_EDOMAIN}};
    dal_stats stats;
    for (size_t j = 0; j < sizeof cases / sizeof *cases; j++) {
        slope s = {.G = cases[j].G, .g = cases[j].g};
        const real b = s.G - s.g / 2.0L - 2.0L, c = -s.g / 2.0L;
        const real exact = 2.0L * (-2.0L * c / (b + sqrtl(b * b - 8.0L * c)) - 1.0L);
        dal_stepper *const stepper = start_on_slope(&s, 0, 0.0);
        CHECK(dal_step(stepper, NULL) == cases[j].status);
        dal_stepper_stats(stepper, &stats);
        CHECK(cases[j].status ? stats.halvings == 40 : stats.halvings > 0 && stats.halvings < 40);
        if (!cases[j].status)
            CHECK_NEAR(dal_stepper_state(stepper)[1], (double)exact, 8 * U * s.G);
        release(stepper);
    }
    slope s = {.G = 1.0, .g = 0.5}; /* where it starts is out of the domain: nothing to halve */
    dal_stepper *const stepper = start_on_slope(&s, 0, -3.0);
    CHECK(dal_step(stepper, NULL) == DAL_EDOMAIN);
    dal_stepper_stats(stepper, &stats);
    CHECK(stats.full_newtons == 1 && stats.halvings == 0);
}

/* What is said where the iterations are too few: at rest v' changes in the first by F/K with F = G
 * - g and K = 1 + g/4, of |v'| + |F/2| + |F/2|. */
static void test_too_few_iterations(void)
{
    slope s = {.G = 1.0, .g = 0.9};
    for (int most = 1; most <= 4; most++) {
        dal_stepper *const stepper = start_on_slope(&s, most, 0.0);
        const double first = (s.G - s.g) / (1.0 + s.g / 4.0);
        double change = 0.0, scale = 0.0;
        int made = 0;
        CHECK(dal_step(stepper, NULL) == (most < 4 ? DAL_ENOCONV : DAL_SUCCESS));
        if (most < 4) {
            const char *const text = strstr(dal_stepper_error(stepper)->text, "Newton");
            CHECK(sscanf(text, "Newton did not converge in %d iterations: the last update "
                         "was %lf (size of the unknowns %lf)", &made, &change, &scale) == 3);
            CHECK(made == most && change > 0.0);
            if (most == 1) CHECK_NEAR(change, first, 1e-2 * first);
            if (most == 1) CHECK_NEAR(scale, first + (s.G - s.g), 1e-2 * scale);
        }
        release(stepper);
    }
}

/* Steps that are far too large for a pendulum.  Newton's lead away: the first of them is told, F/K
 * at v' = v, and how far they went. */
static void test_led_away(void)
{
    for (double h = 2.125; h <= 2.5; h += 0.125) {
        const double v = 0.5, x[2] = {1.0, v}, end = 1.0 + h * v;
        const double K = 1.0 + h * h / 4.0 * cos(end), F = h / 2.0 * (sin(1.0) + sin(end));
        double far = 0.0, first = 0.0, scale = 0.0;
        dal_stepper *const stepper = start_in_line(pendulum, NULL, 0.5, h, x);
        CHECK(dal_step(stepper, NULL) == DAL_ENOCONV);
        const char *const text = strstr(dal_stepper_error(stepper)->text, "add up to");
        CHECK(text && sscanf(text, "add up to %lf, the first was %lf (size of the unknowns %lf)",
                             &far, &first, &scale) == 3);
        CHECK_NEAR(first, fabs(F / K), 1e-2 * first);
        CHECK(far > 2.0 * first && scale > 0.0);
        release(stepper);
    }
}

/* ---- the branch that small h lead to -------------------------------------------------------- */

/* The particle at y = -1 by the endpoint scheme: S = 1 + y y' with y' = y + h v_y passes through 0
 * at h v_y = 2.  Beyond it there is a solution, which grows out of no small step; with a force the
 * solver for all unknowns says the same. */
static void test_branch(void)
{
    dal_system *const particle = open_system("particle");
    dal_system_def def = particle->def;
    def.force = no_force;
    dal_system *const pushed = new_system(&def);
    dal_system *const systems[] = {particle, pushed};
    for (size_t j = 0; j < 2; j++)
        for (int beyond = 0; beyond < 2; beyond++) {
            const double x[6] = {0.0, -1.0, 0.0, 1.0, beyond ? 30.0 : 15.0, -1.0};
            dal_stepper *const stepper = start_named(systems[j], "endpoint", 0.1, x);
            CHECK(dal_step(stepper, NULL) == (beyond ? DAL_ENOCONV : DAL_SUCCESS));
            CHECK(!beyond || strstr(dal_stepper_error(stepper)->text, DAL__BRANCH_TEXT) != NULL);
            release(stepper);
        }
}

/* Fused pairs are their sub-steps one after the other, which a force that is zero has made one by
 * one: with and without a span, by the step routine and where the full iteration takes over. */
static void test_pairs(void)
{
    static const dal_substep spanless[] = {{0.0, 0.5}, {1.0, -0.5}, {0.5, 1.0}};
    static const dal_substep uneven[] = {{0.0, 0.3}, {1.0, 0.4}, {0.0, 0.5}, {1.0, -0.2}};
    const dal_scheme schemes[] = {{.name = "spanless", .substeps = spanless, .count = 3},
                                  {.name = "uneven", .substeps = uneven, .count = 4}};
    static const double steps[] = {0.1, 0.6};
    dal_system *const system = open_system("particle_oscillator");
    dal_system_def def = system->def;
    size_t full = 0;
    def.force = no_force;
    dal_system *const pushed = new_system(&def);
    for (size_t j = 0; j < 4; j++) {
        const double h = steps[j / 2], x[6] = {0.3, -0.7, 0.2, 0.5, 2.0, -0.35};
        dal_stepper *const other = open_stepper(pushed, &schemes[j % 2], NULL);
        dal_stepper *const one = start_stepper(system, &schemes[j % 2], h, x);
        CHECK(dal_stepper_start(other, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        for (int k = 0; k < 5; k++) {
            double a[1], b[1];
            CHECK(dal_step(one, a) == 0 && dal_step(other, b) == 0);
            for (size_t i = 0; i < 6; i++)
                CHECK_NEAR(dal_stepper_state(one)[i], dal_stepper_state(other)[i], 1e-12);
            CHECK_NEAR(a[0], b[0], 1e-11);
        }
        const dal_stats stats = stats_of(one);
        full += stats.full_newtons;
        release(other);
    }
    CHECK(full > 0);
}

/* L = v^2/2 + c q v, so v stays; but K = 1 - h c of the explicit scheme may cancel. */
static int drifting(double t, const double *q, const double *v, double *L, double *L_q, double *L_v,
                    double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
{
    const double c = *(const double *)ctx;
    if (L) *L = 0.5 * v[0] * v[0] + c * q[0] * v[0];
    if (L_q) *L_q = c * v[0];
    if (L_v) *L_v = v[0] + c * q[0];
    if (L_qq) *L_qq = 0.0;
    if (L_vq) *L_vq = c;
    if (L_vv) *L_vv = 1.0;
    return 0;
}

static void test_lost_K(void)
{
    const double x[2] = {1.0, 0.5}, h = 0.25;
    for (int k = -2; k <= 8; k++) {
        double c = (k < 8 ? 1.0 + k * U : 0.9) / h;
        const dal_system_def def = {.n = 1, .lagrangian = drifting, .ctx = &c};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = start_named(system, "explicit", h, x);
        CHECK(dal_step(stepper, NULL) == (k < 8 ? DAL_ESINGULAR : DAL_SUCCESS));
        CHECK_NEAR(dal_stepper_state(stepper)[1], 0.5, 40 * U);
        release(system);
    }
}

/* Stages whose nodes stand at the same time: the pull is predicted by the last one, not through
 * both. */
static void test_there_and_back(void)
{
    static const dal_substep there_and_back[] = {{0.5, 1.0}, {0.5, -1.0}, {0.5, 1.0}};
    const dal_scheme scheme = {.name = "there and back", .substeps = there_and_back, .count = 3};
    const double x[6] = {0.3, -0.7, 0.2, 0.5, 2.0, -0.35};
    dal_system *const system = open_system("particle_oscillator");
    dal_stepper *const stepper = start_stepper(system, &scheme, 0.05, x);
    CHECK(dal_advance(stepper, 10, NULL, NULL) == 0);
    const dal_stats stats = stats_of(stepper);
    CHECK(stats.full_newtons == 0);
}

/* ---- S = 0 but for rounding ---------------------------------------------------------------- */

/* v_x = c x v_y and, if there is a second, v_z = 0; c is the ctx. */
static int growth(size_t m, const double *q, const double *v, double *phi, double *mu, double *N,
                  double c)
{
    const double forms[6] = {1.0, -c * q[0], 0.0, 0.0, 0.0, 1.0}, slope[6] = {-c * v[1]};
    if (phi) phi[0] = v[0] - c * q[0] * v[1];
    if (phi && m == 2) phi[1] = v[2];
    if (mu) memcpy(mu, forms, 3 * m * sizeof *mu);
    if (N) memcpy(N, slope, 3 * m * sizeof *N);
    return 0;
}

static int growth_1(double t, const double *q, const double *v, double *phi, double *mu, double *N,
                    double *phi_t, void *ctx)
{
    return growth(1, q, v, phi, mu, N, *(const double *)ctx);
}

static int growth_2(double t, const double *q, const double *v, double *phi, double *mu, double *N,
                    double *phi_t, void *ctx)
{
    return growth(2, q, v, phi, mu, N, *(const double *)ctx);
}

/* An endpoint step from x = 2^-60 with v_y = v, which makes x' = x/(1 - h c v), by the step routine
 * or, forced by nothing, by the solver for all unknowns. */
static int grow(size_t m, double c, double h, double v, bool forced)
{
    static const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const double x[6] = {ldexp(1.0, -60), 0.0, 0.0, c * ldexp(1.0, -60) * v, v, 0.0};
    const dal_system_def def = {.n = 3, .m = m, .mass = mass, .ctx = &c,
                                .constraint = m == 1 ? growth_1 : growth_2,
                                .force = forced ? no_force : NULL};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "endpoint", h, x);
    const int status = dal_step(stepper, NULL);
    return status;
}

/* Where 1 - h c v is a rounding no x' is right; where it is huge nothing is wrong. */
static void test_lost_difference(void)
{
    unsigned seed = 3;
    for (int trial = 0; trial < 200; trial++) {
        const size_t m = 1 + (size_t)trial % 2;
        const double c = 2.0 + next_number(&seed), h = 2.0 + next_number(&seed);
        for (int forced = 0; forced < 2; forced++) {
            CHECK(grow(m, c, h, (1.0 + (trial % 8 - 4) * U) / (h * c), forced) == DAL_ESINGULAR);
            CHECK(grow(m, c, h, -1e16 / (h * c), forced) == 0);
        }
    }
}

/* ---- at rest against what holds ------------------------------------------------------------- */

enum { HELD_N = 4, HELD_M = 2 };
static const double held_forms[HELD_M * HELD_N] = {0.3, 0.7, -0.2, 0.1, -0.4, 0.2, 0.9, 0.6};

static int held_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    if (phi) dal__apply(HELD_M, HELD_N, held_forms, v, phi);
    if (phi_v) memcpy(phi_v, held_forms, sizeof held_forms);
    if (phi_q) memset(phi_q, 0, sizeof held_forms);
    return 0;
}

/* V = (mu_1 - 3 mu_2) q + k |q|^2/2: at 0 it pulls across D only.  ctx is k. */
static int held_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const double k = *(const double *)ctx;
    if (V) *V = 0.0;
    for (size_t i = 0; i < HELD_N; i++) {
        const double pull = held_forms[i] - 3.0 * held_forms[HELD_N + i] + k * q[i];
        if (V) *V += (pull - k * q[i] / 2.0) * q[i];
        if (V_q) V_q[i] = pull;
        for (size_t j = 0; V_qq && j < HELD_N; j++) V_qq[i * HELD_N + j] = i == j ? k : 0.0;
    }
    return 0;
}

/* It stays where it is, and what is left of its velocity is in D, however little V acts at the
 * start or at the end; and only stiff springs need the full Newton iteration. */
static void test_held(void)
{
    enum { STEPS = 20 };
    static const double mass[HELD_N * HELD_N] = {2,   0.3, 0, 0.1, 0.3, 1, 0.2, 0,
                                                 0, 0.2, 3, 0.4, 0.1, 0, 0.4, 1};
    static const double betas[] = {0.5, 0.3, 1e-6, 1.0 - 1e-6, 0.0, 1.0};
    for (size_t j = 0; j < sizeof betas / sizeof *betas; j++)
        for (int stiff = 0; stiff < (j == 0 ? 2 : 1); stiff++) {
            double k = stiff ? 1e3 : 0.0, x[2 * HELD_N] = {0};
            const dal_system_def def = {.n = HELD_N, .m = HELD_M, .mass = mass, .ctx = &k,
                                        .potential = held_potential, .constraint = held_constraint};
            const dal_scheme scheme = {.name = "held", .beta = betas[j]};
            dal_system *const system = new_system(&def);
            dal_stepper *const stepper = start_stepper(system, &scheme, 1.0, x);
            CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
            const double *const y = dal_stepper_state(stepper);
            const dal_stats stats = stats_of(stepper);
            CHECK_NEAR(dal__largest(HELD_N, y + HELD_N), 0.0, 16 * U * STEPS);
            CHECK_NEAR(dal__largest(HELD_N, y), 0.0, 16 * U * STEPS * STEPS);
            CHECK(stats.worst_residual <= DAL_RESIDUAL_BOUND(HELD_N));
            CHECK(stats.full_newtons == (stiff ? STEPS : 0));
            CHECK(stiff || (stats.iterations <= STEPS + 2 && stats.corrections == 0));
            release(system);
        }
}

/* A midpoint step from the top of a hill, V = -4 c q^2/2: K = 1 - c passes through 0. */
static void test_hill(void)
{
    const double mass[1] = {1.0}, x[2] = {0.1, 0.5}, c[2] = {0.5, 2.0};
    for (int j = 0; j < 4; j++) {
        const bool beyond = j % 2 == 1;
        double k = -4.0 * c[j % 2];
        const dal_system_def def = {.n = 1, .mass = mass, .potential = spring, .ctx = &k,
                                    .force = j < 2 ? NULL : no_force_1};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = start_named(system, "midpoint", 1.0, x);
        CHECK(dal_step(stepper, NULL) == (beyond ? DAL_ENOCONV : DAL_SUCCESS));
        CHECK(!beyond || strstr(dal_stepper_error(stepper)->text, DAL__BRANCH_TEXT) != NULL);
        release(system);
    }
}

/* ---- initial data, and the time of a row --------------------------------------------------- */

/* The particle, mu = (-y, 0, 1): 1e-8 of the terms is meant to be D, or roundoff of the speed. */
static void test_consistent(void)
{
    const double x[4][6] = {{0.0, -1.0, 0.0, 1.0, 0.0, -1.0 + 1e-8},
                            {0.0, -1.0, 0.0, 1.0, 0.0, -1.0 + 3e-8},
                            {0.0, -1.0, 0.0, 0.0, 1.0, 1e-17},
                            {0.0, -1.0, 0.0, 0.0, 1.0, 1e-13}};
    const int expected[4] = {DAL_SUCCESS, DAL_EOFFD, DAL_SUCCESS, DAL_EOFFD};
    dal_system *const system = open_system("particle");
    dal_stepper *const stepper = open_named(system, "endpoint");
    for (size_t j = 0; j < 4; j++)
        CHECK(dal_stepper_start(stepper, 0.0, 0.1, x[j], DAL_CHECK, DAL_INITIAL_NONE)
              == expected[j]);
}

static int growing_force(double t, const double *q, const double *v, const double *u, double *f,
                         double *f_q, double *f_v, void *ctx)
{
    no_force(t, q, v, u, f, f_q, f_v, ctx);
    if (f) f[2] = t;
    return 0;
}

/* Row k of a trajectory is at t0 + k h. */
static void test_times(void)
{
    enum { ROWS = 3 };
    dal_system *const particle = open_system("particle");
    dal_system_def def = particle->def;
    def.force = growing_force;
    dal_system *const pushed = new_system(&def);
    dal_mechanics *const mechanics = open_mechanics(pushed);
    const double x[ROWS][6] = {{0.0, 0.5, 0.0, 1.0, 0.2, 0.5}, {0.0, 0.5, 0.0, 1.0, 0.2, 0.5},
                               {0.0, 0.5, 0.0, 1.0, 0.2, 0.5}};
    double lambda[ROWS], expected;
    CHECK(dal_trajectory(mechanics, 1.0, 0.5, 0.0, ROWS, x[0], NULL, NULL, lambda, NULL, NULL, NULL)
          == 0);
    for (size_t k = 0; k < ROWS; k++) {
        CHECK(dal_multipliers(mechanics, 1.0 + 0.5 * (double)k, x[k], &expected) == 0);
        CHECK(lambda[k] == expected);
    }
    CHECK_NEAR(lambda[0] - lambda[2], 1.0 / 1.25, 8 * U); /* -mu_z f_z / (1 + y^2) */
}

/* ---- what Newton's steps say ---------------------------------------------------------------- */

static double told(void *ctx) { return *(const double *)ctx; }

/* After steps of these sizes, of a solution of size 1; before the second the first is halved so
 * many times. */
static void test_judge(void)
{
    static const struct {
        double size[9]; /* up to the first 0 */
        dal__verdict verdict;
        double moves;
        bool lagging;
        int halvings;
    } cases[] = {
        /* roundoff at once; or else by the second at the earliest */
        {{3 * 0x1p-53}, DAL__DONE, 0, false, 0},
        {{5 * 0x1p-53}, DAL__GOING, 0, false, 0},
        {{1e-14, 3 * 0x1p-53}, DAL__DONE, 0, false, 0},
        /* what would follow if they converge quadratically, which lagging ones do not */
        {{1e-3, 1e-9}, DAL__GOING, 0, false, 0},
        {{1e-3, 1e-11}, DAL__DONE, 0, false, 0},
        {{1e-3, 1e-11}, DAL__GOING, 0, true, 0},
        {{1, 1e-10}, DAL__GOING, 0, false, 20},
        /* roundoff that does not shrink, which far out is larger */
        {{1e-3, 5e-12, 5e-12}, DAL__DONE, 0, true, 0},
        {{1e-3, 1e-10, 1e-10}, DAL__GOING, 0, true, 0},
        {{1e-3, 1e-9, 1e-9}, DAL__DONE, 1e6, true, 0},
        {{1e-3, 3e-9, 3e-9}, DAL__GOING, 1e6, true, 0},
        /* a first step, and what half of it or its first ratio make of a geometric sum */
        {{1, 2}, DAL__LOST, 0, false, 0},
        {{1, 0.1, 0.09}, DAL__GOING, 0, false, 0},
        {{1, 0.4, 0.4, 0.15}, DAL__GOING, 0, false, 0},
        {{1, 0.4, 0.4, 0.25}, DAL__LOST, 0, false, 0},
        {{1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3}, DAL__GOING, 0, false, 0},
        {{1, 0.4, 0.35, 0.2500019, 5e-7}, DAL__LOST, 0, false, 0},
        {{1, 0.4, 0.35, 0.2500019, 5e-7}, DAL__GOING, 1e10, false, 0},
        {{1, 0.4, 0.4, 0.4, 0.39}, DAL__GOING, 0, false, 3},
        {{INFINITY}, DAL__LOST, 0, false, 0},
        {{1, NAN}, DAL__LOST, 0, false, 0},
    };
    for (size_t i = 0; i < DAL_LENGTH(cases); i++) {
        dal__progress p = {.scale = 1.0, .moves = told, .ctx = (void *)&cases[i].moves,
                           .lagging = cases[i].lagging};
        dal__verdict verdict = DAL__GOING;
        for (p.iteration = 1; cases[i].size[p.iteration - 1] != 0.0; p.iteration++) {
            check_true(verdict == DAL__GOING, "test_judge", "ended early", (int)i);
            verdict = dal__newton_judge(&p, cases[i].size[p.iteration - 1]);
            for (int k = 0; p.iteration == 1 && k < cases[i].halvings; k++)
                CHECK(dal__newton_halve(&p, DAL_EDOMAIN, 0, NULL, NULL));
        }
        check_true(verdict == cases[i].verdict, "test_judge", "verdict", (int)i);
    }
}

int main(int argc, char **argv)
{
    test_steps(argc > 1 ? (unsigned)atoi(argv[1]) : 2048); /* or as many as are asked for */
    test_large_steps();
    test_other_steps();
    test_far();
    test_lost_nodes();
    test_units(1024);
    test_balance();
    test_energy_of_spring();
    test_corrections();
    test_stop();
    test_negative_spring();
    test_stiff_beside_soft();
    test_halvings();
    test_too_few_iterations();
    test_led_away();
    test_branch();
    test_pairs();
    test_lost_K();
    test_there_and_back();
    test_hill();
    test_judge();
    test_lost_difference();
    test_held();
    test_consistent();
    test_times();
    return check_done();
}
