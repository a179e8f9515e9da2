/* A step that changes the energy by more than half the kinetic energy, with no work done, is
 * wrong. */
#include "step/energy_jump.h"

#include <math.h>
#include <string.h>

/* Changes below this part of the energy are none: where nothing moves at the states that are looked
 * at, there is no kinetic energy to compare with. */
static const double RESOLUTION = 1e-9;

/* The energy and the kinetic energy at x[2n], moved back by shift v.  The statistics do not count
 * it. */
static int energies(dal_mechanics *mech, double shift, const double *x, double *E, double *kinetic)
{
    const size_t n = mech->n;
    const dal__calls calls = mech->eval.calls;
    const double *y = x;
    if (shift != 0.0) {
        memcpy(mech->point, x, 2 * n * sizeof *x);
        for (size_t i = 0; i < n; i++) mech->point[i] -= shift * x[n + i];
        y = mech->point;
    }
    int status = dal__build_metric(mech, 0.0, y, y + n);
    if (!status) status = dal__energy(mech, 0.0, y, E);
    dal__weigh(mech, y + n, mech->step);
    *kinetic = 0.5 * dal__dot(n, y + n, mech->step);
    mech->eval.calls = calls;
    return status;
}

int dal__energy_jump_start(dal__energy_jump *jump, dal_mechanics *mech, int order, double shift,
                           const double *x)
{
    const dal_system_def *const def = &mech->eval.system->def;
    *jump = (dal__energy_jump){.shift = shift};
    if (order == 1 || !dal__is_autonomous(mech->eval.system) || def->kind != DAL_LINEAR)
        return DAL_SUCCESS;
    const int status = energies(mech, shift, x, &jump->energy, &jump->kinetic);
    jump->looking = isfinite(jump->energy);
    return status;
}

int dal__energy_jump_look(dal__energy_jump *jump, dal_mechanics *mech, size_t step, const double *x)
{
    double E, kinetic;
    if (!jump->looking || jump->step > 0) return DAL_SUCCESS;
    const int status = energies(mech, jump->shift, x, &E, &kinetic);
    if (status == DAL_EUSER) return status;
    if (status) E = HUGE_VAL; /* V is not finite there, or not defined, as it was at the start */
    else jump->kinetic = fmax(jump->kinetic, kinetic);
    const double change = E - jump->energy + jump->undone;
    jump->strayed = fmax(jump->strayed, fabs(change));
    const double least = RESOLUTION * fmax(fabs(E), fabs(jump->energy));
    if (isfinite(E) && fabs(change) <= fmax(0.5 * jump->kinetic, least)) return DAL_SUCCESS;
    jump->step = step;
    jump->change = change;
    return DAL_SUCCESS;
}

void dal__energy_jump_save(dal__energy_jump *jump, dal__archive *a)
{
    dal__archive_flag(a, &jump->looking);
    dal__archive_real(a, &jump->shift);
    dal__archive_any(a, &jump->energy);
    dal__archive_any(a, &jump->kinetic);
    dal__archive_counter(a, &jump->step);
    dal__archive_any(a, &jump->change);
    dal__archive_any(a, &jump->undone);
}
