/* Steps of one size h. */
#include "step/step_control.h"

#include "step/stepper.h"

static bool wanted(const dal_options *options)
{
    (void)options;
    return true; /* unless the options ask for others */
}

const dal__step_control dal__fixed_steps = {.name = "steps of fixed size", .wanted = wanted,
                                 .check = dal__stepper_check_times, .step = dal__scheme_steps};
