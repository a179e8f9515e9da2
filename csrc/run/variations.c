/* A motion and its derivatives, along the pieces of its Taylor series.
 *
 * A lane has the numbers of a column, or for second derivatives of a pair of columns; four lanes
 * are a block, which is computed at once.  The bits of the motion do not depend on them. */
#include "dalembert/taylor.h"
#include "step/taylor.h"

#include <math.h>
#include <string.h>

enum { FOUR = 4 };

/* The part of a piece for which the coefficients of derivatives are used, in the length to which
 * they lead.  It may be longer: with 1.15 the last ones are up to 40 times what they are to be,
 * 1e-17 of the others by default, and most pieces have one part. */
static const double STRETCHED = 1.15;

/* Rates on both sides of a switch that differ by less, relative to the largest one, have no jump.
 * Columns that leave the tangent space by more, relative to their size, are none of it. */
static const double SAME_RATE = 1e-9, TANGENT = 1e-8;

struct dal_taylor_variations {
    dal_stepper *stepper;
    const dal_variation_series *series;
    size_t n, columns, lanes, blocks;
    size_t states, others, numbers; /* of a lane: all of y, of one direction; and all */
    double t, until;
    double *x, *dx, *d2x;           /* [2n], [columns*2n], [pairs*2n] */
    double *moved_x;                /* [2n] where a call ends */
    double *y, *low, *change;       /* [width] */
    double *lane, *values;          /* [numbers], [3n] of one lane */
    double *about, *work;
    dal_four *all, *before;         /* [blocks*numbers]: now, and before a call */
    dal_four *Y;                   /* [(order + 1)*width] */
    double *none;                   /* [switches] zeros */
    double *side, *rate;            /* [switches], [width] where the piece before ends */
    double *acceleration;           /* [n] at t, of the motion before it */
    double direction;               /* of the last call */
    bool follows;                   /* there is a piece before */
    bool started;
    dal_error error;
    arena arena;
};

static const dal_series *motion_of(const dal_taylor_variations *self)
{
    return self->stepper->motion.system->def.series;
}

/* ---- making -------------------------------------------------------------------------------- */

static int check(const dal_stepper *stepper, int order, size_t columns, dal_error *error)
{
    const dal_system_def *const def = &stepper->motion.system->def;
    if (order != 1 && order != 2)
        return dal__fail(error, DAL_EINVAL, "order = %d: expected 1 or 2", order);
    if (columns == 0) return dal__fail(error, DAL_EINVAL, "columns = 0: expected at least 1");
    if (!dal__taylor_has_pieces(stepper))
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\": derivatives need the scheme "
                         "taylor", stepper->scheme.name);
    if (!def->variations || def->variations->order != order)
        return dal__fail(error, DAL_EUNSUPPORTED, "the derivatives of order %d of the system "
                         "\"%s\" have not been compiled", order, def->name);
    if (def->variations->abi != DAL_SERIES_ABI)
        return dal__fail(error, DAL_EINVAL, "variations: number %u, expected %u; compile the "
                         "system with this version of series.h", def->variations->abi,
                         DAL_SERIES_ABI);
    if (!def->series->in_D && def->m > 0)
        return dal__fail(error, DAL_EUNSUPPORTED, "derivatives of the system \"%s\" are not "
                         "supported: no equations on D in closed form are known", def->name);
    if (def->driven)
        return dal__fail(error, DAL_EUNSUPPORTED, "derivatives of motions whose constraints depend "
                         "on inputs are not supported");
    return DAL_SUCCESS;
}

