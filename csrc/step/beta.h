/* beta.h - what the files of the family beta share. */
#ifndef DAL__BETA_H
#define DAL__BETA_H

#include "dalembert/kernel.h"
#include "ground/ground.h"

/* Its records with a name, and those that are not in the table. */
enum { DAL__BETA_RECORDS = 20 };
extern const dal_scheme dal__beta_records[DAL__BETA_RECORDS];
int dal__beta_parse(dal_scheme *scheme, const char *name);
/* DAL_EINVAL if the record is not valid; the text says why. */
int dal__beta_check(const dal_scheme *scheme, dal_error *error);

/* What makes the steps of a stepper of this family; NULL for those of others. */
dal_kernel *dal__beta_kernel(const dal_stepper *stepper);

/* V_q at the start of the next step, if it is known, is that of the inputs now. */
void dal__beta_take_inputs(const dal_stepper *stepper);

/* The compilation of the step routine to use for these sizes; the one for any.  Some have stages of
 * momentum.h. */
dal_kernel_fn dal__kernel_for(size_t n, size_t m, bool with_momenta);
dal_kernel_fn dal__kernel_any(bool with_momenta);

/* Those of kernel_row.c for n = 1, ..., 6, by m < n, at most 4. */
#define DAL__ROWS(n) extern const dal_kernel_fn dal__plain_##n[5], dal__momenta_##n[5]
DAL__ROWS(1);
DAL__ROWS(2);
DAL__ROWS(3);
DAL__ROWS(4);
DAL__ROWS(5);
DAL__ROWS(6);

#endif /* DAL__BETA_H */
