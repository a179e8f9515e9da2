/* stage.h - a stage of kernel.h for constant mass and linear constraints, and the linear algebra of
 * all stages.  Only kernel.h includes it, once for each compilation.
 *
 * A number is a dal_real, a decision a dal_flag.  These are double and bool; or vectors with a
 * component for each lane, see lanes.h.  If one lane needs an operation, all execute it, and the
 * others discard the result.  A lane that has converged is frozen.  The argument all, a constant
 * after inlining, is true if no lane is frozen. */

/* Row a of A[..*n], whose pattern is mask, times x[n].  Sums begin with their first term, or with
 * -0.  The compiler can omit x + -0 = x, whereas 0 + x costs an addition on the critical path. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(dot)(size_t n, unsigned long long mask,
                                                const dal_real *A, size_t a, const dal_real *x)
{
    dal_real sum = DAL_KERNEL_HAS(mask, a * n) ? A[a * n] * x[0] : DAL_NUMBER(-0.0);
    for (size_t i = 1; i < n; i++)
        if (DAL_KERNEL_HAS(mask, a * n + i)) sum += A[a * n + i] * x[i];
    return sum;
}

/* Component i of Z^T c, for m > 0. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(column)(size_t n, size_t m, unsigned long long mask,
                                                   const dal_real *Z, size_t i, const dal_real *c)
{
    dal_real sum = DAL_KERNEL_HAS(mask, i) ? Z[i] * c[0] : DAL_NUMBER(-0.0);
    for (size_t a = 1; a < m; a++)
        if (DAL_KERNEL_HAS(mask, a * n + i)) sum += Z[a * n + i] * c[a];
    return sum;
}

/* y <- M^-1 f. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(accelerate)(const dal_kernel_of *k,
                                                   const dal_arrays_of *work, size_t n,
                                                   unsigned long long mask, const dal_real *f,
                                                   dal_real *y)
{
    const dal_real *const inverse = work->mass_inverse;
    if (mask == DAL_KERNEL_ALL && k->diagonal) {
        for (size_t i = 0; i < n; i++) y[i] = inverse[i * work->next] * f[i];
        return;
    }
    for (size_t i = 0; i < n; i++) y[i] = DAL_KERNEL_PART(dot)(n, mask, inverse, i, f);
}

/* |v| of residual.h, and the sum of the |v_i| / d_i. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(speed)(size_t n, const dal_real *per_unit,
                                                  const dal_real *v)
{
    dal_real most = DAL_NUMBER(0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const dal_real speed = DAL_ABS(v[i]) * per_unit[i];
        most = DAL_SELECT(speed > most, speed, most);
    }
    return most;
}

DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(extent)(size_t n, const dal_real *per_unit,
                                                   const dal_real *v)
{
    dal_real sum = DAL_NUMBER(-0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        sum += DAL_ABS(v[i]) * per_unit[i];
    return sum;
}

/* |mu^a| of residual.h for row a of mu[m*n]. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(row_norm)(const dal_arrays_of *work, size_t n,
                                                     unsigned long long mask, const dal_real *mu,
                                                     size_t a)
{
    if (work->rows) return DAL_ROWS_EXTENT(work->rows, mu, a, work->unit);
    dal_real sum = DAL_NUMBER(-0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(mask, a * n + i))
            sum += DAL_ABS(mu[a * n + i]) * work->unit[i];
    return sum;
}

/* Row a of mu[m*n], or of a similar matrix, times x[n]; component i of Z^T c. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(product)(const dal_arrays_of *work, size_t n,
                                                    unsigned long long mask, const dal_real *mu,
                                                    size_t a, const dal_real *x)
{
    return work->rows ? DAL_ROWS_DOT(work->rows, mu, a, x)
                      : DAL_KERNEL_PART(dot)(n, mask, mu, a, x);
}

DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(reaction)(const dal_arrays_of *work, size_t n, size_t m,
                                                     unsigned long long mask, size_t i,
                                                     const dal_real *c)
{
    return work->rows ? DAL_ROWS_COLUMN(work->rows, work->Z, i, c)
                      : DAL_KERNEL_PART(column)(n, m, mask, work->Z, i, c);
}

/* The largest number of terms in a sum of mu w, which is n in the bound of the residual. */
DAL_KERNEL_INLINE size_t DAL_KERNEL_PART(terms)(const dal_arrays_of *work, size_t n)
{
    return work->rows ? work->rows->terms : n;
}

