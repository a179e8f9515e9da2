/* Members stepped together, with callbacks inside as a program does that brings its own: the bits
 * of the scalar step routine, whoever the neighbours are, and what stops a lane. */
#include "fixtures.h"
#include "check.h"

#include "dalembert/kernel.h"
#include "dalembert/lanes.h"
#include "step/lanes.h"

/* A knife edge on a plane that turns, with two blades if there are two rows: the second one, of
 * length reach, is not defined where x > wall. */
typedef struct edge {
    double slope, turn, reach, wall;
} edge;

/* Both kinds of callbacks from one text: for numbers, and for vectors. */
#define EDGE_PULL(sin, cos, all) \
    V_q[0] = -p[0] + 0.3 * cos(q[2] + p[1] * t); \
    V_q[1] = 0.3 * sin(q[2] + p[1] * t) * q[1]; \
    V_q[2] = all(0.1) * q[0]
#define EDGE_ROWS(sin, cos, all, choose) \
    mu[0] = sin(q[2] + p[1] * t); \
    mu[1] = -cos(q[2] + p[1] * t); \
    mu[2] = all(0.2); \
    mu[3] = all(0.0); \
    mu[4] = cos(q[2]) + 0.1 * q[0]; \
    mu[5] = sin(q[2]); \
    mu[6] = choose(q[0] > p[3], all(NAN), -p[2]); \
    mu[7] = q[0] * q[3] + 1.0
#define EDGE_SLOPES(sin, cos, all) \
    N[0] = N[1] = N[3] = N[5] = all(0.0); \
    N[2] = cos(q[2] + p[1] * t) * v[0] + sin(q[2] + p[1] * t) * v[1]; \
    N[4] = 0.1 * v[0] + q[3] * v[3]; \
    N[6] = cos(q[2]) * v[1] - sin(q[2]) * v[0]; \
    N[7] = q[0] * v[3]

#define NUMBER(x) (x)
#define EITHER(condition, a, b) ((condition) ? (a) : (b))

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *const p = ctx;
    if (V) *V = 0.0; /* where the plane turns there is none; nothing here looks at it */
    if (V_q) {
        EDGE_PULL(sin, cos, NUMBER);
        V_q[3] = 0.0;
    }
    if (V_qq) {
        memset(V_qq, 0, 16 * sizeof *V_qq);
        V_qq[2] = -0.3 * sin(q[2] + p[1] * t);
        V_qq[5] = 0.3 * sin(q[2] + p[1] * t);
        V_qq[6] = 0.3 * cos(q[2] + p[1] * t) * q[1];
        V_qq[8] = 0.1;
    }
    return 0;
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const double *const p = ctx;
    double mu[8], N[8];
    EDGE_ROWS(sin, cos, NUMBER, EITHER);
    EDGE_SLOPES(sin, cos, NUMBER);
    if (phi)
        for (int a = 0; a < 2; a++) {
            phi[a] = 0.0;
            for (int i = 0; i < 4; i++) phi[a] += mu[4 * a + i] * v[i];
        }
    if (phi_v) memcpy(phi_v, mu, sizeof mu);
    if (phi_q) memcpy(phi_q, N, sizeof N);
    if (phi_t) {
        phi_t[0] = p[1] * N[2];
        phi_t[1] = 0.0;
    }
    return 0;
}

static int call_constraint(dal_kernel *k, double t, const double *q, const double *v, double *mu,
                           double *N)
{
    k->stats.constraint_calls++;
    return constraint(t, q, v, NULL, mu, N, NULL, k->constraint_ctx);
}

static int call_potential(dal_kernel *k, double t, const double *q, double *V_q)
{
    k->stats.potential_calls++;
    return potential(t, q, NULL, V_q, NULL, k->potential_ctx);
}

#define EDGE_PATTERN \
    {0x8421ULL, 0xf7ULL, 0xf7ULL, 0xd4ULL, 0xfULL, 0x7ULL, 0x0ULL, 0, 0, 0, 0}

#define DAL_N 4
#define DAL_M 2
#define DAL_KERNEL edge_step
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) call_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) call_potential(k, t, q, V_q)
#define DAL_KERNEL_PATTERN EDGE_PATTERN
#define DAL_KERNEL_STEADY 0
#include "dalembert/kernel.h"

#ifdef __GNUC__
#define DAL_LANES(name) name##_edge
#define DAL_LANES_VECTOR 2
#include "dalembert/lanes.h"

