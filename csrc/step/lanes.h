/* lanes.h - members of an ensemble that are stepped together, by the routine of dalembert/lanes.h.
 *
 * A member is what a stepper is: its state, t0, h and step, its predictor, and of its system the
 * parameters and M.  It is loaded from a stepper into a lane, makes steps there, and is unloaded
 * into a stepper, which then stands where the lane does and may go on by itself.  What a member
 * does depends neither on its lane nor on the others. */
#ifndef DAL__LANES_H
#define DAL__LANES_H

#include "dalembert.h"

/* What stands between the two cdef marks the Python package reads too, for tests. */

/* <cdef> */
typedef struct dal__lanes dal__lanes;

/* Inputs of members in lanes last so many steps at least, since those at which they change are made
 * without lanes. */
enum { DAL__LANES_INPUT_STEPS = 8 };

/* How many lanes there are on this machine; 0 if the steps of the scheme are not made so. */
size_t dal__lanes_width(const dal_system *system, const dal_scheme *scheme);

/* *lanes <- all empty, for steppers of the system and the scheme of this one.  DAL_EUNSUPPORTED if
 * the width is 0; DAL_ENOMEM. */
int dal__lanes_new(dal__lanes **lanes, const dal_stepper *like, dal_error *error);
void dal__lanes_free(dal__lanes *lanes);

/* The stepper is started; it is not needed any more. */
void dal__lanes_load(dal__lanes *lanes, size_t lane, const dal_stepper *stepper);
/* No lane goes on, until it is loaded. */
void dal__lanes_stop(dal__lanes *lanes);

/* So many steps of all lanes that go.  A lane stops before a step that it cannot make: one that
 * leaves the domain, does not contract, or has to be looked at more closely. */
void dal__lanes_advance(dal__lanes *lanes, size_t steps);
/* How many steps a lane has made since it was loaded. */
size_t dal__lanes_made(const dal__lanes *lanes, size_t lane);

/* x[2n] <- the state of a lane; impulse[m] <- the sum of kappa since it was loaded or forgotten, in
 * which the stepper's is included. */
void dal__lanes_state(const dal__lanes *lanes, size_t lane, double *x);
void dal__lanes_impulse(const dal__lanes *lanes, size_t lane, double *impulse);
void dal__lanes_forget_impulse(dal__lanes *lanes, size_t lane);

/* The stepper, which may have been another one before, but of the same system and scheme, becomes
 * the one that was loaded, stepped on: state, t0, h, step, predictor, impulse, statistics, and what
 * it knew of its energy, at which lanes do not look.  Parameters and M of the system are as they
 * are: the caller has to see that they are those of the member. */
void dal__lanes_unload(const dal__lanes *lanes, size_t lane, dal_stepper *stepper);

/* For tests and benchmarks: takes the routine with so many lanes in a vector, and empties them all.
 * The width then; 0 if this machine or the system has no such routine, and nothing is changed. */
size_t dal__lanes_use(dal__lanes *lanes, size_t vector);
/* </cdef> */

#endif /* DAL__LANES_H */
