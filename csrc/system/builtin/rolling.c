/* Bodies that roll without slipping on a plane. */
#include "system/builtin/builtin.h"

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
    set(x, 8, (double[]){0.0, 0.0, 0.1, phi, R * roll * cos(phi), R * roll * sin(phi), roll, 0.9});
}

CONSTRAINT(disk_constraint)
{
    const double *p = ctx;
    constraint_rolling(2, 3, p[3], q, v, phi, phi_v, phi_q);
    return 0;
}

/* Both angles turn uniformly; the way is R theta' times the integrals of cos(phi) and sin(phi). */
EXACT(disk_exact)
{
    const double *p = ctx, speed = p[3] * x0[6], roll = x0[6], turn = x0[7];
    const double middle = x0[3] + turn * t / 2, phi = x0[3] + turn * t;
    const double way = speed * t * sinc(turn * t / 2);
    set(x, 8, (double[]){x0[0] + way * cos(middle), x0[1] + way * sin(middle), x0[2] + roll * t,
                         phi, speed * cos(phi), speed * sin(phi), roll, turn});
    return 0;
}

INVARIANT(disk_invariant)
{
    values[0] = x[6];
    values[1] = x[7];
    return 0;
}

const builtin dal__disk = {
    .name = "disk",
    .help = "vertical rolling disk of radius R; inertia I rolling (theta), J heading (phi)",
    .description = "A disk of mass m and radius R that stays upright. (x, y) is the point of "
                   "contact, theta the rolling angle (inertia I), phi the heading (inertia J). "
                   "Both angles change uniformly, and the path is a circle.",
    .source = "J. I. Neimark, N. A. Fufaev: Dynamics of Nonholonomic Systems, AMS, 1972; "
              "A. M. Bloch: Nonholonomic Mechanics and Control, Springer, 2003",
    .formulas = "L = (m (v_x^2 + v_y^2) + I v_theta^2 + J v_phi^2)/2\n"
                "v_x - R v_theta cos(phi) = 0\n"
                "v_y - R v_theta sin(phi) = 0",
    .m = 2, .coordinates = {"x", "y", "theta", "phi"},
    .parameters = {{"m", 1.2}, {"I", 0.5}, {"J", 0.3}, {"R", 0.7}},
    .diagonal = {1, 1, 2, 3},
    .state = disk_state,
    .constraint = disk_constraint, .steady = DAL_STEADY_CONSTANT_RATE,
    .exact = disk_exact,
    .invariants = {"v_theta", "v_phi"}, .invariant = disk_invariant,
};

/* ---- robot: q = (x, y, phi, theta), phi heads, theta rolls ------------------------------- */

static void robot_state(const double *p, double *x)
{
    set(x, 8, (double[8]){[4] = p[3], [6] = 0.5, [7] = 1.0});
}

/* V = k sin theta */
POTENTIAL(robot_potential)
{
    const double *p = ctx, k = p[4];
    if (V) *V = k * sin(q[3]);
    if (V_q) set4(V_q, 0.0, 0.0, 0.0, k * cos(q[3]));
    if (V_qq) set(V_qq, 16, (double[16]){[15] = -k * sin(q[3])});
    return 0;
}

CONSTRAINT(robot_constraint)
{
    const double *p = ctx;
    constraint_rolling(3, 2, p[3], q, v, phi, phi_v, phi_q);
    return 0;
}

/* phi is free, and (J + m R^2) theta'' = -k cos(theta). */
INVARIANT(robot_invariant)
{
    const double *p = ctx, inertia = p[2] + p[0] * p[3] * p[3];
    values[0] = x[6];
    values[1] = inertia * x[7] * x[7] / 2 + p[4] * sin(x[3]);
    return 0;
}

