/* dalembert.h - nonholonomic mechanics and its structure preserving integrators.
 *
 * A system is a triple (Q = R^n, L, D): a Lagrangian and velocity constraints mu(q) v = 0 (LC).
 * The library discretises the Lagrange-d'Alembert principle after F. Jimenez and J. Scheurle,
 * "On the discretization of nonholonomic dynamics in R^n" (arXiv 1407.2116), so that the discrete
 * flow stays in D, or in a known deformation D_eps of it, to roundoff.  Words in (parentheses)
 * such as (lambdax) are the LaTeX labels of that paper; its step eps is h here.
 *
 * Rules that hold for every function
 *   1. Order of arguments: the object; then times and steps; then inputs; then states that are
 *      changed in place; then outputs; options; the error record last.
 *   2. The state is x = (q, v), 2n contiguous doubles.  Matrices are row-major; the shape of every
 *      array stands in its comment as [rows*columns].  A trajectory is (N+1) rows (q, v).
 *   3. Functions that can fail return a dal_status: 0 is success, negative is failure.  On failure
 *      every output and every state is as it was, counters excepted.
 *   4. An output pointer that says "or NULL" may be NULL when it is not wanted.
 *   5. The sign and the scale of the multiplier are fixed once: d/dt L_v - L_q = mu^T lambda
 *      (LdAeqs), so lambda is a force and not an impulse.
 *   6. A dal_system is constant after it is made and may be shared by threads as far as its
 *      callbacks may.  Every other object belongs to one thread at a time.  There are no globals.
 *   7. GSL's error handler is never set, changed or provoked.  The one exception is memory: GSL
 *      reports a failed allocation only through its handler, so it allocates only where a flow is
 *      made (but for DAL_FLOW_RODAS): dal_flow_new, dal_stepper_new for "reference",
 *      dal_embedding_new, dal_order_study.  With a handler that returns these return DAL_ENOMEM.
 *
 * This header has systems, schemes, steppers and runs; dalembert/deformation.h has systems made of
 * others, geometry.h the mechanics on D and the reference flow, discrete.h the discrete mechanics,
 * ensemble.h many runs at once, study.h what measures orders, family.h how to make steps of your
 * own. */
#ifndef DALEMBERT_H
#define DALEMBERT_H

#include <stddef.h>

#if defined(__GNUC__)
#define DAL_API __attribute__((visibility("default")))
#else
#define DAL_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* What stands between the two cdef marks is plain declarations; the Python package reads it as
 * its cffi definition, so that the two languages cannot disagree. */

/* <cdef> */
/* ---- ground ---------------------------------------------------------------------------- */

typedef enum dal_status {
    DAL_SUCCESS = 0,
    DAL_STOPPED = 1,       /* an observer or a watch asked to stop; what was computed is valid */
    DAL_EINVAL = -1,       /* an argument is NULL, out of range or not finite */
    DAL_ENOMEM = -2,       /* memory could not be allocated, or its size overflows */
    DAL_EUSER = -3,        /* a callback returned a negative number */
    DAL_EDOMAIN = -4,      /* a callback returned a positive number, NaN or Inf, or (seen when a
                              stepper starts, and by the check) wrote nothing */
    DAL_ESINGULAR = -5,    /* a matrix that has to be invertible is not, to working precision */
    DAL_ENOCONV = -6,      /* an iteration did not converge */
    DAL_EOFFD = -7,        /* initial data do not satisfy the constraint */
    DAL_EUNSUPPORTED = -8, /* the request is valid and this version does not provide it */
    DAL_EIO = -9,          /* a file cannot be read or written */
    DAL_EZENO = -10        /* events accumulate: there are too many in one step */
} dal_status;

/* What went wrong, in words with the numbers; text is empty on success.  Functions that make
 * objects fill the caller's, which may be NULL; an object keeps that of its last failure.  If it is
 * about a number of a callback, text[begin] to text[end] name it: output ("V_q"), row, column.  If
 * it is about constraints that depend on others, rows > 0: row dependent[0] of mu is the sum of
 * factor[k] times row dependent[k], 0 < k < rows, and 0 for rows = 1; a longer sum is cut off. */
typedef struct dal_error {
    int status;
    char text[508];
    const char *output; /* or NULL */
    size_t row, column, begin, end;
    double value;
    size_t rows, dependent[8];
    double factor[8];
} dal_error;

/* "major.minor.patch" of the library that is running, between releases with "+" and the commit;
   a line of text for a dal_status. */
DAL_API const char *dal_version(void);
DAL_API const char *dal_strerror(int status);

/* Asked some twenty times a second by what may compute for long, with how far it is; there it is
 * said in what.  Return 0 to go on, > 0 to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_watch_fn)(double far, void *ctx);

/* ---- system ---------------------------------------------------------------------------- */