DAL_LANES_EACH(sin)
DAL_LANES_EACH(cos)

DAL_KERNEL_INLINE void DAL_LANES(pull)(dal_vec t, const dal_vec *q, dal_vec *V_q, const dal_vec *p)
{
    EDGE_PULL(DAL_LANES(sin), DAL_LANES(cos), DAL_LANES(all_of));
    V_q[3] = DAL_LANES(all_of)(0.0);
}

DAL_KERNEL_INLINE void DAL_LANES(forms)(dal_vec t, const dal_vec *q, const dal_vec *v, dal_vec *mu,
                                        dal_vec *N, const dal_vec *p)
{
    if (mu) {
        EDGE_ROWS(DAL_LANES(sin), DAL_LANES(cos), DAL_LANES(all_of), DAL_LANES(choose));
    }
    if (N) {
        EDGE_SLOPES(DAL_LANES(sin), DAL_LANES(cos), DAL_LANES(all_of));
    }
}

#define DAL_N 4
#define DAL_M 2
#define DAL_LANES_PATTERN EDGE_PATTERN
#define DAL_LANES_STEADY 0
#define DAL_LANES_CONSTRAINT(t, q, v, phi, mu, N, u, p) DAL_LANES(forms)(t, q, v, mu, N, p)
#define DAL_LANES_FORCE(t, q, V_q, u, p) DAL_LANES(pull)(t, q, V_q, p)
#include "dalembert/lanes.h"

static const dal_lanes_routine routines[] = {{2, 4, 0, advance_edge}, {0, 0, 0, NULL}};
#else
static const dal_lanes_routine routines[] = {{0, 0, 0, NULL}};
#endif

static const dal_compiled compiled = {DAL_COMPILED_ABI, sizeof(dal_kernel), edge_step, 0, 0,
                                      routines, NULL};

enum { LANES = 2 * DAL_LANES_INTERLEAVED, SIZE = 8, STEPS = 200 };

static const double masses[][4] = {{2.0, 2.0, 0.75, 1.0}, {1.0, 1.5, 0.5, 0.25}};

/* A member, with parameters, masses, step, time and state of its own. */
typedef struct one {
    dal_system *system;
    dal_stepper *stepper;
} one;

static one open_member(const dal_scheme *scheme, size_t i, double h, double wall)
{
    edge p = {.slope = 1.0 + 0.1 * (double)i, .turn = 0.2 * (double)i, .reach = 0.5, .wall = wall};
    double mass[16] = {0.0}, x[SIZE] = {0.1 * (double)i, -0.2, 0.3 + 0.2 * (double)i, 0.4,
                                        0.5, 0.1, 1.2, -0.3};
    for (int k = 0; k < 4; k++) mass[5 * k] = masses[i % 2][k];
    const dal_system_def def = {.n = 4, .m = 2, .mass = mass, .potential = potential,
                                .constraint = constraint, .ctx = &p, .ctx_size = sizeof p,
                                .time_dependent = 1, .compiled = &compiled};
    one made = {0};
    made.system = new_system(&def);
    made.stepper = open_stepper(made.system, scheme, NULL);
    const double t0 = 0.5 * (double)i;
    dal_mechanics *const mech = &made.stepper->mech;
    need(dal_project(mech, t0, 0.0, x, NULL), "project", mech->error.text);
    need(dal_stepper_start(made.stepper, t0, h * (1.0 + 0.1 * (double)i), x, DAL_CHECK,
                           DAL_INITIAL_NONE), "start", dal_stepper_error(made.stepper)->text);
    return made;
}

/* Everything that the next step depends on, and the statistics; but the number of the system. */
static bool are_alike(dal_stepper *a, dal_stepper *b)
{
    enum { MOST = 128, IDENTITY = 3 };
    double one_state[MOST], other[MOST];
    const size_t count = dal_stepper_saved(a);
    if (count > MOST || dal_stepper_saved(b) != count) return false;
    if (dal_stepper_save(a, one_state) || dal_stepper_save(b, other)) return false;
    one_state[IDENTITY] = other[IDENTITY];
    return memcmp(one_state, other, count * sizeof *other) == 0
        && memcmp(a->motion.impulse, b->motion.impulse, 2 * sizeof *other) == 0;
}

static const char *const names[] = {"explicit", "midpoint", "endpoint", "0.3", "leapfrog",
                                    "leapfrog-mirror", "leapfrog-kl8", "midpoint-suzuki4",
                                    "leapfrog-yoshida4"};