const builtin dal__robot = {
    .name = "robot",
    .help = "rolling robot with V = k sin(theta); inertia I heading (phi), J rolling (theta)",
    .description = "A robot of mass m on wheels of radius R. (x, y) is its position, phi its "
                   "heading (inertia I), theta the rolling angle of the wheels (inertia J). A "
                   "torque from the potential k sin(theta) acts on theta.",
    .source = "J. Cortés, S. Martínez: Non-holonomic integrators, Nonlinearity 14 (2001) 1365-1392",
    .formulas = "L = (m (v_x^2 + v_y^2) + I v_phi^2 + J v_theta^2)/2 - k sin(theta)\n"
                "v_x - R v_theta cos(phi) = 0\n"
                "v_y - R v_theta sin(phi) = 0",
    .m = 2, .coordinates = {"x", "y", "phi", "theta"},
    .parameters = {{"m", 1.0}, {"I", 1.0}, {"J", 1.0}, {"R", 1.0}, {"k", 10.0, FINITE}},
    .diagonal = {1, 1, 2, 3},
    .state = robot_state,
    .potential = robot_potential,
    .constraint = robot_constraint, .steady = DAL_STEADY_CONSTANT_RATE,
    .invariants = {"v_phi", "(J + m R^2) v_theta^2/2 + k sin(theta)"},
    .invariant = robot_invariant,
};

/* ---- rolling_disc, free to lean: q = (x, y, alpha, beta, gamma) ---------------------------
 * (x, y) lies below the centre, alpha is the yaw, beta the lean (0: upright), gamma the spin. */

/* A steady circle about the origin: the lean is 5 degrees, and the yaw rate -rho times that of the
 * spin, rho = 1/10.  With s = sin(beta), c = cos(beta) the lean keeps constant for
 * spin^2 rho c ((C + m r^2)(1 - rho s) + A rho s) = m g r s. */
static void rolling_disc_state(const double *p, double *x)
{
    const double m = p[0], r = p[1], A = p[2], C = p[3], g = p[4];
    const double beta = 0.08726646259971647885 /* pi/36 */, rho = 0.1;
    const double s = sin(beta), c = cos(beta);
    const double pull = m * g * r * s / (rho * c);
    const double spin = sqrt(pull / ((C + m * r * r) * (1 - rho * s) + A * rho * s));
    x[1] = r * (1 / rho - s);
    x[3] = beta;
    x[5] = r * (spin - rho * spin * s);
    x[7] = -rho * spin;
    x[9] = spin;
}

/* L = (m (x'^2 + y'^2 + r^2 s^2 beta'^2) + A (beta'^2 + c^2 alpha'^2) + C omega^2)/2 - m g r c with
 * s = sin(beta), c = cos(beta), omega = gamma' + s alpha' */
LAGRANGIAN(rolling_disc_lagrangian)
{
    const double *p = ctx, m = p[0], r = p[1], A = p[2], C = p[3], weight = m * p[4] * r;
    const double mr2 = m * r * r, s = sin(q[3]), c = cos(q[3]);
    const double yaw = v[2], lean = v[3], omega = v[4] + s * yaw;
    if (L)
        *L = (m * (v[0] * v[0] + v[1] * v[1]) + (A + mr2 * s * s) * lean * lean
              + A * c * c * yaw * yaw + C * omega * omega) / 2 - weight * c;
    if (L_q)
        set(L_q, 5, (double[5]){[3] = s * c * (mr2 * lean * lean - A * yaw * yaw)
                                    + C * omega * c * yaw + weight * s});
    if (L_v)
        set(L_v, 5, (double[]){m * v[0], m * v[1], A * c * c * yaw + C * omega * s,
                               (A + mr2 * s * s) * lean, C * omega});
    if (L_qq)
        set(L_qq, 25, (double[25]){[18] = (c * c - s * s) * (mr2 * lean * lean - A * yaw * yaw)
                                       + C * yaw * (c * c * yaw - s * omega) + weight * c});
    if (L_vq)
        set(L_vq, 25, (double[25]){[13] = -2 * A * s * c * yaw + C * c * (omega + s * yaw),
                                   [18] = 2 * mr2 * s * c * lean, [23] = C * c * yaw});
    if (L_vv)
        set(L_vv, 25, (double[25]){[0] = m, [6] = m, [12] = A * c * c + C * s * s, [14] = C * s,
                                   [18] = A + mr2 * s * s, [22] = C * s, [24] = C});
    return 0;
}

