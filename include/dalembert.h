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
 *      can report a failed allocation only through its handler, so its workspaces are allocated
 *      only when an object is made: dal_flow_new (but for DAL_FLOW_RODAS), dal_embedding_new,
 *      dal_stepper_new with DAL_SOLVER_MULTIROOT, and dal_order_study, which makes a flow.  With a
 *      handler that returns these return DAL_ENOMEM; only GSL itself may then have lost a block,
 *      for DAL_FLOW_MSADAMS and DAL_SOLVER_MULTIROOT.
 *
 * The sections follow the floors of csrc/: ground, system, geometry, flow, discretisation, schemes,
 * runs. */
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
    DAL_EUNSUPPORTED = -8  /* the request is valid and this version does not provide it */
} dal_status;

/* What went wrong, in words with the numbers.  Filled by functions that make objects; text is
 * empty on success.  NULL may be passed. */
typedef struct dal_error {
    int status;
    char text[508];
} dal_error;

/* "major.minor.patch" of the library that is running. */
DAL_API const char *dal_version(void);

/* One line of text for a dal_status; never NULL. */
DAL_API const char *dal_strerror(int status);

/* Asked some twenty times a second by what may compute for long, with how far it is; there it is
 * said in what.  Return 0 to go on, > 0 to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_watch_fn)(double far, void *ctx);

/* ---- system ---------------------------------------------------------------------------- */

/* Callbacks.  Inputs are read only.  An output that is NULL is not wanted.  Return 0; or > 0 if
 * (q, v) is outside the domain of the functions (the step that asked is refused, DAL_EDOMAIN); or
 * < 0 to stop (DAL_EUSER).  ctx is the pointer of the definition and is never read here. */

/* V; V_q[n] = dV/dq_i; V_qq[n*n] = d2V/dq_i dq_j.  q[n].  The Lagrangian is v^T M v / 2 - V. */
typedef int (*dal_potential_fn)(const double *q, double *V, double *V_q, double *V_qq, void *ctx);

/* phi[m], the constraint phi(q, v) = 0, which is mu(q) v for linear constraints; phi_v[m*n] =
 * dphi_a/dv_i, which is mu(q) for them; phi_q[m*n] = dphi_a/dq_j, which is N(q, v) = d(mu v)/dq for
 * them.  q[n], v[n]. */
typedef int (*dal_constraint_fn)(const double *q, const double *v, double *phi, double *phi_v,
                                 double *phi_q, void *ctx);

/* A general normal Lagrangian, L_vv positive definite: L; L_q[n]; L_v[n]; L_qq[n*n]; L_vq[i*n+j] =
 * d2L/dv_i dq_j; L_vv[n*n].  q[n], v[n]. */
typedef int (*dal_lagrangian_fn)(const double *q, const double *v, double *L, double *L_q,
                                 double *L_v, double *L_qq, double *L_vq, double *L_vv, void *ctx);

/* A generalized force, d/dt L_v - L_q = f + mu^T lambda: f[n] at time t; f_q[i*n+j] = df_i/dq_j;
 * f_v[i*n+j] = df_i/dv_j.  q[n], v[n]. */
typedef int (*dal_force_fn)(double t, const double *q, const double *v, double *f, double *f_q,
                            double *f_v, void *ctx);

/* x[2n] <- the exact state at time t of the solution that starts in x0[2n] at time 0. */
typedef int (*dal_exact_fn)(double t, const double *x0, double *x, void *ctx);

/* values[invariants] <- the first integrals at x[2n], energy not among them. */
typedef int (*dal_invariant_fn)(const double *x, double *values, void *ctx);

typedef enum dal_constraint_kind {
    DAL_LINEAR = 0,    /* phi = mu(q) v; the residual is phi_v v, only the check asks for phi */
    DAL_AFFINE = 1,    /* phi = mu(q) v + a(q), beyond the paper as the next */
    DAL_NONLINEAR = 2  /* any phi(q, v) with phi_v of full rank, and with the reaction phi_v^T
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
    DAL_MISSING_F_V = 128  /* costs Newton's speed only */
} dal_missing;

struct dal_kernel; /* kernel.h */

/* Makes steps steps of kernel; *done <- how many succeeded.  What kernel.h defines as
 * DAL_KERNEL. */
typedef int (*dal_kernel_fn)(struct dal_kernel *kernel, size_t steps, size_t *done);

/* In a steady system mu depends only on coordinates that no reaction pushes, those i with row i of
 * M^-1 mu^T zero, as on the heading of a blade.  Steps where V does not act at q~' are then
 * linear. */
typedef enum dal_steady {
    DAL_STEADY_DECLARED = 1, /* every step looks whether it is true, with an evaluation of mu */
    DAL_STEADY_PROVED = 2    /* nothing looks: for code that was derived from formulas */
} dal_steady;

/* The definition of a system, filled by the caller, zero-initialised.  dal_system_new copies the
 * struct, the mass matrix, the names and the state; ctx is borrowed, or copied if ctx_size says how
 * many bytes it has. */
typedef struct dal_system_def {
    size_t n;                       /* number of coordinates, n >= 1 */
    size_t m;                       /* number of constraints, 0 <= m < n */
    const double *mass;             /* M[n*n], constant, symmetric, positive definite; or NULL: */
    dal_lagrangian_fn lagrangian;   /* instead of mass and potential, else NULL */
    dal_potential_fn potential;     /* or NULL: V = 0 */
    dal_constraint_fn constraint;   /* NULL if and only if m = 0 */
    dal_constraint_kind kind;
    dal_force_fn force;             /* or NULL: none */
    unsigned missing;               /* sum of dal_missing */
    void *ctx;
    const char *name;               /* or NULL: "system"; what follows may all be left out */
    const char *help;               /* one line */
    const char *description;        /* some sentences: what coordinates and parameters are */
    const char *source;             /* where it is from, in the literature */
    const char *formulas;           /* lines: "L = ...", the constraints "... = 0", and "where NAME
                                       = ..." for what else is in them or in names of invariants;
                                       v_x is the velocity of x, a blank a product */
    const char *const *coordinates; /* [n] names, or NULL: q0, q1, ... */
    const double *state;            /* [2n] initial data to start from by default, or NULL */
    dal_exact_fn exact;             /* or NULL */
    size_t invariants;              /* number of first integrals besides the energy */
    const char *const *invariant_names; /* [invariants] */
    dal_invariant_fn invariant;
    size_t ctx_size;                /* 0: ctx is borrowed; else it is copied */
    dal_kernel_fn kernel;           /* the step routine compiled for this system, or NULL; only for
                                       constant mass, linear constraints, no force, nothing missing.
                                       It makes the steps of moved nodes */
    size_t kernel_size;             /* sizeof(dal_kernel) as its compiler saw it */
    int steady;                     /* a dal_steady or 0; only for constant mass and linear
                                       constraints */
} dal_system_def;

typedef struct dal_system dal_system;

/* *system <- a system, or untouched on failure.
 * DAL_EINVAL (sizes, missing or superfluous parts, mass matrix not finite, not symmetric or not
 * positive definite: the text names the entry; a kernel from another version of kernel.h; steady
 * where it may not be), DAL_ENOMEM. */
