/* Vehicles: several bodies in the plane, each on a wheel or a blade. */
#include "system/builtin/builtin.h"

#include <stdio.h>

/* ---- snakeboard: q = (x, y, theta, psi, phi) ----------------------------------------------
 * A board with heading theta, a rotor at psi to it, and an axle at either end, a distance r from
 * the middle and turned by phi and -phi. */

/* L = (m (x'^2 + y'^2 + r^2 theta'^2) + J0 psi'^2)/2 + J0 psi' theta' + J1 phi'^2 */
static void snakeboard_mass(const double *p, double *M)
{
    const double m = p[0], r = p[1], J0 = p[2], J1 = p[3];
    set(M, 25, (double[25]){[0] = m, [6] = m, [12] = m * r * r, J0, [17] = J0, J0, [24] = 2 * J1});
}

static int snakeboard_check(const double *p, dal_error *error)
{
    const double m = p[0], r = p[1], J0 = p[2];
    if (m * r * r > J0) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "parameters m = %.15g, r = %.15g, J0 = %.15g of "
                     "snakeboard: expected m r^2 > J0, but m r^2 is %.15g", m, r, J0, m * r * r);
}

static void snakeboard_state(const double *p, double *x)
{
    const double r = p[1], phi = 0.4, turn = 0.3;
    set(x, 10, (double[10]){[4] = phi, -r * turn / tan(phi), 0.0, turn, 0.5, 0.05});
}

/* The axles move along themselves only: their normals are (-sin, cos) of theta +- phi.  By the
 * addition theorems, because theta + phi is rounded, and theta may be large. */
CONSTRAINT(snakeboard_constraint)
{
    const double *p = ctx, r = p[1];
    const double heading[2] = {cos(q[2]), sin(q[2])}, turn[2] = {cos(q[4]), sin(q[4])};
    for (size_t i = 0; i < 2; i++) {
        const double arm = i == 0 ? -r : r, sign = i == 0 ? 1.0 : -1.0;
        const double s = heading[1] * turn[0] + sign * (heading[0] * turn[1]);
        const double c = heading[0] * turn[0] - sign * (heading[1] * turn[1]);
        if (phi) phi[i] = c * v[1] - s * v[0] + arm * turn[0] * v[2];
        if (phi_v) set(phi_v + 5 * i, 5, (double[]){-s, c, arm * turn[0], 0.0, 0.0});
        const double turned = -c * v[0] - s * v[1];
        if (phi_q)
            set(phi_q + 5 * i, 5, (double[]){0.0, 0.0, turned, 0.0,
                                             sign * turned - arm * turn[1] * v[2]});
    }
    return 0;
}

/* No constraint acts on phi or psi. */
INVARIANT(snakeboard_invariant)
{
    const double *p = ctx;
    values[0] = x[9];
    values[1] = p[2] * (x[8] + x[7]);
    return 0;
}

const builtin dal__snakeboard = {
    .name = "snakeboard",
    .help = "snakeboard (m, half length r) with rotor J0 (psi) and axles J1 turned by phi and -phi",
    .description = "A board with midpoint (x, y) and heading theta carries a rotor at angle psi to "
                   "it (inertia J0). An axle (inertia J1) at either end, a distance r from the "
                   "midpoint, is turned by phi and -phi. The total mass is m, and the total "
                   "inertia about the midpoint is `m r^2`, which is larger than J0.",
    .source = "J. Ostrowski, A. Lewis, R. Murray, J. Burdick: Nonholonomic mechanics and "
              "locomotion: the snakeboard example, IEEE Int. Conf. Robot. Autom. (1994); "
              "A. M. Bloch, P. S. Krishnaprasad, J. E. Marsden, R. M. Murray: Nonholonomic "
              "mechanical systems with symmetry, Arch. Ration. Mech. Anal. 136 (1996) 21-99",
    .formulas = "L = (m (v_x^2 + v_y^2 + r^2 v_theta^2) + J0 v_psi^2)/2 + J0 v_psi v_theta "
                "+ J1 v_phi^2\n"
                "v_y cos(theta + phi) - v_x sin(theta + phi) - r v_theta cos(phi) = 0\n"
                "v_y cos(theta - phi) - v_x sin(theta - phi) + r v_theta cos(phi) = 0",
    .m = 2, .coordinates = {"x", "y", "theta", "psi", "phi"},
    .parameters = {{"m", 1.0}, {"r", 0.5}, {"J0", 0.1}, {"J1", 0.05}},
    .check = snakeboard_check,
    .mass = snakeboard_mass,
    .state = snakeboard_state,
    .constraint = snakeboard_constraint,
    .invariants = {"v_phi", "J0 (v_psi + v_theta)"}, .invariant = snakeboard_invariant,
};

