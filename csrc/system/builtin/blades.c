/* Bodies in the plane on a blade, which moves along itself only. */
#include "system/builtin/builtin.h"

/* x <- (q, v) at (X, Y) with heading theta, for a point that lies a distance ahead of the blade,
 * which moves at speed u along itself and turns by omega. */
static void place_body(double *x, double X, double Y, double theta, double ahead, double u,
                       double omega)
{
    const double c = cos(theta), s = sin(theta);
    set3(x, X, Y, theta);
    set3(x + 3, u * c - ahead * omega * s, u * s + ahead * omega * c, omega);
}

/* The velocity of this point across the body: mu = (-sin theta, cos theta, -ahead). */
static inline void constraint_blade(double ahead, const double *q, const double *v, double *phi,
                                    double *phi_v, double *phi_q)
{
    const double s = sin(q[2]), c = cos(q[2]);
    if (phi) phi[0] = c * v[1] - s * v[0] - ahead * v[2];
    if (phi_v) set3(phi_v, -s, c, -ahead);
    if (phi_q) set3(phi_q, 0.0, 0.0, -c * v[0] - s * v[1]);
}

/* ---- knife_edge on an incline: q = (x, y, theta), x downhill, gs = g sin(slope) ---------- */

static void knife_edge_state(const double *p, double *x)
{
    (void)p;
    place_body(x, 0.0, 0.0, 0.2, 0.0, 0.5, 1.2);
}

/* V = -m gs x */
POTENTIAL(knife_edge_potential)
{
    const double *p = ctx, weight = p[0] * p[2];
    if (V) *V = -weight * q[0];
    if (V_q) set3(V_q, -weight, 0.0, 0.0);
    if (V_qq) set(V_qq, 9, (double[9]){0.0});
    return 0;
}

/* mu = (sin theta, -cos theta, 0) */
CONSTRAINT(knife_edge_constraint)
{
    const double s = sin(q[2]), c = cos(q[2]);
    if (phi) phi[0] = s * v[0] - c * v[1];
    if (phi_v) set3(phi_v, s, -c, 0.0);
    if (phi_q) set3(phi_q, 0.0, 0.0, c * v[0] + s * v[1]);
    return 0;
}

/* (x - sin x)/x^2, which cancels for small x: there the series x/3! - x^3/5! + ... */
static double knife_edge_area(double x)
{
    if (fabs(x) > 1.0) return (x - sin(x)) / (x * x);
    double term = x / 6.0, sum = 0.0;
    for (int k = 4; k < 22; k += 2) {
        sum += term;
        term *= -x * x / (k * (k + 1));
    }
    return sum;
}

/* theta' = omega and u' = gs cos(theta) for the speed u along the edge.  With C, S the integrals of
 * cos(theta), sin(theta): u = u0 + gs C, x - x0 = u0 C + gs C^2/2, and y - y0 = u0 S + gs int C dS,
 * where int C dS = (C S + int (C dS - S dC))/2 = (C S + t^2 area(omega t))/2. */
EXACT(knife_edge_exact)
{
    const double *p = ctx, gs = p[2], omega = x0[5], turn = omega * t;
    const double middle = x0[2] + turn / 2, theta = x0[2] + turn;
    const double C = t * sinc(turn / 2) * cos(middle), S = t * sinc(turn / 2) * sin(middle);
    const double u0 = x0[3] * cos(x0[2]) + x0[4] * sin(x0[2]), u = u0 + gs * C;
    place_body(x, x0[0] + (u0 + gs * C / 2) * C,
               x0[1] + u0 * S + gs * (C * S + t * t * knife_edge_area(turn)) / 2, theta, 0.0, u,
               omega);
    return 0;
}

INVARIANT(knife_edge_invariant)
{
    const double *p = ctx, gs = p[2], s = sin(x[2]), c = cos(x[2]);
    values[0] = x[5];
    values[1] = x[5] * (x[3] * c + x[4] * s) - gs * s;
    return 0;
}

