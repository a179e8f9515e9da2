/* The pieces of a motion, kept. */
#include "step/polynomials.h"

/* A record has the coefficients, then t, end and unit, then the low parts and the inputs.  The
 * length of a record is a multiple of ALIGNED, for the vectors. */
enum { TIMES = 3, ALIGNED = 8 };

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

/* Room for one more record; aligned, so the array is made anew where it is full. */
static int make_room(dal__polynomials *self, dal_error *error)
{
    if (self->count < self->room) return DAL_SUCCESS;
    const size_t room = self->room > 0 ? 2 * self->room : 64;
    arena memory = {0};
    double *records;
    DAL__RESERVE(&memory, dal__times(room, self->numbers), &records);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    dal__copy(self->count * self->numbers, self->records, records);
    dal__release(&self->memory);
    self->memory = memory;
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
        self->numbers = (numbers / ALIGNED + 1) * ALIGNED;
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
