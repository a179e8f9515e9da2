/* Floor 2: bodies that roll without slipping on a plane. */
#include "systems.h"

/* M = diag(m, m, I, J) */
static void wheel_mass(const double *p, double *M)
{
    M[0] = M[5] = p[0];
    M[10] = p[1];
    M[15] = p[2];
}

/* Rolling without slipping of a wheel of radius R in the plane of x, y = q[0], q[1]: x' = R roll'
 * cos heading, y' = R roll' sin heading, with roll and heading the places of the angles in q. */
static inline void constraint_rolling(size_t roll, size_t heading, double R, const double *q,
                                      const double *v, double *phi, double *phi_v, double *phi_q)
{
    const double Rc = R * cos(q[heading]), Rs = R * sin(q[heading]);
    if (phi) {
        phi[0] = v[0] - Rc * v[roll];
        phi[1] = v[1] - Rs * v[roll];
    }
    if (phi_v) {
        set4(phi_v, 1.0, 0.0, 0.0, 0.0);
        set4(phi_v + 4, 0.0, 1.0, 0.0, 0.0);
        phi_v[roll] = -Rc;
        phi_v[4 + roll] = -Rs;
    }
    if (phi_q) {
        set4(phi_q, 0.0, 0.0, 0.0, 0.0);
        set4(phi_q + 4, 0.0, 0.0, 0.0, 0.0);
        phi_q[heading] = Rs * v[roll];
        phi_q[4 + heading] = -Rc * v[roll];
    }
}

/* ---- disk, vertical, rolling: q = (x, y, theta, phi), theta rolls, phi heads -------------- */

static void disk_state(const double *p, double *x)
{
    const double R = p[3], roll = 1.1, phi = 0.4;
    set4(x, 0.0, 0.0, 0.1, phi);
    set4(x + 4, R * roll * cos(phi), R * roll * sin(phi), roll, 0.9);
}

static int disk_constraint(const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, void *ctx)
{
    const double *p = ctx;
    constraint_rolling(2, 3, p[3], q, v, phi, phi_v, phi_q);
    return 0;
}

/* Both angles turn uniformly; the way is R theta' times the integrals of cos(phi) and sin(phi). */
static int disk_exact(double t, const double *x0, double *x, void *ctx)
{
    const double *p = ctx, speed = p[3] * x0[6], roll = x0[6], turn = x0[7];
    const double middle = x0[3] + turn * t / 2, phi = x0[3] + turn * t;
    const double way = speed * t * sinc(turn * t / 2);
    set4(x, x0[0] + way * cos(middle), x0[1] + way * sin(middle), x0[2] + roll * t, phi);
    set4(x + 4, speed * cos(phi), speed * sin(phi), roll, turn);
    return 0;
}

static int disk_invariant(const double *x, double *values, void *ctx)
{
    (void)ctx;
    values[0] = x[6];
    values[1] = x[7];
    return 0;
}

const builtin dal__disk = {
    .name = "disk",
    .help = "vertical rolling disk of radius R; inertia I rolling (theta), J heading (phi)",
    .n = 4, .m = 2, .coordinates = {"x", "y", "theta", "phi"},
    .parameters = {"m", "I", "J", "R"}, .defaults = {1.2, 0.5, 0.3, 0.7},
    .ranges = {POSITIVE, POSITIVE, POSITIVE, POSITIVE},
    .mass = wheel_mass,
    .state = disk_state,
    .constraint = disk_constraint,
    .exact = disk_exact,
    .invariants = {"v_theta", "v_phi"}, .invariant = disk_invariant,
};

/* ---- robot: q = (x, y, phi, theta), phi heads, theta rolls ------------------------------- */

static void robot_state(const double *p, double *x)
{
    set4(x + 4, p[3], 0.0, 0.5, 1.0);
}

/* V = k sin theta */
static int robot_potential(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *p = ctx, k = p[4];
    if (V) *V = k * sin(q[3]);
    if (V_q) set4(V_q, 0.0, 0.0, 0.0, k * cos(q[3]));
    if (V_qq) {
        for (size_t i = 0; i < 15; i++) V_qq[i] = 0.0;
        V_qq[15] = -k * sin(q[3]);
    }
    return 0;
}

static int robot_constraint(const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, void *ctx)
{
    const double *p = ctx;
    constraint_rolling(3, 2, p[3], q, v, phi, phi_v, phi_q);
    return 0;
}

/* phi is free, and (J + m R^2) theta'' = -k cos(theta). */
static int robot_invariant(const double *x, double *values, void *ctx)
{
    const double *p = ctx, inertia = p[2] + p[0] * p[3] * p[3];
    values[0] = x[6];
    values[1] = inertia * x[7] * x[7] / 2 + p[4] * sin(x[3]);
    return 0;
}

const builtin dal__robot = {
    .name = "robot",
    .help = "rolling robot with V = k sin(theta); inertia I heading (phi), J rolling (theta)",
    .n = 4, .m = 2, .coordinates = {"x", "y", "phi", "theta"},
    .parameters = {"m", "I", "J", "R", "k"}, .defaults = {1.0, 1.0, 1.0, 1.0, 10.0},
    .ranges = {POSITIVE, POSITIVE, POSITIVE, POSITIVE, FINITE},
    .mass = wheel_mass,
    .state = robot_state,
    .potential = robot_potential,
    .constraint = robot_constraint,
    .invariants = {"v_phi", "(J + m R^2) v_theta^2/2 + k sin(theta)"},
    .invariant = robot_invariant,
};
