/* The family taylor: the flow of the ODE on D by Taylor series that are compiled for the system.
 *
 * A piece is the polynomial of one series, and may be longer or shorter than the steps of a run,
 * whose states it gives.  The numbers y of series.h, and the time, are compensated sums, so their
 * roundoff does not add up. */
#include "dalembert/series.h"
#include "geometry/geometry.h"
#include "step/scheme.h"

#include <math.h>
#include <string.h>

extern const dal_family dal__family_taylor;

static const dal_scheme records[] = {
    {.name = "taylor", .family = &dal__family_taylor,
     .help = "Taylor series of the ODE on D, for systems from expressions: best for accurate runs",
     .reference = "Jorba and Zou 2005"},
};

static const double TOLERANCE = 1e-15; /* where none is given */

/* The last coefficients are this much smaller than the tolerance, see dal_taylor_scheme. */
static const double MARGIN = 0x1p-7;

/* Coefficients of the order k = ORDERS |ln tolerance| decrease by e^-k/ORDERS over a step, whose
 * time per length is then the least (Jorba and Zou 2005; measured: 0.5 is dearer for all). */
static const double ORDERS = 0.66;
enum { LEAST_ORDER = 8 };

/* Of the length at which the last coefficients have the size that is allowed. */
static const double SAFETY = 0.96;

/* A piece that is so much longer than the one before is examined, as is the first one: whether its
 * polynomial solves the ODE at its end.  If the last coefficients are zero by chance, as those of
 * t^30, their size says nothing. */
static const double GROWTH = 2.0;

/* Without last coefficients a piece has at most so many units. */
static const double LONGEST = 0x1p10;

/* What the slopes at the end of a piece may differ by, relative to their size, at most. */
static double allowed_slope(double tolerance) { return fmax(sqrt(tolerance), 1e-7); }

typedef struct taylor {
    const dal_series *series;
    size_t n, states, width, order, inputs;
    double tolerance, log_tolerance; /* of the coefficients; its binary logarithm */
    double time, time_low;   /* since t0, where the piece begins, */
    double length;           /* and its length */
    double unit;             /* that of the coefficients; 0: not known */
    double last_length;      /* of the piece before; 0: there was none */
    double *y, *low;         /* [width] where the piece begins; the part below the last digit */
    double *row, *row_low;   /* [width] the same at the state that was given last */
    double *change, *slope;  /* [width] */
    double *from, *from_low; /* [width] */
    double *x, *input;       /* [2n], [inputs] that state, and the inputs of the piece */
    double *coefficients, *end, *work; /* aligned to ALIGNED */
    bool going;              /* the piece leads on from x, */
    bool stale;              /* but its coefficients are not those of y */
    bool fresh;              /* x is that of a saved state, and not known yet */
    dal__watch watch;
    arena arena;
} taylor;

enum { ALIGNED = 64 };

/* ---- making ------------------------------------------------------------------------------ */

