/* momentum.h - a stage of kernel.h in momentum form: for M(q), for forces that depend on v, and for
 * constraints that are not linear.  Only kernel.h includes it.
 *
 * With p = L_v and F = L_q + f, and A, B and the weights those of struct dal_stage, the stage is
 *
 *     q_k = q~ + A h v,    q~' = q_k + B h v',    p' = L_v(q~', v'),
 *     p' - p = h [start F(q~, v) + end F(q~', v')] + mu_k^T kappa,    phi(q~', v') = 0,
 *
 * mu_k = phi_v at q_k and v, or (v + v')/2 where phi is not linear.  A pair (0, a), (1, b) consists
 * of two stages here, because F depends on the state between them.
 *
 * Solution.  Newton's iteration with the matrix at the prediction, K = dR/dv' of the first
 * equation:
 *     K = L_vv + B h L_vq - end h (F_v + B h F_q),    S = (phi_v + B h phi_q) K^-1 mu_k^T,
 * factored once.  The prediction of v' - v uses the last four stages of the same beta.  After a
 * correction L_v, F and phi are evaluated at the state to be stored.  The stage is complete when
 * the balance has a residual of roundoff there, and the residual of D is at most half of its bound.
 * So a smooth step takes one evaluation with second derivatives and one without.  The stored state
 * itself is checked.  The moves in s^a of residual.h need derivatives of phi at this state.  They
 * are evaluated only if the residual exceeds its bound without them.
 *
 * The momentum p is carried from stage to stage, so the residual r of the balance is not lost: p' =
 * L_v(q~', v') + theta r.  The fraction theta_i of a row that is momentum is at most 1: (L_vv)_ii /
 * U_ii with K = L U.  In stiff damping the rest of r is a rounding of F, and not momentum.  While p
 * is carried, low of kernel.h is its rounding error instead of that of v.
 *
 * As in kernel.h, dal_kernel.finish completes a stage that does not contract or is not finite.  It
 * also completes a stage in which a pivot of L_vv, K or S is not positive.  Each row is compared
 * with its own terms.  So decisions do not depend on the scaling of coordinates or forms, and a
 * coordinate does not affect the accuracy of another. */
#ifndef DALEMBERT_MOMENTUM_H
#define DALEMBERT_MOMENTUM_H
/* A row of the balance is satisfied to this many u of its terms, and of the factors of q~'.  Their
 * roundings at the prediction and after the correction change the row by at most u each. */
#define DAL_MOMENTUM_NOISE (8.0 * DAL_KERNEL_U)
#define DAL_MOMENTUM_GRID (4.0 * DAL_KERNEL_U)
/* The factor of this bound if the residual no longer decreases. */
#define DAL_MOMENTUM_FLOOR 64.0
enum { DAL_MOMENTUM_PASSES = 4 };
/* If pivots of K or S are below this fraction of their terms, the full Newton iteration takes over.
 */
#define DAL_MOMENTUM_PIVOT 1e-12

/* The additional properties of a stage in momentum form. */
typedef struct dal_spans {
    double b, early, late;  /* B h, h start, h end */
    bool constant;          /* M */
    bool linear, nonlinear; /* the constraints */
    bool still;             /* q~' is q_k, */
    bool known;             /* and mu(q~') is mu_k */
} dal_spans;
#endif /* DALEMBERT_MOMENTUM_H */

/* ---- once for each inclusion of kernel.h ---------------------------------------------------- */