DAL_API int dal_system_new(dal_system **system, const dal_system_def *def, dal_error *error);

/* NULL is allowed.  Objects made from a system must be freed before it. */
DAL_API void dal_system_free(dal_system *system);

/* The system that comes with the library under name ("particle", "knife_edge", ...; - and _ are
 * the same), with count parameters changed from their defaults: names[count], values[count].
 * DAL_EINVAL (unknown name or parameter: the text lists what there is; a parameter out of its
 * range), DAL_ENOMEM. */
DAL_API int dal_system_builtin(dal_system **system, const char *name, const char *const *names,
                               const double *values, size_t count, dal_error *error);

/* g[m] of the deformation phi + delta g; g_v[m*n], g_q[m*n] its derivatives.  q[n], v[n]. */
typedef int (*dal_deformation_fn)(const double *q, const double *v, double *g, double *g_v,
                                  double *g_q, void *ctx);

/* *system <- base with the constraints phi + delta g = 0 (deformation, DefCons, DefDAE): a system
 * as any other, of the given kind (of phi + delta g as a function of v), with C_delta,
 * lambda_delta and h_delta (Ceps, heps) from dal_gram, dal_multipliers and dal_field.  missing:
 * DAL_MISSING_PHI_Q if g_q is not provided, else 0.  base and ctx must outlive it; exact solution,
 * invariants, initial data, description, source and formulas are not taken over.
 * DAL_EINVAL (NULL, delta not finite, kind, missing), DAL_ENOMEM, DAL_EUNSUPPORTED (m n > 4000). */
DAL_API int dal_system_deform(dal_system **system, const dal_system *base, dal_deformation_fn g,
                              void *ctx, double delta, dal_constraint_kind kind, unsigned missing,
                              dal_error *error);

/* *system <- base with the constraints phi(q - shift v, v) = 0, nonlinear: for shift = (1 - beta) h
 * its D is the D_eps that the beta-scheme with kept nodes preserves (deformedCons, originalnodes).
 * base must outlive it and provide phi_q.  Errors as of dal_system_deform. */
DAL_API int dal_system_deform_nodes(dal_system **system, const dal_system *base, double shift,
                                    dal_error *error);

/* Number of built-in systems, the name of the i-th and one line about it; NULL: i is too large. */
DAL_API size_t dal_builtin_count(void);
DAL_API const char *dal_builtin_name(size_t i);
DAL_API const char *dal_builtin_help(size_t i);

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
DAL_API const double *dal_system_mass(const dal_system *system); /* [n*n]; NULL: not constant */
DAL_API dal_constraint_kind dal_system_kind(const dal_system *system);
DAL_API int dal_system_is_forced(const dal_system *system); /* 1: there is a generalized force */

/* Parameters of a built-in system; a system of the user's own has none. */
DAL_API size_t dal_system_parameters(const dal_system *system);
DAL_API const char *dal_system_parameter_name(const dal_system *system, size_t i); /* or NULL */
DAL_API double dal_system_parameter(const dal_system *system, size_t i);           /* or NaN */

/* x[2n] <- the default initial data.  DAL_EUNSUPPORTED if there are none. */
DAL_API int dal_system_state(const dal_system *system, double *x);

/* x[2n] <- the exact state a time t after x0[2n], which must lie in D; where there is a force, of
 * the solution that starts at time 0.
 * DAL_EUNSUPPORTED if the system carries no exact solution; DAL_EUSER, DAL_EDOMAIN, DAL_ENOMEM. */
DAL_API int dal_system_exact(const dal_system *system, double t, const double *x0, double *x);

/* First integrals besides the energy: how many, their names, values[count] at x[2n].
 * DAL_EUNSUPPORTED if there are none; DAL_EUSER, DAL_EDOMAIN, DAL_ENOMEM. */
DAL_API size_t dal_system_invariants(const dal_system *system);
DAL_API const char *dal_system_invariant_name(const dal_system *system, size_t i); /* or NULL */
DAL_API int dal_system_invariant(const dal_system *system, const double *x, double *values);

/* A derivative compared with central differences, over a smaller and smaller distance until they
 * agree with it, or with each other. */
typedef struct dal_difference {
    double error;           /* worst |given - differenced| / (1 + |differenced|) */
    double given, expected; /* the two numbers at that entry */
    size_t row, column;
    int checked;            /* 0: not provided, or no entry was judged: nothing to compare */
    int wrong;              /* 1: the two numbers are not the same */
    size_t unjudged;        /* entries where differences do not converge: not compared */
} dal_difference;

/* What dal_system_check found at one point. */
typedef struct dal_check {
    int passed;              /* 1: all below is as it should be */
    dal_difference V_q, V_qq, phi_q;
    dal_difference phi_v;    /* of affine and nonlinear constraints, against phi */
    dal_difference L_q, L_v, L_qq, L_vq, L_vv, f_q, f_v;
    double linearity;        /* worst |mu(q) at v - mu(q) at another v|, which must not depend on v
                                unless the constraint is nonlinear */
    size_t rank;             /* of mu(q); should be m (FullRank, RegularitySet) */
    double condition;        /* of mu(q) in the mass metric: sqrt of the condition of C */
    double mass_min;         /* smallest eigenvalue of M, which is L_vv at x */
    double kernel_min;       /* smallest eigenvalue of M on ker mu (EUDAETh with "> 0", E1) */
    double residual;         /* as dal_relative_residual */
    double curvature;        /* largest length of [X,Y] across D, X and Y from an orthonormal basis
                                of D_q: by N(q,X)Y - N(q,Y)X with N(q,w) = d(mu w)/dq; NaN unless
                                the constraints are linear */
    int integrable;          /* 1: it vanishes here and nearby: D may be a holonomic constraint */
    char text[508];          /* the first thing found wrong, in words; or the summary */
} dal_check;

/* *report <- the system examined at x[2n]; what depends on v also at another velocity, where it is
 * defined there; a force at time 0, and with the other velocity at time 1.  The mass is examined at
 * x, curvature and integrable (NaN, 0) only of linear constraints, and condition (NaN) only if M is
 * positive definite.  Findings are in the report; the return value is for
 * what prevents the examination: DAL_EINVAL, DAL_ENOMEM, DAL_EUSER, DAL_EDOMAIN (a callback that
 * is not finite or writes nothing is a finding of its own: passed = 0 and DAL_EDOMAIN). */
DAL_API int dal_system_check(const dal_system *system, const double *x, dal_check *report,
                             dal_error *error);

/* ---- geometry -------------------------------------------------------------------------- */

/* Mechanics on D: a system with the workspace to evaluate it. */
typedef struct dal_mechanics dal_mechanics;

DAL_API int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system,
                              dal_error *error);
DAL_API void dal_mechanics_free(dal_mechanics *mechanics);
/* What the last failure was, with the numbers; "" if there was none. */
DAL_API const char *dal_mechanics_message(const dal_mechanics *mechanics);

/* In this section M is L_vv, and D = {phi(q, v) = 0}; mu is phi_v, and phi is mu v where the
 * constraints are linear.  Errors of the functions below: DAL_EINVAL, DAL_EUSER, DAL_EDOMAIN;
 * DAL_ESINGULAR where C or M is inverted. */

