/* The adaptive integrator against equations with known solutions, and how it fails. */
#include "check.h"
#include "fixtures.h"

#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>

#include <stdlib.h>
#include <string.h>

enum { MOST = 40 };

/* A field that fails as it is told to, and how often it was asked. */
typedef struct problem {
    size_t N, call, from, until; /* fails in calls from <= call < until */
    int answer;                  /* the status; 0: gives NaN */
    double rate;
} problem;

static int disturbed(problem *p, double *dydt, dal_error *error)
{
    const size_t call = p->call++;
    if (call < p->from || call >= p->until) return 0;
    if (p->answer) return dal__fail(error, p->answer, "call %zu failed", call);
    dydt[p->N ? call % p->N : 0] = NAN;
    return 0;
}

static int oscillator(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = y[1];
    dydt[1] = -y[0];
    return disturbed(ctx, dydt, error);
}

/* y_i' = rate y_i / (i + 1). */
static int exponential(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const problem *const p = ctx;
    (void)t;
    for (size_t i = 0; i < p->N; i++) dydt[i] = p->rate * y[i] / (double)(i + 1);
    return disturbed(ctx, dydt, error);
}

static int cosine(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)y;
    dydt[0] = cos(t);
    return disturbed(ctx, dydt, error);
}

/* y' = rate (y - cos t) - sin t: y = cos t, to which all else decays fast if rate << 0. */
static int prothero(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const problem *const p = ctx;
    dydt[0] = p->rate * (y[0] - cos(t)) - sin(t);
    return disturbed(ctx, dydt, error);
}

/* y'' = rate y. */
static int linear_field(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const problem *const p = ctx;
    (void)t;
    dydt[0] = y[1];
    dydt[1] = p->rate * y[0];
    return disturbed(ctx, dydt, error);
}

static int square(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = y[0] * y[0];
    return disturbed(ctx, dydt, error);
}

/* y' = 1, not beyond y = 1; until counts the refusals. */
static int to_the_wall(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = 1.0;
    if (!(y[0] > 1.0)) return 0;
    ((problem *)ctx)->until++;
    return dal__fail(error, DAL_EDOMAIN, "y = %.17g is beyond the wall", y[0]);
}

/* Free for |y| < 1/2, y'' = -+ 64 (|y| - 1/2)^3 beyond, not beyond |y| = 1: the long steps of the
 * free motion overshoot. */
static int before_the_wall(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const double position = fabs(y[0]), depth = fmax(position - 0.5, 0.0);
    const int status = to_the_wall(t, &position, dydt, ctx, error);
    dydt[0] = y[1];
    dydt[1] = -copysign(64.0 * depth * depth * depth, y[0]);
    return status;
}

static ode *open_ode(size_t N, dal_flow_method method, double tolerance, dal__field_fn field,
                     problem *p)
{
    ode *made = NULL;
    dal_error error;
    CHECK(dal__ode_new(&made, N, method, tolerance, field, p, &error) == 0);
    return made;
}

/* All steps to elapsed time end. */
static int reach(ode *self, double end, dal_error *error)
{
    int status = DAL_SUCCESS;
    while (!status && dal__ode_elapsed(self) != end) status = dal__ode_step(self, end, error);
    return status;
}

/* From y[N] at t0 over span; the state is left in the integrator. */
static int run(ode *self, double t0, double span, const double *y, double factor, dal_error *error)
{
    const int status = dal__ode_begin(self, t0, span, y, factor, error);
    return status ? status : reach(self, span, error);
}

/* ---- accuracy --------------------------------------------------------------------------- */

/* A method may make an error of its tolerance, relative and absolute, in every step.  rk8pd takes
 * some steps a unit of time, the multistep methods up to 100; growing solutions let errors grow in
 * proportion. */
static const double tolerances[] = {1e-12, 1e-10, 1e-8};

static double bound(dal_flow_method method, double span)
{
    const double steps = method == DAL_FLOW_RK8PD ? 5.0 : 100.0;
    return steps * tolerances[method] * (1.0 + fabs(span));
}

static void test_oscillator(dal_flow_method method, double span)
{
    const double y0[2] = {1.0, 0.5};
    problem p = {.from = SIZE_MAX};
    dal_error error = {.text = "before"};
    ode *self = open_ode(2, method, tolerances[method], oscillator, &p);
    CHECK(run(self, 0.0, span, y0, 1.0, &error) == 0);
    const double *const y = dal__ode_state(self);
    CHECK_NEAR(y[0], cos(span) + 0.5 * sin(span), bound(method, span));
    CHECK_NEAR(y[1], -sin(span) + 0.5 * cos(span), bound(method, span));
    CHECK(dal__ode_elapsed(self) == span);
    CHECK(p.call > 10 && dal__ode_evaluations(self) == p.call);
    CHECK(strcmp(error.text, "before") == 0);
    dal__ode_free(self);
}

/* Every component, for small and larger N. */
static void test_exponential(dal_flow_method method, size_t N, double span)
{
    double y0[MOST];
    problem p = {.N = N, .from = SIZE_MAX, .rate = 1.0};
    for (size_t i = 0; i < N; i++) y0[i] = 1.0 + (double)i;
    ode *self = open_ode(N, method, tolerances[method], exponential, &p);
    CHECK(run(self, 7.0, span, y0, 1.0, NULL) == 0);
    for (size_t i = 0; i < N; i++) {
        const double exact = y0[i] * exp(span / (double)(i + 1));
        const double growth = (1.0 + y0[i]) * (1.0 + exp(span / (double)(i + 1)));
        CHECK_NEAR(dal__ode_state(self)[i], exact, growth * bound(method, span));
    }
    dal__ode_free(self);
}

