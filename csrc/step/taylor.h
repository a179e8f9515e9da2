/* taylor.h - the pieces of motions by Taylor series, and several motions at once. */
#ifndef DAL__TAYLOR_H
#define DAL__TAYLOR_H

#include "step/coefficients.h"
#include "step/stepper.h"

/* ---- pieces -------------------------------------------------------------------------------- */

bool dal__taylor_has_pieces(const dal_stepper *stepper);

/* *piece <- that in which the stepper is, after a step.  Returns false if it does not begin at the
 * time `from`, or before it. */
bool dal__taylor_piece(const dal_stepper *stepper, double from, dal__piece *piece);

/* x[2n] <- the state at a time in a piece of the same system, with the workspace of a stepper that
 * is not in use.  The errors of steps. */
int dal__taylor_state(dal_stepper *stepper, const dal__piece *piece, double t, double *x);

/* Visits the pieces from where a stepper has been started to a time.  Errors: those of steps, and
 * what visit returns. */
typedef int (*dal__visit_fn)(const dal__piece *piece, double from, double to, void *ctx);
int dal__taylor_visit(dal_stepper *stepper, double until, dal__visit_fn visit, void *ctx);

/* ---- several motions at once, whose series are computed four by four ------------------------ */

/* A motion, and how far it is to go. */
typedef struct dal__side {
    dal_stepper *stepper; /* of the family taylor, with steps of fixed size */
    size_t steps;         /* to be made */
    int status;           /* if it is not DAL_SUCCESS, no step was made: try the motion alone */
    bool made;
    double room;          /* of the piece that is planned */
} dal__side;

/* Whether the series of a stepper can be computed with those of others. */
bool dal__taylor_has_four(const dal_stepper *stepper);

/* Makes the steps of all motions.  Each gets the same bits as alone. */
void dal__taylor_advance(dal__side *sides, size_t count);

#endif /* DAL__TAYLOR_H */