/* Z <- M^-1 mu_node. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(direct)(const dal_kernel_of *k, const dal_arrays_of *work,
                                               size_t n, size_t m, unsigned long long mask)
{
    if (work->rows)
        for (size_t e = 0; e < dal_rows_entries(work->rows); e++)
            work->Z[e] = work->mass_inverse[work->rows->column[e]] * work->mu_node[e];
    else
        for (size_t a = 0; a < m; a++)
            DAL_KERNEL_PART(accelerate)(k, work, n, mask, work->mu_node + a * n, work->Z + a * n);
}

/* S <- (mu + b N) Z^T, factored; returns whether S is regular and det S > 0.  The sizes of its rows
 * are the norms of mu and b N in the metric, the sizes of its columns the norms of mu_node.  If
 * there is one entry, its size is the sum of its terms. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(factor_S)(const dal_arrays_of *work, size_t n, size_t m,
                                                     dal_pattern has, dal_real b)
{
    dal_real terms = DAL_NUMBER(-0.0);
    for (size_t a = 0; a < m; a++) {
        dal_real size = DAL_NUMBER(-0.0);
        for (size_t c = 0; c < m; c++) work->S[a * m + c] = DAL_NUMBER(-0.0);
        for (size_t i = 0; i < n; i++) {
            const bool has_N = DAL_KERNEL_HAS(has.N, a * n + i);
            if (!has_N && !DAL_KERNEL_HAS(has.mu, a * n + i)) continue;
            const dal_real mu = work->mu[a * n + i], row = has_N ? mu + b * work->N[a * n + i] : mu;
            const dal_real entry = has_N ? DAL_ABS(mu) + DAL_ABS(row) : DAL_ABS(mu);
            if (m > 1) size += entry * work->unit[i];
            for (size_t c = 0; c < m; c++) {
                if (!DAL_KERNEL_HAS(has.Z, c * n + i)) continue;
                const dal_real term = row * work->Z[c * n + i];
                work->S[a * m + c] += term;
                terms += has_N ? entry * DAL_ABS(work->Z[c * n + i]) : DAL_ABS(term);
            }
        }
        work->sizes[a] = m > 1 ? size : terms;
        work->sizes[m + a] = m > 1 ? DAL_KERNEL_PART(row_norm)(work, n, has.mu, work->mu_node, a)
                                   : DAL_NUMBER(1.0);
    }
    return DAL_FACTOR_LU(m, work->S, work->sizes, work->row);
}

/* d <- S^-1 r. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(solve_S)(const dal_kernel_of *k, const dal_arrays_of *work,
                                                size_t m)
{
    (void)m;
    if (work->rows) k->solve(k);
    else DAL_SOLVE_LU(m, work->S, work->row, work->r, work->d);
}

/* V_q at q, and at the velocity v for a force that depends on it, in these lanes. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(force)(dal_kernel_of *k, const dal_arrays_of *work,
                                             dal_flag which, dal_real t, const dal_real *q,
                                             const dal_real *v, dal_real *V_q)
{
    (void)which, (void)t, (void)q, (void)v, (void)V_q;
    return work->dragged ? DAL_DRAG(k, t, q, v, V_q)
                         : DAL_POTENTIAL(k, work, which, t, q, V_q);
}

/* v_known, push += the contribution of V at q_k, or at q~. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(kick)(dal_kernel_of *k, const dal_traits_of *traits,
                                            const dal_arrays_of *work, dal_real *force1,
                                            dal_flag going)
{
    const dal_stage *const s = traits->stage;
    DAL_KERNEL_SIZES;
    const dal_real *const x = work->x, h = k->h;
    const bool at_node = traits->plain || s->w1 != 0.0;
    dal_real *const force = !at_node ? k->force0
                          : traits->plain && DAL_KERNEL_INSIDE ? work->seen : force1;
    if (traits->plain && DAL_KERNEL_INSIDE)
        for (size_t i = 0; i < n; i++) force[i] = DAL_NUMBER(0.0); /* or some compilers warn */
    const dal_flag unknown = at_node ? going : DAL_AND(going, DAL_NOT(k->forced));
    if (DAL_ANY(unknown)) {
        const double shift = traits->kept ? k->shift : 0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) /* q_k; or q~, where q~' will be */
            work->point[i] = at_node ? work->node[i]
                           : traits->kept ? x[i] - shift * h * x[n + i] : x[i];
        const dal_real t = DAL_KERNEL_TIME(k, traits->number, at_node ? s->t_node : s->t_start);
        DAL_FRESH(fresh, DAL_N, force);
        const int returned = DAL_KERNEL_PART(force)(k, work, unknown, t, work->point, x + n, fresh);
        if (returned) return DAL_REFUSED(k, DAL_FAILED_POTENTIAL, returned);
        DAL_KERNEL_PART(take)(n, at_node, unknown, fresh, force);
    }
    const dal_real weight = h * (at_node ? s->w1 : s->w0);
    DAL_KERNEL_PART(accelerate)(k, work, n, traits->has.inverse, force, work->step);
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(traits->has.kick, i)) {
            work->dv_known[i] -= weight * work->step[i];
            work->v_known[i] -= weight * work->step[i];
        }
    return DAL_SUCCESS;
}

