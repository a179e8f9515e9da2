/* Events and output times, against solutions that are known: where they are, in which order, and
 * that what only looks changes nothing. */
#include "dalembert/events.h"
#include "fixtures.h"
#include "check.h"

enum { MOST_SEEN = 400, MOST_2N = 6 };

typedef struct seen {
    size_t count, event[MOST_SEEN], step[MOST_SEEN];
    double t[MOST_SEEN], x[MOST_SEEN][MOST_2N], after[MOST_SEEN][MOST_2N];
    bool reset[MOST_SEEN];
    size_t n;
    size_t stop_at; /* 1: at the first */
    int answer;
} seen;

static int happened(size_t event, size_t step, double t, const double *x, const double *after,
                    void *ctx)
{
    seen *const s = ctx;
    const size_t k = s->count++;
    if (k >= MOST_SEEN) return -1;
    s->event[k] = event;
    s->step[k] = step;
    s->t[k] = t;
    memcpy(s->x[k], x, 2 * s->n * sizeof *x);
    s->reset[k] = after != NULL;
    if (after) memcpy(s->after[k], after, 2 * s->n * sizeof *x);
    return s->count == s->stop_at ? s->answer : 0;
}

static dal_events *events_of(const dal_stepper *stepper, const char *scheme, const dal_event *list,
                             size_t count)
{
    const dal_scheme record = find_scheme(scheme);
    dal_events *events = NULL;
    dal_error error = {0};
    need(dal_events_new(&events, stepper, &record, list, count, &error), scheme, error.text);
    return events;
}

/* ---- a ball: free fall with a bounce, which leapfrog solves exactly ------------------------- */

static const double g0 = 9.0;

static int weight(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = g0 * q[1];
    if (V_q) memcpy(V_q, (double[]){0.0, g0}, 2 * sizeof *V_q);
    if (V_qq) memset(V_qq, 0, 4 * sizeof *V_qq);
    return 0;
}

static dal_system *open_ball(void)
{
    static const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const dal_system_def def = {.n = 2, .mass = mass, .potential = weight, .name = "ball"};
    return new_system(&def);
}

/* A plane: ctx is the coordinate (or 2 + that of the velocity) and where it is. */
typedef struct plane {
    size_t of;
    double at, restitution;
} plane;

static int above(double t, const double *x, double *g, void *ctx)
{
    const plane *const p = ctx;
    *g = x[p->of] - p->at;
    return 0;
}

static int bounce(double t, double *x, void *ctx)
{
    const plane *const p = ctx;
    x[2 + p->of] *= -p->restitution;
    return 0;
}

static void test_bounces(const dal_system *ball, double h)
{
    const double x0[4] = {0.0, 2.0, 1.5, 0.0}, e = 0.8;
    plane floor = {1, 0.0, e}, apex = {3, 0.0, 0.0}, far = {0, 3.0, 0.0};
    const dal_event list[] = {
        {.g = above, .direction = -1, .reset = bounce, .ctx = &floor, .reset_ctx = &floor},
        {.g = above, .direction = -1, .ctx = &apex},
        {.g = above, .ctx = &far},
    };
    const size_t steps = (size_t)lround(4.0 / fabs(h));
    double expected[40], rows[2];
    size_t kinds[40], count = 0;
    double v = 6.0, at = 2.0 / 3.0; /* y = 2 - g0 t^2/2 = 0 there */
    while (at < 4.0) {
        kinds[count] = 0;
        expected[count++] = at;
        v *= e;
        if (at + v / g0 < 4.0) {
            kinds[count] = 1;
            expected[count++] = at + v / g0;
        }
        at += 2.0 * v / g0;
    }
    for (size_t k = 0; k <= count; k++) /* x = 3 at t = 2 */
        if (k == count || expected[k] > 2.0) {
            memmove(expected + k + 1, expected + k, (count - k) * sizeof *expected);
            memmove(kinds + k + 1, kinds + k, (count - k) * sizeof *kinds);
            expected[k] = 2.0;
            kinds[k] = 2;
            count++;
            break;
        }
    dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, x0);
    dal_events *const events = events_of(stepper, "leapfrog", list, 3);
    seen s = {.n = 2};
    dal_run run = {.stepper = stepper, .steps = steps, .stride = 1, .events = events,
                   .happened = happened, .happened_ctx = &s};
    const int status = dal_run_go(&run, SIZE_MAX);
    CHECK(status == DAL_SUCCESS && s.count == count);
    if (status) fprintf(stderr, "h = %g: %s\n", h, dal_stepper_error(stepper)->text);
    for (size_t k = 0; k < count && k < s.count; k++) {
        CHECK(s.event[k] == kinds[k]);
        CHECK_NEAR(s.t[k], expected[k], 2e-13);
        CHECK(s.reset[k] == (kinds[k] == 0));
        CHECK_NEAR(s.x[k][0], 1.5 * expected[k], 1e-12);
        CHECK_NEAR((double)s.step[k] - 0.5, s.t[k] / h, 0.5 + 1e-9);
        if (kinds[k] == 0) CHECK(fabs(s.x[k][1]) < 1e-13 && s.after[k][3] == -e * s.x[k][3]);
    }
    memcpy(rows, dal_stepper_state(stepper), sizeof rows);
    CHECK_NEAR(rows[0], 6.0, 1e-12);
    const double since = 4.0 - (at - 2.0 * v / g0);
    CHECK_NEAR(rows[1], v * since - 0.5 * g0 * since * since, 1e-12);
    const dal_stats stats = stats_of(stepper);
    CHECK(stats.jump_step == 0 && stats.steps == steps); /* a bounce is no jump of the energy */
    dal_events_free(events);
}

