/* dalembert.h - nonholonomic mechanics and its structure-preserving integrators.
 *
 * A system is a triple (Q = R^n, L, D): a Lagrangian and velocity constraints mu(q) v = 0 (LC).
 * The library discretises the Lagrange-d'Alembert principle after F. Jimenez and J. Scheurle, "On
 * the discretization of nonholonomic dynamics in R^n" (arXiv 1407.2116).  The discrete flow stays
 * in D, or in a known deformation D_eps of D, to roundoff.  Words in (parentheses) such as
 * (lambdax) are the LaTeX labels of that paper; its step eps is h here.
 *
 * Rules that hold for every function
 *   1. Order of arguments: the object; then times and steps; then inputs; then states that are
 *      changed in place; then outputs; options; the error record last.
 *   2. The state is x = (q, v), 2n contiguous doubles.  Matrices are row-major; comments give the
 *      shape of every array as [rows*columns].  A trajectory is (N+1) rows (q, v).
 *   3. Functions that can fail return a dal_status: 0 is success, negative is failure.  On failure
 *      every output and every state is unchanged, except counters.
 *   4. An output pointer marked "or NULL" may be NULL.
 *   5. The multiplier lambda is a force, not an impulse: d/dt L_v - L_q = mu^T lambda (LdAeqs).
 *      This fixes its sign and its scale.
 *   6. A dal_system is constant, and threads may share it if its callbacks are thread-safe.  Use
 *      any other object in one thread at a time.  There are no global variables.
 *   7. The library never sets, changes or calls GSL's error handler.  GSL itself calls it only if
 *      an allocation fails.  It allocates memory in dal_flow_new (except for DAL_FLOW_RODAS), in
 *      dal_stepper_new for "reference", in dal_embedding_new and in dal_order_study.  If the
 *      handler returns, these functions return DAL_ENOMEM.
 *
 * This header has systems, schemes, steppers and simple runs.  In the folder dalembert,
 * inspect.h has the properties of systems and schemes; stepper.h diagnostics and saved states;
 * run.h runs with inputs and output times; events.h the events of runs; taylor.h dense output and
 * derivatives; journal.h files of runs that can be resumed; ensemble.h many runs at once;
 * geometry.h the mechanics on D and the reference flow; discrete.h discrete mechanics;
 * deformation.h deformed systems; study.h measured orders; family.h the interface for your own
 * steps. */
#ifndef DALEMBERT_H
#define DALEMBERT_H

#include <stddef.h>

#if defined(__GNUC__)
#define DAL_API __attribute__((visibility("default")))
#else
#define DAL_API
#endif

#ifdef __cplusplus
#define DAL_BEGIN_DECLARATIONS extern "C" {
#define DAL_END_DECLARATIONS }
#else
#define DAL_BEGIN_DECLARATIONS
#define DAL_END_DECLARATIONS
#endif

DAL_BEGIN_DECLARATIONS

/* The part between the two cdef marks has plain declarations only.  The Python package uses it as
 * its cffi definition, so the two languages cannot disagree. */

/* <cdef> */
/* ---- ground ---------------------------------------------------------------------------- */

typedef enum dal_status {
    DAL_SUCCESS = 0,
    DAL_STOPPED = 1,       /* an observer or a watch asked to stop; the results so far are valid */
    DAL_EINVAL = -1,       /* an argument is NULL, out of range or not finite */
    DAL_ENOMEM = -2,       /* memory could not be allocated, or its size overflows */
    DAL_EUSER = -3,        /* a callback returned a negative number */
    DAL_EDOMAIN = -4,      /* a callback returned a positive number, NaN or Inf, or wrote nothing
                              (detected when a stepper starts, and by dal_system_check) */
    DAL_ESINGULAR = -5,    /* a matrix is singular to working precision */
    DAL_ENOCONV = -6,      /* an iteration did not converge */
    DAL_EOFFD = -7,        /* initial data do not satisfy the constraint */
    DAL_EUNSUPPORTED = -8, /* the request is valid, but this version does not provide it */
    DAL_EIO = -9,          /* a file cannot be read or written */
    DAL_EZENO = -10        /* events accumulate: too many in one step */
} dal_status;