/* From node i to q~'_i with the velocity w_i, by way.  If constant_rate is true, the velocity
 * constant and both ways equal, they have the same number of ulps of q.  So the node is in the
 * middle to the bit.  Then a uniformly turning blade loses no energy to the rounding of a large
 * angle.  Each way has half of residue: its rounding error is in residue twice, and the next two
 * ways remove all of it. */
DAL_KERNEL_INLINE dal_real DAL_KERNEL_PART(leave)(const dal_stage *s, size_t n, bool constant_rate,
                                                  const dal_arrays_of *work, size_t i, dal_real w,
                                                  dal_real way)
{
    if (!constant_rate || s->A != s->B) return work->from[i] + way;
    return DAL_SELECT(DAL_AND(w == work->x[n + i], work->residue[n + i] == 0.0),
                      work->node[i] + (work->node[i] - work->x[i]), work->from[i] + way);
}

/* Computes the stored position from the node and the new velocity; point <- the q~' recovered from
 * it.  With kept nodes q_{k+1} = q_k + h v' is stored, and q~' is recovered as q_{k+1} - (1-beta) h
 * v'. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(place)(const dal_kernel_of *k, const dal_stage *s, size_t n,
                                              bool kept, bool constant_rate,
                                              const dal_arrays_of *work)
{
    const dal_real reach = (kept ? s->span : s->B) * k->h;
    for (size_t i = 0; i < n; i++) {
        const dal_real way = reach * work->w[i];
        work->dx[i] = work->dq_known[i] + way;
        work->stored[i] = DAL_KERNEL_PART(leave)(s, n, constant_rate, work, i, work->w[i], way);
        work->point[i] = kept ? work->stored[i] - k->shift * k->h * work->w[i] : work->stored[i];
    }
}

/* ---- predict: the known part of v', and the unknown one */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(predict)(dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_arrays_of *work, dal_real *force1,
                                               dal_flag going)
{
    const dal_stage *const s = traits->stage;
    DAL_KERNEL_SIZES;
    const dal_real *const x = work->x, *const dv_history = work->dv_history;
    const dal_real h = k->h, b = s->B * h;
    const dal_real before = (traits->kept ? 0.0 : s->A) * h; /* a kept node is the state */
    for (size_t i = 0; i < n; i++) {
        const dal_real way = before * x[n + i], near = x[i] + way;
        work->dq_known[i] = work->residue[i] + way;
        work->from[i] = near + work->residue[i];
        work->node[i] = s->linear && !traits->kept ? work->from[i] : near;
        if (traits->constant_rate) {
            const dal_flag even = work->residue[n + i] == 0.0; /* as where v is constant */
            work->from[i] = DAL_SELECT(even, x[i] + (0.5 * work->residue[i] + way), work->from[i]);
            work->node[i] = DAL_SELECT(even, work->from[i], work->node[i]);
        }
        work->dv_known[i] = work->residue[n + i];
        work->v_known[i] = x[n + i] + work->residue[n + i];
    }
    if (traits->potential && !traits->force_after_S) {
        const int status = DAL_KERNEL_PART(kick)(k, traits, work, force1, going);
        if (status) return status;
    }
    /* The latest part is added last; q~' does not wait for v', and predictions do not wait for
     * residue, because this is the critical path.  A steady coordinate is not predicted, but known
     * to the bit. */
    for (size_t i = 0; i < n; i++) {
        const bool predicted = !traits->steady && DAL_KERNEL_HAS(traits->has.dv, i);
        dal_real early = traits->steady || traits->potential ? work->v_known[i] : x[n + i];
        if (predicted)
            early += s->predict_3[1] * dv_history[n + i] + s->predict_3[2] * dv_history[2 * n + i];
        work->w[i] = early;
        work->point[i] = traits->steady || traits->constant_rate
                           ? DAL_KERNEL_PART(leave)(s, n, traits->constant_rate, work, i, early,
                                                    b * early)
                           : work->node[i] + b * early;
        if (predicted) {
            work->w[i] += s->predict_3[0] * dv_history[i];
            work->point[i] += b * s->predict_3[0] * dv_history[i];
        }
    }
    return DAL_SUCCESS;
}

