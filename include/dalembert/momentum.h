/* momentum.h - a stage of kernel.h in momentum form: for M(q), for forces that depend on v, and for
 * constraints that are not linear.  kernel.h includes it; nobody else does.
 *
 * With p = L_v and F = L_q + f, and A, B and the weights those of struct dal_stage, the stage is
 *
 *     q_k = q~ + A h v,    q~' = q_k + B h v',    p' = L_v(q~', v'),
 *     p' - p = h [start F(q~, v) + end F(q~', v')] + mu_k^T kappa,    phi(q~', v') = 0,
 *
 * mu_k = phi_v at q_k and v, or (v + v')/2 where phi is not linear.  A pair (0, a), (1, b) is two
 * stages here, for what is between them enters F.
 *
 * How it is solved.  Newton with the matrix of the prediction, K = dR/dv' of the first equation:
 *     K = L_vv + B h L_vq - end h (F_v + B h F_q),    S = (phi_v + B h phi_q) K^-1 mu_k^T,
 * factored once.  What is predicted is v' - v, from the last four stages of the same beta.  After
 * a correction L_v, F and phi are evaluated at what would be stored.  The stage is done when the
 * balance of momenta there is a rounding of its terms and the residual of D at most half of its
 * bound; so a smooth step takes one evaluation with second derivatives and one without.  Nothing is
 * extrapolated: what is stored was looked at.
 *
 * p is carried from stage to stage and never evaluated again: p' is the sum of the momenta above,
 * so that no rounding of v' is handed on to the next stage.
 *
 * What does not contract, a K with a pivot that is not positive, a negative det S and what is not
 * finite go to dal_kernel.finish, as in kernel.h.  sizes are measured in the metric of the diagonal
 * of K; no scaling of coordinates or forms changes a decision. */

#ifndef DALEMBERT_MOMENTUM_H
#define DALEMBERT_MOMENTUM_H
/* The balance is a rounding of its terms: 8 u, squared.  Squares below TINY are not compared. */
#define DAL_MOMENTUM_NOISE (64.0 * DAL_KERNEL_U * DAL_KERNEL_U)
#define DAL_MOMENTUM_TINY 1e-250
/* What the rounding of q~' moves it by is at most u times its slopes and q~'; twice that, squared. */
#define DAL_MOMENTUM_GRID (4.0 * DAL_KERNEL_U * DAL_KERNEL_U)
/* Pivots of K that are a smaller part of its diagonal are left to the full Newton iteration. */
#define DAL_MOMENTUM_PIVOT 1e-12

/* What a stage here has beside the traits of every stage. */
typedef struct dal_spans {
    double b, early, late;  /* B h, h start, h end */
    bool linear, nonlinear; /* the constraints */
    bool known;             /* mu(q~') is mu_k */
} dal_spans;
#endif /* DALEMBERT_MOMENTUM_H */

/* ---- once for each inclusion of kernel.h ---------------------------------------------------- */

/* sum_i weight_i x_i^2 */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(square)(const dal_kernel *k, const double *weight,
                                                 const double *x)
{
    DAL_KERNEL_SIZES;
    (void)k;
    double sum = -0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) sum += weight[i] * (x[i] * x[i]);
    return sum;
}

/* The size of a row of forms[m*n], sqrt(sum_i light_i form_i^2). */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(form)(const dal_kernel *k, unsigned long long mask,
                                               const double *light, const double *forms, size_t a)
{
    DAL_KERNEL_SIZES;
    (void)k;
    double sum = -0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(mask, a * n + i))
            sum += light[i] * (forms[a * n + i] * forms[a * n + i]);
    return sqrt(sum);
}

/* y[n] <- K^-1 y. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(solve)(const dal_kernel *k, unsigned long long mask,
                                              const double *K, double *y)
{
    DAL_KERNEL_SIZES;
    (void)k;
    DAL_KERNEL_UNROLL
    for (size_t i = 1; i < n; i++) {
        DAL_KERNEL_UNROLL
        for (size_t j = 0; j < i; j++)
            if (DAL_KERNEL_HAS(mask, i * n + j)) y[i] -= K[i * n + j] * y[j];
    }
    DAL_KERNEL_UNROLL
    for (size_t back = 1; back <= n; back++) {
        const size_t i = n - back;
        DAL_KERNEL_UNROLL
        for (size_t j = i + 1; j < n; j++)
            if (DAL_KERNEL_HAS(mask, i * n + j)) y[i] -= K[i * n + j] * y[j];
        y[i] *= K[i * n + i];
    }
}

/* ---- begin: p and F at the start, and what is known of p' */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(begin)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    const double *const x = at->x;
    const bool pushed = of->early != 0.0;
    if (DAL_KERNEL_RARE(!k->carried || (pushed && !k->forced))) {
        DAL_KERNEL_COPY(2 * n, x, k->at.x);
        const int status = DAL_KERNEL_PART(push)(k, o->number, o->stage,
                                                 k->carried ? NULL : k->momentum, pushed);
        if (status) return status;
        k->carried = true;
    }
    const double before = o->kept ? 0.0 : o->stage->before * k->h;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) at->node[i] = x[i] + before * x[n + i];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        balance->known[i] = pushed ? k->momentum[i] - of->early * k->force0[i] : k->momentum[i];
    return DAL_SUCCESS;
}

