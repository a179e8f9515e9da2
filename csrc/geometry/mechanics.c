/* Mechanics on D as an object: what it is made of, and its inputs. */
#include "geometry/geometry.h"

void dal__mechanics_reserve(dal_mechanics *mech, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m;
    dal__evaluator_reserve(&mech->eval, system, a);
    const bool sparse = mech->eval.sparse, nonlinear = system->def.kind == DAL_NONLINEAR;
    const size_t mn = dal__entries(&mech->eval), nn = dal__times(n, n), twice = dal__times(2, n);
    DAL__RESERVE(a, n, &mech->forms.q, &mech->force, &mech->w, &mech->step, &mech->momentum,
                 &mech->reach, &mech->node, &mech->trial, &mech->place);
    DAL__RESERVE(a, m, &mech->forms.phi, &mech->forms.phi_t, &mech->forms.moves, &mech->lambda);
    DAL__RESERVE(a, mn, &mech->forms.mu, &mech->forms.dmu, &mech->gram.Z, &mech->muk);
    if (!sparse) DAL__RESERVE(a, nn, &mech->hessian);
    DAL__RESERVE(a, twice, &mech->point);
    dal__linear_reserve_pattern(&mech->gram.C, m, sparse ? system->pattern : NULL, a);
    if (!system->mass) {
        dal__metric *const metric = &mech->metric;
        DAL__RESERVE(a, n, &metric->unit, &metric->per_unit, &mech->L_vt);
        DAL__RESERVE(a, nn, &metric->M, &metric->factor, &mech->L_vq, &mech->L_vv);
        DAL__RESERVE(a, twice + 1, &metric->formed_at);
    }
    if (system->def.force && !sparse) DAL__RESERVE(a, nn, &mech->f_q, &mech->f_v);
    if (nonlinear) DAL__RESERVE(a, mn, &mech->chetaev);
    if (nonlinear) DAL__RESERVE(a, nn, &mech->bend);
}

void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system)
{
    mech->n = system->def.n;
    mech->m = system->def.m;
    if (system->mass)
        mech->metric = (dal__metric){.M = system->mass, .masses = system->masses,
                                     .unit = system->unit, .per_unit = system->per_unit};
    dal__evaluator_bind(&mech->eval, system);
}

int dal__mechanics_new(dal_mechanics **mechanics, const dal_system *system, bool dense,
                       dal_error *error)
{
    dal_mechanics shape = {.eval.dense = dense}, *self;
    int status = DAL__REQUIRE(error, {"mechanics", mechanics}, {"system", system});
    if (status) return status;
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape, system, &shape.arena);
    status = dal__allocate(&shape.arena, error);
    if (status) return status;
    *self = shape;
    dal__mechanics_bind(self, system);
    *mechanics = self;
    return DAL_SUCCESS;
}

int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system, dal_error *error)
{
    return dal__mechanics_new(mechanics, system, false, error);
}

void dal_mechanics_free(dal_mechanics *mechanics)
{
    if (mechanics) dal__release(&mechanics->arena);
}

const dal_error *dal_mechanics_error(const dal_mechanics *mechanics) { return &mechanics->error; }

int dal_mechanics_input(dal_mechanics *mechanics, const double *u)
{
    if (!mechanics) return DAL_EINVAL;
    return dal__evaluator_input(&mechanics->eval, u, &mechanics->error);
}

int dal__require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x)
{
    return DAL__REQUIRE_FINITE(&mech->error, {name, count, x});
}

int dal__require_state(dal_mechanics *mech, const char *name, const double *output, double shift,
                   double t, const double *x)
{
    if (!mech) return DAL_EINVAL;
    return DAL__REQUIRE_FINITE(&mech->error, {name, 0, output}, {"shift", 1, &shift}, {"t", 1, &t},
                               {"x", 2 * mech->n, x});
}
