/* system.h - a system, and its callbacks as the rest of the library calls them. */
#ifndef DAL__SYSTEM_H
#define DAL__SYSTEM_H

#include "algebra/algebra.h"
#include "dalembert/field.h"
#include "dalembert/inspect.h"

/* The values that a parameter may take; WHOLE: 1, 2, ... up to most. */
typedef enum range { POSITIVE, NOT_NEGATIVE, FINITE, WHOLE } range;

/* A parameter of a built-in system. */
typedef struct parameter {
    const char *name;
    double value; /* the default */
    range range;
    unsigned most;
} parameter;

struct dal_system {
    dal_system_def def;      /* the strings, mass and state point into the arena */
    double *mass;            /* M[n*n], or [n] of masses; NULL for a general Lagrangian, as the */
    double *mass_inverse;    /* next: M^-1, the same */
    double *unit, *per_unit; /* [n] d_i and 1/d_i of residual.h */
    bool diagonal;           /* M is diagonal, and */
    bool masses;             /* given so */
    bool sparse;             /* steps need no matrix of n rows: M is given by masses, constraints
                                are linear, and there is neither V nor a force, or their derivatives
                                are not asked for */
    bool full_newton;        /* except for a step that does not contract: these derivatives are
                                given, and n is small */
    dal_rows *rows;          /* of the sparsity, or NULL */
    size_t *colour, colours; /* [n] and how many, if phi_q is missing too: see evaluator.c */
    dal__pattern *pattern;   /* of mu M^-1 mu^T for these rows, if sparse */
    const struct builtin *record; /* of a built-in system, or NULL */
    size_t parameters;       /* of it: so many doubles at the beginning of ctx, and what is wrong
                                with others (DAL_EINVAL) */
    int (*check)(const dal_system *system, const double *values, dal_error *error);
    size_t ctx_size;         /* of the copy, and */
    const dal_system *like;  /* what a copy was made from, which has to stay */
    dal_parameters_fn refill; /* what else depends on it; NULL: it does not change */
    double *factor;          /* [n*n] of a mass that depends on ctx, or NULL */
    size_t age;              /* how often ctx was changed */
    arena arena;
};

/* The callbacks of a system as the rest of the library calls them: derivatives that the user does
 * not give are differenced, calls are counted.  One evaluator for each thread.  potential_force and
 * constraint may be called directly with their ctx: the hot path does, and counts by itself where
 * that is not the evaluator. */
enum { DAL__CALLBACKS = 4, DAL__OUTPUTS = 7 };
typedef enum dal__moves { MOVES_Q, MOVES_V, MOVES_T } dal__moves;
typedef struct dal__calls { size_t potential, constraint, lagrangian, force; } dal__calls;

typedef struct evaluator {
    const dal_system *system;
    size_t lengths[3];          /* 1, n, m */
    size_t sizes[DAL__CALLBACKS][DAL__OUTPUTS]; /* entries of an output */
    dal_potential_fn potential_force; /* V_q less a positional force; NULL: there is neither */
    void *potential_force_ctx;
    dal_constraint_fn constraint;
    void *constraint_ctx;
    dal_field_fn field;         /* compiled for the system, or NULL */
    bool constant_mass;
    bool dense;                 /* phi_v and phi_q with all entries, of any system: set before */
    bool sparse;                /* of a sparse system, unless dense; */
    const dal_rows *rows;       /* phi_v and phi_q have the entries of these, then and if any */
    const char *refused;        /* the callback for which potential_force or dal__balance failed */
    const double *input;        /* [inputs] of the force and the constraint: */
    double *own_input;          /* these, which are 0 at first, or those of a row */
    double *point, *gradient, *forms; /* scratch of the differences: [n], [n], [m*n] */
    double *nowhere;            /* [n] NaN: the velocity for a force that is positional */
    double *force, *slopes, *drag; /* [n], [n*n] f, f_q, f_v that are added to others */
    dal__calls calls;
} evaluator;

/* Where L and its derivatives are to go; what is NULL is not wanted.  As in dal_lagrangian_fn. */
typedef struct dal__jet {
    double *L, *L_q, *L_v, *L_qq, *L_vq, *L_vv, *L_vt;
} dal__jet;

