/* hand_flows.h - see hand_flows.c. */
#ifndef DALEMBERT_HAND_FLOWS_H
#define DALEMBERT_HAND_FLOWS_H

#include <stddef.h>

/* rates[2n] <- the ODE on D at the state x[2n], with the parameters p. */
typedef int hand_flow(double t, const double x[], double rates[], void *p);

hand_flow hand_flow_particle, hand_flow_particle_oscillator, hand_flow_knife_edge,
    hand_flow_sleigh, hand_flow_robot;

#endif /* DALEMBERT_HAND_FLOWS_H */