static int allocate(dal_taylor_variations **made, dal_stepper *stepper, size_t columns,
                    dal_error *error)
{
    const dal_system_def *const def = &stepper->motion.system->def;
    const dal_variation_series *const series = def->variations;
    const dal_series *const motion = def->series;
    const size_t rows = DAL_SERIES_MOST + 1;
    const size_t pairs = columns * (columns + 1) / 2;
    const bool is_second = series->order == 2;
    dal_taylor_variations shape = {.series = series, .n = def->n, .columns = columns,
                                   .lanes = is_second ? pairs : columns,
                                   .states = series->states,
                                   .others = series->parameters + series->inputs}, *self;
    double *all, *before, *Y;
    shape.blocks = (shape.lanes + FOUR - 1) / FOUR;
    shape.numbers = is_second ? 3 * shape.states + 2 * shape.others : shape.states + shape.others;
    arena a = {0};
    dal__reserve(&a, &self, 1, sizeof *self);
    DAL__RESERVE(&a, 2 * def->n, &shape.x, &shape.moved_x);
    DAL__RESERVE(&a, dal__times(columns, 2 * def->n), &shape.dx);
    DAL__RESERVE(&a, is_second ? dal__times(pairs, 2 * def->n) : 0, &shape.d2x);
    DAL__RESERVE(&a, motion->width, &shape.y, &shape.low, &shape.change, &shape.rate);
    DAL__RESERVE(&a, shape.numbers + 2 * def->n, &shape.lane);
    DAL__RESERVE(&a, def->n, &shape.acceleration);
    DAL__RESERVE(&a, 3 * def->n + shape.states, &shape.values);
    DAL__RESERVE(&a, motion->switches, &shape.none, &shape.side);
    DAL__RESERVE(&a, rows * motion->width, &shape.about);
    DAL__RESERVE(&a, rows * series->room, &shape.work);
    DAL__RESERVE(&a, dal__times(FOUR * shape.numbers, shape.blocks), &all, &before);
    DAL__RESERVE(&a, rows * FOUR * series->width, &Y);
    const int status = dal__allocate(&a, error);
    if (status) return status;
    *self = shape;
    self->arena = a;
    self->stepper = stepper;
    self->all = (dal_four *)all;
    self->before = (dal_four *)before;
    self->Y = (dal_four *)Y;
    if (!is_second) self->d2x = NULL;
    *made = self;
    return DAL_SUCCESS;
}

int dal_taylor_variations_new(dal_taylor_variations **variations, const dal_system *system,
                              const dal_scheme *scheme, int order, size_t columns,
                              dal_error *error)
{
    int status = DAL__REQUIRE(error, {"variations", variations}, {"system", system},
                              {"scheme", scheme});
    dal_stepper *stepper;
    if (!status) status = dal_stepper_new(&stepper, system, scheme, NULL, error);
    if (status) return status;
    status = check(stepper, order, columns, error);
    if (!status) status = allocate(variations, stepper, columns, error);
    if (status) dal_stepper_free(stepper);
    return status;
}

void dal_taylor_variations_free(dal_taylor_variations *variations)
{
    if (!variations) return;
    dal_stepper_free(variations->stepper);
    dal__release(&variations->arena);
}

/* ---- lanes --------------------------------------------------------------------------------- */

/* self->lane[numbers] <- those of a lane, or the other way. */
static void read_lane(dal_taylor_variations *self, size_t lane)
{
    const dal_four *const block = self->all + lane / FOUR * self->numbers;
    for (size_t i = 0; i < self->numbers; i++) self->lane[i] = block[i][lane % FOUR];
}

static void write_lane(dal_taylor_variations *self, size_t lane)
{
    dal_four *const block = self->all + lane / FOUR * self->numbers;
    for (size_t i = 0; i < self->numbers; i++) block[i][lane % FOUR] = self->lane[i];
}

/* The pair of columns of a lane; of order 1 both are its column. */
static void pair_of(const dal_taylor_variations *self, size_t lane, size_t *one, size_t *other)
{
    *one = *other = lane;
    if (self->series->order == 1) return;
    size_t row = 0, first = 0;
    while (lane >= first + self->columns - row) first += self->columns - row++;
    *one = row;
    *other = row + lane - first;
}

/* ---- the start ----------------------------------------------------------------------------- */

/* self->values[3n] <- the derivatives of v in self->lane, where self->y is the motion. */
static void find_velocity(dal_taylor_variations *self, double t)
{
    const dal_motion *const motion = &self->stepper->motion;
    self->series->velocity(t, self->y, motion->input, self->lane, self->values,
                           motion->system->def.ctx);
}

/* The columns at t, where self->y is the motion. */
static void give_columns(dal_taylor_variations *self, double t)
{
    const size_t n = self->n, N = 2 * n;
    for (size_t lane = 0; lane < self->lanes; lane++) {
        size_t one, other;
        pair_of(self, lane, &one, &other);
        read_lane(self, lane);
        find_velocity(self, t);
        if (one == other) {
            memcpy(self->dx + one * N, self->lane, n * sizeof(double));
            memcpy(self->dx + one * N + n, self->values, n * sizeof(double));
        }
        if (!self->d2x) continue;
        memcpy(self->d2x + lane * N, self->lane + 2 * self->states, n * sizeof(double));
        memcpy(self->d2x + lane * N + n, self->values + 2 * n, n * sizeof(double));
    }
}