/* The field sees t0 + elapsed, also in a step that starts late. */
static void test_time(dal_flow_method method, double span)
{
    const double t0 = 1.25, y0[1] = {2.0};
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(1, method, tolerances[method], cosine, &p);
    CHECK(run(self, t0, span, y0, 1.0, NULL) == 0);
    const double y = dal__ode_state(self)[0];
    CHECK_NEAR(y, 2.0 + sin(t0 + span) - sin(t0), 3.0 * bound(method, span));
    dal__ode_free(self);
}

/* rodas steps over what decays, or hardly moves, which it can only with the right Jacobian; an
 * explicit method has to resolve it. */
static void test_stiff(size_t N, dal__field_fn field, double rate, const double *y0, double exact)
{
    const dal_flow_method methods[2] = {DAL_FLOW_RODAS, DAL_FLOW_RK8PD};
    size_t evaluations[2];
    for (size_t i = 0; i < 2; i++) {
        problem p = {.from = SIZE_MAX, .rate = rate};
        ode *self = open_ode(N, methods[i], 1e-6, field, &p);
        CHECK(run(self, 0.0, 10.0, y0, 1.0, NULL) == 0);
        CHECK_NEAR(dal__ode_state(self)[0], exact, 1e-5); /* errors decay: a few tolerances */
        evaluations[i] = dal__ode_evaluations(self);
        dal__ode_free(self);
    }
    CHECK(10 * evaluations[0] < evaluations[1]);
}

/* Looser by a factor is the same as a tolerance that is larger by it. */
static void test_factor(dal_flow_method method)
{
    const double y0[2] = {1.0, 0.5}, tolerance = 0x1p-20;
    problem p = {.from = SIZE_MAX}, q = p, r = p;
    ode *tight = open_ode(2, method, tolerance, oscillator, &p);
    ode *loose = open_ode(2, method, 256.0 * tolerance, oscillator, &q);
    ode *either = open_ode(2, method, tolerance, oscillator, &r);
    CHECK(run(tight, 0.0, 5.0, y0, 1.0, NULL) == 0);
    CHECK(run(loose, 0.0, 5.0, y0, 1.0, NULL) == 0);
    CHECK(run(either, 0.0, 5.0, y0, 256.0, NULL) == 0);
    CHECK(memcmp(dal__ode_state(either), dal__ode_state(loose), sizeof y0) == 0);
    CHECK(q.call == r.call && q.call < p.call);
    CHECK(run(either, 0.0, 5.0, y0, 1.0, NULL) == 0); /* it does not last */
    CHECK(memcmp(dal__ode_state(either), dal__ode_state(tight), sizeof y0) == 0);
    dal__ode_free(tight);
    dal__ode_free(loose);
    dal__ode_free(either);
}

/* ---- steps ------------------------------------------------------------------------------ */

/* Step by step is the same to the last bit as all at once; nothing lies beyond the end. */
static void test_steps(dal_flow_method method, double span)
{
    const double y0[2] = {1.0, 0.5};
    double y[2], before = 0.0;
    size_t steps = 0;
    problem p = {.from = SIZE_MAX}, q = p;
    ode *whole = open_ode(2, method, 1e-7, oscillator, &p);
    ode *self = open_ode(2, method, 1e-7, oscillator, &q);
    CHECK(run(whole, 0.5, span, y0, 1.0, NULL) == 0);
    CHECK(dal__ode_begin(self, 0.5, span, y0, 1.0, NULL) == 0);
    for (; dal__ode_elapsed(self) != span && steps < 10000; steps++) {
        CHECK(dal__ode_step(self, span, NULL) == 0);
        const double elapsed = dal__ode_elapsed(self);
        CHECK(fabs(elapsed) > fabs(before) && fabs(elapsed) <= fabs(span));
        CHECK_NEAR(dal__ode_state(self)[0], cos(elapsed) + 0.5 * sin(elapsed), 1e-4);
        before = elapsed;
    }
    CHECK(steps > 3 && before == span);
    CHECK(memcmp(dal__ode_state(self), dal__ode_state(whole), sizeof y0) == 0);
    CHECK(p.call == q.call);

    memcpy(y, dal__ode_state(self), sizeof y);
    CHECK(dal__ode_step(self, span, NULL) == 0 && reach(self, span, NULL) == 0);
    CHECK(memcmp(dal__ode_state(self), y, sizeof y) == 0 && p.call == q.call);
    CHECK(reach(self, 2.0 * span, NULL) == 0); /* further on */
    CHECK_NEAR(dal__ode_state(self)[1], 0.5 * cos(2.0 * span) - sin(2.0 * span), 1e-4);
    dal__ode_free(whole);
    dal__ode_free(self);
}

/* A step that is accepted and too short for the clock does not go on without it. */
static void test_clock(dal_flow_method method)
{
    const double y0[1] = {0.0};
    problem p = {.N = 1, .from = SIZE_MAX, .rate = 1e-3};
    dal_error error = {0};
    ode *self = open_ode(1, method, 1e-6, exponential, &p);
    CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
    p.rate = -1e18;
    dal__ode_state(self)[0] = 1.0; /* the first step is about 1e-20 */
    CHECK(dal__ode_restart(self, 2.0, NULL) == 0);
    CHECK(reach(self, 2.0, &error) == DAL_ENOCONV);
    CHECK(strstr(error.text, "collapsed to h = ") != NULL && dal__ode_elapsed(self) == 1.0);
    dal__ode_free(self);
}

