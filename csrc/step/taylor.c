/* The family taylor: the flow of the ODE on D by Taylor series that are compiled for the system.
 *
 * A piece is the polynomial of one series, and may be longer or shorter than the steps of a run,
 * whose states it gives.  The numbers y of series.h are compensated sums, so their roundoff does
 * not add up.  Pieces begin and end at times that are doubles. */
#include "dalembert/series.h"
#include "geometry/geometry.h"
#include "step/polynomials.h"
#include "step/scheme.h"
#include "step/taylor.h"

#include <math.h>
#include <string.h>

extern const dal_family dal__family_taylor;

static const dal_scheme records[] = {
    {.name = "taylor", .family = &dal__family_taylor,
     .help = "Taylor series of the ODE on D, for systems from expressions: best for accurate runs",
     .reference = "Jorba and Zou 2005"},
};

static const double TOLERANCE = 1e-15; /* where none is given */

/* The last coefficients are this power of the tolerance.  So the error of the state at t = 100 is
 * mostly below the tolerance.  With the default, 2e-19, the sum of 1e7 truncated terms is below the
 * roundoff of as many steps, and the energy walks at random. */
static const double POWER = 1.25;

/* The order for such coefficients, ln of whose inverse is size.  With the order k = size a step is
 * 1/e of the radius of convergence: the optimum if the time of a step grows linearly with its
 * order.  Measured on the problems of benchmarks/peers for errors from 1e-6 to 1e-12, 0.9 to 1.1 of
 * that take the same time.  At high orders large terms that cancel would cost digits, so that steps
 * become a little shorter: at order 32 they are a quarter of the radius. */
static size_t order_for(double size)
{
    enum { LEAST = 6, MOST = DAL_SERIES_MOST };
    const double order = ceil(size * (1.1 - size / 120.0));
    return order < LEAST ? LEAST : order > MOST ? MOST : (size_t)order;
}

/* Each piece is examined at its end: whether its polynomial solves the ODE there.  Series do not
 * see beyond a branch point where a function is finite, nor pulses as those of cos(t)^100.  Systems
 * that have such are examined at so many places inside each piece too. */
enum { INSIDE = 15 };

/* A piece is at least 1/FAR of the unit of its coefficients; if not, the unit becomes smaller. */
enum { FAR = 64 };

/* The most units of a piece.  Only last coefficients that are nearly zero would allow more.  In
 * doubt pieces grow more slowly. */
static const double LONGEST = 8.0, LONGEST_IN_DOUBT = 2.0;

/* The slopes may differ by the root of the tolerance, relative to their size, or by this. */
static const double LEAST_ALLOWED = 1e-10;

/* Pivots of C below so many times the tolerance may be errors of the steps, as in flow.c. */
static const double PER_TOLERANCE = 10.0;

/* At the start, and after so many pieces, the acceleration is compared with that of the
 * multipliers.  The run ends if the square of their difference is above ALLOWED_LOSS, and above
 * DOUBT times the square of the change of the multipliers' where x moves by MOVED of itself and of
 * its change in the piece. */
enum { CHECKED = 64 };
static const double ALLOWED_LOSS = 1e-12, DOUBT = 1e4, MOVED = 0x1p-44;

/* A switch that has been crossed stays so for this many roundings of t. */
static const double NEAR = 64.0;

/* Coefficients below this order are divided exactly, if the tolerance is so fine that the bias of
 * a rounded 1/k would be seen.  With 10 the energy of the problems of benchmarks/peers is off by
 * some 1e-13 at t = 1e6; with 16 and 24 it is no better. */
enum { EXACT = 10 };
static const double EXACT_BELOW = 1e-12;

typedef struct taylor {
    const dal_series *series;
    size_t n, states, width, order, inputs, exact;
    double tolerance, log_tolerance; /* of the coefficients; its binary logarithm */
    double allowed_slope;
    double t, end;           /* the times where the piece begins and ends */
    double unit;             /* that of the coefficients; 0: not known */
    double last_length;      /* of the piece before; 0: there was none */
    double next_unit;        /* of the coefficients after this piece, if they are known; or 0 */
    double before;           /* the length of the piece before; 0: none */
    bool shrinks;            /* it was shorter than the one before it */
    size_t pieces;           /* made */
    double *y, *low;         /* [width] where the piece begins; the part below the last digit */
    double *row, *row_low;   /* [width] the same at the state that was given last */
    double *change, *slope;  /* [width] */
    double *from, *from_low; /* [width] */
    double *some, *some_low; /* [width] of a state that is asked for */
    double *x, row_t;        /* [2n] that state, and its time */
    double *input;           /* [inputs] of the piece */
    double *side, *crossed;  /* [switches] of series.h; the order of their zeros at t, 0 for none */
    double *none;            /* [switches] zeros */
    size_t switched;         /* the switch at which the piece ends, or the number of switches */
    double *coefficients, *next, *work; /* aligned */
    double *saved;           /* the state before several motions were led on */
    double *probe;           /* [5n] */
    bool going;              /* the piece leads on from x, */
    bool stale;              /* but its coefficients are not those of y */
    bool fresh;              /* x is that of a saved state, and not known yet */
    dal__watch watch;
    arena arena;
} taylor;

