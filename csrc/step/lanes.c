/* Members of an ensemble side by side: what a stepper is, put into a lane and taken out again. */
#include "step/lanes.h"

#include "dalembert/lanes.h"
#include "step/beta.h"
#include "step/stepper.h"

#include <string.h>

/* What a stepper has beside the numbers that the step routine changes. */
typedef struct member {
    bool loaded;
    size_t begin;    /* number of its next step then */
    dal_stats stats;
    dal__calls calls; /* of its evaluator */
    dal__energy_jump energy_jump;
    dal__rank rank;
} member;

struct dal__lanes {
    const dal_system *system;
    const dal_lanes_routine *routine;
    dal_lanes_block block;
    dal_stage *stage;
    size_t n, m, width;
    size_t given, carried; /* vectors of a block */
    member *member;        /* [width] */
    double *largest;       /* [width*m] of their ranks */
    arena arena;
};

/* Whether this machine has the instructions of a routine. */
static bool runs(const dal_lanes_routine *routine)
{
#if defined(__x86_64__) && defined(__GNUC__)
    if (routine->vector == 8)
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq");
    if (routine->vector == 4) return __builtin_cpu_supports("avx2");
#endif
    return routine->vector == 2;
}

/* The one with so many lanes in a vector, or for 0 with the most; NULL if there is none.  What it
 * takes for parameters has to be there. */
static const dal_lanes_routine *find_routine(const dal_system *system, size_t vector)
{
    const dal_compiled *const compiled = system->def.compiled;
    const dal_lanes_routine *routine = compiled ? compiled->lanes : NULL;
    if (!routine || system->ctx_size < routine->parameters * sizeof(double)) return NULL;
    while (routine->vector > 0 && !(runs(routine) && (vector == 0 || routine->vector == vector)))
        routine++;
    return routine->vector > 0 ? routine : NULL;
}

size_t dal__lanes_width(const dal_system *system, const dal_scheme *scheme)
{
    const bool moved = scheme->nodes == DAL_MOVED_NODES && !scheme->family;
    const dal_lanes_routine *const routine = moved ? find_routine(system, 0) : NULL;
    return routine ? DAL_LANES_TURNS * routine->vector : 0;
}

int dal__lanes_new(dal__lanes **lanes, const dal_stepper *like, dal_error *error)
{
    const dal_system *const system = like->motion.system;
    const size_t width = dal__lanes_width(system, &like->scheme);
    const dal_kernel *const k = dal__beta_kernel(like);
    if (width == 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" has no vector routine for this "
                         "system", like->scheme.name);
    const dal_lanes_routine *const routine = find_routine(system, 0);
    const size_t n = k->n, m = k->m, rows = m > 0 ? m : 1, parameters = routine->parameters;
    dal__lanes shape = {.system = system, .routine = routine, .n = n, .m = m, .width = width,
                        .given = 4 + n * n + 2 * n + parameters,
                        .carried = DAL_LANES_X + 8 * n + rows};
    shape.block = (dal_lanes_block){.stages = k->stages, .plain = k->plain,
                                    .steady = k->steady != 0, .parameters = parameters};
    dal__lanes *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__reserve(&memory, &shape.stage, k->stages, sizeof *shape.stage);
    dal__reserve(&memory, &shape.member, width, sizeof *shape.member);
    DAL__RESERVE(&memory, dal__times(m, width), &shape.largest);
    DAL__RESERVE(&memory, dal__times(shape.given, width), &shape.block.given);
    DAL__RESERVE(&memory, dal__times(shape.carried, width), &shape.block.carried);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    /* the slots that the arena has filled are those of shape */
    *self = shape;
    self->arena = memory;
    memcpy(self->stage, k->stage, k->stages * sizeof *k->stage);
    self->block.stage = self->stage;
    *lanes = self;
    return DAL_SUCCESS;
}

void dal__lanes_free(dal__lanes *lanes)
{
    if (!lanes) return;
    dal__release(&lanes->arena);
}

size_t dal__lanes_use(dal__lanes *lanes, size_t vector)
{
    const dal_lanes_routine *const routine = find_routine(lanes->system, vector);
    if (!routine) return 0;
    lanes->routine = routine; /* the memory is for the widest */
    lanes->width = DAL_LANES_TURNS * routine->vector;
    for (size_t lane = 0; lane < lanes->width; lane++) lanes->member[lane].loaded = false;
    dal__lanes_stop(lanes);
    return lanes->width;
}

/* ---- numbers of a lane ------------------------------------------------------------------ */

/* Number i of a lane, of arrays of so many vectors. */
static double *at(const dal__lanes *lanes, double *values, size_t vectors, size_t lane, size_t i)
{
    const size_t vector = lanes->routine->vector;
    return values + (lane / vector * vectors + i) * vector + lane % vector;
}

static double *given(const dal__lanes *lanes, size_t lane, size_t i)
{
    return at(lanes, lanes->block.given, lanes->given, lane, i);
}

static double *carried(const dal__lanes *lanes, size_t lane, size_t i)
{
    return at(lanes, lanes->block.carried, lanes->carried, lane, i);
}

/* Numbers from number i on, count of them. */
static void give(const dal__lanes *lanes, size_t lane, size_t i, size_t count, const double *from)
{
    for (size_t k = 0; k < count; k++) *given(lanes, lane, i + k) = from[k];
}

static void write(const dal__lanes *lanes, size_t lane, size_t i, size_t count, const double *from)
{
    for (size_t k = 0; k < count; k++) *carried(lanes, lane, i + k) = from[k];
}

static void read(const dal__lanes *lanes, size_t lane, size_t i, size_t count, double *to)
{
    for (size_t k = 0; k < count; k++) to[k] = *carried(lanes, lane, i + k);
}

