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
    dal_lanes_layout places; /* of the numbers of a lane */
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
    if (routine->inputs != system->def.inputs) return NULL;
    while (routine->vector > 0 && !(runs(routine) && (vector == 0 || routine->vector == vector)))
        routine++;
    return routine->vector > 0 ? routine : NULL;
}

size_t dal__lanes_width(const dal_system *system, const dal_scheme *scheme)
{
    const bool moved = scheme->nodes == DAL_MOVED_NODES && !scheme->family;
    const dal_lanes_routine *const routine = moved ? find_routine(system, 0) : NULL;
    return routine ? DAL_LANES_INTERLEAVED * routine->vector : 0;
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
    const size_t n = k->n, m = k->m, kinds = k->kinds;
    const bool momenta = dal__has_momenta(system);
    dal__lanes shape = {.system = system, .routine = routine, .n = n, .m = m, .width = width,
                        .places = dal_lanes_layout_of(n, m, momenta, kinds, routine->parameters,
                                                      routine->inputs)};
    shape.block = (dal_lanes_block){.stages = k->stages, .plain = k->plain,
                                    .constant_rate = k->constant_rate,
                                    .steady = k->steady, .momenta = momenta, .kinds = kinds,
                                    .parameters = routine->parameters, .inputs = routine->inputs};
    dal__lanes *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__reserve(&memory, &shape.stage, k->stages, sizeof *shape.stage);
    dal__reserve(&memory, &shape.member, width, sizeof *shape.member);
    DAL__RESERVE(&memory, dal__times(m, width), &shape.largest);
    DAL__RESERVE(&memory, dal__times(shape.places.count, width), &shape.block.numbers,
                 &shape.block.saved);
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
    lanes->width = DAL_LANES_INTERLEAVED * routine->vector;
    for (size_t lane = 0; lane < lanes->width; lane++) lanes->member[lane].loaded = false;
    dal__lanes_stop(lanes);
    return lanes->width;
}

/* ---- numbers of a lane ------------------------------------------------------------------ */

/* Number i of a lane. */
static double *at(const dal__lanes *lanes, size_t lane, size_t i)
{
    const size_t vector = lanes->routine->vector;
    return lanes->block.numbers + (lane / vector * lanes->places.count + i) * vector
         + lane % vector;
}

/* Numbers from number i on, count of them. */
static void write(const dal__lanes *lanes, size_t lane, size_t i, size_t count, const double *from)
{
    for (size_t k = 0; k < count; k++) *at(lanes, lane, i + k) = from[k];
}

static void read(const dal__lanes *lanes, size_t lane, size_t i, size_t count, double *to)
{
    for (size_t k = 0; k < count; k++) to[k] = *at(lanes, lane, i + k);
}

/* ---- members ---------------------------------------------------------------------------- */

/* The values that stages with momenta pass from step to step. */
static void put_momenta(const dal__lanes *lanes, size_t lane, const dal_kernel *k)
{
    const dal_lanes_layout *const to = &lanes->places;
    const size_t n = lanes->n;
    *at(lanes, lane, to->carried) = k->carried;
    *at(lanes, lane, to->latest_span) = k->latest_span;
    write(lanes, lane, to->momentum, n, k->momentum);
    write(lanes, lane, to->latest, lanes->m, k->latest);
    write(lanes, lane, to->history, 4 * n * k->kinds, k->history);
    for (size_t i = 0; i < k->kinds; i++) *at(lanes, lane, to->known + i) = k->known[i];
}

static void take_momenta(const dal__lanes *lanes, size_t lane, dal_kernel *k)
{
    const dal_lanes_layout *const from = &lanes->places;
    const size_t n = lanes->n;
    k->carried = *at(lanes, lane, from->carried) != 0.0;
    k->latest_span = *at(lanes, lane, from->latest_span);
    read(lanes, lane, from->momentum, n, k->momentum);
    read(lanes, lane, from->latest, lanes->m, k->latest);
    read(lanes, lane, from->history, 4 * n * k->kinds, k->history);
    for (size_t i = 0; i < k->kinds; i++)
        k->known[i] = (unsigned char)*at(lanes, lane, from->known + i);
}

