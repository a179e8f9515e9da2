/* The family beta: beta-schemes one after the other (DAELd1, DAELd2, Facil), by the step routine of
 * kernel.h where the mass is constant, the constraints are linear and there is no force; by the
 * full Newton iteration else. */
#include "step/beta.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

typedef struct beta {
    dal_kernel kernel;
    dal_kernel_fn advance; /* the compilation of the step routine, or NULL: newton */
    newton newton;
    size_t substeps;
    dal_substep *substep;
    dal_stage *stage;
    dal_motion *motion;
    double *scratch; /* [2n] of finish */
    arena arena;
} beta;

/* A record as stages: one for each sub-step, but a pair (0, a), (1, b), a + b not 0, is one (see
 * kernel.h). */
static size_t plan_stages(const dal_substep *substep, size_t count, dal_stage *stage)
{
    size_t stages = 0;
    double passed = 0.0; /* of the step */
    for (size_t j = 0; j < count; j++) {
        const double beta = substep[j].beta, f = substep[j].fraction;
        const bool pair = j + 1 < count && beta == 0.0 && substep[j + 1].beta == 1.0
                          && f + substep[j + 1].fraction != 0.0;
        const double g = pair ? substep[++j].fraction : 0.0;
        dal_stage s = {.before = (1.0 - beta) * f, .after = beta * f + g, .span = f + g};
        if (beta == 0.0) {
            s.node = f + g;
        } else {
            s.start = beta * f;
            s.end = (1.0 - beta) * f;
        }
        s.t_start = passed;
        s.t_end = passed = j + 1 < count ? passed + s.span : 1.0;
        s.linear = s.after == 0.0;
        s.t_node = s.linear ? s.t_end : s.t_start + s.before;
        stage[stages++] = s;
    }
    for (size_t j = 0; j < stages; j++)
        stage[j].reuse = fmax(fabs(stage[j].end), fabs(stage[(j + 1) % stages].start));
    return stages;
}

/* Weights of the parabola through the values at times t[0..2] at the time t; where these lie too
 * close together to extrapolate (compositions go back and forth), of the line through the last two,
 * or the last value. */
static void extrapolate(const double times[3], double t, double weight[3])
{
    const double most = 10.0;
    const double a = t - times[0], b = t - times[1], c = t - times[2];
    const double ab = times[0] - times[1], ac = times[0] - times[2], bc = times[1] - times[2];
    const double parabola[3] = {b / ab * (c / ac), -a / ab * (c / bc), a / ac * (b / bc)};
    const double line[3] = {b / ab, -a / ab, 0.0}, last[3] = {1.0, 0.0, 0.0};
    const double *const choice[3] = {parabola, line, last};
    for (int i = 0; i < 3; i++) {
        memcpy(weight, choice[i], 3 * sizeof *weight);
        if (fabs(weight[0]) + fabs(weight[1]) + fabs(weight[2]) <= most) return;
    }
}

/* The pull of a stage, a change of velocity over its span, belongs to the time of its node. */
static void plan_predictions(dal_stage *stage, size_t stages)
{
    for (size_t j = 0; j < stages; j++) {
        double times[3], spans[3], start = 0.0; /* before the start of stage j */
        for (size_t back = 1; back <= 3; back++) {
            const dal_stage *s = stage + (j + 3 * stages - back) % stages;
            start -= s->span;
            times[back - 1] = start + s->before;
            spans[back - 1] = s->span;
        }
        extrapolate(times, stage[j].before, stage[j].ahead);
        for (int i = 0; i < 3; i++) stage[j].ahead[i] *= stage[j].span / spans[i];
    }
}

/* As finish of a dal_kernel: the stage by the full Newton iteration from the state before it; or
 * the velocity alone, into D at what is stored.  A pair is one step with V at the node. */
