/* taylor.h - several motions at once, whose Taylor series are computed four by four. */
#ifndef DAL__TAYLOR_H
#define DAL__TAYLOR_H

#include "step/stepper.h"

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