/* ---- orders --------------------------------------------------------------------------------- */

static int line(double t, const double *x, double *g, void *ctx)
{
    *g = 0.3 * x[0] + x[1] + 0.2 * x[5] * x[2] - 1.5 + 0.1 * t;
    return 0;
}

static double exact_event(const dal_system *system, const double *start, double *x)
{
    double low = 0.5, high = 2.5, g;
    dal_system_exact(system, low, start, x);
    line(low, x, &g, NULL);
    const bool below = g < 0.0;
    for (int k = 0; k < 200; k++) {
        const double middle = 0.5 * (low + high);
        dal_system_exact(system, middle, start, x);
        line(middle, x, &g, NULL);
        if ((g < 0.0) == below) low = middle;
        else high = middle;
    }
    return low;
}

static double event_error(const dal_system *system, const char *scheme, double h, double *residual)
{
    double start[6], x[6];
    dal_mechanics *const mechanics = open_mechanics(system);
    need(dal_system_state(system, start), "state", "");
    const double t = exact_event(system, start, x);
    const dal_event list[] = {{.g = line, .terminal = 1}};
    dal_stepper *const stepper = start_at(system, scheme, 0.0, h, start);
    dal_events *const events = events_of(stepper, scheme, list, 1);
    seen s = {.n = 3};
    dal_run run = {.stepper = stepper, .steps = (size_t)lround(3.0 / h), .stride = 1,
                   .events = events, .happened = happened, .happened_ctx = &s};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED && run.ended && s.count == 1);
    CHECK(run.t_end == s.t[0]);
    CHECK(dal_relative_residual(mechanics, s.t[0], 0.0, s.x[0], residual) == 0);
    const double error = fmax(largest_difference(6, s.x[0], x), fabs(s.t[0] - t));
    dal_events_free(events);
    return error;
}

static void test_orders(void)
{
    static const struct {
        const char *scheme;
        double h, order;
    } cases[] = {{"midpoint", 0.03, 2}, {"leapfrog", 0.03, 2}, {"midpoint-kl6", 0.2, 6},
                 {"leapfrog-kl8", 0.3, 8}, {"leapfrog-suzuki4", 0.1, 4},
                 {"midpoint-nodes", 0.03, 2}, {"pair:0.5:0.5", 0.03, 2}};
    dal_system *const system = open_system("knife_edge");
    for (size_t k = 0; k < DAL_LENGTH(cases); k++) {
        double errors[2], residuals[2];
        for (int i = 0; i < 2; i++)
            errors[i] = event_error(system, cases[k].scheme, cases[k].h / (1 + 2 * i),
                                    &residuals[i]);
        const double order = log(errors[0] / errors[1]) / log(3.0);
        CHECK(fabs(order - cases[k].order) < 0.5);
        CHECK(fmax(residuals[0], residuals[1]) <= DAL_RESIDUAL_BOUND(3));
        if (!(fabs(order - cases[k].order) < 0.5))
            fprintf(stderr, "%s: order %.2f, %g\n", cases[k].scheme, order, errors[1]);
    }
    double residual;
    CHECK(event_error(system, "reference", 0.25, &residual) < 1e-11);
}

/* ---- what only looks changes nothing, and times ---------------------------------------------- */

enum { STEPS = 30 };