/* The last step is not a very short one, from which a trajectory would have to go on. */
static void test_last_step(dal_flow_method method)
{
    const double y0[2] = {1.0, 0.5};
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(2, method, 1e-6, oscillator, &p);
    for (int i = 1; i <= 100; i++) {
        const double end = 0.1 * i;
        double before = 0.0, step = 0.0;
        CHECK(dal__ode_begin(self, 0.0, end, y0, 1.0, NULL) == 0);
        while (dal__ode_elapsed(self) != end) {
            const double elapsed = dal__ode_elapsed(self);
            CHECK(dal__ode_step(self, end, NULL) == 0);
            before = step;
            step = dal__ode_elapsed(self) - elapsed;
        }
        CHECK(step > 0.5 * before);
    }
    dal__ode_free(self);
}

/* The oscillator is linear: doubled on the way, it is doubled at the end.  Its own state may be
 * what it begins from. */
static void test_restart(dal_flow_method method)
{
    const double y0[2] = {1.0, 0.5}, half = 1.5;
    double y[2];
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(2, method, tolerances[method], oscillator, &p);
    CHECK(run(self, 0.25, half, y0, 1.0, NULL) == 0);
    double *const state = dal__ode_state(self);
    memcpy(y, state, sizeof y);
    for (size_t i = 0; i < 2; i++) state[i] *= 2.0;
    CHECK(dal__ode_restart(self, 2.0 * half, NULL) == 0);
    CHECK(dal__ode_elapsed(self) == half);
    CHECK(reach(self, 2.0 * half, NULL) == 0);
    CHECK_NEAR(state[0], 2.0 * cos(3.0) + sin(3.0), 4.0 * bound(method, 3.0));
    CHECK_NEAR(state[1], cos(3.0) - 2.0 * sin(3.0), 4.0 * bound(method, 3.0));

    memcpy(state, y, sizeof y);
    CHECK(run(self, 0.25 + half, -half, state, 1.0, NULL) == 0); /* and back */
    CHECK_NEAR(state[0], y0[0], 4.0 * bound(method, 3.0));
    CHECK_NEAR(state[1], y0[1], 4.0 * bound(method, 3.0));
    dal__ode_free(self);
}

/* y' = y^2 in the chart y, or in 1/y: (1/y)' = -1. */
static int charted(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t, (void)error;
    dydt[0] = *(const bool *)ctx ? -1.0 : y[0] * y[0];
    return 0;
}

/* The solution 1/(2 - t) goes through infinity where the chart is changed after a step. */
static void test_chart(dal_flow_method method)
{
    const double y0[1] = {0.5}, end = 3.0;
    bool inverse = false;
    size_t steps = 0;
    ode *self = NULL;
    CHECK(dal__ode_new(&self, 1, method, 1e-8, charted, &inverse, NULL) == 0);
    CHECK(dal__ode_begin(self, 0.0, end, y0, 1.0, NULL) == 0);
    double *const y = dal__ode_state(self);
    for (; dal__ode_elapsed(self) != end && steps < 10000; steps++) {
        CHECK(dal__ode_step(self, end, NULL) == 0);
        if (inverse || y[0] < 1.5) continue;
        inverse = true;
        y[0] = 1.0 / y[0];
        CHECK(dal__ode_restart(self, end, NULL) == 0);
    }
    CHECK(inverse && dal__ode_elapsed(self) == end);
    CHECK_NEAR(y[0], -1.0, 1e-5); /* 100 steps; errors have grown by y^2 < 10 in the first chart */
    dal__ode_free(self);
}

/* ---- failures --------------------------------------------------------------------------- */

/* The field fails for good, from its k-th call on, for every k of the run. */
static void test_failing(dal_flow_method method, int answer, int expected)
{
    const double y0[2] = {1.0, 0.5};
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(2, method, 1e-5, oscillator, &p);
    CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
    const size_t calls = p.call;
    CHECK(calls > 10);
    for (size_t k = 0; k < calls; k++) {
        dal_error error = {0};
        p = (problem){.answer = answer, .from = k, .until = SIZE_MAX};
        CHECK(run(self, 0.0, 1.0, y0, 1.0, &error) == expected);
        CHECK(error.status == expected);
        CHECK(strstr(error.text, answer ? "failed" : "the field at t = ") != NULL);
        if (expected == DAL_EUSER || expected == DAL_STOPPED)
            CHECK(p.call == k + 1); /* stop means stop */
        CHECK(dal__all_finite(2, dal__ode_state(self)));
    }
    dal__ode_free(self);
}

/* One refused evaluation costs a shorter step, and the next run is as good as the first. */
static void test_recovery(dal_flow_method method, int answer)
{
    const double y0[2] = {1.0, 0.5};
    double first[2];
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(2, method, 1e-7, oscillator, &p);
    CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
    memcpy(first, dal__ode_state(self), sizeof first);
    const size_t calls = p.call;
    for (size_t k = 1; k < calls; k++) {
        p = (problem){.answer = answer, .from = k, .until = k + 1};
        CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
        CHECK(p.call > k);
        CHECK_NEAR(dal__ode_state(self)[0], first[0], 1e-4); /* 1000 tolerances */
        p = (problem){.from = SIZE_MAX};
        CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
        CHECK(memcmp(dal__ode_state(self), first, sizeof first) == 0 && p.call == calls);
    }
    dal__ode_free(self);
}

