/* The equations of one beta-step and their Jacobian, for every system; and what is stored
 * once they are solved. */
#include "discrete/discrete.h"
#include "dalembert/residual.h"

#include <math.h>

void dal__add_reaction(size_t n, size_t m, double factor, const double *mu, const double *kappa,
                       double *f)
{
    for (size_t a = 0; a < m; a++)
        for (size_t i = 0; i < n; i++) f[i] += factor * mu[a * n + i] * kappa[a];
}

/* Where L acts, a step before q_k + alpha h w, or there. */
static const double *place_of_L(dal_mechanics *mech, double reach, const double *velocity)
{
    if (mech->start.alpha == mech->start.beta) return mech->forms.q;
    dal__move(mech->n, mech->node, reach, velocity, mech->place);
    return mech->place;
}

int dal__require_beta(dal_mechanics *mech, double beta)
{
    if (beta >= 0.0 && beta <= 1.0) return DAL_SUCCESS;
    return dal__fail(&mech->error, DAL_EINVAL, "beta = %g: expected a number in [0, 1]", beta);
}

int dal__reaction_forms(dal_mechanics *mech, const double *v, double *muk)
{
    return dal__constraint(&mech->eval, mech->start.middle, mech->node, v, NULL, muk, NULL, NULL,
                           &mech->error);
}

int dal__step_begin(dal_mechanics *mech, double t, double end, double alpha, double beta, double h,
                    bool kept, const double *x)
{
    const size_t n = mech->n;
    const double *const v = x + n, before = (1.0 - beta) * h;
    int status = DAL_SUCCESS;
    const double later = (alpha - beta) * h; /* than at q~ and q~' L acts */
    mech->start = (dal__start){.middle = t + before, .end = end, .acts = t + h + later,
                               .alpha = alpha, .beta = beta, .h = h, .kept = kept, .v = v};
    dal__move(n, x, kept ? 0.0 : before, v, mech->node);
    dal__move(n, x, kept ? -before : 0.0, v, mech->forms.q);
    if (mech->eval.system->def.kind != DAL_NONLINEAR)
        status = dal__reaction_forms(mech, v, mech->muk);
    dal__clear(n, mech->reach);
    const double *const place = place_of_L(mech, (alpha - 1.0) * h, v);
    const dal__jet wanted = {.L_q = alpha != 0.0 ? mech->reach : NULL,
                             .L_v = mech->eval.constant_mass ? NULL : mech->momentum};
    if (!status) status = dal__lagrangian(&mech->eval, t + later, place, v, &wanted, &mech->error);
    /* a step depends on its start alone, and not on where its stepper was before */
    if (!status) status = dal__renew_metric(mech, t, mech->forms.q, v);
    if (!status && alpha != 0.0 && mech->eval.system->def.force) {
        status = dal__force(&mech->eval, t + later, place, v, mech->step, NULL, NULL,
                            &mech->error);
        dal__add(n, 1.0, mech->step, mech->reach);
    }
    for (size_t i = 0; i < n; i++) mech->reach[i] *= alpha * h;
    return status;
}

int dal__chetaev_forms(dal_mechanics *mech, const double *w, double *muk)
{
    for (size_t i = 0; i < mech->n; i++) mech->step[i] = 0.5 * (mech->start.v[i] + w[i]);
    return dal__reaction_forms(mech, mech->step, muk);
}

/* bend <- d(mu_k^T kappa)/dw, by central differences, which serve Newton's speed only. */
static int evaluate_bend(dal_mechanics *mech, const double *w, const double *kappa)
{
    const size_t n = mech->n, m = mech->m;
    double largest = dal__largest(n, w);
    if (largest == 0.0) largest = 1.0;
    const double d = cbrt(DBL_EPSILON) * largest;
    dal__clear(n * n, mech->bend);
    for (size_t j = 0; j < n; j++)
        for (int side = -1; side <= 1; side += 2) {
            dal__copy(n, w, mech->trial);
            mech->trial[j] += side * d;
            const int status = dal__chetaev_forms(mech, mech->trial, mech->chetaev);
            if (status) return status;
            for (size_t a = 0; a < m; a++)
                for (size_t i = 0; i < n; i++)
                    mech->bend[i * n + j] += side * mech->chetaev[a * n + i] * kappa[a] / (2.0 * d);
        }
    return DAL_SUCCESS;
}

