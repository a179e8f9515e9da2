/* embedded.h - the error of a step of a composition, from the states that it goes through. */
#ifndef DAL__EMBEDDED_H
#define DAL__EMBEDDED_H

#include "algebra/algebra.h"

/* Sub-steps one after the other, of which stages of them are made at once. */
typedef struct dal__composition {
    const dal_substep *substep;
    size_t stages;
    const size_t *ends; /* [stages] sub-steps up to the end of each */
    int order;          /* that the whole has */
} dal__composition;

/* weight[stages+1] <- w_i, and the largest *q < order for which E is O(h^(q+1)); 0 if there is
 * none: one stage, sub-steps of several maps, no order.  DAL_ENOMEM. */
int dal__embedded_weights(const dal__composition *of, double *weight, int *q, dal_error *error);

/* Whether a pair of sub-steps (0, a), (1, b) is one stage on a system: see kernel.h. */
bool dal__has_pairs(const dal_system *system);

#endif /* DAL__EMBEDDED_H */
