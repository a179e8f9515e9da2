/* hand_loop.h - see hand_loop.c. */
#ifndef DALEMBERT_HAND_LOOP_H
#define DALEMBERT_HAND_LOOP_H

#include <stddef.h>

/* steps midpoint steps of size h of the free particle, unit mass; state[6] in place. */
typedef void hand_loop(size_t steps, double h, double *state);

hand_loop hand_compensated_loop, hand_plain_loop;

#endif /* DALEMBERT_HAND_LOOP_H */