/* A failure in words, with its numbers; text is empty on success.  Functions that create objects
 * fill the record of the caller, which may be NULL.  An object keeps the record of its last
 * failure.
 *
 * If the failure concerns an output of a callback, text[begin] to text[end] name it, by output
 * ("V_q"), row and column.  If it concerns dependent constraints, rows > 0: row dependent[0] of mu
 * is the sum over 0 < k < rows of factor[k] times row dependent[k].  It is 0 for rows = 1.  A
 * longer sum is truncated. */
typedef struct dal_error {
    int status;
    char text[508];
    const char *output; /* or NULL */
    size_t row, column, begin, end;
    double value;
    size_t rows, dependent[8];
    double factor[8];
} dal_error;

/* Return "major.minor.patch" of the running library, between releases with "+" and the commit; a
 * line of text for a dal_status. */
DAL_API const char *dal_version(void);
DAL_API const char *dal_strerror(int status);

/* Progress callback, called about 20 times a second.  The progress far is in units documented by
 * the caller.  Return 0 to continue, > 0 to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_watch_fn)(double far, void *ctx);

/* ---- system ---------------------------------------------------------------------------- */

/* Callbacks.  The time t, q[n] and v[n] are read-only inputs.  Do not write to an output that is
 * NULL.  Return 0 on success; > 0 if (t, q, v) is outside the domain of the functions, which
 * rejects the step (DAL_EDOMAIN); < 0 to stop (DAL_EUSER).  The pointer ctx is that of the
 * definition, and is never read by the library.  Formulas in these headers omit t if all their
 * terms are evaluated at the same time. */

/* The potential V of the Lagrangian v^T M v / 2 - V, with V_q[n] = dV/dq_i and V_qq[n*n] = d2V/dq_i
 * dq_j. */
typedef int (*dal_potential_fn)(double t, const double *q, double *V, double *V_q, double *V_qq,
                                void *ctx);

/* The constraints phi(t, q, v) = 0: phi[m], phi_v[m*n] = dphi_a/dv_i, phi_q[m*n] = dphi_a/dq_j and
 * phi_t[m] = dphi_a/dt.  For linear constraints these are mu(t, q) v, mu, N(q, v) = d(mu v)/dq and
 * d(mu v)/dt.  If the system has a sparsity, phi_v and phi_q have only its entries. */
typedef int (*dal_constraint_fn)(double t, const double *q, const double *v, double *phi,
                                 double *phi_v, double *phi_q, double *phi_t, void *ctx);

/* Constraints that also depend on inputs u[inputs], such as v - u = 0.  The inputs are constant
 * over a step.  When they change, D changes and v jumps, see dal_stepper_input. */
typedef int (*dal_driven_fn)(double t, const double *q, const double *v, const double *u,
                             double *phi, double *phi_v, double *phi_q, double *phi_t, void *ctx);

/* A general Lagrangian L with positive definite L_vv, and its derivatives L_q[n], L_v[n],
 * L_qq[n*n], L_vq[i*n+j] = d2L/dv_i dq_j, L_vv[n*n] and L_vt[n] = d2L/dv_i dt. */
typedef int (*dal_lagrangian_fn)(double t, const double *q, const double *v, double *L, double *L_q,
                                 double *L_v, double *L_qq, double *L_vq, double *L_vv,
                                 double *L_vt, void *ctx);

/* The generalized force f in d/dt L_v - L_q = f + mu^T lambda, which may depend on inputs
 * u[inputs]: f[n], f_q[i*n+j] = df_i/dq_j and f_v[i*n+j] = df_i/dv_j. */
typedef int (*dal_force_fn)(double t, const double *q, const double *v, const double *u, double *f,
                            double *f_q, double *f_v, void *ctx);

/* mass[n*n] (or [n] for masses) and state[2n] <- their values for the parameters at ctx.  A pointer
 * is NULL if the definition does not have the array.  An array that does not depend on parameters
 * may be left unchanged. */
