/* hand_stages.c - a stage of leapfrog with a potential as one writes it by hand for one system, who
 * knows its formulas: what the stage of the library is compared with.
 *
 *     q_k = q + a h v,      M (v' - v) = -(a+b) h V_q(q_k) + mu(q_k)^T kappa,
 *     q' = q_k + b h v',    mu(q') v' = 0
 *
 * Where mu depends on coordinates that kappa does not push, q' is known as far as mu asks for it,
 * and the equation for kappa is linear.  kappa is found from what mu(q') v' lacks, and what is left
 * of that is looked at, as the library does: D is kept to roundoff.  The compensated sums are those
 * of the library; where the formulas for kappa are its formulas too, the states have its bits. */
#include "hand_stages.h"
#include "hand_sum.h"

#include <float.h>
#include <math.h>

/* What may be left of mu v', for n = 3 or 4, in units of |mu| |v|. */
#define ALLOWED(n) ((n) * DBL_EPSILON)

#define HAND_ARGUMENTS \
    size_t steps, size_t count, const hand_stage *stage, const double *p, double *state

/* Begins the loop of a system, of which both functions of hand_stages.h are made. */
#define HAND(system) \
    HAND_INLINE void system(bool compensated, HAND_ARGUMENTS); \
    void hand_compensated_##system(HAND_ARGUMENTS) \
    { \
        system(true, steps, count, stage, p, state); \
    } \
    void hand_plain_##system(HAND_ARGUMENTS) \
    { \
        system(false, steps, count, stage, p, state); \
    } \
    HAND_INLINE void system(bool compensated, HAND_ARGUMENTS)

static inline double larger(double x, double y) { return x > y ? x : y; }

static inline double largest(double x, double y, double z)
{
    return larger(larger(fabs(x), fabs(y)), fabs(z));
}

/* mu = (a, 0, c), of which one is 1 and the other one depends on y, and M = 1: the loop of both
 * oscillators, with V = (k1 x^2 + k2 y^2 + k3 z^2)/2, p = (k1, k2, k3) and mu = (-y, 0, 1), or with
 * contact V = (x^2 + y^2 + z^2 + eps x^2 z^2)/2, p = (eps) and mu = (1, 0, y). */
HAND_INLINE void oscillator(bool contact, bool compensated, HAND_ARGUMENTS)
{
    hand_sum x = hand_sum_of(state[0]), y = hand_sum_of(state[1]), z = hand_sum_of(state[2]);
    hand_sum vx = hand_sum_of(state[3]), vy = hand_sum_of(state[4]), vz = hand_sum_of(state[5]);
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            const double wx = s->before * vx.x, wy = s->before * vy.x, wz = s->before * vz.x;
            const double xk = x.x + wx, yk = y.x + wy, zk = z.x + wz;
            hand_way to_x = hand_pass(x, xk, wx), to_y = hand_pass(y, yk, wy);
            hand_way to_z = hand_pass(z, zk, wz);
            hand_way ux = hand_start(vx), uy = hand_start(vy), uz = hand_start(vz);
            const double fx = contact ? xk * (1.0 + p[0] * (zk * zk)) : p[0] * xk;
            const double fy = contact ? yk : p[1] * yk;
            const double fz = contact ? zk * (1.0 + p[0] * (xk * xk)) : p[2] * zk;
            hand_go(&ux, -(s->span * fx));
            hand_go(&uy, -(s->span * fy));
            hand_go(&uz, -(s->span * fz));
            hand_end(compensated, &vy, uy);
            hand_go(&to_y, s->after * vy.x);
            hand_end(compensated, &y, to_y);
            const double ak = contact ? 1.0 : -yk, ck = contact ? yk : 1.0;
            const double a = contact ? 1.0 : -y.x, c = contact ? y.x : 1.0;
            const double share = 1.0 / (1.0 + y.x * yk), scale = ALLOWED(3) * (1.0 + fabs(y.x));
            double lack = -(a * ux.next + c * uz.next);
            do {
                const double kappa = lack * share;
                hand_go(&ux, ak * kappa);
                hand_go(&uz, ck * kappa);
                lack = -(a * ux.next + c * uz.next);
            } while (fabs(lack) > scale * largest(ux.next, vy.x, uz.next));
            hand_end(compensated, &vx, ux);
            hand_end(compensated, &vz, uz);
            hand_go(&to_x, s->after * vx.x);
            hand_go(&to_z, s->after * vz.x);
            hand_end(compensated, &x, to_x);
            hand_end(compensated, &z, to_z);
        }
    state[0] = x.x, state[1] = y.x, state[2] = z.x;
    state[3] = vx.x, state[4] = vy.x, state[5] = vz.x;
}

