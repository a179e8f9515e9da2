/* The callbacks of a system as the library calls them; differences for what is missing. */
#include "system/system.h"

#include <math.h>
#include <string.h>

/* A power of two near (u max(1, |q|))^(1/5), so that q+d and q-d are exact.  Roundoff of a function
 * that grows with q asks for d to grow with q; an angle, whose sine has its unit of 1 wherever it
 * stands, for d to stay: the power balances the two.  Where q is so large that d would be lost in
 * it, d is a few units of its last place. */
double dal__spacing(double q)
{
    int exponent;
    frexp(fmax(1.0, fabs(q)), &exponent);
    const int power = (exponent - 1) / 5 - 11, least = exponent - 48;
    return ldexp(1.0, power > least ? power : least);
}

/* f' = (8 (f(q+d) - f(q-d)) - (f(q+2d) - f(q-2d))) / 12d  +  O(d^4 f^(5)/30, 1.5 u f/d) */
int dal__difference(dal__function f, void *ctx, double *point, size_t j, size_t count,
                    double *value, double *slope, size_t stride)
{
    static const int offsets[4] = {1, -1, 2, -2};
    static const double weights[4] = {8.0, -8.0, -1.0, 1.0};
    const double q = point[j], d = dal__spacing(q);
    int returned = 0;
    for (size_t i = 0; i < count; i++) slope[i * stride] = 0.0;
    for (int k = 0; k < 4 && !returned; k++) {
        point[j] = q + offsets[k] * d;
        dal__forget(count, value);
        returned = f(point, value, ctx);
        for (size_t i = 0; i < count; i++) slope[i * stride] += weights[k] * value[i];
    }
    for (size_t i = 0; i < count; i++) slope[i * stride] /= 12.0 * d;
    point[j] = q;
    return returned;
}

/* V, V_q and phi as the functions of q that are differenced. */

static int value_V(const double *q, double *V, void *ctx)
{
    evaluator *const e = ctx;
    e->potential_calls++;
    return e->system->def.potential(q, V, NULL, NULL, e->system->def.ctx);
}

static int value_V_q(const double *q, double *V_q, void *ctx)
{
    evaluator *const e = ctx;
    e->potential_calls++;
    return e->system->def.potential(q, NULL, V_q, NULL, e->system->def.ctx);
}

static int value_phi(const double *q, double *phi, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->constraint_calls++;
    if (def->kind != DAL_LINEAR) return def->constraint(q, e->velocity, phi, NULL, NULL, def->ctx);
    dal__forget(def->m * def->n, e->forms);
    const int returned = def->constraint(q, e->velocity, NULL, e->forms, NULL, def->ctx);
    if (!returned) dal__apply(def->m, def->n, e->forms, e->velocity, phi);
    return returned;
}

/* Second differences of V, good to about 1e-6, which is enough for what they serve: Newton's
 * speed. */
static int hessian_of_V(evaluator *e, const double *q, double *V_qq)
{
    const size_t n = e->system->def.n;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            const double di = dal__spacing(q[i]), dj = dal__spacing(q[j]);
            double sum = 0.0;
            for (int k = 0; k < 4; k++) {
                const double si = k < 2 ? di : -di, sj = k % 2 ? -dj : dj;
                double V = (double)NAN;
                e->point[i] += si;
                e->point[j] += sj;
                const int returned = value_V(e->point, &V, e);
                e->point[i] = q[i];
                e->point[j] = q[j];
                if (returned) return returned;
                sum += si * sj > 0.0 ? V : -V;
            }
            V_qq[i * n + j] = V_qq[j * n + i] = sum / (4.0 * di * dj);
        }
    return 0;
}

static int differenced_gradient(evaluator *e, const double *q, double *V_q)
{
    const size_t n = e->system->def.n;
    int returned = 0;
    double V;
    memcpy(e->point, q, n * sizeof *q);
    for (size_t i = 0; i < n && !returned; i++)
        returned = dal__difference(value_V, e, e->point, i, 1, &V, V_q + i, 1);
    return returned;
}