/* A solution that runs into the wall stops there, rodas where its differences, y + 2e-5 at most,
 * begin to do so.  One that turns before it goes on
 * by shorter steps. */
static void test_wall(dal_flow_method method)
{
    const double distance = method == DAL_FLOW_RODAS ? 2e-5 : 1e-12;
    const double y0[1] = {0.0};
    problem p = {0};
    dal_error error = {0};
    ode *self = open_ode(1, method, 1e-6, to_the_wall, &p);
    CHECK(run(self, 0.0, 2.0, y0, 1.0, &error) == DAL_EDOMAIN);
    CHECK(error.status == DAL_EDOMAIN && strstr(error.text, "beyond the wall") != NULL);
    CHECK_NEAR(dal__ode_state(self)[0], 1.0, distance);
    CHECK_NEAR(dal__ode_elapsed(self), 1.0, distance);
    CHECK(dal__ode_state(self)[0] <= 1.0);
    CHECK(p.until < 200); /* refusals: 53 halvings, and those of steps that were too long */
    dal__ode_free(self);

    const double middle[2] = {0.0, 1.0}; /* turns at |y| = 0.92 */
    p.until = 0;
    self = open_ode(2, method, 1e-8, before_the_wall, &p);
    CHECK(run(self, 0.0, 20.0, middle, 1.0, &error) == 0);
    const double *const y = dal__ode_state(self), depth = fmax(fabs(y[0]) - 0.5, 0.0);
    CHECK_NEAR(0.5 * y[1] * y[1] + 16.0 * pow(depth, 4.0), 0.5, 1e-5); /* 1000 tolerances */
    CHECK(p.until > 0);
    dal__ode_free(self);
}

/* 1/(1 - t) ends at t = 1: the step size collapses. */
static void test_collapse(dal_flow_method method)
{
    const double y0[1] = {1.0};
    problem p = {.from = SIZE_MAX};
    dal_error error = {0};
    ode *self = open_ode(1, method, 1e-6, square, &p);
    CHECK(run(self, 0.0, 2.0, y0, 1.0, &error) == DAL_ENOCONV);
    CHECK(error.status == DAL_ENOCONV);
    CHECK(strstr(error.text, "the step size collapsed to h = ") != NULL);
    CHECK(strstr(error.text, "(tolerance 1e-06): the equations of motion are singular") != NULL);
    CHECK_NEAR(dal__ode_elapsed(self), 1.0, 1e-3); /* the error, 100 steps of tolerance, and more */
    CHECK(dal__all_finite(1, dal__ode_state(self)));
    CHECK(run(self, 0.0, 0.5, y0, 1.0, &error) == 0); /* as good as new */
    CHECK_NEAR(dal__ode_state(self)[0], 2.0, 1e-3);
    dal__ode_free(self);
}

/* 1/(gamma h) - J of rodas is singular where h * rate = 1/gamma = 4; the spans are chosen to meet
 * that.  Such a step is refused, and shorter ones are as good as ever. */
static void test_singular_rodas(void)
{
    const double y0[1] = {1e-3};
    for (int exponent = -10; exponent <= 30; exponent++) {
        problem p = {.N = 1, .from = SIZE_MAX, .rate = ldexp(1.0, exponent)};
        ode *self = open_ode(1, DAL_FLOW_RODAS, 1e-4, exponential, &p);
        const double h = 4.0 * ldexp(1.0, -exponent);
        for (int whole = 0; whole <= 1; whole++) {
            CHECK(dal__ode_begin(self, 0.0, whole ? 3.0 * h : h, y0, 1.0, NULL) == 0);
            CHECK(reach(self, h, NULL) == 0);
            /* some ten steps with an error of at most 1e-4 (1 + y), growing by exp(4) or less */
            CHECK_NEAR(dal__ode_state(self)[0], 1e-3 * exp(4.0), 20e-4 * exp(4.0));
            CHECK_NEAR(dal__ode_state(self)[0] / (1e-3 * exp(4.0)), 1.0, 0.5);
        }
        dal__ode_free(self);
    }
}

/* y' = A y + b cos t with entries of any size; now and then a call gives something that is no
 * number, or is refused.  After so many calls it says stop. */
typedef struct wild {
    uint64_t random;
    size_t N, call, most;
    double A[4 * 4], b[4];
} wild;

/* Uniform in [0, 1). */
static double draw(uint64_t *random)
{
    *random = *random * 6364136223846793005u + 1442695040888963407u;
    return (double)(*random >> 11) * 0x1p-53;
}

static double draw_entry(uint64_t *random)
{
    const double sign = draw(random) < 0.5 ? -1.0 : 1.0, kind = draw(random);
    if (kind < 0.3) return 0.0;
    if (kind < 0.6) return sign; /* singular matrices, round numbers */
    return sign * pow(10.0, (kind < 0.9 ? 40.0 : 600.0) * (draw(random) - 0.5));
}

static int wild_field(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    wild *const w = ctx;
    if (++w->call > w->most) return dal__fail(error, DAL_EUSER, "enough");
    for (size_t i = 0; i < w->N; i++) {
        dydt[i] = w->b[i] * cos(t);
        for (size_t j = 0; j < w->N; j++) dydt[i] += w->A[i * w->N + j] * y[j];
    }
    const double chance = draw(&w->random);
    if (chance < 0.004) return dal__fail(error, DAL_EDOMAIN, "not here");
    if (chance < 0.008) dydt[w->call % w->N] = NAN;
    else if (chance < 0.012) dydt[w->call % w->N] = -INFINITY;
    else if (chance < 0.016) dydt[w->call % w->N] = DBL_MAX;
    return 0;
}