/* *E <- L_v v - L, which is v^T M v / 2 + V(q) for constant mass; a first integral on D unless
 * there is a force, or the constraint forces work (dal_power). */
DAL_API int dal_energy(dal_mechanics *mechanics, const double *x, double *E);

/* *constraint <- lambda . (phi_v v), the power of the constraint forces, which is 0 on D for linear
 * constraints and dE/dt of an affine or nonlinear one (deformation); *force <- f . v.  Either may
 * be NULL. */
DAL_API int dal_power(dal_mechanics *mechanics, double t, const double *x, double *constraint,
                      double *force);

/* M[n*n] <- L_vv at x (metric). */
DAL_API int dal_metric(dal_mechanics *mechanics, const double *x, double *M);

/* residual[m] <- phi(q - shift v, v).  shift = 0 is D; shift = (1 - beta) h is the deformation
 * D_eps that the beta-scheme with kept nodes preserves (deformedCons). */
DAL_API int dal_residual(dal_mechanics *mechanics, double shift, const double *x, double *residual);

/* *worst <- the largest of all a of
 *     |phi^a| / (sum_i |mu^a_i| d_i max_j |v_j| / d_j + |phi^a - mu^a v|),   d_i = sqrt((M^-1)_ii),
 * at (q - shift v, v), where the last term is 0 for linear constraints; 0 where phi is 0.  d_i is
 * the largest |v_i| of a velocity with v^T M v = 1.  It does not change when forms or coordinates
 * are rescaled.  Also DAL_ESINGULAR (M(q) is not positive definite). */
DAL_API int dal_relative_residual(dal_mechanics *mechanics, double shift, const double *x,
                                  double *worst);

/* C[m*m] <- mu M^-1 mu^T at x (lemmaC; Ceps). */
DAL_API int dal_gram(dal_mechanics *mechanics, const double *x, double *C);

/* lambda[m] <- -C^-1 (phi_q v + mu f_v) with f_v = M^-1 (L_q - L_vq v + f), which is -M^-1 V_q for
 * constant mass and no force (f, lambdax, lambdaQV); defined off D as well. */
DAL_API int dal_multipliers(dal_mechanics *mechanics, double t, const double *x, double *lambda);

/* vdot[n] <- f_v + M^-1 mu^T lambda (soODE). */
DAL_API int dal_acceleration(dal_mechanics *mechanics, double t, const double *x, double *vdot);

/* xdot[2n] <- (v, vdot): the vector field h of the ODE on D (h, ODEManifold, ODExMec, heps). */
DAL_API int dal_field(dal_mechanics *mechanics, double t, const double *x, double *xdot);

/* The DAE of motion with the perturbation weight ghat[2n] = weight (ghat_q, ghat_v),
 *   qdot = v + weight ghat_q,  vdot = f_v + M^-1 mu^T lambda + weight ghat_v,  phi(q, v) = 0
 * (PerturbedDAE): xdot[2n] <- its vector field on D (ODEPert; the form ODEPert2 is wrong, E2),
 * lambda[m] <- its multiplier, that of dal_multipliers - weight C^-1 (phi_q ghat_q + mu ghat_v)
 * (hatLambday).  Either may be NULL.  Tangent to D for every ghat (hatperp); if (ghat_q, ghat_v) is
 * tangent to D itself, lambda is that of the unperturbed problem (LargeRemark). */
DAL_API int dal_perturbed(dal_mechanics *mechanics, double t, double weight, const double *x,
                          const double *ghat, double *xdot, double *lambda);

/* x[2n]: v <- the velocity of D (shift = 0) or of D_eps on v + M^-1 mu(q)^T R^m, by Newton; for
 * linear and affine constraints and shift = 0 that is v - M^-1 mu^T C^-1 phi, the nearest
 * consistent velocity in the metric M.  *distance (or NULL) <- the length of the correction in
 * that metric. Also DAL_ENOCONV. */
DAL_API int dal_project(dal_mechanics *mechanics, double shift, double *x, double *distance);

/* x[2n]: v <- the velocity in D_q nearest in the metric M with v_i unchanged where keep[i] is not 0
 * (keep[n], or NULL: none): data to start from (InitialData).  For nonlinear constraints one that
 * is consistent, found by Newton.
 * DAL_ESINGULAR if the kept components leave too little freedom; also DAL_ENOMEM, DAL_ENOCONV. */
DAL_API int dal_consistent(dal_mechanics *mechanics, const unsigned char *keep, double *x,
                           double *distance);

/* The residual and the Jacobian [[K, -mu_k^T], [B, 0]] of one step of the beta-scheme from x[2n] at
 * time t, at a trial velocity w[n] and impulse kappa[m] = h lambda (DAELd1, DAELd2, Facil):
 *   q_k = q + (1-beta) h v,  q1 = q_k + beta h w,  F = L_q + f,
 *   R1[n] = L_v(q1, w) - L_v(q, v) - h ((1-beta) F(t+h, q1, w) + beta F(t, q, v)) - mu_k^T kappa,
 *   R2[m] = phi(q1, w),  mu_k = phi_v(q_k, (v+w)/2), which is mu(q_k) unless phi is nonlinear,
 *   K[n*n] = dR1/dw,  B[m*n] = dR2/dw = phi_v + beta h phi_q at (q1, w).
 * For constant mass and no force K = M + h^2 beta (1-beta) V_qq(q1).  muk[m*n] <- mu_k.  Every
 * output may be NULL. */
DAL_API int dal_step_equations(dal_mechanics *mechanics, double t, double beta, double h,
                               const double *x, const double *w, const double *kappa, double *R1,
                               double *R2, double *K, double *B, double *muk);

/* Evaluates count rows (q, v) of x[count*2n]: energy[count]; multipliers[count*m] by lambdax, which
 * have the order of the rows (rmkpdisc);
 * residual[count*m] = phi(q - shift v, v); relative[count] as dal_relative_residual.  Outputs may
 * be NULL.  On failure *done (or NULL) is the number of rows that were evaluated. */
DAL_API int dal_trajectory(dal_mechanics *mechanics, double t0, double h, double shift,
                           size_t count, const double *x, double *energy, double *multipliers,
                           double *residual, double *relative, size_t *done);

/* ---- geometry: charts of D --------------------------------------------------------------- */

/* D written by m dependent velocities as functions of the rest (Ehresmann connection): with B =
 * phi_v[:, dependent] and A = B^-1 phi_v[:, independent] the coordinates are xi = (q,
 * v_independent), 2n - m numbers, and psi(xi) is the state of D with v_dependent = -A
 * v_independent, for affine constraints -A v_independent - B^-1 a; for nonlinear ones it is found
 * by Newton.  A and B have their rows and columns in the order of dal_chart_dependent and
 * dal_chart_independent.
 *
 * A chart is a system, a choice of the dependent coordinates and the workspace.  Its functions need
 * a choice: DAL_EINVAL before the first one.  Their other errors: DAL_EINVAL, DAL_EUSER,
 * DAL_EDOMAIN; DAL_ESINGULAR where B is singular; for nonlinear constraints DAL_ENOCONV. */
