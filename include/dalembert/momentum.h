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
 * is carried, residue of kernel.h is its rounding error instead of that of v.
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

#endif /* DALEMBERT_MOMENTUM_H */

/* ---- once for each inclusion of kernel.h ---------------------------------------------------- */

/* A[size*size], nearly symmetric and positive definite, becomes its factors L and U, without a
 * change of rows, the diagonal of U inverted.  False if a pivot is not positive, or small against
 * the terms that were added up to that entry of the diagonal. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(eliminate)(size_t size, unsigned long long mask,
                                                      dal_real *A, const dal_real *terms)
{
    dal_flag regular = DAL_FLAG(true);
    DAL_KERNEL_UNROLL
    for (size_t j = 0; j < size; j++) {
        const dal_real pivot = A[j * size + j], inverse = 1.0 / pivot;
        regular = DAL_ALSO(regular, pivot > DAL_MOMENTUM_PIVOT * terms[j]);
        A[j * size + j] = inverse;
        DAL_KERNEL_UNROLL
        for (size_t i = j + 1; i < size; i++) {
            if (!DAL_KERNEL_HAS(mask, i * size + j)) continue;
            const dal_real l = A[i * size + j] * inverse;
            A[i * size + j] = l;
            DAL_KERNEL_UNROLL
            for (size_t c = j + 1; c < size; c++)
                if (DAL_KERNEL_HAS(mask, j * size + c)) A[i * size + c] -= l * A[j * size + c];
        }
    }
    return regular;
}

/* y[size] <- A^-1 y. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(solve)(size_t size, unsigned long long mask,
                                              const dal_real *A, dal_real *y)
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
DAL_KERNEL_INLINE int DAL_KERNEL_PART(begin)(dal_kernel_of *k, const dal_traits_of *traits,
                                             const dal_momentum_traits_of *mom,
                                             const dal_arrays_of *work,
                                             const dal_balance_of *balance, dal_flag going)
{
    DAL_KERNEL_SIZES;
    const dal_real *const x = work->x;
    const bool pushed = mom->pushed;
    dal_flag unknown = DAL_AND(going, DAL_NOT(k->carried));
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        work->dv_known[i] = DAL_SELECT(k->carried, work->residue[n + i], DAL_NUMBER(0.0));
    if (mom->constant && DAL_ANY(unknown)) {
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++)
            k->momentum[i] = DAL_SELECT(
                unknown, DAL_KERNEL_PART(dot)(n, traits->has.inverse, k->mass, i, x + n),
                k->momentum[i]);
    }
    if (mom->constant) unknown = DAL_FLAG(false);
    const dal_flag forces = pushed ? DAL_OR(unknown, DAL_AND(going, DAL_NOT(k->forced)))
                                   : DAL_FLAG(false);
    if (DAL_KERNEL_RARE(DAL_ANY(DAL_OR(unknown, forces)))) {
        if (!DAL_KERNEL_LANES) DAL_KERNEL_COPY(2 * n, x, k->at.x);
        const int status = DAL_KERNEL_PART(push)(k, traits->number, traits->stage, unknown, forces);
        if (status) return status;
        DAL_COUNT_START(work->tally, DAL_OR(unknown, forces));
    }
    const dal_real before = (traits->kept ? 0.0 : traits->stage->A) * k->h;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const dal_real way = before * x[n + i];
        work->dq_known[i] = work->residue[i] + way;
        work->from[i] = x[i] + work->dq_known[i];
        work->node[i] = traits->kept ? x[i] : work->from[i];
    }
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        if (pushed) work->dv_known[i] -= mom->early * k->force0[i];
        balance->known[i] = k->momentum[i] + work->dv_known[i];
    }
    return DAL_SUCCESS;
}

/* w <- v plus the prediction of v' - v from earlier stages. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(extrapolate)(const dal_kernel_of *k,
                                                    const dal_traits_of *traits,
                                                    const dal_arrays_of *work)
{
    DAL_KERNEL_SIZES;
    const dal_real *const past = k->history + 4 * n * traits->stage->kind;
    DAL_WEIGHTS(weight, k, traits->stage);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        work->w[i] = work->x[n + i] + (weight[3] * past[3 * n + i] + weight[2] * past[2 * n + i]
                                       + weight[1] * past[n + i] + weight[0] * past[i]);
}

/* phi and mu at the state to be stored, and N unless NULL; mu_k if it depends on v'. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(constrain)(dal_kernel_of *k, const dal_traits_of *traits,
                                                 const dal_momentum_traits_of *mom,
                                                 const dal_arrays_of *work, dal_flag which,
                                                 dal_real *phi, dal_real *N)
{
    DAL_KERNEL_SIZES;
    int returned = 0;
    (void)which;
    if (m == 0) return 0;
    if (!mom->known)
        returned = DAL_FORMS(k, work, which, traits->t_end, work->point, work->w,
                             mom->linear ? NULL : phi, work->mu, N);
    if (returned || !mom->nonlinear) return returned;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) work->v_free[i] = 0.5 * (work->x[n + i] + work->w[i]);
    return DAL_FORMS(k, work, which, DAL_KERNEL_TIME(k, traits->number, traits->stage->t_node),
                     work->node, work->v_free, NULL, work->mu_node, NULL);
}

/* r <- -phi at the state to be stored. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(miss)(const dal_kernel_of *k, const dal_traits_of *traits,
                                             const dal_momentum_traits_of *mom,
                                             const dal_arrays_of *work, const dal_real *phi)
{
    DAL_KERNEL_SIZES;
    (void)k;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++)
        work->r[a] = mom->linear ? -DAL_KERNEL_PART(dot)(n, traits->has.mu, work->mu, a, work->w)
                                 : -phi[a];
}

/* The same.  Returns those of these lanes in which every residual is at most half of its bound, and
 * updates their statistics.  Unless exact, the terms of phi, sum_i |mu^a_i v_i| + |phi^a - mu^a v|,
 * replace s^a of residual.h, which is not smaller. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(is_within)(dal_kernel_of *k, const dal_traits_of *traits,
                                                      const dal_momentum_traits_of *mom,
                                                      const dal_arrays_of *work,
                                                      const dal_balance_of *balance,
                                                      dal_flag which, bool exact)
{
    DAL_KERNEL_SIZES;
    const double limit = DAL_KERNEL_LIMIT(n);
    const dal_real *const unit = mom->constant ? k->unit : balance->unit;
    const dal_real *const per_unit = mom->constant ? k->per_unit : balance->per_unit;
    const dal_real speed = exact ? DAL_KERNEL_PART(speed)(n, per_unit, work->w) : DAL_NUMBER(0.0);
    dal_real largest = k->stats.worst_residual;
    dal_flag settled = which;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        dal_real sum = DAL_NUMBER(-0.0), terms = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            if (!DAL_KERNEL_HAS(traits->has.mu, a * n + i)) continue;
            const dal_real term = work->mu[a * n + i] * work->w[i];
            sum += term;
            terms += exact ? DAL_ABS(work->mu[a * n + i]) * unit[i] * speed : DAL_ABS(term);
        }
        const dal_real value = mom->linear ? sum : balance->phi[a];
        if (!mom->linear) terms += DAL_ABS(value - sum);
        work->r[a] = -value;
        if (!mom->linear) work->sizes[a] = DAL_TAKE(!exact, which, terms, work->sizes[a]);
        /* nor if both are infinite */
        settled = DAL_ALSO(settled, limit * terms - DAL_ABS(value) >= 0.0);
        const dal_flag larger = DAL_ABS(value) > largest * terms;
        if (DAL_ANY(larger)) largest = DAL_SELECT(larger, DAL_ABS(value) / terms, largest);
    }
    if (DAL_ANY(settled))
        k->stats.worst_residual = DAL_SELECT(settled, largest, k->stats.worst_residual);
    return settled;
}