/* Callbacks.  Inputs are read only: the time t, q[n], v[n].  An output that is NULL is not wanted.
 * Return 0; or > 0 if (t, q, v) is outside the domain of the functions (the step that asked is
 * refused, DAL_EDOMAIN); or < 0 to stop (DAL_EUSER).  ctx is the pointer of the definition and is
 * never read here.  The formulas of this library are written without t where it only stands for
 * the moment at which all that is in them is evaluated. */

/* V; V_q[n] = dV/dq_i; V_qq[n*n] = d2V/dq_i dq_j.  The Lagrangian is v^T M v / 2 - V. */
typedef int (*dal_potential_fn)(double t, const double *q, double *V, double *V_q, double *V_qq,
                                void *ctx);

/* phi[m], the constraint phi(t, q, v) = 0, which is mu(t, q) v for linear constraints; phi_v[m*n] =
 * dphi_a/dv_i, which is mu for them; phi_q[m*n] = dphi_a/dq_j, which is N(q, v) = d(mu v)/dq for
 * them; phi_t[m] = dphi_a/dt, which is d(mu v)/dt for them.  Of a system with a sparsity phi_v and
 * phi_q have the entries of that alone. */
typedef int (*dal_constraint_fn)(double t, const double *q, const double *v, double *phi,
                                 double *phi_v, double *phi_q, double *phi_t, void *ctx);

/* A constraint that depends on inputs u[inputs] as well, such as v - u = 0.  They are constant over
 * a step; where they change D does, and v jumps: see dal_stepper_input. */
typedef int (*dal_driven_fn)(double t, const double *q, const double *v, const double *u,
                             double *phi, double *phi_v, double *phi_q, double *phi_t, void *ctx);

/* A general normal Lagrangian, L_vv positive definite: L; L_q[n]; L_v[n]; L_qq[n*n]; L_vq[i*n+j] =
 * d2L/dv_i dq_j; L_vv[n*n]; L_vt[n] = d2L/dv_i dt. */
typedef int (*dal_lagrangian_fn)(double t, const double *q, const double *v, double *L, double *L_q,
                                 double *L_v, double *L_qq, double *L_vq, double *L_vv,
                                 double *L_vt, void *ctx);

/* A generalized force, d/dt L_v - L_q = f + mu^T lambda, which may depend on inputs u[inputs]:
 * f[n]; f_q[i*n+j] = df_i/dq_j; f_v[i*n+j] = df_i/dv_j. */
typedef int (*dal_force_fn)(double t, const double *q, const double *v, const double *u, double *f,
                            double *f_q, double *f_v, void *ctx);

/* mass[n*n] (or [n] of masses) and state[2n] <- those of the definition for the parameters at ctx.
 * One that it does not have is NULL; one that does not depend on them may be left as it is. */
typedef int (*dal_parameters_fn)(double *mass, double *state, const void *ctx);

/* x[2n] <- the exact state at time t of the solution that starts in x0[2n] at time 0. */
typedef int (*dal_exact_fn)(double t, const double *x0, double *x, void *ctx);

/* values[invariants] <- the first integrals at x[2n] and time t, energy not among them. */
typedef int (*dal_invariant_fn)(double t, const double *x, double *values, void *ctx);

typedef enum dal_constraint_kind {
    DAL_LINEAR = 0,    /* phi = mu(t, q) v; the residual is phi_v v, only the check asks for phi */
    DAL_AFFINE = 1,    /* phi = mu(t, q) v + a(t, q), beyond the paper as the next */
    DAL_NONLINEAR = 2  /* any phi(t, q, v) with phi_v of full rank, and with the reaction phi_v^T
                          lambda (Chetaev), beyond the paper; a phi that is quadratic in v has no
                          D at rest, where phi_v vanishes */
} dal_constraint_kind;

/* Outputs that a callback does not provide; they are replaced by central differences.  These are
 * for functions that vary over 1 or more in q, as sines of angles do; 1e-12 below is for |q| up to
 * about 10, and beyond, also for an angle of many turns, it becomes about (1e-16 |q|)^(4/5). */
typedef enum dal_missing {
    DAL_MISSING_V_Q = 1,   /* costs accuracy: V_q is then good to about 1e-12 relative */
    DAL_MISSING_V_QQ = 2,  /* costs Newton's speed only */
    DAL_MISSING_PHI_Q = 4, /* lambda(q, v) and the reference flow are then good to about 1e-12 */
    DAL_MISSING_L_QQ = 8,  /* costs Newton's speed only */
    DAL_MISSING_L_VQ = 16, /* lambda(q, v) and the reference flow are then good to about 1e-12 */
    DAL_MISSING_L_VV = 32, /* the same, and the metric of projections */
    DAL_MISSING_F_Q = 64,  /* costs Newton's speed only */
    DAL_MISSING_F_V = 128, /* costs Newton's speed only */
    DAL_MISSING_PHI_T = 256, /* as phi_q, and for functions that vary over 1 or more in t */
    DAL_MISSING_L_VT = 512   /* the same */
} dal_missing;