typedef int (*dal_parameters_fn)(double *mass, double *state, const void *ctx);

/* x[2n] <- the exact state at time t of the solution that starts from x0[2n] at time 0. */
typedef int (*dal_exact_fn)(double t, const double *x0, double *x, void *ctx);

/* values[invariants] <- the first integrals besides the energy, at x[2n] and time t. */
typedef int (*dal_invariant_fn)(double t, const double *x, double *values, void *ctx);

typedef enum dal_constraint_kind {
    DAL_LINEAR = 0,    /* phi = mu(t, q) v; the residual is phi_v v, and only dal_system_check
                          requests phi */
    DAL_AFFINE = 1,    /* phi = mu(t, q) v + a(t, q), an extension of the paper */
    DAL_NONLINEAR = 2  /* any phi(t, q, v) with phi_v of full rank and the reaction phi_v^T lambda
                          (Chetaev), an extension of the paper.  A phi quadratic in v has no D at
                          rest, because phi_v vanishes there */
} dal_constraint_kind;

/* Outputs that a callback does not provide, and that are replaced by central differences.  The
 * differences assume functions that vary over distances of 1 or more in q, as sines of angles do.
 * The accuracy 1e-12 below applies for |q| up to about 10.  For larger |q|, also for an angle of
 * many turns, it is about (1e-16 |q|)^(4/5). */
typedef enum dal_missing {
    DAL_MISSING_V_Q = 1,   /* V_q is then accurate to about 1e-12 relative */
    DAL_MISSING_V_QQ = 2,  /* costs Newton's speed only */
    DAL_MISSING_PHI_Q = 4, /* lambda(q, v) and the reference flow are then good to about 1e-12 */
    DAL_MISSING_L_QQ = 8,  /* costs Newton's speed only */
    DAL_MISSING_L_VQ = 16, /* lambda(q, v) and the reference flow are then good to about 1e-12 */
    DAL_MISSING_L_VV = 32, /* the same, and the metric of projections */
    DAL_MISSING_F_Q = 64,  /* costs Newton's speed only */
    DAL_MISSING_F_V = 128, /* costs Newton's speed only */
    DAL_MISSING_PHI_T = 256, /* like phi_q, for functions that vary over times of 1 or more */
    DAL_MISSING_L_VT = 512   /* the same */
} dal_missing;

struct dal_compiled; /* dalembert/kernel.h */
struct dal_series;   /* dalembert/series.h, as is */
struct dal_variation_series;

/* The entries that may be nonzero in phi_v or in phi_q, sorted by row and then by column. */
typedef struct dal_sparsity {
    size_t entries;
    const size_t *row, *column; /* [entries] */
} dal_sparsity;

/* In a steady system mu depends only on coordinates on which no constraint force acts, such as the
 * heading of a blade.  Row i of M^-1 mu^T is zero for such a coordinate i.  Steps in which V does
 * not act at q~' are then linear. */
typedef enum dal_steady {
    DAL_STEADY_DECLARED = 1, /* every step checks it, with an evaluation of mu */
    DAL_STEADY_PROVED = 2,   /* it is not checked: for code derived from formulas */
    DAL_STEADY_CONSTANT_RATE = 3 /* moreover V does not act on a coordinate that mu depends on,
                                    which then moves uniformly */
} dal_steady;

/* The definition of a system: zero-initialise it, then set members.  The function dal_system_new
 * copies the struct, the masses, the sparsity, the names and the state.  The pointer ctx is
 * borrowed, or copied if ctx_size is its number of bytes. */