/* A[size*size], nearly symmetric and positive definite, becomes its factors L and U, without a
 * change of rows, the diagonal of U inverted.  False if a pivot is not positive, or small against
 * the terms that were added up to that entry of the diagonal. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(eliminate)(size_t size, unsigned long long mask, double *A,
                                                  const double *terms)
{
    bool regular = true;
    DAL_KERNEL_UNROLL
    for (size_t j = 0; j < size; j++) {
        const double pivot = A[j * size + j], inverse = 1.0 / pivot;
        if (!(pivot > DAL_MOMENTUM_PIVOT * terms[j])) regular = false;
        A[j * size + j] = inverse;
        DAL_KERNEL_UNROLL
        for (size_t i = j + 1; i < size; i++) {
            if (!DAL_KERNEL_HAS(mask, i * size + j)) continue;
            const double l = A[i * size + j] * inverse;
            A[i * size + j] = l;
            DAL_KERNEL_UNROLL
            for (size_t c = j + 1; c < size; c++)
                if (DAL_KERNEL_HAS(mask, j * size + c)) A[i * size + c] -= l * A[j * size + c];
        }
    }
    return regular;
}

/* y[size] <- A^-1 y. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(solve)(size_t size, unsigned long long mask, const double *A,
                                              double *y)
{
    DAL_KERNEL_UNROLL
    for (size_t i = 1; i < size; i++) {
        DAL_KERNEL_UNROLL
        for (size_t j = 0; j < i; j++)
            if (DAL_KERNEL_HAS(mask, i * size + j)) y[i] -= A[i * size + j] * y[j];
    }
    DAL_KERNEL_UNROLL
    for (size_t back = 1; back <= size; back++) {
        const size_t i = size - back;
        DAL_KERNEL_UNROLL
        for (size_t j = i + 1; j < size; j++)
            if (DAL_KERNEL_HAS(mask, i * size + j)) y[i] -= A[i * size + j] * y[j];
        y[i] *= A[i * size + i];
    }
}

/* ---- begin: p and F at the start, and the known part of p' */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(begin)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    const double *const x = at->x;
    const bool pushed = of->early != 0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) at->push[i] = k->carried ? at->low[n + i] : 0.0;
    if (of->constant && !k->carried) {
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++)
            k->momentum[i] = dal_kernel_dot(n, o->has.inverse, k->mass, i, x + n);
        k->carried = true;
    }
    if (DAL_KERNEL_RARE(!k->carried || (pushed && !k->forced))) {
        DAL_KERNEL_COPY(2 * n, x, k->at.x);
        const int status = DAL_KERNEL_PART(push)(k, o->number, o->stage,
                                                 k->carried ? NULL : k->momentum, pushed);
        if (status) return status;
        k->carried = true;
    }
    const double before = o->kept ? 0.0 : o->stage->before * k->h;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const double way = before * x[n + i];
        at->lead[i] = at->low[i] + way;
        at->from[i] = x[i] + at->lead[i];
        at->node[i] = o->kept ? x[i] : at->from[i];
    }
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        if (pushed) at->push[i] -= of->early * k->force0[i];
        balance->known[i] = k->momentum[i] + at->push[i];
    }
    return DAL_SUCCESS;
}

