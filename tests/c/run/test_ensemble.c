/* Ensembles: each member has the bits that it has by itself, and what fails is one member. */
#include "dalembert/ensemble.h"
#include "check.h"
#include "fixtures.h"

#include <pthread.h>

enum { MEMBERS = 12, STEPS = 24, MOST = 16, MOST_ROWS = STEPS + 1 };

/* ---- a member by itself -------------------------------------------------------------------- */

typedef struct results {
    double states[MEMBERS][MOST_ROWS * MOST], energy[MEMBERS][MOST_ROWS];
    double residual[MEMBERS][MOST_ROWS], multipliers[MEMBERS][MOST_ROWS * MOST];
    double reactions[MEMBERS][MOST_ROWS * MOST], t_end[MEMBERS];
    size_t done[MEMBERS], happened[MEMBERS][2], ended_by[MEMBERS];
    int status[MEMBERS];
    dal_stats stats[MEMBERS];
    dal_error errors[MEMBERS];
} results;

/* The system with the parameters of a member: each by some percent from its default, but for whole
 * numbers. */
static dal_system *open_member(const char *name, size_t member, double *values)
{
    dal_system *const like = open_system(name);
    const size_t count = dal_system_parameters(like);
    const char *names[8] = {0};
    if (count == 0) return like;
    for (size_t i = 0; i < count; i++) {
        names[i] = dal_system_parameter_name(like, i);
        values[i] = dal_system_parameter(like, i);
        if (strcmp(names[i], "trailers") != 0 && strcmp(names[i], "pairs") != 0)
            values[i] *= 1.0 + 0.05 * sin((double)(3 * member + i));
    }
    return open_builtin(name, count, names, values);
}

static dal_stepper *start_member(const dal_system *system, const dal_scheme *scheme, double h)
{
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    double x[MOST];
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, 0.5, h, x, DAL_PROJECT,
                           scheme->nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         scheme->name, dal_stepper_error(stepper)->text);
    return stepper;
}

static bool same(size_t count, const double *x, const double *y)
{
    for (size_t i = 0; i < count; i++)
        if (!(x[i] == y[i] || (isnan(x[i]) && isnan(y[i])))) return false;
    return true;
}

/* Rows of a run by itself, with an own system of these parameters, against row k of the results. */
static void check_member(const char *name, const dal_scheme *scheme, double h, size_t stride,
                         size_t rows, const results *found, size_t k)
{
    double values[8], x[MOST_ROWS * MOST], reactions[MOST_ROWS * MOST], energy[MOST_ROWS];
    double residual[MOST_ROWS], multipliers[MOST_ROWS * MOST], shift = 0.0;
    dal_system *const system = open_member(name, k, values);
    dal_stepper *const stepper = start_member(system, scheme, h);
    dal_mechanics *const mech = open_mechanics(system);
    const size_t n = dal_system_n(system), m = dal_system_m(system), all = STEPS / stride + 1;
    if (scheme->nodes == DAL_KEPT_NODES) dal_scheme_shift(scheme, &shift);
    CHECK(!dal_integrate(stepper, STEPS, stride, x, reactions, NULL, NULL, NULL));
    CHECK(!dal_trajectory(mech, 0.5, (double)stride * h, shift * h, all, x, NULL, energy,
                          multipliers, NULL, residual, NULL));
    dal_stats stats = stats_of(stepper);
    stats.error = (double)NAN; /* of which members have no estimate */
    stats.remade = stats.whole = 0;
    const size_t from = all - rows; /* which are all of them, or the last */
    CHECK(found->status[k] == 0 && found->done[k] == STEPS && found->errors[k].text[0] == '\0');
    CHECK(found->t_end[k] == dal_stepper_time(stepper));
    CHECK(same(rows * 2 * n, found->states[k], x + from * 2 * n));
    CHECK(same(rows, found->energy[k], energy + from));
    CHECK(same(rows, found->residual[k], residual + from));
    CHECK(same(rows * m, found->multipliers[k], multipliers + from * m));
    CHECK(memcmp(&found->stats[k], &stats, sizeof stats) == 0);
    if (rows > 1 || all == 2) CHECK(same((all - 1) * m, found->reactions[k], reactions));
    release(system);
}