static int finish(dal_kernel *k, double number, const dal_stage *s, bool solved)
{
    beta *const self = (beta *)k; /* of which it is the first member */
    dal_mechanics *const mech = self->motion->mechanics;
    const size_t n = k->n, size = n * sizeof(double);
    const double t_end = dal_kernel_time(k, number, s->t_end);
    const dal_arrays *const at = &k->at;
    double *const x = self->scratch, relative = 0.0;
    int status;
    if (solved) {
        memcpy(x, at->stored, size);
        memcpy(x + n, at->w, size);
        k->stats.corrections++;
        status = dal__mend(mech, t_end, k->shift * k->h, false, x, &relative);
        k->stats.worst_residual = fmax(k->stats.worst_residual, relative);
    } else {
        const double beta = s->after / s->span, alpha = s->node != 0.0 ? 1.0 : beta;
        memcpy(x, at->x, 2 * size);
        k->stats.full_newtons++;
        dal__newton_forget(&self->newton);
        status = dal__newton_step(&self->newton, mech,
                                  dal_kernel_time(k, number, s->t_start), t_end, alpha, beta,
                                  s->span * k->h, k->kept, x, at->kappa, &k->stats);
    }
    if (!status && !dal__all_finite(n, at->base)) /* but what the same callbacks give now is */
        status = dal__fail(&mech->error, DAL_EDOMAIN, "a number is not finite; try a smaller h");
    if (status) return dal_kernel_fail(k, status, DAL_FAILED_FINISH);
    memcpy(at->stored, x, size);
    memcpy(at->w, x + n, size);
    return DAL_SUCCESS;
}

static void reserve_kernel(dal_kernel *k, size_t n, size_t m, arena *a)
{
    const size_t mn = dal__times(m, n), mm = dal__times(m, m);
    dal_arrays *const at = &k->at;
    double **const vectors[] = {&k->force0, &k->force1, &at->base, &at->goal, &at->step,
                                &at->seen, &at->stored};
    double **const multipliers[] = {&k->impulse, &at->r, &at->d, &at->kappa};
    dal__reserve(a, &at->x, dal__times(dal_kernel_shared(1, m), n), sizeof(double));
    dal__reserve(a, &k->saved, dal__times(3, n), sizeof(double)); /* m < n */
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve(a, &at->Z, mn, sizeof(double));
    dal__reserve(a, &at->S, mm, sizeof(double));
    dal__reserve(a, &at->sizes, dal__times(5, m), sizeof(double));
    dal__reserve(a, &at->row, m, sizeof(size_t));
}

/* Whether kernel.h makes its steps; those of all others are newton's. */
static bool has_step_routine(const dal_system *system)
{
    return system->mass && !system->def.force && system->def.kind == DAL_LINEAR;
}

/* Whether V, if there is one, acts at some q~ or q~'. */
static bool acts_beside_nodes(const beta *self)
{
    for (size_t j = 0; j < self->kernel.stages; j++)
        if (self->stage[j].start != 0.0 || self->stage[j].end != 0.0) return true;
    return false;
}

/* Whether the step routine knows mu(q~') before v'. */
static bool is_steady(const beta *self, const dal_system_def *def, bool kept)
{
    bool ends = false; /* V acts at some q~' */
    for (size_t j = 0; j < self->kernel.stages; j++)
        if (self->stage[j].end != 0.0) ends = true;
    return def->steady && !kept && !(def->potential && ends);
}

/* A compiled step routine has to know the system as it is: constant mass, linear constraints, no
 * force, nothing missing. */
static int check_compiled(const dal_system *system, dal_error *error)
{
    const dal_compiled *const compiled = system->def.compiled;
    if (!compiled) return DAL_SUCCESS;
    if (compiled->abi != DAL_COMPILED_ABI || compiled->size != sizeof(dal_kernel))
        return dal__fail(error, DAL_EINVAL, "compiled: its number %u and its dal_kernel of %zu "
                         "bytes are not those of this library, %u and %zu; compile it with the "
                         "kernel.h of this library", compiled->abi, compiled->size,
                         DAL_COMPILED_ABI, sizeof(dal_kernel));
    const char *const wrong = !has_step_routine(system) ? "mass, constraints or force are others"
                            : system->def.missing       ? "derivatives are missing" : NULL;
    if (!wrong) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "compiled is not NULL, and %s: a compiled step routine is "
                     "for constant mass, linear constraints, no force and nothing missing", wrong);
}

