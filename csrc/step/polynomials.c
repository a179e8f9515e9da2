/* The pieces of a motion, kept. */
#include "step/polynomials.h"

#include <stdlib.h>

enum { TIMES = 3 }; /* of a record: t, end, unit; then the low parts and the inputs */

static size_t coefficients_of(const dal__piece *piece)
{
    return (piece->order + 1) * piece->series->width;
}

static double *record_at(const dal__polynomials *self, size_t k)
{
    return self->records + k * self->numbers;
}

static const double *times_at(const dal__polynomials *self, size_t k)
{
    return record_at(self, k) + coefficients_of(&self->shape);
}

/* Room for one more record. */
static int make_room(dal__polynomials *self, dal_error *error)
{
    if (self->count < self->room) return DAL_SUCCESS;
    const size_t room = self->room > 0 ? 2 * self->room : 64;
    const size_t size = dal__times(dal__times(room, self->numbers), sizeof *self->block);
    const size_t spare = DAL_COEFFICIENTS_SPARE * sizeof *self->block;
    double *const block = size > SIZE_MAX - spare ? NULL : malloc(size + spare);
    if (!block)
        return dal__fail(error, DAL_ENOMEM, "no memory for the polynomials of %zu steps", room);
    double *const records = dal__aligned(block);
    dal__copy(self->count * self->numbers, self->records, records);
    free(self->block);
    self->block = block;
    self->records = records;
    self->room = room;
    return DAL_SUCCESS;
}

int dal__polynomials_add(dal__polynomials *self, const dal__piece *piece, dal_error *error)
{
    const size_t width = piece->series->width, coefficients = coefficients_of(piece);
    const double direction = piece->end > piece->t ? 1.0 : -1.0;
    if (self->count == 0) {
        const size_t numbers = coefficients + TIMES + width + self->inputs;
        self->shape = *piece;
        self->numbers = (numbers / DAL_COEFFICIENTS_SPARE + 1) * DAL_COEFFICIENTS_SPARE;
    }
    while (self->count > 0
           && direction * (times_at(self, self->count - 1)[0] - piece->t) >= 0.0) self->count--;
    const int status = make_room(self, error);
    if (status) return status;
    double *const record = record_at(self, self->count++), *const times = record + coefficients;
    dal__copy(coefficients, piece->coefficients, record);
    times[0] = piece->t;
    times[1] = piece->end;
    times[2] = piece->unit;
    dal__copy(width, piece->low, times + TIMES);
    dal__copy(self->inputs, piece->input, times + TIMES + width);
    return DAL_SUCCESS;
}

bool dal__polynomials_find(const dal__polynomials *self, double t, dal__piece *piece)
{
    if (self->count == 0) return false;
    const double *const first = times_at(self, 0), *const last = times_at(self, self->count - 1);
    const double direction = first[1] > first[0] ? 1.0 : -1.0;
    if (!(direction * (t - first[0]) >= 0.0 && direction * (t - last[1]) <= 0.0)) return false;
    size_t low = 0, high = self->count; /* the piece is not before low, and before high */
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;
        if (direction * (t - times_at(self, middle)[0]) >= 0.0) low = middle;
        else high = middle;
    }
    const double *const times = times_at(self, low);
    *piece = self->shape;
    piece->t = times[0];
    piece->end = times[1];
    piece->unit = times[2];
    piece->coefficients = piece->y = record_at(self, low);
    piece->low = times + TIMES;
    piece->input = times + TIMES + piece->series->width;
    return true;
}