/* w <- v plus the prediction of v' - v from earlier stages. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(extrapolate)(const dal_kernel *k, const dal_traits *o,
                                                    const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
    const double *const past = k->history + 4 * n * o->stage->kind;
    const double *const weight = o->stage->past[k->known[o->stage->kind]];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        at->w[i] = at->x[n + i] + (weight[3] * past[3 * n + i] + weight[2] * past[2 * n + i]
                                   + weight[1] * past[n + i] + weight[0] * past[i]);
}

/* phi and mu at the state to be stored, and N unless NULL; mu_k if it depends on v'. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(constrain)(dal_kernel *k, const dal_traits *o,
                                                 const dal_spans *of, const dal_arrays *at,
                                                 double *phi, double *N)
{
    DAL_KERNEL_SIZES;
    int returned = 0;
    if (m == 0) return 0;
    if (!of->known)
        returned = DAL_KERNEL_FORMS(k, o->t_end, at->point, at->w, of->linear ? NULL : phi, at->mu,
                                    N);
    if (returned || !of->nonlinear) return returned;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) at->goal[i] = 0.5 * (at->x[n + i] + at->w[i]);
    return DAL_KERNEL_FORMS(k, dal_kernel_time(k, o->number, o->stage->t_node), at->node, at->goal,
                            NULL, at->mu_node, NULL);
}

/* r <- -phi at the state to be stored. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(miss)(const dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const double *phi)
{
    DAL_KERNEL_SIZES;
    (void)k;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++)
        at->r[a] = of->linear ? -dal_kernel_dot(n, o->has.mu, at->mu, a, at->w) : -phi[a];
}

/* The same.  Returns true if every residual is at most half of its bound, and then updates the
 * statistics.  Unless exact, the terms of phi, sum_i |mu^a_i v_i| + |phi^a - mu^a v|, replace s^a
 * of residual.h, which is not smaller. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_within)(dal_kernel *k, const dal_traits *o,
                                                  const dal_spans *of, const dal_arrays *at,
                                                  const dal_balance *balance, bool exact)
{
    DAL_KERNEL_SIZES;
    const double limit = DAL_KERNEL_LIMIT(n);
    const double *const unit = of->constant ? k->unit : balance->unit;
    const double *const per_unit = of->constant ? k->per_unit : balance->per_unit;
    const double speed = exact ? dal_residual_speed(n, per_unit, at->w) : 0.0;
    double largest = k->stats.worst_residual;
    bool settled = true;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        double sum = -0.0, terms = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            if (!DAL_KERNEL_HAS(o->has.mu, a * n + i)) continue;
            const double term = at->mu[a * n + i] * at->w[i];
            sum += term;
            terms += exact ? fabs(at->mu[a * n + i]) * unit[i] * speed : fabs(term);
        }
        const double value = of->linear ? sum : balance->phi[a];
        if (!of->linear) terms += fabs(value - sum);
        at->r[a] = -value;
        if (!of->linear) at->sizes[a] = terms;
        if (!(limit * terms - fabs(value) >= 0.0)) settled = false; /* nor if both are infinite */
        if (fabs(value) > largest * terms) largest = fabs(value) / terms;
    }
    if (settled) k->stats.worst_residual = largest;
    return settled;
}

