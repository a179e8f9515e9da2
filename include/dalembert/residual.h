/* residual.h - the definition of the relative residual of a velocity.
 *
 * For linear constraints mu v = 0 with mass matrix M
 *     residual^a = |mu^a v| / s^a,    s^a(q, v) = |mu^a| |v|,
 *     |mu^a| = sum_i |mu^a_i| d_i,    |v| = max_j |v_j| / d_j,    d_i = sqrt((M^-1)_ii),
 * where d_i is the largest |v_i| of a velocity with v^T M v = 1, so |v|^2 <= v^T M v. If phi is not
 * linear in v, |phi^a| replaces |mu^a v| with mu = phi_v, and
 *     s^a = |mu^a| |v| + |phi^a - mu^a v| + moves^a,
 *     moves^a = sum_i |dphi^a/dq_i q_i| + |dphi^a/dt t|,
 * so s^a includes the rounding of q, of t, and of the terms of phi.  See docs/residual.md for a
 * derivation and the rounding bound.  Header only: generated code has no library to link. */
#ifndef DALEMBERT_RESIDUAL_H
#define DALEMBERT_RESIDUAL_H

#include <math.h>
#include <stddef.h>

#if defined(__GNUC__)
#define DAL_RESIDUAL_INLINE static inline __attribute__((always_inline))
#else
#define DAL_RESIDUAL_INLINE static inline
#endif

/* |v|, with per_unit[n] the 1/d_i.  A NaN may be ignored, because mu^a v shows it. */
DAL_RESIDUAL_INLINE double dal_residual_speed(size_t n, const double *per_unit, const double *v)
{
    double most = 0.0;
    for (size_t i = 0; i < n; i++) {
        const double speed = fabs(v[i]) * per_unit[i];
        most = speed > most ? speed : most;
    }
    return most;
}

/* sum_i |v_i| / d_i, the measure of the steps of an iteration.  It does not depend on the units of
 * coordinates either, and propagates a NaN. */
DAL_RESIDUAL_INLINE double dal_residual_extent(size_t n, const double *per_unit, const double *v)
{
    double sum = n > 0 ? fabs(v[0]) * per_unit[0] : 0.0;
    for (size_t i = 1; i < n; i++) sum += fabs(v[i]) * per_unit[i];
    return sum;
}

/* |mu^a| of a row mu[n], with unit[n] the d_i. */
DAL_RESIDUAL_INLINE double dal_residual_row_norm(size_t n, const double *unit, const double *mu)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += fabs(mu[i]) * unit[i];
    return sum;
}

#endif /* DALEMBERT_RESIDUAL_H */