/* Whether A[n*n] is positive definite, by the pivots of L D L^T. */
DAL_FIELD_ELIMINATION(DAL_KERNEL_PART(is_definite), dal_real, dal_flag, DAL_KERNEL_UNFOLD)

/* unit, per_unit <- those of residual.h for the metric L_vv, from L and D^-1 of is_definite: column
 * j of L^-1 determines (M^-1)_jj. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(measure)(const dal_kernel_of *k, unsigned long long mask,
                                                const dal_balance_of *balance)
{
    (void)k;
    DAL_KERNEL_SIZES;
    const dal_real *const L = balance->L_vv;
    dal_real *const column = balance->per_unit;
    DAL_KERNEL_UNFOLD
    for (size_t j = 0; j < n; j++) {
        dal_real sum = L[j * n + j];
        DAL_KERNEL_UNFOLD
        for (size_t i = j + 1; i < n; i++) {
            column[i] = DAL_KERNEL_HAS(mask, i * n + j) ? -L[i * n + j] : DAL_NUMBER(0.0);
            DAL_KERNEL_UNFOLD
            for (size_t c = j + 1; c < i; c++)
                if (DAL_KERNEL_HAS(mask, i * n + c)) column[i] -= L[i * n + c] * column[c];
            sum += column[i] * column[i] * L[i * n + i];
        }
        balance->unit[j] = DAL_SQRT(sum);
    }
    DAL_KERNEL_UNFOLD
    for (size_t j = 0; j < n; j++) balance->per_unit[j] = 1.0 / balance->unit[j];
}

DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(is_in_D)(dal_kernel_of *k, const dal_traits_of *traits,
                                                    const dal_momentum_traits_of *mom,
                                                    const dal_arrays_of *work,
                                                    const dal_balance_of *balance, dal_flag which)
{
    const dal_flag within = DAL_KERNEL_PART(is_within)(k, traits, mom, work, balance, which, false);
    const dal_flag rest = DAL_AND(which, DAL_NOT(within));
    if (!DAL_ANY(rest)) return within;
    if (!mom->constant) DAL_KERNEL_PART(measure)(k, traits->has.K, balance);
    return DAL_OR(within, DAL_KERNEL_PART(is_within)(k, traits, mom, work, balance, rest, true));
}

#if !DAL_KERNEL_LANES
/* The same with the moves, after is_in_D. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_moved)(dal_kernel *k, const dal_traits *traits,
                                                 const dal_momentum_traits *mom,
                                                 const dal_arrays *work, bool which, bool *open)
{
    DAL_KERNEL_SIZES;
    (void)which, (void)open;
    if (mom->linear || traits->kept) return false;
    DAL_KERNEL_COPY(n, work->point, k->at.point);
    DAL_KERNEL_COPY(n, work->w, k->at.w);
    if (k->measure(k, traits->t_end)) return false;
    const double *const moves = k->at.d;
    double largest = k->stats.worst_residual;
    for (size_t a = 0; a < m; a++) {
        const double s = work->sizes[a] + moves[a], size = fabs(work->r[a]);
        if (!(s <= DBL_MAX && size <= DAL_KERNEL_LIMIT(n) * s)) return false;
        if (size > largest * s) largest = size / s;
    }
    k->stats.worst_residual = largest;
    return true;
}
#endif

/* The size of phi relative to its terms. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(distance)(size_t m, const dal_arrays_of *work)
{
    dal_real most = DAL_NUMBER(0.0);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++)
        most = DAL_SELECT(DAL_ABS(work->r[a]) > most * work->sizes[a],
                          DAL_ABS(work->r[a]) / work->sizes[a], most);
    return most;
}

/* Entry ij of K without L_vv. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(turn)(const dal_traits_of *traits,
                                                 const dal_momentum_traits_of *mom,
                                                 const dal_balance_of *balance, size_t ij)
{
    dal_real sum = DAL_NUMBER(-0.0);
    if (!mom->still && DAL_KERNEL_HAS(traits->has.L_vq, ij)) sum += mom->b * balance->L_vq[ij];
    if (DAL_KERNEL_HAS(traits->has.F_v, ij)) sum -= mom->late * balance->F_v[ij];
    if (!mom->still && DAL_KERNEL_HAS(traits->has.F_q, ij))
        sum -= mom->late * mom->b * balance->F_q[ij];
    return sum;
}

/* K and S, factored, from the evaluations at the prediction; Z; L_vv becomes its factors.  Returns
 * false if one is not regular. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(build_K)(const dal_kernel_of *k,
                                                    const dal_traits_of *traits,
                                                    const dal_momentum_traits_of *mom,
                                                    const dal_arrays_of *work,
                                                    const dal_balance_of *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    dal_real *const factors = balance->factors, *const theta = balance->theta;
    dal_real *const K = balance->K, *const terms = work->step;
    const dal_real b = mom->b;
    dal_flag regular = DAL_FLAG(true);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        theta[i] = balance->L_vv[i * n + i];
        terms[i] = theta[i] + DAL_ABS(DAL_KERNEL_PART(turn)(traits, mom, balance, i * n + i));
        DAL_KERNEL_UNROLL
        for (size_t ij = i * n; ij < (i + 1) * n; ij++)
            factors[ij] = K[ij] =
                balance->L_vv[ij] + DAL_KERNEL_PART(turn)(traits, mom, balance, ij);
    }
    if (!mom->constant)
        regular = DAL_KERNEL_PART(is_definite)(n, traits->has.K, balance->L_vv, theta,
                                               DAL_MOMENTUM_PIVOT, regular);
    if (!DAL_ANY(regular)) return regular;
    regular = DAL_ALSO(regular, DAL_KERNEL_PART(eliminate)(n, traits->has.K, factors, terms));
    if (!DAL_ANY(regular)) return regular;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        theta[i] *= factors[i * n + i];
        theta[i] = DAL_SELECT(theta[i] < 1.0, theta[i], DAL_NUMBER(1.0));
    }
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        DAL_KERNEL_COPY(n, work->mu_node + a * n, work->Z + a * n);
        DAL_KERNEL_PART(solve)(n, traits->has.K, factors, work->Z + a * n);
    }
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        work->sizes[a] = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t c = 0; c < m; c++) work->S[a * m + c] = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            const bool has_N = DAL_KERNEL_HAS(traits->has.N, a * n + i);
            if (!has_N && !DAL_KERNEL_HAS(traits->has.mu, a * n + i)) continue;
            const dal_real mu = work->mu[a * n + i], row = has_N ? mu + b * work->N[a * n + i] : mu;
            const dal_real entry = has_N ? DAL_ABS(mu) + DAL_ABS(row) : DAL_ABS(mu);
            DAL_KERNEL_UNROLL
            for (size_t c = 0; c < m; c++)
                if (DAL_KERNEL_HAS(traits->has.Z, c * n + i))
                    work->S[a * m + c] += row * work->Z[c * n + i];
            if (DAL_KERNEL_HAS(traits->has.Z, a * n + i))
                work->sizes[a] += entry * DAL_ABS(work->Z[a * n + i]);
        }
    }
    return DAL_ALSO(regular,
                    DAL_KERNEL_PART(eliminate)(m, DAL_KERNEL_ALL, work->S, work->sizes));
}

/* ---- linearise: K and S at the prediction; as in kernel.h > 0 is for finish */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(linearise)(dal_kernel_of *k, const dal_traits_of *traits,
                                                 const dal_momentum_traits_of *mom,
                                                 const dal_arrays_of *work,
                                                 const dal_balance_of *balance, dal_flag *open)
{
    const dal_stage *const s = traits->stage;
    DAL_KERNEL_SIZES;
    const dal_flag which = *open;
    int returned = 0;
    (void)which;
    if (m > 0 && !mom->nonlinear)
        returned = DAL_FORMS(k, work, which, DAL_KERNEL_TIME(k, traits->number, s->t_node),
                             work->node, work->x + n, NULL, work->mu_node, NULL);
    if (returned) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, returned);
    if (mom->known) {
        if (DAL_KERNEL_MASS) DAL_KERNEL_COPY(m * n, work->mu_node, k->forms);
        DAL_KERNEL_COPY(m * n, work->mu_node, work->mu);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < m * n; i++) work->N[i] = DAL_NUMBER(0.0);
    }
    returned = DAL_KERNEL_PART(constrain)(k, traits, mom, work, which, balance->phi, work->N);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, returned);
    if (returned > 0) return 1;
    returned = DAL_BALANCE(k, work, which, traits->t_end, mom->still ? work->node : work->point,
                           work->w, balance->L_v, balance->F, balance->L_vq, balance->L_vv,
                           balance->F_q, balance->F_v);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_BALANCE, returned);
    if (returned > 0) return 1;
    *open = DAL_AND(which, DAL_KERNEL_PART(build_K)(k, traits, mom, work, balance));
    return DAL_ANY(*open) ? DAL_KERNEL_PART(look)(k, traits, work, open) : 1;
}