struct dal_compiled; /* dalembert/kernel.h */

/* Which entries of phi_v and of phi_q may be other than 0: those of both together, by rows, and in
 * each row by columns, both ascending. */
typedef struct dal_sparsity {
    size_t entries;
    const size_t *row, *column; /* [entries] */
} dal_sparsity;

/* In a steady system mu depends only on coordinates that no reaction pushes, those i with row i of
 * M^-1 mu^T zero, as on the heading of a blade.  Steps where V does not act at q~' are then
 * linear. */
typedef enum dal_steady {
    DAL_STEADY_DECLARED = 1, /* every step looks whether it is true, with an evaluation of mu */
    DAL_STEADY_PROVED = 2,   /* nothing looks: for code that was derived from formulas */
    DAL_STEADY_EVEN = 3      /* nor does V push a coordinate that mu depends on: it goes evenly */
} dal_steady;

/* The definition of a system, filled by the caller, zero-initialised.  dal_system_new copies the
 * struct, the masses, the sparsity, the names and the state; ctx is borrowed, or copied if ctx_size
 * says how many bytes it has. */
typedef struct dal_system_def {
    size_t n;                       /* number of coordinates, n >= 1 */
    size_t m;                       /* number of constraints, 0 <= m <= n */
    const double *mass;             /* M[n*n], constant, symmetric, positive definite; or NULL */
    const double *masses;           /* [n] of a diagonal M, instead of mass; or NULL */
    dal_lagrangian_fn lagrangian;   /* instead of mass and potential; or NULL */
    dal_potential_fn potential;     /* or NULL: V = 0 */
    dal_constraint_fn constraint;   /* NULL if m = 0; else this or */
    dal_driven_fn driven;           /* one that depends on inputs */
    dal_constraint_kind kind;
    const dal_sparsity *sparsity;   /* or NULL: all entries may be other than 0.  With it steps take
                                       time and memory in proportion to n where there are masses,
                                       and the constraints are linear and touch few coordinates
                                       each.  V_qq, f_q and f_v then serve only steps that do not
                                       converge without, where all are given and n <= 500; else h
                                       has to resolve what V and f make oscillate or decay */
    dal_force_fn force;             /* or NULL: none */
    size_t inputs;                  /* of the force and of driven: motors, steering, ... */
    unsigned missing;               /* sum of dal_missing */
    void *ctx;
    const char *name;               /* or NULL: "system".  What follows may all be left out */
    const char *help;               /* one line */
    const char *description;        /* some sentences: what coordinates and parameters are */
    const char *source;             /* where it is from, in the literature */
    const char *formulas;           /* lines: "L = ...", the constraints "... = 0", and "where NAME
                                       = ..." for what else is in them or in names of invariants;
                                       v_x is the velocity of x, a blank a product */
    const char *const *coordinates; /* [n] names, or NULL: q0, q1, ... */
    const char *const *input_names; /* [inputs], or NULL: u0, u1, ... */
    const double *state;            /* [2n] initial data to start from by default, or NULL */
    dal_exact_fn exact;             /* or NULL */
    size_t invariants;              /* number of first integrals besides the energy */
    const char *const *invariant_names; /* [invariants] */
    dal_invariant_fn invariant;
    size_t ctx_size;                /* 0: ctx is borrowed; else it is copied */
    const struct dal_compiled *compiled; /* the step routine compiled for this system, or NULL; only
                                       for constant mass, linear constraints, no force, nothing
                                       missing.  It makes the steps of moved nodes */
    int steady;                     /* a dal_steady or 0; only for constant mass, linear
                                       constraints, and not time_dependent */
    int time_dependent;             /* 1: a callback besides the force depends on t; phi_t and L_vt
                                       are then asked for, and 0 otherwise */
    int positional;                 /* 1: the force depends on t, q and u alone.  It enters steps
                                       as V_q does; they call it with NaN for v, and without f_v */
    dal_parameters_fn parameters;   /* what else depends on ctx, for ensembles, which copy it; or
                                       NULL: nothing does */
} dal_system_def;

typedef struct dal_system dal_system;

/* *system <- a system, or untouched on failure.
 * DAL_EINVAL (sizes, missing or superfluous parts, mass matrix not finite, not symmetric or not
 * positive definite, a sparsity out of order: the text names the entry; a kernel from another
 * version of kernel.h; steady where it may not be), DAL_ENOMEM. */
DAL_API int dal_system_new(dal_system **system, const dal_system_def *def, dal_error *error);

/* NULL is allowed.  Objects made from a system must be freed before it. */
DAL_API void dal_system_free(dal_system *system);