/* ---- n_trailer: q = (x, y, theta0, ..., theta_N) -------------------------------------------
 * Axles 0 ... N of mass m and inertia J in a chain: axle i stands at p_i = p_(i-1) - d e_i with
 * e_i = (cos theta_i, sin theta_i), and moves along e_i only; p_0 = (x, y).  n_i below is e_i
 * turned by a right angle, so that e_i' = theta_i' n_i and n_i' = -theta_i' e_i. */

enum { MAX_TRAILERS = 50 };

typedef struct plane {
    double x, y;
} plane;

static double dot(plane a, plane b) { return a.x * b.x + a.y * b.y; }

/* What a callback computes first: the directions of the axles, and their velocities p_i'. */
typedef struct chain {
    size_t trailers;
    double d, m, J;
    plane e[MAX_TRAILERS + 1], normal[MAX_TRAILERS + 1], velocity[MAX_TRAILERS + 1];
} chain;

static size_t n_trailer_trailers(const double *p) { return (size_t)p[0]; }

static void n_trailer_chain(const double *p, const double *q, const double *v, chain *all)
{
    all->trailers = n_trailer_trailers(p);
    all->d = p[1];
    all->m = p[2];
    all->J = p[3];
    for (size_t i = 0; i <= all->trailers; i++) {
        const double c = cos(q[2 + i]), s = sin(q[2 + i]);
        all->e[i] = (plane){c, s};
        all->normal[i] = (plane){-s, c};
        if (i == 0) {
            all->velocity[0] = (plane){v[0], v[1]};
        } else {
            const plane before = all->velocity[i - 1], n = all->normal[i];
            const double swing = all->d * v[2 + i];
            all->velocity[i] = (plane){before.x - swing * n.x, before.y - swing * n.y};
        }
    }
}

static void n_trailer_sizes(const double *p, size_t *n, size_t *m)
{
    *n = n_trailer_trailers(p) + 3;
    *m = n_trailer_trailers(p) + 1;
}

static void n_trailer_coordinate(const double *p, size_t i, char text[NAME_SIZE])
{
    (void)p;
    if (i < 2) snprintf(text, NAME_SIZE, "%c", i == 0 ? 'x' : 'y');
    else snprintf(text, NAME_SIZE, "theta%zu", i - 2);
}

/* The first axle drives at speed 1 and turns by 1/2; from the fourth trailer on the chain is
 * straight.  An axle that drives at speed u pulls the next one at u cos, and turns it by u sin / d
 * of the angle between them. */
static void n_trailer_state(const double *p, double *x)
{
    static const double first[4] = {0.2, 0.5, 0.3, 0.0};
    const size_t trailers = n_trailer_trailers(p), n = trailers + 3;
    double speed = 1.0;
    for (size_t i = 0; i <= trailers; i++) x[2 + i] = first[i < 4 ? i : 3];
    x[n] = speed * cos(first[0]);
    x[n + 1] = speed * sin(first[0]);
    x[n + 2] = 0.5;
    for (size_t i = 1; i <= trailers; i++) {
        const double bend = x[1 + i] - x[2 + i];
        x[n + 2 + i] = speed * sin(bend) / p[1];
        speed *= cos(bend);
    }
}

/* m of axles k ... N */
static double mass_behind(const chain *all, size_t k)
{
    return all->m * (double)(all->trailers + 1 - k);
}

/* What axle k > 0 adds to the second derivatives of L: those by theta_k and x, y, theta_j, j <= k,
 * or by their velocities. */
static void second_derivatives(const chain *all, const double *turn, size_t k, plane P,
                               double *L_qq, double *L_vq, double *L_vv)
{
    const size_t n = all->trailers + 3, at = 2 + k;
    const plane e = all->e[k], nk = all->normal[k];
    const double d = all->d, w = mass_behind(all, k);
    if (L_vq) {
        L_vq[at] = w * d * turn[k] * e.x;
        L_vq[n + at] = w * d * turn[k] * e.y;
    }
    if (L_vv) {
        L_vv[at] = L_vv[at * n] = -w * d * nk.x;
        L_vv[n + at] = L_vv[at * n + 1] = -w * d * nk.y;
    }
    for (size_t j = 1; j <= k; j++) {
        const size_t to = 2 + j;
        const double same = w * d * d * dot(e, all->e[j]), cross = w * d * d * dot(nk, all->e[j]);
        if (L_qq) L_qq[at * n + to] = L_qq[to * n + at] = turn[k] * turn[j] * same;
        if (L_vq) {
            L_vq[at * n + to] = -turn[j] * cross;
            L_vq[to * n + at] = turn[k] * cross; /* n_j e_k = -n_k e_j */
        }
        if (L_vv) L_vv[at * n + to] = L_vv[to * n + at] = same;
    }
    if (L_qq) L_qq[at * n + at] += d * turn[k] * dot(nk, P);
    if (L_vq) L_vq[at * n + at] = d * dot(e, P);
    if (L_vv) L_vv[at * n + at] += all->J;
}