static double *aligned(double *block)
{
    const uintptr_t at = (uintptr_t)block;
    return block + (ALIGNED - at % ALIGNED) % ALIGNED / sizeof(double);
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_taylor_scheme none = {0}, *const data = motion->scheme->data;
    const double asked = data ? data->tolerance : none.tolerance;
    const double tolerance = asked != 0.0 ? asked : TOLERANCE;
    const dal_system_def *const def = &motion->system->def;
    const dal_series *const series = def->series;
    int status = dal__scheme_check_plain(motion->scheme, "taylor", error);
    if (status) return status;
    if (!(tolerance >= 1e-16 && tolerance <= 1e-2))
        return dal__fail(error, DAL_EINVAL, "tolerance = %g: expected a number from 1e-16 to 0.01, "
                         "or 0 for 1e-15", tolerance);
    if (!series)
        return dal__fail(error, DAL_EUNSUPPORTED, "the system \"%s\" has no Taylor series, which "
                         "come from its expressions; choose the scheme \"reference\"", def->name);
    taylor shape = {.series = series, .n = def->n, .states = series->states,
                    .width = series->width, .inputs = def->inputs,
                    .tolerance = tolerance * MARGIN}, *self;
    shape.log_tolerance = log2(shape.tolerance);
    shape.order = (size_t)ceil(-ORDERS * log(shape.tolerance));
    if (shape.order < LEAST_ORDER) shape.order = LEAST_ORDER;
    if (shape.order > DAL_SERIES_MOST) shape.order = DAL_SERIES_MOST;
    if (series->abi != DAL_SERIES_ABI)
        return dal__fail(error, DAL_EINVAL, "series: number %u, expected %u; compile the system "
                         "with this version of series.h", series->abi, DAL_SERIES_ABI);
    const size_t spare = ALIGNED / sizeof(double), rows = shape.order + 1;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    DAL__RESERVE(&memory, shape.width, &shape.y, &shape.low, &shape.row, &shape.row_low,
                 &shape.from, &shape.from_low, &shape.slope);
    DAL__RESERVE(&memory, shape.width + spare, &shape.change);
    DAL__RESERVE(&memory, 2 * def->n, &shape.x);
    DAL__RESERVE(&memory, def->inputs, &shape.input);
    DAL__RESERVE(&memory, rows * shape.width + spare, &shape.coefficients);
    DAL__RESERVE(&memory, 2 * shape.width + spare, &shape.end);
    DAL__RESERVE(&memory, rows * series->room + spare, &shape.work);
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    self->change = aligned(self->change);
    self->coefficients = aligned(self->coefficients);
    self->end = aligned(self->end);
    self->work = aligned(self->work);
    *method = self;
    return DAL_SUCCESS;
}

static void release(void *method)
{
    dal__release(&((taylor *)method)->arena);
}

static void start(void *method, dal_motion *motion)
{
    taylor *const self = method;
    (void)motion;
    self->going = self->fresh = false;
    self->unit = self->last_length = 0.0;
}

/* ---- compensated sums -------------------------------------------------------------------- */

/* The sum of a, its low part and b, with its own low part. */
static double add(double a, double *low, double b)
{
    const double part = b + *low, sum = a + part, back = sum - a;
    *low = (a - (sum - back)) + (part - back);
    return sum;
}

/* The state at s units of the piece: y[width] and its low part. */
static void state_at(taylor *self, double s, double *y, double *low)
{
    self->series->sum(self->order, s, self->coefficients, self->change);
    for (size_t i = 0; i < self->states; i++) {
        double rest = self->low[i];
        y[i] = add(self->y[i], &rest, self->change[i]);
        low[i] = rest;
    }
}

/* ---- a piece ----------------------------------------------------------------------------- */

/* The coefficients of a state up to an order; DAL_SERIES_LAST at least gives decay. */
static void expand(taylor *self, const dal_motion *motion, double time, double time_low,
                   const double *y, const double *low, size_t order, double *coefficients)
{
    double rest = time_low;
    const double t = add(motion->t0, &rest, time);
    const dal_series_at at = {.t = t, .t_low = rest, .unit = self->unit, .y = y, .low = low,
                              .u = self->input};
    self->series->expand(&at, order, coefficients, self->work, motion->system->def.ctx);
    motion->stats->evaluations++;
}

/* log2 x for x > 0, to 3e-4, without a call. */
static double quick_log2(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    const int exponent = (int)(bits >> 52) - 1023;
    bits = (bits & 0xfffffffffffffU) | 0x3ff0000000000000U;
    double m;
    memcpy(&m, &bits, sizeof m);
    /* log2 of (1 + z)/(1 - z), around the middle of the octave */
    const double z = (m - 0x1.6a09e667f3bcdp0) / (m + 0x1.6a09e667f3bcdp0), square = z * z;
    return exponent + 0.5 + z * (2.885390081777927 + square * (0.961796693925976
                                                               + square * 0.577078016355585));
}

/* How long the piece may be, in units; infinite if its last coefficients are 0, and NaN if one is
 * not finite. */
