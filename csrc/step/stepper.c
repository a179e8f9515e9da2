/* A system, a scheme and a state that is stepped. */
#include "step/stepper.h"

#include "step/scheme.h"

#include <math.h>
#include <string.h>

/* Pivot of C that reversible steps, which have no tolerance, may come to: see dal__guards. */
#define ALLOWED 1e-9

/* *stepper <- one that knows what it steps, and has no method yet. */
static int allocate(dal_stepper **stepper, const dal_system *system, const dal_scheme *scheme,
                    const dal_options *options, dal_error *error)
{
    const size_t n = system->def.n;
    dal_stepper shape = {.family = dal__scheme_family(scheme), .scheme = *scheme}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    DAL__RESERVE(&memory, dal__times(2, n), &shape.motion.x, &shape.fresh);
    dal__estimate *const estimate = &shape.estimate;
    DAL__RESERVE(&memory, dal__times(2, n), &estimate->low, &estimate->high, &estimate->x,
                 &estimate->sum, &estimate->rate, &estimate->error_of, &estimate->from);
    DAL__RESERVE(&memory, dal__times(2 * DAL__MARKS, n), &estimate->mark);
    DAL__RESERVE(&memory, system->def.m, &shape.motion.impulse);
    dal__rank_reserve(&shape.guards.rank, n, system->def.m, &memory);
    if (system->def.driven) DAL__RESERVE(&memory, system->def.inputs, &shape.applied);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    /* the slots that the arena has filled are those of shape */
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    dal_motion *const motion = &self->motion;
    motion->system = system;
    motion->scheme = &self->scheme;
    motion->mechanics = &self->mech;
    motion->input = self->mech.eval.own_input;
    motion->max_iterations = options && options->max_iterations ? options->max_iterations : 50;
    motion->stats = &self->stats;
    motion->error = &self->mech.error;
    motion->guards = &self->guards;
    self->guards.allowed = ALLOWED;
    *stepper = self;
    return DAL_SUCCESS;
}

int dal_stepper_new(dal_stepper **stepper, const dal_system *system, const dal_scheme *scheme,
                    const dal_options *options, dal_error *error)
{
    int status =
        DAL__REQUIRE(error, {"stepper", stepper}, {"system", system}, {"scheme", scheme});
    if (status) return status;
    if (options && options->max_iterations < 0)
        return dal__fail(error, DAL_EINVAL, "options.max_iterations = %d: expected a positive "
                         "number, or 0 for the default", options->max_iterations);
    if (system->def.driven && scheme->nodes == DAL_KEPT_NODES)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support the constraints "
                         "of \"%s\", because they depend on inputs, which would move its kept "
                         "nodes; choose a scheme with moved nodes", scheme->name,
                         system->def.name);
    const dal_family *const family = dal__scheme_family(scheme);
    if (!family->name || !family->advance)
        return dal__fail(error, DAL_EINVAL, "scheme.family->%s is NULL",
                         family->name ? "advance" : "name");
    dal_stepper *self;
    status = allocate(&self, system, scheme, options, error);
    if (status) return status;
    if (family->make) status = family->make(&self->method, &self->motion, error);
    self->step_control = dal__step_control_of(options);
    if (!status && self->step_control->make)
        status = self->step_control->make(self, options, error);
    if (!status) status = dal__scaling_make(self, options, error);
    if (!status) status = dal__remake_make(self, error);
    if (status) {
        dal_stepper_free(self);
        return status;
    }
    if (scheme->nodes == DAL_KEPT_NODES) self->shift = 1.0 - dal__scheme_substep(scheme, 0).beta;
    self->identity = dal__scheme_identify(system, scheme);
    *stepper = self;
    return DAL_SUCCESS;
}

void dal_stepper_free(dal_stepper *stepper)
{
    if (!stepper) return;
    if (stepper->method && stepper->family->free) stepper->family->free(stepper->method);
    dal__release(&stepper->variable.arena);
    dal__release(&stepper->scaling.arena);
    dal__release(&stepper->remake.arena);
    dal__release(&stepper->arena);
}

/* ---- start ------------------------------------------------------------------------------ */

