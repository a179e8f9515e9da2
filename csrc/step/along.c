/* A function of the state along a piece of a motion.
 *
 * The coefficients of the state are those of a piece; those of g follow from them.  Where they lead
 * less far than the piece does, the polynomials are written about another time. */
#include "step/along.h"

#include <stdlib.h>

/* The most units of a part; only last coefficients that are nearly zero would allow more. */
static const double LONGEST = 8.0, LONGEST_IN_DOUBT = 2.0;

/* A part is at least 1/FAR of the unit of its coefficients; if not, the unit becomes smaller. */
static const double FAR = 64.0;

/* The series of g is compared with g at the end of each part, and in doubt at so many places inside
 * it.  They may differ by this part of the sum of the terms; and by UNSURE times what g changes by
 * where the state and the time are rounded. */
enum { INSIDE = 15 };
static const double BEFORE_SWITCH = 1.0 - 0x1p-20; /* where g may jump */
static const double ALLOWED = 1e-8, UNSURE = 100.0, ROUNDED = 0x1p-50;

/* Times of one zero differ by no more, in parts of the part before. */
static const double SAME_TIME = 1e-9;

static const double NONE = -1.0; /* no value is as near to zero as that */

/* Parts that are shorter, in parts of the piece, lead to where g has no series. */
static const double GAP = 0x1p-30, WIDEST_GAP = 0x1p-10;

struct dal__along {
    const dal_event *event;
    const dal_event_series *series;
    size_t n, width;                /* the width of the states */
    double *y, *low, *change, *x;   /* [width], [width], [width], [2n] */
    double *about, *coefficients, *work;
    double *side, *crossed;         /* [switches], as those of a motion */
    double unit, next_unit;         /* of the coefficients, and of those of the next part */
    size_t at_switch;               /* at which the part ends, or the number of switches */
    dal__found found;
    double zero_since;              /* the time since which g is zero, or NaN */
    double length;                  /* of the part before, */
    bool ends;                      /* which ends with zero */
    double *t;                      /* [room] */
    size_t room;
    arena arena;
};

int dal__along_new(dal__along **self, const dal_event *event, const dal_series *series, size_t n,
                   dal_error *error)
{
    const dal_event_series *const of = event->series;
    const size_t rows = DAL_SERIES_MOST + 1;
    if (of->abi != DAL_SERIES_ABI || of->states != series->states || of->functions != 1)
        return dal__fail(error, DAL_EINVAL, "the series of the event are of number %u, for %zu "
                         "states, of %zu functions: expected number %u, %zu states, 1 function; "
                         "compile the event with this version of series.h, for the system of the "
                         "run", of->abi, of->states, of->functions, DAL_SERIES_ABI,
                         series->states);
    dal__along shape = {.event = event, .series = of, .n = n, .width = series->width}, *made;
    arena memory = {0};
    dal__reserve(&memory, &made, 1, sizeof *made);
    DAL__RESERVE(&memory, shape.width, &shape.y, &shape.low, &shape.change);
    DAL__RESERVE(&memory, 2 * n, &shape.x);
    DAL__RESERVE(&memory, rows * shape.width, &shape.about);
    DAL__RESERVE(&memory, rows * of->width, &shape.coefficients);
    DAL__RESERVE(&memory, rows * of->room, &shape.work);
    DAL__RESERVE(&memory, of->switches, &shape.side, &shape.crossed);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    *made = shape;
    made->arena = memory;
    *self = made;
    return DAL_SUCCESS;
}

void dal__along_free(dal__along *self)
{
    if (!self) return;
    free(self->t);
    dal__release(&self->arena);
}

dal__found dal__along_found(const dal__along *self)
{
    dal__found found = self->found;
    found.zero_since = self->zero_since;
    return found;
}

/* ---- coefficients ------------------------------------------------------------------------ */

static void expand(dal__along *self, const dal__piece *piece, double t)
{
    const double s = (t - piece->t) / piece->unit;
    const bool is_same = s == 0.0 && self->unit == piece->unit;
    const dal_series_at at = {.t = t, .unit = self->unit, .y = self->y, .low = self->low,
                              .u = piece->input, .side = self->side, .crossed = self->crossed};
    dal__numbers_at(piece, s, self->y, self->low, self->change);
    if (!is_same) dal__write_about(piece, s, self->unit, self->about);
    self->series->expand(&at, piece->order, is_same ? piece->coefficients : self->about,
                         self->width, self->coefficients, self->work, self->event->ctx);
}