static void check_looking(const char *scheme, double h)
{
    dal_system *const system = open_system("knife_edge");
    double start[6], plain[(STEPS + 1) * 6], rows[(STEPS + 1) * 6], at[STEPS * 6], times[STEPS];
    double reactions[2][STEPS], x[6];
    need(dal_system_state(system, start), "state", "");
    const dal_event list[] = {{.g = line}, {.g = line, .direction = 1}};
    for (size_t k = 0; k < STEPS; k++)
        times[k] = 0.5 + (double)STEPS * h * (k == STEPS - 1 ? 1.0 : pow((double)k / STEPS, 1.3));
    for (int looking = 0; looking < 2; looking++) {
        dal_stepper *const stepper = start_at(system, scheme, 0.5, h, start);
        dal_events *const events = looking ? events_of(stepper, scheme, list, 2) : NULL;
        dal_run run = {.stepper = stepper, .steps = STEPS, .stride = 1,
                       .x = looking ? rows : plain, .reactions = reactions[looking],
                       .events = events, .times = looking ? times : NULL,
                       .time_count = looking ? STEPS : 0, .x_at_times = at};
        while (run.done < STEPS) CHECK(dal_run_go(&run, looking ? 7 : SIZE_MAX) == DAL_SUCCESS);
        CHECK(run.times_done == (looking ? STEPS : 0) && !run.ended);
        dal_events_free(events);
        release(stepper);
    }
    CHECK(memcmp(rows, plain, sizeof rows) == 0);
    CHECK(memcmp(reactions[0], reactions[1], sizeof *reactions) == 0);
    const dal_scheme record = find_scheme(scheme);
    const bool kept = record.nodes == DAL_KEPT_NODES;
    dal_mechanics *const mechanics = open_mechanics(system);
    for (size_t k = 0; k < STEPS; k++) {
        double residual, node[6];
        const double shift = kept ? 0.5 * h : 0.0;
        memcpy(node, at + 6 * k, sizeof node);
        CHECK(dal_relative_residual(mechanics, times[k], shift, node, &residual) == 0);
        CHECK(residual <= 2.0 * DAL_RESIDUAL_BOUND(3));
        for (size_t i = 0; i < 3; i++) node[i] -= shift * node[3 + i];
        dal_system_exact(system, times[k] - 0.5, start, x);
        CHECK_NEAR(largest_difference(6, node, x), 0.0, 10.0 * h * h);
    }
    CHECK_NEAR(largest_difference(6, at, plain), 0.0, 4 * U);
    CHECK_NEAR(largest_difference(6, at + 6 * (STEPS - 1), plain + 6 * STEPS), 0.0, 4 * U);
}

/* ---- near zero ------------------------------------------------------------------------------ */

/* y = 3 t - g0 t^2/2 passes 1/2 - depth twice around t = 1/3, in one step or in two. */
static void test_grazing(const dal_system *ball)
{
    const double depths[] = {1e-3, 1e-6, 1e-10, 0.0, -1e-10, -1e-3}, steps[] = {0.31, 1.0 / 3};
    const double x0[4] = {0.0, 0.0, 1.0, 3.0};
    for (size_t k = 0; k < 2 * DAL_LENGTH(depths); k++) {
        const double depth = depths[k / 2], h = steps[k % 2];
        plane top = {1, 0.5 - depth, 0.0};
        const dal_event list[] = {{.g = above, .ctx = &top}, {.g = above, .direction = -1,
                                                              .ctx = &top}};
        dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, x0);
        dal_events *const events = events_of(stepper, "leapfrog", list, 2);
        seen s = {.n = 2};
        dal_run run = {.stepper = stepper, .steps = 4, .stride = 1, .events = events,
                       .happened = happened, .happened_ctx = &s};
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
        double t = 0.0, g;
        size_t event = 9;
        const size_t doubts = dal_events_doubts(events, &event, &t, &g);
        if (depth > 0.0) {
            const double half = sqrt(2.0 * depth / g0), sure = 1e-15 / sqrt(depth) + 1e-15;
            CHECK(s.count == 3 && s.event[0] == 0 && s.event[1] == 0 && s.event[2] == 1);
            CHECK_NEAR(s.t[0], 1.0 / 3 - half, sure);
            CHECK_NEAR(s.t[1], 1.0 / 3 + half, sure);
            CHECK_NEAR(s.t[2], 1.0 / 3 + half, sure);
        }
        if (depth < 0.0) CHECK(s.count == 0);
        if (k % 2 == 0) CHECK(doubts == (depth == 0.0 ? 2 : 0));
        if (doubts) {
            CHECK(event == 0 && fabs(g) < 1e-14);
            CHECK_NEAR(t, 1.0 / 3, 1e-6);
        }
        dal_events_free(events);
        release(stepper);
    }
}

/* The speed across is below a bound, twice in one step: from its middle on v is the opposite. */
static int slow(double t, const double *x, double *g, void *ctx)
{
    *g = 1e-3 - x[3] * x[3];
    return 0;
}

static void test_twice_by_velocity(const dal_system *ball)
{
    const double h = 0.2, x0[4] = {0.0, 0.0, 1.0, 0.5 * g0 * h}, half = sqrt(1e-3) / g0;
    const dal_event list[] = {{.g = slow}};
    dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, x0);
    dal_events *const events = events_of(stepper, "leapfrog", list, 1);
    seen s = {.n = 2};
    dal_run run = {.stepper = stepper, .steps = 2, .stride = 1, .events = events,
                   .happened = happened, .happened_ctx = &s};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && s.count == 2);
    CHECK_NEAR(s.t[0], 0.5 * h - half, 1e-13);
    CHECK_NEAR(s.t[1], 0.5 * h + half, 1e-13);
    dal_events_free(events);
    release(stepper);
}

/* Bounces that accumulate, a ball at rest; two walls at once; a reset that throws far. */
static int wrap(double t, double *x, void *ctx)
{
    x[0] -= 1.0;
    return 0;
}

