/* hand_flows.c - the ODE on D as one writes it by hand for one system, with the multipliers
 * eliminated on paper: what the flow of the library is compared with. */
#include "hand_flows.h"

#include <math.h>

/* mu = (-y, 0, 1), M = 1, V = 0. */
int hand_flow_particle(double t, const double x[], double rates[], void *p)
{
    const double y = x[1], vx = x[3], vy = x[4], vz = x[5];
    const double lambda = vy * vx / (1.0 + y * y);
    (void)t, (void)p;
    rates[0] = vx, rates[1] = vy, rates[2] = vz;
    rates[3] = -y * lambda;
    rates[4] = 0.0;
    rates[5] = lambda;
    return 0;
}

/* The same with V = (k1 x^2 + k2 y^2 + k3 z^2)/2; p = (k1, k2, k3). */
int hand_flow_particle_oscillator(double t, const double x[], double rates[], void *p)
{
    const double *const k = p, y = x[1], vx = x[3], vy = x[4], vz = x[5];
    const double fx = k[0] * x[0], fz = k[2] * x[2];
    const double lambda = (vy * vx + fz - y * fx) / (1.0 + y * y);
    (void)t;
    rates[0] = vx, rates[1] = vy, rates[2] = vz;
    rates[3] = -fx - y * lambda;
    rates[4] = -k[1] * y;
    rates[5] = lambda - fz;
    return 0;
}

/* mu = (sin theta, -cos theta, 0), M = diag(m, m, J), V = -m gs x; p = (m, J, gs). */
int hand_flow_knife_edge(double t, const double x[], double rates[], void *p)
{
    const double gs = ((const double *)p)[2], s = sin(x[2]), c = cos(x[2]);
    const double vx = x[3], vy = x[4], omega = x[5];
    const double lambda = -(s * gs + (c * vx + s * vy) * omega); /* of m */
    (void)t;
    rates[0] = vx, rates[1] = vy, rates[2] = omega;
    rates[3] = gs + s * lambda;
    rates[4] = -c * lambda;
    rates[5] = 0.0;
    return 0;
}

/* mu = (-sin theta, cos theta, -a), M = diag(m, m, J), V = k (x^2 + y^2)/2; p = (m, J, a, k). */
int hand_flow_sleigh(double t, const double x[], double rates[], void *p)
{
    const double *const at = p, m = at[0], J = at[1], a = at[2], k = at[3];
    const double s = sin(x[2]), c = cos(x[2]), vx = x[3], vy = x[4], omega = x[5];
    const double fx = -k * x[0], fy = -k * x[1];
    const double lambda = ((s * fx - c * fy) + m * (c * vx + s * vy) * omega)
                        / (1.0 + m * a * a / J);
    (void)t;
    rates[0] = vx, rates[1] = vy, rates[2] = omega;
    rates[3] = (fx - s * lambda) / m;
    rates[4] = (fy + c * lambda) / m;
    rates[5] = -a * lambda / J;
    return 0;
}

/* v_x = R cos(phi) v_theta, v_y = R sin(phi) v_theta, M = diag(m, m, I, J), V = k sin(theta);
 * p = (m, I, J, R, k). */
int hand_flow_robot(double t, const double x[], double rates[], void *p)
{
    const double *const at = p, R = at[3], s = sin(x[2]), c = cos(x[2]);
    const double turn = x[6], roll = x[7];
    const double faster = -at[4] * cos(x[3]) / (at[2] + at[0] * R * R);
    (void)t;
    rates[0] = x[4], rates[1] = x[5], rates[2] = turn, rates[3] = roll;
    rates[4] = R * (c * faster - s * turn * roll);
    rates[5] = R * (s * faster + c * turn * roll);
    rates[6] = 0.0;
    rates[7] = faster;
    return 0;
}