enum { FOUR = 4 }; /* motions of expand_four */

/* ---- saved states ------------------------------------------------------------------------ */

static size_t save(const void *method, double *values)
{
    const taylor *const self = method;
    const double *const numbers[] = {&self->tolerance, &self->unit, &self->t, &self->end,
                                     &self->row_t, &self->last_length};
    const double *const states[] = {self->y, self->low, self->row, self->row_low};
    const size_t inputs = self->inputs, switches = self->series->switches;
    for (size_t i = 0; values && i < DAL_LENGTH(numbers); i++) *values++ = *numbers[i];
    for (size_t i = 0; values && i < DAL_LENGTH(states); i++, values += self->states)
        memcpy(values, states[i], self->states * sizeof *values);
    if (values) {
        if (inputs > 0) memcpy(values, self->input, inputs * sizeof *values);
        values += inputs;
        for (size_t i = 0; i < switches; i++) {
            *values++ = self->side[i];
            *values++ = self->crossed[i];
        }
        values[0] = (double)self->switched;
        values[1] = self->going;
    }
    return DAL_LENGTH(numbers) + DAL_LENGTH(states) * self->states + inputs + 2 * switches + 2;
}

static int accepts(const void *method, const double *values)
{
    const taylor *const self = method;
    const double *const last = values + save(self, NULL) - 2;
    return values[0] == self->tolerance && values[1] >= 0.0
        && (last[1] == 0.0 || (last[1] == 1.0 && values[1] > 0.0))
        && last[0] >= 0.0 && last[0] <= (double)self->series->switches;
}

static void restore(void *method, const double *values)
{
    taylor *const self = method;
    double *const numbers[] = {&self->unit, &self->t, &self->end, &self->row_t,
                               &self->last_length};
    double *const states[] = {self->y, self->low, self->row, self->row_low};
    values++; /* the tolerance */
    for (size_t i = 0; i < DAL_LENGTH(numbers); i++) *numbers[i] = *values++;
    for (size_t i = 0; i < DAL_LENGTH(states); i++, values += self->states)
        memcpy(states[i], values, self->states * sizeof *values);
    const size_t inputs = self->inputs, switches = self->series->switches;
    if (inputs > 0) memcpy(self->input, values, inputs * sizeof *values);
    values += inputs;
    for (size_t i = 0; i < switches; i++) {
        self->side[i] = *values++;
        self->crossed[i] = *values++;
    }
    self->switched = (size_t)values[0];
    self->next_unit = 0.0;
    self->going = self->stale = self->fresh = values[1] == 1.0;
}

/* ---- making ------------------------------------------------------------------------------ */

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_taylor_scheme none = {0}, *const data = motion->scheme->data;
    const double asked = data ? data->tolerance : none.tolerance;
    const double tolerance = asked != 0.0 ? asked : TOLERANCE;
    const dal_system_def *const def = &motion->system->def;
    const dal_series *const series = def->series;
    int status = dal__scheme_check_plain(motion->scheme, "taylor", error);
    if (status) return status;
    if (!(tolerance >= 2.0 * DBL_EPSILON && tolerance <= 0.1))
        return dal__fail(error, DAL_EINVAL, "tolerance = %g: expected a number from %.3g to 0.1, "
                         "or 0 for %g", tolerance, 2.0 * DBL_EPSILON, TOLERANCE);
    if (!series)
        return dal__fail(error, DAL_EUNSUPPORTED, "the system \"%s\" has no Taylor series, which "
                         "come from its expressions; choose the scheme \"reference\"", def->name);
    taylor shape = {.series = series, .n = def->n, .states = series->states,
                    .width = series->width, .inputs = def->inputs,
                    .tolerance = pow(tolerance, POWER)}, *self;
    shape.log_tolerance = log2(shape.tolerance);
    shape.allowed_slope = fmax(sqrt(shape.tolerance), LEAST_ALLOWED);
    shape.order = order_for(-log(shape.tolerance));
    if (series->abi != DAL_SERIES_ABI)
        return dal__fail(error, DAL_EINVAL, "series: number %u, expected %u; compile the system "
                         "with this version of series.h", series->abi, DAL_SERIES_ABI);
    if (shape.tolerance < EXACT_BELOW) shape.exact = EXACT;
    const size_t rows = shape.order + 1;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    DAL__RESERVE(&memory, shape.width, &shape.y, &shape.low, &shape.row, &shape.row_low,
                 &shape.from, &shape.from_low, &shape.some, &shape.some_low);
    DAL__RESERVE(&memory, shape.width, &shape.change, &shape.slope);
    DAL__RESERVE(&memory, 2 * def->n, &shape.x);
    DAL__RESERVE(&memory, 5 * def->n, &shape.probe);
    DAL__RESERVE(&memory, def->inputs, &shape.input);
    DAL__RESERVE(&memory, series->switches, &shape.side, &shape.crossed, &shape.none);
    DAL__RESERVE(&memory, rows * shape.width, &shape.coefficients, &shape.next);
    const size_t several = series->expand_four ? FOUR : 1;
    DAL__RESERVE(&memory, several * rows * series->room, &shape.work);
    DAL__RESERVE(&memory, save(&shape, NULL), &shape.saved);
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    motion->guards->allowed = PER_TOLERANCE * tolerance;
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
    self->unit = self->last_length = self->next_unit = self->before = 0.0;
    self->shrinks = false;
    self->pieces = 0;
}

