/* All that the next step of a stepper depends on, as numbers: to go on elsewhere, bit for bit. */
#include "step/stepper.h"

#include "step/scheme.h"

#include <math.h>
#include <string.h>

enum { VERSION = 10, HEAD = 5 };

/* The head identifies a saved state: version, n, m, system and scheme, control of the steps. */
static void build_head(const dal_stepper *self, double head[HEAD])
{
    head[0] = VERSION;
    head[1] = (double)self->mech.n;
    head[2] = (double)self->mech.m;
    head[3] = self->identity;
    head[4] = dal__digest_text(self->step_control->name);
}

static void save_counts(dal_stepper *self, dal__archive *a)
{
    evaluator *const e = &self->mech.eval;
    dal_stats *const stats = self->motion.stats;
    size_t *const counters[] = {
        &stats->iterations, &stats->constraint_calls, &stats->potential_calls,
        &stats->lagrangian_calls, &stats->force_calls, &stats->evaluations, &stats->corrections,
        &stats->full_newtons, &stats->halvings, &stats->scaled, &stats->unscaled, &stats->resets,
        &stats->rejected, &stats->uncontrolled, &e->calls.constraint, &e->calls.potential,
        &e->calls.lagrangian, &e->calls.force};
    for (size_t i = 0; i < DAL_LENGTH(counters); i++) dal__archive_counter(a, counters[i]);
    dal__archive_real(a, &stats->worst_residual);
    dal__archive_real(a, &stats->initial_residual);
    dal__archive_real(a, &stats->initial_correction);
}

/* Everything between the head and the data of the family. */
static void save(dal_stepper *self, dal__archive *a)
{
    dal_motion *const motion = &self->motion;
    const size_t inputs = motion->system->def.inputs;
    dal__archive_real(a, &motion->t0);
    dal__archive_real(a, &motion->h);
    dal__archive_counter(a, &motion->steps);
    dal__archive_counter(a, &motion->first);
    dal__archive_same(a, "keep_energy", self->scaling.wanted);
    dal__archive_any(a, &self->scaling.energy);
    if (self->step_control->save) self->step_control->save(self, a);
    save_counts(self, a);
    dal__energy_jump_save(&self->energy_jump, a);
    dal__creep_save(&self->guards.creep, a);
    dal__rank_save(&self->guards.rank, self->mech.m, a);
    dal__archive_vector(a, 2 * self->mech.n, motion->x);
    dal__archive_vector(a, inputs, self->mech.eval.own_input);
    if (self->applied) dal__archive_vector(a, inputs, self->applied);
}

/* How many numbers the family keeps. */
static size_t kept_by_family(const dal_stepper *self)
{
    return self->family->save ? self->family->save(self->method, NULL) : 0;
}

static size_t before_family(const dal_stepper *self)
{
    dal__archive a = {.mode = DAL__COUNT, .at = HEAD};
    save((dal_stepper *)self, &a);
    return a.at;
}

size_t dal_stepper_saved(const dal_stepper *stepper)
{
    const size_t kept = kept_by_family(stepper);
    return kept == DAL_NOT_RESUMABLE ? 0 : before_family(stepper) + kept;
}

int dal__stepper_check_scheme(const dal_stepper *stepper, const dal_scheme *scheme,
                              const char *name, dal_error *error)
{
    if (dal__scheme_identify(stepper->motion.system, scheme) != stepper->identity)
        return dal__fail(error, DAL_EINVAL, "scheme: expected the scheme of the stepper");
    if (dal_stepper_saved(stepper) > 0) return DAL_SUCCESS;
    return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" does not support %s, because its "
                     "steps cannot be resumed; choose another scheme", scheme->name, name);
}

/* Whether there is something to save, and where. */
static int check_resumable(dal_stepper *self, const double *values)
{
    if (!values) return dal__fail(&self->error, DAL_EINVAL, "values is NULL");
    if (dal_stepper_saved(self) > 0) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EUNSUPPORTED, "the steps of \"%s\" cannot be resumed, "
                     "because a multistep method depends on earlier steps", self->scheme.name);
}

int dal_stepper_save(dal_stepper *stepper, double *values)
{
    if (!stepper) return DAL_EINVAL;
    int status = check_resumable(stepper, values);
    if (!status) status = dal__stepper_started(stepper);
    if (status) return status;
    dal__archive a = {.mode = DAL__SAVE, .to = values, .at = HEAD};
    build_head(stepper, values);
    save(stepper, &a);
    if (stepper->family->save) stepper->family->save(stepper->method, values + a.at);
    return DAL_SUCCESS;
}

