/* generic4.h - a system without any symmetry: n = 4, m = 2, a constant full mass matrix, a quartic
 * potential, and forms that depend on every coordinate.  It is what the tests throw at formulas
 * that a simpler system would forgive. */
#ifndef DALEMBERT_TESTS_GENERIC4_H
#define DALEMBERT_TESTS_GENERIC4_H

#include "dalembert.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static const double generic4_mass[16] = {
    2.0, 0.2, 0.0, 0.1,
    0.2, 1.5, -0.1, 0.0,
    0.0, -0.1, 1.0, 0.2,
    0.1, 0.0, 0.2, 1.25,
};

/* V = a^4/4 + a^2/2 + a b c/5 - a d/4 + b^4/4 + b^2 d^2/3 + b^2 + c^4/4 + 3 c^2/4 + d^4/4 + d^2/2
 * with (a, b, c, d) = q. */
static inline int generic4_potential(double t, const double *q, double *V, double *V_q,
                                     double *V_qq, void *ctx)
{
    const double a = q[0], b = q[1], c = q[2], d = q[3];
    (void)ctx;
    if (V)
        *V = a * a * a * a / 4 + a * a / 2 + a * b * c / 5 - a * d / 4 + b * b * b * b / 4 +
             b * b * d * d / 3 + b * b + c * c * c * c / 4 + 3 * c * c / 4 + d * d * d * d / 4 +
             d * d / 2;
    if (V_q) {
        V_q[0] = a * a * a + a + b * c / 5 - d / 4;
        V_q[1] = a * c / 5 + b * b * b + 2 * b * d * d / 3 + 2 * b;
        V_q[2] = a * b / 5 + c * c * c + 3 * c / 2;
        V_q[3] = -a / 4 + 2 * b * b * d / 3 + d * d * d + d;
    }
    if (V_qq) {
        const double hessian[16] = {
            3 * a * a + 1, c / 5, b / 5, -0.25,
            c / 5, 3 * b * b + 2 * d * d / 3 + 2, a / 5, 4 * b * d / 3,
            b / 5, a / 5, 3 * c * c + 1.5, 0.0,
            -0.25, 4 * b * d / 3, 0.0, 2 * b * b / 3 + 3 * d * d + 1,
        };
        memcpy(V_qq, hessian, sizeof hessian);
    }
    return 0;
}

/* mu^1 = (1, c/2, -b/3 + sin(d)/4, a/5), mu^2 = (b/4 + c^2/10, cos(a)/3, 1, a d/6 - c/2). */
static inline int generic4_constraint(double t, const double *q, const double *v, double *phi,
                                      double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double a = q[0], b = q[1], c = q[2], d = q[3];
    const double mu[8] = {
        1.0, c / 2, -b / 3 + sin(d) / 4, a / 5,
        b / 4 + c * c / 10, cos(a) / 3, 1.0, a * d / 6 - c / 2,
    };
    (void)ctx;
    if (phi)
        for (size_t i = 0; i < 2; i++)
            phi[i] = mu[4 * i] * v[0] + mu[4 * i + 1] * v[1] + mu[4 * i + 2] * v[2] +
                     mu[4 * i + 3] * v[3];
    if (phi_v) memcpy(phi_v, mu, sizeof mu);
    if (phi_q) {
        const double derivative[8] = {
            v[3] / 5, -v[2] / 3, v[1] / 2, cos(d) * v[2] / 4,
            -sin(a) * v[1] / 3 + d * v[3] / 6, v[0] / 4, c * v[0] / 5 - v[3] / 2, a * v[3] / 6,
        };
        memcpy(phi_q, derivative, sizeof derivative);
    }
    return 0;
}

/* x[8] <- initial data in D: v_2 = 1/2, v_4 = -2/5 given, v_1 and v_3 from mu v = 0. */
static inline void generic4_state(double *x)
{
    const double s = sin(0.5), c = cos(0.3);
    const double v1 = (-6420 + 1575 * s + 1000 * c + 3750 * s * c) / (765 * s + 90204);
    const double v3 = (-125000 * c - 54438) / (6375 * s + 751700);
    const double state[8] = {0.3, -0.2, 0.4, 0.5, v1, 0.5, v3, -0.4};
    memcpy(x, state, sizeof state);
}

static inline int generic4_new(dal_system **system, dal_error *error)
{
    double state[8];
    generic4_state(state);
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass,
                                .potential = generic4_potential,
                                .constraint = generic4_constraint, .name = "generic4",
                                .state = state};
    return dal_system_new(system, &def, error);
}

#endif /* DALEMBERT_TESTS_GENERIC4_H */