/* ---- a piece ----------------------------------------------------------------------------- */

static dal__piece piece_of(const taylor *self)
{
    return (dal__piece){.series = self->series, .order = self->order, .t = self->t,
                        .end = self->end, .unit = self->unit,
                        .tolerance = self->tolerance,
                        .log_tolerance = self->log_tolerance, .y = self->y, .low = self->low,
                        .coefficients = self->coefficients, .input = self->input,
                        .side = self->side, .crossed = self->crossed};
}

/* The state at s units of the piece: y[width] and its low part. */
static void state_at(taylor *self, double s, double *y, double *low)
{
    const dal__piece piece = piece_of(self);
    dal__numbers_at(&piece, s, y, low, self->change);
}


/* The coefficients of a state up to an order. */
static void expand(taylor *self, const dal_motion *motion, double t, double unit, const double *y,
                   const double *low, size_t order, double *coefficients)
{
    const dal_series_at at = {.t = t, .unit = unit, .exact = self->exact, .y = y,
                              .low = low, .u = self->input, .side = self->side,
                              .crossed = t == self->t ? self->crossed : self->none};
    self->series->expand(&at, order, coefficients, self->work, motion->system->def.ctx);
    motion->stats->evaluations++;
}

/* Those of the piece. */
static void expand_here(taylor *self, const dal_motion *motion)
{
    if (self->next_unit > 0.0) {
        double *const known = self->next;
        self->next = self->coefficients;
        self->coefficients = known;
        self->next_unit = 0.0;
    } else {
        expand(self, motion, self->t, self->unit, self->y, self->low, self->order,
               self->coefficients);
    }
}

/* How long the piece may be, in units. */
static double allowed_units(const taylor *self)
{
    double decay[DAL_SERIES_LAST];
    self->series->decay(self->order, self->coefficients, decay);
    return dal__units_of(decay, self->order, self->log_tolerance);
}

/* After t there is no piece, however short. */
static int fail_to_go_on(taylor *self, dal_motion *motion, double length)
{
    return dal__fail(motion->error, DAL_ENOCONV, "the step size collapsed to %.1e at t = %.17g, "
                     "where a function is not analytic, or the motion comes to an end; the scheme "
                     "\"reference\" needs no series", length, self->t);
}

/* Either side of a switch leads back to the other. */
static int fail_to_slide(taylor *self, dal_motion *motion)
{
    return dal__fail(motion->error, DAL_ENOCONV, "at t = %.17g the force jumps so that either side "
                     "of the jump leads back to it. For dry friction use a smooth law, such as "
                     "tanh(v/eps) for sign(v), or switch between two systems at a terminal event",
                     self->t);
}

static int fail_not_finite(taylor *self, dal_motion *motion)
{
    dal_mechanics *const mech = motion->mechanics;
    const double t = self->t;
    memcpy(mech->point, self->y, self->n * sizeof(double));
    self->series->velocity(t, self->y, self->input, mech->point + self->n,
                           motion->system->def.ctx);
    for (size_t i = 0; i < 2 * self->n; i++)
        if (!isfinite(mech->point[i]))
            return dal__fail(motion->error, DAL_EDOMAIN, "the motion leaves the range of numbers "
                             "after t = %.17g", t);
    const int status = dal__field(mech, t, mech->point, self->slope);
    if (status) return status;
    return dal__fail(motion->error, DAL_EDOMAIN, "the Taylor series are not finite at t = %.17g, "
                     "where a function is not analytic, or the motion comes to an end; the scheme "
                     "\"reference\" needs no series", t);
}

/* The coefficients at y, in a unit that suits them; *units <- what allowed_units says. */
static int expand_piece(taylor *self, dal_motion *motion, double *units)
{
    enum { TRIES = 80 };
    for (int k = 0; k < TRIES; k++) {
        expand_here(self, motion);
        *units = allowed_units(self);
        if (*units >= 1.0 / FAR) return DAL_SUCCESS; /* long pieces grow one after the other */
        const double factor = isnan(*units) ? 0x1p-32 : dal__power_of_2(*units);
        const double unit = self->unit * factor;
        if (!(unit > DBL_MIN && unit < DBL_MAX)) break;
        self->unit = unit;
    }
    return fail_not_finite(self, motion);
}

/* ---- switches ---------------------------------------------------------------------------- */

static const double *switch_at(const taylor *self, size_t i)
{
    return self->coefficients + self->states + i;
}

static double direction_of(const dal_motion *motion) { return motion->h > 0.0 ? 1.0 : -1.0; }

/* side and crossed of a switch: its sign at the beginning of the piece, or right after it. */
static void find_side(taylor *self, size_t i, double direction)
{
    const double *const g = switch_at(self, i);
    double ahead = 1.0;
    self->side[i] = self->crossed[i] = 0.0;
    for (size_t k = 0; k < self->order; k++, ahead *= direction)
        if (g[k * self->width] != 0.0) {
            self->side[i] = copysign(1.0, ahead * g[k * self->width]);
            self->crossed[i] = (double)k;
            return;
        }
}

