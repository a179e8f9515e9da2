/* All that the next step of a stepper depends on, as numbers: to go on elsewhere, bit for bit. */
#include "dalembert/family.h"
#include "step/step.h"

#include <math.h>
#include <string.h>

/* What stands in front of x, the inputs and what the family keeps: what it is of, and the fields
 * below.  Counters are exact below 2^53. */
enum { VERSION = 9, OF = 8, FIELDS = 54, HEAD = OF + FIELDS };

/* A number of the stepper: a real one, which may be any if it is one of the energy, a counter or a
 * flag. */
typedef struct field {
    double *real, *energy;
    size_t *counter;
    bool *flag;
} field;

static void list_fields(dal_stepper *self, field fields[FIELDS])
{
    dal_motion *const motion = &self->motion;
    evaluator *const e = &self->mech.eval;
    dal_stats *const stats = motion->stats;
    dal__jump *const jump = &self->jump;
    dal__rank *const rank = &self->guards.rank;
    dal__creep *const creep = &self->guards.creep;
    const field list[FIELDS] = {
        {.real = &motion->t0}, {.real = &motion->h}, {.counter = &motion->steps},
        {.flag = &jump->looking}, {.real = &jump->shift}, {.energy = &jump->energy},
        {.energy = &jump->kinetic}, {.counter = &jump->step}, {.energy = &jump->change},
        {.counter = &stats->iterations}, {.counter = &stats->constraint_calls},
        {.counter = &stats->potential_calls}, {.counter = &stats->corrections},
        {.counter = &stats->full_newtons}, {.counter = &stats->halvings},
        {.real = &stats->worst_residual}, {.real = &stats->initial_residual},
        {.real = &stats->initial_correction}, {.counter = &e->constraint_calls},
        {.counter = &e->potential_calls}, {.counter = &e->lagrangian_calls},
        {.counter = &e->force_calls}, {.counter = &stats->evaluations},
        {.counter = &stats->lagrangian_calls}, {.counter = &stats->force_calls},
        {.counter = &stats->scaled}, {.counter = &stats->unscaled}, {.counter = &stats->resets},
        {.energy = &self->scaling.energy}, {.energy = &jump->undone},
        {.counter = &stats->rejected}, {.counter = &stats->uncontrolled},
        {.real = &rank->least}, {.real = &rank->t}, {.counter = &rank->rows},
        {.counter = &rank->doubts}, {.real = &creep->count}, {.real = &creep->length},
        {.real = &creep->longest}, {.real = &creep->shortest}, {.real = &creep->t},
        {.real = &creep->mark}, {.counter = &creep->since},
        {.energy = &rank->range[0]}, {.energy = &rank->range[1]},
        {.real = &self->reversible.rho}, {.real = &self->reversible.speed},
        {.real = &self->reversible.fastest}, {.flag = &self->reversible.settled},
        {.counter = &motion->first}, {.real = &self->pace.seen}, {.real = &self->pace.share},
        {.real = &self->pace.h}, {.real = &self->pace.error},
    };
    memcpy(fields, list, sizeof list);
}

static double read(const field *f)
{
    return f->real ? *f->real : f->energy ? *f->energy
         : f->counter ? (double)*f->counter : *f->flag;
}

static void write(const field *f, double value)
{
    if (f->real) *f->real = value;
    if (f->energy) *f->energy = value;
    if (f->counter) *f->counter = (size_t)value;
    if (f->flag) *f->flag = value != 0.0;
}

/* What is wrong with a value of the field; NULL if nothing is. */
static const char *fault(const field *f, double value)
{
    if (isnan(value) || (isinf(value) && !f->energy)) return "not finite";
    if (f->counter && !(value >= 0.0 && value <= 0x1p53 && value == floor(value)))
        return "not a whole number from 0 to 2^53";
    return f->flag && value != 0.0 && value != 1.0 ? "neither 0 nor 1" : NULL;
}

/* The longest error-controlled step; 0: none. */
static double longest(const dal_stepper *self)
{
    return isfinite(self->pace.h_max) ? self->pace.h_max : 0.0;
}

/* How many numbers the family keeps. */
static size_t kept_by_family(const dal_stepper *self)
{
    return self->family->save ? self->family->save(self->method, NULL) : 0;
}

/* How many inputs the state lies in the D of. */
static size_t applied(const dal_stepper *self)
{
    return self->applied ? self->motion.system->def.inputs : 0;
}

static size_t before_family(const dal_stepper *self)
{
    return HEAD + 2 * self->mech.n + self->motion.system->def.inputs + applied(self)
         + self->mech.m;
}

size_t dal_stepper_saved(const dal_stepper *stepper)
{
    const size_t kept = kept_by_family(stepper);
    return kept == DAL_NOT_RESUMABLE ? 0 : before_family(stepper) + kept;
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
    const size_t n = stepper->mech.n, m = stepper->mech.m, N = 2 * n;
    int status = check_resumable(stepper, values);
    if (!status) status = dal__stepper_started(stepper);
    if (status) return status;
    double *const of_family = values + before_family(stepper);
    field fields[FIELDS];
    const double of[OF] = {VERSION, (double)n, (double)m, stepper->identity,
                           stepper->pace.tolerance, longest(stepper),
                           stepper->scaling.wanted, stepper->reversible.eps};
    list_fields(stepper, fields);
    memcpy(values, of, sizeof of);
    for (size_t i = 0; i < FIELDS; i++) values[OF + i] = read(&fields[i]);
    memcpy(values + HEAD, stepper->motion.x, N * sizeof *values);
    dal__copy(stepper->motion.system->def.inputs, stepper->motion.input, values + HEAD + N);
    dal__copy(m, stepper->guards.rank.largest, of_family - m);
    dal__copy(applied(stepper), stepper->applied, of_family - m - applied(stepper));
    if (stepper->family->save) stepper->family->save(stepper->method, of_family);
    return DAL_SUCCESS;
}

