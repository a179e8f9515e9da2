/* gsl_flow.c - rk8pd of GSL on the reduced ODE: what somebody writes in C for one system.

field.h, written for each problem, has SIZE and `static void field(double t, const double *y,
double *out)`. */
#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>
#include <string.h>

#include "field.h"

enum { NMAX = 2000000 };  /* steps to the next of the times: no step becomes ever smaller */

static int rates(double t, const double y[], double out[], void *unused)
{
  (void) unused;
  field(t, y, out);
  return GSL_SUCCESS;
}

/* From `state` at times[0] to rows of `states` at the other times.  Returns GSL's status. */
int gsl_flow(double tolerance, const double *state, size_t count, const double *times,
             double *states)
{
  gsl_odeiv2_system system = {rates, NULL, SIZE, NULL};
  gsl_odeiv2_driver *driver =
    gsl_odeiv2_driver_alloc_y_new(&system, gsl_odeiv2_step_rk8pd, 1e-3, tolerance, tolerance);
  double t = times[0], y[SIZE];
  int status = driver == NULL ? GSL_ENOMEM : GSL_SUCCESS;
  memcpy(y, state, sizeof y);
  if (driver != NULL)
    gsl_odeiv2_driver_set_nmax(driver, NMAX);
  for (size_t i = 1; i < count && status == GSL_SUCCESS; i++) {
    status = gsl_odeiv2_driver_apply(driver, &t, times[i], y);
    memcpy(states + (i - 1) * SIZE, y, sizeof y);
  }
  if (driver != NULL)
    gsl_odeiv2_driver_free(driver);
  return status;
}