/* mu at the node, unless it is that of the stage before. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(mu_at_node)(dal_kernel_of *k, const dal_traits_of *traits,
                                                  const dal_arrays_of *work, dal_flag going)
{
    DAL_KERNEL_SIZES;
    (void)going;
#ifdef DAL_KERNEL_MOMENTA
    if (k->formed && traits->stage->A == 0.0) {
        DAL_KERNEL_COPY(m * n, k->forms, work->mu_node);
        return 0;
    }
#endif
    const dal_real t = DAL_KERNEL_TIME(k, traits->number, traits->stage->t_node);
    return DAL_CONSTRAINT(k, work, going, t, work->node, work->x + n, work->mu_node, NULL);
}

/* ---- factor: S, with mu at the prediction, and then at the node: more has to wait for the first.
 * Returns > 0 if no lane remains open; the others are left to finish. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(factor)(dal_kernel_of *k, const dal_traits_of *traits,
                                              const dal_arrays_of *work, dal_real *force1,
                                              dal_flag *open)
{
    const dal_stage *const s = traits->stage;
    DAL_KERNEL_SIZES;
    int returned = 0;
    if (m > 0 && !s->linear)
        returned = DAL_CONSTRAINT(k, work, *open, traits->t_end, work->point, work->w, work->mu,
                                  traits->steady ? NULL : work->N);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, returned);
    if (m > 0) {
        const int status = DAL_KERNEL_PART(mu_at_node)(k, traits, work, *open);
        if (status) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, status);
        DAL_KERNEL_PART(direct)(k, work, n, m, traits->has.inverse);
    }
    const size_t entries = work->rows ? dal_rows_entries(work->rows) : m * n;
    if (s->linear) DAL_KERNEL_COPY(entries, work->mu_node, work->mu);
    if (s->linear || (traits->steady && traits->has.N)) {
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < entries; i++) work->N[i] = DAL_NUMBER(0.0);
    }
    if (traits->ends && returned == 0)
        returned = DAL_KERNEL_PART(force)(k, work, *open, traits->t_end, work->point, work->w,
                                          force1);
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_POTENTIAL, returned);
    if (returned > 0) return 1;
    if (m == 0) return DAL_SUCCESS;
    const dal_real b = s->B * k->h;
    const dal_flag regular = work->rows ? DAL_FLAG(k->factor(k, b) > 0)
                                        : DAL_KERNEL_PART(factor_S)(work, n, m, traits->has, b);
    *open = DAL_AND(*open, regular);
    return DAL_ANY(*open) ? DAL_KERNEL_PART(look)(k, traits, work, open) : 1;
}

/* ---- iterate: Newton on (v', kappa), Hessian dropped, S frozen */

/* r <- -mu w, with mu at the stored q~'. Returns those of these lanes in which the residual of
 * every constraint is within half of its bound.  In these stats.worst_residual is raised if the
 * residual exceeds it.  False if r is not finite. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(find_settled)(dal_kernel_of *k,
                                                         const dal_traits_of *traits,
                                                         const dal_arrays_of *work, dal_flag which)
{
    DAL_KERNEL_SIZES;
    const double limit = DAL_KERNEL_LIMIT(DAL_KERNEL_PART(terms)(work, n));
    dal_real largest = k->stats.worst_residual;
    const dal_real speed = DAL_KERNEL_PART(speed)(n, work->per_unit, work->w);
    const dal_real seen = DAL_SELECT(largest < limit, largest, DAL_NUMBER(limit)) * speed;
    dal_flag settled = which;
    bool raised = false;
    for (size_t a = 0; a < m; a++) {
        const dal_real sum =
            DAL_KERNEL_PART(product)(work, n, traits->has.mu, work->mu, a, work->w);
        const dal_real norm = DAL_KERNEL_PART(row_norm)(work, n, traits->has.mu, work->mu, a);
        work->r[a] = -sum;
        /* nor if both are infinite; norm * speed may overflow */
        const dal_flag rare = DAL_AND(which, DAL_NOT(norm * seen > DAL_ABS(sum)));
        if (DAL_KERNEL_RARE(DAL_ANY(rare))) {
            const dal_real s = norm * speed;
            settled = DAL_AND(settled, DAL_OR(DAL_NOT(rare), norm * (limit * speed) - DAL_ABS(sum)
                                                                 >= 0.0));
            largest = DAL_SELECT(DAL_AND(rare, DAL_ABS(sum) > largest * s), DAL_ABS(sum) / s,
                                 largest);
            raised = true;
        }
    }
    if (raised)
        k->stats.worst_residual = DAL_SELECT(settled, largest, k->stats.worst_residual);
    return settled;
}