typedef struct dal_chart dal_chart;

DAL_API int dal_chart_new(dal_chart **chart, const dal_system *system, dal_error *error);
DAL_API void dal_chart_free(dal_chart *chart);
/* What the last failure was, with the numbers, or the last change that dal_chart_renew made; "" if
 * there was neither. */
DAL_API const char *dal_chart_message(const dal_chart *chart);

/* Chooses dependent[m], in any order; NULL: by pivoting at x[2n], with the components of v in the
 * units 1/sqrt(M_ii), so that the choice does not depend on the units of q, and with exchanges
 * until no entry of A exceeds 5/4 in them, so that it hardly depends on which forms describe D
 * either.  Newton for nonlinear constraints starts at the v_dependent of x. */
DAL_API int dal_chart_choose(dal_chart *chart, const size_t *dependent, const double *x);

/* The choice: [m] and [n-m] indices, ascending, borrowed; NULL before the first one. */
DAL_API const size_t *dal_chart_dependent(const dal_chart *chart);
DAL_API const size_t *dal_chart_independent(const dal_chart *chart);

/* *condition <- the largest singular value of [A, I] at x in the units 1/sqrt(M_ii): how much
 * larger v can be than v_independent.  It is the condition of B once the forms are made
 * orthonormal, 1 at best, and the same for mu and any B(q) mu; INFINITY where B is singular. */
DAL_API int dal_chart_condition(dal_chart *chart, const double *x, double *condition);

/* Keeps the choice where its condition at x is at most 10 sqrt(1 + m (n-m)), else chooses anew; a
 * choice by pivoting starts eight times below this limit, so it does not flip back.  *changed (or
 * NULL) <- whether the dependent coordinates changed, as they do when first chosen;
 * dal_chart_message then says from which to which.  For nonlinear constraints Newton starts at the
 * v_dependent of x from then on. */
DAL_API int dal_chart_renew(dal_chart *chart, const double *x, int *changed);

/* A[m*(n-m)] and B[m*m] at x[2n], either may be NULL. */
DAL_API int dal_chart_connection(dal_chart *chart, const double *x, double *A, double *B);

/* v = hor + ver: hor[n] is the velocity of D with the v_independent of x, and ver[n] is zero in the
 * independent components.  For linear constraints both are linear in v.  Either may be NULL. */
DAL_API int dal_chart_split(dal_chart *chart, const double *x, double *hor, double *ver);

/* x[2n] <- psi(xi[2n-m]) (Embedd), with |phi_a| <= 4 n u of the size of its terms. */
DAL_API int dal_chart_lift(dal_chart *chart, const double *xi, double *x);

/* xi[2n-m] <- (q, v_independent) of x[2n]; the left inverse of psi. */
DAL_API int dal_chart_drop(dal_chart *chart, const double *x, double *xi);

/* J[2n*(2n-m)] <- dpsi/dxi (EhresJota), left[(2n-m)*2n] <- its left inverse, the derivative of
 * dal_chart_drop (Inverse); either may be NULL. */
DAL_API int dal_chart_jacobian(dal_chart *chart, const double *xi, double *J, double *left);

/* xidot[2n-m] <- the ODE on D in these coordinates: left h(psi(xi)) (ODExi, ODEred, ODExiConnec;
 * ODExiEps). */
DAL_API int dal_chart_field(dal_chart *chart, double t, const double *xi, double *xidot);

/* The multipliers of the forms [A, I] from those of mu, and back: lambda_E[m] <- B^T lambda,
 * lambda[m] <- B^-T lambda_E, B at x[2n]; mu^T lambda = [A, I]^T lambda_E.  They may overlap. */
DAL_API int dal_chart_multipliers(dal_chart *chart, const double *x, const double *lambda,
                                  double *lambda_E);
DAL_API int dal_chart_multipliers_back(dal_chart *chart, const double *x, const double *lambda_E,
                                       double *lambda);

/* One beta-step with moved nodes from xi[2n-m] at time t, in place, with the multiplier eliminated
 * (the decompositions that follow firstorder and secondorder): with R1 that of dal_step_equations
 * for kappa = 0 and A, B at q_k,
 *   R1_independent - A^T R1_dependent = 0,  phi(q1, w) = 0,
 * and lambda_E[m] (or NULL) <- R1_dependent / h, the multiplier of [A, I] at q_k.
 * Also DAL_ENOCONV for all constraints. */
DAL_API int dal_chart_step(dal_chart *chart, double t, double beta, double h, double *xi,
                           double *lambda_E);

/* ---- geometry: curves in D --------------------------------------------------------------- */

/* The cut-off functions chi_0 = (1 + tanh cot(pi tau)) / 2 and chi_1 = 1 - chi_0 on 0 < tau < 1,
 * both without cancellation, to a relative error of a few u |log chi|, and *slope <- dchi_0/dtau
 * (CutOff); (1, 0, 0) for tau <= 0 and
 * (0, 1, 0) for tau >= 1.  All derivatives vanish at the ends.  NaN for NaN.  Every output may be
 * NULL. */
DAL_API void dal_cutoff(double tau, double *chi0, double *chi1, double *slope);

/* x[2n] <- c(tau) = psi(chi_0 xi1 + chi_1 xi2), a curve in D from x1[2n] for tau <= 0 to x2[2n] for
 * tau >= 1, which have to lie in D (yD, InterpolationD; not checked: only their q and v_independent
 * matter).  For nonlinear constraints Newton starts at chi_0 v1 + chi_1 v2.  Errors as above. */
DAL_API int dal_chart_curve(dal_chart *chart, const double *x1, const double *x2, double tau,
                            double *x);

/* Between the rows (q, v) of x[rows*2n], which stand at t0 + k h, k < rows: out[count*2n] <- the
 * states at the times t[count], in any order, between t0 and t0 + (rows-1) h (up to 1e-9 of that).
 * xi is interpolated after Hermite, q from q, v and vdot in degree 5, v_independent from v and vdot
 * in degree 3, and lifted by psi: the states lie in D to roundoff and have an error O(h^4) beside
 * that of the rows.  At the time of a row they are that row.  shift = 0 is D; for rows of kept
 * nodes shift is (1-beta) times the step of the scheme, q - shift v is what is interpolated, and
 * the states lie in D_eps (where the first row does not, as with DAL_INITIAL_D, the states jump
 * behind it).  The coordinates are chosen by pivoting in the middle of each interval, and again at
 * a state where that choice is ill conditioned; *changes (or NULL) <- how often they changed from
 * one state to the next.  The choice of the chart is neither needed nor changed.  On failure *done
 * (or NULL) states were computed.  DAL_EINVAL, DAL_EUSER, DAL_EDOMAIN, DAL_ESINGULAR,
 * DAL_ENOCONV. */
DAL_API int dal_chart_interpolate(dal_chart *chart, double t0, double h, double shift, size_t rows,
                                  const double *x, size_t count, const double *t, double *out,
                                  size_t *changes, size_t *done);

/* ---- flow ------------------------------------------------------------------------------ */