/* ---- members ---------------------------------------------------------------------------- */

static void put(dal__lanes *lanes, size_t lane, const dal_stepper *stepper)
{
    const dal_kernel *const k = dal__beta_kernel(stepper);
    const size_t n = lanes->n, nn = n * n, force = DAL_LANES_X + 7 * n;
    const double first[] = {k->t0, k->h, k->range[0], k->range[1]};
    const double begin[DAL_LANES_X] = {
        [DAL_LANES_PULLED] = k->pulled, [DAL_LANES_FORCED] = k->forced,
        [DAL_LANES_NUMBER] = (double)stepper->motion.steps,
        [DAL_LANES_WORST] = k->stats.worst_residual};
    give(lanes, lane, 0, 4, first);
    give(lanes, lane, 4, nn, k->mass_inverse);
    give(lanes, lane, 4 + nn, n, k->unit);
    give(lanes, lane, 4 + nn + n, n, k->per_unit);
    give(lanes, lane, 4 + nn + 2 * n, lanes->block.parameters, stepper->motion.system->def.ctx);
    write(lanes, lane, 0, DAL_LANES_X, begin);
    write(lanes, lane, DAL_LANES_X, 2 * n, k->at.x);
    write(lanes, lane, DAL_LANES_X + 2 * n, 5 * n, k->at.pull); /* and low */
    if (k->forced) write(lanes, lane, force, n, k->force0);
    write(lanes, lane, force + n, lanes->m, k->impulse);
}

void dal__lanes_load(dal__lanes *lanes, size_t lane, const dal_stepper *stepper)
{
    member *const self = &lanes->member[lane];
    /* what empty lanes compute is as quick as the rest, and not of numbers that are none */
    for (size_t other = 0; other < lanes->width; other++)
        if (!lanes->member[other].loaded) put(lanes, other, stepper);
    put(lanes, lane, stepper);
    *self = (member){.loaded = true, .begin = stepper->motion.steps,
                     .stats = dal__beta_kernel(stepper)->stats,
                     .calls = stepper->mech.eval.calls, .energy_jump = stepper->energy_jump,
                     .rank.largest = lanes->largest + lane * lanes->m};
    dal__rank_copy(lanes->m, &stepper->guards.rank, &self->rank);
    *carried(lanes, lane, DAL_LANES_GOING) = 1.0;
}

void dal__lanes_stop(dal__lanes *lanes)
{
    for (size_t lane = 0; lane < lanes->width; lane++)
        *carried(lanes, lane, DAL_LANES_GOING) = 0.0;
}

void dal__lanes_advance(dal__lanes *lanes, size_t steps)
{
    lanes->routine->advance(&lanes->block, steps);
}

static size_t counter(const dal__lanes *lanes, size_t lane, size_t i)
{
    return (size_t)*carried(lanes, lane, i);
}

size_t dal__lanes_made(const dal__lanes *lanes, size_t lane)
{
    return counter(lanes, lane, DAL_LANES_NUMBER) - lanes->member[lane].begin;
}

void dal__lanes_state(const dal__lanes *lanes, size_t lane, double *x)
{
    read(lanes, lane, DAL_LANES_X, 2 * lanes->n, x);
}

void dal__lanes_impulse(const dal__lanes *lanes, size_t lane, double *impulse)
{
    read(lanes, lane, DAL_LANES_X + 8 * lanes->n, lanes->m, impulse);
}

void dal__lanes_forget_impulses(dal__lanes *lanes)
{
    for (size_t lane = 0; lane < lanes->width; lane++)
        for (size_t a = 0; a < lanes->m; a++)
            *carried(lanes, lane, DAL_LANES_X + 8 * lanes->n + a) = 0.0;
}

void dal__lanes_unload(const dal__lanes *lanes, size_t lane, dal_stepper *stepper)
{
    const member *const self = &lanes->member[lane];
    const size_t n = lanes->n;
    const dal_system_def *const def = &lanes->system->def;
    dal_motion *const motion = &stepper->motion;
    dal_kernel *const k = dal__beta_kernel(stepper);
    k->stats = self->stats;
    motion->steps = counter(lanes, lane, DAL_LANES_NUMBER);
    k->stats.worst_residual = *carried(lanes, lane, DAL_LANES_WORST);
    k->stats.iterations += counter(lanes, lane, DAL_LANES_ITERATIONS);
    k->stats.constraint_calls += counter(lanes, lane, DAL_LANES_CONSTRAINT_CALLS);
    const size_t calls = counter(lanes, lane, DAL_LANES_PULL_CALLS);
    if (def->potential) k->stats.potential_calls += calls;
    if (def->force) k->stats.force_calls += calls;
    stepper->mech.eval.calls = self->calls;
    stepper->energy_jump = self->energy_jump;
    dal__rank_copy(lanes->m, &self->rank, &stepper->guards.rank);
    stepper->started = true;
    dal__estimate_forget(stepper);
    k->t0 = motion->t0 = *given(lanes, lane, 0);
    k->h = motion->h = *given(lanes, lane, 1);
    k->range[0] = *given(lanes, lane, 2);
    k->range[1] = *given(lanes, lane, 3);
    dal_kernel_forget(k);
    k->pulled = *carried(lanes, lane, DAL_LANES_PULLED) != 0.0;
    k->forced = *carried(lanes, lane, DAL_LANES_FORCED) != 0.0;
    read(lanes, lane, DAL_LANES_X, 2 * n, k->at.x);
    read(lanes, lane, DAL_LANES_X + 2 * n, 5 * n, k->at.pull); /* and low */
    read(lanes, lane, DAL_LANES_X + 7 * n, n, k->force0);
    dal__lanes_impulse(lanes, lane, k->impulse);
}
