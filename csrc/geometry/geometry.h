/* geometry.h - mechanics on D, charts of D, and the flow of the ODE on D. */
#ifndef DAL__GEOMETRY_H
#define DAL__GEOMETRY_H

#include "dalembert/geometry.h"
#include "system/system.h"

/* M at one (t, q, v), and the data to solve with it.  For constant mass it is the system's:
 * read-only, valid for the life of the system.  Otherwise it is that of the last function that
 * builds the metric, and invalid after one of these has failed. */
typedef struct dal__metric {
    double *M;                    /* [n*n], or [n] of masses */
    bool masses;
    double *unit, *per_unit;      /* [n] d_i and 1/d_i of residual.h */
    double *factor;               /* [n*n] of Cholesky; NULL for constant mass, as the next */
    double *formed_at;            /* [2n+1] (q, v) and t, */
    bool formed;                  /* if there are any, */
    size_t age;                   /* of the system then */
} dal__metric;

/* phi and its derivatives at the node q, of the last dal__forms_at or dal__step_at, or where
 * multipliers were asked for; those that were not wanted then are of no use.  dal__step_begin moves
 * q away from them. */
typedef struct dal__forms {
    double *q;                    /* [n] */
    double *phi, *phi_t;          /* [m] */
    double *moves;                /* [m] of residual.h, after dal__measure_moves */
    double *mu, *dmu;             /* [m*n]: phi_v and phi_q, that is mu(q) and d(mu v)/dq */
} dal__forms;

/* Row a of Z[m*n] is M^-1 mu^a, as dal__build_Z left it, or another direction in which v may move.
 * C is mu Z^T and then its factors: those of Cholesky, with (C^-1)_aa in sizes, from
 * dal__factor_gram until the next dal__mend or projection, which leave those of LU; but always of
 * LU, if C has a pattern. */
typedef struct dal__gram {
    double *Z;
    dal__linear C;
} dal__gram;

/* Of the step that dal__step_begin began. */
typedef struct dal__start {
    double middle, end, acts; /* times of q_k and q~', and where L acts at the end */
    double alpha, beta, h;
    bool kept;
    const double *v;          /* [n] */
    double base;              /* see algebra.h, of the last dal__step_at that gave R1 and K */
} dal__start;

/* A dal_mechanics may be part of another object: reserve in its arena, bind after allocation.
 * First the values that belong together, then what any function here may overwrite.  Where there
 * are eval.rows, mu and the other arrays of [m*n] are stored by these rows; set eval.dense first to
 * get dense matrices. */
struct dal_mechanics {
    evaluator eval;
    size_t n, m;
    dal__metric metric;
    dal__forms forms;
    dal__gram gram;
    /* L_q - L_vq v - L_vt + f and lambda: after all that ask for multipliers, where
     * the three values above are those of the same state. */
    double *force, *lambda;       /* [n], [m] */
    double *w, *step;             /* [n] */
    double *point;                /* [2n] the state that is projected; of energy_jump.c too */
    double t, shift;              /* its time; the D or D_eps of this shift */
    double relative;              /* the residual of what dal_project left in D */
    double *hessian;              /* [n*n]: L_qq, or V_qq; NULL if sparse */
    double *L_vt;                 /* [n], and */
    double *L_vq, *L_vv;          /* [n*n]; NULL for constant mass */
    double *f_q, *f_v;            /* [n*n]; NULL without a force, or if sparse */
    /* of the equations of a step */
    double *momentum, *reach;     /* [n] L_v(q, v), h beta F(t, q, v) */
    double *node, *muk;           /* [n], [m*n] q_k, mu_k */
    double *place;                /* [n] where L acts, if that is not q */
    double *trial, *chetaev, *bend; /* [n], [m*n], [n*n] of nonlinear constraints: where mu_k^T
                                       kappa is differenced, its value and its derivative */
    dal__start start;
    dal_error error;
    arena arena; /* used only by dal_mechanics_new */
};

void dal__mechanics_reserve(dal_mechanics *mech, const dal_system *system, arena *a);
void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system);
/* dal_mechanics_new; dense: with all entries of mu and all matrices of n rows. */
int dal__mechanics_new(dal_mechanics **mechanics, const dal_system *system, bool dense,
                       dal_error *error);

/* Row a of A, stored as mu is: times x[n]; sum_i |A_ai x_i|; c times it added to y[n]. */
static inline double dal__row_dot(const dal_mechanics *mech, const double *A, size_t a,
                                  const double *x)
{
    const dal_rows *const rows = mech->eval.rows;
    return rows ? dal_rows_dot(rows, A, a, x) : dal__dot(mech->n, A + a * mech->n, x);
}