/* The system that comes with the library under name ("particle", "knife_edge", ...; - and _ are
 * the same), with count parameters changed from their defaults: names[count], values[count].
 * DAL_EINVAL (unknown name or parameter: the text lists what there is; a parameter out of its
 * range), DAL_ENOMEM. */
DAL_API int dal_system_builtin(dal_system **system, const char *name, const char *const *names,
                               const double *values, size_t count, dal_error *error);

/* Number of built-in systems, the name of the i-th and one line about it; NULL: i is too large. */
DAL_API size_t dal_builtin_count(void);
DAL_API const char *dal_builtin_name(size_t i);
DAL_API const char *dal_builtin_help(size_t i);

/* n and m; the sum of dal_missing; its name, and one line about it. */
DAL_API size_t dal_system_n(const dal_system *system);
DAL_API size_t dal_system_m(const dal_system *system);
DAL_API unsigned dal_system_missing(const dal_system *system);
DAL_API const char *dal_system_name(const dal_system *system);
DAL_API const char *dal_system_help(const dal_system *system);
/* As of the definition; "" where it says nothing. */
DAL_API const char *dal_system_description(const dal_system *system);
DAL_API const char *dal_system_source(const dal_system *system);
DAL_API const char *dal_system_formulas(const dal_system *system);
DAL_API const char *dal_system_coordinate(const dal_system *system, size_t i); /* NULL: i >= n */
DAL_API size_t dal_system_inputs(const dal_system *system);
DAL_API const char *dal_system_input_name(const dal_system *system, size_t i); /* or NULL */
/* M[n*n], which may be NULL, <- the mass matrix.  DAL_EUNSUPPORTED if it is not constant. */
DAL_API int dal_system_mass(const dal_system *system, double *M);
/* The sparsity of the definition, or NULL. */
DAL_API const dal_sparsity *dal_system_sparsity(const dal_system *system);
DAL_API dal_constraint_kind dal_system_kind(const dal_system *system);
DAL_API int dal_system_is_forced(const dal_system *system); /* 1: there is a generalized force */
DAL_API int dal_system_is_driven(const dal_system *system); /* 1: constraints depend on inputs */
DAL_API int dal_system_is_time_dependent(const dal_system *system); /* as of the definition */

/* Parameters of a built-in system; a system of the user's own has none. */
DAL_API size_t dal_system_parameters(const dal_system *system);
DAL_API const char *dal_system_parameter_name(const dal_system *system, size_t i); /* or NULL */
DAL_API double dal_system_parameter(const dal_system *system, size_t i);           /* or NaN */
/* Bytes of what ensembles may give for each member instead: ctx, if it was copied; the values of
 * the parameters, in their order, of a built-in system; else 0. */
DAL_API size_t dal_system_parameter_size(const dal_system *system);

/* x[2n] <- the default initial data.  DAL_EUNSUPPORTED if there are none. */
DAL_API int dal_system_state(const dal_system *system, double *x);

/* x[2n] <- the exact state a time t after x0[2n], which must lie in D; where there is a force, or
 * the system depends on time, of the solution that starts at time 0.
 * DAL_EUNSUPPORTED if the system carries no exact solution; DAL_EUSER, DAL_EDOMAIN, DAL_ENOMEM. */
DAL_API int dal_system_exact(const dal_system *system, double t, const double *x0, double *x);

/* First integrals besides the energy: how many, their names, values[count] at x[2n] and time t.
 * DAL_EUNSUPPORTED if there are none; DAL_EUSER, DAL_EDOMAIN, DAL_ENOMEM. */
DAL_API size_t dal_system_invariants(const dal_system *system);
DAL_API const char *dal_system_invariant_name(const dal_system *system, size_t i); /* or NULL */
DAL_API int dal_system_invariant(const dal_system *system, double t, const double *x,
                                 double *values);

/* ---- schemes --------------------------------------------------------------------------- */

/* Adaptive methods for the ODE on D. */
typedef enum dal_flow_method {
    DAL_FLOW_RK8PD = 0,   /* Prince-Dormand 8(7), the default */
    DAL_FLOW_MSADAMS = 1, /* multistep Adams, orders 1 to 12 */
    DAL_FLOW_RODAS = 2    /* Rosenbrock, order 4(3), with a differenced Jacobian, for stiff
                             potentials */
} dal_flow_method;

/* One beta-scheme with step fraction * h. */
typedef struct dal_substep {
    double beta;     /* in [0, 1] */
    double fraction; /* not 0; the fractions of a record sum to 1 */
} dal_substep;