typedef struct dal_system_def {
    size_t n;                       /* number of coordinates, n >= 1 */
    size_t m;                       /* number of constraints, 0 <= m <= n */
    const double *mass;             /* M[n*n], constant, symmetric, positive definite; or NULL */
    const double *masses;           /* [n] of a diagonal M, instead of mass; or NULL */
    dal_lagrangian_fn lagrangian;   /* instead of mass and potential; or NULL */
    dal_potential_fn potential;     /* or NULL: V = 0 */
    dal_constraint_fn constraint;   /* NULL if m = 0; else this or */
    dal_driven_fn driven;           /* constraints that depend on inputs */
    dal_constraint_kind kind;
    const dal_sparsity *sparsity;   /* or NULL: all entries may be nonzero.  With a sparsity, the
                                       time and memory of a step are proportional to n, for masses
                                       and linear constraints in few coordinates each.  V_qq, f_q
                                       and f_v then serve only steps that do not converge without
                                       them, if all are given and n <= 500.  Otherwise h has to
                                       resolve the oscillations and decay due to V and f */
    dal_force_fn force;             /* or NULL: none */
    size_t inputs;                  /* number of inputs of force and driven: motors, steering,
                                       ... */
    unsigned missing;               /* sum of dal_missing */
    void *ctx;
    const char *name;               /* or NULL: "system".  All members from here on are optional */
    const char *help;               /* one line */
    const char *description;        /* some sentences about coordinates and parameters */
    const char *source;             /* source in the literature */
    const char *formulas;           /* lines: "L = ...", the constraints "... = 0", and "where NAME
                                       = ..." for each other symbol in these and in names of
                                       invariants; v_x is the velocity of x, a blank a product */
    const char *const *coordinates; /* [n] names, or NULL: q0, q1, ... */
    const char *const *input_names; /* [inputs], or NULL: u0, u1, ... */
    const double *state;            /* [2n] default initial data, or NULL */
    dal_exact_fn exact;             /* or NULL */
    size_t invariants;              /* number of first integrals besides the energy */
    const char *const *invariant_names; /* [invariants] */
    dal_invariant_fn invariant;
    size_t ctx_size;                /* 0: ctx is borrowed; else it is copied */
    const struct dal_compiled *compiled; /* the step routine compiled for this system, or NULL.  It
                                            computes the steps of moved nodes.  Not with a sparsity
                                            or missing derivatives */
    const struct dal_series *series; /* the Taylor series compiled for this system, or NULL */
    const struct dal_variation_series *variations; /* those of its derivatives, or NULL */
    int steady;                     /* a dal_steady or 0; nonzero only for constant mass, linear
                                       constraints, and not time_dependent */
    int time_dependent;             /* 1: a callback besides the force depends on t, and provides
                                       phi_t and L_vt; 0: these are 0 */
    int positional;                 /* 1: the force depends on t, q and u only.  Steps treat it like
                                       V_q, and call it with NaN for v and without f_v */
    dal_parameters_fn parameters;   /* mass and state for the parameters at a copy of ctx, for
                                       ensembles; or NULL: they do not depend on ctx */
} dal_system_def;

typedef struct dal_system dal_system;

/* Creates a system: *system <- the system defined by def, unchanged on failure.
 * Errors: DAL_EINVAL (invalid sizes; missing or superfluous members; a mass matrix that is not
 * finite, symmetric and positive definite; a sparsity out of order; a step routine from another
 * version of kernel.h; steady in another case than above; the text names the entry); DAL_ENOMEM. */
DAL_API int dal_system_new(dal_system **system, const dal_system_def *def, dal_error *error);

/* Frees a system; NULL is allowed.  Free objects created from a system before it. */
DAL_API void dal_system_free(dal_system *system);

/* Creates a system of the library by name ("particle", "knife_edge", ...; - and _ are equivalent).
 * The parameters names[count] get values[count], all others their defaults.
 * Errors: DAL_EINVAL (unknown name or parameter, and the text lists the names; a parameter out of
 * range); DAL_ENOMEM. */
DAL_API int dal_system_builtin(dal_system **system, const char *name, const char *const *names,
                               const double *values, size_t count, dal_error *error);

/* Return n, m, and the name. */
DAL_API size_t dal_system_n(const dal_system *system);
DAL_API size_t dal_system_m(const dal_system *system);
DAL_API const char *dal_system_name(const dal_system *system);