/* What R1 and K need of the Lagrangian and the force where L acts, each called once: w <- L_v(., w)
 * - L_v(., v), which is M (w - v) for constant mass; force <- F(., w); second derivatives. */
static int evaluate(dal_mechanics *mech, const double *w, bool R1, bool K)
{
    const size_t n = mech->n;
    const double alpha = mech->start.alpha, t = mech->start.acts;
    const double *const place = place_of_L(mech, alpha * mech->start.h, w);
    const bool general = !mech->eval.constant_mass, ends = alpha != 1.0; /* F acts there */
    const dal__jet wanted = {.L_q = R1 && ends ? mech->force : NULL,
                             .L_v = R1 && general ? mech->w : NULL,
                             .L_qq = K && ends && alpha != 0.0 ? mech->hessian : NULL,
                             .L_vq = K && general ? mech->L_vq : NULL,
                             .L_vv = K && general ? mech->L_vv : NULL};
    int status = dal__lagrangian(&mech->eval, t, place, w, &wanted, &mech->error);
    if (!status && ends && mech->eval.system->def.force) {
        status = dal__force(&mech->eval, t, place, w, R1 ? mech->step : NULL,
                            K ? mech->f_q : NULL, K ? mech->f_v : NULL, &mech->error);
        if (R1) dal__add(n, 1.0, mech->step, mech->force);
    }
    if (status || !R1) return status;
    if (general) {
        dal__add(n, -1.0, mech->momentum, mech->w);
    } else {
        dal__move(n, w, -1.0, mech->start.v, mech->step);
        dal__weigh(mech, mech->step, mech->w);
    }
    return DAL_SUCCESS;
}

static void build_R1(const dal_mechanics *mech, const double *kappa, double *R1)
{
    const size_t n = mech->n;
    const double weight = mech->start.h * (1.0 - mech->start.alpha);
    dal__move(n, mech->w, -1.0, mech->reach, R1);
    if (weight != 0.0) dal__add(n, -weight, mech->force, R1);
    for (size_t a = 0; a < mech->m; a++) dal__row_add(mech, -kappa[a], mech->muk, a, R1);
}

double dal__base_of_w(const dal_mechanics *mech, const double *v, size_t count,
                      const dal__term *terms, const double *mu, const double *kappa)
{
    const size_t n = mech->n;
    double base = dal_residual_extent(n, mech->metric.per_unit, v);
    /* momenta, in the units of the velocity as M^-1 brings them there */
    for (const dal__term *term = terms; term < terms + count; term++)
        if (term->weight != 0.0)
            base += term->weight * dal_residual_extent(n, mech->metric.unit, term->x);
    for (size_t a = 0; a < mech->m; a++)
        base += fabs(kappa[a]) * dal__row_extent(mech, mu, a, mech->metric.unit);
    return base;
}

/* L_v(q, v) and L_v(q1, w), where they are not M v and M w, are about the same. */
static double base_of_R1(const dal_mechanics *mech, const double *kappa)
{
    const dal__term terms[] = {
        {1.0, mech->w}, {1.0, mech->reach}, {mech->eval.constant_mass ? 0.0 : 1.0, mech->momentum},
        {fabs(mech->start.h * (1.0 - mech->start.alpha)), mech->force}};
    return dal__base_of_w(mech, mech->start.v, DAL_LENGTH(terms), terms, mech->muk, kappa);
}

/* K[n*n] += factor A, and sizes[n], unless NULL, the absolute values on the diagonal. */
static void add_term(size_t n, double factor, const double *A, double *K, double *sizes)
{
    dal__add(n * n, factor, A, K);
    for (size_t i = 0; sizes && i < n; i++) sizes[i] += fabs(factor * A[i * n + i]);
}