/* What a run shows of a pair of nodes (q_{k-1}, q_k) (ros). */
typedef enum dal_nodes {
    DAL_MOVED_NODES = 0, /* states at q~_k = (1-beta) q_{k-1} + beta q_k: keeps D */
    DAL_KEPT_NODES = 1   /* states at the nodes q_k: keeps D_eps = {phi(q - (1-beta) h v, v) = 0}
                            at the time of q~_k */
} dal_nodes;

struct dal_family; /* dalembert/family.h */

/* A scheme is a record, and its family makes the steps.  To make one: zero-initialise, then set
 * beta, or substeps and count; or family and data.  A stepper copies what it points to. */
typedef struct dal_scheme {
    char name[40];
    const char *help;             /* one line, or NULL */
    const char *reference;        /* where it comes from, or NULL */
    const struct dal_family *family; /* NULL: beta-schemes one after the other */
    const void *data;             /* what another family needs: a dal_pair, a dal_flow_scheme */
    double beta;                  /* of the only sub-step, for count = 0 */
    size_t count;
    const dal_substep *substeps;  /* [count] */
    dal_nodes nodes;              /* kept nodes need a single sub-step */
    int order;                    /* p: q, v have local error O(h^(p+1)); 0: nothing is promised */
    int multiplier_order;         /* s of the scheme's own multipliers at the end of the step */
    int symmetric;                /* 1: its own adjoint on D */
} dal_scheme;

/* *scheme <- the record called name: "explicit", "midpoint", "endpoint", a number in [0, 1] (beta),
 * "leapfrog", "leapfrog-mirror", BASE"-nodes" (kept nodes; BASE one of the first four), and
 * BASE"-suzuki4", "-yoshida4", "-kl6", "-kl8", "-ss10" (BASE leapfrog or midpoint); "bm4", "bm6";
 * "pair:A:B", the velocity integrator of two maps rho^A for L_d and rho^B for D_d; "reference", the
 * flow of the ODE on D.  - and _ are the same.
 * DAL_EINVAL: there is no such scheme, the text lists what there is. */
DAL_API int dal_scheme_find(dal_scheme *scheme, const char *name, dal_error *error);

/* The table of named schemes: how many, and the i-th (DAL_EINVAL if i is too large). */
DAL_API size_t dal_scheme_count(void);
DAL_API int dal_scheme_at(dal_scheme *scheme, size_t i);

/* The name of the family that makes its steps: "beta", "pair", "flow", or your own. */
DAL_API const char *dal_scheme_family(const dal_scheme *scheme);

/* 1 if every step of scheme on system is a sequence of linear solves, without iteration: every
 * sub-step has beta = 0, the mass is constant, no force, and the constraints are not nonlinear;
 * else 0. */
DAL_API int dal_scheme_is_explicit(const dal_scheme *scheme, const dal_system *system);

/* *shift <- 1 - beta of a record with a single sub-step: its D_eps has shift (1 - beta) h.
 * DAL_EUNSUPPORTED for a record with several. */
DAL_API int dal_scheme_shift(const dal_scheme *scheme, double *shift);

/* *eps <- one for reversible steps (dal_options) of scheme: 0.8 / sum_j |fraction_j| of its
 * sub-steps, at most 0.2.
 * DAL_EUNSUPPORTED unless it is a composition that is its own adjoint, read backwards, of more than
 * two sub-steps, with moved nodes: as bm6, leapfrog-kl8. */
DAL_API int dal_scheme_eps(const dal_scheme *scheme, double *eps, dal_error *error);

/* What the steps of the scheme "reference" are made with: its data, or NULL for the defaults. */
typedef struct dal_flow_scheme {
    dal_flow_method method;
    double tolerance; /* as of dal_flow_new; 0: 1e-13 */
} dal_flow_scheme;

/* Zero-initialised: the defaults. */
typedef struct dal_options {
    int max_iterations; /* of the full Newton in a step; 0: 50 */
    double tolerance;   /* 0: steps of h.  Else error-controlled steps, of compositions with moved
                           nodes: about what the error of the state, relative to 1 + |x_i|, may be
                           after a time of 100 or some hundred steps; in [1e-14, 0.1] */
    double h_max;       /* the longest of them; 0: any */
    int keep_energy;    /* 1: each step keeps the energy of the start, or of the last reset, to
                           roundoff, by scaled velocities: q', w by the scheme from (q, (1+s) v) and
                           v' = (1+s') w, with s by the energy of the plain step and s' by that of
                           (q', w).  It costs two steps and more symmetric steps of h/2 would lead
                           nearer to the motion: it is for those who want the energy.  Where |s| or
                           |s'| is above 1/2 the plain step is taken, and the next one has to mend
                           the energy; unscaled counts these.  For symmetric schemes of the family
                           beta with moved nodes, linear constraints, no force, nothing that depends
                           on time, and L of second degree in v */
    double eps;         /* 0: none.  Else reversible steps, which exclude the above: each is of
                           h = eps / rho, with rho a variable that follows the rate of the motion,
                           so that the energy does not drift where steps of one size are too long
                           for close approaches; at most 0.2, see dal_scheme_eps.  The largest
                           speed and rate so far are scales of it: until they are found, at the
                           start and in the first encounters, steps are not reversible */
} dal_options;