static void bind_kernel(beta *self, dal_motion *motion)
{
    const dal_system *const system = motion->system;
    const dal_scheme *const scheme = motion->scheme;
    dal_kernel *const k = &self->kernel;
    evaluator *const e = &motion->mechanics->eval;
    self->motion = motion;
    k->n = system->def.n;
    k->m = system->def.m;
    k->constraint = e->constraint;
    k->constraint_ctx = e->constraint_ctx;
    k->potential = e->potential;
    k->potential_ctx = e->potential_ctx;
    k->mass_inverse = system->mass_inverse;
    k->unit = system->unit;
    k->per_unit = system->per_unit;
    k->at.mass_inverse = k->mass_inverse;
    k->at.unit = k->unit;
    k->at.per_unit = k->per_unit;
    k->diagonal = system->diagonal;
    k->stage = self->stage;
    k->stages = plan_stages(self->substep, self->substeps, self->stage);
    plan_predictions(self->stage, k->stages);
    k->kept = scheme->nodes == DAL_KEPT_NODES;
    k->plain = !k->kept && !(k->potential && acts_beside_nodes(self));
    k->shift = k->kept ? 1.0 - self->substep[0].beta : 0.0;
    dal_kernel_share(k, k->at.x);
    k->impulse = motion->impulse;
    k->finish = finish;
    k->steady = is_steady(self, &system->def, k->kept) ? system->def.steady : 0;
    if (has_step_routine(system))
        self->advance = system->def.compiled && !k->kept ? system->def.compiled->advance
                                                         : dal__kernel_for(k->n, k->m);
    motion->x = k->at.x;
    motion->stats = &k->stats;
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_system *const system = motion->system;
    const dal_scheme *const scheme = motion->scheme;
    int status = dal__beta_check(scheme, error);
    if (!status) status = check_compiled(system, error);
    if (status) return status;
    const size_t n = system->def.n, count = dal__scheme_count(scheme);
    beta shape = {.substeps = count}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    reserve_kernel(&shape.kernel, n, system->def.m, &memory);
    dal__newton_reserve(&shape.newton, system, &memory);
    dal__reserve(&memory, &shape.substep, count, sizeof *shape.substep);
    dal__reserve(&memory, &shape.stage, count, sizeof *shape.stage);
    dal__reserve(&memory, &shape.scratch, dal__times(2, n), sizeof(double));
    status = dal__allocate(&memory, error);
    if (status) return status;
    /* the slots that the arena has filled are those of shape */
    *self = shape;
    self->arena = memory;
    for (size_t j = 0; j < count; j++) self->substep[j] = dal__scheme_substep(scheme, j);
    dal__newton_bind(&self->newton, system, motion->max_iterations);
    bind_kernel(self, motion);
    *method = self;
    return DAL_SUCCESS;
}

static void release(void *method)
{
    arena memory = ((beta *)method)->arena; /* the object lies inside it */
    dal__release(&memory);
}

static void start(void *method, dal_motion *motion)
{
    beta *const self = method;
    self->kernel.t0 = motion->t0;
    self->kernel.h = motion->h;
    dal_kernel_forget(&self->kernel);
    dal__newton_forget(&self->newton);
}

/* ---- steps ------------------------------------------------------------------------------ */

/* What went wrong in the step that failed, in words. */
static void explain(const dal_kernel *k, dal_error *error, int status)
{
    switch (k->failure.kind) {
    case DAL_FAILED_CONSTRAINT:
    case DAL_FAILED_POTENTIAL:
        dal__refuse(error, k->failure.kind == DAL_FAILED_CONSTRAINT ? "constraint" : "potential",
                    k->failure.returned);
        break;
    case DAL_FAILED_STEADY:
        dal__fail(error, status, "the system is declared steady, but mu at the end of the step is "
                  "not what it was before the reaction acted: a coordinate that mu depends on is "
                  "pushed by a reaction");
        break;
    case DAL_FAILED_FINISH: /* who failed has said why */
        break;
    }
}