/* From the user's gradient where there is one. */
static int differenced_hessian(evaluator *e, const double *q, double *V_qq)
{
    const size_t n = e->system->def.n;
    int returned = 0;
    memcpy(e->point, q, n * sizeof *q);
    if (e->system->def.missing & DAL_MISSING_V_Q) return hessian_of_V(e, q, V_qq);
    for (size_t j = 0; j < n && !returned; j++)
        returned = dal__difference(value_V_q, e, e->point, j, n, e->gradient, V_qq + j, n);
    return returned;
}

static int complete_potential(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    double *const given_V_q = def->missing & DAL_MISSING_V_Q ? NULL : V_q;
    double *const given_V_qq = def->missing & DAL_MISSING_V_QQ ? NULL : V_qq;
    if (V || given_V_q || given_V_qq) {
        const int returned = def->potential(q, V, given_V_q, given_V_qq, def->ctx);
        e->potential_calls++;
        if (returned) return returned;
    }
    if (V_q && !given_V_q) {
        const int returned = differenced_gradient(e, q, V_q);
        if (returned) return returned;
    }
    return V_qq && !given_V_qq ? differenced_hessian(e, q, V_qq) : 0;
}

static int complete_constraint(const double *q, const double *v, double *phi, double *phi_v,
                               double *phi_q, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    const size_t n = def->n, m = def->m;
    if (phi || phi_v) {
        const int returned = def->constraint(q, v, phi, phi_v, NULL, def->ctx);
        e->constraint_calls++;
        if (returned) return returned;
    }
    if (!phi_q) return 0;
    int returned = 0;
    e->velocity = v;
    memcpy(e->point, q, n * sizeof *q);
    for (size_t j = 0; j < n && !returned; j++)
        returned = dal__difference(value_phi, e, e->point, j, m, e->gradient, phi_q + j, n);
    return returned;
}

/* The first derivatives of L, and f, as functions of q or v that are differenced: the point that
 * moves is the argument, the other one is kept in the evaluator. */

static int value_L_q(const double *q, double *L_q, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->lagrangian_calls++;
    return def->lagrangian(q, e->velocity, NULL, L_q, NULL, NULL, NULL, NULL, def->ctx);
}

static int value_L_v(const double *q, double *L_v, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->lagrangian_calls++;
    return def->lagrangian(q, e->velocity, NULL, NULL, L_v, NULL, NULL, NULL, def->ctx);
}

static int value_L_v_of_v(const double *v, double *L_v, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->lagrangian_calls++;
    return def->lagrangian(e->position, v, NULL, NULL, L_v, NULL, NULL, NULL, def->ctx);
}

static int value_f(const double *q, double *f, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->force_calls++;
    return def->force(e->time, q, e->velocity, f, NULL, NULL, def->ctx);
}

static int value_f_of_v(const double *v, double *f, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->force_calls++;
    return def->force(e->time, e->position, v, f, NULL, NULL, def->ctx);
}

/* matrix[n*n] <- df_i/dx_j at x, where f is one of the functions above. */
static int differenced_matrix(evaluator *e, dal__function f, const double *x, double *matrix)
{
    const size_t n = e->system->def.n;
    int returned = 0;
    memcpy(e->point, x, n * sizeof *x);
    for (size_t j = 0; j < n && !returned; j++)
        returned = dal__difference(f, e, e->point, j, n, e->gradient, matrix + j, n);
    return returned;
}

static void symmetrise(size_t n, double *A)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++) {
            const double mean = 0.5 * (A[i * n + j] + A[j * n + i]);
            A[i * n + j] = A[j * n + i] = mean;
        }
}

void dal__evaluator_reserve(evaluator *e, const dal_system *system, arena *a)
{
    const size_t n = system->def.n;
    dal__reserve(a, &e->point, n, sizeof(double));
    dal__reserve(a, &e->gradient, n, sizeof(double));
    dal__reserve(a, &e->forms, dal__times(system->def.m, n), sizeof(double));
}