/* self->y <- the numbers of a state. */
static void find_numbers(dal_taylor_variations *self, double t, const double *x)
{
    const dal_motion *const motion = &self->stepper->motion;
    memcpy(self->y, x, self->n * sizeof *self->y);
    motion_of(self)->quasi(t, x, motion->input, self->y + self->n, motion->system->def.ctx);
}

/* self->lane <- one with dy[states] and dz, or NULL, in direction a. */
static void fill_lane(dal_taylor_variations *self, const double *dy, const double *dz)
{
    const size_t z = self->numbers - (self->series->order == 1 ? 1 : 2) * self->others;
    memset(self->lane, 0, self->numbers * sizeof *self->lane);
    memcpy(self->lane, dy, self->states * sizeof *dy);
    if (dz && self->others > 0) memcpy(self->lane + z, dz, self->others * sizeof *dz);
}

int dal_taylor_variations_column(dal_taylor_variations *variations, double t, const double *x,
                                 const double *dy, const double *dz, double *dx)
{
    dal_taylor_variations *const self = variations;
    if (!self) return DAL_EINVAL;
    const int status = DAL__REQUIRE(&self->error, {"x", x}, {"dy", dy}, {"dx", dx});
    if (status) return status;
    find_numbers(self, t, x);
    fill_lane(self, dy, dz);
    find_velocity(self, t);
    memcpy(dx, dy, self->n * sizeof *dx);
    memcpy(dx + self->n, self->values, self->n * sizeof *dx);
    return DAL_SUCCESS;
}

/* dy[states] <- the derivatives of y of column k; DAL_EOFFD if it is not tangent to D. */
static int find_column(dal_taylor_variations *self, size_t k, const double *dx, const double *dz,
                       double *dy)
{
    const size_t n = self->n;
    const dal_motion *const motion = &self->stepper->motion;
    const double *const column = dx + k * 2 * n, t = self->t;
    double *const given = self->lane, *const dw = self->values;
    memset(given, 0, (self->numbers + 2 * n) * sizeof *given);
    memcpy(given, column, 2 * n * sizeof *given);
    if (dz && self->others > 0)
        memcpy(given + 2 * n, dz + k * self->others, self->others * sizeof *given);
    if (!dal__all_finite(2 * n + self->others, given))
        return dal__fail(&self->error, DAL_EINVAL, "column %zu: expected finite numbers", k);
    self->series->quasi(t, self->x, motion->input, given, dw, motion->system->def.ctx);
    memcpy(dy, column, n * sizeof *dy);
    memcpy(dy + n, dw, (self->states - n) * sizeof *dy);
    fill_lane(self, dy, dz ? dz + k * self->others : NULL);
    find_velocity(self, t);
    const double size = fmax(dal__largest(n, column + n), dal__largest(n, self->values));
    const double off = dal__largest_difference(n, column + n, self->values);
    if (off <= TANGENT * size) return DAL_SUCCESS;
    return dal__fail(&self->error, DAL_EOFFD, "column %zu is not tangent to D: its velocities "
                     "differ by %.2g, of %.2g, from those that are", k, off, size);
}

int dal_taylor_variations_start(dal_taylor_variations *variations, double t, const double *x,
                                const double *dx, const double *dz)
{
    dal_taylor_variations *const self = variations;
    if (!self) return DAL_EINVAL;
    self->error = (dal_error){0};
    int status = DAL__REQUIRE(&self->error, {"x", x}, {"dx", dx});
    if (status) return status;
    const dal_motion *const motion = &self->stepper->motion;
    const size_t S = self->states, Z = self->others;
    self->started = self->follows = false;
    status = dal_stepper_start(self->stepper, t, 1.0, x, DAL_CHECK, DAL_INITIAL_NONE);
    if (status) return dal__fail_because(&self->error, status, &self->stepper->error, "%s", "");
    memcpy(self->x, motion->x, 2 * self->n * sizeof *self->x);
    self->t = t;
    find_numbers(self, t, self->x);
    memset(self->all, 0, self->blocks * self->numbers * sizeof *self->all);
    for (size_t lane = 0; lane < self->lanes; lane++) {
        size_t pair[2];
        double *const dy[2] = {self->change, self->rate};
        pair_of(self, lane, &pair[0], &pair[1]);
        const size_t directions = self->series->order == 1 ? 1 : 2;
        for (size_t i = 0; i < directions; i++) {
            status = find_column(self, pair[i], dx, dz, dy[i]);
            if (status) return status;
        }
        memset(self->lane, 0, self->numbers * sizeof *self->lane);
        double *const z = self->lane + (directions == 1 ? S : 3 * S);
        for (size_t i = 0; i < directions; i++) {
            memcpy(self->lane + i * S, dy[i], S * sizeof *self->lane);
            if (dz && Z > 0) memcpy(z + i * Z, dz + pair[i] * Z, Z * sizeof *z);
        }
        write_lane(self, lane);
    }
    give_columns(self, t);
    dal__forget(self->n, self->acceleration);
    self->started = true;
    return DAL_SUCCESS;
}