static void put(dal__lanes *lanes, size_t lane, const dal_stepper *stepper)
{
    const dal_kernel *const k = dal__beta_kernel(stepper);
    const dal_lanes_layout *const to = &lanes->places;
    const size_t n = lanes->n;
    for (size_t i = to->going; i < to->x; i++) *at(lanes, lane, i) = 0.0;
    *at(lanes, lane, to->t0) = k->t0;
    *at(lanes, lane, to->h) = k->h;
    write(lanes, lane, to->range, 2, k->range);
    if (k->mass_inverse) {
        write(lanes, lane, to->mass_inverse, n * n, k->mass_inverse);
        write(lanes, lane, to->unit, n, k->unit);
        write(lanes, lane, to->per_unit, n, k->per_unit);
    }
    if (k->mass_inverse && lanes->block.momenta) write(lanes, lane, to->mass, n * n, k->mass);
    write(lanes, lane, to->inputs, lanes->block.inputs, k->input);
    write(lanes, lane, to->parameters, lanes->block.parameters, stepper->motion.system->def.ctx);
    *at(lanes, lane, to->history_known) = k->history_known;
    *at(lanes, lane, to->forced) = k->forced;
    *at(lanes, lane, to->number) = (double)stepper->motion.steps;
    *at(lanes, lane, to->worst) = k->stats.worst_residual;
    write(lanes, lane, to->x, 2 * n, k->at.x);
    write(lanes, lane, to->dv_history, 3 * n, k->at.dv_history);
    write(lanes, lane, to->residue, 2 * n, k->at.residue);
    if (k->forced) write(lanes, lane, to->force, n, k->force0);
    write(lanes, lane, to->impulse, lanes->m, k->impulse);
    if (lanes->block.momenta) put_momenta(lanes, lane, k);
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
    *at(lanes, lane, lanes->places.going) = 1.0;
}

void dal__lanes_stop(dal__lanes *lanes)
{
    for (size_t lane = 0; lane < lanes->width; lane++)
        *at(lanes, lane, lanes->places.going) = 0.0;
}

void dal__lanes_advance(dal__lanes *lanes, size_t steps)
{
    lanes->routine->advance(&lanes->block, steps);
}

static size_t counter(const dal__lanes *lanes, size_t lane, size_t i)
{
    return (size_t)*at(lanes, lane, i);
}

size_t dal__lanes_made(const dal__lanes *lanes, size_t lane)
{
    return counter(lanes, lane, lanes->places.number) - lanes->member[lane].begin;
}

void dal__lanes_state(const dal__lanes *lanes, size_t lane, double *x)
{
    read(lanes, lane, lanes->places.x, 2 * lanes->n, x);
}

void dal__lanes_impulse(const dal__lanes *lanes, size_t lane, double *impulse)
{
    read(lanes, lane, lanes->places.impulse, lanes->m, impulse);
}

void dal__lanes_forget_impulse(dal__lanes *lanes, size_t lane)
{
    for (size_t a = 0; a < lanes->m; a++) *at(lanes, lane, lanes->places.impulse + a) = 0.0;
}

void dal__lanes_unload(const dal__lanes *lanes, size_t lane, dal_stepper *stepper)
{
    const member *const self = &lanes->member[lane];
    const dal_lanes_layout *const from = &lanes->places;
    const size_t n = lanes->n;
    const dal_system_def *const def = &lanes->system->def;
    dal_motion *const motion = &stepper->motion;
    dal_kernel *const k = dal__beta_kernel(stepper);
    k->stats = self->stats;
    motion->steps = counter(lanes, lane, lanes->places.number);
    read(lanes, lane, from->inputs, lanes->block.inputs,
         stepper->mech.eval.own_input);
    k->stats.worst_residual = *at(lanes, lane, from->worst);
    k->stats.iterations += counter(lanes, lane, from->counts + DAL_LANES_ITERATIONS);
    k->stats.constraint_calls += counter(lanes, lane, from->counts + DAL_LANES_CONSTRAINTS);
    const size_t calls = counter(lanes, lane, from->counts + DAL_LANES_FORCES);
    if (def->potential) k->stats.potential_calls += calls;
    if (def->force) k->stats.force_calls += calls;
    if (def->lagrangian) k->stats.lagrangian_calls += calls;
    stepper->mech.eval.calls = self->calls;
    stepper->energy_jump = self->energy_jump;
    dal__rank_copy(lanes->m, &self->rank, &stepper->guards.rank);
    stepper->started = true;
    dal__estimate_forget(stepper);
    k->t0 = motion->t0 = *at(lanes, lane, from->t0);
    k->h = motion->h = *at(lanes, lane, from->h);
    read(lanes, lane, from->range, 2, k->range);
    dal_kernel_forget(k);
    k->history_known = *at(lanes, lane, from->history_known) != 0.0;
    dal__beta_take_inputs(stepper);
    k->forced = *at(lanes, lane, from->forced) != 0.0;
    read(lanes, lane, from->x, 2 * n, k->at.x);
    read(lanes, lane, from->dv_history, 3 * n, k->at.dv_history);
    read(lanes, lane, from->residue, 2 * n, k->at.residue);
    read(lanes, lane, from->force, n, k->force0);
    dal__lanes_impulse(lanes, lane, k->impulse);
    if (lanes->block.momenta) take_momenta(lanes, lane, k);
}