HAND(particle_oscillator)
{
    oscillator(false, compensated, steps, count, stage, p, state);
}

HAND(contact_oscillator)
{
    oscillator(true, compensated, steps, count, stage, p, state);
}

/* mu = (sin theta, -cos theta, 0), M = diag(m, m, J), V = -m gs x; p = (m, J, gs).  The reaction
 * on the edge is m kappa, so that neither m nor J occurs but in the size of v. */
HAND(knife_edge)
{
    const double gs = p[2], ratio = sqrt(p[1] / p[0]);
    const double omega = state[5], turning = ratio * fabs(omega);
    hand_sum x = hand_sum_of(state[0]), y = hand_sum_of(state[1]), theta = hand_sum_of(state[2]);
    hand_sum vx = hand_sum_of(state[3]), vy = hand_sum_of(state[4]);
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            const double wx = s->before * vx.x, wy = s->before * vy.x, turn = s->before * omega;
            const double node = theta.x + (0.5 * theta.low + turn);
            hand_way to_x = hand_pass(x, x.x + wx, wx), to_y = hand_pass(y, y.x + wy, wy);
            hand_end(compensated, &theta, hand_turn(theta, node, turn, s->after * omega,
                                                    s->before == s->after));
            const double sk = sin(node), ck = cos(node), s1 = sin(theta.x), c1 = cos(theta.x);
            hand_way ux = hand_start(vx), uy = hand_start(vy);
            hand_go(&ux, s->span * gs);
            const double share = 1.0 / (s1 * sk + c1 * ck);
            const double scale = ALLOWED(3) * (fabs(s1) + fabs(c1));
            double lack = c1 * uy.next - s1 * ux.next;
            do {
                const double kappa = lack * share;
                hand_go(&ux, sk * kappa);
                hand_go(&uy, -ck * kappa);
                lack = c1 * uy.next - s1 * ux.next;
            } while (fabs(lack) > scale * largest(ux.next, uy.next, turning));
            hand_end(compensated, &vx, ux);
            hand_end(compensated, &vy, uy);
            hand_go(&to_x, s->after * vx.x);
            hand_go(&to_y, s->after * vy.x);
            hand_end(compensated, &x, to_x);
            hand_end(compensated, &y, to_y);
        }
    state[0] = x.x, state[1] = y.x, state[2] = theta.x;
    state[3] = vx.x, state[4] = vy.x;
}

/* v_x = R cos(phi) v_theta, v_y = R sin(phi) v_theta, M = diag(m, m, I, J), V = k sin(theta);
 * p = (m, I, J, R, k).  With e = (cos phi, sin phi) and kappa = m (v' - v)
 *     J (v_theta' - v_theta) = -(a+b) h k cos(theta_k) - R e_k . kappa,
 * and what is left of mu v' are the roundings of kappa and v'. */
HAND(robot)
{
    const double J = p[2], R = p[3], mR = p[0] * R, mRR = mR * R, pull = p[4] / J;
    const double turn = state[6];
    hand_sum x = hand_sum_of(state[0]), y = hand_sum_of(state[1]), phi = hand_sum_of(state[2]);
    hand_sum theta = hand_sum_of(state[3]), roll = hand_sum_of(state[7]);
    hand_sum vx = hand_sum_of(state[4]), vy = hand_sum_of(state[5]);
    for (size_t step = 0; step < steps; step++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            const double wx = s->before * vx.x, wy = s->before * vy.x, way = s->before * roll.x;
            const double turned = s->before * turn, node = phi.x + (0.5 * phi.low + turned);
            const double theta_k = theta.x + way;
            hand_way to_x = hand_pass(x, x.x + wx, wx), to_y = hand_pass(y, y.x + wy, wy);
            hand_way to_theta = hand_pass(theta, theta_k, way);
            hand_end(compensated, &phi, hand_turn(phi, node, turned, s->after * turn,
                                                  s->before == s->after));
            const double sk = sin(node), ck = cos(node), s1 = sin(phi.x), c1 = cos(phi.x);
            hand_way ux = hand_start(vx), uy = hand_start(vy), faster = hand_start(roll);
            hand_go(&faster, -(s->span * (pull * cos(theta_k))));
            const double share = mR / (J + mRR * (ck * c1 + sk * s1));
            const double lack_x = R * c1 * faster.next - ux.next;
            const double lack_y = R * s1 * faster.next - uy.next;
            const double change = -(share * (ck * lack_x + sk * lack_y));
            hand_go(&faster, change);
            hand_go(&ux, lack_x + R * c1 * change);
            hand_go(&uy, lack_y + R * s1 * change);
            hand_end(compensated, &roll, faster);
            hand_end(compensated, &vx, ux);
            hand_end(compensated, &vy, uy);
            hand_go(&to_x, s->after * vx.x);
            hand_go(&to_y, s->after * vy.x);
            hand_go(&to_theta, s->after * roll.x);
            hand_end(compensated, &x, to_x);
            hand_end(compensated, &y, to_y);
            hand_end(compensated, &theta, to_theta);
        }
    state[0] = x.x, state[1] = y.x, state[2] = phi.x, state[3] = theta.x;
    state[4] = vx.x, state[5] = vy.x, state[7] = roll.x;
}