/* The sides of switches that are not known: their signs at t, or right after it.  Returns whether
 * all were known. */
static bool find_sides(dal__along *self, size_t order, double direction)
{
    bool known = true;
    for (size_t i = 0; i < self->series->switches; i++) {
        const double *const g = self->coefficients + self->series->functions + i;
        double ahead = 1.0;
        for (size_t k = 0; self->side[i] == 0.0 && k < order; k++, ahead *= direction) {
            const double one = g[k * self->series->width];
            if (one == 0.0) continue;
            self->side[i] = copysign(1.0, ahead * one);
            self->crossed[i] = (double)k;
            known = false;
        }
    }
    return known;
}

/* The coefficients at t, in a unit that suits them; returns how many units they lead to, 0 if there
 * are none. */
static double expand_at(dal__along *self, const dal__piece *piece, double t, double direction)
{
    enum { TRIES = 40 };
    double decay[DAL_SERIES_LAST];
    for (size_t k = 0; k < TRIES + 2 * self->series->switches; k++) {
        expand(self, piece, t);
        self->series->decay(piece->order, self->coefficients, decay);
        const double units = dal__units_of(decay, piece->order, piece->log_tolerance);
        if (units >= 1.0 / FAR) {
            if (find_sides(self, piece->order, direction)) return units;
        } else {
            self->unit *= isnan(units) ? 0x1p-16 : dal__power_of_2(units);
            if (!(self->unit > DBL_MIN)) return 0.0;
        }
    }
    return 0.0;
}

/* ---- the value of g ---------------------------------------------------------------------- */

/* *g <- the function at s units of the piece; rounded: of numbers that are moved by roundoff. */
static bool value_at(dal__along *self, const dal__piece *piece, double s, double rounded,
                     double *g)
{
    const double t = (piece->t + s * piece->unit) * (1.0 + rounded);
    double *const x = self->x;
    dal__numbers_at(piece, s, self->y, self->low, self->change);
    memcpy(x, self->y, self->n * sizeof *x);
    piece->series->velocity(t, self->y, piece->input, x + self->n, piece->parameters);
    for (size_t i = 0; i < 2 * self->n; i++) x[i] *= 1.0 + (i % 2 == 0 ? rounded : -rounded);
    *g = (double)NAN;
    return self->event->g(t, x, g, self->event->ctx) == 0 && isfinite(*g);
}

/* Whether the series of g about t gives its value at a distance of so many of its units. */
static bool is_value(dal__along *self, const dal__piece *piece, double t, double units)
{
    const double s = (t - piece->t + units * self->unit) / piece->unit;
    const double *const G = self->coefficients;
    double sum = 0.0, size = 0.0, value, moved;
    for (size_t k = piece->order + 1; k-- > 0;) {
        sum = sum * units + G[k * self->series->width];
        size = size * fabs(units) + fabs(G[k * self->series->width]);
    }
    if (!isfinite(sum) || !value_at(self, piece, s, 0.0, &value)) return false;
    const double difference = fabs(sum - value);
    if (difference <= fmax(ALLOWED, sqrt(piece->tolerance)) * size) return true;
    return value_at(self, piece, s, ROUNDED, &moved)
        && difference <= UNSURE * fabs(moved - value);
}

static bool has_values(dal__along *self, const dal__piece *piece, double t, double units)
{
    const bool is_switch = self->at_switch < self->series->switches;
    for (int k = 1; self->series->is_doubtful && k <= INSIDE; k++)
        if (!is_value(self, piece, t, units * k / (INSIDE + 1.0))) return false;
    return is_value(self, piece, t, is_switch ? units * BEFORE_SWITCH : units);
}

/* ---- parts of the piece ------------------------------------------------------------------ */

/* How many units the part from t has, at most those given; 0 if g has no series there, or they lead
 * less far than `least`. */