/* Whether r may be roundoff: of w, the sum of goal and Z^T kappa, and of q~', through N.  No
 * correction would reduce it. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(is_roundoff)(const dal_kernel_of *k,
                                                        const dal_traits_of *traits,
                                                        const dal_arrays_of *work)
{
    DAL_KERNEL_SIZES;
    (void)k;
    const dal_real terms = DAL_KERNEL_PART(speed)(n, work->per_unit, work->w)
                         + DAL_KERNEL_PART(speed)(n, work->per_unit, work->v_free);
    dal_flag roundoff = DAL_FLAG(true);
    for (size_t a = 0; a < m; a++) {
        dal_real shifted = DAL_NUMBER(0.0);
        for (size_t i = 0; !work->rows && i < n; i++)
            if (DAL_KERNEL_HAS(traits->has.N, a * n + i))
                shifted += DAL_ABS(work->N[a * n + i])
                         * (DAL_ABS(work->point[i]) + DAL_ABS(work->stored[i]));
        if (work->rows)
            shifted = DAL_ROWS_EXTENT(work->rows, work->N, a, work->point)
                    + DAL_ROWS_EXTENT(work->rows, work->N, a, work->stored);
        const dal_real norm = DAL_KERNEL_PART(row_norm)(work, n, traits->has.mu, work->mu, a);
        const dal_real bound = 2.0 * (double)DAL_KERNEL_PART(terms)(work, n) * norm * terms;
        roundoff = DAL_AND(roundoff,
                           2.0 * DAL_KERNEL_U * (bound + shifted) - DAL_ABS(work->r[a]) >= 0.0);
    }
    return roundoff;
}

/* One correction of w and kappa, from V_q(point) in force1 if ends, and mu and N at the q~' of
 * seen[n].  If first, kappa was 0.  The equations are v' = goal + Z^T kappa and mu v' + b N (v' -
 * seen) = 0.  The term b N (v' - seen) is the change of mu v' with q~'. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(newton)(const dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_arrays_of *work, const dal_real *force1,
                                               dal_flag open, bool first, bool all)
{
    const dal_stage *const s = traits->stage;
    const dal_pattern has = traits->has;
    DAL_KERNEL_SIZES;
    (void)open, (void)all;
    const dal_real h = k->h, b = s->B * h, *const seen = traits->ends ? work->seen : work->w;
    if (traits->ends) DAL_KERNEL_PART(accelerate)(k, work, n, has.inverse, force1, work->v_free);
    for (size_t i = 0; i < n; i++) {
        const bool kicked = traits->ends && DAL_KERNEL_HAS(has.kick, i);
        const dal_real kick = kicked ? h * s->w2 * work->v_free[i] : DAL_NUMBER(0.0);
        work->dx[n + i] = work->dv_known[i] - kick;
        work->v_free[i] = work->v_known[i] - kick;
        work->step[i] = work->v_free[i];
        if (!first && m > 0 && DAL_KERNEL_HAS(has.dv, i))
            work->step[i] += DAL_KERNEL_PART(reaction)(work, n, m, has.Z, i, work->kappa);
    }
    for (size_t a = 0; a < m; a++) {
        dal_real sum = DAL_KERNEL_PART(product)(work, n, has.mu, work->mu, a, work->step);
        if (has.N) {
            dal_real turn = DAL_NUMBER(-0.0);
            if (work->rows)
                for (size_t e = work->rows->first[a]; e < work->rows->first[a + 1]; e++)
                    turn += work->N[e]
                          * (work->step[work->rows->column[e]] - seen[work->rows->column[e]]);
            for (size_t i = 0; !work->rows && i < n; i++)
                if (DAL_KERNEL_HAS(has.N, a * n + i) && DAL_KERNEL_HAS(has.dv, i))
                    turn += work->N[a * n + i] * (work->step[i] - seen[i]);
            sum += b * turn;
        }
        work->r[a] = -sum;
    }
    if (m > 0) DAL_KERNEL_PART(solve_S)(k, work, m);
    for (size_t a = 0; a < m; a++) /* 0 + d would be waited for */
        work->kappa[a] = first ? work->d[a] : DAL_TAKE(all, open, work->kappa[a] + work->d[a],
                                                       work->kappa[a]);
    for (size_t i = 0; i < n; i++) {
        if (!DAL_KERNEL_HAS(has.dv, i)) continue;
        const dal_real reaction =
            m > 0 ? DAL_KERNEL_PART(reaction)(work, n, m, has.Z, i, work->kappa)
                  : DAL_NUMBER(-0.0);
        const dal_real next = work->v_free[i] + reaction;
        work->dx[n + i] += reaction;
        work->step[i] = next - work->w[i];
        work->w[i] = next; /* a frozen lane keeps its value */
    }
}