static int check_start(dal_stepper *self, double t0, double h, const double *x,
                       dal_consistency consistency, dal_initial initial)
{
    const size_t n = self->mech.n;
    const bool kept = self->scheme.nodes == DAL_KEPT_NODES;
    dal_error *const error = &self->error;
    if (!x) return dal__fail(error, DAL_EINVAL, "x is NULL");
    const int status = self->step_control->check(self, t0, h);
    if (status) return status;
    for (size_t i = 0; i < 2 * n; i++)
        if (!isfinite(x[i]))
            return dal__fail(error, DAL_EINVAL, "%s[%zu] = %g is not finite", i < n ? "q" : "v",
                             i < n ? i : i - n, x[i]);
    if ((int)consistency < DAL_CHECK || consistency > DAL_ASSUME)
        return dal__fail(error, DAL_EINVAL, "consistency = %d is not a dal_consistency",
                         (int)consistency);
    if ((int)initial < DAL_INITIAL_NONE || initial > DAL_INITIAL_SHIFT)
        return dal__fail(error, DAL_EINVAL, "initial = %d is not a dal_initial", (int)initial);
    if (kept && initial == DAL_INITIAL_NONE)
        return dal__fail(error, DAL_EINVAL, "initial is missing: a scheme with kept nodes needs it "
                         "(data in D, in D_eps, to be projected onto D_eps, or shifted to the "
                         "node)");
    if (!kept && initial != DAL_INITIAL_NONE)
        return dal__fail(error, DAL_EINVAL, "initial = %d: expected DAL_INITIAL_NONE, because only "
                         "schemes with kept nodes have a choice", (int)initial);
    return DAL_SUCCESS;
}

/* The steps of a start leave the text of their failure in the error of self->mech. */

/* fresh <- consistent data of D (shift = 0) or D_eps; what was found and done goes to stats. */
static int make_consistent(dal_stepper *self, double t0, double shift, dal_consistency consistency,
                           dal_stats *stats)
{
    dal_mechanics *const mech = &self->mech;
    bool consistent;
    int status = dal__lies_in_D(mech, t0, shift, self->fresh, &stats->initial_residual,
                                &consistent);
    if (!status && consistency == DAL_CHECK && !consistent)
        return dal__fail(&mech->error, DAL_EOFFD, "the initial velocity violates the constraint%s: "
                         "relative residual %.3g, allowed %g", shift == 0.0 ? "" : " of D_eps",
                         stats->initial_residual, DAL_CONSISTENT);
    if (!status && consistency != DAL_ASSUME)
        status = dal_project(mech, t0, shift, self->fresh, &stats->initial_correction);
    return status;
}

/* Whether a system that is declared steady is so at the initial data, where mu and d(mu v)/dq are
 * in mech: no coordinate that mu depends on is pushed by a reaction. */
static int check_steady(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    const dal_rows *const rows = mech->eval.rows;
    dal__build_Z(mech, mech->forms.mu);
    for (size_t i = 0; i < n; i++) {
        double pushed = 0.0, changed = 0.0;
        const size_t begin = rows ? rows->above[i] : 0, end = rows ? rows->above[i + 1] : m;
        for (size_t k = begin; k < end; k++) {
            const size_t e = rows ? rows->entry[k] : k * n + i;
            pushed = fmax(pushed, fabs(mech->gram.Z[e]));
            changed = fmax(changed, fabs(mech->forms.dmu[e]));
        }
        if (pushed != 0.0 && changed != 0.0)
            return dal__fail(&mech->error, DAL_EINVAL, "the system is declared steady, but mu "
                             "depends on coordinate %zu, which a reaction pushes (M^-1 mu^T has %g "
                             "there, d(mu v)/dq has %g); do not declare it steady", i, pushed,
                             changed);
    }
    return DAL_SUCCESS;
}

/* Whether a force that is declared positional, and stands in mech->force, is the same at this v, or
 * says that it is not defined there. */
static int check_positional(dal_mechanics *mech, double t0, const double *q, const double *v)
{
    evaluator *const e = &mech->eval;
    const int status = dal__force(e, t0, q, v, mech->step, NULL, NULL, &mech->error);
    if (status == DAL_EUSER) return status;
    for (size_t i = 0; i < mech->n; i++)
        if (!(mech->step[i] == mech->force[i]))
            return dal__fail(&mech->error, DAL_EINVAL, "the force is declared positional, but "
                             "f[%zu] is %g at the initial velocity and %g where v[0] = %g", i,
                             mech->force[i], mech->step[i], v[0]);
    return DAL_SUCCESS;
}

