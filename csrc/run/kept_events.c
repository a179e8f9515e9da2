/* The events of a run, kept. */
#include "dalembert/events.h"
#include "ground/ground.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The arrays grow together. */
static bool make_room(dal_kept_events *self)
{
    dal_error ignored;
    size_t rooms[3] = {self->room, self->room, self->room};
    const size_t count = self->count, size = 4 * self->n * sizeof *self->x;
    if (dal__grow(&self->event, count, &rooms[0], sizeof *self->event, &ignored)
        || dal__grow(&self->t, count, &rooms[1], sizeof *self->t, &ignored)
        || dal__grow(&self->x, count, &rooms[2], size, &ignored)) return false;
    self->room = rooms[0];
    return true;
}

int dal_keep_event(size_t event, size_t step, double t, const double *x, const double *after,
                   void *kept)
{
    dal_kept_events *const self = kept;
    const size_t N = 2 * self->n;
    (void)step;
    if (!make_room(self)) return -1;
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