/* Lanes in any order, some of them empty, in one call or in several. */
static void test_same_bits(size_t loaded, size_t shift, double h)
{
    for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        one alone[LANES], member[LANES], other = open_member(&scheme, 3, h, INFINITY);
        for (size_t i = 0; i < LANES; i++) {
            alone[i] = open_member(&scheme, i, h, INFINITY);
            member[i] = open_member(&scheme, i, h, INFINITY);
        }
        dal__lanes *lanes;
        CHECK(dal__lanes_width(member[0].system, &scheme) == LANES);
        CHECK(dal__lanes_new(&lanes, member[0].stepper, NULL) == 0);
        for (size_t i = 0; i < loaded; i++)
            dal__lanes_load(lanes, (i + shift) % LANES, member[i].stepper);
        for (size_t part = 0; part < 4; part++) dal__lanes_advance(lanes, STEPS / 4);
        for (size_t i = 0; i < loaded; i++) {
            const size_t lane = (i + shift) % LANES;
            double x[SIZE], impulse[2];
            size_t done;
            const size_t made = dal__lanes_made(lanes, lane);
            CHECK(dal_advance(alone[i].stepper, made, NULL, &done) == 0 && done == made);
            dal__lanes_state(lanes, lane, x);
            dal__lanes_impulse(lanes, lane, impulse);
            CHECK(memcmp(x, dal_stepper_state(alone[i].stepper), sizeof x) == 0);
            CHECK(memcmp(impulse, alone[i].stepper->motion.impulse, sizeof impulse) == 0);
            const double largest = alone[i].stepper->guards.rank.range[1];
            /* the energy is not looked at where time plays a part, so all of it is there */
            dal__lanes_unload(lanes, lane, member[i].stepper);
            CHECK(are_alike(member[i].stepper, alone[i].stepper));
            /* into a stepper that was another one: the state, though not the parameters */
            dal__lanes_unload(lanes, lane, other.stepper);
            CHECK(are_alike(other.stepper, alone[i].stepper));
            CHECK(dal_advance(alone[i].stepper, 50, NULL, NULL)
                  == dal_advance(member[i].stepper, 50, NULL, NULL));
            CHECK(are_alike(member[i].stepper, alone[i].stepper));
            /* it stops only where C is looked at */
            CHECK(h > 0.5 || made == STEPS || largest != alone[i].stepper->guards.rank.range[1]);
        }
        dal__lanes_free(lanes);
        for (size_t i = 0; i < LANES; i++) {
        }
    }
}

/* A lane that comes to where its constraint is no number, or whose step is far too large, stops
 * before that step, and its neighbours go on as if it were not there. */
static void test_stopped(void)
{
    for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        one alone = open_member(&scheme, 0, 0.02, INFINITY);
        one member[LANES] = {open_member(&scheme, 0, 0.02, INFINITY),
                             open_member(&scheme, 0, 0.02, 0.3),
                             open_member(&scheme, 1, 400.0, INFINITY),
                             open_member(&scheme, 2, 0.02, 0.25)};
        dal__lanes *lanes;
        CHECK(dal__lanes_new(&lanes, member[0].stepper, NULL) == 0);
        for (size_t i = 0; i < LANES; i++) dal__lanes_load(lanes, i, member[i].stepper);
        dal__lanes_advance(lanes, STEPS);
        CHECK(dal__lanes_made(lanes, 0) == STEPS);
        CHECK(dal_advance(alone.stepper, STEPS, NULL, NULL) == 0);
        dal__lanes_unload(lanes, 0, member[0].stepper);
        CHECK(are_alike(alone.stepper, member[0].stepper));
        for (size_t i = 1; i < LANES; i++) {
            size_t done, made = dal__lanes_made(lanes, i);
            double x[SIZE], begun[SIZE];
            dal__lanes_state(lanes, i, begun);
            dal__lanes_advance(lanes, 5); /* it stays where it is */
            dal__lanes_state(lanes, i, x);
            CHECK(dal__lanes_made(lanes, i) == made && memcmp(x, begun, sizeof x) == 0);
            if (i == 2) continue;
            /* the scalar routine finds the same: it cannot make the next step */
            const int status = dal_advance(member[i].stepper, STEPS, NULL, &done);
            CHECK(status != 0 && done == made && made < STEPS);
            CHECK(memcmp(x, dal_stepper_state(member[i].stepper), sizeof x) == 0);
        }
        dal__lanes_free(lanes);
    }
}

