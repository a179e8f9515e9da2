/* beta.h - what the files of the family beta share. */
#ifndef DAL__BETA_H
#define DAL__BETA_H

#include "dalembert/kernel.h"
#include "step/step.h"

/* Its records with a name, and those that are not in the table. */
enum { DAL__BETA_RECORDS = 20 };
extern const dal_scheme dal__beta_records[DAL__BETA_RECORDS];
int dal__beta_parse(dal_scheme *scheme, const char *name);
/* DAL_EINVAL if the record is not valid; the text says why. */
int dal__beta_check(const dal_scheme *scheme, dal_error *error);

/* What makes the steps of a stepper of this family; NULL for those of others. */
dal_kernel *dal__beta_kernel(const dal_stepper *stepper);

/* The compilation of the step routine to use for these sizes; the one for any. */
dal_kernel_fn dal__kernel_for(size_t n, size_t m);
dal_kernel_fn dal__kernel_any(void);
/* The same of those with stages of momentum.h. */
dal_kernel_fn dal__kernel_with_momenta(size_t n, size_t m);
dal_kernel_fn dal__kernel_any_with_momenta(void);
/* One for n = 7 and 8, m <= 4; else NULL. */
dal_kernel_fn dal__kernel_of_many(size_t n, size_t m);

#endif /* DAL__BETA_H */
