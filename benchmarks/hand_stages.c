/* hand_stages.c - a stage of leapfrog with a potential as one writes it by hand for one system, who
 * knows its formulas: what the stage of the library is compared with.
 *
 *     q_k = q + a h v,      M (v' - v) = -(a+b) h V_q(q_k) + mu(q_k)^T kappa,
 *     q' = q_k + b h v',    mu(q') v' = 0
 *
 * Where mu depends on coordinates that kappa does not push, q' is known as far as mu asks for it,
 * and the equation for kappa is linear.  kappa is found from what mu(q') v' lacks, and what is left
 * of that is looked at, as the library does: D is kept to roundoff. */
#include "hand_stages.h"

#include <float.h>
#include <math.h>

/* What may be left of mu v', for n = 3 or 4, in units of |mu| |v|. */
#define ALLOWED(n) ((n) * DBL_EPSILON)

static inline double larger(double x, double y) { return x > y ? x : y; }

static inline double largest(double x, double y, double z)
{
    return larger(larger(fabs(x), fabs(y)), fabs(z));
}

/* mu = (-y, 0, 1), M = 1, V = (k1 x^2 + k2 y^2 + k3 z^2)/2; p = (k1, k2, k3). */
void hand_particle_oscillator(size_t steps, size_t count, const hand_stage *stage, const double *p,
                              double *state)
{
    const double k1 = p[0], k2 = p[1], k3 = p[2];
    double x = state[0], y = state[1], z = state[2];
    double vx = state[3], vy = state[4], vz = state[5];
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            x += s->before * vx;
            y += s->before * vy;
            z += s->before * vz;
            vx -= s->span * (k1 * x);
            vy -= s->span * (k2 * y);
            vz -= s->span * (k3 * z);
            const double yk = y;
            y += s->after * vy;
            const double share = 1.0 / (1.0 + y * yk), scale = ALLOWED(3) * (1.0 + fabs(y));
            double lack = y * vx - vz;
            do {
                const double kappa = lack * share;
                vx -= yk * kappa;
                vz += kappa;
                lack = y * vx - vz;
            } while (fabs(lack) > scale * largest(vx, vy, vz));
            x += s->after * vx;
            z += s->after * vz;
        }
    state[0] = x, state[1] = y, state[2] = z;
    state[3] = vx, state[4] = vy, state[5] = vz;
}

/* mu = (1, 0, y), M = 1, V = (x^2 + y^2 + z^2 + eps x^2 z^2)/2; p = (eps). */
void hand_contact_oscillator(size_t steps, size_t count, const hand_stage *stage, const double *p,
                             double *state)
{
    const double eps = p[0];
    double x = state[0], y = state[1], z = state[2];
    double vx = state[3], vy = state[4], vz = state[5];
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            x += s->before * vx;
            y += s->before * vy;
            z += s->before * vz;
            vx -= s->span * (x + eps * x * (z * z));
            vy -= s->span * y;
            vz -= s->span * (z + eps * z * (x * x));
            const double yk = y;
            y += s->after * vy;
            const double share = 1.0 / (1.0 + y * yk), scale = ALLOWED(3) * (1.0 + fabs(y));
            double lack = -(vx + y * vz);
            do {
                const double kappa = lack * share;
                vx += kappa;
                vz += yk * kappa;
                lack = -(vx + y * vz);
            } while (fabs(lack) > scale * largest(vx, vy, vz));
            x += s->after * vx;
            z += s->after * vz;
        }
    state[0] = x, state[1] = y, state[2] = z;
    state[3] = vx, state[4] = vy, state[5] = vz;
}

/* mu = (sin theta, -cos theta, 0), M = diag(m, m, J), V = -m gs x; p = (m, J, gs).  The reaction
 * on the edge is m kappa, so that neither m nor J occurs but in the size of v. */
void hand_knife_edge(size_t steps, size_t count, const hand_stage *stage, const double *p,
                     double *state)
{
    const double gs = p[2], ratio = sqrt(p[1] / p[0]);
    double x = state[0], y = state[1], theta = state[2];
    double vx = state[3], vy = state[4];
    const double omega = state[5], turning = ratio * fabs(omega);
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            x += s->before * vx;
            y += s->before * vy;
            theta += s->before * omega;
            const double sk = sin(theta), ck = cos(theta);
            theta += s->after * omega;
            const double s1 = sin(theta), c1 = cos(theta);
            vx += s->span * gs;
            const double share = 1.0 / (s1 * sk + c1 * ck);
            const double scale = ALLOWED(3) * (fabs(s1) + fabs(c1));
            double lack = c1 * vy - s1 * vx;
            do {
                const double kappa = lack * share;
                vx += sk * kappa;
                vy -= ck * kappa;
                lack = c1 * vy - s1 * vx;
            } while (fabs(lack) > scale * largest(vx, vy, turning));
            x += s->after * vx;
            y += s->after * vy;
        }
    state[0] = x, state[1] = y, state[2] = theta;
    state[3] = vx, state[4] = vy;
}