void dal__evaluator_bind(evaluator *e, const dal_system *system)
{
    const dal_system_def *def = &system->def;
    const unsigned of_potential = DAL_MISSING_V_Q | DAL_MISSING_V_QQ;
    e->system = system;
    e->potential = def->potential;
    e->potential_ctx = def->ctx;
    e->constraint = def->constraint;
    e->constraint_ctx = def->ctx;
    e->constant_mass = !def->lagrangian;
    if (def->potential && (def->missing & of_potential)) {
        e->potential = complete_potential;
        e->potential_ctx = e;
    }
    if (def->constraint && (def->missing & DAL_MISSING_PHI_Q)) {
        e->constraint = complete_constraint;
        e->constraint_ctx = e;
    }
}

static int refuse(dal_error *error, const char *callback, int returned)
{
    return dal__fail(error, dal__callback_status(returned), "%s returned %d (%s)", callback,
                     returned, returned > 0 ? "outside its domain" : "stop");
}

static int require_finite(dal_error *error, const char *callback, const char *output, size_t rows,
                          size_t columns, const double *x)
{
    if (!x || dal__all_finite(rows * columns, x)) return DAL_SUCCESS;
    size_t i = 0;
    while (isfinite(x[i])) i++;
    return dal__fail(error, DAL_EDOMAIN, "%s: %s[%zu,%zu] = %g is not finite, or was not written",
                     callback, output, i / columns, i % columns, x[i]);
}

int dal__potential(evaluator *e, const double *q, double *V, double *V_q, double *V_qq,
                   dal_error *error)
{
    const size_t n = e->system->def.n;
    if (!e->potential) {
        if (V) *V = 0.0;
        if (V_q) memset(V_q, 0, n * sizeof *V_q);
        if (V_qq) memset(V_qq, 0, n * n * sizeof *V_qq);
        return DAL_SUCCESS;
    }
    if (!V && !V_q && !V_qq) return DAL_SUCCESS;
    dal__forget(1, V);
    dal__forget(n, V_q);
    dal__forget(n * n, V_qq);
    const int returned = e->potential(q, V, V_q, V_qq, e->potential_ctx);
    if (e->potential_ctx != e) e->potential_calls++;
    if (returned) return refuse(error, "potential", returned);
    int status = require_finite(error, "potential", "V", 1, 1, V);
    if (!status) status = require_finite(error, "potential", "V_q", 1, n, V_q);
    if (!status) status = require_finite(error, "potential", "V_qq", n, n, V_qq);
    return status;
}

int dal__constraint(evaluator *e, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, dal_error *error)
{
    const size_t n = e->system->def.n, m = e->system->def.m;
    const bool linear = e->system->def.kind == DAL_LINEAR;
    if (m == 0) return DAL_SUCCESS;
    double *const forms = linear && phi && !phi_v ? e->forms : phi_v;
    dal__forget(m, phi);
    dal__forget(m * n, forms);
    dal__forget(m * n, phi_q);
    const int returned = e->constraint(q, v, linear ? NULL : phi, forms, phi_q, e->constraint_ctx);
    if (e->constraint_ctx != e) e->constraint_calls++;
    if (returned) return refuse(error, "constraint", returned);
    int status = require_finite(error, "constraint", "phi_v", m, n, forms);
    if (!status) status = require_finite(error, "constraint", "phi_q", m, n, phi_q);
    if (!status && !linear) status = require_finite(error, "constraint", "phi", 1, m, phi);
    if (!status && linear && phi) dal__apply(m, n, forms, v, phi);
    return status;
}

/* The jet of v^T M v / 2 - V. */
static int simple_lagrangian(evaluator *e, const double *q, const double *v, const dal__jet *jet,
                             dal_error *error)
{
    const size_t n = e->system->def.n;
    const double *const M = e->system->mass;
    double V;
    const int status = dal__potential(e, q, jet->L ? &V : NULL, jet->L_q, jet->L_qq, error);
    if (status) return status;
    for (size_t i = 0; jet->L_q && i < n; i++) jet->L_q[i] = -jet->L_q[i];
    for (size_t k = 0; jet->L_qq && k < n * n; k++) jet->L_qq[k] = -jet->L_qq[k];
    if (jet->L_v) dal__apply(n, n, M, v, jet->L_v);
    if (jet->L_vq) memset(jet->L_vq, 0, n * n * sizeof *jet->L_vq);
    if (jet->L_vv) memcpy(jet->L_vv, M, n * n * sizeof *jet->L_vv);
    if (!jet->L) return DAL_SUCCESS;
    dal__apply(n, n, M, v, e->gradient);
    *jet->L = 0.5 * dal__dot(n, v, e->gradient) - V;
    return DAL_SUCCESS;
}