/* w <- v and what the stages before say of v' - v. */
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

/* phi and mu at what would be stored, and N unless NULL; mu_k where it depends on v'. */
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
    for (size_t i = 0; i < n; i++) at->goal[i] = 0.5 * (at->x[n + i] + at->w[i]);
    return DAL_KERNEL_FORMS(k, dal_kernel_time(k, o->number, o->stage->t_node), at->node, at->goal,
                            NULL, at->mu_node, NULL);
}

/* r <- -phi at what would be stored. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(miss)(const dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const double *phi)
{
    DAL_KERNEL_SIZES;
    (void)k;
    for (size_t a = 0; a < m; a++)
        at->r[a] = of->linear ? -dal_kernel_dot(n, o->has.mu, at->mu, a, at->w) : -phi[a];
}

/* The same.  True if for every constraint |phi^a| is at most half of the bound times sum_i |mu^a_i
 * v_i| + |phi^a - mu^a v|, which is at most s^a of residual.h; then the statistics know it. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_in_D)(dal_kernel *k, const dal_traits *o,
                                                const dal_spans *of, const dal_arrays *at,
                                                const double *phi)
{
    DAL_KERNEL_SIZES;
    const double limit = DAL_KERNEL_LIMIT(n);
    double largest = k->stats.worst_residual;
    bool settled = true;
    for (size_t a = 0; a < m; a++) {
        double sum = -0.0, terms = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            if (!DAL_KERNEL_HAS(o->has.mu, a * n + i)) continue;
            const double term = at->mu[a * n + i] * at->w[i];
            sum += term;
            terms += fabs(term);
        }
        const double value = of->linear ? sum : phi[a];
        if (!of->linear) terms += fabs(value - sum);
        at->r[a] = -value;
        if (!(limit * terms - fabs(value) >= 0.0)) settled = false; /* nor if both are infinite */
        if (fabs(value) > largest * terms) largest = fabs(value) / terms;
    }
    if (settled) k->stats.worst_residual = largest;
    return settled;
}