/* x[2n] <- the default initial data.  Errors: DAL_EUNSUPPORTED if there are none. */
DAL_API int dal_system_state(const dal_system *system, double *x);

/* x[2n] <- the exact state at time t of the solution that starts from x0[2n] in D at time 0.
 * Errors: DAL_EUNSUPPORTED if the system has no exact solution; DAL_EUSER; DAL_EDOMAIN; DAL_ENOMEM.
 */
DAL_API int dal_system_exact(const dal_system *system, double t, const double *x0, double *x);

/* ---- schemes --------------------------------------------------------------------------- */

/* Adaptive methods for the ODE on D. */
typedef enum dal_flow_method {
    DAL_FLOW_RK8PD = 0,   /* Prince-Dormand 8(7), the default */
    DAL_FLOW_MSADAMS = 1, /* multistep Adams, orders 1 to 12 */
    DAL_FLOW_RODAS = 2    /* Rosenbrock of order 4(3) with a differenced Jacobian, for stiff
                             potentials */
} dal_flow_method;

/* One beta-scheme with step fraction * h. */
typedef struct dal_substep {
    double beta;     /* in [0, 1] */
    double fraction; /* not 0; the fractions of a scheme sum to 1 */
} dal_substep;

/* The state that a run returns for a pair of nodes (q_{k-1}, q_k) (ros). */
typedef enum dal_nodes {
    DAL_MOVED_NODES = 0, /* states at q~_k = (1-beta) q_{k-1} + beta q_k, which preserve D */
    DAL_KEPT_NODES = 1   /* states at the nodes q_k, which preserve D_eps = {phi(q - (1-beta) h v,
                            v) = 0} at the time of q~_k */
} dal_nodes;

struct dal_family; /* dalembert/family.h */

/* A scheme; its family computes the steps.  To define one, zero-initialise the record, then set
 * beta; or substeps and count; or family and data.  A stepper copies the arrays that it points to.
 */
typedef struct dal_scheme {
    char name[40];
    const char *help;             /* one line, or NULL */
    const char *reference;        /* source in the literature, or NULL */
    const struct dal_family *family; /* NULL: a composition of beta-schemes */
    const void *data;             /* data of another family: a dal_pair, a dal_flow_scheme */
    double beta;                  /* beta of the only sub-step, for count = 0 */
    size_t count;
    const dal_substep *substeps;  /* [count] */
    dal_nodes nodes;              /* kept nodes require a single sub-step */
    int order;                    /* p: the local error of q, v is O(h^(p+1)); 0: no promise */
    int multiplier_order;         /* s: order of the scheme's own multipliers at the end of the
                                     step */
    int symmetric;                /* 1: its own adjoint on D */
} dal_scheme;

/* *scheme <- the scheme called name: "explicit", "midpoint", "endpoint", a number in [0, 1] (beta),
 * "leapfrog", "leapfrog-mirror", BASE"-nodes" (kept nodes; BASE one of the first four), and
 * BASE"-suzuki4", "-yoshida4", "-kl6", "-kl8", "-ss10" (BASE leapfrog or midpoint); "bm4", "bm6";
 * "pair:A:B", the velocity integrator of two maps rho^A for L_d and rho^B for D_d; "reference", the
 * flow of the ODE on D.  The characters - and _ are equivalent.
 * Errors: DAL_EINVAL if there is no such scheme, and the text lists the names. */
DAL_API int dal_scheme_find(dal_scheme *scheme, const char *name, dal_error *error);

/* The data of the scheme "reference"; NULL means the defaults. */
typedef struct dal_flow_scheme {
    dal_flow_method method;
    double tolerance; /* as for dal_flow_new; 0: 1e-13 */
} dal_flow_scheme;

/* The data of the scheme "taylor"; NULL means the defaults. */
typedef struct dal_taylor_scheme {
    double tolerance; /* admissible error of a step, relative to the change of each coordinate in
                         it, from 4.4e-16 to 0.1; 0: 1e-15 */
} dal_taylor_scheme;