/* What is done with initial data (dal_stepper_start). */
typedef enum dal_consistency {
    DAL_CHECK = 0,   /* DAL_EOFFD unless |phi^a| is at most 1e-8 of the sizes of its terms, or
                        roundoff; then mended */
    DAL_PROJECT = 1, /* projected in the metric M */
    DAL_ASSUME = 2   /* used as they are */
} dal_consistency;

/* How a run with kept nodes starts.  Such a scheme refuses DAL_INITIAL_NONE, others all else. */
typedef enum dal_initial {
    DAL_INITIAL_NONE = 0,
    DAL_INITIAL_D = 1,       /* data in D, used as they are: the first step jumps to D_eps (E12) */
    DAL_INITIAL_D_EPS = 2,   /* data in D_eps */
    DAL_INITIAL_PROJECT = 3, /* data in D, the velocity projected onto D_eps */
    DAL_INITIAL_SHIFT = 4    /* data in D, q moved to the node q + (1-beta) h v: the run is that of
                                the moved nodes, seen at the nodes */
} dal_initial;

/* What a stepper has done since it was started. */
typedef struct dal_stats {
    size_t steps;
    size_t substeps;            /* of the record, in these steps; a fused pair is one */
    size_t iterations;          /* Newton iterations */
    size_t constraint_calls, potential_calls;
    size_t lagrangian_calls, force_calls;
    size_t evaluations;         /* of the vector field, by the reference flow */
    size_t corrections;         /* final corrections that took an evaluation of their own */
    size_t full_newtons;        /* sub-steps that the modified Newton handed to the full one; where
                                   all are solved by the full one, that had to start anew */
    size_t rejected;            /* error-controlled or reversible steps that were made again,
                                   shorter */
    size_t uncontrolled;        /* those that are longer than the tolerance allows, as their
                                   estimated error is roundoff, whatever their length */
    size_t scaled, unscaled;    /* of keep_energy: steps that were made again with scaled
                                   velocities; and that could not be, so that the plain step was
                                   taken, and the energy not kept there; or where states at
                                   events and output times do not have it */
    size_t resets;              /* of rho to where it belongs, once its scales are known: these
                                   steps are not reversible, as rho had left the rate of the motion,
                                   or the step was made again; with a smaller eps there are less */
    size_t halvings;            /* Newton steps halved because a callback left its domain */
    double worst_residual;      /* largest residual, as dal_relative_residual, after any step of
                                   the set that the scheme keeps */
    double initial_residual;    /* that of the data given to dal_stepper_start */
    double initial_correction;  /* how far these were moved, in the mass metric */
    unsigned differenced;       /* dal_missing: derivatives that were differenced */
    size_t jump_step;           /* the step after which the energy was first seen to have changed,
                                   by jump, by more than half of the largest kinetic energy: h is
                                   too large.  0: it was not.  What keep_energy has undone counts
                                   as a change.  Looked at in every 64th step and at
                                   the end of dal_integrate, where there is no force, nothing
                                   depends on time, the constraints are linear, and the scheme is
                                   not of order 1 */
    double jump, largest_kinetic;
    double least_pivot;         /* of C = mu M^-1 mu^T, beside the largest that the pivot of its row
                                   has been, as 1/(C^-1)_aa; 1: none was less.  Near 0 the
                                   constraints lose rank there, and branches of the motion may
                                   meet.  Looked at where steps that choose their size are much
                                   shorter than usual; and in steps of h where det C falls, or the
                                   full Newton iteration is needed, not in those of your families */
    double least_pivot_t;       /* when, and */
    size_t least_pivot_rows;    /* the sum of 2^a over the rows a that have part in it, a < 52; 0:
                                   they are not known */
    size_t rank_doubts;         /* looks at which a pivot was below the tolerance (ten times that of
                                   "reference"), or passes 0 within about two steps of h */
    double least_step;          /* of steps that choose their size: the shortest, beside the mean of
                                   those before; 1 for others */
    double least_step_t;        /* when */
    double error;               /* about how large the error of the state is at the end of a run,
                                   relative to its size: of each q the way that it has gone, of each
                                   v its largest value.  From `remade` steps of another size, that
                                   were made beside those of the run; whole = 1: the whole run was
                                   made again, or its first 131072 steps, or what follows its last
                                   reset.  Else samples were, whose errors are added up, which is
                                   mostly more than the error.  Above 0.05 with whole = 1, h is too
                                   large; INFINITY: steps of h/2 cannot be made, and there is
                                   reason to doubt those of h.  NAN: no estimate, see dal_run */
    size_t remade, whole;
} dal_stats;