/* The coefficients with the sides that belong to them, where a side is 0 as not known yet. */
static int expand_on_sides(taylor *self, dal_motion *motion, double *units)
{
    const size_t switches = self->series->switches;
    for (size_t pass = 0; pass <= 2 * switches + 1; pass++) {
        bool changed = false;
        const int status = expand_piece(self, motion, units);
        if (status) return status;
        for (size_t i = 0; i < switches; i++) {
            if (self->side[i] != 0.0) continue;
            find_side(self, i, direction_of(motion));
            changed = changed || self->side[i] != 0.0;
        }
        if (!changed) return DAL_SUCCESS;
    }
    return DAL_SUCCESS;
}

static dal__columns columns_of(const taylor *self, double direction)
{
    return (dal__columns){.first = self->coefficients, .next = self->width, .order = self->order,
                          .direction = direction};
}

/* Shortens the piece, of so many units, to the first change of a switch. */
static double until_switch(taylor *self, double direction, double units)
{
    const dal__columns of = columns_of(self, direction);
    self->switched = self->series->switches;
    for (size_t i = 0; i < self->series->switches; i++) {
        const double change = dal__until_change(&of, self->states + i, self->side[i],
                                                (size_t)self->crossed[i], units);
        if (change < units) self->switched = i, units = change;
    }
    return units;
}

/* Shortens the piece to where the argument of an exponential has grown too much. */
static double until_rise(const taylor *self, double direction, double units)
{
    const dal__columns of = columns_of(self, direction);
    const size_t first = self->states + self->series->switches;
    for (size_t i = 0; i < self->series->exponents; i++)
        units = dal__until_rise(&of, first + i, units);
    return units;
}

/* The switch that is at most some roundings of t ahead, if no step is short enough to lead there,
 * as near the end of a root. */
static size_t switch_at_hand(const taylor *self, double direction)
{
    const double most = 16.0 * fabs(nextafter(self->t, HUGE_VAL) - self->t) / self->unit;
    for (size_t i = 0; i < self->series->switches; i++) {
        const double *const g = switch_at(self, i);
        const double slope = direction * g[self->width];
        if (self->crossed[i] == 0.0 && self->side[i] * slope < 0.0
            && fabs(g[0]) <= most * fabs(slope)) return i;
    }
    return self->series->switches;
}

/* Whether the slope of a state at s units is its rate there, but for roundoff of the state. */
static bool is_slope(const taylor *self, size_t i, double s, double rate)
{
    const double difference = fabs(self->slope[i] - rate);
    double size = fabs(rate);
    for (size_t k = 1; k <= 3; k++) {
        const double other = fabs(self->coefficients[k * self->width + i]);
        if (other > size) size = other;
    }
    if (!isfinite(difference) || !isfinite(size)) return false;
    if (difference <= self->allowed_slope * size) return true;
    const bool is_q = i < self->n;
    const double largest = is_q ? dal__largest(self->n, self->y)
                                : dal__largest(self->states - self->n, self->y + self->n);
    return difference * fabs(s) <= DAL_ROUNDOFF * (double)self->order * largest;
}

/* self->from <- the state at a time in the piece.  Returns false if it is not finite. */
static bool look_at(taylor *self, double t)
{
    state_at(self, (t - self->t) / self->unit, self->from, self->from_low);
    return dal__all_finite(self->states, self->from);
}

/* Whether the polynomial of the piece solves the ODE at a time in it, where self->next has the
 * coefficients in a unit. */
static bool has_slopes(taylor *self, double t, double unit)
{
    const double s = (t - self->t) / self->unit, ratio = self->unit / unit;
    self->series->slope(self->order, s, self->coefficients, self->slope);
    for (size_t i = 0; i < self->states; i++)
        if (!is_slope(self, i, s, ratio * self->next[self->width + i])) return false;
    return true;
}

/* The same, with self->from <- the state there, self->next <- its coefficients up to an order. */
static bool solves_at(taylor *self, const dal_motion *motion, double t, double unit, size_t order)
{
    if (!look_at(self, t)) return false;
    expand(self, motion, t, unit, self->from, self->from_low, order, self->next);
    return has_slopes(self, t, unit);
}

/* Whether the polynomial may not be that of the motion, though it is so at its end: powers have no
 * series where a switch is zero. */
static bool is_in_doubt(const taylor *self)
{
    bool found = self->series->is_doubtful;
    for (size_t i = 0; i < self->series->switches; i++) found = found || self->crossed[i] != 0.0;
    return found;
}

/* The same at places inside the piece, if there is doubt. */
static bool solves_inside(taylor *self, const dal_motion *motion)
{
    const bool in_doubt = is_in_doubt(self);
    for (int k = 1; in_doubt && k <= INSIDE; k++) {
        const double part = (double)k / (INSIDE + 1.0);
        const double t = self->t + part * (self->end - self->t);
        if (!solves_at(self, motion, t, self->unit, 1)) return false;
    }
    return true;
}