const builtin dal__knife_edge = {
    .name = "knife_edge",
    .help = "knife edge (mass m, inertia J) on an incline, x downhill with acceleration gs",
    .description = "An edge (mass m, inertia J) at (x, y) with heading theta moves only along "
                   "itself, on a plane that slopes down along x; gs is g times the sine of the "
                   "slope. It turns uniformly, and so drifts sideways instead of sliding down.",
    .source = "J. I. Neimark, N. A. Fufaev: Dynamics of Nonholonomic Systems, AMS, 1972; "
              "A. M. Bloch: Nonholonomic Mechanics and Control, Springer, 2003",
    .formulas = "L = (m (v_x^2 + v_y^2) + J v_theta^2)/2 + m gs x\n"
                "v_x sin(theta) - v_y cos(theta) = 0\n"
                "where u = v_x cos(theta) + v_y sin(theta)",
    .m = 1, .coordinates = {"x", "y", "theta"},
    .parameters = {{"m", 2.0}, {"J", 0.75}, {"gs", 2.5, FINITE}},
    .diagonal = {1, 1, 2},
    .state = knife_edge_state,
    .potential = knife_edge_potential,
    .constraint = knife_edge_constraint, .steady = DAL_STEADY_CONSTANT_RATE,
    .exact = knife_edge_exact,
    .invariants = {"v_theta", "v_theta u - gs sin(theta)"},
    .invariant = knife_edge_invariant,
};

/* ---- sleigh (Chaplygin): q = (x, y, theta), (x, y) the centre of mass -------------------- */

static void sleigh_state(const double *p, double *x)
{
    place_body(x, 0.0, 0.0, 0.3, p[2], 0.2, 1.0);
}

CONSTRAINT(sleigh_constraint)
{
    const double *p = ctx;
    constraint_blade(p[2], q, v, phi, phi_v, phi_q);
    return 0;
}

/* With u the speed along the blade and I = J + m a^2: u' = a theta'^2, theta'' = -(m a/I) u theta';
 * so u = U tanh(s), theta' = W / cosh(s), s = s0 + k t, k = m a U/I. */
typedef struct sleigh_motion {
    double theta0, U, W, s0, k;
} sleigh_motion;

/* theta0 + (W/k) (gd(s) - gd(s0)), gd(s) - gd(s0) = 2 atan(sinh(k t/2) / cosh(s0 + k t/2)); the
 * quotient is written with |k t/2| - |s0 + k t/2|, in which k t/2 drops out where it is large. */
static double sleigh_heading(const sleigh_motion *motion, double t)
{
    const double half = motion->k * t / 2, mean = motion->s0 + half;
    if (half == 0.0) return motion->theta0 + motion->W * t / cosh(mean);
    const double against = copysign(1.0, half) * motion->s0;
    const double quotient = exp(fmin(-against, 2 * fabs(half) + against)) * -expm1(-2 * fabs(half))
        / (1 + exp(-2 * fabs(mean)));
    return motion->theta0 + motion->W / motion->k * 2 * atan(copysign(quotient, half));
}

/* xy[2] += the way of the blade between two times, by Gauss-Legendre quadrature with 10 points on
 * panels on which s and theta change by at most 1/2; the integrand is analytic within pi/2 of real
 * s, which leaves the error of the quadrature far below roundoff. */
static void sleigh_way(const sleigh_motion *motion, double from, double to, size_t panels,
                       double *xy)
{
    static const double node[5] = {0.14887433898163121088, 0.43339539412924719080,
                                   0.67940956829902440623, 0.86506336668898451073,
                                   0.97390652851717172008};
    static const double weight[5] = {0.29552422471475287017, 0.26926671930999635509,
                                     0.21908636251598204400, 0.14945134915058059315,
                                     0.06667134430868813759};
    const double radius = (to - from) / (2 * (double)panels);
    for (size_t panel = 0; panel < panels; panel++) {
        const double middle = from + (2 * (double)panel + 1) * radius;
        double along_x = 0.0, along_y = 0.0;
        for (int i = 0; i < 10; i++) {
            const double t = middle + (i < 5 ? -node[i] : node[i - 5]) * radius;
            const double theta = sleigh_heading(motion, t);
            const double du = weight[i % 5] * tanh(motion->s0 + motion->k * t);
            along_x += du * cos(theta);
            along_y += du * sin(theta);
        }
        xy[0] += radius * motion->U * along_x;
        xy[1] += radius * motion->U * along_y;
    }
}