/* K becomes its factors L, U without a change of rows, the diagonal of U inverted: it is nearly
 * symmetric and positive definite.  False if a pivot is too small for that, measured by the terms
 * of its diagonal, for which diagonal and light then have K_ii and 1/K_ii. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(factor_K)(const dal_kernel *k, unsigned long long mask,
                                                 const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    double *const K = balance->L_vv;
    bool regular = true;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) balance->light[i] = K[i * n + i];
    DAL_KERNEL_UNROLL
    for (size_t j = 0; j < n; j++) {
        const double pivot = K[j * n + j], inverse = 1.0 / pivot;
        if (!(pivot > DAL_MOMENTUM_PIVOT * balance->diagonal[j])) regular = false;
        balance->diagonal[j] = balance->light[j];
        balance->light[j] = 1.0 / balance->light[j];
        K[j * n + j] = inverse;
        DAL_KERNEL_UNROLL
        for (size_t i = j + 1; i < n; i++) {
            if (!DAL_KERNEL_HAS(mask, i * n + j)) continue;
            const double l = K[i * n + j] * inverse;
            K[i * n + j] = l;
            DAL_KERNEL_UNROLL
            for (size_t c = j + 1; c < n; c++)
                if (DAL_KERNEL_HAS(mask, j * n + c)) K[i * n + c] -= l * K[j * n + c];
        }
    }
    return regular;
}

/* S <- (mu + b N) Z^T, factored, as dal_kernel_factor. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(factor_S)(const dal_kernel *k, const dal_traits *o, double b,
                                                const dal_arrays *at, const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    double terms = -0.0;
    for (size_t a = 0; a < m; a++) {
        double size = -0.0;
        for (size_t c = 0; c < m; c++) at->S[a * m + c] = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            const bool turns = DAL_KERNEL_HAS(o->has.N, a * n + i);
            if (!turns && !DAL_KERNEL_HAS(o->has.mu, a * n + i)) continue;
            const double mu = at->mu[a * n + i], row = turns ? mu + b * at->N[a * n + i] : mu;
            const double entry = turns ? fabs(mu) + fabs(row) : fabs(mu);
            if (m > 1) size += balance->light[i] * (entry * entry);
            for (size_t c = 0; c < m; c++) {
                if (!DAL_KERNEL_HAS(o->has.Z, c * n + i)) continue;
                at->S[a * m + c] += row * at->Z[c * n + i];
                if (m == 1) terms += entry * fabs(at->Z[c * n + i]);
            }
        }
        at->sizes[a] = m > 1 ? sqrt(size) : terms;
        at->sizes[m + a] =
            m > 1 ? DAL_KERNEL_PART(form)(k, o->has.mu, balance->light, at->mu_node, a) : 1.0;
    }
    return dal_lu_factor(m, at->S, at->sizes, at->row);
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
    if (s->linear) {
        DAL_KERNEL_COPY(m * n, at->mu_node, at->mu);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < m * n; i++) at->N[i] = 0.0;
    }
    returned = DAL_KERNEL_PART(constrain)(k, o, of, at, balance->phi, s->linear ? NULL : at->N);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
    if (returned > 0) return 1;
    returned = DAL_KERNEL_BALANCE(k, o->t_end, at->point, at->w, balance->L_v, balance->F,
                                  balance->L_vq, balance->L_vv, balance->F_q, balance->F_v);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_BALANCE, returned);
    if (returned > 0) return 1;
    double *const K = balance->L_vv;
    const double b = of->b, late = of->late;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) balance->diagonal[i] = fabs(K[i * n + i]);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n * n; i++) {
        double more = -0.0;
        if (DAL_KERNEL_HAS(o->has.L_vq, i)) more += b * balance->L_vq[i];
        if (DAL_KERNEL_HAS(o->has.F_v, i)) more -= late * balance->F_v[i];
        if (DAL_KERNEL_HAS(o->has.F_q, i)) more -= late * b * balance->F_q[i];
        K[i] += more;
        if (i % (n + 1) == 0) balance->diagonal[i / n] += fabs(more);
    }
    const bool regular = DAL_KERNEL_PART(factor_K)(k, o->has.K, balance);
    for (size_t a = 0; a < m; a++) {
        DAL_KERNEL_COPY(n, at->mu_node + a * n, at->Z + a * n);
        DAL_KERNEL_PART(solve)(k, o->has.K, K, at->Z + a * n);
    }
    return !regular || (m > 0 && DAL_KERNEL_PART(factor_S)(k, o, b, at, balance) <= 0);
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

/* residual <- what is missing in the balance of momenta; returns its size, squared.  *base <- the
 * sum of those of the terms of v' and of p'. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(weigh)(const dal_kernel *k, const dal_spans *of,
                                                const dal_arrays *at, const dal_balance *balance,
                                                double *base)
{
    DAL_KERNEL_SIZES;
    *base = DAL_KERNEL_PART(square)(k, balance->diagonal, at->w)
          + DAL_KERNEL_PART(square)(k, balance->light, balance->known)
          + DAL_KERNEL_PART(square)(k, balance->light, balance->reaction);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        const double next = balance->known[i] + of->late * balance->F[i] + balance->reaction[i];
        balance->residual[i] = next - balance->L_v[i];
    }
    if (DAL_KERNEL_RARE(!(*base > DAL_MOMENTUM_TINY))) /* squares may be lost */
        return dal_kernel_sum(n, balance->residual) == 0.0 ? 0.0 : HUGE_VAL;
    return DAL_KERNEL_PART(square)(k, balance->light, balance->residual);
}

