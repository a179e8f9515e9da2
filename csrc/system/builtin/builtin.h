/* builtin.h - what the files of the built-in systems share: the record of a system, and helpers.
 *
 * A system is a section of a file: its functions, then its record, which builtin.c lists in the
 * table.  ctx is the array of its parameters, in the order of the record. */
#ifndef DAL__BUILTIN_H
#define DAL__BUILTIN_H

#include "system/system.h"

#include <math.h>
#include <string.h>

enum { MAX_COORDINATES = 5, MAX_PARAMETERS = 5, MAX_INVARIANTS = 4, NAME_SIZE = 32 };

/* p is the array of the parameters; in outputs of mass and state stand zeros before the call.  A
 * list of names or parameters ends with a NULL. */
typedef struct builtin {
    const char *name, *help, *description, *source;
    const char *formulas; /* as of a dal_system_def */
    size_t m;
    const char *coordinates[MAX_COORDINATES + 1]; /* n of them */
    /* Instead of m and coordinates where they depend on the parameters: */
    void (*sizes)(const double *p, size_t *n, size_t *m);
    void (*coordinate)(const double *p, size_t i, char text[NAME_SIZE]); /* name of the i-th */
    parameter parameters[MAX_PARAMETERS + 1];
    int (*check)(const double *p, dal_error *error); /* of parameters together; or NULL */
    size_t diagonal[MAX_COORDINATES]; /* the number, from 1, of the parameter M_ii; 0: 1 */
    void (*mass)(const double *p, double *M); /* M[n*n], instead of diagonal */
    double start[2 * MAX_COORDINATES];
    void (*state)(const double *p, double *x); /* instead of start */
    dal_potential_fn potential;
    dal_lagrangian_fn lagrangian; /* instead of M and potential */
    dal_constraint_fn constraint;
    dal_constraint_kind kind;
    int steady;
    dal_exact_fn exact;
    const char *invariants[MAX_INVARIANTS + 1];
    dal_invariant_fn invariant;
} builtin;

/* particles.c */
extern const builtin dal__particle, dal__particle_oscillator, dal__heisenberg;
/* oscillators.c */
extern const builtin dal__contact_oscillator, dal__chaotic, dal__genmass;
/* blades.c */
extern const builtin dal__knife_edge, dal__sleigh, dal__sleigh_contact;
/* rolling.c */
extern const builtin dal__disk, dal__robot, dal__rolling_disc, dal__ball_on_table;
/* vehicles.c */
extern const builtin dal__snakeboard, dal__n_trailer;

/* Heads of the callbacks of dalembert.h, with the names that their arguments have there. */
#define POTENTIAL(name) \
    static int name(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
#define CONSTRAINT(name) \
    static int name(double t, const double *q, const double *v, double *phi, double *phi_v, \
                    double *phi_q, double *phi_t, void *ctx)
#define LAGRANGIAN(name) \
    static int name(double t, const double *q, const double *v, double *L, double *L_q, \
                    double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
#define EXACT(name) static int name(double t, const double *x0, double *x, void *ctx)
#define INVARIANT(name) static int name(double t, const double *x, double *values, void *ctx)

/* set3 and set4 are for what every step asks for: set waits until the values are written. */
static inline void set(double *a, size_t count, const double *values)
{
    memcpy(a, values, count * sizeof *a);
}

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

#endif /* DAL__BUILTIN_H */