static inline double dal__row_extent(const dal_mechanics *mech, const double *A, size_t a,
                                     const double *x)
{
    const dal_rows *const rows = mech->eval.rows;
    if (rows) return dal_rows_extent(rows, A, a, x);
    double sum = 0.0;
    for (size_t i = 0; i < mech->n; i++) sum += fabs(A[a * mech->n + i] * x[i]);
    return sum;
}

static inline void dal__row_add(const dal_mechanics *mech, double c, const double *A, size_t a,
                                double *y)
{
    const dal_rows *const rows = mech->eval.rows;
    if (!rows) dal__add(mech->n, c, A + a * mech->n, y);
    for (size_t e = rows ? rows->first[a] : 0; rows && e < rows->first[a + 1]; e++)
        y[rows->column[e]] += c * A[e];
}

/* That of the residual: of n, or where there are rows of the most terms that are added up. */
static inline double dal__residual_bound(const dal_mechanics *mech)
{
    return DAL_RESIDUAL_BOUND(mech->eval.rows ? mech->eval.rows->terms : mech->n);
}

/* M_ii. */
static inline double dal__mass_at(const dal_mechanics *mech, size_t i)
{
    return mech->metric.M[i * (mech->metric.masses ? 1 : mech->n + 1)];
}

/* y[n] <- M x, M that of the last dal__build_metric. */
void dal__weigh(const dal_mechanics *mech, const double *x, double *y);

/* These functions leave the text of their failure in mech->error. */

/* DAL_EINVAL unless the output of this name is not NULL, and shift, t and x[2n] are finite: the
 * first line of public functions. */
int dal__require_state(dal_mechanics *mech, const char *name, const double *output, double shift,
                       double t, const double *x);

/* DAL_EINVAL unless the argument of this name is there and finite. */
int dal__require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x);
/* M at (t, q, v) and what solving with it needs.  DAL_ESINGULAR if it is not positive definite. */
int dal__build_metric(dal_mechanics *mech, double t, const double *q, const double *v);
/* The same of metric.M, which is that at (t, q, v) already. */
int dal__factor_metric(dal_mechanics *mech, double t, const double *q, const double *v);
/* dal__build_metric, if it is not the last that was formed; the statistics do not count it. */
int dal__renew_metric(dal_mechanics *mech, double t, const double *q, const double *v);
/* y[n] <- M^-1 f[n], M that of the last dal__build_metric; y and f may not overlap. */
void dal__accelerate(const dal_mechanics *mech, const double *f, double *y);
/* gram.Z <- the rows M^-1 mu^a. */
void dal__build_Z(dal_mechanics *mech, const double *mu);
/* Adds ": constraints[2] equals constraints[0] here" to the text, and the rows to the record, if a
 * row of mu depends on others: the square of its part across them, relative to that of the row,
 * both in the metric of Z = mu M^-1, is at most least.  Returns whether there was one; error may be
 * NULL.  C is of no use afterwards. */
bool dal__name_dependent(dal_mechanics *mech, const double *mu, const double *Z, double least,
                         dal_error *error);
/* The least where rows that depend to three digits explain why a step is not found, and where mu
 * M^-1 mu^T is singular to working precision. */
#define DAL_RANK_ALMOST_LOST 1e-6
static inline double dal__rank_lost(const dal_mechanics *mech)
{
    return 4.0 * (double)(mech->m * mech->m) / DAL_LU_CONDITION;
}
/* The same of the mu of a step that is not found; and what is said where there is none. */
#define DAL__RANK_OR_H ": the constraints lose rank here, or h is too large"
bool dal__name_rank_lost(dal_mechanics *mech, const double *mu);
/* Adds to the text which rows of muk and of the forms, the mu of one step, point to opposite sides:
 * they vanish on the way, or h is too large. */
void dal__name_turned(dal_mechanics *mech);
/* The gram of the forms and the metric.  DAL_ESINGULAR. */
int dal__factor_gram(dal_mechanics *mech);
/* The LU factors of mu Z^T, where Z need not be that of mu, and may leave coordinates out.
 * DAL_ESINGULAR. */
int dal__factor_product(dal_mechanics *mech);
/* y[m] <- C^-1 y, of the last dal__factor_gram. */
void dal__solve_gram(const dal_mechanics *mech, double *y);
/* forms.moves <- those of residual.h at the node forms.q = q - shift v and the time t, whose parts
 * are rounded both, so that they count as |forms.q_i| + |shift v_i|.  They are 0 for linear
 * constraints, unless shift makes mu depend on v. */
int dal__measure_moves(dal_mechanics *mech, double t, double shift, const double *v);
/* How far velocities move then, to first order; see dal__progress. */
double dal__velocity_moves(dal_mechanics *mech, double t, double shift, const double *v);
/* The residual of residual.h, the largest of all a, in the units of the last dal__build_metric;
 * without moves[m] if these are NULL. */