static void test_resets(const dal_system *ball)
{
    seen s = {.n = 2};
    plane floor = {1, 0.0, 0.5};
    const double x0[4] = {0.0, 2.0, 1.0, 0.0};
    for (int k = 0; k < 2; k++) {
        if (k == 1) floor.restitution = 0.0;
        const dal_event list[] = {
            {.g = above, .reset = bounce, .ctx = &floor, .reset_ctx = &floor}};
        dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, 0.25, x0);
        dal_events *const events = events_of(stepper, "leapfrog", list, 1);
        double rows[4 * 41];
        dal_run run = {.stepper = stepper, .steps = 40, .stride = 1, .x = rows, .events = events,
                       .happened = happened, .happened_ctx = &s};
        s.count = 0;
        const int status = dal_run_go(&run, SIZE_MAX);
        CHECK(status == DAL_EZENO);
        CHECK(strstr(dal_stepper_error(stepper)->text, "g stays at zero after the reset") != NULL);
        CHECK(run.done == (k ? 2 : 8)); /* at rest from t = 2/3 on, or 2/3 + 4/3 */
        CHECK(run.stored == run.done + 1 && rows[4 * run.done + 1] >= -1e-14);
        CHECK(memcmp(rows + 4 * run.done, dal_stepper_state(stepper), 4 * sizeof *rows) == 0);
        CHECK(s.count == 0 || s.t[s.count - 1] <= (double)run.done * 0.25);
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_EZENO); /* as before */
        dal_events_free(events);
        release(stepper);
    }
    /* with steps that do not end where the bounces do */
    floor.restitution = 0.5;
    const dal_event slower[] = {{.g = above, .reset = bounce, .ctx = &floor, .reset_ctx = &floor}};
    for (double h = 0.013; h < 5.0; h *= 1.7) {
        dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, x0);
        dal_events *const events = events_of(stepper, "leapfrog", slower, 1);
        dal_run run = {.stepper = stepper, .steps = (size_t)(4.0 / h) + 1, .stride = 1,
                       .events = events};
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_EZENO && (double)(run.done + 1) * h >= 2.0 - 1e-9);
        CHECK((double)run.done * h <= 2.0 + 1e-6);
        dal_events_free(events);
        release(stepper);
    }
    /* many in one step */
    floor.restitution = 0.97;
    dal_stepper *const long_step = start_at(ball, "leapfrog", 0.0, 60.0, x0);
    dal_events *const many = events_of(long_step, "leapfrog", slower, 1);
    dal_run all = {.stepper = long_step, .steps = 1, .stride = 1, .events = many};
    CHECK(dal_run_go(&all, 1) == DAL_EZENO && all.done == 0);
    CHECK(strstr(dal_stepper_error(long_step)->text, "100 resets in one step") != NULL);
    dal_events_free(many);
    /* into a corner: both walls, and back on the way that led there */
    plane right = {0, 1.0, 1.0}, top = {1, -2.0, 1.0};
    const dal_event corner[] = {{.g = above, .reset = bounce, .ctx = &right, .reset_ctx = &right},
                                {.g = above, .reset = bounce, .ctx = &top, .reset_ctx = &top}};
    const double towards[4] = {0.0, 0.0, 1.0, 0.5 * g0 - 2.0};
    for (double h = 0.3; h > 0.01; h *= 0.5) {
        dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, towards);
        dal_events *const events = events_of(stepper, "leapfrog", corner, 2);
        dal_run run = {.stepper = stepper, .steps = (size_t)ceil(1.2 / h), .stride = 1,
                       .events = events, .happened = happened, .happened_ctx = &s};
        run.steps = (size_t)ceil(1.05 / h);
        s.count = 0;
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && s.count == 2);
        CHECK(s.event[0] != s.event[1]);
        for (size_t k = 0; k < s.count; k++) CHECK_NEAR(s.t[k], 1.0, 1e-12);
        const double T = (double)run.steps * h - 1.0, *const x = dal_stepper_state(stepper);
        CHECK_NEAR(x[0], 1.0 - T, 1e-12);
        CHECK_NEAR(x[1], -2.0 + (2.0 + 0.5 * g0) * T - 0.5 * g0 * T * T, 2e-11);
        dal_events_free(events);
        release(stepper);
    }
    /* a floor that is watched too, by one before it in the list and one after it */
    floor = (plane){1, 0.0, 0.9};
    const dal_event watched[] = {{.g = above, .ctx = &floor},
                                 {.g = above, .reset = bounce, .ctx = &floor, .reset_ctx = &floor},
                                 {.g = above, .direction = -1, .ctx = &floor}};
    for (double h = 0.01; h < 2.0; h *= 1.7) {
        dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, h, x0);
        dal_events *const events = events_of(stepper, "leapfrog", watched, 3);
        dal_run run = {.stepper = stepper, .steps = (size_t)(4.0 / h), .stride = 1,
                       .events = events, .happened = happened, .happened_ctx = &s};
        s.count = 0;
        const int status = dal_run_go(&run, SIZE_MAX);
        CHECK(status == DAL_SUCCESS && s.count % 3 == 0 && s.count >= 6);
        if (status) fprintf(stderr, "h = %g: %s\n", h, dal_stepper_error(stepper)->text);
        for (size_t k = 0; k < s.count; k++) {
            CHECK(s.event[k] == k % 3);
            CHECK_NEAR(s.t[k], s.t[k / 3 * 3], 1e-12);
        }
        dal_events_free(events);
        release(stepper);
    }
    /* on a circle of length 1, several times round in a step */
    plane end = {0, 1.0, 0.0};
    const dal_event round[] = {{.g = above, .direction = 1, .reset = wrap, .ctx = &end}};
    dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, 3.7, x0);
    dal_events *const events = events_of(stepper, "leapfrog", round, 1);
    dal_run run = {.stepper = stepper, .steps = 10, .stride = 1, .events = events,
                   .happened = happened, .happened_ctx = &s};
    s.count = 0;
    const int status = dal_run_go(&run, SIZE_MAX);
    CHECK(status == DAL_SUCCESS && (s.count == 36 || s.count == 37));
    if (status) fprintf(stderr, "%s\n", dal_stepper_error(stepper)->text);
    for (size_t k = 0; k < s.count; k++) CHECK_NEAR(s.t[k], 1.0 + (double)k, 1e-11);
    CHECK_NEAR(dal_stepper_state(stepper)[0] + (double)s.count, 37.0, 1e-11);
    dal_events_free(events);
}