/* value, or the end of the interval between 0 and t that is nearest to it. */
static double clamp_time(double value, double t)
{
    return fmax(fmin(0.0, t), fmin(value, fmax(0.0, t)));
}

/* (x, y) is the point of the sleigh that lies a distance ahead of the blade.  Beyond |s| = 40 the
 * motion is straight to roundoff; so the number of panels does not grow with t, but for a -> 0,
 * where the sleigh turns for ever: 2^20 panels (5e5 rad) are the limit of the domain. */
static int sleigh_flow(double t, const double *x0, double *x, const double *p, double ahead)
{
    const double m = p[0], a = p[2], inertia = p[1] + m * a * a;
    const double c0 = cos(x0[2]), s0 = sin(x0[2]), u0 = x0[3] * c0 + x0[4] * s0, w0 = x0[5];
    if (w0 == 0.0) {
        place_body(x, x0[0] + u0 * c0 * t, x0[1] + u0 * s0 * t, x0[2], ahead, u0, w0);
        return 0;
    }
    const double ratio = sqrt(m / inertia), U = hypot(u0, w0 / ratio);
    const sleigh_motion motion = {.theta0 = x0[2], .U = U, .W = copysign(U * ratio, w0),
                                  .s0 = asinh(ratio * u0 / fabs(w0)), .k = m * a * U / inertia};
    const double theta = sleigh_heading(&motion, t), c1 = cos(theta), s1 = sin(theta);
    const double s = motion.s0 + motion.k * t, u1 = U * tanh(s), w1 = motion.W / cosh(s);
    const double edge = copysign(40.0, motion.k) * copysign(1.0, t);
    const double from = clamp_time((-edge - motion.s0) / motion.k, t);
    const double to = clamp_time((edge - motion.s0) / motion.k, t);
    const double panels = ceil(2 * fmax(fabs(motion.k), fabs(motion.W)) * fabs(to - from));
    if (!(panels <= 0x1p20)) return 1;
    double xy[2] = {x0[0] + ahead * (c1 - c0) + u0 * c0 * from + u1 * c1 * (t - to),
                    x0[1] + ahead * (s1 - s0) + u0 * s0 * from + u1 * s1 * (t - to)};
    sleigh_way(&motion, from, to, (size_t)panels, xy);
    place_body(x, xy[0], xy[1], theta, ahead, u1, w1);
    return 0;
}

EXACT(sleigh_exact)
{
    const double *p = ctx;
    return sleigh_flow(t, x0, x, p, p[2]);
}

/* a theta - sqrt(I/m) atan(sqrt(m/I) u/theta'): a times the heading of the sleigh where u = 0.  The
 * sign of theta' never changes; so the atan does not jump. */
INVARIANT(sleigh_invariant)
{
    const double *p = ctx, m = p[0], a = p[2], ratio = sqrt((p[1] + m * a * a) / m);
    const double u = x[3] * cos(x[2]) + x[4] * sin(x[2]), w = x[5];
    values[0] = a * x[2] - ratio * atan2(copysign(1.0, w) * u, ratio * fabs(w));
    return 0;
}

const builtin dal__sleigh = {
    .name = "sleigh",
    .help = "Chaplygin sleigh (m, J), centre of mass a distance a ahead of the blade",
    .description = "A body (mass m, inertia J) on a blade and two points that slide freely. (x, y) "
                   "is the centre of mass, theta the heading; the blade is a distance a behind. In "
                   "the end it moves straight, with the blade behind for a > 0.",
    .source = "S. A. Chaplygin: On the theory of motion of nonholonomic systems. The "
              "reducing-multiplier theorem (1911), Regul. Chaotic Dyn. 13 (2008) 369-376",
    .formulas = "L = (m (v_x^2 + v_y^2) + J v_theta^2)/2\n"
                "v_y cos(theta) - v_x sin(theta) - a v_theta = 0\n"
                "where u = v_x cos(theta) + v_y sin(theta)\n"
                "where I = J + m a^2",
    .m = 1, .coordinates = {"x", "y", "theta"},
    .parameters = {{"m", 1.5}, {"J", 0.8}, {"a", 0.4, FINITE}},
    .diagonal = {1, 1, 2},
    .state = sleigh_state,
    .constraint = sleigh_constraint,
    .exact = sleigh_exact,
    .invariants = {"a theta - sqrt(I/m) atan(sqrt(m/I) u/v_theta)"},
    .invariant = sleigh_invariant,
};