/* A system of its own with the same definition, whose ctx may be changed. */
int dal__system_copy(dal_system **copy, const dal_system *system, dal_error *error);
/* ctx of such a copy <- parameters[dal_system_parameter_size].  Steppers and what else was made of
 * it know it from their next start.  On failure it is of no use until the next success.
 * DAL_EINVAL, DAL_EDOMAIN, DAL_EUSER. */
int dal__system_change(dal_system *system, const void *parameters, dal_error *error);

/* Whether M is constant; DAL_EINVAL unless it is finite and symmetric; what follows from M, or
 * DAL_EINVAL with the pivot where it is not positive definite. */
static inline bool dal__has_mass(const dal_system_def *def) { return def->mass || def->masses; }
int dal__check_mass(const dal_system_def *def, dal_error *error);
int dal__bind_mass(dal_system *system, dal_error *error);
/* y[n] <- M x, for constant mass. */
void dal__apply_mass(const dal_system *system, const double *x, double *y);
/* A[m*n] <- itself, of which the entries of the sparsity stand at the beginning. */
void dal__expand(const dal_system_def *def, double *A);

void dal__evaluator_reserve(evaluator *e, const dal_system *system, arena *a);
void dal__evaluator_bind(evaluator *e, const dal_system *system);
/* The callback of the constraint, whichever there is; returns what it does. */
int dal__call_constraint(const evaluator *e, double t, const double *q, const double *v,
                         double *phi, double *phi_v, double *phi_q, double *phi_t);
/* own_input <- u[inputs].  DAL_EINVAL. */
int dal__evaluator_input(evaluator *e, const double *u, dal_error *error);

/* Calls that check: status of the callback; DAL_EDOMAIN if an output is not finite.  The text
 * names the callback, the component and the value. */
int dal__potential(evaluator *e, double t, const double *q, double *V, double *V_q, double *V_qq,
                   dal_error *error);
/* phi_t is 0 unless the system is time_dependent, and so is L_vt. */
int dal__constraint(evaluator *e, double t, const double *q, const double *v, double *phi,
                    double *phi_v, double *phi_q, double *phi_t, dal_error *error);
/* Of every system: that of constant mass has the jet of v^T M v / 2 - V. */
int dal__lagrangian(evaluator *e, double t, const double *q, const double *v, const dal__jet *jet,
                    dal_error *error);
/* Of every system: zeros where there is no force. */
int dal__force(evaluator *e, double t, const double *q, const double *v, double *f, double *f_q,
               double *f_v, dal_error *error);

/* A dal_balance_fn of kernel.h, whose ctx is the evaluator: returns what the callback did that did
 * not return 0, and looks at nothing.  Of F_q terms that would be differenced are left out. */
int dal__balance(double t, const double *q, const double *v, double *L_v, double *F, double *L_vq,
                 double *L_vv, double *F_q, double *F_v, void *ctx);

/* Status of a callback that returned this, with a text that names it. */
int dal__refuse(dal_error *error, const char *callback, int returned);

/* How many entries phi_v has as the evaluator gives it. */
size_t dal__entries(const evaluator *e);

/* Whether nothing depends on time, as far as the definition says. */
bool dal__is_autonomous(const dal_system *system);
/* Whether there is a force that may depend on v. */
bool dal__is_dragged(const dal_system *system);
/* Whether momenta enter the steps: see momentum.h. */
bool dal__has_momenta(const dal_system *system);
/* What is compiled for a system, and there is, has to know it as it is.  DAL_EINVAL. */
int dal__check_compiled(const dal_system *system, dal_error *error);

/* f[count] at q; returns 0, or what its callback returned. */
typedef int (*dal__function)(const double *q, double *f, void *ctx);

/* slope[count], stride apart, <- df/dq_j at point[n] by central differences of order 4.
 * value[count] is scratch; point is moved and put back.  Returns what f returned, at once if that
 * is not 0. */
int dal__difference(dal__function f, void *ctx, double *point, size_t j, size_t count,
                    double *value, double *slope, size_t stride);
/* slopes[count*n] <- df/dq at point[n], the same. */
int dal__jacobian(dal__function f, void *ctx, size_t n, double *point, size_t count, double *value,
                  double *slopes);
/* The distance of these points at a coordinate q. */
double dal__spacing(double q);

#endif /* DAL__SYSTEM_H */