typedef enum dal_flow_method {
    DAL_FLOW_RK8PD = 0,   /* Prince-Dormand 8(9), the default */
    DAL_FLOW_MSADAMS = 1, /* multistep Adams, orders 1 to 12 */
    DAL_FLOW_RODAS = 2    /* Rosenbrock, order 4(3), with a differenced Jacobian, for stiff
                             potentials */
} dal_flow_method;

typedef enum dal_flow_coordinates {
    DAL_FLOW_X = 0, /* the ODE in the states x (h) */
    DAL_FLOW_XI = 1 /* the ODE in the coordinates of a chart (ODExi, ODExiConnec), which is changed
                       on the way where it has become ill conditioned: every step lies in D */
} dal_flow_coordinates;

/* The flow of the ODE on D by an adaptive method: GSL's (odeiv2), but for rodas. */
typedef struct dal_flow dal_flow;

/* tolerance: relative and absolute, for each step, in [4 u, 0.1], u = 2^-53; 1e-13 is about the
 * best. */
DAL_API int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                         dal_flow_coordinates coordinates, double tolerance, dal_error *error);
DAL_API void dal_flow_free(dal_flow *flow);
DAL_API const char *dal_flow_message(const dal_flow *flow);

/* Has watch asked, with the time where the flow is, by all that computes with it; NULL: nobody. */
DAL_API void dal_flow_watch(dal_flow *flow, dal_watch_fn watch, void *ctx);

/* x[2n] at t0, which must lie in D, -> x at t1 (t1 < t0 is allowed), projected onto D at the end
 * (ODEflow).
 * That x lies in D is not checked: off D the same ODE is integrated, which keeps phi, and only the
 * result is projected; in xi the part of v off D is dropped at once.  *accuracy (or NULL) <-
 * estimate of the error, the largest component of the difference to the result at a tolerance ten
 * times as large with steps of at most 1/17 of the interval, or roundoff if that is larger; asking
 * for it costs a second integration.  What happens between the evaluations of both, as a short push
 * in a long rest, is not seen: integrate from one such event to the next.  DAL_FLOW_MSADAMS takes
 * two evaluations for a step, and is for smooth forces only.
 * DAL_EINVAL, DAL_EUSER, DAL_EDOMAIN, DAL_ESINGULAR, DAL_ENOCONV (the step size collapsed),
 * DAL_STOPPED, where x is as it was too. */
DAL_API int dal_flow_apply(dal_flow *flow, double t0, double t1, double *x, double *accuracy);

/* Rows 1..steps of x[(steps+1)*2n] from row 0, which must lie in D (not checked either): the
 * states at t0 + k h, projected.  On failure *done (or NULL) rows after row 0 are valid.  Errors as
 * of dal_flow_apply. */
DAL_API int dal_flow_trajectory(dal_flow *flow, double t0, double h, size_t steps, double *x,
                                size_t *done);

/* Changes of the chart so far; 0 but for DAL_FLOW_XI. */
DAL_API size_t dal_flow_chart_changes(const dal_flow *flow);

/* Evaluations of the vector field so far. */
DAL_API size_t dal_flow_evaluations(const dal_flow *flow);

/* ---- discretisation -------------------------------------------------------------------- */

/* A finite difference map rho(q0, q1) = (g, f) for the step h (FDM, roloc): a position and a
 * velocity made of two nodes, with g(q, q) = q, f(q, q) = 0 and df/dq1 = 1/h on the diagonal.
 * g[n], f[n]; the derivatives g_0[i*n+j] = dg_i/dq0_j, g_1 = dg/dq1, f_0 = df/dq0, f_1 = df/dq1,
 * [n*n] each.  q0[n], q1[n]; h may be negative. */
typedef int (*dal_map_fn)(double h, const double *q0, const double *q1, double *g, double *f,
                          double *g_0, double *g_1, double *f_0, double *f_1, void *ctx);

/* Zero-initialise, then set what is needed. */
typedef struct dal_difference_map {
    double beta;     /* in [0, 1].  With map NULL: rho^beta, g = (1-beta) q0 + beta q1 and
                        f = (q1-q0)/h (robeta; ro1, ro2 are 0 and 1/2).  Else where between the
                        nodes g lies, which only a force that depends on time has to know */
    dal_map_fn map;  /* of the user's own, or NULL */
    int differenced; /* 1: map gives g and f only; central differences then cost about 1e-12 of
                        D_r L_d, which the orbit sees, and nothing of phi_d */
    void *ctx;
} dal_difference_map;

/* A system with difference maps: the discrete Lagrangian L_d = h L o rho (aprox, Ld1), the discrete
 * constraint D_d = {phi_d = phi o rho' = 0} (DiscNHSet; of dimension 2n - m, E14), rho and rho'
 * maps that may differ, and their discrete Lagrange-d'Alembert equations
 *   D_2 L_d(q_(k-1), q_k) + f^+ + D_1 L_d(q_k, q_(k+1)) + f^- + h mu(q_k)^T lambda_(k+1) = 0,
 *   phi_d(q_k, q_(k+1)) = 0                                                             (DLA)
 * with f^- = h g_0^T f, f^+ = h g_1^T f for a generalized force f at rho.  lambda is a force; that
 * of the paper is -h lambda (E16).  mu(q_k) is phi_v(q_k, (v_k + v_(k+1))/2) with v the velocity
 * of rho' if phi is nonlinear.  Without constraints these are the discrete Euler-Lagrange equations
 * (discreteeq), and what is said of lambda[m], phi_d[m] is empty.
 *
 * The pair (q_(k-1), q_k) belongs to the state (q~_k, v_k) = rho'(q_(k-1), q_k) and to its time
 * t_k, which is the t of the functions below. */
typedef struct dal_discrete dal_discrete;

/* lagrangian: rho; constraint: rho', or NULL: the same.  They are copied, their ctx is borrowed.
 * DAL_EINVAL (NULL, beta not in [0, 1]), DAL_ENOMEM. */
DAL_API int dal_discrete_new(dal_discrete **discrete, const dal_system *system,
                             const dal_difference_map *lagrangian,
                             const dal_difference_map *constraint, dal_error *error);
DAL_API void dal_discrete_free(dal_discrete *discrete);
/* What the last failure was, with the numbers; "" if there was none. */
DAL_API const char *dal_discrete_message(const dal_discrete *discrete);

/* Errors of the functions below: DAL_EINVAL (NULL, not finite, h = 0), DAL_EUSER, DAL_EDOMAIN, and
 * what is said. */

/* x[2n] <- rho'(q0, q1) (roloc).  q0[n], q1[n]. */
DAL_API int dal_discrete_state(dal_discrete *discrete, double h, const double *q0,
                               const double *q1, double *x);

/* q0[n], q1[n] <- the pair of nodes with rho'(q0, q1) = x[2n]: how a run on nodes starts from a
 * state, which gives a pair of D_d if x lies in D (E17).  rho^beta: q0 = q - beta h v, q1 = q +
 * (1-beta) h v; else by Newton.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_nodes(dal_discrete *discrete, double h, const double *x, double *q0,
                               double *q1);

/* *L_d; D1[n] = dL_d/dq0; D2[n] = dL_d/dq1; D12[i*n+j] = d2L_d/dq0_i dq1_j.  For a map of the
 * user's own D12 is good to about 1e-10, because its second derivatives are differenced.  Outputs
 * may be NULL. */