int dal__lagrangian(evaluator *e, const double *q, const double *v, const dal__jet *jet,
                    dal_error *error)
{
    const dal_system_def *const def = &e->system->def;
    const size_t n = def->n;
    if (e->constant_mass) return simple_lagrangian(e, q, v, jet, error);
    double *const given_qq = def->missing & DAL_MISSING_L_QQ ? NULL : jet->L_qq;
    double *const given_vq = def->missing & DAL_MISSING_L_VQ ? NULL : jet->L_vq;
    double *const given_vv = def->missing & DAL_MISSING_L_VV ? NULL : jet->L_vv;
    dal__forget(1, jet->L);
    dal__forget(n, jet->L_q);
    dal__forget(n, jet->L_v);
    dal__forget(n * n, jet->L_qq);
    dal__forget(n * n, jet->L_vq);
    dal__forget(n * n, jet->L_vv);
    int returned = 0;
    if (jet->L || jet->L_q || jet->L_v || given_qq || given_vq || given_vv) {
        e->lagrangian_calls++;
        returned = def->lagrangian(q, v, jet->L, jet->L_q, jet->L_v, given_qq, given_vq, given_vv,
                                   def->ctx);
    }
    e->position = q;
    e->velocity = v;
    if (!returned && jet->L_qq && !given_qq) {
        returned = differenced_matrix(e, value_L_q, q, jet->L_qq);
        symmetrise(n, jet->L_qq);
    }
    if (!returned && jet->L_vq && !given_vq)
        returned = differenced_matrix(e, value_L_v, q, jet->L_vq);
    if (!returned && jet->L_vv && !given_vv) {
        returned = differenced_matrix(e, value_L_v_of_v, v, jet->L_vv);
        symmetrise(n, jet->L_vv);
    }
    if (returned) return refuse(error, "lagrangian", returned);
    int status = require_finite(error, "lagrangian", "L", 1, 1, jet->L);
    if (!status) status = require_finite(error, "lagrangian", "L_q", 1, n, jet->L_q);
    if (!status) status = require_finite(error, "lagrangian", "L_v", 1, n, jet->L_v);
    if (!status) status = require_finite(error, "lagrangian", "L_qq", n, n, jet->L_qq);
    if (!status) status = require_finite(error, "lagrangian", "L_vq", n, n, jet->L_vq);
    if (!status) status = require_finite(error, "lagrangian", "L_vv", n, n, jet->L_vv);
    return status;
}

int dal__force(evaluator *e, double t, const double *q, const double *v, double *f, double *f_q,
               double *f_v, dal_error *error)
{
    const dal_system_def *const def = &e->system->def;
    const size_t n = def->n;
    if (!def->force) {
        if (f) memset(f, 0, n * sizeof *f);
        if (f_q) memset(f_q, 0, n * n * sizeof *f_q);
        if (f_v) memset(f_v, 0, n * n * sizeof *f_v);
        return DAL_SUCCESS;
    }
    double *const given_q = def->missing & DAL_MISSING_F_Q ? NULL : f_q;
    double *const given_v = def->missing & DAL_MISSING_F_V ? NULL : f_v;
    dal__forget(n, f);
    dal__forget(n * n, f_q);
    dal__forget(n * n, f_v);
    int returned = 0;
    if (f || given_q || given_v) {
        e->force_calls++;
        returned = def->force(t, q, v, f, given_q, given_v, def->ctx);
    }
    e->time = t;
    e->position = q;
    e->velocity = v;
    if (!returned && f_q && !given_q) returned = differenced_matrix(e, value_f, q, f_q);
    if (!returned && f_v && !given_v) returned = differenced_matrix(e, value_f_of_v, v, f_v);
    if (returned) return refuse(error, "force", returned);
    int status = require_finite(error, "force", "f", 1, n, f);
    if (!status) status = require_finite(error, "force", "f_q", n, n, f_q);
    if (!status) status = require_finite(error, "force", "f_v", n, n, f_v);
    return status;
}