/* The same records by the full Newton iteration, sub-step by sub-step. */
static int advance_by_newton(beta *self, dal_motion *motion, size_t steps, size_t *done)
{
    dal_kernel *const k = &self->kernel;
    double *const x = k->saved, *const impulse = x + 2 * k->n;
    for (*done = 0; *done < steps; ++*done) {
        double passed = 0.0; /* fraction of the step */
        memcpy(x, k->at.x, 2 * k->n * sizeof *x);
        memcpy(impulse, k->impulse, k->m * sizeof *impulse);
        for (size_t j = 0; j < self->substeps; j++) {
            const dal_substep s = self->substep[j];
            const double number = (double)(motion->steps + *done);
            const double next = j + 1 < self->substeps ? passed + s.fraction : 1.0;
            const int status =
                dal__newton_step(&self->newton, motion->mechanics,
                                 motion->t0 + (number + passed) * motion->h,
                                 motion->t0 + (number + next) * motion->h, s.beta, s.beta,
                                 s.fraction * motion->h, k->kept, x, k->at.kappa, &k->stats);
            if (status) {
                if (j > 0) dal__newton_forget(&self->newton); /* the sub-steps that are undone */
                return status;
            }
            for (size_t a = 0; a < k->m; a++) impulse[a] += k->at.kappa[a];
            passed = next;
        }
        memcpy(k->at.x, x, 2 * k->n * sizeof *x);
        memcpy(k->impulse, impulse, k->m * sizeof *impulse);
    }
    return DAL_SUCCESS;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    beta *const self = method;
    if (!self->advance) return advance_by_newton(self, motion, steps, done);
    const int status = self->advance(&self->kernel, steps, done);
    if (status) explain(&self->kernel, motion->error, status);
    return status;
}

/* The predictor of the step routine: the pulls and V_q of the last stages; or that of newton.  What
 * the flags call unknown is 0: a step that failed may have left anything there. */
static size_t save(const void *method, double *values)
{
    const beta *const self = method;
    const dal_kernel *const k = &self->kernel;
    if (!self->advance) return dal__newton_save(&self->newton, values);
    if (!values) return 2 + 4 * k->n;
    values[0] = k->pulled;
    values[1] = k->forced;
    memcpy(values + 2, k->at.pull, 3 * k->n * sizeof *values);
    for (size_t i = 0; i < k->n; i++) values[2 + 3 * k->n + i] = k->forced ? k->force0[i] : 0.0;
    return 2 + 4 * k->n;
}

static int accepts(const void *method, const double *values)
{
    const bool has_two_flags = ((const beta *)method)->advance;
    return (values[0] == 0.0 || values[0] == 1.0)
        && (!has_two_flags || values[1] == 0.0 || values[1] == 1.0);
}

static void restore(void *method, const double *values)
{
    beta *const self = method;
    dal_kernel *const k = &self->kernel;
    if (!self->advance) {
        dal__newton_restore(&self->newton, values);
        return;
    }
    k->pulled = values[0] != 0.0;
    k->forced = values[1] != 0.0;
    memcpy(k->at.pull, values + 2, 3 * k->n * sizeof *values);
    memcpy(k->force0, values + 2 + 3 * k->n, k->n * sizeof *values);
}

void dal__beta_any_sizes(dal_stepper *stepper)
{
    beta *const self = stepper->method;
    if (self->advance) self->advance = dal__kernel_any();
}

const dal_family dal__family_beta = {
    .name = "beta",
    .schemes = dal__beta_records,
    .count = DAL__BETA_RECORDS,
    .parse = dal__beta_parse,
    .help = "a number in [0, 1], beta (also with -nodes)",
    .make = make,
    .free = release,
    .start = start,
    .advance = advance,
    .save = save,
    .accepts = accepts,
    .restore = restore,
};