/* Whether A[n*n] is positive definite: by the pivots of L D L^T, beside its diagonal.  In the lower
 * half of A are then L, and D^-1. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_definite)(const dal_kernel *k, unsigned long long mask,
                                                    double *A, const double *diagonal)
{
    DAL_KERNEL_SIZES;
    (void)k;
    bool definite = true;
    DAL_KERNEL_UNFOLD
    for (size_t j = 0; j < n; j++) {
        const double pivot = A[j * n + j], inverse = 1.0 / pivot;
        if (!(pivot > DAL_MOMENTUM_PIVOT * diagonal[j])) definite = false;
        A[j * n + j] = inverse;
        DAL_KERNEL_UNFOLD
        for (size_t i = j + 1; i < n; i++) {
            if (!DAL_KERNEL_HAS(mask, i * n + j)) continue;
            const double entry = A[i * n + j];
            A[i * n + j] *= inverse;
            DAL_KERNEL_UNFOLD
            for (size_t c = j + 1; c <= i; c++)
                if (DAL_KERNEL_HAS(mask, c * n + j)) A[i * n + c] -= entry * A[c * n + j];
        }
    }
    return definite;
}

/* unit, per_unit <- those of residual.h for the metric L_vv, from L and D^-1 of is_definite: column
 * j of L^-1 determines (M^-1)_jj. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(measure)(const dal_kernel *k, unsigned long long mask,
                                                const dal_balance *balance)
{
    (void)k;
    DAL_KERNEL_SIZES;
    const double *const L = balance->L_vv;
    double *const column = balance->per_unit;
    DAL_KERNEL_UNFOLD
    for (size_t j = 0; j < n; j++) {
        double sum = L[j * n + j];
        DAL_KERNEL_UNFOLD
        for (size_t i = j + 1; i < n; i++) {
            column[i] = DAL_KERNEL_HAS(mask, i * n + j) ? -L[i * n + j] : 0.0;
            DAL_KERNEL_UNFOLD
            for (size_t c = j + 1; c < i; c++)
                if (DAL_KERNEL_HAS(mask, i * n + c)) column[i] -= L[i * n + c] * column[c];
            sum += column[i] * column[i] * L[i * n + i];
        }
        balance->unit[j] = sqrt(sum);
    }
    DAL_KERNEL_UNFOLD
    for (size_t j = 0; j < n; j++) balance->per_unit[j] = 1.0 / balance->unit[j];
}

DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_in_D)(dal_kernel *k, const dal_traits *o,
                                                const dal_spans *of, const dal_arrays *at,
                                                const dal_balance *balance)
{
    if (DAL_KERNEL_PART(is_within)(k, o, of, at, balance, false)) return true;
    if (!of->constant) DAL_KERNEL_PART(measure)(k, o->has.K, balance);
    return DAL_KERNEL_PART(is_within)(k, o, of, at, balance, true);
}

/* The same with the moves, after is_in_D. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_moved)(dal_kernel *k, const dal_traits *o,
                                                 const dal_spans *of, const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
    if (of->linear || o->kept) return false;
    DAL_KERNEL_COPY(n, at->point, k->at.point);
    DAL_KERNEL_COPY(n, at->w, k->at.w);
    if (k->measure(k, o->t_end)) return false;
    const double *const moves = k->at.d;
    double largest = k->stats.worst_residual;
    for (size_t a = 0; a < m; a++) {
        const double s = at->sizes[a] + moves[a], size = fabs(at->r[a]);
        if (!(s <= DBL_MAX && size <= DAL_KERNEL_LIMIT(n) * s)) return false;
        if (size > largest * s) largest = size / s;
    }
    k->stats.worst_residual = largest;
    return true;
}

/* The size of phi relative to its terms. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(distance)(size_t m, const dal_arrays *at)
{
    double most = 0.0;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++)
        if (fabs(at->r[a]) > most * at->sizes[a]) most = fabs(at->r[a]) / at->sizes[a];
    return most;
}

/* Entry ij of K without L_vv. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(turn)(const dal_traits *o, const dal_spans *of,
                                               const dal_balance *balance, size_t ij)
{
    double sum = -0.0;
    if (!of->still && DAL_KERNEL_HAS(o->has.L_vq, ij)) sum += of->b * balance->L_vq[ij];
    if (DAL_KERNEL_HAS(o->has.F_v, ij)) sum -= of->late * balance->F_v[ij];
    if (!of->still && DAL_KERNEL_HAS(o->has.F_q, ij)) sum -= of->late * of->b * balance->F_q[ij];
    return sum;
}

/* K and S, factored, from the evaluations at the prediction; Z; L_vv becomes its factors.  Returns
 * false if one is not regular. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(form)(const dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    double *const factors = balance->factors, *const share = balance->share;
    double *const K = balance->K, *const terms = at->step, b = of->b;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        share[i] = balance->L_vv[i * n + i];
        terms[i] = share[i] + fabs(DAL_KERNEL_PART(turn)(o, of, balance, i * n + i));
        DAL_KERNEL_UNROLL
        for (size_t ij = i * n; ij < (i + 1) * n; ij++)
            factors[ij] = K[ij] = balance->L_vv[ij] + DAL_KERNEL_PART(turn)(o, of, balance, ij);
    }
    if (!of->constant && !DAL_KERNEL_PART(is_definite)(k, o->has.K, balance->L_vv, share))
        return false;
    if (!DAL_KERNEL_PART(eliminate)(n, o->has.K, factors, terms)) return false;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        share[i] *= factors[i * n + i];
        if (!(share[i] < 1.0)) share[i] = 1.0;
    }
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        DAL_KERNEL_COPY(n, at->mu_node + a * n, at->Z + a * n);
        DAL_KERNEL_PART(solve)(n, o->has.K, factors, at->Z + a * n);
    }
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        at->sizes[a] = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t c = 0; c < m; c++) at->S[a * m + c] = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            const bool turns = DAL_KERNEL_HAS(o->has.N, a * n + i);
            if (!turns && !DAL_KERNEL_HAS(o->has.mu, a * n + i)) continue;
            const double mu = at->mu[a * n + i], row = turns ? mu + b * at->N[a * n + i] : mu;
            const double entry = turns ? fabs(mu) + fabs(row) : fabs(mu);
            DAL_KERNEL_UNROLL
            for (size_t c = 0; c < m; c++)
                if (DAL_KERNEL_HAS(o->has.Z, c * n + i))
                    at->S[a * m + c] += row * at->Z[c * n + i];
            if (DAL_KERNEL_HAS(o->has.Z, a * n + i))
                at->sizes[a] += entry * fabs(at->Z[a * n + i]);
        }
    }
    return DAL_KERNEL_PART(eliminate)(m, DAL_KERNEL_ALL, at->S, at->sizes);
}

/* ---- linearise: K and S at the prediction; as in kernel.h > 0 is for finish */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(linearise)(dal_kernel *k, const dal_traits *o,
                                                 const dal_spans *of, const dal_arrays *at,
                                                 const dal_balance *balance)
{
    const dal_stage *const s = o->stage;
    DAL_KERNEL_SIZES;
    int returned = 0;
    if (m > 0 && !of->nonlinear)
        returned = DAL_KERNEL_FORMS(k, dal_kernel_time(k, o->number, s->t_node), at->node,
                                    at->x + n, NULL, at->mu_node, NULL);
    if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
    if (of->known) {
        if (DAL_KERNEL_MASS) DAL_KERNEL_COPY(m * n, at->mu_node, k->forms);
        DAL_KERNEL_COPY(m * n, at->mu_node, at->mu);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < m * n; i++) at->N[i] = 0.0;
    }
    returned = DAL_KERNEL_PART(constrain)(k, o, of, at, balance->phi, at->N);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
    if (returned > 0) return 1;
    returned = DAL_KERNEL_BALANCE(k, o->t_end, of->still ? at->node : at->point, at->w,
                                  balance->L_v, balance->F, balance->L_vq, balance->L_vv,
                                  balance->F_q, balance->F_v);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_BALANCE, returned);
    if (returned > 0) return 1;
    if (!DAL_KERNEL_PART(form)(k, o, of, at, balance)) return 1;
    return DAL_KERNEL_PART(look)(k, o, at);
}