/* The unit of the coefficients after a piece that had room for a length. */
static double unit_after(const taylor *self, double length)
{
    const double relative = length / self->unit;
    return relative < 0.25 || relative >= 2.0 ? dal__power_of_2(length) : self->unit;
}

/* The same inside and at its end, where the next piece begins; the piece has room for a length. */
static bool solves(taylor *self, const dal_motion *motion, double room)
{
    const bool goes_on = self->switched == self->series->switches && self->series->in_D;
    const double unit = goes_on ? unit_after(self, room) : self->unit;
    if (!solves_inside(self, motion)
        || !solves_at(self, motion, self->end, unit, goes_on ? self->order : 1)) return false;
    if (goes_on) self->next_unit = unit;
    self->last_length = room;
    return true;
}

/* The length that the coefficients allow, or if the last ones are zero, a guess: that of the piece,
 * or their unit. */
static double room_for(const taylor *self, double units, double length)
{
    return units < HUGE_VAL ? units * self->unit : fmax(length, self->unit);
}

/* A number from 31/32 to 1, from the digits of t. */
static double at_random(double t)
{
    uint64_t bits;
    memcpy(&bits, &t, sizeof bits);
    return 1.0 - (double)(bits * 0x9e3779b97f4a7c15u >> 40) * 0x1p-29;
}

/* The most units of a piece; if *units is larger, it is infinite.  The lengths vary at random:
 * without, a periodic motion may have the same pieces in each period, and roundoff adds up. */
static double limit(const taylor *self, double *units)
{
    const double most = self->series->is_doubtful ? LONGEST_IN_DOUBT : LONGEST;
    if (*units <= most) return *units * at_random(self->t);
    *units = HUGE_VAL; /* its length says nothing of the scale of the motion */
    return most;
}

/* The time after a length.  Unless the piece is short or ends at a switch, it is a multiple of the
 * unit over 2^20.  So s at its end has few digits, and s^2 in sums is exact: if it were rounded to
 * one side the energy would drift. */
static double time_after(const taylor *self, double direction, double length)
{
    const double end = self->t + direction * length, grid = 0x1p-20 * self->unit;
    const double multiple = rint(end / grid);
    const bool is_free = self->switched == self->series->switches && length > 0x1p10 * grid;
    return is_free && isfinite(multiple) ? multiple * grid : end;
}

/* On the other side of the switch at which the piece ends.  Returns false if it has just been
 * crossed. */
static bool cross(taylor *self)
{
    const size_t i = self->switched;
    if (i == self->series->switches) return true;
    if (self->crossed[i] != 0.0) return false;
    self->crossed[i] = 1.0;
    self->side[i] *= -1.0;
    return true;
}

/* Shortens the piece of so many units, in a time of length, until its polynomial solves the ODE.
 * Returns false if then it leads nowhere. */
static bool shorten(taylor *self, const dal_motion *motion, double units, double length)
{
    enum { HALVINGS = 60 };
    for (int k = 0; k <= HALVINGS; k++, length *= 0.5) {
        self->end = time_after(self, direction_of(motion), length);
        if (self->end == self->t) return false;
        if (solves(self, motion, room_for(self, units, length))) return true;
        units = 0.5 * length / self->unit;
        self->switched = self->series->switches;
    }
    return false;
}

static int keep(taylor *self, dal_motion *motion)
{
    const dal__piece piece = piece_of(self);
    return motion->kept ? dal__polynomials_add(motion->kept, &piece, motion->error) : DAL_SUCCESS;
}

/* A piece from y. */
static int begin_piece(taylor *self, dal_motion *motion)
{
    const double direction = direction_of(motion);
    const size_t switches = self->series->switches;
    for (;;) {
        double units;
        const int status = expand_on_sides(self, motion, &units);
        if (status) return status;
        const double most = until_rise(self, direction, limit(self, &units));
        const double length = until_switch(self, direction, most) * self->unit;
        self->stale = false;
        if (shorten(self, motion, units, length)) return keep(self, motion);
        if (self->switched == switches) self->switched = switch_at_hand(self, direction);
        if (self->switched == switches) return fail_to_go_on(self, motion, length);
        if (!cross(self)) return fail_to_slide(self, motion);
    }
}

/* x[2n] <- y at a time, with the velocity in D to roundoff. */
static int find_state(taylor *self, dal_motion *motion, double t, const double *y, double *x)
{
    dal_mechanics *const mech = motion->mechanics;
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
    const int status = find_state(self, motion, self->t, self->y, self->x);
    for (size_t i = 0; !status && i < n; i++)
        if (self->x[n + i] != self->y[n + i]) {
            self->y[n + i] = self->x[n + i];
            self->low[n + i] = 0.0;
        }
    return status;
}