/* reaction <- mu_k^T kappa. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(react)(const dal_kernel_of *k, const dal_traits_of *traits,
                                              const dal_arrays_of *work,
                                              const dal_balance_of *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        balance->reaction[i] =
            m > 0 ? DAL_KERNEL_PART(column)(n, m, traits->has.mu, work->mu_node, i, work->kappa)
                  : DAL_NUMBER(0.0);
}

/* residual <- the residual of the balance of momenta. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(weigh)(const dal_kernel_of *k,
                                              const dal_momentum_traits_of *mom,
                                              const dal_arrays_of *work,
                                              const dal_balance_of *balance)
{
    DAL_KERNEL_SIZES;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        work->dx[n + i] = work->dv_known[i] + mom->late * balance->F[i] + balance->reaction[i];
        balance->residual[i] = k->momentum[i] + work->dx[n + i] - balance->L_v[i];
    }
}

/* Whether r may be all roundoff: of v' = v + Z^T kappa + ..., and of q~', through N. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(is_rounding)(const dal_kernel_of *k,
                                                        const dal_traits_of *traits,
                                                        const dal_arrays_of *work)
{
    DAL_KERNEL_SIZES;
    (void)k;
    dal_flag roundoff = DAL_FLAG(true);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        dal_real terms = DAL_NUMBER(-0.0), moved = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            dal_real size = DAL_ABS(work->w[i]) + DAL_ABS(work->x[n + i]);
            DAL_KERNEL_UNROLL
            for (size_t c = 0; c < m; c++)
                if (DAL_KERNEL_HAS(traits->has.Z, c * n + i))
                    size += DAL_ABS(work->Z[c * n + i] * work->kappa[c]);
            if (DAL_KERNEL_HAS(traits->has.mu, a * n + i))
                terms += DAL_ABS(work->mu[a * n + i]) * size;
            if (DAL_KERNEL_HAS(traits->has.N, a * n + i))
                moved += DAL_ABS(work->N[a * n + i])
                       * (DAL_ABS(work->point[i]) + DAL_ABS(work->stored[i]));
        }
        const dal_real bound = 2.0 * DAL_KERNEL_U * (2.0 * (double)n * terms + moved);
        roundoff = DAL_ALSO(roundoff, bound - DAL_ABS(work->r[a]) >= 0.0);
    }
    return roundoff;
}

/* The terms of a row of p' that are not L_v. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(pushes)(const dal_momentum_traits_of *mom,
                                                   const dal_balance_of *balance, size_t i)
{
    return DAL_ABS(balance->known[i]) + DAL_ABS(mom->late * balance->F[i])
         + DAL_ABS(balance->reaction[i]);
}

/* The ratio of the worst row of the residual to a rounding.  The rounding is that of its terms, of
 * velocities of coupled rows, by the terms of these rows, or of q~'.  At most 1 if every row is a
 * rounding; NaN if a row is NaN.  If all terms are below DBL_MIN, roundings are not proportional to
 * them. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(imbalance)(const dal_kernel_of *k,
                                                      const dal_traits_of *traits,
                                                      const dal_momentum_traits_of *mom,
                                                      const dal_arrays_of *work,
                                                      const dal_balance_of *balance,
                                                      dal_flag which)
{
    DAL_KERNEL_SIZES;
    (void)k;
    dal_real worst = DAL_NUMBER(0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const dal_real left = DAL_ABS(balance->residual[i]);
        const dal_real own = DAL_ABS(balance->known[i]) + DAL_ABS(balance->reaction[i])
                         + DAL_ABS(balance->L_v[i]);
        const dal_flag small = DAL_MOMENTUM_NOISE * own - left >= 0.0; /* not if infinite both */
        if (!DAL_ANY(DAL_AND(which, DAL_NOT(small)))) continue;
        dal_real terms = DAL_NUMBER(DBL_MIN), moved = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t j = 0; j < n; j++) {
            const size_t ij = i * n + j;
            if (DAL_KERNEL_HAS(traits->has.K, ij)) {
                const dal_real push =
                    DAL_KERNEL_PART(pushes)(mom, balance, j) * balance->factors[j * n + j];
                terms += DAL_ABS(balance->K[ij]) * (DAL_ABS(work->w[j]) + push + DBL_MIN);
            }
            if (DAL_KERNEL_HAS(traits->has.L_vq, ij))
                moved += DAL_ABS(balance->L_vq[ij] * work->point[j]);
            if (DAL_KERNEL_HAS(traits->has.F_q, ij))
                moved += DAL_ABS(mom->late * balance->F_q[ij] * work->point[j]);
        }
        const dal_real ratio = left / (DAL_MOMENTUM_NOISE * terms + DAL_MOMENTUM_GRID * moved);
        worst = DAL_SELECT(DAL_OR(small, ratio <= worst), worst, ratio);
    }
    return worst;
}

