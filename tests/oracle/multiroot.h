/* multiroot.h - another way to solve the equations of beta-steps, as a family: set it in a record of
 * sub-steps.  What it finds agrees with the library to 64 u of the state. */
#ifndef ORACLE_MULTIROOT_H
#define ORACLE_MULTIROOT_H

#include "dalembert/family.h"

extern const dal_family multiroot_family;

#endif /* ORACLE_MULTIROOT_H */