static int check_saved(dal_stepper *self, const double *values, size_t count)
{
    const size_t n = self->mech.n, m = self->mech.m, expected = dal_stepper_saved(self);
    const dal_family *const family = self->family;
    dal_error *const error = &self->error;
    if (count > 0 && values[0] != VERSION)
        return dal__fail(error, DAL_EINVAL, "values[0] = %g: expected %d; the saved state was "
                         "written by another version of dalembert", values[0], VERSION);
    if (count > 3 && (values[1] != (double)n || values[2] != (double)m
                      || values[3] != self->identity))
        return dal__fail(error, DAL_EINVAL, "the saved state belongs to another system or scheme: "
                         "n = %g, m = %g; expected n = %zu, m = %zu and scheme \"%s\"", values[1],
                         values[2], n, m, self->scheme.name);
    if (count > 5 && (values[4] != self->pace.tolerance || values[5] != longest(self)))
        return dal__fail(error, DAL_EINVAL, "the saved state has tolerance = %g and h_max = %g; "
                         "expected tolerance = %g and h_max = %g, as in this stepper", values[4],
                         values[5], self->pace.tolerance, longest(self));
    if (count > 6 && values[6] != (double)self->scaling.wanted)
        return dal__fail(error, DAL_EINVAL, "the saved state has keep_energy = %g; expected %d, as "
                         "in this stepper", values[6], (int)self->scaling.wanted);
    if (count > 7 && values[7] != self->reversible.eps)
        return dal__fail(error, DAL_EINVAL, "the saved state has eps = %g; expected eps = %g, as "
                         "in this stepper", values[7], self->reversible.eps);
    if (count != expected)
        return dal__fail(error, DAL_EINVAL, "count = %zu: expected %zu numbers", count, expected);
    field fields[FIELDS];
    list_fields(self, fields);
    for (size_t i = OF; i < count; i++) {
        const char *const wrong = fault(i < HEAD ? &fields[i - OF] : &(field){0}, values[i]);
        if (wrong)
            return dal__fail(error, DAL_EINVAL, "values[%zu] = %g is %s", i, values[i], wrong);
    }
    const double t = values[OF], h = values[OF + 1], steps = values[OF + 2];
    const double first = values[HEAD - 5], share = values[HEAD - 3], next = values[HEAD - 2];
    const int status = dal__stepper_check_times(self, t, h);
    if (status) return status;
    if (!isfinite(t + (steps - first + 1.0) * h))
        return dal__fail(error, DAL_EINVAL, "values[%d] = %g: so many steps of h = %g from t = %g "
                         "do not reach a finite time", OF + 2, steps, h, t);
    if (self->pace.q > 0 ? !(next * h > 0.0 && share > 0.0 && values[HEAD - 1] > 0.0)
                         : next != 0.0)
        return dal__fail(error, DAL_EINVAL, "values[%d] = %g: not the saved state of %s", HEAD - 2,
                         next, self->pace.q > 0 ? "error-controlled steps"
                                                : "steps without error control");
    if (self->vary.on ? !(first <= steps) : first != 0.0)
        return dal__fail(error, DAL_EINVAL, "values[%d] = %g: not the saved state of %s", HEAD - 5,
                         first, self->vary.on ? "steps of variable size" : "steps of fixed size");
    const double *const reversible = values + HEAD - 9; /* rho, v0^2, fastest^2 */
    if (self->reversible.eps > 0.0 && !(reversible[0] > 0.0 && reversible[1] >= 0.0
                                        && reversible[2] >= 0.0))
        return dal__fail(error, DAL_EINVAL, "values[%d] = %g: not the saved state of reversible "
                         "steps", HEAD - 9, reversible[0]);
    const size_t of_family = before_family(self);
    if (family->accepts && !family->accepts(self->method, values + of_family))
        return dal__fail(error, DAL_EINVAL, "values[%zu]: not the saved state of the scheme \"%s\"",
                         of_family, self->scheme.name);
    return DAL_SUCCESS;
}

int dal_stepper_restore(dal_stepper *stepper, const double *values, size_t count)
{
    if (!stepper) return DAL_EINVAL;
    const size_t N = 2 * stepper->mech.n;
    int status = check_resumable(stepper, values);
    if (!status) status = check_saved(stepper, values, count);
    if (status) return status;
    field fields[FIELDS];
    list_fields(stepper, fields);
    for (size_t i = 0; i < FIELDS; i++) write(&fields[i], values[OF + i]);
    stepper->motion.stats->steps = stepper->motion.steps; /* by which the step routine counts */
    memcpy(stepper->motion.x, values + HEAD, N * sizeof *values);
    dal_stepper_input(stepper, values + HEAD + N);
    const double *const largest = values + before_family(stepper) - stepper->mech.m;
    dal__copy(stepper->mech.m, largest, stepper->guards.rank.largest);
    dal__copy(applied(stepper), largest - applied(stepper), stepper->applied);
    if (stepper->family->start) stepper->family->start(stepper->method, &stepper->motion);
    if (stepper->family->restore)
        stepper->family->restore(stepper->method, values + before_family(stepper));
    stepper->vary.until = copysign((double)INFINITY, stepper->motion.h);
    stepper->started = true;
    dal__fail(&stepper->error, DAL_SUCCESS, "%s", "");
    return DAL_SUCCESS;
}