/* ---- the end of a run ----------------------------------------------------------------------- */

static void test_terminal(const dal_system *ball)
{
    const double x0[4] = {0.0, 2.0, 1.5, 0.0};
    plane floor = {1, 0.0, 1.0}, side = {0, 10.0, 0.0};
    const dal_event list[] = {
        {.g = above, .direction = -1, .terminal = 3, .reset = bounce, .ctx = &floor,
         .reset_ctx = &floor},
        {.g = above, .ctx = &side}};
    double rows[4 * 11], at[4 * 6];
    const double times[] = {0.0, 0.66, 0.67, 1.0, 3.31, 3.5}, T = 2.0 / 3.0;
    memset(rows, 0, sizeof rows);
    dal_stepper *const stepper = start_at(ball, "leapfrog", 0.0, 0.05, x0);
    dal_events *const events = events_of(stepper, "leapfrog", list, 2);
    seen s = {.n = 2};
    dal_run run = {.stepper = stepper, .steps = 100, .stride = 10, .x = rows, .events = events,
                   .happened = happened, .happened_ctx = &s, .times = times, .time_count = 6,
                   .x_at_times = at};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED);
    CHECK(run.ended && s.count == 3 && run.stored == 8 && run.done == 66 && run.times_done == 5);
    CHECK_NEAR(run.t_end, 5 * T, 1e-13);
    CHECK_NEAR(rows[4 * 7], 1.5 * 5 * T, 1e-13);
    CHECK(fabs(rows[4 * 7 + 1]) < 1e-13 && rows[4 * 7 + 3] < 0.0 && !s.reset[2] && s.reset[1]);
    CHECK(dal_stepper_time(stepper) == 66 * 0.05);
    for (size_t k = 0; k < 5; k++) {
        const double t = times[k], since = t < T ? t : fmod(t + T, 2 * T) - T;
        CHECK_NEAR(at[4 * k], 1.5 * t, 1e-13);
        CHECK_NEAR(at[4 * k + 1], 2.0 - 0.5 * g0 * since * since, 1e-12);
    }
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED && run.stored == 8 && s.count == 3);
    dal_events_free(events);
}

/* The mean force up to the end, and over a step with a reset: of the blade, by its motion. */
static int pass_x(double t, const double *x, double *g, void *ctx)
{
    *g = x[0] - *(const double *)ctx;
    return 0;
}

static int turn_back(double t, double *x, void *ctx)
{
    for (int i = 3; i < 6; i++) x[i] = -x[i];
    return 0;
}

static void test_reactions(void)
{
    dal_system *const system = open_system("knife_edge");
    double start[6], wall = 0.4, rows[6 * 41], reactions[40];
    need(dal_system_state(system, start), "state", "");
    for (int way = 0; way < 2; way++) {
        const dal_event list[] = {{.g = pass_x, .direction = 1, .terminal = !way,
                                   .reset = turn_back, .ctx = &wall}};
        dal_stepper *const stepper = start_at(system, "leapfrog-kl8", 0.0, 0.1, start);
        dal_events *const events = events_of(stepper, "leapfrog-kl8", list, 1);
        seen s = {.n = 3};
        dal_run run = {.stepper = stepper, .steps = 12, .stride = 12, .x = rows,
                       .reactions = reactions, .events = events, .happened = happened,
                       .happened_ctx = &s};
        CHECK(dal_run_go(&run, SIZE_MAX) == (way ? DAL_SUCCESS : DAL_STOPPED) && s.count == 1);
        /* sum of lambda h = int m (v_x' sin - v_y' cos) dt - m gs int sin: here u omega m + ... */
        const double end = way ? 1.2 : run.t_end, T = s.t[0];
        double sum = 0.0, x[6], back[6];
        enum { PARTS = 20000 };
        dal_system_exact(system, T, start, back);
        turn_back(0.0, back, NULL);
        for (size_t k = 0; k < PARTS; k++) {
            const double t = ((double)k + 0.5) * end / PARTS;
            if (t < T) dal_system_exact(system, t, start, x);
            else dal_system_exact(system, t - T, back, x);
            const double u = x[3] * cos(x[2]) + x[4] * sin(x[2]);
            sum += -(2.0 * u * x[5] + 2.0 * 2.5 * sin(x[2])) / PARTS;
        }
        CHECK_NEAR(reactions[0], sum, 1e-5);
        dal_events_free(events);
        release(stepper);
    }
}