static int check_head(dal_stepper *self, const double *values, size_t count)
{
    double head[HEAD];
    build_head(self, head);
    if (count > 0 && values[0] != VERSION)
        return dal__fail(&self->error, DAL_EINVAL, "values[0] = %g: expected %d; the saved state "
                         "was written by another version of dalembert", values[0], VERSION);
    if (count > 3 && memcmp(values + 1, head + 1, 3 * sizeof *head) != 0)
        return dal__fail(&self->error, DAL_EINVAL, "the saved state belongs to another system or "
                         "scheme: n = %g, m = %g; expected n = %g, m = %g and scheme \"%s\"",
                         values[1], values[2], head[1], head[2], self->scheme.name);
    if (count > 4 && values[4] != head[4])
        return dal__fail(&self->error, DAL_EINVAL, "values[4] = %.17g: not the saved state of %s",
                         values[4], self->step_control->name);
    if (count == dal_stepper_saved(self)) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EINVAL, "count = %zu: expected %zu numbers", count,
                     dal_stepper_saved(self));
}

/* DAL_EINVAL unless steps lead on from t0, h, steps and first, at values[HEAD]. */
static int check_motion(dal_stepper *self, const double *values)
{
    const double t = values[HEAD], h = values[HEAD + 1];
    const double steps = values[HEAD + 2], first = values[HEAD + 3];
    const int status = dal__stepper_check_times(self, t, h);
    if (status) return status;
    if (steps + 1.0 == steps) /* which the number of a step, a double, does not grow beyond */
        return dal__fail(&self->error, DAL_EINVAL, "values[%d] = %g: expected fewer than 2^53 "
                         "steps", HEAD + 2, steps);
    if (!isfinite(t + (steps - first + 1.0) * h))
        return dal__fail(&self->error, DAL_EINVAL, "values[%d] = %g: so many steps of h = %g from "
                         "t = %g do not reach a finite time", HEAD + 2, steps, h, t);
    if (self->step_control->varies ? !(first <= steps) : first != 0.0)
        return dal__fail(&self->error, DAL_EINVAL, "values[%d] = %g: not the saved state of %s",
                         HEAD + 3, first, self->step_control->name);
    return DAL_SUCCESS;
}

static int check_saved(dal_stepper *self, const double *values, size_t count)
{
    const dal_family *const family = self->family;
    dal_error *const error = &self->error;
    int status = check_head(self, values, count);
    if (status) return status;
    dal__archive a = {.mode = DAL__CHECK, .from = values, .at = HEAD, .h = values[HEAD + 1]};
    save(self, &a);
    const size_t of_family = a.at;
    for (size_t i = of_family; i < count; i++) dal__archive_real(&a, NULL);
    if (a.name)
        return dal__fail(error, DAL_EINVAL, "the saved state has %s = %g; expected %g, as in this "
                         "stepper", a.name, values[a.where], a.expected);
    if (a.wrong)
        return dal__fail(error, DAL_EINVAL, "values[%zu] = %g is %s", a.where, values[a.where],
                         a.wrong);
    status = check_motion(self, values);
    if (status) return status;
    if (family->accepts && !family->accepts(self->method, values + of_family))
        return dal__fail(error, DAL_EINVAL, "values[%zu]: not the saved state of the scheme \"%s\"",
                         of_family, self->scheme.name);
    return DAL_SUCCESS;
}

int dal_stepper_restore(dal_stepper *stepper, const double *values, size_t count)
{
    if (!stepper) return DAL_EINVAL;
    int status = check_resumable(stepper, values);
    if (!status) status = check_saved(stepper, values, count);
    if (status) return status;
    dal__archive a = {.mode = DAL__RESTORE, .from = values, .at = HEAD};
    save(stepper, &a);
    if (stepper->family->start) stepper->family->start(stepper->method, &stepper->motion);
    if (stepper->family->restore)
        stepper->family->restore(stepper->method, values + a.at);
    stepper->until = copysign((double)INFINITY, stepper->motion.h);
    stepper->started = true;
    dal__fail(&stepper->error, DAL_SUCCESS, "%s", "");
    return DAL_SUCCESS;
}
