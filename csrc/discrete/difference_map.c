/* Finite difference maps rho, rho^beta or a user's own, and their inverse. */
#include "discrete/discrete.h"

#include <math.h>

void dal__rho_reserve(dal__rho *rho, const dal_difference_map *map, size_t n, arena *a)
{
    const size_t twice = map->differenced ? dal__times(2, n) : 0;
    rho->map = *map;
    rho->n = n;
    DAL__RESERVE(a, n, &rho->g, &rho->f);
    DAL__RESERVE(a, dal__times(n, n), &rho->g_0, &rho->g_1, &rho->f_0, &rho->f_1);
    DAL__RESERVE(a, twice, &rho->point, &rho->value);
    DAL__RESERVE(a, dal__times(twice, twice), &rho->slope);
}

/* The derivatives of rho^beta are constant. */
void dal__rho_bind(dal__rho *rho, dal_error *error)
{
    rho->error = error;
    if (rho->map.map) return;
    for (size_t k = 0; k < rho->n; k++) {
        const size_t kk = k * rho->n + k;
        rho->g_0[kk] = 1.0 - rho->map.beta;
        rho->g_1[kk] = rho->map.beta;
        rho->f_0[kk] = -1.0;
        rho->f_1[kk] = 1.0;
    }
}

static int require_finite(const dal__rho *rho, const char *name, size_t count, const double *x)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return dal__fail(rho->error, DAL_EDOMAIN, "difference map: %s[%zu,%zu] = %g is not "
                             "finite, or the callback did not set it", name, i / rho->n, i % rho->n,
                             x[i]);
    return DAL_SUCCESS;
}

static int require_state(const dal__rho *rho)
{
    const int status = require_finite(rho, "g", rho->n, rho->g);
    return status ? status : require_finite(rho, "f", rho->n, rho->f);
}

/* (g, f)[2n] at (q0, q1)[2n], to be differenced. */
static int value_rho(const double *q, double *value, void *ctx)
{
    const dal__rho *const rho = ctx;
    const size_t n = rho->n;
    return rho->map.map(rho->h, q, q + n, value, value + n, NULL, NULL, NULL, NULL, rho->map.ctx);
}

static int difference_slopes(dal__rho *rho, const dal__pair *pair)
{
    const size_t n = rho->n;
    rho->h = pair->h;
    dal__copy(n, pair->q0, rho->point);
    dal__copy(n, pair->q1, rho->point + n);
    const int returned =
        dal__jacobian(value_rho, rho, 2 * n, rho->point, 2 * n, rho->value, rho->slope);
    for (size_t i = 0; i < n; i++) {
        const double *const of_g = rho->slope + 2 * n * i, *const of_f = of_g + 2 * n * n;
        dal__copy(n, of_g, rho->g_0 + i * n);
        dal__copy(n, of_g + n, rho->g_1 + i * n);
        dal__copy(n, of_f, rho->f_0 + i * n);
        dal__copy(n, of_f + n, rho->f_1 + i * n);
    }
    return returned;
}

static int user_map(dal__rho *rho, const dal__pair *pair, bool slopes)
{
    const size_t n = rho->n, nn = n * n;
    const bool given = slopes && !rho->map.differenced;
    double *const matrices[] = {rho->g_0, rho->g_1, rho->f_0, rho->f_1};
    static const char *const names[] = {"g_0", "g_1", "f_0", "f_1"};
    dal__forget(n, rho->g);
    dal__forget(n, rho->f);
    for (size_t i = 0; given && i < 4; i++) dal__forget(nn, matrices[i]);
    int returned = rho->map.map(pair->h, pair->q0, pair->q1, rho->g, rho->f,
                                given ? rho->g_0 : NULL, given ? rho->g_1 : NULL,
                                given ? rho->f_0 : NULL, given ? rho->f_1 : NULL, rho->map.ctx);
    if (returned) return dal__refuse(rho->error, "difference map", returned);
    int status = require_state(rho);
    if (status || !slopes) return status;
    if (!given) returned = difference_slopes(rho, pair);
    if (returned) return dal__refuse(rho->error, "difference map", returned);
    for (size_t i = 0; !status && i < 4; i++)
        status = require_finite(rho, names[i], nn, matrices[i]);
    for (size_t k = 0; k < nn; k++) {
        rho->f_0[k] *= pair->h;
        rho->f_1[k] *= pair->h;
    }
    return status;
}

int dal__rho_at(dal__rho *rho, const dal__pair *pair, bool slopes)
{
    const double beta = rho->map.beta;
    if (rho->map.map) return user_map(rho, pair, slopes);
    for (size_t i = 0; i < rho->n; i++) {
        rho->g[i] = (1.0 - beta) * pair->q0[i] + beta * pair->q1[i];
        rho->f[i] = pair->w[i];
    }
    return require_state(rho);
}

/* ---- the inverse -------------------------------------------------------------------------- */

/* Of rho(z) - state at z = (q0, q1); the equations of f are multiplied by h. */
static int find_step(dal__newton *equations)
{
    dal_discrete *const d = equations->ctx;
    dal__rho *const rho = &d->constraint;
    dal__root *const root = &d->root;
    double *const J = root->J.A;
    const double h = d->mech.start.h, *const x = d->state;
    const size_t n = rho->n, N = 2 * n;
    const dal__pair pair = {h, root->z, root->z + n, NULL};
    const int status = dal__rho_at(rho, &pair, true);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        root->residual[i] = rho->g[i] - x[i];
        root->residual[n + i] = h * (rho->f[i] - x[n + i]);
        for (size_t j = 0; j < n; j++) {
            J[i * N + j] = rho->g_0[i * n + j];
            J[i * N + n + j] = rho->g_1[i * n + j];
            J[(n + i) * N + j] = rho->f_0[i * n + j];
            J[(n + i) * N + n + j] = rho->f_1[i * n + j];
        }
    }
    for (size_t k = 0; k < N * N; k++) root->scale[k] = fabs(J[k]);
    return dal__root_step(root, "the Jacobian of the difference map is singular: the map has no "
                          "inverse here", &d->mech.error);
}

int dal__rho_invert(dal_discrete *d, double t, double h, const double *x, double *q0, double *q1)
{
    const size_t n = d->n;
    const dal_difference_map *const map = &d->constraint.map;
    const double *const v = x + n;
    double *const z = d->root.z;
    const double before = map->map ? 0.5 : map->beta;
    dal__move(n, x, -before * h, v, z);
    dal__move(n, x, (1.0 - before) * h, v, z + n);
    int status = DAL_SUCCESS;
    if (map->map) {
        d->mech.start.h = h;
        dal__copy(2 * n, x, d->state);
        dal__newton equations = {.find_step = find_step, .ctx = d, .size = 2 * n, .n = n,
                                 .measured = 2 * n, .per_unit = d->mech.metric.per_unit, .z = z,
                                 .step = d->root.step};
        status = dal__build_metric(&d->mech, t, x, v);
        d->root.J.size = 2 * n;
        if (!status) status = dal__newton_run(&equations, &d->mech.error);
    }
    return status ? status : DAL__DELIVER(&d->mech.error, {"q0", n, z, q0}, {"q1", n, z + n, q1});
}