static double allowed_units(const taylor *self)
{
    double decay[DAL_SERIES_LAST], least = HUGE_VAL;
    self->series->decay(self->order, self->coefficients, decay);
    for (size_t l = 0; l < DAL_SERIES_LAST; l++) {
        if (!(decay[l] <= DBL_MAX)) return (double)NAN;
        if (decay[l] < DBL_MIN) continue;
        const double power = (double)(self->order - DAL_SERIES_LAST + l);
        const double units = (self->log_tolerance - quick_log2(decay[l])) / power;
        if (units < least) least = units;
    }
    return least < HUGE_VAL ? SAFETY * exp2(least) : least;
}

/* The power of 2 next to a positive number. */
static double power_of_2(double x)
{
    int exponent;
    (void)frexp(x, &exponent);
    return ldexp(1.0, exponent);
}

static int fail_not_finite(taylor *self, dal_motion *motion)
{
    dal_mechanics *const mech = motion->mechanics;
    const double t = motion->t0 + self->time;
    memcpy(mech->point, self->y, self->n * sizeof(double));
    self->series->velocity(t, self->y, self->input, mech->point + self->n,
                           motion->system->def.ctx);
    for (size_t i = 0; i < 2 * self->n; i++)
        if (!isfinite(mech->point[i]))
            return dal__fail(motion->error, DAL_EDOMAIN, "the motion leaves the range of numbers "
                             "after t = %.17g", t);
    const int status = dal__field(mech, t, mech->point, self->end);
    if (status) return status;
    return dal__fail(motion->error, DAL_EDOMAIN, "the Taylor series are not finite at t = %.17g, "
                     "where a function is not analytic, or the motion comes to an end; the scheme "
                     "\"reference\" needs no series", t);
}

/* The coefficients at y, in a unit that suits them; *units <- what allowed_units says. */
static int expand_piece(taylor *self, dal_motion *motion, double *units)
{
    enum { TRIES = 80, FAR = 64 };
    for (int k = 0; k < TRIES; k++) {
        expand(self, motion, self->time, self->time_low, self->y, self->low, self->order,
               self->coefficients);
        *units = allowed_units(self);
        const bool is_far = !(*units <= FAR && *units >= 1.0 / FAR);
        if (*units == HUGE_VAL || !is_far) return DAL_SUCCESS;
        const double factor = isnan(*units) ? 0x1p-32 : power_of_2(*units);
        const double unit = self->unit * factor;
        if (!(unit > DBL_MIN && unit < DBL_MAX)) break;
        self->unit = unit;
    }
    return fail_not_finite(self, motion);
}

/* Whether the polynomial of the piece solves the ODE where it ends. */
static bool solves_at_end(taylor *self, const dal_motion *motion)
{
    const size_t width = self->width;
    const double s = self->length / self->unit;
    double low = self->time_low;
    const double end = add(self->time, &low, self->length);
    state_at(self, s, self->from, self->from_low);
    if (!dal__all_finite(self->states, self->from)) return false;
    expand(self, motion, end, low, self->from, self->from_low, 1, self->end);
    memset(self->slope, 0, width * sizeof(double));
    for (size_t k = self->order; k > 0; k--)
        for (size_t i = 0; i < width; i++)
            self->slope[i] = self->slope[i] * s + (double)k * self->coefficients[k * width + i];
    for (size_t i = 0; i < self->states; i++) {
        double size = fabs(self->end[width + i]);
        for (size_t k = 1; k <= 3; k++)
            size = fmax(size, fabs(self->coefficients[k * width + i]));
        const double roundoff = DAL_ROUNDOFF * (double)self->order * fabs(self->y[i]);
        const double difference = fabs(self->slope[i] - self->end[width + i]);
        if (!(difference <= allowed_slope(self->tolerance) * size + roundoff)) return false;
    }
    return true;
}