static double limit(dal__along *self, const dal__piece *piece, double t, double direction,
                    double most, double least)
{
    const dal_event_series *const of = self->series;
    double units = expand_at(self, piece, t, direction);
    const double allowed = fmin(units * self->unit, piece->unit);
    self->next_unit = allowed < piece->unit && allowed > 0.0 ? dal__power_of_2(allowed)
                                                             : piece->unit;
    units = fmin(fmin(units, of->is_doubtful ? LONGEST_IN_DOUBT : LONGEST), most / self->unit);
    const dal__columns columns = {.first = self->coefficients, .next = of->width,
                                  .order = piece->order, .direction = direction};
    for (size_t i = 0; i < of->exponents; i++)
        units = dal__until_rise(&columns, of->functions + of->switches + i, units);
    self->at_switch = of->switches;
    for (size_t i = 0; i < of->switches; i++) {
        const double change = dal__until_change(&columns, of->functions + i, self->side[i],
                                                (size_t)self->crossed[i], units);
        if (change < units) self->at_switch = i, units = change;
    }
    for (;; units *= 0.5) {
        if (units == 0.0 || has_values(self, piece, t, direction * units)) return units;
        self->at_switch = of->switches;
        if (units * self->unit < least) return 0.0;
    }
}

static int add(dal__along *self, double t, dal_error *error)
{
    const int status = dal__grow(&self->t, self->found.count, &self->room, sizeof *self->t, error);
    if (status) return status;
    self->found.t = self->t;
    self->t[self->found.count++] = t;
    return DAL_SUCCESS;
}

/* The signs in a part of so many units from t; a first value of no more than zero is zero. */
static dal__sign_changes signs_in(const dal__along *self, const dal__piece *piece, double units,
                                  double zero)
{
    double c[DAL_ROOTS_MOST + 1], power = 1.0, rest = 0.0;
    const size_t width = self->series->width;
    for (size_t k = 0; k <= piece->order; k++, power *= units) {
        c[k] = power * self->coefficients[k * width];
        rest += k > 0 ? fabs(c[k]) : 0.0;
    }
    const double noise = piece->tolerance * (fabs(c[0]) + rest);
    dal__sign_changes here = {.touch = (double)NAN};
    if (fabs(c[0]) - noise > rest) {
        here.first = here.last = c[0] > 0.0 ? 1 : -1;
    } else if (fabs(c[0]) <= zero) { /* g/s, with the sign of g for s > 0 */
        dal__find_sign_changes(piece->order - 1, c + 1, noise, &here);
    } else {
        dal__find_sign_changes(piece->order, c, noise, &here);
    }
    return here;
}

/* The changes of sign in that part. */
static int look_into(dal__along *self, const dal__piece *piece, double t, double units,
                     double zero, dal_error *error)
{
    dal__found *const found = &self->found;
    const dal__sign_changes here = signs_in(self, piece, units, zero);
    const double length = units * self->unit;
    int status = DAL_SUCCESS;
    if (here.first == 0) { /* zero all along */
        if (isnan(self->zero_since)) self->zero_since = t;
        return DAL_SUCCESS;
    }
    const double since = isnan(self->zero_since) ? t : self->zero_since;
    const bool is_at_zero = !isnan(self->zero_since) || (self->ends && here.begins);
    const bool is_late = found->count > 0
        && fabs(found->t[found->count - 1] - t) <= SAME_TIME * fabs(self->length);
    if (here.first * found->last < 0 && is_late && self->ends) {
        found->count--; /* at a kink that is a zero, both sides have it */
        if (isnan(found->touch)) found->touch = t;
    } else if (here.first * found->last < 0) {
        status = add(self, since, error);
    } else if (found->last != 0 && is_at_zero && !is_late && isnan(found->touch)) {
        found->touch = since;
    }
    self->zero_since = (double)NAN;
    for (size_t k = 0; !status && k < here.count; k++)
        status = add(self, t + here.at[k] * length, error);
    if (found->first == 0) found->first = here.first;
    found->last = here.last;
    if (isnan(found->touch)) found->touch = t + here.touch * length;
    self->ends = here.ends;
    self->length = length;
    return status;
}