/* Every output that the steps will ask for, once, into buffers that are NaN: what is never written
 * is found here. */
static int probe(dal_stepper *self, double t0)
{
    dal_mechanics *const mech = &self->mech;
    const double *const q = self->fresh, *const v = self->fresh + mech->n;
    const dal__jet jet = {.L_q = mech->force, .L_v = mech->momentum, .L_qq = mech->hessian,
                          .L_vq = mech->L_vq, .L_vv = mech->L_vv};
    const dal__jet simple = {.L_q = mech->force, .L_qq = mech->hessian};
    int status = dal__constraint(&mech->eval, t0, q, v, mech->forms.phi, mech->forms.mu,
                                 mech->forms.dmu, NULL, &mech->error);
    if (!status && mech->eval.system->def.steady) status = check_steady(mech);
    if (!status)
        status = dal__lagrangian(&mech->eval, t0, q, v, mech->eval.constant_mass ? &simple : &jet,
                                 &mech->error);
    if (!status && mech->eval.system->def.force)
        status = dal__force(&mech->eval, t0, q, v, mech->force, mech->f_q, mech->f_v,
                            &mech->error);
    if (status || !mech->eval.system->def.positional) return status;
    for (size_t i = 0; i < mech->n; i++) mech->reach[i] = -v[i];
    status = check_positional(mech, t0, q, mech->reach);
    return status ? status : check_positional(mech, t0, q, mech->eval.nowhere);
}

/* q <- q + shift v. */
static int move_node(dal_stepper *self, double shift, double *x)
{
    const size_t n = self->mech.n;
    for (size_t i = 0; i < n; i++) x[i] += shift * x[n + i];
    if (dal__all_finite(n, x)) return DAL_SUCCESS;
    return dal__fail(&self->mech.error, DAL_EDOMAIN, "q + %g v overflows", shift);
}

int dal_stepper_start(dal_stepper *stepper, double t0, double h, const double *x,
                      dal_consistency consistency, dal_initial initial)
{
    if (!stepper) return DAL_EINVAL;
    dal_stepper *const self = stepper;
    dal_motion *const motion = &self->motion;
    const size_t n = self->mech.n;
    const double shift = self->shift != 0.0 ? self->shift * h : 0.0; /* h may be infinite */
    double first = h, kept = 0.0;
    dal_stats stats = {0};
    int status = check_start(self, t0, h, x, consistency, initial);
    if (status) return status;

    self->mech.eval.calls = (dal__calls){0};
    memcpy(self->fresh, x, 2 * n * sizeof *x);
    status = probe(self, t0);
    if (!status)
        status = make_consistent(self, t0, initial == DAL_INITIAL_D_EPS ? shift : 0.0, consistency,
                                 &stats);
    if (!status && initial == DAL_INITIAL_PROJECT)
        status = dal_project(&self->mech, t0, shift, self->fresh, &stats.initial_correction);
    if (!status && self->applied && !self->mech.eval.constant_mass)
        status = dal__check_degree(&self->mech, t0, self->fresh, "inputs in constraints");
    if (!status && initial == DAL_INITIAL_SHIFT) status = move_node(self, shift, self->fresh);
    if (!status) dal__rank_find(&self->guards.rank, &self->mech);
    dal__energy_jump jump = {0};
    if (!status)
        status = dal__energy_jump_start(&jump, &self->mech, self->scheme.order, shift, self->fresh);
    if (!status) status = dal__scaling_start(self, self->fresh, &kept);
    if (!status && self->step_control->start)
        status = self->step_control->start(self, t0, h, self->fresh, &first);
    if (status) {
        self->error = self->mech.error;
        return status;
    }

    memcpy(motion->x, self->fresh, 2 * n * sizeof *x);
    if (self->applied) dal__copy(motion->system->def.inputs, motion->input, self->applied);
    motion->t0 = t0;
    motion->h = first;
    motion->steps = motion->first = 0;
    self->until = h > 0.0 ? (double)INFINITY : -(double)INFINITY;
    *motion->stats = stats;
    self->energy_jump = jump;
    dal__rank_start(&self->guards.rank, self->mech.m);
    self->guards.creep = (dal__creep){0};
    dal__estimate_forget(self);
    self->scaling.energy = kept;
    self->started = true;
    dal__fail(&self->error, DAL_SUCCESS, "%s", "");
    if (self->family->start) self->family->start(self->method, motion);
    return DAL_SUCCESS;
}