/* Whether corrections shrink; balanced <- whether V_q need not be evaluated again.  Corrections
 * shrink by the same factor again, and the next stage may give V_q more weight. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(judge)(const dal_kernel_of *k,
                                                  const dal_traits_of *traits,
                                                  const dal_arrays_of *work,
                                                  dal_progress_of *progress, bool first,
                                                  dal_flag *balanced)
{
    const dal_stage *const s = traits->stage;
    DAL_KERNEL_SIZES;
    (void)k;
    const dal_real last = progress->last;
    dal_real size = DAL_NUMBER(-0.0);
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(traits->has.dv, i))
            size += DAL_ABS(work->step[i]) * work->per_unit[i];
    const dal_real noise =
        8.0 * DAL_KERNEL_U * DAL_KERNEL_PART(extent)(n, work->per_unit, work->v_free);
    const dal_flag small = size <= noise;
    *balanced = DAL_FLAG(true);
    if (traits->ends)
        *balanced = first ? small
                          : DAL_OR(small, DAL_AND(DAL_NOT(progress->anew),
                                                  DAL_KERNEL_SAFETY * (size * (size / last))
                                                          * s->reuse
                                                      <= noise * fabs(s->w2)));
    const dal_flag shrinks =
        first ? DAL_FLAG(true) : DAL_OR(progress->anew, DAL_OR(size <= 0.5 * last, small));
    if (traits->ends) {
        progress->anew = DAL_AND(progress->passed, *balanced);
        progress->passed =
            DAL_AND(DAL_NOT(*balanced),
                    (first ? 0.0 * size : size * (size / last)) <= DAL_KERNEL_PASSING * noise);
    } else {
        progress->anew = DAL_FLAG(false);
    }
    progress->last = size;
    return shrinks;
}

/* A correction of the open lanes, and the evaluations after it.  Returns DAL_KERNEL_AGAIN if some
 * remain open, and > 0 too if these are left to finish. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(correct)(dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_arrays_of *work, dal_real *force1,
                                               dal_progress_of *progress, bool first, bool all)
{
    DAL_KERNEL_SIZES;
    dal_flag balanced = DAL_FLAG(true);
    int returned = 0;
    DAL_COUNT_ITERATION(k, work, progress->open);
    DAL_KERNEL_PART(newton)(k, traits, work, force1, progress->open, first, all);
    DAL_KERNEL_PART(place)(k, traits->stage, n, traits->kept, traits->constant_rate, work);
    if (!traits->known || traits->ends) {
        /* first saves a division; if it is no constant, it costs more */
        const dal_flag shrinks = DAL_KERNEL_PART(judge)(k, traits, work, progress,
                                                        DAL_KERNEL_LANES && first, &balanced);
        DAL_LEAVE_UNLESS(progress->open, shrinks);
    }
    const dal_flag look = traits->ends ? DAL_AND(progress->open, DAL_NOT(progress->passed))
                                       : progress->open;
    if (!traits->known && DAL_ANY(look)) {
        const bool whole =
            all && !(traits->ends && DAL_ANY(DAL_AND(progress->open, DAL_NOT(look))));
        DAL_FRESH(mu, DAL_KERNEL_M * DAL_N, work->mu);
        returned = DAL_CONSTRAINT(k, work, look, traits->t_end, work->point, work->w, mu, NULL);
        if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_CONSTRAINT, returned);
        if (whole) {
            DAL_KERNEL_PART(take)(m * n, true, look, mu, work->mu);
            if (traits->ends) DAL_KERNEL_COPY(n, work->w, work->seen);
        } else {
            DAL_KERNEL_PART(take)(m * n, false, look, mu, work->mu);
            for (size_t i = 0; traits->ends && i < n; i++)
                work->seen[i] = DAL_SELECT(look, work->w[i], work->seen[i]);
        }
    }
    const dal_flag again = DAL_AND(progress->open, DAL_NOT(balanced));
    if (traits->ends && DAL_ANY(again) && returned == 0) {
        DAL_FRESH(force, DAL_N, force1);
        returned = DAL_KERNEL_PART(force)(k, work, again, traits->t_end, work->point, work->w,
                                          force);
        if (all && !DAL_ANY(DAL_AND(progress->open, balanced)))
            DAL_KERNEL_PART(take)(n, true, again, force, force1);
        else
            DAL_KERNEL_PART(take)(n, false, again, force, force1);
    }
    if (returned < 0) return DAL_REFUSED(k, DAL_FAILED_POTENTIAL, returned);
    if (returned > 0) return 1;
    const dal_flag last = DAL_AND(progress->open, balanced);
    if (!DAL_KERNEL_LANES && !DAL_ANY(last)) return DAL_KERNEL_AGAIN;
    const dal_flag settled = DAL_KERNEL_PART(find_settled)(k, traits, work, last);
    progress->settled = DAL_OR(progress->settled, settled);
    dal_flag done = traits->known ? last : settled;
    if (!traits->known && DAL_ANY(DAL_AND(last, DAL_NOT(settled))))
        done = DAL_OR(done, DAL_AND(last, DAL_KERNEL_PART(is_roundoff)(k, traits, work)));
    progress->solved = DAL_OR(progress->solved, done);
    progress->open = DAL_AND(progress->open, DAL_NOT(done));
    if (!DAL_ANY(progress->open)) return DAL_SUCCESS;
    if (traits->steady && DAL_ANY(last)) return DAL_FAIL(k, DAL_EINVAL, DAL_FAILED_STEADY);
    return DAL_KERNEL_AGAIN;
}

DAL_KERNEL_INLINE int DAL_KERNEL_PART(iterate)(dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_arrays_of *work, dal_real *force1,
                                               dal_progress_of *progress)
{
    DAL_KERNEL_SIZES;
    (void)m;
    int status = DAL_KERNEL_AGAIN;
    progress->passed = DAL_FLAG(false);
    progress->anew = DAL_FLAG(true);
    progress->last = DAL_NUMBER(HUGE_VAL);
    if (traits->ends) DAL_KERNEL_COPY(n, work->w, work->seen);
    for (int i = 1; i <= DAL_KERNEL_CORRECTIONS && status == DAL_KERNEL_AGAIN; i++) {
        if (!DAL_KERNEL_LANES)
            status = DAL_KERNEL_PART(correct)(k, traits, work, force1, progress, i == 1, true);
        else if (i == 1)
            status = DAL_KERNEL_PART(correct)(k, traits, work, force1, progress, true, true);
        else if (!DAL_ANY(progress->solved))
            status = DAL_KERNEL_PART(correct)(k, traits, work, force1, progress, false, true);
        else
            status = DAL_KERNEL_PART(correct)(k, traits, work, force1, progress, false, false);
    }
    return status;
}