/* ---- inputs --------------------------------------------------------------------------------- */

static int motor(double t, const double *q, const double *v, const double *u, double *f,
                 double *f_q, double *f_v, void *ctx)
{
    if (f) memcpy(f, (double[]){u[0], 0.0}, 2 * sizeof *f);
    if (f_q) memset(f_q, 0, 4 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 4 * sizeof *f_v);
    return 0;
}

/* x = u t^2/2 with u = 1 up to t = 1, and then u = -2. */
static void test_inputs(void)
{
    static const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const dal_system_def def = {.n = 2, .mass = mass, .force = motor, .inputs = 1};
    const double x0[4] = {0.0, 0.0, 0.0, 0.0}, part = sqrt(0.25 - 0.2);
    double inputs[] = {1.0, -2.0};
    dal_system *const system = new_system(&def);
    plane at = {0, 0.7, 0.0};
    const dal_event list[] = {{.g = above, .ctx = &at}};
    dal_stepper *const stepper = start_at(system, "midpoint", 0.0, 0.25, x0);
    dal_events *const events = events_of(stepper, "midpoint", list, 1);
    seen s = {.n = 2};
    dal_run run = {.stepper = stepper, .steps = 8, .stride = 1, .inputs = inputs, .input_steps = 4,
                   .events = events, .happened = happened, .happened_ctx = &s};
    CHECK(dal_run_go(&run, SIZE_MAX) == 0 && s.count == 2);
    CHECK_NEAR(s.t[0], 1.5 - part, 1e-14); /* 1/2 + (t - 1) - (t - 1)^2 = 0.7 */
    CHECK_NEAR(s.t[1], 1.5 + part, 1e-14);
    dal_events_free(events);
}

/* ---- going on elsewhere ---------------------------------------------------------------------- */

/* Bounces in one go; and in pieces, between which all is saved and made anew. */
static void test_resuming(const dal_system *ball)
{
    enum { ALL = 120, EVERY = 7 };
    const double x0[4] = {0.0, 2.0, 1.5, 0.0};
    plane floor = {1, 0.0, 0.97}, apex = {3, 0.0, 0.0};
    const dal_event list[] = {
        {.g = above, .direction = -1, .terminal = 5, .reset = bounce, .ctx = &floor,
         .reset_ctx = &floor},
        {.g = above, .ctx = &apex}};
    double rows[2][4 * (ALL + 1)] = {{0}}, values[200], of_events[10];
    seen s[2] = {{.n = 2}, {.n = 2}};
    size_t ends[2] = {0};
    for (int way = 0; way < 2; way++) {
        dal_stepper *stepper = start_at(ball, "leapfrog-kl6", 0.0, 0.05, x0);
        dal_events *events = events_of(stepper, "leapfrog-kl6", list, 2);
        dal_run run = {.stepper = stepper, .steps = ALL, .stride = 1, .x = rows[way],
                       .events = events, .happened = happened, .happened_ctx = &s[way]};
        int status;
        while ((status = dal_run_go(&run, way ? EVERY : SIZE_MAX)) == 0 && run.done < ALL) {
            const size_t count = dal_stepper_saved(stepper);
            CHECK(count <= DAL_LENGTH(values) && dal_events_saved(events) == 10);
            CHECK(dal_stepper_save(stepper, values) == 0);
            dal_events_save(events, of_events);
            dal_events_free(events);
            release(stepper);
            run.stepper = stepper = open_named(ball, "leapfrog-kl6");
            CHECK(dal_stepper_restore(stepper, values, count) == 0);
            run.events = events = events_of(stepper, "leapfrog-kl6", list, 2);
            CHECK(dal_events_restore(events, of_events, 10, NULL) == 0);
        }
        CHECK(status == DAL_STOPPED);
        ends[way] = run.stored;
        dal_events_free(events);
        release(stepper);
    }
    /* numbers that are no guard's end in an error, not in GSL */
    dal_stepper *const stepper = start_at(ball, "leapfrog-kl6", 0.0, 0.05, x0);
    dal_events *const events = events_of(stepper, "leapfrog-kl6", list, 2);
    dal_run wrong = {.stepper = stepper, .steps = ALL, .stride = 1, .events = events};
    CHECK(dal_run_go(&wrong, 1) == DAL_SUCCESS);
    dal_events_save(events, of_events);
    for (int k = 0; k < 2; k++) of_events[5 * k] = -of_events[5 * k];
    CHECK(dal_events_restore(events, of_events, 10, NULL) == 0);
    CHECK(dal_run_go(&wrong, SIZE_MAX) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "depend only on the state and the time"));
    dal_events_free(events);
    CHECK(ends[0] == ends[1] && memcmp(rows[0], rows[1], sizeof *rows) == 0);
    CHECK(s[0].count == s[1].count && memcmp(s[0].t, s[1].t, sizeof s[0].t) == 0);
    CHECK(s[0].count == 9);
}