/* Options of a stepper; a zero-initialised record has the defaults. */
typedef struct dal_options {
    int max_iterations; /* limit of full Newton iterations in a step; 0: 50 */
    double tolerance;   /* 0: steps of size h.  Otherwise error-controlled steps, for compositions
                           with moved nodes.  The value, in [1e-14, 0.1], is about the admissible
                           error of the state after a time of 100, relative to 1 + |x_i| */
    double h_max;       /* longest error-controlled step; 0: no limit */
    int keep_energy;    /* 1: each step conserves the energy of the start, or of the last reset, to
                           roundoff.  The scheme computes (q', w) from (q, (1+s) v), and v' is
                           (1+s') w.  The energy of the plain step determines s, that of (q', w)
                           determines s'.  The cost is that of two steps or more, and symmetric
                           steps of h/2 are closer to the exact motion.  If |s| or |s'| exceeds 1/2,
                           the plain step is taken, the next step corrects the energy, and unscaled
                           counts the step.  Only for symmetric schemes of the family beta with
                           moved nodes.  The constraints must be linear and L of second degree in v,
                           without force or dependence on time */
    double eps;         /* 0: no reversible steps.  Otherwise the size of each step is h = eps /
                           rho, at most eps = 0.2, see dal_scheme_eps.  The variable rho follows the
                           rate of the motion, the inverse of its time scale.  So the energy does
                           not drift in close approaches for which steps of fixed size are too long.
                           The largest speed and rate so far define scales of rho.  Until they are
                           known, at the start and in the first encounters, steps are not
                           reversible.  Excludes tolerance and h_max */
    int own_steps;      /* > 0: steps of the scheme's own size, as long as its tolerance allows, for
                           the schemes taylor and reference.  Those of taylor are made in so many
                           equal parts: events are looked for at their ends.  Excludes the other
                           controls of the size */
} dal_options;

/* The treatment of initial data (dal_stepper_start). */
typedef enum dal_consistency {
    DAL_CHECK = 0,   /* DAL_EOFFD if |phi^a| exceeds 1e-8 of the sizes of its terms and roundoff;
                        smaller residuals are corrected */
    DAL_PROJECT = 1, /* projected in the metric M */
    DAL_ASSUME = 2   /* used unchanged */
} dal_consistency;

/* The start of a run with kept nodes.  These schemes reject DAL_INITIAL_NONE; all others require
 * it. */
typedef enum dal_initial {
    DAL_INITIAL_NONE = 0,
    DAL_INITIAL_D = 1,       /* data in D, used unchanged: the first step jumps to D_eps (E12) */
    DAL_INITIAL_D_EPS = 2,   /* data in D_eps */
    DAL_INITIAL_PROJECT = 3, /* data in D, the velocity projected onto D_eps */
    DAL_INITIAL_SHIFT = 4    /* data in D, q moved to the node q + (1-beta) h v: the run is that of
                                the moved nodes, observed at the nodes */
} dal_initial;

/* A system, a scheme, and a state that steps advance.  A step never allocates memory.  After every
 * step the dal_relative_residual of the set that the scheme preserves is at most 4 n u, u = 2^-53.
 */
typedef struct dal_stepper dal_stepper;

/* Creates a stepper; options may be NULL.
 * Errors: DAL_EINVAL (an invalid scheme or option, which the text names); DAL_EUNSUPPORTED
 * (error-controlled steps without an estimate; reversible steps with a force, variable M,
 * dependence on time, or constraints that are not linear or are sparse); DAL_ENOMEM. */
DAL_API int dal_stepper_new(dal_stepper **stepper, const dal_system *system,
                            const dal_scheme *scheme, const dal_options *options,
                            dal_error *error);
DAL_API void dal_stepper_free(dal_stepper *stepper);
DAL_API const dal_error *dal_stepper_error(const dal_stepper *stepper);