static dal_members members_of(results *to)
{
    return (dal_members){
        .count = MEMBERS, .t0 = 0.5, .consistency = DAL_PROJECT,
        .states = to->states[0], .energy = to->energy[0], .residual = to->residual[0],
        .multipliers = to->multipliers[0], .reactions = to->reactions[0], .t_end = to->t_end,
        .done = to->done, .ended_by = to->ended_by, .status = to->status, .stats = to->stats,
        .errors = to->errors};
}

/* The results of packed arrays with rows rows each, by members. */
static void spread(results *found, size_t n, size_t m, size_t rows)
{
    static results packed;
    const size_t intervals = rows > 1 ? rows - 1 : 1;
    packed = *found;
    for (size_t k = 0; k < MEMBERS; k++) {
        const struct { double *to, *from; size_t size; } parts[] = {
            {found->states[k], packed.states[0], rows * 2 * n},
            {found->energy[k], packed.energy[0], rows},
            {found->residual[k], packed.residual[0], rows},
            {found->multipliers[k], packed.multipliers[0], rows * m},
            {found->reactions[k], packed.reactions[0], intervals * m}};
        for (size_t i = 0; i < sizeof parts / sizeof *parts; i++)
            memcpy(parts[i].to, parts[i].from + k * parts[i].size,
                   parts[i].size * sizeof(double));
    }
}

/* ---- bits ---------------------------------------------------------------------------------- */

static void check_bits(const char *name, const char *scheme_name, double h, size_t stride)
{
    static results found;
    double values[MEMBERS][8] = {{0}};
    const dal_scheme scheme = find_scheme(scheme_name);
    dal_system *const system = open_system(name);
    const size_t n = dal_system_n(system), m = dal_system_m(system), steps = STEPS;
    const size_t rows = stride > 0 ? STEPS / stride + 1 : 1;
    dal_error error = {0};
    for (size_t k = 0; k < MEMBERS; k++) open_member(name, k, values[k]);
    dal_members members = members_of(&found);
    members.h = &h;
    members.steps = &steps;
    members.stride = stride;
    members.initial =
        scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
    if (dal_system_parameters(system) > 0) {
        members.parameters = values;
        members.parameters_next = sizeof values[0];
        CHECK(dal_system_parameter_size(system) == dal_system_parameters(system) * sizeof(double));
    }
    /* in pieces, out of order */
    const size_t pieces[][2] = {{7, 5}, {0, 3}, {3, 4}};
    for (size_t i = 0; i < 3; i++)
        CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, pieces[i][0], pieces[i][1], NULL,
                                NULL, &error));
    spread(&found, n, m, rows);
    for (size_t k = 0; k < MEMBERS; k++)
        check_member(name, &scheme, h, stride > 0 ? stride : STEPS, rows, &found, k);
}

static void test_bits(void)
{
    static const char *const schemes[] = {"explicit", "midpoint", "leapfrog-kl6", "endpoint",
                                          "midpoint-nodes", "pair:0.5:0.25", "reference"};
    for (size_t j = 0; j < sizeof schemes / sizeof *schemes; j++) {
        for (size_t i = 0; i < dal_builtin_count(); i++)
            check_bits(dal_builtin_name(i), schemes[j], 0.01, i % 2 ? 4 : 0);
        check_bits("uneven_edge", schemes[j], 0.01, 1);
        check_bits("generic4", schemes[j], -0.01, 6);
    }
}

/* ---- a user's own system with parameters --------------------------------------------------- */

/* A blade of length p[1] ahead, with a mass that is not diagonal, p[0] of it. */
static int own_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                          double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]), ahead = ((const double *)ctx)[1];
    (void)t, (void)phi_t;
    if (phi) phi[0] = c * v[1] - s * v[0] - ahead * v[2];
    if (phi_v) phi_v[0] = -s, phi_v[1] = c, phi_v[2] = -ahead;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0, phi_q[2] = -c * v[0] - s * v[1];
    return 0;
}

static int own_parameters(double *mass, double *state, const void *ctx)
{
    const double *const p = ctx;
    if (p[0] > 90.0) return p[0] > 95.0 ? -1 : 1;
    const double M[9] = {2.0, 0.3 * p[0] - 0.3, 0.0, 0.3 * p[0] - 0.3, 2.0, 0.0, 0.0, 0.0, p[0]};
    if (mass) memcpy(mass, M, sizeof M);
    if (state && p[1] != 0.0) state[0] = p[1]; /* the rest is that of the definition */
    return 0;
}

