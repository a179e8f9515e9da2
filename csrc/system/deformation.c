/* Systems whose constraint is that of another system, deformed.
 *
 * A deformed system is a system as any other: its callbacks call those of its base, which it
 * borrows, with the ctx of the base.  It may be shared by threads as far as the base may, so what
 * a call needs beside its outputs lies on the stack. */
#include "dalembert/deformation.h"
#include "system/system.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST_ENTRIES = 4000, MOST_ROWS = 64 }; /* of phi_v, and of the coordinates; m <= n */

typedef struct deformation {
    dal_system_def base;  /* first: the ctx of what is taken over */
    dal_deformation_fn g; /* NULL: phi(q - delta v, v) */
    void *ctx;            /* of g */
    double delta;
} deformation;

/* ---- what is taken over from the base ---------------------------------------------------- */

static int base_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const dal_system_def *const base = ctx; /* the first member of a deformation */
    return base->potential(t, q, V, V_q, V_qq, base->ctx);
}

static int base_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                           double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                           void *ctx)
{
    const dal_system_def *const base = ctx; /* the first member of a deformation */
    return base->lagrangian(t, q, v, L, L_q, L_v, L_qq, L_vq, L_vv, L_vt, base->ctx);
}

static int base_force(double t, const double *q, const double *v, const double *u, double *f,
                      double *f_q, double *f_v, void *ctx)
{
    const dal_system_def *const base = ctx; /* the first member of a deformation */
    return base->force(t, q, v, u, f, f_q, f_v, base->ctx);
}

/* phi[m] of the base, which is mu v where it is linear, and phi_v[m*n], phi_q[m*n], phi_t[m], which
 * may be NULL; forms[m*n] is scratch. */
static int base_constraint(const dal_system_def *base, double t, const double *q, const double *v,
                           double *phi, double *phi_v, double *phi_q, double *phi_t, double *forms)
{
    const bool linear = base->kind == DAL_LINEAR;
    double *const mu = linear && phi && !phi_v ? forms : phi_v;
    const int returned =
        base->constraint(t, q, v, linear ? NULL : phi, mu, phi_q, phi_t, base->ctx);
    if (!returned && base->sparsity && mu) dal__expand(base, mu);
    if (!returned && base->sparsity && phi_q) dal__expand(base, phi_q);
    if (!returned && linear && phi) dal__apply(base->m, base->n, mu, v, phi);
    return returned;
}

/* ---- phi + delta g ----------------------------------------------------------------------- */

/* sum[count], which may be NULL, += delta g. */
static void add(size_t count, double delta, const double *g, double *sum)
{
    if (sum) dal__move(count, sum, delta, g, sum);
}

static int deformed(double t, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, double *phi_t, void *ctx)
{
    const deformation *const self = ctx;
    const size_t m = self->base.m, mn = m * self->base.n;
    double g[MOST_ROWS], g_v[MOST_ENTRIES], g_q[MOST_ENTRIES], g_t[MOST_ROWS];
    int returned = base_constraint(&self->base, t, q, v, phi, phi_v, phi_q, phi_t, g_v);
    if (returned) return returned;
    dal__forget(m, g);
    dal__forget(mn, g_v);
    dal__forget(mn, g_q);
    dal__forget(m, g_t);
    returned = self->g(t, q, v, phi ? g : NULL, phi_v ? g_v : NULL, phi_q ? g_q : NULL,
                       phi_t ? g_t : NULL, self->ctx);
    if (returned) return returned;
    add(m, self->delta, g, phi);
    add(mn, self->delta, g_v, phi_v);
    add(mn, self->delta, g_q, phi_q);
    add(m, self->delta, g_t, phi_t);
    return 0;
}

/* ---- phi(q - delta v, v) ------------------------------------------------------------------ */