/* Starts from x[2n] (InitialData) at time t0 with step h, which is negative to go backwards and not
 * 0.  The array x is not changed; dal_stepper_state returns the state used.  To change h or the
 * state, start again.  On failure the stepper is unchanged.
 *
 * Error-controlled steps begin with h; if h is infinite, the first step is determined, in the
 * direction of its sign.  Reversible steps always determine it, and require h = INFINITY or
 * -INFINITY.
 * Errors: DAL_EINVAL (also a system declared steady that is not); DAL_EOFFD; DAL_ESINGULAR;
 * DAL_ENOCONV; DAL_EUSER; DAL_EDOMAIN (also reversible steps at a state without a time scale, on a
 * straight line or at rest). */
DAL_API int dal_stepper_start(dal_stepper *stepper, double t0, double h, const double *x,
                              dal_consistency consistency, dal_initial initial);

/* Sets the inputs u[inputs] of the following steps; in a new stepper they are 0.  Inputs are
 * constant over a step (zero-order hold), so no scheme loses order.  A change costs one evaluation
 * of the force, which the predictor of the next step may use.
 *
 * If the constraints depend on inputs, the initial data have to lie in the D of the inputs at the
 * start.  The step after a change begins with a jump, as at an impact.  The velocity after it is
 * that of the new D on v + M^-1 mu^T R^m (dal_project).  Its impulse counts as one of the step.
 * The state stays in the old D until then.
 * Errors: DAL_EINVAL (NULL, not finite), and the stepper is unchanged; DAL_EUNSUPPORTED for
 * constraints that depend on inputs, with kept nodes, reversible steps or keep_energy.  If moreover
 * L is not of second degree in v, dal_stepper_start returns DAL_EUNSUPPORTED. */
DAL_API int dal_stepper_input(dal_stepper *stepper, const double *u);

/* Return the inputs u[inputs] of the next step, the current state x[2n], its time t0 + k h, and the
 * step size h.  If the size varies, h is that of the last step.  Arrays are borrowed, and valid
 * until the stepper is freed.  Steps may change the address of the state. */
DAL_API const double *dal_stepper_inputs(const dal_stepper *stepper);
DAL_API const double *dal_stepper_state(const dal_stepper *stepper);
DAL_API double dal_stepper_time(const dal_stepper *stepper);
DAL_API double dal_stepper_h(const dal_stepper *stepper);

/* Takes one step (DAELd1, DAELd2), with reaction[m] (or NULL) <- the scheme's own multiplier, sum_j
 * h_j lambda_j / h, a force (LamLd1, lamdaGR).
 * Errors: DAL_EINVAL (not started); DAL_ESINGULAR; DAL_ENOCONV; DAL_EUSER; DAL_EDOMAIN. */
DAL_API int dal_step(dal_stepper *stepper, double *reaction);

/* Takes a number of steps, with reaction[m] (or NULL) <- the mean multiplier over them.  If a step
 * fails, the state is that after the last successful one, and *done (or NULL) <- the number of
 * successful steps.  The reaction is then unchanged, as it is if only it overflows (DAL_EDOMAIN,
 * after all steps).
 * Errors: as for dal_step. */
DAL_API int dal_advance(dal_stepper *stepper, size_t steps, double *reaction, size_t *done);

/* ---- runs ------------------------------------------------------------------------------ */

/* Observer, called at every stored state; step counts from the start of the stepper.  Return 0 to
 * continue, > 0 to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_observer_fn)(size_t step, double t, const double *x, void *ctx);

/* Takes a number of steps, a multiple of stride.  x[(steps/stride + 1)*2n] (or NULL) <- the initial
 * state and every stride-th one; reactions[(steps/stride)*m] (or NULL) <- the mean multiplier over
 * each interval, NaN for a scheme without multipliers; *done (or NULL) <- the number of steps
 * taken.  See dalembert/run.h for inputs, events and output times.
 * Errors: DAL_STOPPED; DAL_EINVAL; the errors of dal_step. */
DAL_API int dal_integrate(dal_stepper *stepper, size_t steps, size_t stride, double *x,
                          double *reactions, dal_observer_fn observer, void *ctx, size_t *done);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_H */