/* The centre moves by r omega along the plane of the disc and by -r (sin beta)' across it:
 * x' = r omega cos(alpha) + r c beta' sin(alpha),
 * y' = r omega sin(alpha) - r c beta' cos(alpha). */
CONSTRAINT(rolling_disc_constraint)
{
    const double *p = ctx, r = p[1], s = sin(q[3]), c = cos(q[3]);
    const double rc = r * cos(q[2]), rs = r * sin(q[2]);
    const double omega = v[4] + s * v[2], sway = c * v[3];
    if (phi) {
        phi[0] = v[0] - rc * omega - rs * sway;
        phi[1] = v[1] - rs * omega + rc * sway;
    }
    if (phi_v)
        set(phi_v, 10, (double[]){1.0, 0.0, -rc * s, -rs * c, -rc,
                                  0.0, 1.0, -rs * s, rc * c, -rs});
    const double omega_beta = c * v[2], sway_beta = -s * v[3];
    if (phi_q)
        set(phi_q, 10, (double[10]){[2] = rs * omega - rc * sway,
                                    [3] = -rc * omega_beta - rs * sway_beta,
                                    [7] = -rc * omega - rs * sway,
                                    [8] = -rs * omega_beta + rc * sway_beta});
    return 0;
}

const builtin dal__rolling_disc = {
    .name = "rolling_disc",
    .help = "rolling disc that may lean and fall, unlike disk; inertia A diametral, C axial",
    .description = "A disc of mass m and radius r under gravity g. (x, y) is the point below its "
                   "centre, alpha the yaw, beta the lean (0: upright), gamma the spin. The inertia "
                   "is A about a diameter, C about the axis. It starts in a steady circle about "
                   "the origin.",
    .source = "O. M. O'Reilly: The dynamics of rolling disks and sliding disks, Nonlinear Dyn. 10 "
              "(1996) 287-305; the steady circle after C. Le Saux, R. I. Leine, C. Glocker: "
              "Dynamics of a rolling disk in the presence of dry friction, J. Nonlinear Sci. 15 "
              "(2005) 27-61",
    .formulas = "L = (m (v_x^2 + v_y^2 + r^2 sin(beta)^2 v_beta^2) + A (v_beta^2 + cos(beta)^2 "
                "v_alpha^2) + C omega^2)/2 - m g r cos(beta)\n"
                "v_x - r omega cos(alpha) - r v_beta cos(beta) sin(alpha) = 0\n"
                "v_y - r omega sin(alpha) + r v_beta cos(beta) cos(alpha) = 0\n"
                "where omega = v_gamma + v_alpha sin(beta)",
    .m = 2, .coordinates = {"x", "y", "alpha", "beta", "gamma"},
    .parameters = {{"m", 1.0}, {"r", 1.0}, {"A", 0.25}, {"C", 0.5}, {"g", 9.81, NOT_NEGATIVE}},
    .state = rolling_disc_state,
    .lagrangian = rolling_disc_lagrangian,
    .constraint = rolling_disc_constraint,
};

/* ---- ball_on_table, which turns by Omega: q = (x, y, theta_x, theta_y, theta_z) -----------
 * The angles are the integrals of the angular velocity in space; a homogeneous ball needs to know
 * nothing else of its orientation. */

static void ball_state(const double *p, double *x)
{
    const double a = p[2], turn = p[3];
    const double X = 0.5, Y = -0.2, vx = 0.3, vy = 0.4;
    set(x, 10, (double[]){X, Y, 0.0, 0.0, 0.0, vx, vy, (turn * X - vy) / a, (turn * Y + vx) / a,
                          0.7});
}

/* The point of contact moves with the table: x' - a omega_y = -Omega y, y' + a omega_x = Omega x */
CONSTRAINT(ball_constraint)
{
    const double *p = ctx, a = p[2], turn = p[3];
    if (phi) {
        phi[0] = v[0] - a * v[3] + turn * q[1];
        phi[1] = v[1] + a * v[2] - turn * q[0];
    }
    if (phi_v) set(phi_v, 10, (double[]){1.0, 0.0, 0.0, -a, 0.0, 0.0, 1.0, a, 0.0, 0.0});
    if (phi_q) set(phi_q, 10, (double[10]){[1] = turn, [5] = -turn});
    return 0;
}