/* reaction <- mu_k^T kappa. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(react)(const dal_kernel *k, const dal_traits *o,
                                              const dal_arrays *at, const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        balance->reaction[i] =
            m > 0 ? dal_kernel_column(n, m, o->has.mu, at->mu_node, i, at->kappa) : 0.0;
}

/* residual <- the residual of the balance of momenta. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(weigh)(const dal_kernel *k, const dal_spans *of,
                                              const dal_arrays *at, const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        at->move[n + i] = at->push[i] + of->late * balance->F[i] + balance->reaction[i];
        balance->residual[i] = k->momentum[i] + at->move[n + i] - balance->L_v[i];
    }
}

/* Whether r may be all roundoff: of v' = v + Z^T kappa + ..., and of q~', through N. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_rounding)(const dal_kernel *k, const dal_traits *o,
                                                    const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
    (void)k;
    bool roundoff = true;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        double terms = -0.0, moved = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            double size = fabs(at->w[i]) + fabs(at->x[n + i]);
            DAL_KERNEL_UNROLL
            for (size_t c = 0; c < m; c++)
                if (DAL_KERNEL_HAS(o->has.Z, c * n + i))
                    size += fabs(at->Z[c * n + i] * at->kappa[c]);
            if (DAL_KERNEL_HAS(o->has.mu, a * n + i)) terms += fabs(at->mu[a * n + i]) * size;
            if (DAL_KERNEL_HAS(o->has.N, a * n + i))
                moved += fabs(at->N[a * n + i]) * (fabs(at->point[i]) + fabs(at->stored[i]));
        }
        const double bound = 2.0 * DAL_KERNEL_U * (2.0 * (double)n * terms + moved);
        if (!(bound - fabs(at->r[a]) >= 0.0)) roundoff = false;
    }
    return roundoff;
}

/* The terms of a row of p' that are not L_v. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(pushes)(const dal_spans *of, const dal_balance *balance,
                                                 size_t i)
{
    return fabs(balance->known[i]) + fabs(of->late * balance->F[i]) + fabs(balance->reaction[i]);
}

/* The ratio of the worst row of the residual to a rounding.  The rounding is that of its terms, of
 * velocities of coupled rows, by the terms of these rows, or of q~'.  At most 1 if every row is a
 * rounding; NaN if a row is NaN.  If all terms are below DBL_MIN, roundings are not proportional to
 * them. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(imbalance)(const dal_kernel *k, const dal_traits *o,
                                                    const dal_spans *of, const dal_arrays *at,
                                                    const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    double worst = 0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const double left = fabs(balance->residual[i]);
        const double own = fabs(balance->known[i]) + fabs(balance->reaction[i])
                         + fabs(balance->L_v[i]);
        if (DAL_MOMENTUM_NOISE * own - left >= 0.0) continue; /* not if both are infinite */
        double terms = DBL_MIN, moved = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t j = 0; j < n; j++) {
            const size_t ij = i * n + j;
            if (DAL_KERNEL_HAS(o->has.K, ij)) {
                const double push =
                    DAL_KERNEL_PART(pushes)(of, balance, j) * balance->factors[j * n + j];
                terms += fabs(balance->K[ij]) * (fabs(at->w[j]) + push + DBL_MIN);
            }
            if (DAL_KERNEL_HAS(o->has.L_vq, ij)) moved += fabs(balance->L_vq[ij] * at->point[j]);
            if (DAL_KERNEL_HAS(o->has.F_q, ij))
                moved += fabs(of->late * balance->F_q[ij] * at->point[j]);
        }
        const double ratio = left / (DAL_MOMENTUM_NOISE * terms + DAL_MOMENTUM_GRID * moved);
        if (!(ratio <= worst)) worst = ratio;
    }
    return worst;
}