int dal_taylor_variations_input(dal_taylor_variations *variations, const double *u)
{
    if (!variations) return DAL_EINVAL;
    dal_taylor_variations *const self = variations;
    const int status = dal_stepper_input(self->stepper, u);
    return dal__fail_because(&self->error, status, &self->stepper->error, "%s", "");
}

/* ---- along a piece ------------------------------------------------------------------------- */

/* self->Y <- the coefficients of a block from t on, in the unit of the piece. */
static void expand(dal_taylor_variations *self, const dal__piece *piece, double t, size_t block)
{
    const double s = (t - piece->t) / piece->unit;
    const dal_series_at at = {.t = t, .unit = piece->unit, .y = self->y, .low = self->low,
                              .u = piece->input, .side = piece->side,
                              .crossed = s == 0.0 ? piece->crossed : self->none};
    self->series->expand(&at, piece->order, s == 0.0 ? piece->coefficients : self->about,
                         piece->series->width, self->all + block * self->numbers, self->Y,
                         self->work, self->stepper->motion.system->def.ctx);
}

/* The numbers and coefficients of the motion at t. */
static void come_to(dal_taylor_variations *self, const dal__piece *piece, double t)
{
    const double s = (t - piece->t) / piece->unit;
    dal__numbers_at(piece, s, self->y, self->low, self->change);
    if (s != 0.0) dal__write_about(piece, s, piece->unit, self->about);
}

/* Leads a block from a time in the piece to another. */
static int lead_block(dal_taylor_variations *self, const dal__piece *piece, size_t block,
                      double from, double to)
{
    enum { MOST = 1000 }; /* parts; there are few, unless columns are nearly out of range */
    const size_t order = piece->order;
    dal_four *const columns = self->all + block * self->numbers;
    for (int part = 0; from != to; part++) {
        double decay[DAL_SERIES_LAST];
        come_to(self, piece, from);
        expand(self, piece, from, block);
        self->series->decay(order, self->Y, decay);
        const double units = STRETCHED * dal__units_of(decay, order, piece->log_tolerance);
        const double rest = (to - from) / piece->unit, parts = ceil(fabs(rest) / units);
        if (isnan(units) || part == MOST)
            return dal__fail(&self->error, DAL_EDOMAIN, "the derivatives are not finite after t = "
                             "%.17g", from);
        const double s = parts > 1.0 ? rest / parts : rest;
        self->series->lead(order, s, self->Y, columns);
        from = parts > 1.0 ? from + s * piece->unit : to;
    }
    return DAL_SUCCESS;
}

/* ---- switches ------------------------------------------------------------------------------ */

/* Whether the rates on both sides of a switch differ; self->change <- those before, less those
 * after. */
static bool jumps(dal_taylor_variations *self, const dal__piece *piece)
{
    double most = 0.0, size = 0.0;
    for (size_t i = 0; i < self->states; i++) {
        const double after = piece->coefficients[piece->series->width + i] / piece->unit;
        self->change[i] = self->rate[i] - after;
        most = fmax(most, fabs(self->change[i]));
        size = fmax(size, fmax(fabs(after), fabs(self->rate[i])));
    }
    return most > SAME_RATE * size;
}

/* Where the rates jump, the time of the jump depends on the column. */
static int cross(dal_taylor_variations *self, const dal__piece *piece, size_t i)
{
    const double rate = self->rate[self->states + i];
    if (self->series->order > 1)
        return dal__fail(&self->error, DAL_EUNSUPPORTED, "second derivatives: a function has a "
                         "kink, which the motion passes at t = %.17g", piece->t);
    if (!jumps(self, piece)) return DAL_SUCCESS;
    double *const jump = self->lane;
    memcpy(jump, self->change, self->states * sizeof *jump);
    for (size_t b = 0; b < self->blocks; b++) {
        dal_four *const columns = self->all + b * self->numbers;
        come_to(self, piece, piece->t);
        expand(self, piece, piece->t, b);
        const dal_four later = -self->Y[self->states + i] / rate;
        for (size_t c = 0; c < self->states; c++) columns[c] += jump[c] * later;
        for (size_t lane = 0; lane < FOUR; lane++)
            if (!isfinite(later[lane]))
                return dal__fail(&self->error, DAL_EDOMAIN, "the motion touches a jump of the "
                                 "force at t = %.17g, so its derivatives do not exist", piece->t);
    }
    return DAL_SUCCESS;
}

