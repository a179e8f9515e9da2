/* jump.h - checks of the energy. */
#ifndef DAL__JUMP_H
#define DAL__JUMP_H

#include "geometry/geometry.h"
#include "ground/archive.h"

/* Whether the energy jumps (jump.c): looked at now and then, never where something does work or
 * depends on time, or by schemes of order 1, which drift by design. */
typedef struct dal__jump {
    bool looking;
    double shift, energy, kinetic; /* of the states' D_eps; at the start; the largest seen */
    size_t step;                   /* where the energy was seen to have jumped; 0: nowhere */
    double change;                 /* by how much */
    double undone;                 /* what else it would have changed by: see scaling.c */
    double strayed;                /* the largest change that was seen */
} dal__jump;
/* The errors of the callbacks; then only DAL_EUSER.  The text is in mech->error. */
int dal__jump_start(dal__jump *jump, dal_mechanics *mech, int order, double shift,
                    const double *x);
int dal__jump_look(dal__jump *jump, dal_mechanics *mech, size_t step, const double *x);
void dal__jump_save(dal__jump *jump, dal__archive *a);

#endif /* DAL__JUMP_H */