DAL_API int dal_discrete_lagrangian(dal_discrete *discrete, double h, const double *q0,
                                    const double *q1, double *L_d, double *D1, double *D2,
                                    double *D12);

/* phi_d[m] (DiscNHSet, Ff); D1[m*n] = dphi_d/dq0; D2[m*n] = dphi_d/dq1.  Outputs may be NULL. */
DAL_API int dal_discrete_constraint(dal_discrete *discrete, double h, const double *q0,
                                    const double *q1, double *phi_d, double *D1, double *D2);

/* The discrete Legendre transforms, with the forces at time t: minus[n] <- p^- = -D_1 L_d - f^-,
 * the momentum at q0; plus[n] <- p^+ = D_2 L_d + f^+, that at q1.  Either may be NULL.  Along an
 * orbit p^-(q_k, q_(k+1)) - p^+(q_(k-1), q_k) = h mu(q_k)^T lambda_(k+1). */
DAL_API int dal_discrete_momenta(dal_discrete *discrete, double t, double h, const double *q0,
                                 const double *q1, double *minus, double *plus);

/* The discrete momentum of a symmetry whose generator is xi0[n] at q0 and xi1[n] at q1: *minus <-
 * p^- . xi0, *plus <- p^+ . xi1.  Either may be NULL.  If L_d is invariant, the two are equal for
 * every pair; so without forces their value is constant along an orbit if m = 0 or mu(q_k) xi(q_k)
 * vanishes. */
DAL_API int dal_discrete_momentum(dal_discrete *discrete, double t, double h, const double *q0,
                                  const double *q1, const double *xi0, const double *xi1,
                                  double *minus, double *plus);

/* residual[n+m] <- the left sides of the two equations above (DLAa, DLAb) for three nodes [n] each
 * and lambda[m]; t is the time of (q_before, q). */
DAL_API int dal_discrete_residual(dal_discrete *discrete, double t, double h,
                                  const double *q_before, const double *q, const double *q_after,
                                  const double *lambda, double *residual);

/* The matrix that has to be invertible where q_after is to be found (REG, RegularityDLA, E15):
 *   matrix[(n+m)*(n+m)] = [[D_1 D_2 L_d + df^-/dq1, mu(q)^T], [D_2 phi_d, 0]] at (q, q_after),
 * with mu = phi_v(q, f) if phi is nonlinear; t is the time of the pair before.  Its determinant is
 * *sign exp(*logarithm), with *sign = 0 and -Inf where it vanishes to working precision, and equals
 * (-1/h)^n det K det S with the K and S = B K^-1 mu^T of dal_step_equations.  *condition: of the
 * matrix with its first n columns multiplied by h, which has a limit as h goes to 0; Inf if the
 * determinant vanishes.  Outputs may be NULL. */
DAL_API int dal_discrete_regularity(dal_discrete *discrete, double t, double h, const double *q,
                                    const double *q_after, double *matrix, int *sign,
                                    double *logarithm, double *condition);

/* The node map F (NHFlow): the pair q0[n], q1[n] at time t becomes (q_k, q_(k+1)), by Newton with
 * the regularity matrix; lambda[m] (or NULL) <- lambda_(k+1).  The pair need not lie in D_d, where
 * F is a map: elsewhere this step goes there.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_step(dal_discrete *discrete, double t, double h, double *q0, double *q1,
                              double *lambda);

/* steps steps on nodes.  Rows 0 and 1 of nodes[(steps+2)*n] are a pair of D_d at time t0; row k + 2
 * and lambda[steps*m] (or NULL), row k, are made by step k.  (q1 - q0)/h is carried along, so what
 * it loses to the size of the nodes, u |q|/h, it loses once.  On failure *done (or NULL) steps are
 * good.  Also DAL_EOFFD (the first pair does not lie in D_d, as for DAL_CHECK),
 * DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_run(dal_discrete *discrete, double t0, double h, size_t steps,
                             double *nodes, double *lambda, size_t *done);

/* The velocity integrator rho' F rho'^-1 (VNI, propoDcont, diagram): x[2n] at time t -> the state
 * at t + h; lambda[m] (or NULL) <- lambda_(k+1).  Afterwards x lies in D to roundoff, as after
 * dal_step.  With both maps rho^beta it is the beta-scheme; with maps of the user's own the nodes
 * lose u |q|/h of v in each step.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_advance(dal_discrete *discrete, double t, double h, double *x,
                                 double *lambda);

/* Where (q0, q1) stands to the exact discrete constraint D_d^E = {(q0, q(h)) : v0 in D}, the q(h)
 * that the flow reaches from (q0, v0) in time h: v0[n] <- the velocity of D at q0 whose q(h)
 * misses q1 only in the direction M^-1 mu^T, across D; defect[m] (or NULL) <- mu (q1 - q(h))/h,
 * which is 0 if and only if the pair lies in D_d^E; mu and M at (q0, v0).  t0 is the time of q0.
 * By iteration with the flow, which contracts by O(h); the text of a failure is that of the flow.
 * DAL_EINVAL, DAL_ENOMEM, DAL_ESINGULAR, DAL_ENOCONV (h is too large), DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_exact_velocity(dal_flow *flow, double t0, double h, const double *q0,
                               const double *q1, double *v0, double *defect);

/* ---- schemes --------------------------------------------------------------------------- */

/* One beta-scheme with step fraction * h. */
typedef struct dal_substep {
    double beta;     /* in [0, 1] */
    double fraction; /* not 0; the fractions of a record sum to 1 */
} dal_substep;

/* What a run shows of a pair of nodes (q_{k-1}, q_k) (ros). */
typedef enum dal_nodes {
    DAL_MOVED_NODES = 0, /* states at q~_k = (1-beta) q_{k-1} + beta q_k: keeps D */
    DAL_KEPT_NODES = 1   /* states at the nodes q_k: keeps D_eps = {phi(q - (1-beta) h v, v) = 0} */
} dal_nodes;

/* A scheme is a record; one step routine runs every record.  To make one: zero-initialise, then
 * set beta, or substeps and count (they are copied when a stepper is made). */