/* mu = (-sin theta, cos theta, -a), M = diag(m, m, J), V = k (x^2 + y^2)/2; p = (m, J, a, k).  The
 * reaction turns the sleigh: Newton in the number kappa, from those of the stages before. */
HAND(sleigh)
{
    const double light = 1.0 / p[0], arm = p[2], lever = arm / p[1], pull = p[3] * light;
    const double ratio = sqrt(p[1] / p[0]), reach = fabs(arm) / ratio;
    hand_sum x = hand_sum_of(state[0]), y = hand_sum_of(state[1]), theta = hand_sum_of(state[2]);
    hand_sum vx = hand_sum_of(state[3]), vy = hand_sum_of(state[4]), omega = hand_sum_of(state[5]);
    double one = 0.0, two = 0.0, three = 0.0; /* kappa of the stages before */
    for (size_t k = 0; k < steps; k++)
        for (const hand_stage *s = stage, *const end = stage + count; s < end; s++) {
            const double wx = s->before * vx.x, wy = s->before * vy.x, way = s->before * omega.x;
            const double xk = x.x + wx, yk = y.x + wy, node = theta.x + way;
            hand_way to_x = hand_pass(x, xk, wx), to_y = hand_pass(y, yk, wy);
            hand_way to_theta = hand_pass(theta, node, way);
            const double sk = light * sin(node), ck = light * cos(node);
            hand_way ux = hand_start(vx), uy = hand_start(vy), turn = hand_start(omega);
            hand_go(&ux, -(s->span * (pull * xk)));
            hand_go(&uy, -(s->span * (pull * yk)));
            double kappa = s->ahead[0] * one + s->ahead[1] * two + s->ahead[2] * three;
            double nx = ux.next - sk * kappa, ny = uy.next + ck * kappa;
            double rate = turn.next - lever * kappa, angle = to_theta.next + s->after * rate;
            double s1 = sin(angle), c1 = cos(angle);
            const double share = 1.0 / (s1 * sk + c1 * ck + lever * (arm
                                        + s->after * (c1 * nx + s1 * ny)));
            double lack = s1 * nx - c1 * ny + arm * rate;
            double change = 1.0; /* of the angle */
            for (int tries = 0; fabs(change) > 0x1p-17 && tries < 16; tries++) {
                kappa += lack * share;
                nx = ux.next - sk * kappa, ny = uy.next + ck * kappa;
                rate = turn.next - lever * kappa;
                change = to_theta.next + s->after * rate - angle;
                angle += change;
                if (fabs(change) > 0x1p-17) {
                    s1 = sin(angle), c1 = cos(angle);
                } else { /* change^3/6 is less than a rounding */
                    const double sine = s1, half = 0.5 * change;
                    s1 += change * (c1 - half * s1);
                    c1 -= change * (sine + half * c1);
                }
                lack = s1 * nx - c1 * ny + arm * rate;
            }
            if (fabs(lack) > ALLOWED(3) * (fabs(s1) + fabs(c1) + reach)
                                 * largest(nx, ny, ratio * rate)) /* a rounding of the angle */
                kappa += lack * share;
            three = two, two = one, one = kappa;
            hand_go(&ux, -sk * kappa);
            hand_go(&uy, ck * kappa);
            hand_go(&turn, -lever * kappa);
            hand_end(compensated, &vx, ux);
            hand_end(compensated, &vy, uy);
            hand_end(compensated, &omega, turn);
            hand_go(&to_x, s->after * vx.x);
            hand_go(&to_y, s->after * vy.x);
            hand_go(&to_theta, s->after * omega.x);
            hand_end(compensated, &x, to_x);
            hand_end(compensated, &y, to_y);
            hand_end(compensated, &theta, to_theta);
        }
    state[0] = x.x, state[1] = y.x, state[2] = theta.x;
    state[3] = vx.x, state[4] = vy.x, state[5] = omega.x;
}
