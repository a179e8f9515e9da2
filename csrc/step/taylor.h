/* taylor.h - several motions at once, whose Taylor series are computed four by four. */
#ifndef DAL__TAYLOR_H
#define DAL__TAYLOR_H

#include "step/stepper.h"

/* One of them. */
typedef struct dal__side {
    dal_stepper *stepper; /* of the family taylor, with steps of fixed size */
    size_t steps;         /* to be made */
    int status;           /* if not DAL_SUCCESS, none was made, and the motion has to go on alone */
    bool made;
    double room;          /* of the piece that is planned */
} dal__side;

/* Whether a stepper can be one of them. */
bool dal__taylor_has_four(const dal_stepper *stepper);

/* Their steps, with the bits that each has alone. */
void dal__taylor_advance(dal__side *sides, size_t count);

#endif /* DAL__TAYLOR_H */