/* K[n*n] += M, the same. */
static void add_mass(const dal_mechanics *mech, double *K, double *sizes)
{
    if (!mech->metric.masses) add_term(mech->n, 1.0, mech->metric.M, K, sizes);
    for (size_t i = 0; mech->metric.masses && i < mech->n; i++) {
        K[i * (mech->n + 1)] += mech->metric.M[i];
        if (sizes) sizes[i] += mech->metric.M[i];
    }
}

/* K = L_vv + alpha h L_vq - h (1-alpha) [L_vq^T + f_v + alpha h (L_qq + f_q)] - bend; never asked
 * for if mech is sparse. */
static void build_K(const dal_mechanics *mech, double *K, double *K_sizes)
{
    const size_t n = mech->n;
    const double a = mech->start.alpha * mech->start.h;
    const double b = (1.0 - mech->start.alpha) * mech->start.h;
    const bool general = !mech->eval.constant_mass;
    dal__clear(n * n, K);
    dal__clear(n, K_sizes);
    if (!general) {
        add_mass(mech, K, K_sizes);
    } else {
        add_term(n, 1.0, mech->L_vv, K, K_sizes);
        add_term(n, a, mech->L_vq, K, K_sizes);
        for (size_t i = 0; i < n; i++) {
            for (size_t j = 0; j < n; j++) K[i * n + j] -= b * mech->L_vq[j * n + i];
            if (K_sizes) K_sizes[i] += fabs(b * mech->L_vq[i * n + i]);
        }
    }
    if (a * b != 0.0) add_term(n, -b * a, mech->hessian, K, K_sizes);
    if (mech->eval.system->def.force && b != 0.0) {
        add_term(n, -b, mech->f_v, K, K_sizes);
        add_term(n, -b * a, mech->f_q, K, K_sizes);
    }
    if (mech->eval.system->def.kind == DAL_NONLINEAR) add_term(n, -1.0, mech->bend, K, K_sizes);
    for (size_t i = 0; K_sizes && i < n; i++) K_sizes[i] = K_sizes[n + i] = sqrt(K_sizes[i]);
}

/* Of phi, and of R1, when q1 and the place of L move by themselves. */
double dal__step_moves(const dal_mechanics *mech)
{
    const size_t n = mech->n;
    const double alpha = mech->start.alpha, b = (1.0 - alpha) * mech->start.h;
    const double *const place = alpha == mech->start.beta ? mech->forms.q : mech->place;
    const bool linear = mech->eval.system->def.kind == DAL_LINEAR;
    double sum = dal__forms_move(mech, mech->forms.mu, mech->forms.dmu, mech->forms.q,
                                 linear ? NULL : mech->forms.phi_t, mech->start.end);
    for (size_t k = 0; alpha != 0.0 && !mech->eval.sparse && k < n * n; k++) {
        double slope = mech->eval.constant_mass ? 0.0 : fabs(mech->L_vq[k]);
        if (b != 0.0) slope += fabs(b * mech->hessian[k]);
        if (b != 0.0 && mech->eval.system->def.force) slope += fabs(b * mech->f_q[k]);
        sum += slope * fabs(place[k % n]) * mech->metric.unit[k / n];
    }
    return sum;
}

int dal__step_at(dal_mechanics *mech, const double *w, const double *kappa, double *R1, double *R2,
                 double *K, double *K_sizes, double *B)
{
    const size_t n = mech->n, entries = dal__entries(&mech->eval);
    const double a = mech->start.beta * mech->start.h;
    const bool nonlinear = mech->eval.system->def.kind == DAL_NONLINEAR;
    int status = DAL_SUCCESS;
    dal__move(n, mech->node, a, w, mech->forms.q);
    const bool slopes = B && mech->eval.system->def.kind != DAL_LINEAR;
    if (R2 || B)
        status = dal__constraint(&mech->eval, mech->start.end, mech->forms.q, w, mech->forms.phi,
                                 mech->forms.mu, B ? mech->forms.dmu : NULL,
                                 slopes ? mech->forms.phi_t : NULL, &mech->error);
    if (!status && nonlinear) status = dal__chetaev_forms(mech, w, mech->muk);
    if (!status && K && nonlinear) status = evaluate_bend(mech, w, kappa);
    if (!status && (R1 || K)) status = evaluate(mech, w, R1 != NULL, K != NULL);
    if (status) return status;
    /* nothing is written before all of it is known */
    if (R1) build_R1(mech, kappa, R1);
    if (R1 && (K || mech->eval.sparse)) mech->start.base = base_of_R1(mech, kappa);
    if (R2) dal__copy(mech->m, mech->forms.phi, R2);
    if (K) build_K(mech, K, K_sizes);
    if (B) dal__move(entries, mech->forms.mu, a, mech->forms.dmu, B);
    return DAL_SUCCESS;
}