/* step, d <- a correction of w and kappa. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(correct_balance)(dal_kernel_of *k,
                                                        const dal_traits_of *traits,
                                                        const dal_momentum_traits_of *mom,
                                                        const dal_arrays_of *work,
                                                        const dal_balance_of *balance,
                                                        dal_flag open)
{
    DAL_KERNEL_SIZES;
    dal_real *const y = work->step;
    (void)open;
    DAL_KERNEL_COPY(n, balance->residual, y);
    DAL_KERNEL_PART(solve)(n, traits->has.K, balance->factors, y);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        dal_real turn = DAL_NUMBER(-0.0);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++)
            if (DAL_KERNEL_HAS(traits->has.N, a * n + i)) turn += work->N[a * n + i] * y[i];
        work->r[a] -= DAL_KERNEL_PART(dot)(n, traits->has.mu, work->mu, a, y) + mom->b * turn;
    }
    if (m > 0) {
        DAL_KERNEL_COPY(m, work->r, work->d);
        DAL_KERNEL_PART(solve)(m, DAL_KERNEL_ALL, work->S, work->d);
    }
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (m > 0) y[i] += DAL_KERNEL_PART(column)(n, m, traits->has.Z, work->Z, i, work->d);
    DAL_COUNT_ITERATION(k, work, open);
}

/* A correction of the open lanes, and the evaluations after it; returns as correct of stage.h. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(improve)(dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_momentum_traits_of *mom,
                                               const dal_arrays_of *work,
                                               const dal_balance_of *balance,
                                               dal_progress_of *progress, dal_real *far, bool all)
{
    DAL_KERNEL_SIZES;
    const dal_flag which = progress->open;
    (void)all, (void)which;
    DAL_KERNEL_PART(correct_balance)(k, traits, mom, work, balance, which);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        work->w[i] = DAL_TAKE(all, which, work->w[i] + work->step[i], work->w[i]);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++)
        work->kappa[a] = DAL_TAKE(all, which, work->kappa[a] + work->d[a], work->kappa[a]);
    DAL_KERNEL_PART(place)(k, traits->stage, n, traits->kept, false, work);
    int returned = DAL_KERNEL_PART(constrain)(k, traits, mom, work, which, balance->phi, NULL);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, returned);
    if (returned > 0) return 1;
    returned = DAL_VALUES(k, work, which, traits->t_end, mom->still ? work->node : work->point,
                          work->w, balance->L_v, balance->F, mom->late_pushed);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_BALANCE, returned);
    if (returned > 0) return 1;
    DAL_KERNEL_PART(react)(k, traits, work, balance);
    DAL_KERNEL_PART(weigh)(k, mom, work, balance);
    const dal_flag settled = DAL_KERNEL_PART(is_in_D)(k, traits, mom, work, balance, which);
    const dal_real imbalance = DAL_KERNEL_PART(imbalance)(k, traits, mom, work, balance, which);
    const dal_flag stalls = DAL_NOT(imbalance <= 0.5 * progress->last);
    progress->last = imbalance;
    const dal_real distance = mom->linear ? DAL_NUMBER(0.0) : DAL_KERNEL_PART(distance)(m, work);
    const dal_flag stays = distance > 0.5 * *far;
    *far = distance;
    const dal_flag balanced = DAL_AND(
        which, imbalance <= DAL_SELECT(stalls, DAL_NUMBER(DAL_MOMENTUM_FLOOR), DAL_NUMBER(1.0)));
    dal_flag done = DAL_AND(balanced, settled);
    if (DAL_ANY(DAL_AND(balanced, DAL_NOT(done))))
        done = DAL_OR(done, DAL_AND(balanced, DAL_KERNEL_PART(is_rounding)(k, traits, work)));
    dal_flag moved = DAL_AND(DAL_AND(balanced, stays), DAL_NOT(done));
    if (DAL_ANY(moved)) {
        moved = DAL_KERNEL_PART(is_moved)(k, traits, mom, work, moved, &progress->open);
        done = DAL_OR(done, moved);
    }
    progress->settled = DAL_OR(progress->settled, DAL_AND(done, settled));
    progress->solved = DAL_OR(progress->solved, done);
    progress->open = DAL_AND(DAL_AND(progress->open, DAL_NOT(done)),
                             DAL_OR(DAL_NOT(stalls), imbalance <= 1.0));
    return DAL_ANY(progress->open) ? DAL_KERNEL_AGAIN : DAL_SUCCESS;
}

/* ---- close: the balance, by Newton with K and S frozen */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(close)(dal_kernel_of *k, const dal_traits_of *traits,
                                             const dal_momentum_traits_of *mom,
                                             const dal_arrays_of *work,
                                             const dal_balance_of *balance,
                                             dal_progress_of *progress)
{
    dal_real far = DAL_NUMBER(HUGE_VAL);
    int status = DAL_KERNEL_AGAIN;
    progress->last = DAL_NUMBER(HUGE_VAL);
    DAL_KERNEL_PART(weigh)(k, mom, work, balance);
    DAL_KERNEL_PART(miss)(k, traits, mom, work, balance->phi);
    for (int i = 1; i <= DAL_KERNEL_CORRECTIONS && status == DAL_KERNEL_AGAIN; i++)
        status = DAL_KERNEL_PART(improve)(k, traits, mom, work, balance, progress, &far,
                                          !DAL_KERNEL_LANES);
    return status < 0 ? status : DAL_ANY(progress->solved) ? DAL_SUCCESS : 1;
}