/* ---- settle: whether the stored state is finite and has a small residual; a kept node would lead
 * to another q~' */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(settle)(dal_kernel_of *k, const dal_traits_of *traits,
                                                   const dal_arrays_of *work,
                                                   const dal_progress_of *progress)
{
    DAL_KERNEL_SIZES;
    dal_flag settled = progress->settled;
    const dal_flag rest = DAL_AND(progress->solved, DAL_NOT(settled));
    if (m > 0 && !traits->kept && DAL_KERNEL_RARE(DAL_ANY(rest))) {
        DAL_KERNEL_PART(solve_S)(k, work, m);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            const dal_real mended = DAL_TAKE(
                false, rest,
                work->w[i] + DAL_KERNEL_PART(reaction)(work, n, m, traits->has.Z, i, work->d),
                work->w[i]);
            work->dx[n + i] += mended - work->w[i];
            work->w[i] = mended;
        }
        settled = DAL_OR(settled, DAL_KERNEL_PART(find_settled)(k, traits, work, rest));
    }
    return DAL_AND(settled, DAL_KERNEL_PART(is_finite)(n, work));
}

/* ---- commit.  The next stage adds the rounding error of the sum of x and dx, so these errors do
 * not accumulate (compensated summation; E. Hairer, R. McLachlan and A. Razakarivony 2008).  Those
 * of dx, smaller by h, do accumulate. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(commit)(dal_kernel_of *k, const dal_traits_of *traits,
                                               const dal_arrays_of *work, dal_real *force1,
                                               dal_flag made, dal_flag solved, bool all)
{
    DAL_KERNEL_SIZES;
    dal_real *const x = work->x, *const dv_history = work->dv_history;
    dal_real *const residue = work->residue;
    (void)made, (void)all;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        if (!traits->steady && DAL_KERNEL_HAS(traits->has.dv, i)) {
            dv_history[2 * n + i] = DAL_TAKE(all, made, dv_history[n + i], dv_history[2 * n + i]);
            dv_history[n + i] = DAL_TAKE(all, made, dv_history[i], dv_history[n + i]);
            dv_history[i] = DAL_TAKE(all, made, work->w[i] - work->v_known[i], dv_history[i]);
        }
        residue[i] = DAL_TAKE(all, made, x[i] - work->stored[i] + work->dx[i], residue[i]);
        residue[n + i] =
            DAL_TAKE(all, made, x[n + i] - work->w[i] + work->dx[n + i], residue[n + i]);
        x[i] = DAL_TAKE(all, made, work->stored[i], x[i]);
        x[n + i] = DAL_TAKE(all, made, work->w[i], x[n + i]);
    }
    const dal_flag starts = DAL_AND(made, DAL_NOT(k->history_known));
    if (!traits->steady && DAL_KERNEL_RARE(DAL_ANY(starts))) { /* the best guess of the past */
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            dv_history[n + i] = DAL_SELECT(starts, dv_history[i], dv_history[n + i]);
            dv_history[2 * n + i] = DAL_SELECT(starts, dv_history[i], dv_history[2 * n + i]);
        }
        k->history_known = DAL_OR(k->history_known, starts);
    }
    for (size_t a = 0; a < m; a++)
        k->impulse[a] = DAL_TAKE(all, made, k->impulse[a] + work->kappa[a], k->impulse[a]);
    DAL_KERNEL_PART(pass_on)(k, work, n, traits->ends, all, made, force1);
    if (traits->potential && !traits->plain)
        k->forced = DAL_OR(DAL_AND(made, traits->ends ? solved : DAL_FLAG(false)),
                           DAL_AND(DAL_NOT(made), k->forced));
}

