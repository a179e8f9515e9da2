/* Floor 2: the built-in systems.  Each has a section with its functions and a record in the table
 * at the end; ctx is the array of its parameters, in the order of the record. */
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MAX_COORDINATES = 4, MAX_PARAMETERS = 5, MAX_INVARIANTS = 2, MAX_PAIRS = 1000 };

/* The values that a parameter may take. */
typedef enum range { FINITE, POSITIVE, NOT_NEGATIVE, PAIRS } range;

typedef struct builtin {
    const char *name, *help;
    size_t n, m;                               /* n = 0: 2 pairs + 1, pairs is parameter 0 */
    const char *coordinates[MAX_COORDINATES];  /* for n > 0 */
    const char *parameters[MAX_PARAMETERS];
    double defaults[MAX_PARAMETERS];
    range ranges[MAX_PARAMETERS];
    void (*mass)(const double *p, double *diagonal); /* of M; NULL: M = 1 */
    void (*state)(const double *p, double *x);       /* zeros stand in x when it is called */
    dal_potential_fn potential;
    dal_constraint_fn constraint;
    dal_exact_fn exact;
    const char *invariants[MAX_INVARIANTS];
    dal_invariant_fn invariant;
} builtin;

/* ---- what several systems share --------------------------------------------------------- */

static inline void set3(double *a, double a0, double a1, double a2)
{
    a[0] = a0;
    a[1] = a1;
    a[2] = a2;
}

static inline void set4(double *a, double a0, double a1, double a2, double a3)
{
    set3(a, a0, a1, a2);
    a[3] = a3;
}

/* sin(x)/x */
static double sinc(double x) { return x == 0.0 ? 1.0 : sin(x) / x; }

/* M = diag(m, m, J) */
static void mass_plane(const double *p, double *diagonal)
{
    set3(diagonal, p[0], p[0], p[1]);
}

/* M = diag(m, m, I, J) */
static void mass_rolling(const double *p, double *diagonal)
{
    set4(diagonal, p[0], p[0], p[1], p[2]);
}