/* Whatever the system: a status, a state that is finite, and GSL's handler, which aborts, is not
 * called. */
static void test_wild(dal_flow_method method)
{
    size_t succeeded = 0;
    for (uint64_t seed = 0; seed < (brief() ? 100 : 2000); seed++) {
        wild w = {.random = seed, .N = 1 + seed % 4, .most = 400};
        double y[4];
        dal_error error = {0};
        ode *self = NULL;
        for (size_t i = 0; i < w.N * w.N; i++) w.A[i] = draw_entry(&w.random);
        for (size_t i = 0; i < w.N; i++) w.b[i] = draw_entry(&w.random);
        for (size_t i = 0; i < w.N; i++) y[i] = draw_entry(&w.random);
        const double tolerance = pow(10.0, -1.0 - 14.0 * draw(&w.random));
        const double span = pow(10.0, 20.0 * (draw(&w.random) - 0.5));
        CHECK(dal__ode_new(&self, w.N, method, tolerance, wild_field, &w, NULL) == 0);
        const int status = run(self, draw_entry(&w.random), seed % 2 ? span : -span, y, 1.0,
                               &error);
        CHECK(status == 0 || (status == error.status && error.text[0] != '\0'));
        CHECK(dal__all_finite(w.N, dal__ode_state(self)));
        succeeded += status == 0;
        dal__ode_free(self);
    }
    CHECK(succeeded > (brief() ? 10 : 200)); /* most of the others are told to stop */
}

/* y_1 = exp(sin t - sin t0)/(1 - s/2)^2 and y_2 = 1/(1 - s/2), s = t - t0; a large y_3 makes every
 * step as large as it may be, two in all. */
static int swing(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)ctx, (void)error;
    dydt[0] = y[0] * (y[1] + cos(t));
    dydt[1] = 0.5 * y[1] * y[1];
    dydt[2] = 0.0;
    return 0;
}

/* Of order 4, also in time: half the span has 1/32 of the error.  A wrong coefficient would cost an
 * order, a Jacobian that is not exact to many digits too.  The number of calls says that the steps
 * are the same. */
static void test_order_rodas(void)
{
    const double y0[3] = {1.0, 1.0, 1e6}, t0 = 0.5;
    double before = 0.0;
    ode *self = NULL;
    CHECK(dal__ode_new(&self, 3, DAL_FLOW_RODAS, 0.1, swing, NULL, NULL) == 0);
    for (int halvings = 0; halvings <= 5; halvings++) {
        const double span = ldexp(0.5, -halvings);
        const size_t calls = dal__ode_evaluations(self);
        CHECK(run(self, t0, span, y0, 1.0, NULL) == 0);
        CHECK(dal__ode_evaluations(self) == calls + 1 + 2 * (6 + 2 + 6 + 1));
        const double error = dal__ode_state(self)[0]
                           - exp(sin(t0 + span) - sin(t0)) / pow(1.0 - 0.5 * span, 2.0);
        if (halvings >= 3) CHECK_NEAR(log2(before / error), 5.0, 0.3);
        before = error;
    }
    dal__ode_free(self);
}

/* The same where a number is 0, and where it does not change: y_1 = cos(s + c). */
static int turning(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t, (void)ctx, (void)error;
    dydt[0] = y[1];
    dydt[1] = -y[0];
    dydt[2] = 0.0;
    return 0;
}

static void test_order_from_zero_rodas(void)
{
    const double starts[2][3] = {{0.0, 1.0, 1e6}, {1.0, 0.0, 1e6}};
    for (int k = 0; k < 2; k++) {
        double before = 0.0;
        ode *self = NULL;
        CHECK(dal__ode_new(&self, 3, DAL_FLOW_RODAS, 0.1, turning, NULL, NULL) == 0);
        for (int halvings = 0; halvings <= 3; halvings++) {
            const double span = ldexp(0.5, -halvings);
            CHECK(run(self, 0.0, span, starts[k], 1.0, NULL) == 0);
            const double error = dal__ode_state(self)[0] - (k ? cos(span) : sin(span));
            if (halvings == 3) CHECK_NEAR(log2(before / error), k ? 6.0 : 5.0, 0.3);
            before = error;
        }
        dal__ode_free(self);
    }
}

/* A pulse at t = 5 that steps grown before it have to be refused for. */
static int pulse(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    dydt[0] = y[1];
    dydt[1] = exp(-25.0 * (t - 5.0) * (t - 5.0)) - y[0];
    return disturbed(ctx, dydt, error);
}

static int pulse_of_gsl(double t, const double *y, double *dydt, void *ctx)
{
    return pulse(t, y, dydt, ctx, NULL);
}

/* Steps are those of GSL's own loop and control, once these take the first; rk8pd is our own, so
 * that it may round otherwise. */