static dal_system *open_own(const double *p)
{
    double M[9], state[6] = {0.0, 0.0, 0.4, 1.0, 0.0, 0.7};
    need(own_parameters(M, state, p), "own", "");
    double values[2] = {p[0], p[1]};
    const dal_system_def def = {.n = 3, .m = 1, .mass = M, .constraint = own_constraint,
                                .ctx = values, .ctx_size = sizeof values, .state = state,
                                .parameters = own_parameters};
    dal_system *system;
    system = new_system(&def);
    return system;
}

/* Off the diagonal M may be 0 for one member and not for the next; and members fail. */
static void test_own(void)
{
    static const double p[][2] = {{1.0, 0.5}, {0.0, 0.5}, {2.0, -0.3}, {91.0, 1.0}, {96.0, 1.0},
                                  {1e-3, 0.0}, {9.0, 1.0}, {1.0, NAN}, {NAN, 0.25}, {1.5, 0.25},
                                  {1.0, 0.5}};
    enum { COUNT = sizeof p / sizeof *p };
    static const int expected[COUNT] = {0, DAL_EINVAL, 0, DAL_EDOMAIN, DAL_EUSER,
                                        0, DAL_EINVAL, DAL_EINVAL, DAL_EINVAL, 0, 0};
    const dal_scheme scheme = find_scheme("midpoint");
    static const double without[2] = {1.0, 0.0};
    dal_system *const system = open_own(without);
    const double h = 0.02;
    const size_t steps = STEPS;
    double states[COUNT][6], t_end[COUNT];
    size_t done[COUNT];
    int status[COUNT];
    static dal_error errors[COUNT];
    const dal_members members = {.count = COUNT, .parameters = p, .parameters_next = sizeof p[0],
                                 .h = &h, .steps = &steps, .consistency = DAL_PROJECT,
                                 .states = states[0], .done = done, .status = status,
                                 .t_end = t_end, .errors = errors};
    CHECK(dal_system_parameter_size(system) == sizeof p[0]);
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) {
        CHECK(status[k] == expected[k]);
        CHECK((errors[k].text[0] != '\0') == (expected[k] != 0));
        CHECK(done[k] == (expected[k] ? 0 : STEPS) && isnan(t_end[k]) == (expected[k] != 0));
        if (expected[k]) {
            CHECK(isnan(states[k][0]) && isnan(states[k][5]));
            continue;
        }
        dal_system *const own = open_own(p[k]);
        dal_stepper *const stepper = open_stepper(own, &scheme, NULL);
        double x[6];
        need(dal_system_state(own, x), "state", "");
        CHECK(x[0] == (p[k][1] != 0.0 ? p[k][1] : 0.0));
        CHECK(!dal_stepper_start(stepper, 0.0, h, x, DAL_PROJECT, DAL_INITIAL_NONE));
        CHECK(!dal_advance(stepper, STEPS, NULL, NULL));
        CHECK(same(6, states[k], dal_stepper_state(stepper)));
        release(own);
    }
    CHECK(strstr(errors[1].text, "not positive definite"));
    CHECK(strstr(errors[3].text, "parameters returned 1"));
    CHECK(strstr(errors[7].text, "state has an entry that is not finite"));
    CHECK(strstr(errors[8].text, "mass[0,1] = nan is not finite"));
}

/* Of built-in systems each parameter has its range, and none changes n. */
static void test_ranges(void)
{
    const dal_scheme scheme = find_scheme("leapfrog");
    const double h = 0.01;
    const size_t steps = 5;
    static dal_error errors[2];
    int status[2];
    dal_members members = {.count = 2, .h = &h, .steps = &steps, .status = status,
                           .errors = errors};
    dal_system *system = open_system("sleigh");
    double sleigh[2][3];
    for (size_t i = 0; i < 3; i++) sleigh[0][i] = sleigh[1][i] = dal_system_parameter(system, i);
    sleigh[0][0] = -1.0;
    members.parameters = sleigh;
    members.parameters_next = sizeof sleigh[0];
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, 2, NULL, NULL, NULL));
    CHECK(status[0] == DAL_EINVAL && status[1] == 0);
    CHECK(strstr(errors[0].text, "parameter m of sleigh = -1: expected"));

    system = open_system("n_trailer");
    const size_t count = dal_system_parameters(system);
    double trailer[2][8];
    for (size_t i = 0; i < count; i++) {
        trailer[0][i] = trailer[1][i] = dal_system_parameter(system, i);
        if (strcmp(dal_system_parameter_name(system, i), "trailers") == 0) trailer[1][i] += 1.0;
    }
    members.parameters = trailer;
    members.parameters_next = sizeof trailer[0];
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, 2, NULL, NULL, NULL));
    CHECK(status[0] == 0 && status[1] == DAL_EINVAL && strstr(errors[1].text, "expected n ="));
}

