/* multiroot.h - another way to solve the equations of beta-steps, as a family: set it in a record
 * of sub-steps.  What it finds agrees with the library to 64 u of the state. */
#ifndef ORACLE_MULTIROOT_H
#define ORACLE_MULTIROOT_H

#include "step/stepper.h"

extern const dal_family multiroot_family;

/* Who makes the steps of a record of sub-steps: the library, by the compilation for the sizes of
 * the system or by the one for any; or multiroot. */
typedef enum way { BY_LIBRARY, BY_ANY_SIZES, BY_MULTIROOT, WAYS } way;

/* dal_stepper_new for one of these. */
static inline int new_stepper_by(way by, dal_stepper **stepper, const dal_system *system,
                                 const dal_scheme *scheme, dal_error *error)
{
    dal_scheme record = *scheme;
    if (by == BY_MULTIROOT) record.family = &multiroot_family;
    const int status = dal_stepper_new(stepper, system, &record, NULL, error);
    if (!status && by == BY_ANY_SIZES) dal__beta_any_sizes(*stepper);
    return status;
}

#endif /* ORACLE_MULTIROOT_H */
