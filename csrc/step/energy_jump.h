/* energy_jump.h - checks of the energy. */
#ifndef DAL__ENERGY_JUMP_H
#define DAL__ENERGY_JUMP_H

#include "geometry/geometry.h"
#include "ground/archive.h"

/* The energy is checked now and then.  It is not if a force acts, if anything depends on time, or
 * for schemes of order 1, which drift by design. */
typedef struct dal__energy_jump {
    bool looking;
    double shift, energy, kinetic; /* of the states' D_eps; at the start; the largest so far */
    size_t step;                   /* where the energy was seen to have jumped; 0: nowhere */
    double change;                 /* by how much */
    double undone;                 /* what else it would have changed by: see scaling.c */
    double strayed;                /* the largest change that was seen */
} dal__energy_jump;
/* The errors of the callbacks; then only DAL_EUSER.  The text is in mech->error. */
int dal__energy_jump_start(dal__energy_jump *jump, dal_mechanics *mech, int order, double shift,
                           const double *x);
int dal__energy_jump_look(dal__energy_jump *jump, dal_mechanics *mech, size_t step,
                          const double *x);
void dal__energy_jump_save(dal__energy_jump *jump, dal__archive *a);

#endif /* DAL__ENERGY_JUMP_H */