/* ---- events, step sizes, inputs ------------------------------------------------------------ */

static int past(double t, const double *x, double *g, void *ctx)
{
    (void)t;
    *g = x[0] - ((const double *)ctx)[1];
    return 0;
}

static int headed(double t, const double *x, double *g, void *ctx)
{
    (void)t;
    *g = x[2] - *(const double *)ctx;
    return 0;
}

static int turned(double t, const double *x, double *g, void *ctx)
{
    (void)t, (void)ctx;
    *g = sin(4.0 * x[2]);
    return 0;
}

static int count_turn(size_t event, size_t step, double t, const double *x, const double *after,
                      void *ctx)
{
    (void)step, (void)t, (void)x, (void)after;
    *(size_t *)ctx += event;
    return 0;
}

/* A member ends where its own run does; what an event remembers does not reach the next member. */
static void test_events(void)
{
    static const double walls[] = {1.1, 99.0, 0.35};
    enum { COUNT = 9 };
    dal_system *const system = open_system("sleigh");
    const dal_scheme scheme = find_scheme("midpoint-nodes");
    double x0[COUNT][6], h[COUNT], states[COUNT][6], energy[COUNT], t_end[COUNT];
    size_t steps[COUNT], done[COUNT], happened[COUNT][2], ended_by[COUNT];
    int status[COUNT];
    size_t ended = 0;
    for (size_t wall = 0; wall < 3; wall++) {
        const dal_event events[2] = {{.g = headed, .terminal = 1 + (wall == 2),
                                      .ctx = (void *)&walls[wall]},
                                     {.g = turned, .ctx = (void *)walls}};
        for (size_t k = 0; k < COUNT; k++) {
            need(dal_system_state(system, x0[k]), "state", "");
            for (size_t i = 3; i < 6; i++) x0[k][i] *= 1.0 + (double)k;
            h[k] = 0.01 / (double)(k + 1);
            steps[k] = k == 5 ? 0 : 100 * (k + 1);
        }
        const dal_members members = {
            .count = COUNT, .x = x0[0], .x_next = 6, .h = h, .h_next = 1, .steps = steps,
            .steps_next = 1, .initial = DAL_INITIAL_SHIFT, .events = events, .event_count = 2,
            .states = states[0], .energy = energy, .t_end = t_end, .done = done,
            .happened = happened[0], .ended_by = ended_by, .status = status};
        CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, COUNT, NULL, NULL, NULL));
        for (size_t k = 0; k < COUNT; k++) {
            dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
            dal_events *own;
            double rows[2 * 6];
            need(dal_stepper_start(stepper, 0.0, h[k], x0[k], DAL_CHECK, DAL_INITIAL_SHIFT),
                 "start", "");
            need(dal_events_new(&own, stepper, &scheme, events, 2, NULL), "events", "");
            size_t turns = 0;
            dal_run run = {.stepper = stepper, .steps = steps[k], .stride = k == 5 ? 1 : steps[k],
                           .x = rows, .events = own, .happened = count_turn,
                           .happened_ctx = &turns};
            const int ends = dal_run_go(&run, SIZE_MAX);
            CHECK(status[k] == 0 && done[k] == run.done);
            CHECK((ends == DAL_STOPPED) == (ended_by[k] == 0) && (ends || ended_by[k] == 2));
            CHECK(t_end[k] == (run.ended ? run.t_end : dal_stepper_time(stepper)));
            CHECK(same(6, states[k], k == 5 ? rows : rows + 6) && isfinite(energy[k]));
            CHECK((happened[k][0] == events[0].terminal) == (ended_by[k] == 0));
            CHECK(happened[k][1] == turns);
            ended += ended_by[k] == 0;
            dal_events_free(own);
            release(stepper);
        }
    }
    CHECK(ended > 0 && ended < 2 * COUNT);
}

