/* polynomials.h - the pieces of a motion, kept. */
#ifndef DAL__POLYNOMIALS_H
#define DAL__POLYNOMIALS_H

#include "step/coefficients.h"

/* Those of dal_motion. */
typedef struct dal__polynomials {
    size_t inputs;          /* of the system */
    size_t numbers;         /* of a record */
    size_t count, room;
    double *records;        /* [room*numbers] */
    arena memory;
    dal__piece shape;       /* what all pieces have in common, from the first */
} dal__polynomials;

/* Appends a piece.  Those that do not begin before it are dropped: it has taken their place.
 * DAL_ENOMEM. */
int dal__polynomials_add(dal__polynomials *self, const dal__piece *piece, dal_error *error);

/* The piece of a time: the last one that does not begin after it.  Returns false outside. */
bool dal__polynomials_find(const dal__polynomials *self, double t, dal__piece *piece);

#endif /* DAL__POLYNOMIALS_H */
