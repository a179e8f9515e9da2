/* The constant mass of a system: whether it is one, its inverse, and its units. */
#include "system/system.h"

#include <math.h>
#include <string.h>

/* Shape, finiteness, symmetry and positive definiteness are separate questions with separate
 * answers, because each is a different mistake. */
int dal__check_mass(const dal_system_def *def, dal_error *error)
{
    const size_t n = def->n;
    const double *M = def->mass;
    for (size_t i = 0; !M && i < n; i++)
        if (!isfinite(def->masses[i]))
            return dal__fail(error, DAL_EINVAL, "masses[%zu] = %g is not finite", i,
                             def->masses[i]);
    if (!M) return DAL_SUCCESS;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            if (!isfinite(M[i * n + j]))
                return dal__fail(error, DAL_EINVAL, "mass[%zu,%zu] = %g is not finite", i, j,
                                 M[i * n + j]);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++) {
            const double a = M[i * n + j], b = M[j * n + i];
            if (fabs(a - b) > 16.0 * DAL_ROUNDOFF * (fabs(a) + fabs(b)))
                return dal__fail(error, DAL_EINVAL,
                                 "mass is not symmetric: mass[%zu,%zu] = %.17g, mass[%zu,%zu] = "
                                 "%.17g", i, j, a, j, i, b);
        }
    return DAL_SUCCESS;
}

static int not_definite(size_t row, double pivot, double entry, dal_error *error)
{
    return dal__fail(error, DAL_EINVAL, "mass is not positive definite to working precision: pivot "
                     "%zu of its Cholesky factor is %g where mass[%zu,%zu] = %g", row, pivot, row,
                     row, entry);
}

/* From an entry of its diagonal to the next. */
static size_t next_mass(const dal_system *system)
{
    return system->masses ? 1 : system->def.n + 1;
}

static int invert_diagonal_mass(dal_system *system, dal_error *error)
{
    const size_t next = next_mass(system);
    for (size_t i = 0; i < system->def.n; i++) {
        const double entry = system->mass[i * next];
        if (!(entry > 0.0 && isfinite(1.0 / entry))) return not_definite(i, entry, entry, error);
        system->mass_inverse[i * next] = 1.0 / entry;
    }
    return DAL_SUCCESS;
}

/* M^-1 by columns, which are its rows but for roundoff. */
static int invert_mass(dal_system *system, dal_error *error)
{
    const size_t n = system->def.n;
    double *const inverse = system->mass_inverse, *factor;
    arena scratch = {0};
    DAL__RESERVE(&scratch, system->factor ? 0 : n * n, &factor);
    int status = dal__allocate(&scratch, error);
    if (status) return status;
    if (system->factor) factor = system->factor;
    size_t row = 0;
    double pivot = 0.0;
    memcpy(factor, system->mass, n * n * sizeof *factor);
    if (!dal__cholesky(n, factor, system->unit, &row, &pivot))
        status = not_definite(row, pivot, system->mass[row * n + row], error);
    for (size_t j = 0; !status && j < n; j++) {
        inverse[j * n + j] = 1.0;
        dal__cholesky_solve(n, factor, inverse + j * n);
    }
    dal__symmetrise(n, inverse);
    dal__release(&scratch);
    return status;
}

static bool is_diagonal(const dal_system_def *def)
{
    const size_t n = def->n;
    for (size_t i = 0; def->mass && i < n; i++)
        for (size_t j = 0; j < n; j++)
            if (i != j && def->mass[i * n + j] != 0.0) return false;
    return dal__has_mass(def);
}

int dal__bind_mass(dal_system *system, dal_error *error)
{
    const size_t n = system->def.n;
    dal__clear(system->masses ? n : n * n, system->mass_inverse);
    system->diagonal = is_diagonal(&system->def);
    const int status =
        system->diagonal ? invert_diagonal_mass(system, error) : invert_mass(system, error);
    for (size_t i = 0; !status && i < n; i++) {
        system->unit[i] = sqrt(system->mass_inverse[i * next_mass(system)]);
        system->per_unit[i] = 1.0 / system->unit[i];
    }
    return status;
}

void dal__apply_mass(const dal_system *system, const double *x, double *y)
{
    const size_t n = system->def.n;
    if (!system->masses) dal__apply(n, n, system->mass, x, y);
    for (size_t i = 0; system->masses && i < n; i++) y[i] = system->mass[i] * x[i];
}

int dal_system_mass(const dal_system *system, double *M)
{
    if (!system) return DAL_EINVAL;
    if (!system->mass) return DAL_EUNSUPPORTED;
    if (!M) return DAL_SUCCESS;
    const size_t n = system->def.n;
    if (!system->masses) dal__copy(n * n, system->mass, M);
    else dal__clear(n * n, M);
    for (size_t i = 0; system->masses && i < n; i++) M[i * n + i] = system->mass[i];
    return DAL_SUCCESS;
}