/* ---- sleigh_contact: q = (x, y, theta), (x, y) the point of the blade -------------------- */

/* The motion of the default data of the sleigh. */
static void sleigh_contact_state(const double *p, double *x)
{
    const double a = p[2], theta = 0.3;
    place_body(x, -a * cos(theta), -a * sin(theta), theta, 0.0, 0.2, 1.0);
}

/* L = m |v|^2/2 + m a omega w + (J + m a^2) omega^2/2, w = -v_x sin(theta) + v_y cos(theta) */
LAGRANGIAN(sleigh_contact_lagrangian)
{
    const double *p = ctx, m = p[0], a = p[2], ma = m * a, inertia = p[1] + ma * a;
    const double s = sin(q[2]), c = cos(q[2]), omega = v[2];
    const double u = c * v[0] + s * v[1], w = c * v[1] - s * v[0]; /* w_theta = -u, u_theta = w */
    if (L) *L = m * (v[0] * v[0] + v[1] * v[1]) / 2 + (ma * w + inertia * omega / 2) * omega;
    if (L_q) set3(L_q, 0.0, 0.0, -ma * omega * u);
    if (L_v)
        set3(L_v, m * v[0] - ma * s * omega, m * v[1] + ma * c * omega, ma * w + inertia * omega);
    if (L_qq) set(L_qq, 9, (double[9]){[8] = -ma * omega * w});
    if (L_vq)
        set(L_vq, 9, (double[9]){[2] = -ma * c * omega, [5] = -ma * s * omega, [8] = -ma * u});
    if (L_vv) set(L_vv, 9, (double[]){m, 0.0, -ma * s, 0.0, m, ma * c, -ma * s, ma * c, inertia});
    return 0;
}

CONSTRAINT(sleigh_contact_constraint)
{
    constraint_blade(0.0, q, v, phi, phi_v, phi_q);
    return 0;
}

EXACT(sleigh_contact_exact)
{
    return sleigh_flow(t, x0, x, ctx, 0.0);
}

const builtin dal__sleigh_contact = {
    .name = "sleigh_contact",
    .help = "the sleigh (m, J, a) by the point of its blade: its mass matrix depends on theta",
    .description = "The body and the motion of `sleigh` (mass m, inertia J about the centre of "
                   "mass), with (x, y) the point of the blade; the centre of mass is a distance a "
                   "ahead.",
    .source = "S. A. Chaplygin: On the theory of motion of nonholonomic systems. The "
              "reducing-multiplier theorem (1911), Regul. Chaotic Dyn. 13 (2008) 369-376",
    .formulas = "L = (m (v_x^2 + v_y^2) + I v_theta^2)/2 + m a v_theta w\n"
                "v_y cos(theta) - v_x sin(theta) = 0\n"
                "where u = v_x cos(theta) + v_y sin(theta)\n"
                "where w = v_y cos(theta) - v_x sin(theta)\n"
                "where I = J + m a^2",
    .m = 1, .coordinates = {"x", "y", "theta"},
    .parameters = {{"m", 1.5}, {"J", 0.8}, {"a", 0.4, FINITE}},
    .state = sleigh_contact_state,
    .lagrangian = sleigh_contact_lagrangian,
    .constraint = sleigh_contact_constraint,
    .exact = sleigh_contact_exact,
    .invariants = {"a theta - sqrt(I/m) atan(sqrt(m/I) u/v_theta)"},
    .invariant = sleigh_invariant,
};