double dal__relative_residual(const dal_mechanics *mech, const double *mu, const double *phi,
                              const double *v, const double *moves);
/* Whether v is so near to D that it is meant to lie in it: |mu^a v| <= 1e-8 sum_i |mu^a_i v_i| + 4
 * n u s^a, with phi and a^a where residual.h has them. */
bool dal__is_consistent(const dal_mechanics *mech, const double *mu, const double *phi,
                        const double *v, const double *moves);
/* dal_field, of a finite state; what it leaves in force, lambda and gram is of no use. */
int dal__field(dal_mechanics *mech, double t, const double *x, double *xdot);
/* force and lambda at x[2n], with the metric, the forms but for phi, and the gram.  The arguments
 * are checked as dal__require_state does. */
int dal__solve_multipliers(dal_mechanics *mech, const char *name, const double *output, double t,
                           const double *x);
/* *E <- the energy at x[2n], which may overflow. */
int dal__energy(dal_mechanics *mech, double t, const double *x, double *E);
/* How far velocities move, to first order, when the point q and, unless slope_t is NULL, the time t
 * where mu, slope = phi_q and slope_t = phi_t were evaluated become twice themselves; see
 * dal__progress. */
double dal__forms_move(const dal_mechanics *mech, const double *mu, const double *slope,
                       const double *q, const double *slope_t, double t);
/* Both, of x[2n] and the D or D_eps of shift. */
int dal__lies_in_D(dal_mechanics *mech, double t, double shift, const double *x, double *relative,
                   bool *consistent);
/* forms.q <- q - shift v of x[2n]; phi and mu of the forms at (forms.q, v), and phi_q if slopes. */
void dal__move_node(dal_mechanics *mech, double shift, const double *x);
int dal__evaluate_forms(dal_mechanics *mech, double t, const double *v, bool slopes);
/* The forms at q - shift v of x[2n], with phi_q if slopes, but without phi_t; and the metric. */
int dal__forms_at(dal_mechanics *mech, double t, double shift, const double *x, bool slopes);
/* v of x[2n] moves into the D or D_eps of shift, along Z as it is or that of mu, and q with it so
 * that q - shift v is the same but for a rounding; *relative <- what is left of the residual,
 * within its bound.  DAL_ESINGULAR. */
int dal__mend(dal_mechanics *mech, double t, double shift, bool along_Z, double *x,
              double *relative);
/* impulse[m] += that of a change[n] of v, M change = mu^T impulse, just made by dal_project. */
void dal__add_impulse_of(dal_mechanics *mech, const double *change, double *impulse);
/* dal_trajectory of rows that belong to the times t0 + (first + k) h. */
int dal__trajectory(dal_mechanics *mech, double t0, double h, size_t first, double shift,
                    size_t count, const double *x, const double *inputs, double *energy,
                    double *multipliers, double *residual, double *relative, size_t *done);

/* How near C has come to losing its rank along a motion (rank.c).  The pivot of row a is
 * 1/(C^-1)_aa, that of an elimination in which it comes last: the square of what constraint a has
 * beside all others.  It is compared with the largest that it has been, so that the scale of a
 * constraint, or constraints that are nearly dependent all the time, do not matter. */
typedef struct dal__rank {
    double *largest, *found; /* [m] pivots of each row so far; those of the last look, or 0 */
    double *weight, *part;  /* [m], [3n] of dal__rank_pass */
    double least, t;        /* the least beside its largest, 1 at a start; when */
    size_t rows;            /* the sum of 2^a over those as small, for a < 52; 0: not known */
    size_t doubts;          /* looks that found one below what is allowed */
    double inverse;         /* log2 of 1/det C at a start; NaN: not known */
    double range[2];        /* of the same of the matrices of steps: beyond it C is looked at; from
                               1 to 0 if there is none yet */
} dal__rank;
void dal__rank_reserve(dal__rank *rank, size_t n, size_t m, arena *a);
/* found <- the pivots by the forms and the metric as they are; and then these are a start's. */
void dal__rank_find(dal__rank *rank, dal_mechanics *mech);
void dal__rank_start(dal__rank *rank, size_t m);
void dal__rank_save(dal__rank *rank, size_t m, dal__archive *a);
/* to <- from, but where its pivots are. */
void dal__rank_copy(size_t m, const dal__rank *from, dal__rank *to);
/* A look at the state x[2n], moved back by shift v, for pivots below what is allowed; and at a step
 * of h from it, by a scheme of this order, for one that the step does not resolve.  The errors of
 * the callbacks; the text is in mech->error. */
int dal__rank_look(dal__rank *rank, dal_mechanics *mech, double t, double shift, double least,
                   const double *x);