/* A piece from y. */
static int begin_piece(taylor *self, dal_motion *motion)
{
    enum { HALVINGS = 60 };
    const double direction = motion->h > 0.0 ? 1.0 : -1.0, last = self->last_length;
    double units;
    const int status = expand_piece(self, motion, &units);
    if (status) return status;
    const double longest = fmin(units, LONGEST) * self->unit;
    self->length = direction * longest;
    const bool suspicious =
        last == 0.0 || longest > GROWTH * last || self->series->is_branched;
    for (int k = 0; suspicious && !solves_at_end(self, motion); k++) {
        if (k == HALVINGS) return fail_not_finite(self, motion);
        self->length *= 0.5;
    }
    self->last_length = fabs(self->length);
    self->stale = false;
    return DAL_SUCCESS;
}

/* x[2n] <- y at a time since t0, with the velocity in D to roundoff. */
static int find_state(taylor *self, dal_motion *motion, double time, const double *y, double *x)
{
    dal_mechanics *const mech = motion->mechanics;
    const double t = motion->t0 + time;
    memcpy(x, y, self->n * sizeof *x);
    self->series->velocity(t, y, self->input, x + self->n, motion->system->def.ctx);
    if (!dal__all_finite(2 * self->n, x)) return fail_not_finite(self, motion);
    if (mech->m == 0) return DAL_SUCCESS;
    const int status = motion->system->def.kind == DAL_NONLINEAR
                           ? dal_project(mech, t, 0.0, x, NULL)
                           : dal__mend(mech, t, 0.0, false, x, &mech->relative);
    if (!status) motion->stats->worst_residual = fmax(motion->stats->worst_residual,
                                                      mech->relative);
    return status;
}

/* Where w is v, v moves into D in the metric M. */
static int stay_in_D(taylor *self, dal_motion *motion)
{
    const size_t n = self->n;
    const int status = find_state(self, motion, self->time, self->y, self->x);
    for (size_t i = 0; !status && i < n; i++)
        if (self->x[n + i] != self->y[n + i]) {
            self->y[n + i] = self->x[n + i];
            self->low[n + i] = 0.0;
        }
    return status;
}

/* After a piece: the one that follows on it. */
static int next_piece(taylor *self, dal_motion *motion, double until)
{
    struct dal__guards *const guards = motion->guards;
    int status = dal__creep_check(&guards->creep, motion->t0 + self->time,
                                  fabs(until - self->time), motion->error);
    if (status) return status;
    state_at(self, self->length / self->unit, self->y, self->low);
    self->time = add(self->time, &self->time_low, self->length);
    const double relative = self->last_length / self->unit;
    if (relative < 0.25 || relative > 4.0) self->unit = power_of_2(self->last_length);
    if (!self->series->in_D) status = stay_in_D(self, motion);
    if (!status) status = begin_piece(self, motion);
    if (!status) dal__creep_step(&guards->creep, motion->t0 + self->time, self->length);
    return status;
}

/* ---- steps ------------------------------------------------------------------------------- */

/* The first piece, from x at a time since t0. */
static int begin(taylor *self, dal_motion *motion, double time)
{
    const dal_series *const series = self->series;
    const size_t n = self->n;
    const bool same = self->going && memcmp(self->x, motion->x, 2 * n * sizeof(double)) == 0;
    if (same) { /* the inputs have changed */
        memcpy(self->y, self->row, self->width * sizeof(double));
        memcpy(self->low, self->row_low, self->width * sizeof(double));
    } else {
        memcpy(self->y, motion->x, n * sizeof(double));
        memset(self->low, 0, self->width * sizeof(double));
    }
    if (self->inputs > 0) memcpy(self->input, motion->input, self->inputs * sizeof(double));
    if (!same)
        series->quasi(motion->t0 + time, motion->x, self->input, self->y + n,
                      motion->system->def.ctx);
    self->time = time;
    self->time_low = 0.0;
    self->last_length = 0.0;
    if (self->unit == 0.0) self->unit = power_of_2(fabs(motion->h));
    return begin_piece(self, motion);
}

/* Whether the piece leads on from where the motion is. */
static bool leads_on(const taylor *self, const dal_motion *motion)
{
    const size_t inputs = self->inputs;
    return self->going && memcmp(self->x, motion->x, 2 * self->n * sizeof(double)) == 0
        && (inputs == 0 || memcmp(self->input, motion->input, inputs * sizeof(double)) == 0);
}