/* Where a ctx is NULL an event has the parameters of its member.  The first ends within a step, and
 * the others begin in the same state. */
static void test_parameters_of_events(void)
{
    static const double p[][2] = {{1.0, 0.005}, {1.0, 0.006}, {1.0, -0.5}, {1.0, 0.7}};
    const dal_scheme scheme = find_scheme("leapfrog");
    dal_system *const system = open_own(p[0]);
    const dal_event event = {.g = past, .terminal = 1};
    const double h = 0.01, x0[6] = {0.0, 0.0, 0.0, 1.0, 0.0, 0.0};
    const size_t steps = 1000;
    double states[4][6];
    const dal_members members = {.count = 4, .x = x0, .parameters = p,
                                 .parameters_next = sizeof p[0], .h = &h, .steps = &steps,
                                 .consistency = DAL_PROJECT, .events = &event, .event_count = 1,
                                 .states = states[0]};
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, 4, NULL, NULL, NULL));
    for (size_t k = 0; k < 4; k++)
        if (p[k][1] > 0.0) CHECK_NEAR(states[k][0], p[k][1], 1e-12);
        else CHECK(states[k][0] > 2.0); /* it began behind its wall */
}

/* ---- inputs, what is measured --------------------------------------------------------------- */

enum { PUSHES = 3 };

/* f = (u, 0) on a particle in the plane; not defined where a member starts, unless u is 0. */
static int pushed(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)v, (void)ctx;
    if (f) f[0] = u[0], f[1] = 0.0;
    if (f_q) memset(f_q, 0, 4 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 4 * sizeof *f_v);
    return q[0] == 0.0 && u[0] != 0.0;
}

/* V = -log(1 - q_1)/100: a wall, which the run may be beyond after a step that is too large. */
static int walled(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = -log(1.0 - q[1]) / 100.0;
    if (V_q) V_q[0] = 0.0, V_q[1] = 0.01 / (1.0 - q[1]);
    if (V_qq) memset(V_qq, 0, 4 * sizeof *V_qq), V_qq[3] = 0.01 / ((1.0 - q[1]) * (1.0 - q[1]));
    return 0;
}

/* Each member has its inputs, and starts with none; what is not defined at a row is NaN there. */
static void test_inputs(void)
{
    enum { COUNT = 4, ROWS = 1 + 2 * PUSHES };
    static const double mass[4] = {1.0, 0.0, 0.0, 2.0};
    const dal_system_def def = {.n = 2, .mass = mass, .force = pushed, .inputs = 1,
                                .positional = 1, .potential = walled};
    const dal_scheme scheme = find_scheme("explicit");
    const double h = 0.25;
    const size_t steps = 2 * PUSHES;
    double u[COUNT][PUSHES], x[COUNT][4], states[COUNT][4 * ROWS], energy[COUNT][ROWS];
    int status[COUNT];
    static dal_error errors[COUNT];
    dal_system *system;
    system = new_system(&def);
    for (size_t k = 0; k < COUNT; k++) {
        for (size_t i = 0; i < PUSHES; i++) u[k][i] = 1.0 + (double)(k + i);
        memcpy(x[k], (double[4]){0.0, 0.0, 1.0, k == 2 ? 1.5 : 0.1}, sizeof x[k]);
    }
    const dal_members members = {.count = COUNT, .x = x[0], .x_next = 4, .h = &h, .steps = &steps,
                                 .inputs = u[0], .inputs_next = PUSHES, .input_steps = 2,
                                 .stride = 1,
                                 .states = states[0], .energy = energy[0], .status = status,
                                 .errors = errors};
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) {
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double rows[4 * ROWS];
        need(dal_stepper_start(stepper, 0.0, h, x[k], DAL_CHECK, DAL_INITIAL_NONE), "start", "");
        dal_run run = {.stepper = stepper, .steps = steps, .stride = 1, .input_steps = 2, .x = rows,
                       .inputs = u[k]};
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
        const size_t good = k == 2 ? 3 : ROWS; /* at t = 3/4 it is beyond the wall, and goes on */
        CHECK(status[k] == DAL_SUCCESS && same(4 * ROWS, states[k], rows));
        CHECK(isfinite(energy[k][good - 1]) && (k != 2 || isnan(energy[k][good])));
        release(stepper);
    }
    dal_members at_end = members;
    at_end.stride = 0;
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &at_end, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) CHECK(status[k] == 0 && isnan(energy[0][k]) == (k == 2));
}