/* A system, a scheme, and a state that is stepped.  A step never allocates.  After every step the
 * residual of the set that the scheme keeps, as dal_relative_residual finds it, is at most 4 n u
 * with u = 2^-53. */
typedef struct dal_stepper dal_stepper;

/* options may be NULL.  DAL_EINVAL (a record or an option that is not valid; the text says what),
 * DAL_EUNSUPPORTED (error-controlled steps without an estimate; reversible ones where there is a
 * force, M depends on q, or the system on time, constraints are not linear, or sparse), DAL_ENOMEM.
 */
DAL_API int dal_stepper_new(dal_stepper **stepper, const dal_system *system,
                            const dal_scheme *scheme, const dal_options *options,
                            dal_error *error);
DAL_API void dal_stepper_free(dal_stepper *stepper);
DAL_API const dal_error *dal_stepper_error(const dal_stepper *stepper);

/* Start from x[2n] (InitialData) at time t0 with step h (negative: backwards; 0 is DAL_EINVAL).  x
 * is not changed; the state used is that of dal_stepper_state.  A change of h or of the state is a
 * new start.  On failure the stepper is as it was.
 * Error-controlled steps begin with h; if that is infinite they find their first size, in its
 * direction.  Reversible ones always find it, and h has to be INFINITY or -INFINITY; DAL_EDOMAIN if
 * nothing at x says how fast the motion goes, as on a straight line, or at rest.
 * DAL_EINVAL (also a system declared steady that is seen not to be), DAL_EOFFD, DAL_ESINGULAR,
 * DAL_ENOCONV, DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_stepper_start(dal_stepper *stepper, double t0, double h, const double *x,
                              dal_consistency consistency, dal_initial initial);

/* The inputs are u[inputs] in the steps that follow, until they are changed again; 0
 * in a new stepper.  Constant over a step (a zero-order hold), they cost no scheme its order.  A
 * change costs one evaluation of the force, which the predictor of the next step may see.
 * Where constraints depend on them they are also those of a start, in whose D the data lie; and
 * the step after a change begins with a jump, as at an impact: v <- the velocity of the new D on
 * v + M^-1 mu^T R^m (dal_project).  Its impulse counts as one of the step.  The state stays in the
 * old D until then.  Kept nodes, reversible steps and keep_energy are DAL_EUNSUPPORTED there; if L
 * is not of second degree in v dal_stepper_start is.
 * DAL_EINVAL (NULL, not finite), and the stepper is as it was. */
DAL_API int dal_stepper_input(dal_stepper *stepper, const double *u);

/* Error-controlled and reversible steps do not go beyond the time t, and one of them ends there to
 * the bit; until another time, or an infinite one, is given.  A step from there is DAL_EINVAL.  Of
 * reversible steps only the last is shortened for that, and it alone is not reversible; output
 * times of a run do not touch them.
 * DAL_EINVAL (not started; t lies behind), DAL_EUNSUPPORTED (steps of h). */
DAL_API int dal_stepper_until(dal_stepper *stepper, double t);

/* The inputs of the next step, u[inputs]; the current state x[2n]; its time, t0 + k h; h, of the
 * last step if their size varies.  Arrays are borrowed, and valid until the stepper is freed; where
 * the state stands may change with steps. */
DAL_API const double *dal_stepper_inputs(const dal_stepper *stepper);
DAL_API const double *dal_stepper_state(const dal_stepper *stepper);
DAL_API double dal_stepper_time(const dal_stepper *stepper);
DAL_API double dal_stepper_h(const dal_stepper *stepper);
DAL_API void dal_stepper_stats(const dal_stepper *stepper, dal_stats *stats);

/* One step (DAELd1, DAELd2).  reaction[m] (or NULL) <- the scheme's own multiplier, sum_j h_j
 * lambda_j / h, a force (LamLd1, lamdaGR).
 * DAL_EINVAL (not started), DAL_ESINGULAR, DAL_ENOCONV, DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_step(dal_stepper *stepper, double *reaction);

/* steps steps.  reaction[m] (or NULL) <- the mean over them.  If one fails the stepper stands after
 * the last good one and *done (or NULL) says how many were good; reaction is then untouched, and so
 * it is where it alone overflows (DAL_EDOMAIN, after all steps). */
DAL_API int dal_advance(dal_stepper *stepper, size_t steps, double *reaction, size_t *done);

/* What the next step depends on, as numbers: how many they are, 0 if the steps of this scheme
 * cannot be resumed (multistep flows); values[dal_stepper_saved] <- them; and from them, also into
 * a stepper of the same system and scheme in another process, whose steps are then bit for bit
 * those of the one that was saved.  On failure the stepper is as it was.
 * DAL_EINVAL (not started; of another version, system or scheme; no such number),
 * DAL_EUNSUPPORTED. */