/* Crosses the switches between the piece before and this one. */
static int follow(dal_taylor_variations *self, const dal__piece *piece)
{
    int status = DAL_SUCCESS;
    for (size_t i = 0; !status && self->follows && i < piece->series->switches; i++)
        if (piece->side[i] * self->side[i] < 0.0) status = cross(self, piece, i);
    return status;
}

/* Stores the sides, the rates and the acceleration at a time in the piece, for the next one.  At a
 * jump they are those before it. */
static void leave(dal_taylor_variations *self, const dal__piece *piece, double t)
{
    const double s = (t - piece->t) / piece->unit;
    const double *const Y = piece->coefficients;
    dal__copy(piece->series->switches, piece->side, self->side);
    piece->series->slope(piece->order, s, Y, self->rate);
    for (size_t i = 0; i < piece->series->width; i++) self->rate[i] /= piece->unit;
    for (size_t i = 0; i < self->n; i++) {
        double sum = 0.0;
        for (size_t k = piece->order; k > 1; k--)
            sum = sum * s + (double)(k * (k - 1)) * Y[k * piece->series->width + i];
        self->acceleration[i] = sum / piece->unit / piece->unit;
    }
    self->follows = true;
}

/* ---- going on ------------------------------------------------------------------------------ */

static int lead(const dal__piece *piece, double from, double to, void *ctx)
{
    dal_taylor_variations *const self = ctx;
    int status = follow(self, piece);
    for (size_t b = 0; !status && b < self->blocks; b++)
        status = lead_block(self, piece, b, from, to);
    if (!status) leave(self, piece, to);
    if (status || to != self->until) return status;
    status = dal__taylor_state(self->stepper, piece, to, self->moved_x);
    if (status) return dal__fail_because(&self->error, status, &self->stepper->error, "%s", "");
    come_to(self, piece, to);
    return DAL_SUCCESS;
}

int dal_taylor_variations_go(dal_taylor_variations *variations, double t_end, dal_watch_fn watch,
                             void *ctx)
{
    dal_taylor_variations *const self = variations;
    if (!self) return DAL_EINVAL;
    dal_stepper *const stepper = self->stepper;
    const size_t size = self->blocks * self->numbers * sizeof *self->all;
    self->error = (dal_error){0};
    if (!self->started) return dal__fail(&self->error, DAL_EINVAL, "not started");
    if (!isfinite(t_end))
        return dal__fail(&self->error, DAL_EINVAL, "t_end = %g: expected a finite number", t_end);
    if (t_end == self->t) return DAL_SUCCESS;
    int status = dal_stepper_start(stepper, self->t, t_end - self->t, self->x, DAL_ASSUME,
                                   DAL_INITIAL_NONE);
    const double direction = t_end > self->t ? 1.0 : -1.0;
    memcpy(self->before, self->all, size);
    self->follows = self->follows && direction == self->direction;
    self->direction = direction;
    self->until = t_end;
    stepper->motion.watch = watch;
    stepper->motion.watch_ctx = ctx;
    if (!status) status = dal__taylor_visit(stepper, t_end, lead, self);
    stepper->motion.watch = NULL;
    if (status) {
        memcpy(self->all, self->before, size);
        self->follows = false;
        return self->error.status ? status
            : dal__fail_because(&self->error, status, &stepper->error, "%s", "");
    }
    self->t = t_end;
    memcpy(self->x, self->moved_x, 2 * self->n * sizeof *self->x);
    give_columns(self, t_end);
    return DAL_SUCCESS;
}

/* ---- what there is ------------------------------------------------------------------------- */

size_t dal_taylor_variations_states(const dal_taylor_variations *variations)
{
    return variations->states;
}

double dal_taylor_variations_time(const dal_taylor_variations *variations)
{
    return variations->t;
}

const double *dal_taylor_variations_state(const dal_taylor_variations *variations)
{
    return variations->x;
}

const double *dal_taylor_variations_acceleration(const dal_taylor_variations *variations)
{
    return variations->acceleration;
}

const double *dal_taylor_variations_columns(const dal_taylor_variations *variations)
{
    return variations->dx;
}

const double *dal_taylor_variations_second(const dal_taylor_variations *variations)
{
    return variations->d2x;
}

const dal_error *dal_taylor_variations_error(const dal_taylor_variations *variations)
{
    return &variations->error;
}