/* ---- correction of the velocity to D at the stored q~', with the corresponding reaction, in lanes
 * that are solved but not settled.  S is for a variable q~', so each pass leaves a part B h N of
 * the residual.  Returns the lanes that it settles; rest <- those that another pass may. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(mend)(dal_kernel_of *k, const dal_traits_of *traits,
                                                 const dal_momentum_traits_of *mom,
                                                 const dal_arrays_of *work,
                                                 const dal_balance_of *balance, dal_flag *rest)
{
    DAL_KERNEL_SIZES;
    const dal_flag which = *rest;
    (void)which;
    if (m == 0) return DAL_FLAG(true);
    DAL_KERNEL_COPY(m, work->r, work->d);
    DAL_KERNEL_PART(solve)(m, DAL_KERNEL_ALL, work->S, work->d);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) work->d[a] = DAL_TAKE(false, which, work->d[a], DAL_NUMBER(0.0));
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        work->w[i] = DAL_TAKE(
            false, which,
            work->w[i] + DAL_KERNEL_PART(column)(n, m, traits->has.Z, work->Z, i, work->d),
            work->w[i]);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) work->kappa[a] += work->d[a];
    if (!mom->linear
        && DAL_FORMS(k, work, which, traits->t_end, work->point, work->w, balance->phi, work->mu,
                     NULL))
        return DAL_FLAG(false);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        balance->L_v[i] = DAL_TAKE(
            false, which,
            balance->L_v[i] + balance->theta[i] * DAL_KERNEL_PART(column)(n, m, traits->has.mu,
                                                                         work->mu_node, i, work->d),
            balance->L_v[i]);
    const dal_flag settled = DAL_KERNEL_PART(is_in_D)(k, traits, mom, work, balance, which);
    *rest = DAL_AND(which, DAL_NOT(settled));
    if (!DAL_ANY(*rest)) return settled;
    const dal_flag moved = DAL_KERNEL_PART(is_moved)(k, traits, mom, work, *rest, rest);
    *rest = DAL_AND(*rest, DAL_NOT(moved));
    return DAL_OR(settled, moved);
}

/* ---- carry: the data of a completed balance for the next stage; none of it if finish did it */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(carry)(dal_kernel_of *k, const dal_arrays_of *work,
                                              const dal_balance_of *balance, dal_flag made,
                                              bool all)
{
    DAL_KERNEL_SIZES;
    (void)made, (void)all;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        dal_real *const p = &k->momentum[i], *const residue = &work->residue[n + i];
        const dal_real next = balance->L_v[i] + balance->residual[i];
        *residue = DAL_TAKE(all, made, balance->theta[i] * (*p - next + work->dx[n + i]), *residue);
        *p = DAL_TAKE(all, made, balance->L_v[i] + balance->theta[i] * balance->residual[i], *p);
        k->force0[i] = DAL_TAKE(all, made, -balance->F[i], k->force0[i]);
    }
}