/* v_x = R cos(phi) v_theta, v_y = R sin(phi) v_theta, M = diag(m, m, I, J), V = k sin(theta);
 * p = (m, I, J, R, k).  With e = (cos phi, sin phi) and kappa = m (R v_theta' e' - v)
 *     J (v_theta' - v_theta) = -(a+b) h k cos(theta_k) - R e_k . kappa,
 * and what is found lies in D, for v' is made from it. */
void hand_robot(size_t steps, size_t count, const hand_stage *stage, const double *p,
                double *state)
{
    const double J = p[2], R = p[3], k = p[4], mR = p[0] * R, mRR = mR * R;
    double x = state[0], y = state[1], phi = state[2], theta = state[3];
    double vx = state[4], vy = state[5], roll = state[7];
    const double turn = state[6];
    for (size_t step = 0; step < steps; step++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            x += s->before * vx;
            y += s->before * vy;
            phi += s->before * turn;
            theta += s->before * roll;
            const double sk = sin(phi), ck = cos(phi);
            phi += s->after * turn;
            const double s1 = sin(phi), c1 = cos(phi);
            const double lack_x = vx - R * c1 * roll, lack_y = vy - R * s1 * roll;
            roll += (mR * (ck * lack_x + sk * lack_y) - s->span * k * cos(theta))
                  / (J + mRR * (ck * c1 + sk * s1));
            vx = R * c1 * roll;
            vy = R * s1 * roll;
            x += s->after * vx;
            y += s->after * vy;
            theta += s->after * roll;
        }
    state[0] = x, state[1] = y, state[2] = phi, state[3] = theta;
    state[4] = vx, state[5] = vy, state[7] = roll;
}

/* mu = (-sin theta, cos theta, -a), M = diag(m, m, J), V = k (x^2 + y^2)/2; p = (m, J, a, k).  The
 * reaction turns the sleigh: Newton in the number kappa, from those of the stages before. */
void hand_sleigh(size_t steps, size_t count, const hand_stage *stage, const double *p,
                 double *state)
{
    const double light = 1.0 / p[0], arm = p[2], lever = arm / p[1], pull = p[3] * light;
    const double ratio = sqrt(p[1] / p[0]), reach = fabs(arm) / ratio;
    double x = state[0], y = state[1], theta = state[2];
    double vx = state[3], vy = state[4], omega = state[5];
    double one = 0.0, two = 0.0, three = 0.0; /* kappa of the stages before */
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            x += s->before * vx;
            y += s->before * vy;
            theta += s->before * omega;
            const double sk = light * sin(theta), ck = light * cos(theta);
            vx -= s->span * (pull * x);
            vy -= s->span * (pull * y);
            double kappa = s->ahead[0] * one + s->ahead[1] * two + s->ahead[2] * three;
            double ux = vx - sk * kappa, uy = vy + ck * kappa, turn = omega - lever * kappa;
            double angle = theta + s->after * turn;
            double s1 = sin(angle), c1 = cos(angle);
            const double share = 1.0 / (s1 * sk + c1 * ck + lever * (arm
                                        + s->after * (c1 * ux + s1 * uy)));
            double lack = s1 * ux - c1 * uy + arm * turn;
            double change = 1.0; /* of the angle */
            for (int tries = 0; fabs(change) > 0x1p-17 && tries < 16; tries++) {
                kappa += lack * share;
                ux = vx - sk * kappa, uy = vy + ck * kappa, turn = omega - lever * kappa;
                change = theta + s->after * turn - angle;
                angle += change;
                if (fabs(change) > 0x1p-17) {
                    s1 = sin(angle), c1 = cos(angle);
                } else { /* change^3/6 is less than a rounding */
                    const double sine = s1, half = 0.5 * change;
                    s1 += change * (c1 - half * s1);
                    c1 -= change * (sine + half * c1);
                }
                lack = s1 * ux - c1 * uy + arm * turn;
            }
            if (fabs(lack) > ALLOWED(3) * (fabs(s1) + fabs(c1) + reach)
                                 * largest(ux, uy, ratio * turn)) { /* a rounding of the angle */
                kappa += lack * share;
                ux = vx - sk * kappa, uy = vy + ck * kappa, turn = omega - lever * kappa;
            }
            three = two, two = one, one = kappa;
            theta = angle, omega = turn;
            vx = ux, vy = uy;
            x += s->after * vx;
            y += s->after * vy;
        }
    state[0] = x, state[1] = y, state[2] = theta;
    state[3] = vx, state[4] = vy, state[5] = omega;
}