/* From a piece to the beginning of the next one. */
static int leave_piece(taylor *self, dal_motion *motion, double until)
{
    struct dal__guards *const guards = motion->guards;
    int status = dal__creep_check(&guards->creep, self->t, fabs(until - self->t), motion->error);
    if (!status) status = dal__ask(&self->watch, self->t, motion->error);
    if (status) return status;
    if (self->next_unit == 0.0)
        state_at(self, (self->end - self->t) / self->unit, self->from, self->from_low);
    memcpy(self->y, self->from, self->width * sizeof(double));
    memcpy(self->low, self->from_low, self->width * sizeof(double));
    const bool is_far = fabs(self->end - self->t) > NEAR * DAL_ROUNDOFF * fabs(self->end);
    self->t = self->end;
    for (size_t i = 0; is_far && i < self->series->switches; i++) self->crossed[i] = 0.0;
    if (!is_far) self->next_unit = 0.0;
    if (!cross(self)) return fail_to_slide(self, motion);
    self->unit = unit_after(self, self->last_length);
    return self->series->in_D ? DAL_SUCCESS : stay_in_D(self, motion);
}

/* The square of the size of a[n] in the metric. */
static double square(const dal_mechanics *mech, const double *a, double *product)
{
    double sum = 0.0;
    dal__weigh(mech, a, product);
    for (size_t i = 0; i < mech->n; i++) sum += a[i] * product[i];
    return sum;
}

/* *error <- the square of the difference between the acceleration by the multipliers at x, where
 * the piece begins, and that of the series; or, if again, and that by the multipliers near x.  It
 * is relative to the acceleration and to v over the length of a piece.  Returns false if it is not
 * finite, or there are no multipliers. */
static bool compare_acceleration(taylor *self, dal_motion *motion, bool again, double *error)
{
    dal_mechanics *const mech = motion->mechanics;
    const size_t n = self->n;
    const double *const Y = self->coefficients + 2 * self->width;
    const double units = allowed_units(self), length = room_for(self, units, self->unit);
    double *const a = self->probe, *const known = a + n, *const x = known + 2 * n;
    for (size_t i = 0; i < 2 * n; i++) x[i] = self->x[i];
    if (dal__field(mech, self->t, x, known) || dal__build_metric(mech, self->t, x, x + n))
        return false;
    const double size = square(mech, known + n, self->change);
    for (size_t i = 0; i < n; i++) a[i] = x[n + i] / length;
    const double whole = size + square(mech, a, self->change);
    for (size_t i = 0; i < 2 * n; i++) { /* known has the rates of x */
        const double way = fabs(x[i]) + length * fabs(known[i]);
        x[i] += (i % 2 == 0 ? MOVED : -MOVED) * way;
    }
    if (again && dal__field(mech, self->t, x, mech->point)) return false;
    for (size_t i = 0; i < n; i++)
        a[i] = known[n + i] - (again ? mech->point[n + i] : 2.0 * Y[i] / self->unit / self->unit);
    *error = square(mech, a, self->change) / whole;
    return isfinite(*error);
}

/* Compares the acceleration at x, where the piece begins, with that of the multipliers.  Formulas
 * that mix very different units may lose all digits.  At a jump of a force, and where roundoff
 * changes the acceleration of the multipliers as much, there is no verdict. */
static int check_acceleration(taylor *self, dal_motion *motion)
{
    double lost, unsure;
    for (size_t i = 0; i < self->series->switches; i++)
        if (self->crossed[i] != 0.0 || switch_at(self, i)[0] == 0.0) return DAL_SUCCESS;
    const bool is_lost = self->series->in_D
        && compare_acceleration(self, motion, false, &lost) && lost > ALLOWED_LOSS
        && compare_acceleration(self, motion, true, &unsure) && lost > DOUBT * unsure;
    *motion->error = (dal_error){0};
    if (!is_lost) return DAL_SUCCESS;
    return dal__fail(motion->error, DAL_EDOMAIN, "at t = %.17g roundoff of the equations on D is "
                     "%.1e of the acceleration: the units of coordinates are too far apart; choose "
                     "other units, or the scheme \"reference\"", self->t, sqrt(lost));
}

/* A look at the rank where pieces were short and become longer again, and at the acceleration now
 * and then. */
static int watch_piece(taylor *self, dal_motion *motion)
{
    struct dal__guards *const guards = motion->guards;
    const double length = fabs(self->end - self->t), before = self->before;
    const bool turns = self->shrinks && length > before;
    dal__creep_step(&guards->creep, self->t, length);
    self->shrinks = length < before;
    self->before = length;
    const bool is_due = ++self->pieces % CHECKED == 0;
    const bool looks = motion->system->def.m > 0 && turns
                    && dal__creep_is_short(&guards->creep, before);
    int status = DAL_SUCCESS;
    if (is_due || looks) status = find_state(self, motion, self->t, self->y, self->x);
    if (!status && is_due) status = check_acceleration(self, motion);
    if (status || !looks) return status;
    return dal__rank_look(&guards->rank, motion->mechanics, self->t, 0.0, guards->allowed, self->x);
}

/* After a piece: the one that follows on it. */
static int next_piece(taylor *self, dal_motion *motion, double until)
{
    int status = leave_piece(self, motion, until);
    if (!status) status = begin_piece(self, motion);
    return status ? status : watch_piece(self, motion);
}

/* ---- steps ------------------------------------------------------------------------------- */

