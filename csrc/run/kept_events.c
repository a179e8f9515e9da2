/* The events of a run, kept. */
#include "dalembert/events.h"
#include "ground/ground.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static bool make_room(dal_kept_events *self)
{
    const size_t room = self->room > 0 ? 2 * self->room : 16;
    const size_t states = dal__times(dal__times(room, 4 * self->n), sizeof *self->x);
    size_t *const event = realloc(self->event, dal__times(room, sizeof *event));
    if (event) self->event = event;
    double *const t = realloc(self->t, dal__times(room, sizeof *t));
    if (t) self->t = t;
    double *const x = realloc(self->x, states);
    if (x) self->x = x;
    if (!event || !t || !x) return false;
    self->room = room;
    return true;
}

int dal_keep_event(size_t event, size_t step, double t, const double *x, const double *after,
                   void *kept)
{
    dal_kept_events *const self = kept;
    const size_t N = 2 * self->n;
    (void)step;
    if (self->count == self->room && !make_room(self)) return -1;
    double *const states = self->x + 2 * N * self->count;
    self->event[self->count] = event;
    self->t[self->count++] = t;
    memcpy(states, x, N * sizeof *states);
    for (size_t i = 0; i < N; i++) states[N + i] = after ? after[i] : (double)NAN;
    return 0;
}

void dal_kept_events_free(dal_kept_events *kept)
{
    free(kept->event);
    free(kept->t);
    free(kept->x);
    *kept = (dal_kept_events){.n = kept->n};
}
