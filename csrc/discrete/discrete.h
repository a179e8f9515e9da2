/* discrete.h - the equations of a step, difference maps, discrete Lagrangians and constraints. */
#ifndef DAL__DISCRETE_H
#define DAL__DISCRETE_H

#include "dalembert/discrete.h"
#include "geometry/geometry.h"

/* The equations of dal_step_equations in parts.  First what depends on t, beta, h and x alone,
 * which are those of that function and have been checked; end is t + h, where phi is wanted, but
 * for the rounding of the time that the state is stored with; kept: x is (q_k, v), the state of
 * kept nodes.  alpha is beta there; another one is that of rho^alpha for L_d, and L acts at q_k +
 * alpha h w.  Then the rest, as often as needed; K_sizes[2*n]: those of the rows and columns of K
 * (see lu.h); mu_k is in mech->muk; outputs may be NULL.  At last x[2n] <- the new state, with w[n]
 * the velocity that was found, corrected so that phi at the q~' that x gives back is roundoff; the
 * residual raises *worst.  The x of dal__step_begin must stay until the last dal__step_at. */
int dal__step_begin(dal_mechanics *mech, double t, double end, double alpha, double beta, double h,
                    bool kept, const double *x);
int dal__step_at(dal_mechanics *mech, const double *w, const double *kappa, double *R1, double *R2,
                 double *K, double *K_sizes, double *B);
/* How far w moves with q~', see algebra.h, after the last dal__step_at that gave K and B. */
double dal__step_moves(const dal_mechanics *mech);
int dal__step_settle(dal_mechanics *mech, const double *w, double *x, double *worst);

/* Two nodes one step h apart, and the difference quotient w = (q1 - q0)/h, which may be known to
 * more digits than the nodes leave. */
typedef struct dal__pair {
    double h;
    const double *q0, *q1, *w; /* [n] */
} dal__pair;

/* A finite difference map, and what it gives at a pair. */
typedef struct dal__rho {
    dal_difference_map map;
    size_t n;
    dal_error *error;           /* of its owner */
    double *g, *f;              /* [n] */
    double *g_0, *g_1;          /* [n*n] */
    double *f_0, *f_1;          /* [n*n] times h, so that they do not grow as h goes to 0 */
    double h, *point, *value, *slope; /* [2n], [2n], [2n*2n] of differenced derivatives */
} dal__rho;

void dal__rho_reserve(dal__rho *rho, const dal_difference_map *map, size_t n, arena *a);
/* After the allocation; error gets the text of what fails. */
void dal__rho_bind(dal__rho *rho, dal_error *error);
/* g and f at the pair, and the derivatives if slopes. */
int dal__rho_at(dal__rho *rho, const dal__pair *pair, bool slopes);

/* Entries of a matrix, and the sums of the sizes of their terms. */
typedef struct dal__terms {
    double *sum, *scale;
} dal__terms;

struct dal_discrete {
    dal_mechanics mech;
    size_t n, m;
    dal__rho lagrangian, constraint; /* of L_d, of D_d */
    dal__rho moved;                  /* of L_d too: its second derivatives are differenced */
    dal__root root;                  /* for 2n unknowns */
    double *q0, *q1, *w;             /* [n] a pair of our own */
    double *state;                   /* [2n] */
    dal__pair held;                  /* whose p^- is differenced by q1 */
    double *force, *L_v;             /* [n] F = L_q + f and L_v at rho(pair) */
    double *minus, *plus;            /* [n] p^- and p^+ */
    double *L_qq, *L_vq, *L_vv, *f_q, *f_v; /* [n*n] */
    dal__terms X, Y;                 /* [n*n] h dF/dw and dL_v/dw, on the way to */
    dal__terms K;                    /* [n*n] dp^-/dw */
    double *phi, *phi_v, *phi_q;     /* [m], [m*n], [m*n] at rho(pair) */
    dal__terms B;                    /* [m*n] d phi_d/dw */
    double *muk;                     /* [m*n] the forms along which the constraint reacts */
    double *point, *value, *bend;    /* [n], [n], [n*n] of differences by w or by q1 */
    double t;                        /* of the pair before the step that is being solved, */
    const double *kappa;             /* [m] and its reaction; q_k, h and more are those of mech */
    double *momentum, *velocity;     /* [n] p^+_k; v_k */
    arena arena;
};

/* f[n] += factor mu^T kappa. */
void dal__add_reaction(size_t n, size_t m, double factor, const double *mu, const double *kappa,
                       double *f);

/* What the roundoff of w is relative to beside w: v, and the terms of the equations of motion, of
 * which mu^T kappa is one, as changes of velocity.  They may be far larger than w: at rest, where a
 * reaction balances a force. */
typedef struct dal__term {
    double weight;   /* 0: what stands at x is not known */
    const double *x; /* [n] */
} dal__term;
double dal__base_of_w(const dal_mechanics *mech, const double *v, size_t count,
                      const dal__term *terms, const double *mu, const double *kappa);

/* DAL_EINVAL unless beta is in [0, 1]. */
int dal__require_beta(dal_mechanics *mech, double beta);
/* muk <- phi_v(node, v) at the time of the node, start.middle; or for the mean of start.v and w,
 * along which a nonlinear constraint reacts. */
int dal__reaction_forms(dal_mechanics *mech, const double *v, double *muk);
int dal__chetaev_forms(dal_mechanics *mech, const double *w, double *muk);

/* DAL_EINVAL unless h is finite and not 0, and t and x[2n], of this name, are finite. */
int dal__discrete_require(dal_discrete *d, const char *name_t, double t, double h,
                          const char *name_x, const double *x);
/* *pair <- that of the nodes q0, q1 [n], which have these names, with (q1 - q0)/h in d->w.
 * DAL_EINVAL unless d is there, t, h and the nodes are finite and h is not 0. */
int dal__discrete_open(dal_discrete *d, double t, double h, const char *name0, const double *q0,
                       const char *name1, const double *q1, dal__pair *pair);
/* q0, q1 [n] <- the pair with rho(q0, q1) = x[2n] at time t, rho that of D_d. */
int dal__rho_invert(dal_discrete *d, double t, double h, const double *x, double *q0, double *q1);
/* d->w <- (q1 - q0)/h; the pair. */
dal__pair dal__discrete_pair(dal_discrete *d, double h, const double *q0, const double *q1);
/* minus, plus [n] (or NULL) <- p^- = -D_1 L_d and p^+ = D_2 L_d of the pair at time t, with the
 * forces if forced; d->K if derivative. */
int dal__discrete_momenta(dal_discrete *d, double t, bool forced, const dal__pair *pair,
                          double *minus, double *plus, bool derivative);
/* dal_discrete_advance; the residual of D raises *worst. */
int dal__discrete_advance(dal_discrete *discrete, double t, double h, double *x, double *lambda,
                          double *worst);
/* d->K -= factor df/d(point[n]), where f[n], whose ctx is d, is differenced. */
int dal__discrete_bend(dal_discrete *d, dal__function f, double factor, const double *point);
/* d->phi, d->phi_v, and d->B if derivative. */
int dal__discrete_constraint(dal_discrete *d, double t, const dal__pair *pair, bool derivative);

#endif /* DAL__DISCRETE_H */