static int shifted(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    const deformation *const self = ctx;
    const size_t n = self->base.n, mn = self->base.m * n;
    double point[MOST_ENTRIES], scratch[MOST_ENTRIES];
    dal__move(n, q, -self->delta, v, point);
    double *const slope = phi_v && !phi_q ? scratch : phi_q; /* phi_v needs it */
    const int returned = base_constraint(&self->base, t, point, v, phi, phi_v, slope, phi_t,
                                         phi_v ? NULL : scratch);
    if (!returned) add(mn, -self->delta, slope, phi_v);
    return returned;
}

/* ---- making ------------------------------------------------------------------------------ */

static int make(dal_system **system, const dal_system *base, deformation *self,
                dal_constraint_fn constraint, dal_constraint_kind kind, unsigned missing,
                dal_error *error)
{
    if (base->def.m == 0)
        return dal__fail(error, DAL_EINVAL, "base has no constraints to deform");
    if (base->def.driven)
        return dal__fail(error, DAL_EUNSUPPORTED, "base is \"%s\", whose constraints depend on "
                         "inputs: such constraints cannot be deformed", base->def.name);
    if (!isfinite(self->delta))
        return dal__fail(error, DAL_EINVAL, "%s = %g is not finite", self->g ? "delta" : "shift",
                         self->delta);
    if (dal__times(base->def.m, base->def.n) > MOST_ENTRIES)
        return dal__fail(error, DAL_EUNSUPPORTED, "m n = %zu * %zu: expected at most %d",
                         base->def.m, base->def.n, (int)MOST_ENTRIES);
    char name[128];
    snprintf(name, sizeof name, "%.100s_deformed", base->def.name);
    self->base = base->def;
    dal_system_def def = base->def;
    def.potential = base->def.potential ? base_potential : NULL;
    def.lagrangian = base->def.lagrangian ? base_lagrangian : NULL;
    def.force = base->def.force ? base_force : NULL;
    def.constraint = constraint;
    def.kind = kind;
    def.missing = base->def.missing | missing;
    def.name = name;
    def.description = def.source = def.formulas = NULL;
    def.state = NULL;
    def.exact = NULL;
    def.invariant = NULL;
    def.invariants = 0;
    def.ctx = self;
    def.ctx_size = sizeof *self;
    def.compiled = NULL;
    def.series = NULL;
    def.variations = NULL;
    def.sparsity = NULL;
    def.steady = 0;
    def.parameters = NULL;
    return dal_system_new(system, &def, error);
}

int dal_system_deform(dal_system **system, const dal_system *base, dal_deformation_fn g, void *ctx,
                      double delta, dal_constraint_kind kind, unsigned missing, dal_error *error)
{
    const int status = DAL__REQUIRE(error, {"system", system}, {"base", base}, {"g", g});
    if (status) return status;
    if (missing & ~(unsigned)(DAL_MISSING_PHI_Q | DAL_MISSING_PHI_T))
        return dal__fail(error, DAL_EINVAL, "missing = %#x: expected only DAL_MISSING_PHI_Q, for "
                         "g_q, and DAL_MISSING_PHI_T, for g_t", missing);
    if (kind < base->def.kind)
        return dal__fail(error, DAL_EINVAL, "kind = %d: expected at least %d, the kind of the base",
                         (int)kind, (int)base->def.kind);
    deformation self = {.g = g, .ctx = ctx, .delta = delta};
    return make(system, base, &self, deformed, kind, missing, error);
}

int dal_system_deform_nodes(dal_system **system, const dal_system *base, double shift,
                            dal_error *error)
{
    const int status = DAL__REQUIRE(error, {"system", system}, {"base", base});
    if (status) return status;
    if (base->def.missing & DAL_MISSING_PHI_Q)
        return dal__fail(error, DAL_EINVAL, "base does not provide phi_q, which the shifted "
                         "constraint needs");
    deformation self = {.delta = shift};
    return make(system, base, &self, shifted, DAL_NONLINEAR, 0, error);
}