/* The state at a time since t0. */
static int reach(taylor *self, dal_motion *motion, double time)
{
    const double direction = motion->h > 0.0 ? 1.0 : -1.0;
    int status = DAL_SUCCESS;
    while (direction * ((time - self->time) - self->time_low) > direction * self->length) {
        status = dal__ask(&self->watch, motion->t0 + self->time, motion->error);
        if (!status) status = next_piece(self, motion, time);
        if (status) return status;
    }
    const double s = ((time - self->time) - self->time_low) / self->unit;
    state_at(self, s, self->row, self->row_low);
    return find_state(self, motion, time, self->row, self->x);
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    taylor *const self = method;
    const double made = (double)(motion->steps - motion->first);
    int status = DAL_SUCCESS;
    if (self->watch.function != motion->watch || self->watch.ctx != motion->watch_ctx)
        self->watch = (dal__watch){.function = motion->watch, .ctx = motion->watch_ctx};
    if (self->fresh) memcpy(self->x, motion->x, 2 * self->n * sizeof(double));
    self->fresh = false;
    if (!leads_on(self, motion)) status = begin(self, motion, made * motion->h);
    else if (self->stale)
        expand(self, motion, self->time, self->time_low, self->y, self->low, self->order,
               self->coefficients);
    self->stale = false;
    self->going = !status;
    for (*done = 0; !status && *done < steps; *done += !status) {
        status = reach(self, motion, (made + (double)*done + 1.0) * motion->h);
        if (!status) memcpy(motion->x, self->x, 2 * self->n * sizeof(double));
    }
    self->going = !status;
    return status;
}

/* ---- saved states ------------------------------------------------------------------------ */

static size_t save(const void *method, double *values)
{
    const taylor *const self = method;
    const double *const numbers[] = {&self->tolerance, &self->unit, &self->time, &self->time_low,
                                     &self->length, &self->last_length};
    const double *const states[] = {self->y, self->low, self->row, self->row_low};
    const size_t inputs = self->inputs;
    for (size_t i = 0; values && i < DAL_LENGTH(numbers); i++) *values++ = *numbers[i];
    for (size_t i = 0; values && i < DAL_LENGTH(states); i++, values += self->states)
        memcpy(values, states[i], self->states * sizeof *values);
    if (values && inputs > 0) memcpy(values, self->input, inputs * sizeof *values);
    if (values) values[inputs] = self->going;
    return DAL_LENGTH(numbers) + DAL_LENGTH(states) * self->states + inputs + 1;
}

static int accepts(const void *method, const double *values)
{
    const taylor *const self = method;
    const double going = values[save(self, NULL) - 1];
    return values[0] == self->tolerance && values[1] >= 0.0 && (going == 0.0 || going == 1.0)
        && (going == 0.0 || values[1] > 0.0);
}

static void restore(void *method, const double *values)
{
    taylor *const self = method;
    double *const numbers[] = {&self->unit, &self->time, &self->time_low, &self->length,
                               &self->last_length};
    double *const states[] = {self->y, self->low, self->row, self->row_low};
    values++; /* the tolerance */
    for (size_t i = 0; i < DAL_LENGTH(numbers); i++) *numbers[i] = *values++;
    for (size_t i = 0; i < DAL_LENGTH(states); i++, values += self->states)
        memcpy(states[i], values, self->states * sizeof *values);
    if (self->inputs > 0) memcpy(self->input, values, self->inputs * sizeof *values);
    self->going = self->stale = self->fresh = values[self->inputs] == 1.0;
}

const dal_family dal__family_taylor = {
    .name = "taylor",
    .schemes = records,
    .count = DAL_LENGTH(records),
    .no_reaction = 1,
    .make = make,
    .free = release,
    .start = start,
    .advance = advance,
    .save = save,
    .accepts = accepts,
    .restore = restore,
};