static int brake(double t, const double *x, double *u, void *ctx)
{
    (void)t;
    u[0] = -*(const double *)ctx * x[2];
    return 0;
}

/* Not defined, whatever it has written. */
static int undefined(double t, const double *x, double *u, void *ctx)
{
    (void)t, (void)x, (void)ctx;
    u[0] = 1.0;
    return 1;
}

/* A velocity that is braked in proportion to itself, held for two steps: after k holds of T it is
 * (1 - c T)^k of the first; the members have numbers of steps of their own. */
static void test_control(void)
{
    enum { COUNT = 3 };
    static const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    static const size_t steps[COUNT] = {3, 40, 7};
    const dal_system_def def = {.n = 2, .mass = mass, .force = pushed, .inputs = 1,
                                .positional = 1};
    const dal_scheme scheme = find_scheme("explicit");
    const double h = 0.25, c = 0.5, x[4] = {1.0, 0.0, 2.0, 0.0};
    double states[COUNT][4];
    const dal_law law = {.values = brake, .count = 1, .ctx = (void *)&c};
    dal_system *system;
    system = new_system(&def);
    const dal_members members = {.count = COUNT, .x = x, .h = &h, .steps = steps, .steps_next = 1,
                                 .control = &law, .input_steps = 2, .states = states[0]};
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &members, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) {
        const double held = pow(1.0 - 2.0 * c * h, (double)(steps[k] / 2));
        CHECK_NEAR(states[k][2], 2.0 * held * (steps[k] % 2 ? 1.0 - c * h : 1.0), 8.0 * U);
    }
    const dal_law none = {.values = undefined, .count = 1};
    dal_members refused = members;
    int status[COUNT];
    refused.control = &none;
    refused.status = status;
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &refused, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) CHECK(status[k] == DAL_EINVAL);
}

/* ---- stopping, threads, refusals ------------------------------------------------------------ */

static int stop_at(double far, void *ctx) { return far >= *(const double *)ctx; }

/* Within a step that takes long, or between steps. */
static void test_stopping(const char *name, double h)
{
    static results found;
    dal_system *const system = open_system("knife_edge");
    const dal_scheme scheme = find_scheme(name);
    const size_t steps = 100000000;
    double part = 0.0;
    dal_error error = {0};
    dal_members members = members_of(&found);
    members.h = &h;
    members.steps = &steps;
    CHECK(dal_ensemble_run(system, &scheme, NULL, &members, 2, 3, stop_at, &part, &error)
          == DAL_STOPPED);
    CHECK(strstr(error.text, "watch"));
    for (size_t k = 2; k < 5; k++) {
        CHECK(found.status[k] == DAL_STOPPED && isnan(found.states[0][6 * k]));
        CHECK(found.done[k] < steps && (k == 2 || isnan(found.t_end[k])));
    }
}

typedef struct task {
    const dal_system *system;
    const dal_members *members;
    size_t first, count;
    int status;
} task;

static void *run_task(void *ctx)
{
    task *const self = ctx;
    const dal_scheme scheme = find_scheme("midpoint");
    self->status = dal_ensemble_run(self->system, &scheme, NULL, self->members, self->first,
                                    self->count, NULL, NULL, NULL);
    return NULL;
}

/* Several threads on parts of one ensemble. */
static void test_threads(void)
{
    enum { COUNT = 400, THREADS = 4 };
    static double values[COUNT][8], alone[COUNT][6], together[COUNT][6];
    dal_system *const system = open_system("sleigh");
    const double h = 0.01;
    const size_t steps = 200;
    for (size_t k = 0; k < COUNT; k++) open_member("sleigh", k, values[k]);
    dal_members members = {.count = COUNT, .parameters = values,
                           .parameters_next = sizeof values[0], .h = &h, .steps = &steps,
                           .states = alone[0]};
    task one = {system, &members, 0, COUNT, -1};
    run_task(&one);
    CHECK(one.status == 0);
    dal_members shared = members;
    shared.states = together[0];
    pthread_t threads[THREADS];
    task tasks[THREADS];
    for (size_t i = 0; i < THREADS; i++) {
        tasks[i] = (task){system, &shared, i * COUNT / THREADS, COUNT / THREADS, -1};
        if (pthread_create(&threads[i], NULL, run_task, &tasks[i])) exit(2);
    }
    for (size_t i = 0; i < THREADS; i++) {
        pthread_join(threads[i], NULL);
        CHECK(tasks[i].status == 0);
    }
    CHECK(memcmp(alone, together, sizeof alone) == 0);
}

