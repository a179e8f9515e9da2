/* systems.h - what the files of the built-in systems share: the record of a system, and helpers.
 *
 * A system is a section of a file csrc/systems_SUBJECT.c: its functions, then its record, which
 * csrc/systems.c lists in the table.  ctx is the array of its parameters, in the order of the
 * record. */
#ifndef DALEMBERT_SYSTEMS_H
#define DALEMBERT_SYSTEMS_H

#include "system/system.h"

#include <math.h>

enum { MAX_COORDINATES = 5, MAX_PARAMETERS = 5, MAX_INVARIANTS = 4, NAME_SIZE = 32 };

/* The values that a parameter may take; WHOLE: 1, 2, ... up to its entry in most. */
typedef enum range { FINITE, POSITIVE, NOT_NEGATIVE, WHOLE } range;

/* p is the array of the parameters; in outputs of mass and state stand zeros before the call. */
typedef struct builtin {
    const char *name, *help, *description, *source;
    const char *formulas; /* as of a dal_system_def */
    size_t n, m;
    const char *coordinates[MAX_COORDINATES];
    /* Instead of n, m and coordinates where they depend on the parameters: */
    void (*sizes)(const double *p, size_t *n, size_t *m);
    void (*coordinate)(const double *p, size_t i, char text[NAME_SIZE]); /* name of the i-th */
    const char *parameters[MAX_PARAMETERS];
    double defaults[MAX_PARAMETERS];
    range ranges[MAX_PARAMETERS];
    unsigned most[MAX_PARAMETERS];
    int (*check)(const double *p, dal_error *error); /* of parameters together; or NULL */
    void (*mass)(const double *p, double *M); /* M[n*n]; NULL: M = 1, or L is in lagrangian */
    void (*state)(const double *p, double *x);
    dal_potential_fn potential;
    dal_lagrangian_fn lagrangian; /* instead of mass and potential */
    dal_constraint_fn constraint;
    dal_constraint_kind kind;
    int steady;
    dal_exact_fn exact;
    const char *invariants[MAX_INVARIANTS];
    dal_invariant_fn invariant;
} builtin;

/* systems_particles.c */
extern const builtin dal__particle, dal__particle_oscillator, dal__heisenberg;
/* systems_oscillators.c */
extern const builtin dal__contact_oscillator, dal__chaotic, dal__genmass;
/* systems_blades.c */
extern const builtin dal__knife_edge, dal__sleigh, dal__sleigh_contact;
/* systems_rolling.c */
extern const builtin dal__disk, dal__robot, dal__rolling_disc, dal__ball_on_table;
/* systems_vehicles.c */
extern const builtin dal__snakeboard, dal__n_trailer;

static inline void set3(double *a, double a0, double a1, double a2)
{
    a[0] = a0;
    a[1] = a1;
    a[2] = a2;
}

static inline void set4(double *a, double a0, double a1, double a2, double a3)
{
    set3(a, a0, a1, a2);
    a[3] = a3;
}

/* sin(x)/x */
static inline double sinc(double x) { return x == 0.0 ? 1.0 : sin(x) / x; }

#endif /* DALEMBERT_SYSTEMS_H */
