/* arrays.h - the vectors and matrices of a stage, for numbers of one type.
 *
 * The includer defines the types of a number, dal_real, of a decision, dal_flag, and of an exchange
 * of rows, dal_exchange; and DAL_ARRAYS(name), the names of the types here.  kernel.h includes this
 * file for double, lanes.h for vectors. */

/* The vectors and matrices of a stage. */
typedef struct DAL_ARRAYS(arrays) {
    dal_real *x;                  /* [2n] the state */
    dal_real *dv_history;         /* [3n] the unknown parts of v' - v, the latest stage first */
    dal_real *residue;            /* [2n] rounding error of x: the exact sum is x + residue */
    dal_real *node, *point, *w;   /* [n] q_k, q~' of the last evaluation, the current v' */
    dal_real *mu_node, *mu, *N;   /* [m*n] */
    dal_real *v_known, *v_free;   /* [n] the known part of v', and all of it but Z^T kappa */
    dal_real *step;               /* [n] w' - w */
    dal_real *seen;               /* [n] the v' at whose q~' mu was evaluated last */
    dal_real *stored;             /* [n] the position of the new state */
    dal_real *from;               /* [n] q_k including residue */
    dal_real *dq_known, *dv_known; /* [n] the known part of q~' - q~ and of v' - v, with residue */
    dal_real *dx;                 /* [2n] q~' - q~ and v' - v, before they are rounded to x' */
    dal_real *Z;                  /* [m*n] row a is M^-1 mu_node^a */
    dal_real *S, *sizes, *r, *d, *kappa; /* [m*m], [5*m] (see lu.h), [m] */
    dal_exchange *row;            /* [m] of lu.h; in lanes [m*m] */
    /* as in dal_kernel; constants if the compilation knows that M is 1 */
    const dal_real *mass_inverse, *unit, *per_unit;
    size_t next;                  /* distance in mass_inverse to the next entry of the diagonal */
    /* only for variable sizes: */
    const dal_rows *rows;         /* stored entries of [m*n]; NULL: all */
    bool dragged;                 /* V_q stands for -(L_q + f), f at the velocity there */
    dal_flag *tally;              /* only in lanes: the operations of the stage, counted */
} DAL_ARRAYS(arrays);

typedef struct DAL_ARRAYS(masses) {
    const dal_real *mass_inverse, *unit, *per_unit;
} DAL_ARRAYS(masses);

/* The additional arrays of a stage of momentum.h. */
typedef struct DAL_ARRAYS(balance) {
    dal_real *known;               /* [n] the part of p' that is known at the start */
    dal_real *reaction, *residual; /* [n] mu_k^T kappa; the residual of the balance */
    dal_real *theta;               /* [n] fraction of the residual that is momentum */
    dal_real *phi;                 /* [m] */
    dal_real *L_v, *F;             /* [n] at the last evaluation, F = L_q + f */
    dal_real *unit, *per_unit;     /* [n] of residual.h for L_vv */
    dal_real *L_vq, *L_vv, *F_q, *F_v; /* [n*n] at the prediction */
    dal_real *K, *factors;         /* [n*n] */
} DAL_ARRAYS(balance);

/* The constant properties of a stage; compile-time constants if they are known. */
typedef struct DAL_ARRAYS(traits) {
    const dal_stage *stage;
    dal_real number; /* number of the step, from 0 */
    dal_real t_end;  /* time of the end of the stage */
    dal_pattern has;
    bool plain, kept, potential, steady;
    bool constant_rate; /* as in dal_kernel, for moved nodes */
    bool ends;  /* V_q acts at the unknown q~' */
    bool known; /* mu(q~') needs no evaluation */
    bool force_after_S; /* nor is V_q: it is evaluated after S, which need not wait for the state */
} DAL_ARRAYS(traits);

/* The additional properties of a stage of momentum.h. */
typedef struct DAL_ARRAYS(momentum_traits) {
    dal_real b, early, late;  /* B h, h start, h end */
    bool pushed, late_pushed; /* whether the last two are not 0 */
    bool constant;            /* M */
    bool linear, nonlinear;   /* the constraints */
    bool still;               /* q~' is q_k, */
    bool known;               /* and mu(q~') is mu_k */
} DAL_ARRAYS(momentum_traits);

/* The state of the iteration of a stage. */
typedef struct DAL_ARRAYS(progress) {
    dal_flag open, solved, settled; /* in iteration; done; and with the residual that it needs */
    dal_flag passed;                /* mu was not evaluated after the last correction, */
    dal_flag anew;                  /* nor after the one before: this one may be larger */
    dal_real last;                  /* the size of the last correction */
} DAL_ARRAYS(progress);

#undef DAL_ARRAYS
