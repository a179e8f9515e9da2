/* A control of the size of steps that is not in the library: steps of h and of 2 h in turn. */
#include "fixtures.h"
#include "check.h"

#include "step/stepper.h"

/* ---- the control ------------------------------------------------------------------------ */

static int make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    bool *long_one;
    (void)options;
    dal__reserve(&self->variable.arena, &long_one, 1, sizeof *long_one);
    const int status = dal__variable_make(self, error);
    if (!status) *(bool *)(self->control_data = long_one) = false;
    return status;
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    bool *const long_one = self->control_data;
    const double t = dal_stepper_time(self), ratio = *long_one ? 2.0 : 0.5;
    const double h = self->motion.steps == 0 ? self->motion.h : ratio * self->motion.h;
    (void)steps;
    const int status = dal__variable_step(self, t, h);
    if (!status) *long_one = !*long_one;
    *made = !status;
    return status;
}

/* In another state the short step comes first. */
static void land(dal_stepper *self) { *(bool *)self->control_data = false; }

static void save(dal_stepper *self, dal__archive *a) { dal__archive_flag(a, self->control_data); }

static const dal__step_control in_turn = {.name = "steps of h and 2 h in turn", .varies = true,
                                          .make = make, .check = dal__stepper_check_times,
                                          .step = step, .land = land, .save = save};

/* ---- what it does ----------------------------------------------------------------------- */

static dal_stepper *controlled(const dal_system *system, const dal_scheme *scheme)
{
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    stepper->step_control = &in_turn;
    need(make(stepper, NULL, NULL), "control", "make");
    return stepper;
}

int main(void)
{
    dal_system *const system = open_system("sleigh");
    const dal_scheme scheme = find_scheme("leapfrog");
    dal_stepper *const stepper = controlled(system, &scheme);
    dal_stepper *const other = controlled(system, &scheme);
    dal_stepper *const fixed = open_stepper(system, &scheme, NULL);
    double x[6], values[200];
    dal_system_state(system, x);
    need(dal_stepper_start(stepper, 0.0, 0.25, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
    for (int k = 1; k <= 5; k++) {
        CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
        CHECK(dal_stepper_time(stepper) == 0.25 * k + 0.25 * (k / 2));
    }
    CHECK(dal_stepper_until(stepper, 2.25) == DAL_SUCCESS); /* which the next step reaches */
    CHECK(dal_stepper_saved(stepper) <= 200 && dal_stepper_save(stepper, values) == DAL_SUCCESS);
    const size_t count = dal_stepper_saved(stepper);
    CHECK(dal_stepper_restore(other, values, count) == DAL_SUCCESS);
    CHECK(dal_step(stepper, NULL) == DAL_SUCCESS && dal_step(stepper, NULL) == DAL_EINVAL);
    CHECK(dal_step(other, NULL) == DAL_SUCCESS && dal_stepper_time(other) == 2.25);
    CHECK(memcmp(dal_stepper_state(stepper), dal_stepper_state(other), sizeof x) == 0);
    CHECK(dal_step(other, NULL) == DAL_SUCCESS && dal_stepper_time(other) == 2.5);
    CHECK(dal__stepper_land(other, x, 0.0) == DAL_SUCCESS); /* after a short one, another */
    CHECK(dal_step(other, NULL) == DAL_SUCCESS && dal_stepper_time(other) == 2.625);
    CHECK(dal_stepper_restore(fixed, values, count) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(fixed)->text, "not the saved state of steps of fixed size"));
    return check_done();
}