/* ---- conclude: as commit of stage.h */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(conclude)(dal_kernel_of *k, const dal_traits_of *traits,
                                                 const dal_arrays_of *work, dal_flag done, bool all)
{
    DAL_KERNEL_SIZES;
    dal_real *const x = work->x, *const past = k->history + 4 * n * traits->stage->kind;
    (void)done, (void)all;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        past[3 * n + i] = DAL_TAKE(all, done, past[2 * n + i], past[3 * n + i]);
        past[2 * n + i] = DAL_TAKE(all, done, past[n + i], past[2 * n + i]);
        past[n + i] = DAL_TAKE(all, done, past[i], past[n + i]);
        past[i] = DAL_TAKE(all, done, work->w[i] - x[n + i], past[i]);
        work->residue[i] =
            DAL_TAKE(all, done, x[i] - work->stored[i] + work->dx[i], work->residue[i]);
        x[i] = DAL_TAKE(all, done, work->stored[i], x[i]);
        x[n + i] = DAL_TAKE(all, done, work->w[i], x[n + i]);
    }
    DAL_KNOW_ONE_MORE(k, traits->stage->kind, done);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) {
        k->impulse[a] = DAL_TAKE(all, done, k->impulse[a] + work->kappa[a], k->impulse[a]);
        k->latest[a] = DAL_TAKE(all, done, work->kappa[a], k->latest[a]);
    }
    k->latest_span = DAL_TAKE(all, done, DAL_NUMBER(traits->stage->span), k->latest_span);
    DAL_KERNEL_PART(pass_on)(k, work, n, false, all, done, NULL);
}