/* ---- failures ------------------------------------------------------------------------------- */

typedef struct trouble {
    int kind;
    double from;
} trouble;

static int troubled(double t, const double *x, double *g, void *ctx)
{
    const trouble *const one = ctx;
    if (t > one->from && one->kind == 1) return -7;
    if (t > one->from && one->kind == 2) return 3;
    if (t > one->from && one->kind == 3) *g = INFINITY;
    else if (t > one->from && one->kind == 4) return 0; /* writes nothing */
    else *g = 0.61 - t;
    return 0;
}

static int bad_reset(double t, double *x, void *ctx)
{
    const trouble *const one = ctx;
    if (one->kind == 5) return -1;
    if (one->kind == 6) x[3] += 1.0;
    if (one->kind == 7) x[0] = NAN;
    return 0;
}

static void test_failures(void)
{
    static const struct {
        int status;
        const char *text;
    } expected[] = {{0, ""}, {DAL_EUSER, "event 1 returned -7 at t = "},
                    {DAL_EDOMAIN, "event 1 returned 3 at t = "},
                    {DAL_EDOMAIN, "event 1: g = inf at t = "},
                    {DAL_EDOMAIN, "event 1: g = nan at t = "},
                    {DAL_EUSER, "the reset of event 1 returned -1 at t = 0.61"},
                    {DAL_EOFFD, "after the reset of event 1 at t = 0.61: the initial velocity"},
                    {DAL_EINVAL, "after the reset of event 1 at t = 0.61: q[0] = nan"}};
    dal_system *const system = open_system("knife_edge");
    double start[6], rows[2][6 * 21];
    need(dal_system_state(system, start), "state", "");
    for (int kind = 0; kind < 8; kind++) {
        trouble one = {kind, kind < 5 ? 0.55 : 9.0};
        double wall = 0.1;
        const dal_event list[] = {
            {.g = pass_x, .ctx = &wall},
            {.g = troubled, .reset = kind > 4 ? bad_reset : NULL, .ctx = &one, .reset_ctx = &one}};
        dal_stepper *const stepper = start_at(system, "midpoint", 0.0, 0.1, start);
        dal_events *const events = events_of(stepper, "midpoint", list, 2);
        seen s = {.n = 3};
        dal_run run = {.stepper = stepper, .steps = 20, .stride = 1, .x = rows[kind > 0],
                       .events = events, .happened = happened, .happened_ctx = &s};
        const int status = dal_run_go(&run, SIZE_MAX);
        CHECK(status == expected[kind].status);
        if (kind > 0) {
            CHECK(strstr(dal_stepper_error(stepper)->text, expected[kind].text) != NULL);
            CHECK(run.done == (kind < 5 ? 5 : 6) && dal_stepper_time(stepper) == run.done * 0.1);
            CHECK(memcmp(dal_stepper_state(stepper), rows[1] + 6 * run.done, sizeof start) == 0);
            one = (trouble){0, 9.0}; /* mended, it goes on as if nothing had been */
            CHECK(dal_run_go(&run, SIZE_MAX) == 0);
            if (kind < 5) CHECK(memcmp(rows[0], rows[1], sizeof *rows) == 0);
            CHECK(s.count == 2);
        }
        dal_events_free(events);
        release(stepper);
    }
    /* the mean force over steps of which one was tried again */
    double means[2];
    for (int kind = 0; kind < 2; kind++) {
        trouble one = {kind, 0.55};
        const dal_event list[] = {{.g = troubled, .ctx = &one}};
        dal_stepper *const stepper = start_at(system, "midpoint", 0.0, 0.1, start);
        dal_events *const events = events_of(stepper, "midpoint", list, 1);
        dal_run run = {.stepper = stepper, .steps = 20, .stride = 20, .reactions = &means[kind],
                       .events = events};
        CHECK(kind == 0 || dal_run_go(&run, SIZE_MAX) == DAL_EUSER);
        one.kind = 0;
        CHECK(dal_run_go(&run, SIZE_MAX) == 0);
        dal_events_free(events);
        release(stepper);
    }
    CHECK(means[0] == means[1]);
    /* what is projected on request; an observer that stops; arguments */
    trouble one = {6, 9.0};
    dal_event list[] = {{.g = troubled, .reset = bad_reset, .consistency = DAL_PROJECT,
                         .ctx = &one, .reset_ctx = &one}};
    dal_stepper *const stepper = start_at(system, "midpoint", 0.0, 0.1, start);
    dal_events *const events = events_of(stepper, "midpoint", list, 1);
    seen s = {.n = 3, .stop_at = 1, .answer = 5};
    dal_run run = {.stepper = stepper, .steps = 20, .stride = 1, .x = rows[0], .events = events,
                   .happened = happened, .happened_ctx = &s};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED && s.count == 1 && !run.ended);
    CHECK(run.done == 7);
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && s.count == 1 && run.stored == 21);
    double residual;
    dal_mechanics *const mechanics = open_mechanics(system);
    CHECK(dal_relative_residual(mechanics, 0.0, 0.0, s.after[0], &residual) == 0);
    CHECK(residual <= DAL_RESIDUAL_BOUND(3));

    dal_events *none = NULL;
    dal_error error;
    const dal_scheme midpoint = find_scheme("midpoint"), other = find_scheme("leapfrog");
    CHECK(dal_events_new(NULL, stepper, &midpoint, list, 1, &error) == DAL_EINVAL);
    CHECK(dal_events_new(&none, NULL, &midpoint, list, 1, &error) == DAL_EINVAL);
    CHECK(dal_events_new(&none, stepper, &midpoint, NULL, 1, &error) == DAL_EINVAL);
    CHECK(dal_events_new(&none, stepper, &other, list, 1, &error) == DAL_EINVAL
          && strcmp(error.text, "scheme: expected the scheme of the stepper") == 0);
    dal_scheme adams = find_scheme("reference");
    const dal_flow_scheme data = {.method = DAL_FLOW_MSADAMS, .tolerance = 1e-9};
    adams.data = &data;
    dal_stepper *const multistep = open_stepper(system, &adams, NULL);
    CHECK(dal_events_new(&none, multistep, &adams, list, 1, &error) == DAL_EUNSUPPORTED);
    list[0].consistency = (dal_consistency)9;
    CHECK(dal_events_new(&none, stepper, &midpoint, list, 1, &error) == DAL_EINVAL
          && strstr(error.text, "list[0].consistency = 9") != NULL);
    list[0].g = NULL;
    CHECK(dal_events_new(&none, stepper, &midpoint, list, 1, &error) == DAL_EINVAL
          && strcmp(error.text, "list[0].g is NULL") == 0);
    CHECK(none == NULL);
    double values[5];
    CHECK(dal_events_saved(events) == 5);
    dal_events_save(events, values);
    CHECK(dal_events_restore(events, values, 4, &error) == DAL_EINVAL);
    values[0] = 0.5;
    CHECK(dal_events_restore(events, values, 5, &error) == DAL_EINVAL);
    CHECK(dal_events_restore(NULL, values, 5, &error) == DAL_EINVAL);

    dal_stepper *const second = start_at(system, "midpoint", 0.0, 0.1, start);
    double times[] = {0.3, 0.2}, at[12];
    run = (dal_run){.stepper = second, .steps = 5, .stride = 1, .events = events};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    run = (dal_run){.stepper = second, .steps = 5, .stride = 1, .happened = happened};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    dal_events *const own = events_of(second, "midpoint", NULL, 0);
    run = (dal_run){.stepper = second, .steps = 5, .stride = 1, .events = own, .times = times,
                    .time_count = 2, .x_at_times = at};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL
          && strstr(dal_stepper_error(second)->text, "times[1] = 0.2") != NULL);
    times[1] = 0.51;
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    times[1] = NAN;
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    times[1] = 0.5;
    run.x_at_times = NULL;
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    run.x_at_times = at;
    CHECK(dal_run_go(&run, SIZE_MAX) == 0 && run.times_done == 2);
    dal_events_free(own);
    dal_events_free(events);
    dal_events_free(NULL);
}