/* ---- steps ------------------------------------------------------------------------------ */

enum { BETWEEN_LOOKS = 64 };

/* Update the least and the largest number of iterations per step, over 64 steps. */
static void note_effort(dal_stepper *self)
{
    dal__estimate *const estimate = &self->estimate;
    const size_t steps = self->motion.steps - estimate->looked;
    const size_t iterations = self->motion.stats->iterations - estimate->iterations;
    if (steps < BETWEEN_LOOKS) return;
    estimate->least_effort = fmin(estimate->least_effort, (double)iterations / (double)steps);
    estimate->most_effort = fmax(estimate->most_effort, (double)iterations / (double)steps);
    estimate->looked += steps;
    estimate->iterations += iterations;
}

int dal__stepper_look(dal_stepper *stepper)
{
    note_effort(stepper);
    const int status = dal__energy_jump_look(&stepper->energy_jump, &stepper->mech,
                                             stepper->motion.steps, stepper->motion.x);
    if (status) stepper->error = stepper->mech.error;
    return status;
}

int dal__stepper_land(dal_stepper *stepper, const double *x, double kept)
{
    dal_motion *const motion = &stepper->motion;
    dal__energy_jump jump = {0};
    int status = dal__energy_jump_start(&jump, &stepper->mech, stepper->scheme.order,
                                        stepper->energy_jump.shift, x);
    if (status) {
        stepper->error = stepper->mech.error;
        return status;
    }
    if (stepper->step_control->land) stepper->step_control->land(stepper);
    if (stepper->energy_jump.step == 0) stepper->energy_jump = jump;
    stepper->scaling.energy = kept;
    memcpy(motion->x, x, 2 * stepper->mech.n * sizeof *x);
    if (stepper->family->start) stepper->family->start(stepper->method, motion);
    return DAL_SUCCESS;
}

int dal__stepper_advance(dal_stepper *stepper, size_t steps, size_t *made)
{
    dal_stepper *const self = stepper;
    dal_motion *const motion = &self->motion;
    *made = 0;
    const int turned = steps > 0 ? dal__stepper_enter_D(self) : DAL_SUCCESS;
    if (turned) return turned;
    while (*made < steps) {
        const size_t left = steps - *made, next = BETWEEN_LOOKS - motion->steps % BETWEEN_LOOKS;
        size_t done = 0;
        motion->error->text[0] = '\0';
        if (dal_stepper_time(self) == self->until) return DAL_SUCCESS;
        const int status = self->step_control->step(self, next < left ? next : left, &done);
        motion->steps += done;
        *made += done;
        if (status && !motion->error->text[0]) /* a family of the user's that says nothing */
            dal__fail(motion->error, status, "%s", dal_strerror(status));
        if (status)
            return dal__fail_because(&self->error, status, motion->error,
                                     "step %zu (t = %g, h = %g): ", motion->steps + 1,
                                     dal_stepper_time(self), motion->h);
        const int stopped = motion->steps % BETWEEN_LOOKS == 0 ? dal__stepper_look(self) : 0;
        if (stopped) return stopped;
    }
    return DAL_SUCCESS;
}

int dal_advance(dal_stepper *stepper, size_t steps, double *reaction, size_t *done)
{
    if (done) *done = 0;
    if (!stepper) return DAL_EINVAL;
    int status = dal__stepper_started(stepper);
    if (status) return status;
    size_t made = 0;
    const double begin = dal_stepper_time(stepper);
    dal__stepper_forget_impulse(stepper);
    status = dal__stepper_advance(stepper, steps, &made);
    if (done) *done = made;
    if (!status && made < steps)
        return dal__fail(&stepper->error, DAL_EINVAL, "the stepper has reached the end of its "
                         "steps, t = %g; set a later end", dal_stepper_time(stepper));
    if (status || !reaction || steps == 0) return status;
    const double elapsed = stepper->step_control->varies ? dal_stepper_time(stepper) - begin
                                                         : (double)steps * stepper->motion.h;
    return dal__stepper_reaction(stepper, elapsed, reaction);
}

int dal_step(dal_stepper *stepper, double *reaction)
{
    return dal_advance(stepper, 1, reaction, NULL);
}