/* The parts of a stage, in their order. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(make_balanced)(dal_kernel_of *k, const dal_traits_of *traits,
                                                     const dal_momentum_traits_of *mom,
                                                     const dal_arrays_of *work,
                                                     const dal_balance_of *balance)
{
    DAL_KERNEL_SIZES;
    dal_progress_of progress = {.open = DAL_GOING(k), .solved = DAL_FLAG(false),
                                .settled = DAL_FLAG(false)};
    int status = DAL_KERNEL_PART(begin)(k, traits, mom, work, balance, progress.open);
    if (status) return status;
    DAL_KERNEL_PART(extrapolate)(k, traits, work);
    DAL_KERNEL_PART(place)(k, traits->stage, n, traits->kept, false, work);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) work->kappa[a] = DAL_NUMBER(0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) balance->reaction[i] = DAL_NUMBER(0.0);
    status = DAL_KERNEL_PART(linearise)(k, traits, mom, work, balance, &progress.open);
    if (status == 0) status = DAL_KERNEL_PART(close)(k, traits, mom, work, balance, &progress);
    if (status < 0) return status;
    dal_flag rest = DAL_AND(progress.solved, DAL_NOT(progress.settled));
    const int passes = status == 0 && !traits->kept ? DAL_MOMENTUM_PASSES : 0;
    for (int pass = 0; pass < passes && DAL_KERNEL_RARE(DAL_ANY(rest)); pass++)
        progress.settled = DAL_OR(progress.settled,
                                  DAL_KERNEL_PART(mend)(k, traits, mom, work, balance, &rest));
    const dal_flag made = DAL_AND(DAL_AND(progress.solved, progress.settled),
                                  DAL_KERNEL_PART(is_finite)(n, work));
    dal_flag done = made;
    if (DAL_KERNEL_RARE(!DAL_EVERY(made))) {
        status = DAL_KERNEL_PART(hand_over)(k, traits, work, &progress.solved, &done);
        if (status) return status;
        DAL_KERNEL_UNROLL
        for (size_t i = n; i < 2 * n; i++) /* where finish did it, there is no p */
            work->residue[i] = DAL_TAKE(false, DAL_AND(done, DAL_NOT(made)), DAL_NUMBER(0.0),
                                    work->residue[i]);
        if (DAL_ANY(made)) DAL_KERNEL_PART(carry)(k, work, balance, made, false);
    } else {
        DAL_KERNEL_PART(carry)(k, work, balance, made, true);
    }
    const dal_flag before = DAL_NOT(done);
    k->carried = DAL_OR(made, DAL_AND(before, k->carried));
    k->forced = DAL_OR(mom->late_pushed ? made : DAL_FLAG(false), DAL_AND(before, k->forced));
    if (DAL_EVERY(done)) DAL_KERNEL_PART(conclude)(k, traits, work, done, true);
    else DAL_KERNEL_PART(conclude)(k, traits, work, done, false);
    k->formed = DAL_KERNEL_MASS && mom->known;
    return DAL_SUCCESS;
}