static dal_system *open_stateless(void)
{
    static const double mass[1] = {1.0};
    const dal_system_def def = {.n = 1, .mass = mass};
    dal_system *system;
    system = new_system(&def);
    return system;
}

static void test_refusals(void)
{
    dal_system *const system = open_system("particle"), *const own = open_system("generic4");
    const dal_scheme scheme = find_scheme("leapfrog"), flow = {.name = "reference",
        .family = find_scheme("reference").family,
        .data = &(dal_flow_scheme){DAL_FLOW_MSADAMS, 1e-9}};
    const double h = 0.01, number = 1.0;
    const size_t steps = 10;
    const dal_event event = {.g = turned, .ctx = (void *)&number};
    const dal_law law = {.values = brake, .count = 1, .ctx = (void *)&number};
    const dal_system_def pushable = {.n = 1, .mass = &number, .force = pushed, .inputs = 1};
    dal_system *driven;
    driven = new_system(&pushable);
    dal_members good = {.count = 2, .h = &h, .steps = &steps};
    int status[2] = {9, 9};
    good.status = status;
#define REFUSED(code, system, scheme, words, ...) \
    do { \
        dal_error error = {0}; \
        dal_members wrong = good; \
        __VA_ARGS__; \
        CHECK(dal_ensemble_run(system, scheme, NULL, &wrong, 0, 2, NULL, NULL, &error) == code); \
        CHECK(strstr(error.text, words) != NULL); \
    } while (0)
    REFUSED(DAL_EINVAL, NULL, &scheme, "system", (void)wrong);
    REFUSED(DAL_EINVAL, system, NULL, "scheme", (void)wrong);
    REFUSED(DAL_EINVAL, system, &scheme, "members.h", wrong.h = NULL);
    REFUSED(DAL_EINVAL, system, &scheme, "members.steps", wrong.steps = NULL);
    REFUSED(DAL_EINVAL, system, &scheme, "members.events", wrong.event_count = 1);
    REFUSED(DAL_EINVAL, system, &scheme, "within the 1 members", wrong.count = 1);
    REFUSED(DAL_EINVAL, own, &scheme, "parameters", wrong.parameters = &number);
    REFUSED(DAL_EINVAL, system, &scheme, "members.inputs", wrong.inputs = &number);
    REFUSED(DAL_EINVAL, system, &scheme, "members.control", wrong.control = &law);
    REFUSED(DAL_EINVAL, driven, &scheme, "one of them", wrong.inputs = &number;
            wrong.control = &law);
    REFUSED(DAL_EINVAL, system, &scheme, "steps_next", wrong.stride = 5; wrong.steps_next = 1);
    REFUSED(DAL_EINVAL, system, &scheme, "multiple of stride = 3", wrong.stride = 3);
    REFUSED(DAL_EUNSUPPORTED, system, &flow, "does not support events", wrong.events = &event;
            wrong.event_count = 1);
    dal_system *const nameless = open_stateless();
    REFUSED(DAL_EINVAL, nameless, &scheme, "no default initial data", (void)wrong);
#undef REFUSED
    const dal_options varied = {.tolerance = 1e-6};
    const double ahead = INFINITY, start[2] = {0.0, 1.0};
    good.h = &ahead;
    good.until = 1.0;
    dal_members wrong[4] = {good, good, good, good};
    wrong[0].stride = 1;
    wrong[1].until = INFINITY;
    wrong[2].inputs = wrong[3].inputs = &number;
    wrong[2].x = wrong[3].x = start;
    wrong[3].input_duration = -0.5;
    static const char *const words[] = {"members.stride = 1: expected 0", "members.until = inf",
                                        "input_duration = 0", "input_duration = -0.5"};
    const dal_scheme composed = find_scheme("leapfrog-kl6");
    for (size_t i = 0; i < 4; i++) {
        dal_error refused = {0};
        CHECK(dal_ensemble_run(i < 2 ? system : driven, &composed, &varied, &wrong[i], 0, 2, NULL,
                               NULL, &refused) == DAL_EINVAL);
        CHECK(strstr(refused.text, words[i]) != NULL);
    }
    CHECK(status[0] == 9);
    dal_error error = {0};
    CHECK(dal_ensemble_run(system, &scheme, NULL, &good, 1, 2, NULL, NULL, &error) == DAL_EINVAL);
    CHECK(dal_ensemble_run(system, &scheme, NULL, NULL, 0, 2, NULL, NULL, &error) == DAL_EINVAL);
    CHECK(!dal_ensemble_run(system, &scheme, NULL, &good, 2, 0, NULL, NULL, &error));
    double p[1] = {1.0}, M[9], state[6];
    const dal_system_def def = {.n = 3, .mass = M, .ctx = p, .parameters = own_parameters};
    dal_system *none;
    own_parameters(M, state, (double[2]){1.0, 1.0});
    CHECK(dal_system_new(&none, &def, &error) == DAL_EINVAL && strstr(error.text, "ctx_size"));
}