static void test_control(dal_flow_method method)
{
    const double y0[2] = {1e-3, 0.0}, end = 100.0;
    problem p = {.from = SIZE_MAX};
    gsl_odeiv2_system system = {pulse_of_gsl, NULL, 2, &p};
    gsl_odeiv2_driver *const driver = gsl_odeiv2_driver_alloc_y_new(
        &system, method == DAL_FLOW_RK8PD ? gsl_odeiv2_step_rk8pd : gsl_odeiv2_step_msadams, 1.0,
        tolerances[method], tolerances[method]);
    ode *self = open_ode(2, method, tolerances[method], pulse, &p);
    CHECK(dal__ode_begin(self, 0.0, end, y0, 1.0, NULL) == 0);
    CHECK(dal__ode_step(self, end, NULL) == 0);
    double t = 0.0, h = dal__ode_elapsed(self), y[2] = {y0[0], y0[1]};
    while (t < 20.0) {
        CHECK(gsl_odeiv2_evolve_apply(driver->e, driver->c, driver->s, &system, &t, end, &h, y)
              == 0);
        if (method == DAL_FLOW_MSADAMS) {
            CHECK(t == dal__ode_elapsed(self) && memcmp(y, dal__ode_state(self), sizeof y) == 0);
        }
        CHECK_NEAR(t, dal__ode_elapsed(self), 1e-9); /* the error of a step has few digits */
        for (size_t i = 0; i < 2; i++)
            CHECK_NEAR(y[i], dal__ode_state(self)[i], method == DAL_FLOW_RK8PD ? 1e-9 : 0.0);
        CHECK(dal__ode_step(self, end, NULL) == 0);
    }
    CHECK(driver->e->failed_steps > 1);
    gsl_odeiv2_driver_free(driver);
    dal__ode_free(self);
}

/* y_i' = sin(t) y_(i+1) + y_i^2/(i + 2), for any N. */
static int ring(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const size_t N = ((const problem *)ctx)->N;
    for (size_t i = 0; i < N; i++)
        dydt[i] = sin(t) * y[(i + 1) % N] + y[i] * y[i] / (double)(i + 2);
    return disturbed(ctx, dydt, error);
}

static int ring_of_gsl(double t, const double *y, double *dydt, void *ctx)
{
    return ring(t, y, dydt, ctx, NULL);
}

/* One step is that of GSL, its error too, for sizes that have a text of their own and others. */
static void test_step_rk8pd(void)
{
    for (size_t N = 1; N <= MOST; N++) {
        problem p = {.N = N, .from = SIZE_MAX};
        dal__rk8pd self = {.field = ring, .ctx = &p};
        arena memory = {0};
        dal_error error = {0};
        const double t0 = 2.0, elapsed = 0.5, h = -0.25;
        double y[MOST], z[MOST], slope[MOST], after[MOST], own[MOST], theirs[MOST];
        dal__rk8pd_reserve(&self, N, &memory);
        CHECK(dal__allocate(&memory, NULL) == 0);
        for (size_t i = 0; i < N; i++) y[i] = z[i] = 1.0 / (double)(i + 1);
        CHECK(ring(t0 + elapsed, y, slope, &p, NULL) == 0);
        gsl_odeiv2_system system = {ring_of_gsl, NULL, N, &p};
        gsl_odeiv2_step *const gsl = gsl_odeiv2_step_alloc(gsl_odeiv2_step_rk8pd, N);
        CHECK(gsl_odeiv2_step_apply(gsl, t0 + elapsed, h, z, theirs, slope, after, &system) == 0);
        p.call = 0;
        CHECK(dal__rk8pd_step(&self, t0, elapsed, h, y, slope, own, &error) == 0);
        CHECK(p.call == 12 && self.evaluations == 12);
        for (size_t i = 0; i < N; i++) {
            CHECK_NEAR(y[i], z[i], 8.0 * DAL_ROUNDOFF);
            CHECK_NEAR(own[i], theirs[i], 8.0 * DAL_ROUNDOFF);
            CHECK(fabs(own[i]) < 1e-7 && fabs(own[i]) > 0.0);
        }
        gsl_odeiv2_step_free(gsl);
        dal__release(&memory);
    }
}

/* A slope that is not finite, of any stage and component, is named by its time. */
static void test_not_finite_rk8pd(void)
{
    static const double at[13] = {0.0, 1.0 / 18, 1.0 / 12, 1.0 / 8, 5.0 / 16, 3.0 / 8, 59.0 / 400,
                                  93.0 / 200, 5490023248.0 / 9719169821.0, 13.0 / 20,
                                  1201146811.0 / 1299019798.0, 1.0, 1.0};
    for (size_t N = 1; N <= MOST; N++)
        for (size_t stage = 1; stage < 13; stage++) {
            problem p = {.N = N, .from = stage - 1, .until = SIZE_MAX};
            dal__rk8pd self = {.field = ring, .ctx = &p};
            arena memory = {0};
            dal_error error = {0};
            char text[80];
            double y[MOST], before[MOST], slope[MOST] = {0.0}, own[MOST];
            dal__rk8pd_reserve(&self, N, &memory);
            CHECK(dal__allocate(&memory, NULL) == 0);
            for (size_t i = 0; i < N; i++) before[i] = y[i] = 1.0;
            const int status = dal__rk8pd_step(&self, 2.0, 0.5, 0.25, y, slope, own, &error);
            snprintf(text, sizeof text, "the field at t = %.17g is not finite",
                     2.0 + (0.5 + at[stage] * 0.25));
            if (stage < 12) {
                CHECK(status == DAL_EDOMAIN && strcmp(error.text, text) == 0);
                CHECK(p.call == stage && memcmp(y, before, N * sizeof *y) == 0);
            } else { /* of the last one it is in the state */
                CHECK(status == 0 && !dal__all_finite(N, y));
            }
            dal__release(&memory);
        }
}

/* Of the steps of rodas few are refused, which costs 9 evaluations of the field and 4 for its
 * roundoff, but the Jacobian, 4 more, belongs to the state and stays. */