int dal__rank_pass(dal__rank *rank, dal_mechanics *mech, double t, double shift, double h,
                   int order, const double *x);
/* Whether the matrix of a step calls for a look, by log2 of 1/|det|; and then the range is another
 * one. */
bool dal__rank_strays(dal__rank *rank, double inverse);

/* Guards of a motion, which a stepper shares with its integrator. */
struct dal__guards {
    dal__rank rank;
    double allowed;         /* pivot: below it the errors of the steps may choose the branch */
    dal__creep creep;
};
/* Copy the least pivot and the shortest step into the statistics. */
void dal__guards_report(const struct dal__guards *guards, dal_stats *stats);
/* A chart of D, chart.c.  It may be part of another object, as a dal_mechanics may. */
struct dal_chart {
    dal_mechanics mech;
    size_t n, m, width;      /* width = 2n - m, that of xi */
    bool chosen;
    size_t *place;           /* [n]: the dependent coordinates, then the independent ones */
    double *branch;          /* [m] v_dependent where Newton starts */
    dal__linear B;
    double *A;               /* [m*(n-m)] */
    double *right, *solution; /* [m] */
    double *x, *y;           /* [2n] */
    double t;                /* of the state x that Newton lifts */
    double *tableau;         /* [m*width] */
    size_t *former, *owner;  /* [n], [m] */
    /* of dal_chart_step */
    double *w, *R1, *step;   /* [n] */
    double *R2, *kappa;      /* [m] */
    double *K, *slope;       /* [n*n], [m*n] */
    dal__linear G;
    /* of dal_chart_interpolate */
    double *first, *second;  /* [3n] (q, v, vdot) at the ends of an interval */
    size_t *other_place;     /* [n] the choice, beside that of the caller */
    double *other_branch;    /* [m] */
    size_t *last_place;      /* [n] that of the state before */
    arena arena;             /* used only by dal_chart_new */
};

void dal__chart_reserve(dal_chart *chart, const dal_system *system, arena *a);
void dal__chart_bind(dal_chart *chart, const dal_system *system);

/* chart->x <- psi(t, xi) without checking the arguments; for nonlinear constraints Newton starts at
 * the v_dependent that stands there. */
int dal__chart_lift(dal_chart *chart, double t, const double *xi);
/* v_dependent in chart->x moves into D at q - shift v and time t, with B as it is. */
int dal__chart_mend(dal_chart *chart, double t, double shift);
/* dal_chart_drop, the same. */
void dal__chart_drop(const dal_chart *chart, const double *x, double *xi);
/* chart->x <- psi(t, xi), Newton from the state of the choice; DAL_EINVAL unless there is a choice
 * and t and xi[2n-m] are finite. */
int dal__chart_state(dal_chart *chart, double t, const double *xi);
/* B of mu[m*n], factored, in the units of the last dal__build_metric. */
int dal__chart_factor(dal_chart *chart, const double *mu);
/* result[m] <- B^T given[m], B that of mu[m*n]. */
void dal__chart_reduce(const dal_chart *chart, const double *mu, const double *given,
                       double *result);
/* DAL_EINVAL unless there is a choice. */
int dal__chart_ready(dal_chart *chart);
/* dal_chart_condition, without checking the arguments; and whether dal_chart_renew keeps a choice
 * of this condition. */
int dal__chart_condition(dal_chart *chart, double t, const double *x, double *condition);
bool dal__chart_keeps(const dal_chart *chart, double condition);

/* The tolerance where none is given. */
#define DAL_FLOW_TOLERANCE 1e-13

/* dal_flow_apply over span, without checking its arguments and without the accuracy; the projection
 * onto D at the end only if project. */
int dal__flow_apply(dal_flow *flow, double t0, double span, double *x, bool project);

/* Step k of a row of steps of size h from t0, of a flow in x: x[2n] at t0 + k h is taken to t0 +
 * (k+1) h, in D, whose residual raises *worst; on failure x is as it was.  A step begins anew, with
 * inner steps of the size that the step before ended with; but multistep methods go on.
 * dal__flow_forget: what comes next does not follow on what was before.  The inner size, all that a
 * step depends on beside x; NULL for a multistep method. */
int dal__flow_step(dal_flow *flow, double t0, double h, size_t k, double *x, double *worst);
void dal__flow_forget(dal_flow *flow);
/* The guards of the stepper, instead of those of each call. */
void dal__flow_guard(dal_flow *flow, struct dal__guards *guards);
double *dal__flow_inner(dal_flow *flow);

/* What a flow is made of; the error of its mechanics is its own. */
dal_mechanics *dal__flow_mechanics(dal_flow *flow);
double dal__flow_tolerance(const dal_flow *flow);
dal_flow_method dal__flow_method(const dal_flow *flow);

#endif /* DAL__GEOMETRY_H */