/* The parts of a stage, in their order. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(make)(dal_kernel_of *k, const dal_traits_of *traits,
                                            const dal_arrays_of *work, dal_real *force1)
{
    DAL_KERNEL_SIZES;
    dal_progress_of progress = {.open = DAL_GOING(k), .solved = DAL_FLAG(false),
                                .settled = DAL_FLAG(false)};
    int status = DAL_KERNEL_PART(predict)(k, traits, work, force1, progress.open);
    if (status) return status;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) work->kappa[a] = DAL_NUMBER(0.0);
    status = DAL_KERNEL_PART(factor)(k, traits, work, force1, &progress.open);
    if (status < 0) return status;
    if (traits->force_after_S) {
        const int kicked = DAL_KERNEL_PART(kick)(k, traits, work, force1, progress.open);
        if (kicked) return kicked;
        DAL_KERNEL_COPY(n, work->v_known, work->w);
    }
    dal_flag made = DAL_FLAG(false);
    if (status > 0) {
        DAL_KERNEL_COPY(n, work->node, work->stored);
        DAL_KERNEL_COPY(n, work->v_known, work->v_free);
    } else {
        status = DAL_KERNEL_PART(iterate)(k, traits, work, force1, &progress);
        if (status < 0) return status;
        made = DAL_KERNEL_PART(settle)(k, traits, work, &progress);
    }
    if (DAL_KERNEL_RARE(!DAL_EVERY(made))) {
        status = DAL_KERNEL_PART(hand_over)(k, traits, work, &progress.solved, &made);
        if (status) return status;
    }
    if (DAL_EVERY(made))
        DAL_KERNEL_PART(commit)(k, traits, work, force1, made, progress.solved, true);
    else
        DAL_KERNEL_PART(commit)(k, traits, work, force1, made, progress.solved, false);
    return DAL_SUCCESS;
}

/* A stage of step number, counted from 0, of the active lanes.  The argument plain, a constant
 * after inlining, means moved nodes, and V = 0 or at nodes only.  So code for other cases costs
 * nothing. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(stage)(dal_kernel_of *const k, const dal_real number,
                                             const dal_stage *const s, const bool plain,
                                             const dal_masses_of *const masses, dal_real *const x,
                                             dal_real *const dv_history)
{
    DAL_KERNEL_SIZES;
    (void)masses, (void)x, (void)dv_history;
    dal_pattern has = DAL_KERNEL_PATTERN;
#ifdef DAL_N
    DAL_KERNEL_SHARED(node, DAL_N, 2 * n);
    DAL_KERNEL_SHARED(point, DAL_N, 3 * n);
    DAL_KERNEL_SHARED(w, DAL_N, 4 * n);
    DAL_KERNEL_SHARED(mu_node, DAL_KERNEL_M * DAL_N, 10 * n);
    DAL_KERNEL_SHARED(mu, DAL_KERNEL_M * DAL_N, 10 * n + m * n);
    DAL_KERNEL_SHARED(N, DAL_KERNEL_M * DAL_N, 10 * n + 2 * m * n);
    /* not passed to other functions: on the stack, for the registers */
    dal_real v_known[DAL_N], v_free[DAL_N], step[DAL_N], seen[DAL_N], stored[DAL_N];
    dal_real from[DAL_N], dq_known[DAL_N], dv_known[DAL_N], dx[2 * DAL_N];
    dal_real Z[DAL_KERNEL_M * DAL_N], S[DAL_KERNEL_M * DAL_KERNEL_M], sizes[5 * DAL_KERNEL_M];
    dal_real r[DAL_KERNEL_M], d[DAL_KERNEL_M], kappa[DAL_KERNEL_M];
    DAL_EXCHANGES(row);
    DAL_TALLY(tally);
#if DAL_KERNEL_LANES
    dal_real mass_inverse[DAL_N * DAL_N], unit[DAL_N], per_unit[DAL_N];
    DAL_KERNEL_PART(take_masses)(k, mass_inverse, unit, per_unit);
#else
    const double *const mass_inverse = masses->mass_inverse;
    const double *const unit = masses->unit, *const per_unit = masses->per_unit;
#endif
    const dal_arrays_of work = {x, dv_history, dv_history + 3 * n, node, point, w, mu_node, mu, N,
                                v_known, v_free, step, seen, stored, from, dq_known, dv_known, dx,
                                Z, S, sizes, r, d, kappa, row, mass_inverse, unit, per_unit, n + 1,
                                NULL, false, tally};
#else
    const dal_arrays_of work = k->at;
#endif
    DAL_FRESH(force1, DAL_N, k->force1);
    const bool kept = !plain && !DAL_KERNEL_INSIDE && k->kept;
    const bool potential = DAL_KERNEL_HAS_FORCE || work.dragged;
    const bool inside = DAL_KERNEL_STEADY > 0 && plain;
    const int declared = DAL_KERNEL_STEADY == 0 ? 0 : k->steady;
    const bool proved = inside || declared >= DAL_STEADY_PROVED;
    if (inside) has.N = 0;
    const dal_traits_of traits = {.stage = s, .number = number, .has = has, .plain = plain,
                                  .kept = kept, .t_end = DAL_KERNEL_TIME(k, number, s->t_end),
                                  .potential = potential,
                                  .ends = potential && !plain && s->w2 != 0.0,
                                  .constant_rate = DAL_KERNEL_CONSTANT_RATE(k) && !kept,
                                  .steady = inside || declared,
                                  .known = m == 0 || proved || (s->linear && !kept),
                                  .force_after_S = plain && DAL_KERNEL_STEADY > 1};
    return DAL_KERNEL_PART(make)(k, &traits, &work, force1);
}