static void test_refused_rodas(void)
{
    const double y0[2] = {1e-3, 0.0}, end = 20.0;
    problem p = {.from = SIZE_MAX};
    size_t accepted = 0;
    ode *self = open_ode(2, DAL_FLOW_RODAS, 1e-8, pulse, &p);
    CHECK(dal__ode_begin(self, 0.0, end, y0, 1.0, NULL) == 0);
    for (; dal__ode_elapsed(self) != end && accepted < 10000; accepted++)
        CHECK(dal__ode_step(self, end, NULL) == 0);
    const size_t rest = dal__ode_evaluations(self) - 1 - 13 * accepted;
    CHECK(rest % 13 == 0 && rest > 0 && rest / 13 < accepted / 10);
    dal__ode_free(self);
}

/* Steps that are shortened to end somewhere leave the size that was suggested before. */
static void test_shortened(dal_flow_method method)
{
    const double y0[2] = {1.0, 0.5};
    for (double end = 3.0; end < 4.0; end += 0.01) {
        problem p = {.from = SIZE_MAX};
        ode *self = open_ode(2, method, 1e-8, oscillator, &p);
        double size = 0.0;
        CHECK(dal__ode_begin(self, 0.0, end, y0, 1.0, NULL) == 0);
        while (dal__ode_elapsed(self) != end) {
            const double left = end - dal__ode_elapsed(self);
            size = dal__ode_suggested(self);
            CHECK(dal__ode_step(self, end, NULL) == 0);
            if (2.0 * size > left) CHECK(dal__ode_suggested(self) >= size);
        }
        dal__ode_free(self);
    }
}

/* An oscillator whose position is counted in units of 1e-15, or 1e15. */
static int small_units(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    const problem *const p = ctx;
    (void)t;
    dydt[0] = p->rate * y[1];
    dydt[1] = -y[0] / p->rate;
    return disturbed(ctx, dydt, error);
}

static void test_units_rodas(void)
{
    for (double unit = 1e-15; unit <= 1e16; unit *= 1e30) {
        problem p = {.from = SIZE_MAX, .rate = unit};
        const double y0[2] = {0.0, 1.0};
        ode *self = open_ode(2, DAL_FLOW_RODAS, 1e-6, small_units, &p);
        CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
        CHECK_NEAR(dal__ode_state(self)[1], cos(1.0), 1e-4); /* 100 tolerances */
        CHECK(p.call < 1000);
        dal__ode_free(self);
    }
}

/* y'' = -e^(y/L) L/(2 T^2) with L = 1e-10 and T = 1e-15, from rest in 0 and, y as wide, at a
 * state that stays 0: y = -2 L ln cosh(t / (2 T)). */
static int slope_of_atoms(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = y[2];
    dydt[1] = y[3];
    dydt[2] = -exp(y[0] / 1e-10 + y[1] / 1e-10) * 1e-10 / 2e-30;
    dydt[3] = 0.0;
    return disturbed(ctx, dydt, error);
}

static void test_atoms_rodas(void)
{
    problem p = {.from = SIZE_MAX};
    const double y0[4] = {0.0};
    ode *self = open_ode(4, DAL_FLOW_RODAS, 1e-10, slope_of_atoms, &p);
    CHECK(run(self, 0.0, 4e-15, y0, 1.0, NULL) == 0);
    CHECK_NEAR(dal__ode_state(self)[0], -2e-10 * log(cosh(2.0)), 1e-10 * 1e-6);
    CHECK_NEAR(dal__ode_state(self)[2], -1e5 * tanh(2.0), 1e5 * 1e-7); /* 1000 tolerances */
    CHECK(p.call < 20000);
    dal__ode_free(self);
}

/* y' = y with a roundoff of 1e-9, which no step makes less. */
static int coarse(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = y[0] + 1e-9 * sin(1e18 * y[0]);
    return disturbed(ctx, dydt, error);
}

static void test_coarse(void)
{
    const double y0[1] = {1.0};
    problem p = {.from = SIZE_MAX};
    dal_error error;
    ode *self = open_ode(1, DAL_FLOW_RK8PD, 1e-13, coarse, &p);
    CHECK(run(self, 0.0, 1.0, y0, 1.0, NULL) == 0);
    CHECK_NEAR(dal__ode_state(self)[0], exp(1.0), 1e-8);
    const size_t calls = p.call;
    CHECK(calls < 2000);
    for (size_t k = 0; k < calls; k++) { /* also while the roundoff is looked at */
        p = (problem){.answer = DAL_EUSER, .from = k, .until = k + 1};
        CHECK(run(self, 0.0, 1.0, y0, 1.0, &error) == DAL_EUSER && p.call == k + 1);
    }
    dal__ode_free(self);
}

/* An angle after 1e4 turns, y_0' = 1, and y_1' = y_1 cos y_0: its curvature is no roundoff. */
static int turned(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    (void)t;
    dydt[0] = 1.0;
    dydt[1] = y[1] * cos(y[0]);
    return disturbed(ctx, dydt, error);
}

static void test_turned_rodas(void)
{
    const double y0[2] = {2e4 * acos(-1.0), 1.0};
    problem p = {.from = SIZE_MAX};
    ode *self = open_ode(2, DAL_FLOW_RODAS, 1e-9, turned, &p);
    CHECK(run(self, 0.0, 5.0, y0, 1.0, NULL) == 0);
    CHECK_NEAR(dal__ode_state(self)[1], exp(sin(5.0)), 1e-6); /* 1000 tolerances */
    dal__ode_free(self);
}