/* On the other side of the switch at which the part of a length ends; short parts keep switches
 * crossed. */
static void cross(dal__along *self, bool is_far)
{
    for (size_t i = 0; is_far && i < self->series->switches; i++) self->crossed[i] = 0.0;
    if (self->at_switch == self->series->switches) return;
    self->side[self->at_switch] *= -1.0;
    self->crossed[self->at_switch] = 1.0;
}

static int fail_to_expand(double t, dal_error *error)
{
    return dal__fail(error, DAL_EDOMAIN, "the event has no Taylor series at t = %.17g", t);
}

/* Where g has no series, as at the end of a root, a gap is passed over: the signs of g at both ends
 * are compared.  DAL_EDOMAIN if g is not finite there. */
static int pass(dal__along *self, const dal__piece *piece, double t, double end, dal_error *error)
{
    double before = t, after = end, low, high;
    if (!value_at(self, piece, (t - piece->t) / piece->unit, 0.0, &low)
        || !value_at(self, piece, (end - piece->t) / piece->unit, 0.0, &high))
        return fail_to_expand(t, error);
    const int side = self->found.last != 0 ? self->found.last : (low > 0.0) - (low < 0.0);
    const int other = (high > 0.0) - (high < 0.0);
    if (self->found.first == 0) self->found.first = side;
    self->found.last = other != 0 ? other : side;
    self->ends = other == 0;
    self->length = end - t;
    if (side * other >= 0) return DAL_SUCCESS;
    for (;;) {
        const double middle = before + 0.5 * (after - before);
        double value;
        if (middle == before || middle == after) return add(self, after, error);
        if (value_at(self, piece, (middle - piece->t) / piece->unit, 0.0, &value)
            && value * side > 0.0) before = middle;
        else after = middle;
    }
}

static void begin(dal__along *self, const dal__piece *piece)
{
    self->unit = piece->unit;
    self->found = (dal__found){.touch = (double)NAN};
    self->zero_since = (double)NAN;
    self->length = 0.0;
    self->ends = false;
    dal__clear(self->series->switches, self->side);
    dal__clear(self->series->switches, self->crossed);
}

int dal__along_look(dal__along *self, const dal__piece *piece, double from, double to,
                    double zero, dal__watch *watch, dal_error *error)
{
    const double direction = to < from ? -1.0 : 1.0;
    const double least = GAP * fabs(piece->end - piece->t);
    double gap = least;  /* gaps in a row become wider */
    size_t standing = 0; /* parts without length, one after the other */
    begin(self, piece);
    for (double t = from; t != to;) {
        int status = dal__ask(watch, t, error);
        if (status) return status;
        const double units = limit(self, piece, t, direction, fabs(to - t), least);
        double end = units * self->unit >= fabs(to - t) ? to : t + direction * units * self->unit;
        const bool is_switch = self->at_switch < self->series->switches;
        if (end == t && is_switch && ++standing <= 2 * self->series->switches) {
            cross(self, false);
            continue;
        }
        const bool is_gap = end == t || (fabs(end - t) < least && end != to && !is_switch);
        standing = 0;
        if (is_gap) {
            const double length = fmax(gap, 64.0 * DAL_ROUNDOFF * fabs(t));
            end = length >= fabs(to - t) ? to : t + direction * length;
            gap = fmin(2.0 * gap, WIDEST_GAP / GAP * least);
            self->next_unit = piece->unit;
            self->at_switch = self->series->switches;
            dal__clear(self->series->switches, self->side);
            status = pass(self, piece, t, end, error);
        } else {
            gap = least;
            status = look_into(self, piece, t, direction * units, t == from ? zero : NONE, error);
        }
        if (status) return status;
        cross(self, true);
        self->unit = self->next_unit;
        t = end;
    }
    return DAL_SUCCESS;
}

int dal__along_rate(dal__along *self, const dal__piece *piece, double t, double *rate,
                    dal_error *error)
{
    begin(self, piece);
    const bool is_known = expand_at(self, piece, t, 1.0) > 0.0;
    *rate = self->coefficients[self->series->width] / self->unit;
    return is_known && isfinite(*rate) ? DAL_SUCCESS : fail_to_expand(t, error);
}