/* What a lane was before does not matter; impulses are forgotten when that is asked for. */
static void test_again(void)
{
    const dal_scheme scheme = find_scheme("midpoint");
    one alone = open_member(&scheme, 1, 0.02, INFINITY);
    one member = open_member(&scheme, 1, 0.02, INFINITY);
    one gone = open_member(&scheme, 3, 0.02, 0.31);
    dal__lanes *lanes;
    double impulse[2], reaction[2];
    CHECK(dal__lanes_new(&lanes, member.stepper, NULL) == 0);
    for (size_t i = 0; i < LANES; i++) dal__lanes_load(lanes, i, gone.stepper);
    dal__lanes_advance(lanes, STEPS);
    CHECK(dal__lanes_made(lanes, 1) < STEPS);
    dal__lanes_stop(lanes);
    CHECK(dal_advance(member.stepper, 10, NULL, NULL) == 0);
    dal__lanes_load(lanes, 1, member.stepper);
    CHECK(dal__lanes_made(lanes, 1) == 0);
    dal__lanes_advance(lanes, 10);
    for (size_t i = 0; i < LANES; i++) dal__lanes_forget_impulse(lanes, i);
    dal__lanes_advance(lanes, 20);
    CHECK(dal__lanes_made(lanes, 1) == 30 && dal__lanes_made(lanes, 0) < STEPS);
    dal__lanes_impulse(lanes, 1, impulse);
    CHECK(dal_advance(alone.stepper, 20, NULL, NULL) == 0);
    CHECK(dal_advance(alone.stepper, 20, reaction, NULL) == 0);
    CHECK(memcmp(impulse, alone.stepper->motion.impulse, sizeof impulse) == 0);
    dal__lanes_unload(lanes, 1, member.stepper);
    CHECK(are_alike(alone.stepper, member.stepper));
    CHECK(dal_stepper_time(member.stepper) == dal_stepper_time(alone.stepper));
    /* with what only the stepper knew that was loaded */
    member.stepper->energy_jump.energy = 7.0;
    member.stepper->mech.eval.calls.constraint = 3;
    dal__lanes_load(lanes, 2, member.stepper);
    dal__lanes_unload(lanes, 2, gone.stepper);
    CHECK(gone.stepper->energy_jump.energy == 7.0);
    CHECK(gone.stepper->mech.eval.calls.constraint == 3);
    dal__lanes_stop(lanes);
    dal__lanes_advance(lanes, 20);
    CHECK(dal__lanes_made(lanes, 1) == 30);
    CHECK(dal__lanes_use(lanes, 2) == LANES && dal__lanes_use(lanes, 3) == 0);
    dal__lanes_free(lanes);
    dal__lanes_free(NULL);
}

/* Who has none: systems that were not compiled so, kept nodes, other families, and parameters that
 * are not there. */
static void test_none(void)
{
    const dal_scheme midpoint = find_scheme("midpoint"), kept = find_scheme("midpoint-nodes");
    const dal_scheme flow = find_scheme("reference");
    one member = open_member(&midpoint, 0, 0.02, INFINITY);
    dal_system *system = NULL, *short_of = NULL;
    dal_error error;
    CHECK(dal__lanes_width(member.system, &kept) == 0);
    CHECK(dal__lanes_width(member.system, &flow) == 0);
    system = open_system("sleigh");
    CHECK(dal__lanes_width(system, &midpoint) == 0);
    dal_stepper *const stepper = open_stepper(system, &midpoint, NULL);
    dal__lanes *lanes = NULL;
    CHECK(dal__lanes_new(&lanes, stepper, &error) == DAL_EUNSUPPORTED && !lanes);
    CHECK(strstr(error.text, "midpoint") != NULL);
    edge p = {.slope = 1.0};
    dal_system_def def = member.system->def;
    def.ctx = &p;
    def.ctx_size = sizeof p - sizeof(double);
    short_of = new_system(&def);
    CHECK(dal__lanes_width(short_of, &midpoint) == 0);
}

int main(void)
{
    if (routines[0].vector == 0) return 77; /* to meson: skipped */
    test_same_bits(LANES, 0, 0.02);
    test_same_bits(LANES - 1, 3, 0.05);
    test_same_bits(1, 1, 0.02);
    test_same_bits(LANES, 2, 1.5);
    test_stopped();
    test_again();
    test_none();
    return check_done();
}
