/* hand_stages.h - see hand_stages.c. */
#ifndef DALEMBERT_HAND_STAGES_H
#define DALEMBERT_HAND_STAGES_H

#include <stddef.h>

/* A stage of a record of fused pairs (0, a), (1, b), with the step h in its numbers. */
typedef struct hand_stage {
    double before, after; /* a h, b h */
    double span;          /* (a + b) h */
    double ahead[3];      /* kappa is predicted from those of the last three stages, latest first */
} hand_stage;

/* steps steps of count stages each, from state = (q, v) and in its place; p are the parameters. */
typedef void hand_fn(size_t steps, size_t count, const hand_stage *stage, const double *p,
                     double *state);

/* With compensated sums, and with plain ones. */
hand_fn hand_compensated_particle_oscillator, hand_plain_particle_oscillator,
    hand_compensated_contact_oscillator, hand_plain_contact_oscillator,
    hand_compensated_knife_edge, hand_plain_knife_edge, hand_compensated_robot, hand_plain_robot,
    hand_compensated_sleigh, hand_plain_sleigh;

#endif /* DALEMBERT_HAND_STAGES_H */