/* V = (k1 x^2 + k2 y^2 + k3 z^2)/2 */
static int potential_springs(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *k = ctx;
    if (V) *V = (k[0] * q[0] * q[0] + k[1] * q[1] * q[1] + k[2] * q[2] * q[2]) / 2;
    if (V_q) set3(V_q, k[0] * q[0], k[1] * q[1], k[2] * q[2]);
    if (V_qq) {
        set3(V_qq, k[0], 0.0, 0.0);
        set3(V_qq + 3, 0.0, k[1], 0.0);
        set3(V_qq + 6, 0.0, 0.0, k[2]);
    }
    return 0;
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

/* ---- particle and particle_oscillator: q = (x, y, z), mu = (-y, 0, 1) ------------------- */

static void particle_state(const double *p, double *x)
{
    (void)p;
    set3(x, 0.5, 0.3, -0.2);
    set3(x + 3, 1.0, 0.7, 0.3);
}

static int particle_constraint(const double *q, const double *v, double *phi, double *phi_v,
                               double *phi_q, void *ctx)
{
    (void)ctx;
    if (phi) phi[0] = v[2] - q[1] * v[0];
    if (phi_v) set3(phi_v, -q[1], 0.0, 1.0);
    if (phi_q) set3(phi_q, 0.0, -v[0], 0.0);
    return 0;
}

/* v_y = w and v_x s = c are constant, s = sqrt(1 + y^2); x1 - x0 = c (asinh y1 - asinh y0)/w and
 * z1 - z0 = c (s1 - s0)/w.  The difference of the asinh is asinh(y1 s0 - y0 s1) = asinh(w t r), and
 * r has a form without cancellation for y0, y1 of one sign and another for the rest. */
static int particle_exact(double t, const double *x0, double *x, void *ctx)
{
    (void)ctx;
    const double y0 = x0[1], w = x0[4], y1 = y0 + w * t;
    const double s0 = hypot(1.0, y0), s1 = hypot(1.0, y1), c = x0[3] * s0;
    double r = 1.0;
    if (y0 * y1 > 0.0) r = (y1 + y0) / (y1 * s0 + y0 * s1);
    else if (y0 != y1) r = (y1 * s0 - y0 * s1) / (y1 - y0);
    const double arc = w * t * r;
    x[0] = x0[0] + c * t * r * (arc == 0.0 ? 1.0 : asinh(arc) / arc);
    x[1] = y1;
    x[2] = x0[2] + c * t * ((y1 + y0) / (s0 + s1));
    set3(x + 3, c / s1, w, c / s1 * y1);
    return 0;
}

static int particle_invariant(const double *x, double *values, void *ctx)
{
    (void)ctx;
    values[0] = x[4];
    values[1] = x[3] * hypot(1.0, x[1]);
    return 0;
}

static int particle_oscillator_invariant(const double *x, double *values, void *ctx)
{
    const double *k = ctx;
    values[0] = (x[4] * x[4] + k[1] * x[1] * x[1]) / 2;
    return 0;
}

/* ---- knife_edge on an incline: q = (x, y, theta), x downhill, gs = g sin(slope) ---------- */

static void knife_edge_state(const double *p, double *x)
{
    (void)p;
    const double theta = 0.2, u = 0.5, omega = 1.2;
    set3(x, 0.0, 0.0, theta);
    set3(x + 3, u * cos(theta), u * sin(theta), omega);
}

/* V = -m gs x */
static int knife_edge_potential(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *p = ctx, weight = p[0] * p[2];
    if (V) *V = -weight * q[0];
    if (V_q) set3(V_q, -weight, 0.0, 0.0);
    if (V_qq)
        for (size_t i = 0; i < 9; i++) V_qq[i] = 0.0;
    return 0;
}

/* mu = (sin theta, -cos theta, 0) */
static int knife_edge_constraint(const double *q, const double *v, double *phi, double *phi_v,
                                 double *phi_q, void *ctx)
{
    (void)ctx;
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
static int knife_edge_exact(double t, const double *x0, double *x, void *ctx)
{
    const double *p = ctx, gs = p[2], omega = x0[5], turn = omega * t;
    const double middle = x0[2] + turn / 2, theta = x0[2] + turn;
    const double C = t * sinc(turn / 2) * cos(middle), S = t * sinc(turn / 2) * sin(middle);
    const double u0 = x0[3] * cos(x0[2]) + x0[4] * sin(x0[2]), u = u0 + gs * C;
    x[0] = x0[0] + (u0 + gs * C / 2) * C;
    x[1] = x0[1] + u0 * S + gs * (C * S + t * t * knife_edge_area(turn)) / 2;
    x[2] = theta;
    set3(x + 3, u * cos(theta), u * sin(theta), omega);
    return 0;
}

static int knife_edge_invariant(const double *x, double *values, void *ctx)
{
    const double *p = ctx, gs = p[2], s = sin(x[2]), c = cos(x[2]);
    values[0] = x[5];
    values[1] = x[5] * (x[3] * c + x[4] * s) - gs * s;
    return 0;
}

/* ---- sleigh (Chaplygin): q = (x, y, theta), (x, y) the centre of mass -------------------- */

static void sleigh_state(const double *p, double *x)
{
    const double a = p[2], theta = 0.3, u = 0.2, omega = 1.0;
    set3(x, 0.0, 0.0, theta);
    set3(x + 3, u * cos(theta) - a * omega * sin(theta), u * sin(theta) + a * omega * cos(theta),
         omega);
}

/* mu = (-sin theta, cos theta, -a): the blade, a distance a behind, moves along itself only. */
static int sleigh_constraint(const double *q, const double *v, double *phi, double *phi_v,
                             double *phi_q, void *ctx)
{
    const double *p = ctx, a = p[2], s = sin(q[2]), c = cos(q[2]);
    if (phi) phi[0] = c * v[1] - s * v[0] - a * v[2];
    if (phi_v) set3(phi_v, -s, c, -a);
    if (phi_q) set3(phi_q, 0.0, 0.0, -c * v[0] - s * v[1]);
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

/* The centre of mass is a cos(theta), a sin(theta) ahead of the blade.  Beyond |s| = 40 the motion
 * is straight to roundoff; so the number of panels does not grow with t, but for a -> 0, where the
 * sleigh turns for ever: 2^20 panels (5e5 rad) are the limit of the domain. */
static int sleigh_exact(double t, const double *x0, double *x, void *ctx)
{
    const double *p = ctx, m = p[0], a = p[2], inertia = p[1] + m * a * a;
    const double c0 = cos(x0[2]), s0 = sin(x0[2]), u0 = x0[3] * c0 + x0[4] * s0, w0 = x0[5];
    if (w0 == 0.0) {
        const double X = x0[0] + u0 * c0 * t, Y = x0[1] + u0 * s0 * t;
        set3(x, X, Y, x0[2]);
        set3(x + 3, u0 * c0, u0 * s0, 0.0);
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
    double xy[2] = {x0[0] + a * (c1 - c0) + u0 * c0 * from + u1 * c1 * (t - to),
                    x0[1] + a * (s1 - s0) + u0 * s0 * from + u1 * s1 * (t - to)};
    sleigh_way(&motion, from, to, (size_t)panels, xy);
    set3(x, xy[0], xy[1], theta);
    set3(x + 3, u1 * c1 - a * w1 * s1, u1 * s1 + a * w1 * c1, w1);
    return 0;
}

/* a theta - sqrt(I/m) atan(sqrt(m/I) u/theta'): a times the heading of the sleigh where u = 0.  The
 * sign of theta' never changes; so the atan does not jump. */
static int sleigh_invariant(const double *x, double *values, void *ctx)
{
    const double *p = ctx, m = p[0], a = p[2], ratio = sqrt((p[1] + m * a * a) / m);
    const double u = x[3] * cos(x[2]) + x[4] * sin(x[2]), w = x[5];
    values[0] = a * x[2] - ratio * atan2(copysign(1.0, w) * u, ratio * fabs(w));
    return 0;
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

/* ---- heisenberg: q = (x, y, z), mu = (y, -x, 1) ------------------------------------------ */

static void heisenberg_state(const double *p, double *x)
{
    (void)p;
    set3(x, 0.8, 0.2, 0.1);
    set3(x + 3, 0.3, 0.5, 0.34);
}

static int heisenberg_constraint(const double *q, const double *v, double *phi, double *phi_v,
                                 double *phi_q, void *ctx)
{
    (void)ctx;
    if (phi) phi[0] = q[1] * v[0] - q[0] * v[1] + v[2];
    if (phi_v) set3(phi_v, q[1], -q[0], 1.0);
    if (phi_q) set3(phi_q, -v[1], v[0], 0.0);
    return 0;
}

/* ---- contact_oscillator (McLachlan & Perlmutter): q = (x, y, z), mu = (1, 0, y) ---------- */

/* Energy 3/2, of which H_y = 1/2. */
static void contact_oscillator_state(const double *p, double *x)
{
    const double z = -sqrt(0.5);
    set3(x, sqrt((2.0 - z * z) / (1.0 + p[0] * z * z)), 1.0, z);
}

/* V = (x^2 + y^2 + z^2 + eps x^2 z^2)/2 */
static int contact_oscillator_potential(const double *q, double *V, double *V_q, double *V_qq,
                                        void *ctx)
{
    const double *p = ctx, eps = p[0], x = q[0], y = q[1], z = q[2];
    if (V) *V = (x * x + y * y + (1.0 + eps * x * x) * z * z) / 2;
    if (V_q) set3(V_q, x * (1.0 + eps * z * z), y, z * (1.0 + eps * x * x));
    if (V_qq) {
        set3(V_qq, 1.0 + eps * z * z, 0.0, 2 * eps * x * z);
        set3(V_qq + 3, 0.0, 1.0, 0.0);
        set3(V_qq + 6, 2 * eps * x * z, 0.0, 1.0 + eps * x * x);
    }
    return 0;
}

static int contact_oscillator_constraint(const double *q, const double *v, double *phi,
                                         double *phi_v, double *phi_q, void *ctx)
{
    (void)ctx;
    if (phi) phi[0] = v[0] + q[1] * v[2];
    if (phi_v) set3(phi_v, 1.0, 0.0, q[1]);
    if (phi_q) set3(phi_q, 0.0, v[2], 0.0);
    return 0;
}

/* The driver y is free; so its energy and that of the pair (x, z), v_x = -y v_z, are constant. */
static int contact_oscillator_invariant(const double *x, double *values, void *ctx)
{
    const double *p = ctx, eps = p[0];
    const double xx = x[0] * x[0], yy = x[1] * x[1], zz = x[2] * x[2];
    values[0] = (x[4] * x[4] + yy) / 2;
    values[1] = (xx + (1.0 + eps * xx) * zz + (1.0 + yy) * x[5] * x[5]) / 2;
    return 0;
}

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

/* ---- chaotic (McLachlan & Perlmutter): q = (x, y_1..y_pairs, z_1..z_pairs) --------------- */

static size_t chaotic_pairs(const double *p) { return (size_t)p[0]; }

/* The third of the ten initial data of energy 3.06 for three pairs, y_i = 3/5, 2/5, 1/5; with other
 * numbers of pairs the y_i go down to 0 in as many steps. */
static void chaotic_state(const double *p, double *x)
{
    const size_t pairs = chaotic_pairs(p), n = 2 * pairs + 1;
    const double angle = 0.34906585039886591538; /* pi/9 */
    x[0] = cos(angle);
    for (size_t i = 0; i < pairs; i++) {
        x[1 + i] = 3.0 * (double)(pairs - i) / (5.0 * (double)pairs);
        x[1 + pairs + i] = 1.0;
    }
    x[n + 1] = sin(angle);
}

/* V = (|q|^2 + z_1^2 z_2^2 + sum_i y_i^2 z_i^2)/2, without z_1^2 z_2^2 for a single pair. */
static int chaotic_potential(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const size_t pairs = chaotic_pairs(ctx), n = 2 * pairs + 1;
    const double *y = q + 1, *z = y + pairs;
    const double z1 = pairs > 1 ? z[0] : 0.0, z2 = pairs > 1 ? z[1] : 0.0;
    if (V) {
        double sum = q[0] * q[0] + z1 * z1 * z2 * z2;
        for (size_t i = 0; i < pairs; i++) sum += y[i] * y[i] * (1.0 + z[i] * z[i]) + z[i] * z[i];
        *V = sum / 2;
    }
    if (V_q) {
        double *V_y = V_q + 1, *V_z = V_y + pairs;
        V_q[0] = q[0];
        for (size_t i = 0; i < pairs; i++) {
            V_y[i] = y[i] * (1.0 + z[i] * z[i]);
            V_z[i] = z[i] * (1.0 + y[i] * y[i]);
        }
        if (pairs > 1) {
            V_z[0] += z1 * z2 * z2;
            V_z[1] += z2 * z1 * z1;
        }
    }
    if (V_qq) {
        memset(V_qq, 0, n * n * sizeof *V_qq);
        V_qq[0] = 1.0;
        for (size_t i = 0; i < pairs; i++) {
            double *row_y = V_qq + (1 + i) * n, *row_z = row_y + pairs * n;
            row_y[1 + i] = 1.0 + z[i] * z[i];
            row_z[1 + pairs + i] = 1.0 + y[i] * y[i];
            row_y[1 + pairs + i] = row_z[1 + i] = 2 * y[i] * z[i];
        }
        if (pairs > 1) {
            double *row = V_qq + (1 + pairs) * n, *next = row + n;
            row[1 + pairs] += z2 * z2;
            next[2 + pairs] += z1 * z1;
            row[2 + pairs] = next[1 + pairs] = 2 * z1 * z2;
        }
    }
    return 0;
}

/* mu = (1, 0..0, y_1..y_pairs) */
static int chaotic_constraint(const double *q, const double *v, double *phi, double *phi_v,
                              double *phi_q, void *ctx)
{
    const size_t pairs = chaotic_pairs(ctx);
    const double *y = q + 1;
    if (phi) {
        phi[0] = v[0];
        for (size_t i = 0; i < pairs; i++) phi[0] += y[i] * v[1 + pairs + i];
    }
    if (phi_v) {
        phi_v[0] = 1.0;
        for (size_t i = 0; i < pairs; i++) {
            phi_v[1 + i] = 0.0;
            phi_v[1 + pairs + i] = y[i];
        }
    }
    if (phi_q) {
        phi_q[0] = 0.0;
        for (size_t i = 0; i < pairs; i++) {
            phi_q[1 + i] = v[1 + pairs + i];
            phi_q[1 + pairs + i] = 0.0;
        }
    }
    return 0;
}

/* ---- the table --------------------------------------------------------------------------- */

static const builtin table[] = {
    {
        .name = "particle",
        .help = "free particle with v_z = y v_x",
        .n = 3, .m = 1, .coordinates = {"x", "y", "z"},
        .state = particle_state,
        .constraint = particle_constraint,
        .exact = particle_exact,
        .invariants = {"v_y", "v_x sqrt(1 + y^2)"}, .invariant = particle_invariant,
    },
    {
        .name = "particle_oscillator",
        .help = "particle with v_z = y v_x on springs k1, k2, k3",
        .n = 3, .m = 1, .coordinates = {"x", "y", "z"},
        .parameters = {"k1", "k2", "k3"}, .defaults = {1.0, 2.0, 1.5},
        .ranges = {FINITE, FINITE, FINITE},
        .state = particle_state,
        .potential = potential_springs,
        .constraint = particle_constraint,
        .invariants = {"(v_y^2 + k2 y^2)/2"}, .invariant = particle_oscillator_invariant,
    },
    {
        .name = "knife_edge",
        .help = "knife edge (mass m, inertia J) on an incline, x downhill with acceleration gs",
        .n = 3, .m = 1, .coordinates = {"x", "y", "theta"},
        .parameters = {"m", "J", "gs"}, .defaults = {2.0, 0.75, 2.5},
        .ranges = {POSITIVE, POSITIVE, FINITE},
        .mass = mass_plane,
        .state = knife_edge_state,
        .potential = knife_edge_potential,
        .constraint = knife_edge_constraint,
        .exact = knife_edge_exact,
        .invariants = {"v_theta", "v_theta u - gs sin(theta)"},
        .invariant = knife_edge_invariant,
    },
    {
        .name = "sleigh",
        .help = "Chaplygin sleigh (m, J), centre of mass a distance a ahead of the blade",
        .n = 3, .m = 1, .coordinates = {"x", "y", "theta"},
        .parameters = {"m", "J", "a"}, .defaults = {1.5, 0.8, 0.4},
        .ranges = {POSITIVE, POSITIVE, FINITE},
        .mass = mass_plane,
        .state = sleigh_state,
        .constraint = sleigh_constraint,
        .exact = sleigh_exact,
        .invariants = {"a theta - sqrt(I/m) atan(sqrt(m/I) u/v_theta)"},
        .invariant = sleigh_invariant,
    },
    {
        .name = "disk",
        .help = "vertical rolling disk of radius R; inertia I rolling (theta), J heading (phi)",
        .n = 4, .m = 2, .coordinates = {"x", "y", "theta", "phi"},
        .parameters = {"m", "I", "J", "R"}, .defaults = {1.2, 0.5, 0.3, 0.7},
        .ranges = {POSITIVE, POSITIVE, POSITIVE, POSITIVE},
        .mass = mass_rolling,
        .state = disk_state,
        .constraint = disk_constraint,
        .exact = disk_exact,
        .invariants = {"v_theta", "v_phi"}, .invariant = disk_invariant,
    },
    {
        .name = "heisenberg",
        .help = "particle with v_z = x v_y - y v_x on springs k1, k2, k3",
        .n = 3, .m = 1, .coordinates = {"x", "y", "z"},
        .parameters = {"k1", "k2", "k3"}, .defaults = {1.0, 2.25, 0.5},
        .ranges = {FINITE, FINITE, FINITE},
        .state = heisenberg_state,
        .potential = potential_springs,
        .constraint = heisenberg_constraint,
    },
    {
        .name = "contact_oscillator",
        .help = "oscillators x, z with coupling eps x^2 z^2, v_x = -y v_z driven by oscillator y",
        .n = 3, .m = 1, .coordinates = {"x", "y", "z"},
        .parameters = {"eps"}, .defaults = {0.0}, .ranges = {NOT_NEGATIVE},
        .state = contact_oscillator_state,
        .potential = contact_oscillator_potential,
        .constraint = contact_oscillator_constraint,
        .invariants = {"(v_y^2 + y^2)/2", "(x^2 + (1 + eps x^2) z^2 + (1 + y^2) v_z^2)/2"},
        .invariant = contact_oscillator_invariant,
    },
    {
        .name = "robot",
        .help = "rolling robot with V = k sin(theta); inertia I heading (phi), J rolling (theta)",
        .n = 4, .m = 2, .coordinates = {"x", "y", "phi", "theta"},
        .parameters = {"m", "I", "J", "R", "k"}, .defaults = {1.0, 1.0, 1.0, 1.0, 10.0},
        .ranges = {POSITIVE, POSITIVE, POSITIVE, POSITIVE, FINITE},
        .mass = mass_rolling,
        .state = robot_state,
        .potential = robot_potential,
        .constraint = robot_constraint,
        .invariants = {"v_phi", "(J + m R^2) v_theta^2/2 + k sin(theta)"},
        .invariant = robot_invariant,
    },
    {
        .name = "chaotic",
        .help = "chaotic quartic oscillator with v_x = -sum y_i v_zi; 2 pairs + 1 coordinates",
        .n = 0, .m = 1,
        .parameters = {"pairs"}, .defaults = {3.0}, .ranges = {PAIRS},
        .state = chaotic_state,
        .potential = chaotic_potential,
        .constraint = chaotic_constraint,
    },
};

enum { TABLE_COUNT = sizeof table / sizeof table[0] };

size_t dal_builtin_count(void) { return TABLE_COUNT; }

const char *dal_builtin_name(size_t i) { return i < TABLE_COUNT ? table[i].name : NULL; }

const char *dal_builtin_help(size_t i) { return i < TABLE_COUNT ? table[i].help : NULL; }

/* ---- from a name to a system ------------------------------------------------------------- */

/* Equal, - and _ being the same. */
static bool same_name(const char *a, const char *b)
{
    for (; *a && *b; a++, b++)
        if ((*a == '-' ? '_' : *a) != (*b == '-' ? '_' : *b)) return false;
    return *a == *b;
}

/* Number of names before the first NULL. */
static size_t count_names(size_t size, const char *const *names)
{
    size_t count = 0;
    while (count < size && names[count]) count++;
    return count;
}

/* Adds a name to the list in text[size]. */
static void append_name(size_t size, char *text, const char *name)
{
    const size_t used = strlen(text);
    snprintf(text + used, size - used, "%s%s", used ? ", " : "", name);
}

static int fail_unknown_system(const char *name, dal_error *error)
{
    char known[256] = "";
    for (size_t i = 0; i < TABLE_COUNT; i++) append_name(sizeof known, known, table[i].name);
    return dal__fail(error, DAL_EINVAL, "there is no built-in system \"%.60s\"; there are %s", name,
                     known);
}

static int fail_unknown_parameter(const builtin *record, const char *name, dal_error *error)
{
    char known[128] = "";
    const size_t parameters = count_names(MAX_PARAMETERS, record->parameters);
    for (size_t i = 0; i < parameters; i++)
        append_name(sizeof known, known, record->parameters[i]);
    return dal__fail(error, DAL_EINVAL, "%s has no parameter \"%.60s\"; it has %s", record->name,
                     name, parameters ? known : "none");
}

static bool in_range(range expected, double value)
{
    if (!isfinite(value)) return false;
    switch (expected) {
    case FINITE: return true;
    case POSITIVE: return value > 0.0;
    case NOT_NEGATIVE: return value >= 0.0;
    case PAIRS: return value >= 1.0 && value <= MAX_PAIRS && value == floor(value);
    }
    return false;
}

static const char *range_in_words(range expected)
{
    switch (expected) {
    case FINITE: return "a finite number";
    case POSITIVE: return "a finite number > 0";
    case NOT_NEGATIVE: return "a finite number >= 0";
    case PAIRS: return "a whole number from 1 to 1000";
    }
    return "";
}

/* p[MAX_PARAMETERS] with the parameter called name changed to value. */
static int set_parameter(const builtin *record, const char *name, double value, double *p,
                         dal_error *error)
{
    const size_t parameters = count_names(MAX_PARAMETERS, record->parameters);
    size_t i = 0;
    while (i < parameters && !same_name(name, record->parameters[i])) i++;
    if (i == parameters) return fail_unknown_parameter(record, name, error);
    if (!in_range(record->ranges[i], value))
        return dal__fail(error, DAL_EINVAL, "parameter %s of %s is %.15g; expected %s",
                         record->parameters[i], record->name, value,
                         range_in_words(record->ranges[i]));
    p[i] = value;
    return DAL_SUCCESS;
}

enum { NAME_SIZE = 24 };

/* coordinates[2 pairs + 1] <- x, y1, y2, ..., z1, z2, ..., written to text. */
static void name_pairs(size_t pairs, char (*text)[NAME_SIZE], const char **coordinates)
{
    snprintf(text[0], NAME_SIZE, "x");
    for (size_t i = 1; i <= pairs; i++) {
        snprintf(text[i], NAME_SIZE, "y%zu", i);
        snprintf(text[pairs + i], NAME_SIZE, "z%zu", i);
    }
    for (size_t i = 0; i <= 2 * pairs; i++) coordinates[i] = text[i];
}

/* A system from its record and its parameters p; dal__system_make copies what depends on p. */
static int make(dal_system **system, const builtin *record, const double *p, dal_error *error)
{
    const size_t n = record->n > 0 ? record->n : 2 * chaotic_pairs(p) + 1;
    arena a = {0};
    double *diagonal, *mass, *state;
    const char **pairs;
    char(*text)[NAME_SIZE];
    dal__reserve(&a, &diagonal, n, sizeof *diagonal);
    dal__reserve(&a, &mass, dal__times(n, n), sizeof *mass);
    dal__reserve(&a, &state, 2 * n, sizeof *state);
    dal__reserve(&a, &pairs, n, sizeof *pairs);
    dal__reserve(&a, &text, n, sizeof *text);
    int status = dal__allocate(&a, error);
    if (status) return status;

    for (size_t i = 0; i < n; i++) diagonal[i] = 1.0;
    if (record->mass) record->mass(p, diagonal);
    for (size_t i = 0; i < n; i++) mass[i * n + i] = diagonal[i];
    record->state(p, state);
    if (record->n == 0) name_pairs(n / 2, text, pairs);
    const dal_system_def def = {
        .n = n, .m = record->m, .mass = mass,
        .potential = record->potential, .constraint = record->constraint,
        .name = record->name, .help = record->help,
        .coordinates = record->n > 0 ? record->coordinates : pairs,
        .state = state, .exact = record->exact,
        .invariants = count_names(MAX_INVARIANTS, record->invariants),
        .invariant_names = record->invariants, .invariant = record->invariant,
    };
    status = dal__system_make(system, &def, count_names(MAX_PARAMETERS, record->parameters),
                              record->parameters, p, error);
    dal__release(&a);
    return status;
}

int dal_system_builtin(dal_system **system, const char *name, const char *const *names,
                       const double *values, size_t count, dal_error *error)
{
    if (!system || !name)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", system ? "name" : "system");
    if (count > 0 && (!names || !values))
        return dal__fail(error, DAL_EINVAL, "%s is NULL with count = %zu parameters",
                         names ? "values" : "names", count);
    const builtin *record = NULL;
    for (size_t i = 0; i < TABLE_COUNT && !record; i++)
        if (same_name(name, table[i].name)) record = &table[i];
    if (!record) return fail_unknown_system(name, error);

    double p[MAX_PARAMETERS];
    memcpy(p, record->defaults, sizeof p);
    for (size_t i = 0; i < count; i++) {
        if (!names[i]) return dal__fail(error, DAL_EINVAL, "names[%zu] is NULL", i);
        const int status = set_parameter(record, names[i], values[i], p, error);
        if (status) return status;
    }
    return make(system, record, p, error);
}