/* L = sum_i (m |p_i'|^2 + J theta_i'^2)/2.  With P_k = m (p_k' + ... + p_N'), the momentum of what
 * hangs at axle k: dL/dtheta_k' = J theta_k' - d n_k P_k and dL/dtheta_k = d theta_k' e_k P_k for
 * k > 0; and P_k changes by -w d n_j with theta_j' and by w d theta_j' e_j with theta_j, where w is
 * the mass behind both k and j. */
LAGRANGIAN(n_trailer_lagrangian)
{
    chain all;
    n_trailer_chain(ctx, q, v, &all);
    const size_t N = all.trailers, n = N + 3;
    const double *turn = v + 2;
    if (L) {
        *L = 0.0;
        for (size_t i = 0; i <= N; i++)
            *L += (all.m * dot(all.velocity[i], all.velocity[i]) + all.J * turn[i] * turn[i]) / 2;
    }
    dal__clear(n, L_q);
    dal__clear(n * n, L_qq);
    dal__clear(n * n, L_vq);
    dal__clear(n * n, L_vv);
    if (L_vv) {
        L_vv[0] = L_vv[n + 1] = mass_behind(&all, 0);
        L_vv[2 * n + 2] = all.J;
    }
    plane P = {0.0, 0.0};
    for (size_t k = N; k > 0; k--) {
        P.x += all.m * all.velocity[k].x;
        P.y += all.m * all.velocity[k].y;
        if (L_v) L_v[2 + k] = all.J * turn[k] - all.d * dot(all.normal[k], P);
        if (L_q) L_q[2 + k] = all.d * turn[k] * dot(all.e[k], P);
        second_derivatives(&all, turn, k, P, L_qq, L_vq, L_vv);
    }
    if (L_v) {
        L_v[0] = P.x + all.m * v[0];
        L_v[1] = P.y + all.m * v[1];
        L_v[2] = all.J * turn[0];
    }
    return 0;
}

/* n_i p_i' = 0 */
CONSTRAINT(n_trailer_constraint)
{
    chain all;
    n_trailer_chain(ctx, q, v, &all);
    const size_t N = all.trailers, n = N + 3;
    dal__clear((N + 1) * n, phi_v);
    dal__clear((N + 1) * n, phi_q);
    for (size_t i = 0; i <= N; i++) {
        const plane nk = all.normal[i];
        double *const mu = phi_v ? phi_v + i * n : NULL;
        double *const slope = phi_q ? phi_q + i * n : NULL;
        if (phi) phi[i] = dot(nk, all.velocity[i]);
        if (mu) {
            mu[0] = nk.x;
            mu[1] = nk.y;
        }
        for (size_t j = 1; j <= i; j++) {
            if (mu) mu[2 + j] = -all.d * dot(nk, all.normal[j]);
            if (slope) slope[2 + j] = all.d * v[2 + j] * dot(nk, all.e[j]);
        }
        if (slope) slope[2 + i] -= dot(all.e[i], all.velocity[i]);
    }
    return 0;
}

/* No constraint acts on the heading of the first axle, and it moves nothing else. */
INVARIANT(n_trailer_invariant)
{
    values[0] = x[n_trailer_trailers(ctx) + 5];
    return 0;
}

const builtin dal__n_trailer = {
    .name = "n_trailer",
    .help = "axle that pulls a chain of trailers on bars of length d; each has mass m, inertia J",
    .description = "A chain of axles 0, 1, ..., trailers of mass m and inertia J. (x, y) is the "
                   "midpoint of the first, `theta_i` the heading of axle i. A bar of length d "
                   "along its own heading connects each axle to the one in front. No axle slides "
                   "sideways; `u_i` and `w_i` are the components of the velocity of axle i.",
    .source = "A. Bravo-Doddoli, L. C. García-Naranjo: The dynamics of an articulated n-trailer "
              "vehicle, Regul. Chaotic Dyn. 20 (2015) 497-517",
    .formulas = "L = sum_i(m (u_i^2 + w_i^2) + J v_theta_i^2)/2\n"
                "w_i cos(theta_i) - u_i sin(theta_i) = 0\n"
                "where u_0 = v_x\n"
                "where w_0 = v_y\n"
                "where u_i = u_(i-1) + d v_theta_i sin(theta_i)\n"
                "where w_i = w_(i-1) - d v_theta_i cos(theta_i)",
    .sizes = n_trailer_sizes, .coordinate = n_trailer_coordinate,
    .parameters = {{"trailers", 3.0, WHOLE, MAX_TRAILERS}, {"d", 1.0}, {"m", 1.0}, {"J", 0.1}},
    .state = n_trailer_state,
    .lagrangian = n_trailer_lagrangian,
    .constraint = n_trailer_constraint,
    .invariants = {"v_theta0"}, .invariant = n_trailer_invariant,
};