/* Data that no integration can begin from. */
static void test_beginning(void)
{
    const double bad[2] = {1.0, INFINITY}, y0[2] = {1.0, 0.5};
    problem p = {.from = SIZE_MAX};
    dal_error error = {0};
    ode *self = open_ode(2, DAL_FLOW_RK8PD, 1e-6, oscillator, &p);
    CHECK(dal__ode_begin(self, 2.5, 1.0, bad, 1.0, &error) == DAL_EDOMAIN);
    CHECK(strstr(error.text, "the state at t = 2.5 is not finite") != NULL && p.call == 0);
    p = (problem){.answer = DAL_ESINGULAR, .until = SIZE_MAX};
    CHECK(dal__ode_begin(self, 2.5, 1.0, y0, 1.0, &error) == DAL_ESINGULAR);
    CHECK(error.status == DAL_ESINGULAR && strcmp(error.text, "call 0 failed") == 0);
    p.from = SIZE_MAX;
    CHECK(run(self, 2.5, 1.0, y0, 1.0, &error) == 0);
    p = (problem){.answer = DAL_ESINGULAR, .until = SIZE_MAX};
    CHECK(dal__ode_restart(self, 2.0, &error) == DAL_ESINGULAR);
    dal__ode_free(self);
}

static void test_arguments(void)
{
    const double bad[] = {0.0, -1e-9, 0.11, NAN, INFINITY};
    const size_t large[] = {SIZE_MAX, SIZE_MAX / 8, SIZE_MAX / 64};
    problem p = {.from = SIZE_MAX};
    ode *const none = NULL;
    ode *self = none;
    dal_error error = {0};
    CHECK(dal__ode_new(&self, 2, (dal_flow_method)17, 1e-6, oscillator, &p, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "method = 17") != NULL);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        CHECK(dal__ode_new(&self, 2, DAL_FLOW_RK8PD, bad[i], oscillator, &p, &error) == DAL_EINVAL);
        CHECK(strstr(error.text, "tolerance = ") != NULL);
    }
    for (size_t i = 0; i < sizeof large / sizeof large[0]; i++)
        CHECK(dal__ode_new(&self, large[i], DAL_FLOW_RK8PD, 0.1, oscillator, &p, &error)
              == DAL_ENOMEM);
    CHECK(error.status == DAL_ENOMEM && strstr(error.text, "overflows") != NULL);
    error.text[0] = '\0';
    CHECK(dal__ode_new(&self, (size_t)1 << 31, DAL_FLOW_RODAS, 0.1, oscillator, &p, &error)
          == DAL_ENOMEM);
    CHECK(strstr(error.text, "overflows") != NULL);
    CHECK(self == none);
    dal__ode_free(NULL);
}

/* After steps of 1 ten thousand of 1e-7 advance by 1e-3, less than a millionth of what steps of 1
 * would, and those of 1e-5 by more. */
static void test_creep(void)
{
    for (int k = 0; k < 4; k++) {
        const double slow = k % 2 ? 1e-5 : 1e-7, span = k < 2 ? 1e5 : (double)INFINITY;
        dal__creep creep = {0};
        dal_error error = {0};
        double t = 0.0;
        int status = dal__creep_check(&creep, t, span, &error), step = 0;
        for (; !status && step < 20000; step++) {
            const double h = step < 10 ? 1.0 : slow;
            dal__creep_step(&creep, t, h);
            t += h;
            status = dal__creep_check(&creep, t, span, &error);
        }
        CHECK(step == 20000 && status == (k % 2 ? DAL_SUCCESS : DAL_ENOCONV));
        CHECK(k % 2 || strstr(error.text, "after steps of up to 1.0e+00"));
    }
}

int main(void)
{
    gsl_set_error_handler(abort_on_gsl_error);
    for (dal_flow_method method = DAL_FLOW_RK8PD; method <= DAL_FLOW_RODAS; method++) {
        for (int sign = -1; sign <= 1; sign += 2) {
            test_oscillator(method, sign * 3.0);
            test_exponential(method, 1, sign * 2.0);
            test_exponential(method, 3, sign * 2.0);
            test_exponential(method, MOST, sign * 1.0);
            test_time(method, sign * 4.0);
            test_steps(method, sign * 3.0);
        }
        test_factor(method);
        test_restart(method);
        test_clock(method);
        test_last_step(method);
        test_chart(method);
        test_failing(method, DAL_EDOMAIN, DAL_EDOMAIN);
        test_failing(method, DAL_ENOCONV, DAL_ENOCONV);
        test_failing(method, DAL_EUSER, DAL_EUSER);
        test_failing(method, DAL_STOPPED, DAL_STOPPED);
        test_failing(method, 0, DAL_EDOMAIN);
        test_recovery(method, DAL_ESINGULAR);
        test_recovery(method, 0);
        test_wall(method);
        test_collapse(method);
        test_wild(method);
        if (method != DAL_FLOW_RODAS) test_control(method);
    }
    test_stiff(1, prothero, -1e4, (const double[1]){1.0}, cos(10.0));
    test_stiff(2, linear_field, -1e8, (const double[2]){1e-12, 0.0}, 0.0);
    test_singular_rodas();
    test_order_rodas();
    test_order_from_zero_rodas();
    test_step_rk8pd();
    test_not_finite_rk8pd();
    test_refused_rodas();
    test_units_rodas();
    test_atoms_rodas();
    test_coarse();
    test_creep();
    test_turned_rodas();
    test_shortened(DAL_FLOW_RK8PD);
    test_shortened(DAL_FLOW_RODAS);
    test_beginning();
    test_arguments();
    return check_done();
}