/* Steps of variable size: the bits of a run, and inputs that are held for a time. */
static void test_varied(void)
{
    enum { COUNT = 3 };
    const dal_scheme scheme = find_scheme("leapfrog-kl6");
    const dal_options options = {.tolerance = 1e-8, .h_max = 0.7};
    const double h = INFINITY, c = 0.5, x[4] = {1.0, 0.0, 2.0, 0.0};
    const size_t most = SIZE_MAX / 2;
    double values[COUNT][8] = {{0}}, states[COUNT][6], t_end[COUNT], reactions[COUNT];
    size_t done[COUNT];
    dal_system *const system = open_system("sleigh");
    for (size_t k = 0; k < COUNT; k++) open_member("sleigh", k, values[k]);
    dal_members members = {.count = COUNT, .h = &h, .steps = &most, .t0 = 0.5, .until = 3.0,
                           .parameters = values, .parameters_next = sizeof values[0],
                           .states = states[0], .t_end = t_end, .reactions = reactions,
                           .done = done, .lanes = 1};
    CHECK(!dal_ensemble_run(system, &scheme, &options, &members, 0, COUNT, NULL, NULL, NULL));
    for (size_t k = 0; k < COUNT; k++) {
        double own[8], start[6], reaction;
        dal_system *const one = open_member("sleigh", k, own);
        dal_stepper *const stepper = open_stepper(one, &scheme, &options);
        need(dal_system_state(one, start), "state", "");
        CHECK(!dal_stepper_start(stepper, 0.5, h, start, DAL_CHECK, DAL_INITIAL_NONE));
        dal_run run = {.stepper = stepper, .steps = most, .stride = most, .until = 3.0,
                       .reactions = &reaction};
        CHECK(!dal_run_go(&run, SIZE_MAX) && done[k] == run.done && run.done > 3);
        CHECK(same(6, states[k], dal_stepper_state(stepper)) && t_end[k] == 3.0);
        CHECK(reactions[k] == reaction);
        release(one);
    }
    static const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const dal_system_def def = {.n = 2, .mass = mass, .force = pushed, .inputs = 1,
                                .positional = 1};
    const dal_law law = {.values = brake, .count = 1, .ctx = (void *)&c};
    dal_system *braked;
    braked = new_system(&def);
    members = (dal_members){.count = 1, .x = x, .h = &h, .steps = &most, .until = 2.0,
                            .control = &law, .input_duration = 0.25, .states = states[0]};
    CHECK(!dal_ensemble_run(braked, &scheme, &options, &members, 0, 1, NULL, NULL, NULL));
    CHECK_NEAR(states[0][2], 2.0 * pow(1.0 - c * 0.25, 8.0), 64.0 * U);
}

int main(void)
{
    test_bits();
    test_varied();
    test_own();
    test_ranges();
    test_events();
    test_parameters_of_events();
    test_inputs();
    test_control();
    test_stopping("reference", 1e3);
    test_stopping("leapfrog", 1e-3);
    test_threads();
    test_refusals();
    return check_done();
}