/* Whether the last state that was given is that of the motion. */
static bool is_at(const taylor *self, const dal_motion *motion, double t)
{
    return self->going && self->row_t == t
        && memcmp(self->x, motion->x, 2 * self->n * sizeof(double)) == 0;
}

/* The first piece, from x at t. */
static int begin(taylor *self, dal_motion *motion, double t)
{
    const size_t n = self->n, size = self->width * sizeof(double);
    const bool same = is_at(self, motion, t);
    memset(self->low, 0, size);
    if (same) memcpy(self->low, self->row_low, size);
    if (same) memcpy(self->y, self->row, size);
    else memcpy(self->y, motion->x, n * sizeof(double));
    if (self->inputs > 0) memcpy(self->input, motion->input, self->inputs * sizeof(double));
    if (!same)
        self->series->quasi(t, motion->x, self->input, self->y + n, motion->system->def.ctx);
    self->t = self->row_t = t;
    self->last_length = self->next_unit = 0.0;
    for (size_t i = 0; i < self->series->switches; i++) self->side[i] = self->crossed[i] = 0.0;
    if (self->unit == 0.0) self->unit = dal__power_of_2(fabs(motion->h));
    memcpy(self->x, motion->x, 2 * n * sizeof(double));
    memcpy(self->row, self->y, size);
    memcpy(self->row_low, self->low, size);
    const int status = begin_piece(self, motion);
    return status ? status : check_acceleration(self, motion);
}

/* A piece that leads on from where the motion is, at t. */
static int follow(taylor *self, dal_motion *motion, double t)
{
    int status = DAL_SUCCESS;
    if (self->watch.function != motion->watch || self->watch.ctx != motion->watch_ctx)
        self->watch = (dal__watch){.function = motion->watch, .ctx = motion->watch_ctx};
    if (self->fresh) memcpy(self->x, motion->x, 2 * self->n * sizeof(double));
    self->fresh = false;
    const bool same_inputs = self->inputs == 0
        || memcmp(self->input, motion->input, self->inputs * sizeof(double)) == 0;
    if (!is_at(self, motion, t) || !same_inputs) status = begin(self, motion, t);
    else if (self->stale) expand_here(self, motion);
    self->stale = false;
    self->going = !status;
    return status;
}

/* Whether t is in the piece. */
static bool has_reached(const taylor *self, const dal_motion *motion, double t)
{
    return direction_of(motion) * (t - self->end) <= 0.0;
}

/* The state at t, which is in the piece. */
static int give_state(taylor *self, dal_motion *motion, double t)
{
    state_at(self, (t - self->t) / self->unit, self->row, self->row_low);
    const int status = find_state(self, motion, t, self->row, self->x);
    self->row_t = t;
    self->going = !status;
    if (!status) memcpy(motion->x, self->x, 2 * self->n * sizeof(double));
    return status;
}

/* The state at t. */
static int reach(taylor *self, dal_motion *motion, double t)
{
    int status = DAL_SUCCESS;
    while (!status && !has_reached(self, motion, t)) status = next_piece(self, motion, t);
    if (!status) return give_state(self, motion, t);
    self->going = false;
    return status;
}

static double time_of(const dal_motion *motion, size_t steps)
{
    return motion->t0 + (double)(motion->steps - motion->first + steps) * motion->h;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    int status = follow(method, motion, time_of(motion, 0));
    for (*done = 0; !status && *done < steps; *done += !status)
        status = reach(method, motion, time_of(motion, *done + 1));
    return status;
}

static int own_end(void *method, dal_motion *motion, double until, double *end)
{
    taylor *const self = method;
    int status = follow(self, motion, time_of(motion, 0));
    const bool is_there = direction_of(motion) * (self->end - self->row_t) <= 0.0;
    if (!status && is_there) status = next_piece(self, motion, until);
    *end = self->end;
    self->going = !status;
    return status;
}

int dal_system_has_series(const dal_system *system)
{
    const dal_series *const series = system->def.series;
    return !series ? 0 : series->expand_four ? 2 : 1;
}

/* ---- pieces ------------------------------------------------------------------------------ */

bool dal__taylor_has_pieces(const dal_stepper *stepper)
{
    return stepper->family == &dal__family_taylor;
}

static dal__piece piece_with(const taylor *self, const dal_motion *motion)
{
    dal__piece piece = piece_of(self);
    piece.parameters = motion->system->def.ctx;
    return piece;
}

bool dal__taylor_piece(const dal_stepper *stepper, double from, dal__piece *piece)
{
    const taylor *const self = stepper->method;
    if (!dal__taylor_has_pieces(stepper) || !self->going || self->stale) return false;
    *piece = piece_with(self, &stepper->motion);
    return direction_of(&stepper->motion) * (from - self->t) >= 0.0;
}

int dal__taylor_state(dal_stepper *stepper, const dal__piece *piece, double t, double *x)
{
    taylor *const self = stepper->method;
    if (self->inputs > 0) memcpy(self->input, piece->input, self->inputs * sizeof(double));
    dal__numbers_at(piece, (t - piece->t) / piece->unit, self->some, self->some_low, self->change);
    const int status = find_state(self, &stepper->motion, t, self->some, x);
    if (status) stepper->error = *stepper->motion.error;
    return status;
}

