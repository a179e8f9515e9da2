/* The controls of the size of steps. */
#include "step/step_control.h"

static const dal__step_control *const controls[] = {
    &dal__reversible_steps, &dal__controlled_steps, &dal__own_steps, &dal__fixed_steps};

const dal__step_control *dal__step_control_of(const dal_options *options)
{
    static const dal_options none = {0};
    size_t i = 0;
    while (!controls[i]->wanted(options ? options : &none)) i++;
    return controls[i];
}