DAL_API size_t dal_stepper_saved(const dal_stepper *stepper);
DAL_API int dal_stepper_save(dal_stepper *stepper, double *values);
DAL_API int dal_stepper_restore(dal_stepper *stepper, const double *values, size_t count);

/* ---- runs ------------------------------------------------------------------------------ */

/* Called at every stored state; step counts from the start of the stepper.  Return 0 to go on, > 0
 * to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_observer_fn)(size_t step, double t, const double *x, void *ctx);

/* u[inputs] <- the inputs of the steps that begin at step, where the time is t and the state x[2n]:
 * a controller.  Returns as an observer. */
typedef int (*dal_control_fn)(size_t step, double t, const double *x, double *u, void *ctx);

/* Called in the order of time, after the step in which it happened, and before its state is stored:
 * event number `event` at time t, in step `step`, counted as by an observer; x[2n] the state there;
 * after[2n] that after its reset, or NULL.  Returns as an observer. */
typedef int (*dal_happened_fn)(size_t event, size_t step, double t, const double *x,
                               const double *after, void *ctx);

/* A run of a stepper: zero-initialise, set what is above done, and let it go. */
typedef struct dal_run {
    dal_stepper *stepper;   /* started */
    size_t steps, stride;   /* every stride-th state is stored; steps is a multiple of stride */
    double *x;              /* [(steps/stride + 1)*2n] or NULL: the states, row 0 where it begins */
    double *reactions;      /* [(steps/stride)*m] or NULL: the mean reaction over each interval,
                               which belongs to its middle, with the impulses of jumps; NaN for a
                               scheme without multipliers */
    double *inputs;         /* [ceil(steps/hold)*inputs] or NULL: row k has those of the steps
                               k hold, ..., (k+1) hold - 1 of the run; NULL: as the stepper has */
    size_t hold;            /* 0 is 1 */
    dal_control_fn control; /* or NULL: writes the rows of inputs, each when its steps begin */
    void *control_ctx;
    dal_observer_fn observer; /* or NULL */
    void *observer_ctx;
    dal_watch_fn watch;     /* or NULL: asked within steps that take long, with their time */
    void *watch_ctx;
    struct dal_events *events; /* of the stepper, see dalembert/events.h; or NULL */
    dal_happened_fn happened; /* or NULL */
    void *happened_ctx;
    const double *times;    /* [time_count], of the run, one after the other; needs events */
    size_t time_count;
    double *at;             /* [time_count*2n]: the states at times, in the set the scheme keeps */
    struct dal_journal *journal; /* see dalembert/journal.h; or NULL */
    int unchecked;          /* 1: there is no estimate of the error.  Else a run of steps of h, by a
                               scheme that has an order, makes one, with other steps: for a run of
                               less than 1000 steps, or whose samples are suspect, with 2h, 4h or 8h
                               after its end, and where these do not clear it with h/2.  No bit of
                               the run depends on it, and observers, controls and events are not
                               asked again */
    size_t checks;          /* steps that are left to be made again, when all are made: the run may
                               go on until it is 0, and then the estimate stands in dal_stats */
    double until;           /* of steps whose size varies: the run ends there, or after `steps`; x
                               has room for one row more, the last, which is stored in any case */
    double held;            /* of steps whose size varies, instead of hold: row k of inputs is for
                               the time from t_begin + k held to t_begin + (k+1) held */
    double *row_times;      /* of steps whose size varies, or NULL: the times of the rows of x */
    double t_begin, row_time; /* theirs, set by the run: where it began; of the last row, */
    size_t row_step;          /* its step; */
    size_t handed, row_inputs; /* rows of inputs that were handed over, and before that row; for
                               a stepper that has the first row already the caller may set handed
                               to 1: control is not asked for it */
    size_t done;            /* steps made */
    size_t stored;          /* rows of x that are valid */
    size_t timed;           /* rows of at that are valid */
    int ended;              /* 1: a terminal event has ended the run: the state there is the last
                               row of x, and the stepper stands before the step */
    double t_end;           /* when it did */
} dal_run;

/* At most budget steps more of the run: so the caller can look at clocks and signals in between.
 * The run is over when done is steps.  budget does not change a bit of what is stored.  After
 * DAL_STOPPED, or a failure that the caller has mended, it may go on.
 * DAL_STOPPED, DAL_EINVAL and the errors of dal_step. */
DAL_API int dal_run_go(dal_run *run, size_t budget);

/* A whole run in one call; *done (or NULL) <- steps made and stored. */
DAL_API int dal_integrate(dal_stepper *stepper, size_t steps, size_t stride, double *x,
                          double *reactions, dal_observer_fn observer, void *ctx, size_t *done);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_H */