/* step, d <- a correction of w and kappa. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(correct)(dal_kernel *k, const dal_traits *o,
                                                  const dal_spans *of, const dal_arrays *at,
                                                  const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    double *const y = at->step;
    DAL_KERNEL_COPY(n, balance->residual, y);
    DAL_KERNEL_PART(solve)(n, o->has.K, balance->factors, y);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        double turn = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++)
            if (DAL_KERNEL_HAS(o->has.N, a * n + i)) turn += at->N[a * n + i] * y[i];
        at->r[a] -= dal_kernel_dot(n, o->has.mu, at->mu, a, y) + of->b * turn;
    }
    if (m > 0) {
        DAL_KERNEL_COPY(m, at->r, at->d);
        DAL_KERNEL_PART(solve)(m, DAL_KERNEL_ALL, at->S, at->d);
    }
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (m > 0) y[i] += dal_kernel_column(n, m, o->has.Z, at->Z, i, at->d);
    k->stats.iterations++;
}

/* ---- close: the balance, by Newton with K and S frozen; *settled: D too */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(close)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance, bool *settled)
{
    DAL_KERNEL_SIZES;
    double last = HUGE_VAL, far = HUGE_VAL;
    DAL_KERNEL_PART(weigh)(k, of, at, balance);
    DAL_KERNEL_PART(miss)(k, o, of, at, balance->phi);
    for (int correction = 1; correction <= DAL_KERNEL_CORRECTIONS; correction++) {
        DAL_KERNEL_PART(correct)(k, o, of, at, balance);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) at->w[i] += at->step[i];
        DAL_KERNEL_UNROLL
        for (size_t a = 0; a < m; a++) at->kappa[a] += at->d[a];
        dal_kernel_place(k, o->stage, n, o->kept, false, at);
        int returned = DAL_KERNEL_PART(constrain)(k, o, of, at, balance->phi, NULL);
        if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        if (returned > 0) return 1;
        returned = DAL_KERNEL_VALUES(k, o->t_end, of->still ? at->node : at->point, at->w,
                                     balance->L_v, balance->F, of->late != 0.0);
        if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_BALANCE, returned);
        if (returned > 0) return 1;
        DAL_KERNEL_PART(react)(k, o, at, balance);
        DAL_KERNEL_PART(weigh)(k, of, at, balance);
        *settled = DAL_KERNEL_PART(is_in_D)(k, o, of, at, balance);
        const double imbalance = DAL_KERNEL_PART(imbalance)(k, o, of, at, balance);
        const bool stalls = !(imbalance <= 0.5 * last);
        last = imbalance;
        const double distance = of->linear ? 0.0 : DAL_KERNEL_PART(distance)(m, at);
        const bool stays = distance > 0.5 * far;
        far = distance;
        if (imbalance <= (stalls ? DAL_MOMENTUM_FLOOR : 1.0)
            && (*settled || DAL_KERNEL_PART(is_rounding)(k, o, at)
                || (stays && DAL_KERNEL_PART(is_moved)(k, o, of, at))))
            return 0;
        if (stalls && !(imbalance <= 1.0)) return 1;
    }
    return 1;
}