int dal__taylor_visit(dal_stepper *stepper, double until, dal__visit_fn visit, void *ctx)
{
    taylor *const self = stepper->method;
    dal_motion *const motion = &stepper->motion;
    double from = time_of(motion, 0);
    *motion->error = (dal_error){0};
    int status = follow(self, motion, from);
    while (!status) {
        const dal__piece piece = piece_with(self, motion);
        const bool is_last = has_reached(self, motion, until);
        status = visit(&piece, from, is_last ? until : piece.end, ctx);
        if (status || is_last) break;
        from = piece.end;
        status = next_piece(self, motion, until);
    }
    self->going = false;
    stepper->error = *motion->error;
    return status;
}

/* ---- several motions ---------------------------------------------------------------------- */

bool dal__taylor_has_four(const dal_stepper *stepper)
{
    const taylor *const self = stepper->method;
    return stepper->family == &dal__family_taylor && self->series->expand_four;
}

/* Begins the next piece up to where the coefficients at its end have to be known.  Returns false if
 * begin_piece has to do more. */
static bool plan_piece(dal__side *side)
{
    taylor *const self = side->stepper->method;
    const dal_motion *const motion = &side->stepper->motion;
    if (self->next_unit == 0.0) return false;
    expand_here(self, motion);
    double units = allowed_units(self);
    if (!(units >= 1.0 / FAR)) return false;
    const double most = until_rise(self, direction_of(motion), limit(self, &units));
    const double length = most * self->unit;
    side->room = room_for(self, units, length);
    self->end = time_after(self, direction_of(motion), length);
    return self->end != self->t && solves_inside(self, motion) && look_at(self, self->end);
}

/* The coefficients at the ends of some pieces that are planned; their examination. */
static void examine(dal__side *const *side, size_t count)
{
    dal_series_at at[FOUR];
    const dal_series_at *of[FOUR];
    const void *parameters[FOUR];
    double *next[FOUR];
    const taylor *const first = side[0]->stepper->method;
    for (size_t i = 0; i < FOUR; i++) { /* empty places compute what the first one does */
        const dal__side *const one = side[i < count ? i : 0];
        const taylor *const self = one->stepper->method;
        at[i] = (dal_series_at){.t = self->end, .unit = unit_after(self, one->room),
                                .exact = self->exact, .y = self->from, .low = self->from_low,
                                .u = self->input, .side = self->side, .crossed = self->none};
        of[i] = &at[i];
        next[i] = self->next;
        parameters[i] = one->stepper->motion.system->def.ctx;
    }
    if (count > 2)
        first->series->expand_four(of, first->order, next, first->work, parameters);
    for (size_t i = 0; i < count; i++) {
        taylor *const self = side[i]->stepper->method;
        dal_motion *const motion = &side[i]->stepper->motion;
        if (count <= 2)
            self->series->expand(of[i], self->order, next[i], self->work, parameters[i]);
        motion->stats->evaluations++;
        int status = DAL_SUCCESS;
        if (has_slopes(self, self->end, at[i].unit)) {
            self->next_unit = at[i].unit;
            self->last_length = side[i]->room;
        } else {
            status = begin_piece(self, motion);
        }
        side[i]->status = status ? status : watch_piece(self, motion);
    }
}

/* Leads one of the motions on, if it is not where it is to go.  Returns whether it did. */
static bool goes_on(dal__side *side, bool *is_planned)
{
    taylor *const self = side->stepper->method;
    dal_motion *const motion = &side->stepper->motion;
    const double t = time_of(motion, side->steps);
    *is_planned = false;
    if (side->status || side->made) return false;
    if (has_reached(self, motion, t)) {
        side->status = give_state(self, motion, t);
        side->made = true;
        return false;
    }
    side->status = leave_piece(self, motion, t);
    if (side->status) return false;
    *is_planned = plan_piece(side);
    if (*is_planned) return true;
    side->status = begin_piece(self, motion);
    if (!side->status) side->status = watch_piece(self, motion);
    return true;
}

void dal__taylor_advance(dal__side *sides, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        dal_stepper *const stepper = sides[i].stepper;
        taylor *const self = stepper->method;
        save(self, self->saved);
        sides[i].made = sides[i].steps == 0;
        sides[i].status = sides[i].made ? DAL_SUCCESS
            : follow(self, &stepper->motion, time_of(&stepper->motion, 0));
    }
    for (bool going = true; going;) {
        dal__side *planned[FOUR];
        size_t number = 0;
        going = false;
        for (size_t i = 0; i < count; i++) {
            bool is_planned;
            if (goes_on(&sides[i], &is_planned)) going = true;
            if (is_planned) planned[number++] = &sides[i];
            if (number == FOUR) examine(planned, number), number = 0;
        }
        if (number > 0) examine(planned, number);
    }
    for (size_t i = 0; i < count; i++) {
        taylor *const self = sides[i].stepper->method;
        if (sides[i].status) restore(self, self->saved); /* from there it goes on alone */
        else sides[i].stepper->motion.steps += sides[i].steps;
    }
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
    .own_end = own_end,
    .save = save,
    .accepts = accepts,
    .restore = restore,
};
