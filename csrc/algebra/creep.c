/* How an integrator that chooses its own steps advances. */
#include "algebra/algebra.h"

/* Steps after which it has to have advanced by this part of what as many of its longest steps
 * would, but of no more than the span, and of no less than LEAST of that: at such a pace 1e10 steps
 * and more would lead over the span.  Measured: over the sign() of dry friction steps are 1e-10 of
 * the longest. */
enum { WINDOW = 10000 };
static const double PART = 1e-6, LEAST = 1e-3;

/* Before so many steps nobody knows which size is usual. */
static const double EARLY = 8.0;

void dal__creep_step(dal__creep *self, double t, double h)
{
    const double part = self->count * fabs(h) / self->length;
    if (self->count >= EARLY && !(part >= dal__creep_shortest(self))) {
        self->shortest = part;
        self->t = t;
    }
    self->longest = fmax(self->longest, fabs(h));
    self->length += fabs(h);
    self->count += 1.0;
    self->since++;
}

int dal__creep_check(dal__creep *self, double t, double span, dal_error *error)
{
    if (self->since > 0 && self->since < WINDOW) return DAL_SUCCESS;
    const double advance = fabs(t - self->mark);
    if (!isfinite(span)) span = WINDOW * self->longest;
    const double reach = fmin(span, fmax(WINDOW * self->longest, LEAST * span));
    const bool creeps = self->since > 0 && advance < PART * reach;
    self->mark = t;
    self->since = 0;
    if (!creeps) return DAL_SUCCESS;
    return dal__fail(error, DAL_ENOCONV, "the step size collapsed: %d steps advanced by only %.1e, "
                     "to t = %.17g, after steps of up to %.1e. The force probably jumps or is "
                     "singular there. For dry friction use a smooth law, such as tanh(v/eps) for "
                     "sign(v), or switch between two systems at a terminal event", WINDOW, advance,
                     t, self->longest);
}

void dal__creep_save(dal__creep *self, dal__archive *a)
{
    double *const numbers[] = {&self->count, &self->length, &self->longest, &self->shortest,
                               &self->t, &self->mark};
    for (size_t i = 0; i < DAL_LENGTH(numbers); i++) dal__archive_real(a, numbers[i]);
    dal__archive_counter(a, &self->since);
}