/* ---- correction of the velocity to D at the stored q~', with the corresponding reaction.  S is
 * for a variable q~', so each pass leaves a part B h N of the residual. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(mend)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    if (m == 0) return true;
    DAL_KERNEL_COPY(m, at->r, at->d);
    DAL_KERNEL_PART(solve)(m, DAL_KERNEL_ALL, at->S, at->d);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (m > 0) at->w[i] += dal_kernel_column(n, m, o->has.Z, at->Z, i, at->d);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) at->kappa[a] += at->d[a];
    if (!of->linear && DAL_KERNEL_FORMS(k, o->t_end, at->point, at->w, balance->phi, at->mu, NULL))
        return false;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        balance->L_v[i] += balance->share[i]
                         * dal_kernel_column(n, m, o->has.mu, at->mu_node, i, at->d);
    return DAL_KERNEL_PART(is_in_D)(k, o, of, at, balance)
        || DAL_KERNEL_PART(is_moved)(k, o, of, at);
}

/* ---- carry: the data of a completed balance for the next stage */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(carry)(dal_kernel *k, const dal_spans *of,
                                              const dal_arrays *at, const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const double next = balance->L_v[i] + balance->residual[i];
        at->low[n + i] = balance->share[i] * (k->momentum[i] - next + at->move[n + i]);
        k->momentum[i] = balance->L_v[i] + balance->share[i] * balance->residual[i];
        k->force0[i] = -balance->F[i];
    }
    k->carried = true;
    k->forced = of->late != 0.0;
}

/* ---- conclude: as commit of kernel.h */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(conclude)(dal_kernel *k, const dal_traits *o,
                                                 const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
    double *const x = at->x, *const past = k->history + 4 * n * o->stage->kind;
    unsigned char *const count = &k->known[o->stage->kind];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        past[3 * n + i] = past[2 * n + i];
        past[2 * n + i] = past[n + i];
        past[n + i] = past[i];
        past[i] = at->w[i] - x[n + i];
        at->low[i] = x[i] - at->stored[i] + at->move[i];
        if (!k->carried) at->low[n + i] = 0.0;
        x[i] = at->stored[i];
        x[n + i] = at->w[i];
    }
    *count = (unsigned char)(*count + (*count < 4));
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        k->impulse[a] += at->kappa[a];
        k->latest[a] = at->kappa[a];
    }
    k->latest_span = o->stage->span;
}

