/* C = mu Z^T and its factors, where mu = phi_v and Z holds the rows M^-1 mu^a. */
#include "geometry/geometry.h"

#include <math.h>

/* C <- mu Z^T of the forms. */
static void build_gram(dal_mechanics *mech)
{
    dal__linear_multiply(&mech->gram.C, mech->eval.rows, mech->n, mech->forms.mu, mech->gram.Z);
}

/* The sizes of mu Z^T for dal__linear: a coordinate that no row of Z moves counts for nothing. */
static void size_product(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    const dal_rows *const rows = mech->eval.rows;
    const double *const Z = mech->gram.Z, *const mu = mech->forms.mu;
    double *const sizes = mech->gram.C.sizes, *const moves = mech->w;
    dal__clear(n, moves);
    for (size_t a = 0; a < m; a++) {
        const size_t begin = rows ? rows->first[a] : a * n;
        const size_t end = rows ? rows->first[a + 1] : begin + n;
        sizes[m + a] = 0.0;
        for (size_t e = begin; e < end; e++) {
            const size_t i = rows ? rows->column[e] : e - begin;
            if (Z[e] != 0.0) moves[i] = mech->metric.unit[i];
            sizes[m + a] = fmax(sizes[m + a], fabs(Z[e]) * mech->metric.per_unit[i]);
        }
    }
    for (size_t a = 0; a < m; a++) sizes[a] = dal__row_extent(mech, mu, a, moves);
}

static int lost_rank(dal_mechanics *mech)
{
    dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular");
    if (!dal__name_dependent(mech, mech->forms.mu, mech->gram.Z, dal__rank_lost(mech),
                             &mech->error))
        dal__add_words(&mech->error, ": mu does not have full rank");
    return DAL_ESINGULAR;
}

int dal__factor_product(dal_mechanics *mech)
{
    build_gram(mech);
    size_product(mech);
    return dal__linear_factor(&mech->gram.C) ? DAL_SUCCESS : lost_rank(mech);
}

int dal__factor_gram(dal_mechanics *mech)
{
    dal__linear *const C = &mech->gram.C;
    dal__build_Z(mech, mech->forms.mu);
    if (C->pattern) return dal__factor_product(mech);
    build_gram(mech);
    return dal__cholesky(mech->m, C->A, C->sizes, NULL, NULL) ? DAL_SUCCESS : lost_rank(mech);
}

void dal__solve_gram(const dal_mechanics *mech, double *y)
{
    const dal__linear *const C = &mech->gram.C;
    if (C->pattern) dal__linear_solve(C, y, y);
    else dal__cholesky_solve(mech->m, C->A, y);
}

int dal_gram(dal_mechanics *mech, double t, const double *x, double *C)
{
    int status = dal__require_state(mech, "C", C, 0.0, t, x);
    if (!status) status = dal__build_metric(mech, t, x, x + mech->n);
    if (!status) /* without phi, which may overflow */
        status = dal__constraint(&mech->eval, t, x, x + mech->n, NULL, mech->forms.mu, NULL,
                                 NULL, &mech->error);
    if (status) return status;
    dal__copy(mech->n, x, mech->forms.q);
    dal__build_Z(mech, mech->forms.mu);
    build_gram(mech);
    const dal__linear *const gram = &mech->gram.C;
    const dal__pattern *const pattern = gram->pattern;
    const size_t m = mech->m;
    if (!pattern) return DAL__DELIVER(&mech->error, {"C", m * m, gram->A, C});
    status = dal__require_output(&mech->error, "C", pattern->stored, gram->A);
    if (status) return status;
    dal__clear(m * m, C);
    for (size_t a = 0; a < m; a++)
        for (size_t k = pattern->first[a]; k < pattern->first[a + 1]; k++)
            C[a * m + pattern->column[k]] = gram->A[pattern->place[k]];
    return DAL_SUCCESS;
}
