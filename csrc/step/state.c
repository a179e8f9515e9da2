/* All that the next step of a stepper depends on, as numbers: to go on elsewhere, bit for bit. */
#include "dalembert/family.h"
#include "step/step.h"

#include <math.h>
#include <string.h>

/* What stands in front of x and of what the family keeps.  Counters are exact below 2^53. */
enum { VERSION = 1, HEAD = 27 };

static void write_head(const dal_stepper *self, double *head)
{
    const dal_motion *const motion = &self->motion;
    const evaluator *const e = &self->mech.eval;
    const dal_stats *const stats = motion->stats;
    const double values[HEAD] = {
        VERSION, (double)self->mech.n, (double)self->mech.m, self->identity,
        motion->t0, motion->h, (double)motion->steps,
        self->jump.looking, self->jump.shift, self->jump.energy, self->jump.kinetic,
        (double)self->jump.step, self->jump.change,
        (double)stats->iterations, (double)stats->constraint_calls, (double)stats->potential_calls,
        (double)stats->corrections, (double)stats->full_newtons, (double)stats->halvings,
        stats->worst_residual, stats->initial_residual, stats->initial_correction,
        (double)e->constraint_calls, (double)e->potential_calls, (double)e->lagrangian_calls,
        (double)e->force_calls, (double)stats->evaluations,
    };
    memcpy(head, values, sizeof values);
}

static void read_head(dal_stepper *self, const double *head)
{
    dal_motion *const motion = &self->motion;
    evaluator *const e = &self->mech.eval;
    motion->t0 = head[4];
    motion->h = head[5];
    motion->steps = (size_t)head[6];
    self->jump = (dal__jump){.looking = head[7] != 0.0, .shift = head[8], .energy = head[9],
                             .kinetic = head[10], .step = (size_t)head[11], .change = head[12]};
    *motion->stats = (dal_stats){
        .steps = motion->steps,
        .iterations = (size_t)head[13], .constraint_calls = (size_t)head[14],
        .potential_calls = (size_t)head[15], .corrections = (size_t)head[16],
        .full_newtons = (size_t)head[17], .halvings = (size_t)head[18],
        .worst_residual = head[19], .initial_residual = head[20], .initial_correction = head[21],
        .evaluations = (size_t)head[26],
    };
    e->constraint_calls = (size_t)head[22];
    e->potential_calls = (size_t)head[23];
    e->lagrangian_calls = (size_t)head[24];
    e->force_calls = (size_t)head[25];
}

/* How many numbers the family keeps. */
static size_t kept_by_family(const dal_stepper *self)
{
    return self->family->save ? self->family->save(self->method, NULL) : 0;
}

size_t dal_stepper_saved(const dal_stepper *stepper)
{
    const size_t kept = kept_by_family(stepper);
    return kept == DAL_NOT_RESUMABLE ? 0 : HEAD + 2 * stepper->mech.n + kept;
}

/* Whether there is something to save, and where. */
static int check_resumable(dal_stepper *self, const double *values)
{
    if (!values) return dal__fail(&self->error, DAL_EINVAL, "values is NULL");
    if (dal_stepper_saved(self) > 0) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EUNSUPPORTED, "the steps of \"%s\" cannot be resumed: a "
                     "multistep method depends on the steps before", self->scheme.name);
}

int dal_stepper_save(dal_stepper *stepper, double *values)
{
    if (!stepper) return DAL_EINVAL;
    const size_t N = 2 * stepper->mech.n;
    int status = check_resumable(stepper, values);
    if (!status) status = dal__stepper_started(stepper);
    if (status) return status;
    write_head(stepper, values);
    memcpy(values + HEAD, stepper->motion.x, N * sizeof *values);
    if (stepper->family->save) stepper->family->save(stepper->method, values + HEAD + N);
    return DAL_SUCCESS;
}

/* What stands at i of the head. */
enum { LOOKING = 7 };
static bool is_of_energy(size_t i) { return i >= 9 && i <= 12; }
static bool is_counter(size_t i)
{
    return i == 6 || i == 11 || (i >= 13 && i <= 18) || (i >= 22 && i < HEAD);
}

static int check_saved(dal_stepper *self, const double *values, size_t count)
{
    const size_t n = self->mech.n, m = self->mech.m, expected = dal_stepper_saved(self);
    const dal_family *const family = self->family;
    dal_error *const error = &self->error;
    if (count > 0 && values[0] != VERSION)
        return dal__fail(error, DAL_EINVAL, "values[0] = %g is not %d: what was saved is not a "
                         "state of this version", values[0], VERSION);
    if (count > 3 && (values[1] != (double)n || values[2] != (double)m
                      || values[3] != self->identity))
        return dal__fail(error, DAL_EINVAL, "what was saved is of another system or scheme: n = "
                         "%g, m = %g; here n = %zu, m = %zu and scheme \"%s\"", values[1],
                         values[2], n, m, self->scheme.name);
    if (count != expected)
        return dal__fail(error, DAL_EINVAL, "count = %zu: expected %zu numbers", count, expected);
    for (size_t i = 0; i < count; i++) {
        const double value = values[i];
        if (isnan(value) || (isinf(value) && !is_of_energy(i))) /* what is seen of it may be */
            return dal__fail(error, DAL_EINVAL, "values[%zu] = %g is not finite", i, value);
        if (is_counter(i) && !(value >= 0.0 && value <= 0x1p53 && value == floor(value)))
            return dal__fail(error, DAL_EINVAL, "values[%zu] = %g is no counter", i, value);
        if (i == LOOKING && value != 0.0 && value != 1.0)
            return dal__fail(error, DAL_EINVAL, "values[%zu] = %g is neither 0 nor 1", i, value);
    }
    const double t = values[4], h = values[5];
    const int status = dal__stepper_check_times(self, t, h);
    if (status) return status;
    if (!isfinite(t + (values[6] + 1.0) * h))
        return dal__fail(error, DAL_EINVAL, "values[6] = %g steps of h = %g lead from t = %g to no "
                         "finite time", values[6], h, t);
    if (family->accepts && !family->accepts(self->method, values + HEAD + 2 * n))
        return dal__fail(error, DAL_EINVAL, "values[%zu] and what follows is not of the scheme "
                         "\"%s\"", HEAD + 2 * n, self->scheme.name);
    return DAL_SUCCESS;
}

int dal_stepper_restore(dal_stepper *stepper, const double *values, size_t count)
{
    if (!stepper) return DAL_EINVAL;
    const size_t N = 2 * stepper->mech.n;
    int status = check_resumable(stepper, values);
    if (!status) status = check_saved(stepper, values, count);
    if (status) return status;
    read_head(stepper, values);
    memcpy(stepper->motion.x, values + HEAD, N * sizeof *values);
    if (stepper->family->start) stepper->family->start(stepper->method, &stepper->motion);
    if (stepper->family->restore)
        stepper->family->restore(stepper->method, values + HEAD + N);
    stepper->started = true;
    stepper->error.text[0] = '\0';
    return DAL_SUCCESS;
}