/* A stage of step number, counted from 0.  The argument explicit, a constant after inlining, may be
 * true if B = 0: mu(q~') is then that of the node. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(momentum)(dal_kernel_of *const k, const dal_real number,
                                                const dal_stage *const s, const bool explicit,
                                                dal_real *const x, dal_real *const residue)
{
    DAL_KERNEL_SIZES;
    (void)x, (void)residue;
#ifdef DAL_N
    dal_real node[DAL_N], point[DAL_N], w[DAL_N], v_free[DAL_N], step[DAL_N], stored[DAL_N];
    dal_real mu_node[DAL_KERNEL_M * DAL_N], mu[DAL_KERNEL_M * DAL_N], N[DAL_KERNEL_M * DAL_N];
    dal_real Z[DAL_KERNEL_M * DAL_N], S[DAL_KERNEL_M * DAL_KERNEL_M], sizes[5 * DAL_KERNEL_M];
    dal_real r[DAL_KERNEL_M], d[DAL_KERNEL_M], kappa[DAL_KERNEL_M];
    DAL_EXCHANGES(row);
    DAL_TALLY(tally);
    dal_real from[DAL_N], dq_known[DAL_N], dv_known[DAL_N], dx[2 * DAL_N];
    dal_real known[DAL_N], reaction[DAL_N], residual[DAL_N], theta[DAL_N];
    dal_real phi[DAL_KERNEL_M], L_v[DAL_N], F[DAL_N], unit[DAL_N], per_unit[DAL_N];
    dal_real L_vq[DAL_N * DAL_N], L_vv[DAL_N * DAL_N], F_q[DAL_N * DAL_N], F_v[DAL_N * DAL_N];
    dal_real K[DAL_N * DAL_N], factors[DAL_N * DAL_N];
    const dal_arrays_of work = {x, NULL, residue, node, point, w, mu_node, mu, N, known, v_free,
                                step, NULL, stored, from, dq_known, dv_known, dx, Z, S, sizes, r, d,
                                kappa, row, NULL, NULL, NULL, 0, NULL, false, tally};
    const dal_balance_of balance = {known, reaction, residual, theta, phi, L_v, F, unit, per_unit,
                                    L_vq, L_vv, F_q, F_v, K, factors};
#else
    const dal_arrays_of work = k->at;
    const dal_balance_of balance = k->balance;
#endif
    const dal_constraint_kind kind = DAL_KERNEL_KIND(k);
    const bool linear = kind == DAL_LINEAR, kept = !DAL_KERNEL_INSIDE && k->kept;
    const dal_momentum_traits_of mom = {.b = s->B * k->h, .early = k->h * s->w0,
                                        .late = k->h * s->w2, .pushed = s->w0 != 0.0,
                                        .late_pushed = s->w2 != 0.0,
                                        .constant = DAL_KERNEL_INSIDE ? DAL_KERNEL_MASS
                                                                      : k->mass != NULL,
                                        .linear = linear, .nonlinear = kind == DAL_NONLINEAR,
                                        .still = explicit && !kept,
                                        .known = explicit && linear && !kept};
    const dal_pattern has = DAL_KERNEL_PATTERN;
    const dal_traits_of traits = {.stage = s, .number = number, .has = has, .kept = kept,
                                  .t_end = DAL_KERNEL_TIME(k, number, s->t_end)};
    return DAL_KERNEL_PART(make_balanced)(k, &traits, &mom, &work, &balance);
}