int dal__step_settle(dal_mechanics *mech, const double *w, double *x, double *worst)
{
    const size_t n = mech->n;
    const double h = mech->start.h, beta = mech->start.beta;
    const double after = mech->start.kept ? h : beta * h;
    const double shift = mech->start.kept ? (1.0 - beta) * h : 0.0;
    double relative = 0.0;
    int status = DAL_SUCCESS;
    dal__move(n, mech->node, after, w, x);
    dal__copy(n, w, x + n);
    if (mech->m > 0 && dal__all_finite(2 * n, x))
        status = dal__mend(mech, mech->start.end, shift, false, x, &relative);
    if (status) return status;
    if (!dal__all_finite(2 * n, x))
        return dal__fail(&mech->error, DAL_EDOMAIN, "the new state overflows with h = %g; try a "
                         "smaller h", h);
    *worst = fmax(*worst, relative);
    return DAL_SUCCESS;
}

/* The same for a mechanics that is sparse, by one that is not. */
static int with_all_entries(dal_mechanics *sparse, double t, double beta, double h, const double *x,
                            const double *w, const double *kappa, double *R1, double *R2, double *K,
                            double *B, double *muk)
{
    dal_mechanics *whole;
    const dal_system *const system = sparse->eval.system;
    int status = dal__mechanics_new(&whole, system, true, &sparse->error);
    if (status) return status;
    dal__copy(system->def.inputs, sparse->eval.own_input, whole->eval.own_input);
    status = dal_step_equations(whole, t, beta, h, x, w, kappa, R1, R2, K, B, muk);
    sparse->error = whole->error;
    dal_mechanics_free(whole);
    return status;
}

int dal_step_equations(dal_mechanics *mechanics, double t, double beta, double h, const double *x,
                       const double *w, const double *kappa, double *R1, double *R2, double *K,
                       double *B, double *muk)
{
    if (!mechanics) return DAL_EINVAL;
    if (mechanics->eval.sparse)
        return with_all_entries(mechanics, t, beta, h, x, w, kappa, R1, R2, K, B, muk);
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n, m = mech->m;
    int status = dal__require_beta(mech, beta);
    if (!status) /* without constraints kappa may be NULL */
        status = DAL__REQUIRE_FINITE(&mech->error, {"t", 1, &t}, {"h", 1, &h}, {"x", 2 * n, x},
                                     {"w", n, w}, {"kappa", m, m > 0 ? kappa : w});
    if (!status) status = dal__step_begin(mech, t, t + h, beta, beta, h, false, x);
    if (status) return status;

    double *r1;
    arena scratch = {0};
    DAL__RESERVE(&scratch, (n + m) * (n + 1), &r1);
    status = dal__allocate(&scratch, &mech->error);
    if (status) return status;
    double *const r2 = r1 + n, *const k = r2 + m, *const b = k + n * n;
    status = dal__step_at(mech, w, kappa, R1 ? r1 : NULL, R2 ? r2 : NULL, K ? k : NULL, NULL,
                          B ? b : NULL);
    if (!status)
        status = DAL__DELIVER(&mech->error, {"R1", n, r1, R1}, {"R2", m, r2, R2},
                              {"K", n * n, k, K}, {"B", m * n, b, B},
                              {"mu_k", m * n, mech->muk, muk});
    dal__release(&scratch);
    return status;
}