/* Whether r may be all roundoff: of v', by the base of its terms, and of q~', through N. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_rounding)(const dal_kernel *k, const dal_traits *o,
                                                    double base, const dal_arrays *at,
                                                    const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    const double size = 2.0 * (double)n * sqrt(base);
    bool roundoff = true;
    for (size_t a = 0; a < m; a++) {
        double moved = -0.0;
        for (size_t i = 0; i < n; i++)
            if (DAL_KERNEL_HAS(o->has.N, a * n + i))
                moved += fabs(at->N[a * n + i]) * (fabs(at->point[i]) + fabs(at->stored[i]));
        const double form = DAL_KERNEL_PART(form)(k, o->has.mu, balance->light, at->mu, a);
        if (!(2.0 * DAL_KERNEL_U * (form * size + moved) - fabs(at->r[a]) >= 0.0)) roundoff = false;
    }
    return roundoff;
}

/* Whether what is left of the balance, squared, is a rounding: of its terms, or of q~'. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_balanced)(const dal_kernel *k, const dal_traits *o,
                                                    double late, double left, double base,
                                                    const double *point,
                                                    const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    (void)k;
    double sum = -0.0;
    if (DAL_MOMENTUM_NOISE * base - left >= 0.0) return true; /* not if both are infinite */
    for (size_t i = 0; i < n; i++) {
        double moved = -0.0;
        for (size_t j = 0; j < n; j++) {
            if (DAL_KERNEL_HAS(o->has.L_vq, i * n + j))
                moved += fabs(balance->L_vq[i * n + j] * point[j]);
            if (DAL_KERNEL_HAS(o->has.F_q, i * n + j))
                moved += fabs(late * balance->F_q[i * n + j] * point[j]);
        }
        sum += balance->light[i] * (moved * moved);
    }
    return DAL_MOMENTUM_NOISE * base + DAL_MOMENTUM_GRID * sum - left >= 0.0;
}

/* step, d <- a correction of w and kappa; returns what it is, squared, in the metric of K. */
DAL_KERNEL_INLINE double DAL_KERNEL_PART(correct)(dal_kernel *k, const dal_traits *o,
                                                  const dal_spans *of, const dal_arrays *at,
                                                  const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    double *const y = at->step;
    DAL_KERNEL_COPY(n, balance->residual, y);
    DAL_KERNEL_PART(solve)(k, o->has.K, balance->L_vv, y);
    for (size_t a = 0; a < m; a++) {
        double turn = -0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++)
            if (DAL_KERNEL_HAS(o->has.N, a * n + i)) turn += at->N[a * n + i] * y[i];
        at->r[a] -= dal_kernel_dot(n, o->has.mu, at->mu, a, y) + of->b * turn;
    }
    dal_lu_solve(m, at->S, at->row, at->r, at->d);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (m > 0) y[i] += dal_kernel_column(n, m, o->has.Z, at->Z, i, at->d);
    k->stats.iterations++;
    return DAL_KERNEL_PART(square)(k, balance->diagonal, y);
}

/* ---- close: the balance, by Newton with K and S frozen; *settled: D too */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(close)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance, bool *settled)
{
    DAL_KERNEL_SIZES;
    double last = HUGE_VAL, base;
    DAL_KERNEL_PART(weigh)(k, of, at, balance, &base);
    DAL_KERNEL_PART(miss)(k, o, of, at, balance->phi);
    for (int correction = 1; correction <= DAL_KERNEL_CORRECTIONS; correction++) {
        const double size = DAL_KERNEL_PART(correct)(k, o, of, at, balance);
        if (!(size <= 0.25 * last)) return 1;
        last = size;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) at->w[i] += at->step[i];
        for (size_t a = 0; a < m; a++) at->kappa[a] += at->d[a];
        dal_kernel_place(k, o->stage, n, o->kept, at);
        int returned = DAL_KERNEL_PART(constrain)(k, o, of, at, balance->phi, NULL);
        if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        if (returned > 0) return 1;
        returned = DAL_KERNEL_VALUES(k, o->t_end, at->point, at->w, balance->L_v, balance->F,
                                     of->late != 0.0);
        if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_BALANCE, returned);
        if (returned > 0) return 1;
        DAL_KERNEL_PART(react)(k, o, at, balance);
        const double left = DAL_KERNEL_PART(weigh)(k, of, at, balance, &base);
        *settled = DAL_KERNEL_PART(is_in_D)(k, o, of, at, balance->phi);
        if (!DAL_KERNEL_PART(is_balanced)(k, o, of->late, left, base, at->point, balance)) continue;
        if (*settled || DAL_KERNEL_PART(is_rounding)(k, o, base, at, balance)) return 0;
    }
    return 1;
}

/* ---- mend: as settle of kernel.h, with the reaction that goes with the velocity */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(mend)(dal_kernel *k, const dal_traits *o,
                                             const dal_spans *of, const dal_arrays *at,
                                             const dal_balance *balance)
{
    DAL_KERNEL_SIZES;
    dal_lu_solve(m, at->S, at->row, at->r, at->d);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++)
        if (m > 0) at->w[i] += dal_kernel_column(n, m, o->has.Z, at->Z, i, at->d);
    for (size_t a = 0; a < m; a++) at->kappa[a] += at->d[a];
    if (!of->linear && DAL_KERNEL_FORMS(k, o->t_end, at->point, at->w, balance->phi, at->mu, NULL))
        return false;
    DAL_KERNEL_PART(react)(k, o, at, balance);
    return DAL_KERNEL_PART(is_in_D)(k, o, of, at, balance->phi);
}