typedef struct dal_scheme {
    char name[40];
    const char *help;             /* one line, or NULL */
    const char *reference;        /* where it comes from, or NULL */
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
 * BASE"-suzuki4", "-yoshida4", "-kl6", "-kl8" (BASE leapfrog or midpoint); - and _ are the same.
 * DAL_EINVAL: there is no such scheme, the text lists what there is. */
DAL_API int dal_scheme_find(dal_scheme *scheme, const char *name, dal_error *error);

/* The table of named schemes: how many, and the i-th (DAL_EINVAL if i is too large). */
DAL_API size_t dal_scheme_count(void);
DAL_API int dal_scheme_at(dal_scheme *scheme, size_t i);

/* 1 if every step of scheme on system is a sequence of linear solves, without iteration: every
 * sub-step has beta = 0, the mass is constant, no force, and the constraints are not nonlinear;
 * else 0. */
DAL_API int dal_scheme_is_explicit(const dal_scheme *scheme, const dal_system *system);

/* *shift <- 1 - beta of a record with a single sub-step: its D_eps has shift (1 - beta) h.
 * DAL_EUNSUPPORTED for a record with several. */
DAL_API int dal_scheme_shift(const dal_scheme *scheme, double *shift);

/* How the equations of a step are solved. */
typedef enum dal_solver {
    DAL_SOLVER_SCHUR = 0,    /* Newton on the m x m Schur complement: the default */
    DAL_SOLVER_MULTIROOT = 1 /* gsl_multiroot hybridsj on all n + m unknowns: slow, a check */
} dal_solver;

typedef enum dal_sizes {
    DAL_SIZES_AUTO = 0,   /* the step routine compiled for this (n, m) if there is one */
    DAL_SIZES_RUNTIME = 1 /* the step routine for any (n, m); the same bits */
} dal_sizes;

/* Zero-initialised: the defaults. */
typedef struct dal_options {
    dal_solver solver;
    dal_sizes sizes;
    int max_iterations; /* of the full Newton in a sub-step; 0: 50 */
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
    size_t substeps;            /* of the record, in these steps */
    size_t iterations;          /* Newton iterations */
    size_t constraint_calls, potential_calls;
    size_t lagrangian_calls, force_calls;
    size_t corrections;         /* final corrections that took an evaluation of their own */
    size_t full_newtons;        /* sub-steps that the modified Newton handed to the full one; where
                                   all are solved by the full one, that had to start anew */
    size_t halvings;            /* Newton steps halved because a callback left its domain */
    double worst_residual;      /* largest residual, as dal_relative_residual, after any step of
                                   the set that the scheme keeps */
    double initial_residual;    /* that of the data given to dal_stepper_start */
    double initial_correction;  /* how far these were moved, in the mass metric */
    unsigned differenced;       /* dal_missing: derivatives that were differenced */
    size_t jump_step;           /* the step after which the energy was first seen to have changed,
                                   by jump, by more than half of the largest kinetic energy: h is
                                   too large.  0: it was not.  Looked at in every 64th step and at
                                   the end of dal_integrate, where there is no force, the
                                   constraints are linear, and the scheme is not of order 1 */
    double jump, largest_kinetic;
} dal_stats;

/* A system, a scheme, and a state that is stepped.  A step never allocates.  After every step the
 * residual of the set that the scheme keeps, as dal_relative_residual finds it, is at most 4 n u
 * with u = 2^-53.  Where kept nodes lie so far out that the rounding of q - (1-beta) h v moves mu v
 * by more, it may be up to that, and worst_residual says so. */
typedef struct dal_stepper dal_stepper;

/* options: or NULL for the defaults.
 * DAL_EINVAL (a record that is not valid; the text says what), DAL_ENOMEM. */
DAL_API int dal_stepper_new(dal_stepper **stepper, const dal_system *system,
                            const dal_scheme *scheme, const dal_options *options,
                            dal_error *error);
DAL_API void dal_stepper_free(dal_stepper *stepper);
DAL_API const char *dal_stepper_message(const dal_stepper *stepper);

/* Start from x[2n] (InitialData) at time t0 with step h (negative: backwards; 0 is DAL_EINVAL).  x
 * is not changed; the state used is that of dal_stepper_state.  A change of h or of the state is a
 * new start.  On failure the stepper is as it was.
 * DAL_EINVAL (also a system declared steady that is seen not to be), DAL_EOFFD, DAL_ESINGULAR,
 * DAL_ENOCONV, DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_stepper_start(dal_stepper *stepper, double t0, double h, const double *x,
                              dal_consistency consistency, dal_initial initial);

/* The current state x[2n] (borrowed, valid until the stepper is freed), its time t0 + k h. */
DAL_API const double *dal_stepper_state(const dal_stepper *stepper);
DAL_API double dal_stepper_time(const dal_stepper *stepper);
DAL_API void dal_stepper_stats(const dal_stepper *stepper, dal_stats *stats);

/* One step (DAELd1, DAELd2).  reaction[m] (or NULL) <- the scheme's own multiplier, sum_j h_j
 * lambda_j / h, a force (LamLd1, lamdaGR).
 * DAL_EINVAL (not started), DAL_ESINGULAR, DAL_ENOCONV, DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_step(dal_stepper *stepper, double *reaction);

/* steps steps.  reaction[m] (or NULL) <- the mean over them.  If one fails the stepper stands after
 * the last good one and *done (or NULL) says how many were good; reaction is then untouched, and so
 * it is where it alone overflows (DAL_EDOMAIN, after all steps). */
DAL_API int dal_advance(dal_stepper *stepper, size_t steps, double *reaction, size_t *done);

/* ---- runs ------------------------------------------------------------------------------ */

/* Called at every stored state; step counts from the start of the stepper.  Return 0 to go on, > 0
 * to stop (DAL_STOPPED), < 0 to fail (DAL_EUSER). */
typedef int (*dal_observer_fn)(size_t step, double t, const double *x, void *ctx);

/* steps steps from the stepper's state, every stride-th state stored (steps a multiple of stride).
 * x[(steps/stride + 1)*2n] (or NULL) <- the states, row 0 the state now;
 * reactions[(steps/stride)*m] (or NULL) <- the mean reaction over each interval, which belongs to
 * its middle.  observer or NULL. *done (or NULL) <- steps made and stored.  A second call goes on
 * where this one stopped. DAL_STOPPED, DAL_EINVAL and the errors of dal_step. */
DAL_API int dal_integrate(dal_stepper *stepper, size_t steps, size_t stride, double *x,
                          double *reactions, dal_observer_fn observer, void *ctx, size_t *done);

/* A fitted order: errors ~ h^slope over the points that count. */
typedef struct dal_fit {
    double slope;    /* NaN if fewer than three points count */
    double spread;   /* by how much the slopes between neighbours differ: where it is more than
                        0.25 the errors are not yet a power of h */
    size_t points;   /* how many counted */
    int exact;       /* 1: every error is at the level of roundoff; of the states in a study, also
                        that those of one order less than promised would not be */
} dal_fit;

/* The fits of a study. */
typedef enum dal_order_fit {
    DAL_FIT_STATE, DAL_FIT_MULTIPLIERS, DAL_FIT_REACTION, DAL_FIT_MIDPOINT,
    DAL_FIT_GLOBAL_Q, DAL_FIT_GLOBAL_V, DAL_FIT_GLOBAL_MULTIPLIERS, DAL_FIT_GLOBAL_STATE
} dal_order_fit;

/* One step size of a study.  Errors are largest components of differences. */
typedef struct dal_order_point {
    double h;
    size_t steps;
    double q, v, multipliers;         /* at t_end, against the reference; lambda(q, v) by lambdax */
    double local_state;               /* (q, v) after one step from exact data (porder) */
    double local_multipliers;         /* lambda(q, v) after that step */
    double local_reaction;            /* the scheme's own multiplier of that step against
                                         lambda(t0 + h) (pdisc) */
    double local_midpoint;            /* the same against lambda(t0 + h/2) */
    double residual, residual_eps;    /* worst relative residual of D and of D_eps over the run;
                                         residual_eps is NaN for a record with several sub-steps */
    double energy;                    /* max |E - E0| / max(|E0|, 1) over the run */
    int failed;                       /* status of the run; nonzero: the errors are NaN */
    unsigned counted;                 /* bit 1 << k: the point counted in the dal_order_fit k */
} dal_order_point;

typedef struct dal_order {
    dal_fit state;        /* slope - 1 is p */
    dal_fit multipliers;  /* slope - 1 is the order of lambda(q, v), which should be p */
    dal_fit reaction;     /* slope - 1 is s of (p, s), as in the paper; over the finer half of the
                             steps, because its h^2 term is there at any order */
    dal_fit midpoint;     /* slope of the reaction at the middle of the step, minus 1 */
    dal_fit global_q, global_v, global_multipliers; /* slopes at t_end, */
    dal_fit global_state;                           /* and of the larger error of q and v */
    double p, s;          /* state.slope - 1, reaction.slope - 1 (firstorder, secondorder) */
    double floor;         /* of the errors at t_end: those below 100 floor do not count; it is
                             higher for runs of many sub-steps, and lower for one-step errors */
    double reference;     /* accuracy of the reference solution; 0 for an exact one */
    int keeps_D, keeps_D_eps; /* 1: residual within 4 n u after every step of every run */
    int holds;            /* the verdict: 1 if the set that the nodes promise is kept, s >=
                             multiplier_order - 0.2 (or exact), and p or the slope at t_end is at
                             least order - 0.2 or exact (the one-step errors of high orders can
                             reach roundoff before their slope settles); 0 if not; -1 if the record
                             promises nothing; -2 if it is not settled: too few points count, a
                             slope falls short that has not settled, the slope at t_end falls
                             short where that of one step does not, or the runs do not resolve
                             the solution (an error at t_end beyond half of the largest component
                             of its ends, or a run that failed with a smaller step).  With
                             DAL_INITIAL_D the promise for the first step is (order - 1,
                             multiplier_order - 1), and order at t_end (E12) */
    char text[508];       /* the verdict in words */
} dal_order;

/* What a study runs over. */
typedef struct dal_order_def {
    double t0, t_end;
    const double *x0;           /* [2n] in D (for DAL_INITIAL_D_EPS it is moved there) */
    const size_t *steps;        /* [count] numbers of steps over t_end - t0 */
    size_t count;
    dal_initial initial;        /* for kept nodes */
    double tolerance;           /* of the flow where there is no exact solution; 0: 1e-13 */
    dal_watch_fn watch;         /* or NULL; it sees the number of steps made, of all runs */
    void *watch_ctx;
} dal_order_def;

/* Step-size refinement of scheme on system: points[count] and *order.
 * DAL_EINVAL, DAL_ENOMEM, DAL_STOPPED (nothing is written), and the errors of the reference flow.
 * A run that fails is a failed point, not a failed study. */
DAL_API int dal_order_study(const dal_system *system, const dal_scheme *scheme,
                            const dal_order_def *def, dal_order_point *points, dal_order *order,
                            dal_error *error);

/* The least squares slope of log(error) over log(h) for the points with error > 100 floor (at
 * least three over a factor of two in h).  h[count], errors[count]; counted[count] (or NULL) <- 1
 * for these points, 0 for the others. */
DAL_API void dal_fit_order(size_t count, const double *h, const double *errors, double floor,
                           dal_fit *fit, unsigned char *counted);

/* ---- runs: embedding --------------------------------------------------------------------- */

/* A scheme Phi of order p and step h is the period map of a flow that is perturbed periodically in
 * time: with xi the coordinates of a chart, f the field of the ODE on D in them and F its flow,
 * there is a 1-periodic g(tau, xi), bounded as h -> 0, such that Phi is the time-h map of
 *     xidot = f(xi) + h^p g(t/h, xi)          (pertODE, propoDisc; on D: Coro, perturbedNhODExi).
 * For h -> 0 it tends to -chi_0'(tau) d(xi), d the error constant of dal_embedding_limit.  With
 * p + 1 in place of p it grows as 1/h, with p - 1 it tends to 0: so it measures p (porder,
 * pdisc). */
typedef struct dal_embedding dal_embedding;

typedef struct dal_embedding_def {
    const dal_scheme *scheme; /* any record; of kept nodes the moved-node map is embedded, which is
                                 its conjugate by (q, v) -> (q - (1-beta) h v, v) */
    double h;                 /* the period, not 0 */
    int order;                /* p; 0: the order of the record */
    double tolerance;         /* of the flow; 0: 1e-14 */
    int numerical;            /* 1: the reference flow even where there is an exact solution */
} dal_embedding_def;

/* DAL_EINVAL, DAL_ENOMEM, DAL_EUNSUPPORTED (a system with a force: it may depend on time). */
DAL_API int dal_embedding_new(dal_embedding **embedding, const dal_system *system,
                              const dal_embedding_def *def, dal_error *error);
DAL_API void dal_embedding_free(dal_embedding *embedding);
DAL_API const char *dal_embedding_message(const dal_embedding *embedding);

/* The chart whose xi the functions below take and give: dal_chart_choose it first.  Borrowed. */
DAL_API dal_chart *dal_embedding_chart(dal_embedding *embedding);
/* Has watch asked by all that computes with the embedding, with the number of steps of the scheme
 * that dal_embedding_curve has made; NULL: nobody. */
DAL_API void dal_embedding_watch(dal_embedding *embedding, dal_watch_fn watch, void *ctx);
/* p. */
DAL_API int dal_embedding_order(const dal_embedding *embedding);
/* About how much of g is noise: the accuracy of the flow (4 u for an exact solution) times
 * h^-(p+1).  Where g is not larger, it says nothing. */
DAL_API double dal_embedding_noise(const dal_embedding *embedding);

/* Errors of the functions below: DAL_EINVAL (also where the chart has no choice yet), the errors of
 * charts, flows and steps, and DAL_ENOCONV where h is too large.  tau is in units of h. */

/* G[2n-m] <- the curve G~(tau, y) that starts in y[2n-m] and goes through Phi(y) at tau = 1,
 * through Phi(Phi(y)) at tau = 2, ..., a step for each; 0 <= tau <= 2^53 (Gdef, Gtilde,
 * period0). */
DAL_API int dal_embedding_curve(dal_embedding *embedding, double tau, const double *y, double *G);

/* y[2n-m] <- the start of the curve that goes through z[2n-m] at tau - floor(tau) (ztilde). */
DAL_API int dal_embedding_source(dal_embedding *embedding, double tau, const double *z, double *y);

/* g[2n-m] at (tau, z[2n-m]) (gdefinition, period1).  Its image in the state, a vector tangent to D,
 * is that of the Jacobian of dal_chart_jacobian (tildeg). */
DAL_API int dal_embedding_field(dal_embedding *embedding, double tau, const double *z, double *g);

/* d[2n-m] <- (Phi(z) - F(h, z)) / h^(p+1). */
DAL_API int dal_embedding_limit(dal_embedding *embedding, const double *z, double *d);

/* z[2n-m] at t0 -> at t1, along the perturbed ODE to a tolerance of 1e-12. */
DAL_API int dal_embedding_flow(dal_embedding *embedding, double t0, double t1, double *z);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_H */