/* A stage of step number, counted from 0.  The argument explicit, a constant after inlining, may be
 * true if B = 0: mu(q~') is then that of the node. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(momentum)(dal_kernel *const k, const double number,
                                                const dal_stage *const s, const bool explicit,
                                                double *const x, double *const low)
{
    DAL_KERNEL_SIZES;
#ifdef DAL_N
    double node[DAL_N], point[DAL_N], w[DAL_N], goal[DAL_N], step[DAL_N], stored[DAL_N];
    double mu_node[DAL_KERNEL_M * DAL_N], mu[DAL_KERNEL_M * DAL_N], N[DAL_KERNEL_M * DAL_N];
    double Z[DAL_KERNEL_M * DAL_N], S[DAL_KERNEL_M * DAL_KERNEL_M], sizes[5 * DAL_KERNEL_M];
    double r[DAL_KERNEL_M], d[DAL_KERNEL_M], kappa[DAL_KERNEL_M];
    size_t row[DAL_KERNEL_M];
    double from[DAL_N], lead[DAL_N], push[DAL_N], move[2 * DAL_N];
    double known[DAL_N], reaction[DAL_N], residual[DAL_N], share[DAL_N];
    double phi[DAL_KERNEL_M], L_v[DAL_N], F[DAL_N], unit[DAL_N], per_unit[DAL_N];
    double L_vq[DAL_N * DAL_N], L_vv[DAL_N * DAL_N], F_q[DAL_N * DAL_N], F_v[DAL_N * DAL_N];
    double K[DAL_N * DAL_N], factors[DAL_N * DAL_N];
    const dal_arrays at = {x, NULL, low, node, point, w, mu_node, mu, N, known, goal, step, NULL,
                           stored, from, lead, push, move, Z, S, sizes, r, d, kappa, row, NULL,
                           NULL, NULL, 0, NULL, false};
    const dal_balance balance = {known, reaction, residual, share, phi, L_v, F, unit, per_unit,
                                 L_vq, L_vv, F_q, F_v, K, factors};
#else
    (void)low;
    const dal_arrays at = k->at;
    const dal_balance balance = k->balance;
#endif
    const dal_constraint_kind kind = DAL_KERNEL_KIND(k);
    const bool linear = kind == DAL_LINEAR, kept = !DAL_KERNEL_INSIDE && k->kept;
    const dal_spans of = {.b = s->after * k->h, .early = k->h * s->start, .late = k->h * s->end,
                          .constant = DAL_KERNEL_INSIDE ? DAL_KERNEL_MASS : k->mass != NULL,
                          .linear = linear, .nonlinear = kind == DAL_NONLINEAR,
                          .still = explicit && !kept,
                          .known = explicit && linear && !kept};
    const dal_pattern has = DAL_KERNEL_PATTERN;
    const dal_traits o = {.stage = s, .number = number, .has = has, .kept = kept,
                          .t_end = dal_kernel_time(k, number, s->t_end)};

    bool settled = false;
    int status = DAL_KERNEL_PART(begin)(k, &o, &of, &at, &balance);
    if (status) return status;
    DAL_KERNEL_PART(extrapolate)(k, &o, &at);
    dal_kernel_place(k, s, n, kept, false, &at);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) at.kappa[a] = 0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) balance.reaction[i] = 0.0;
    status = DAL_KERNEL_PART(linearise)(k, &o, &of, &at, &balance);
    if (status == 0) status = DAL_KERNEL_PART(close)(k, &o, &of, &at, &balance, &settled);
    if (status < 0) return status;
    bool solved = status == 0;
    if (DAL_KERNEL_RARE(solved && !settled && !kept))
        for (int pass = 0; !settled && pass < DAL_MOMENTUM_PASSES; pass++)
            settled = DAL_KERNEL_PART(mend)(k, &o, &of, &at, &balance);
    if (solved && settled && DAL_KERNEL_PART(is_finite)(n, &at)) {
        DAL_KERNEL_PART(carry)(k, &of, &at, &balance);
    } else {
        status = DAL_KERNEL_PART(hand_over)(k, &o, &at, &solved);
        if (status) return status;
        k->carried = k->forced = false;
    }
    DAL_KERNEL_PART(conclude)(k, &o, &at);
    k->formed = DAL_KERNEL_MASS && of.known;
    return DAL_SUCCESS;
}