/* ---- carry: commit; solved: here, and not by finish */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(carry)(dal_kernel *k, const dal_traits *o,
                                              const dal_spans *of, const dal_arrays *at,
                                              const dal_balance *balance, bool solved)
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
        x[i] = at->stored[i];
        x[n + i] = at->w[i];
    }
    *count = (unsigned char)(*count + (*count < 4));
    for (size_t a = 0; a < m; a++) k->impulse[a] += at->kappa[a];
    k->carried = solved;
    k->forced = solved && of->late != 0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        k->momentum[i] = balance->known[i] + of->late * balance->F[i] + balance->reaction[i];
        k->force0[i] = -balance->F[i];
    }
}

/* A stage of step number, counted from 0. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(momentum)(dal_kernel *const k, const double number,
                                                const dal_stage *const s, double *const x)
{
    DAL_KERNEL_SIZES;
#ifdef DAL_N
    double node[DAL_N], point[DAL_N], w[DAL_N], goal[DAL_N], step[DAL_N], stored[DAL_N];
    double mu_node[DAL_KERNEL_M * DAL_N], mu[DAL_KERNEL_M * DAL_N], N[DAL_KERNEL_M * DAL_N];
    double Z[DAL_KERNEL_M * DAL_N], S[DAL_KERNEL_M * DAL_KERNEL_M], sizes[5 * DAL_KERNEL_M];
    double r[DAL_KERNEL_M], d[DAL_KERNEL_M], kappa[DAL_KERNEL_M];
    size_t row[DAL_KERNEL_M];
    double known[DAL_N], reaction[DAL_N], residual[DAL_N], diagonal[DAL_N], light[DAL_N];
    double phi[DAL_KERNEL_M], L_v[DAL_N], F[DAL_N];
    double L_vq[DAL_N * DAL_N], L_vv[DAL_N * DAL_N], F_q[DAL_N * DAL_N], F_v[DAL_N * DAL_N];
    const dal_arrays at = {x, NULL, node, point, w, mu_node, mu, N, known, goal, step, NULL,
                           stored, Z, S, sizes, r, d, kappa, row};
    const dal_balance balance = {known, reaction, residual, diagonal, light, phi, L_v, F,
                                 L_vq, L_vv, F_q, F_v};
#else
    const dal_arrays at = k->at;
    const dal_balance balance = k->balance;
#endif
    const dal_constraint_kind kind = DAL_KERNEL_KIND(k);
    const bool linear = kind == DAL_LINEAR, kept = !DAL_KERNEL_INSIDE && k->kept;
    const dal_spans of = {.b = s->after * k->h, .early = k->h * s->start, .late = k->h * s->end,
                          .linear = linear, .nonlinear = kind == DAL_NONLINEAR,
                          .known = s->linear && linear && !kept};
    const dal_pattern has = DAL_KERNEL_PATTERN;
    const dal_traits o = {.stage = s, .number = number, .has = has, .kept = kept,
                          .t_end = dal_kernel_time(k, number, s->t_end)};

    bool settled = false;
    int status = DAL_KERNEL_PART(begin)(k, &o, &of, &at, &balance);
    if (status) return status;
    DAL_KERNEL_PART(extrapolate)(k, &o, &at);
    dal_kernel_place(k, s, n, kept, &at);
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) at.kappa[a] = 0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) balance.reaction[i] = 0.0;
    status = DAL_KERNEL_PART(linearise)(k, &o, &of, &at, &balance);
    if (status == 0) status = DAL_KERNEL_PART(close)(k, &o, &of, &at, &balance, &settled);
    if (status < 0) return status;
    bool solved = status == 0;
    if (DAL_KERNEL_RARE(solved && !settled && !kept))
        settled = DAL_KERNEL_PART(mend)(k, &o, &of, &at, &balance);
    const bool done = solved && settled && DAL_KERNEL_PART(is_finite)(n, &at);
    if (DAL_KERNEL_RARE(!done)) {
        status = DAL_KERNEL_PART(hand_over)(k, &o, &at, &solved);
        if (status) return status;
    }
    DAL_KERNEL_PART(carry)(k, &o, &of, &at, &balance, done);
    return DAL_SUCCESS;
}