/* The velocity turns uniformly, by k = J/(J + m a^2) Omega; so the centre of the ball goes round a
 * circle.  The angles follow from J theta_x - m a y and J theta_y + m a x, which change uniformly:
 * the friction that accelerates the centre has the torque of this. */
EXACT(ball_exact)
{
    const double *p = ctx, m = p[0], J = p[1], a = p[2], turn = p[3];
    const double half = J / (J + m * a * a) * turn * t / 2, way = t * sinc(half);
    const double vx = x0[5], vy = x0[6], vz = x0[9];
    const double dx = way * (cos(half) * vx - sin(half) * vy);
    const double dy = way * (sin(half) * vx + cos(half) * vy);
    const double vx1 = cos(2 * half) * vx - sin(2 * half) * vy;
    const double vy1 = sin(2 * half) * vx + cos(2 * half) * vy;
    const double ma = m * a / J;
    const double theta_x = x0[2] + (x0[7] - ma * vy) * t + ma * dy;
    const double theta_y = x0[3] + (x0[8] + ma * vx) * t - ma * dx;
    const double X = x0[0] + dx, Y = x0[1] + dy;
    set(x, 10, (double[]){X, Y, theta_x, theta_y, x0[4] + vz * t, vx1, vy1, (turn * X - vy1) / a,
                          (turn * Y + vx1) / a, vz});
    return 0;
}

/* The table does work, so that the energy changes; that in the frame that turns does not. */
INVARIANT(ball_invariant)
{
    const double *p = ctx, m = p[0], J = p[1], a = p[2], turn = p[3];
    const double *v = x + 5, *w = x + 7;
    values[0] = w[2];
    values[1] = J * w[0] - m * a * v[1];
    values[2] = J * w[1] + m * a * v[0];
    values[3] = m * (v[0] * v[0] + v[1] * v[1]) / 2
        + J * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / 2
        - m * turn * (x[0] * v[1] - x[1] * v[0]);
    return 0;
}

const builtin dal__ball_on_table = {
    .name = "ball_on_table",
    .help = "homogeneous ball (m, J, radius a) on a table that turns by Omega: affine constraints",
    .description = "A ball of mass m, inertia J and radius a that rolls on a table turning about "
                   "the origin with angular velocity Omega. (x, y) is the point of contact, "
                   "`theta_x`, `theta_y`, `theta_z` are the integrals of the angular velocity. The "
                   "centre moves on a circle. The table does work, so the energy is not constant; "
                   "the last of the invariants takes its place.",
    .source = "J. I. Neimark, N. A. Fufaev: Dynamics of Nonholonomic Systems, AMS, 1972; F. Fassò, "
              "N. Sansonetto: Conservation of 'moving' energy in nonholonomic systems with affine "
              "constraints and integrability of spheres on rotating surfaces, J. Nonlinear Sci. 26 "
              "(2016) 519-544",
    .formulas = "L = (m (v_x^2 + v_y^2) + J (v_theta_x^2 + v_theta_y^2 + v_theta_z^2))/2\n"
                "v_x - a v_theta_y + Omega y = 0\n"
                "v_y + a v_theta_x - Omega x = 0",
    .m = 2, .coordinates = {"x", "y", "theta_x", "theta_y", "theta_z"},
    .parameters = {{"m", 1.0}, {"J", 0.1}, {"a", 0.5}, {"Omega", 1.0, FINITE}},
    .diagonal = {1, 1, 2, 2, 2},
    .state = ball_state,
    .kind = DAL_AFFINE, .constraint = ball_constraint,
    .exact = ball_exact,
    .invariants = {"v_theta_z", "J v_theta_x - m a v_y", "J v_theta_y + m a v_x",
                   "energy - m Omega (x v_y - y v_x)"},
    .invariant = ball_invariant,
};