/* A run of no steps is at its time. */
static void test_no_steps(void)
{
    dal_system *const system = open_system("sleigh");
    const dal_scheme scheme = find_scheme("leapfrog");
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    double x[6], at[12] = {0};
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, 0.5, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
    dal_events *events = NULL;
    need(dal_events_new(&events, stepper, &scheme, NULL, 0, NULL), "events", "");
    dal_run run = {.stepper = stepper, .stride = 1, .events = events,
                   .times = (double[]){0.5, 0.5}, .time_count = 2, .x_at_times = at};
    CHECK(dal_run_go(&run, 1) == DAL_SUCCESS && run.times_done == 2);
    for (size_t k = 0; k < 2; k++)
        CHECK(memcmp(at + 6 * k, dal_stepper_state(stepper), 6 * sizeof *at) == 0);
    dal_events_free(events);
}

int main(void)
{
    test_no_steps();
    dal_system *const ball = open_ball();
    test_bounces(ball, 0.1);
    test_bounces(ball, 0.8); /* several events in a step */
    test_bounces(ball, 1e-3);
    test_orders();
    check_looking("midpoint", 0.05);
    check_looking("leapfrog-kl6", 0.05);
    check_looking("midpoint-nodes", 0.05);
    check_looking("midpoint", -0.05);
    check_looking("reference", 0.05);
    test_grazing(ball);
    test_twice_by_velocity(ball);
    test_resets(ball);
    test_terminal(ball);
    test_reactions();
    test_inputs();
    test_resuming(ball);
    test_failures();
    return check_done();
}
