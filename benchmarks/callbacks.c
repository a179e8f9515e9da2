/* callbacks.c - three systems as a user writes them, in a file of their own, so that no compiler
 * inlines them into the step.  Definitions as those of the library's systems of the same names. */
#include "bench.h"

#include <math.h>

/* v_z = y v_x */
static int particle(double t, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[2] - q[1] * v[0];
    if (phi_v) {
        phi_v[0] = -q[1];
        phi_v[1] = 0.0;
        phi_v[2] = 1.0;
    }
    if (phi_q) {
        phi_q[0] = 0.0;
        phi_q[1] = -v[0];
        phi_q[2] = 0.0;
    }
    return 0;
}

/* -sin(theta) v_x + cos(theta) v_y = a v_theta: the blade, a behind the centre of mass, does not
 * slip sideways */
static const double sleigh_a = 0.8;

static int sleigh(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    if (phi) phi[0] = -s * v[0] + c * v[1] - sleigh_a * v[2];
    if (phi_v) {
        phi_v[0] = -s;
        phi_v[1] = c;
        phi_v[2] = -sleigh_a;
    }
    if (phi_q) {
        phi_q[0] = phi_q[1] = 0.0;
        phi_q[2] = -c * v[0] - s * v[1];
    }
    return 0;
}

/* v_x = R cos(phi) v_theta, v_y = R sin(phi) v_theta: rolling without slipping */
static const double disk_R = 0.5;

static int disk(double t, const double *q, const double *v, double *phi, double *phi_v,
                double *phi_q, double *phi_t, void *ctx)
{
    const double s = disk_R * sin(q[3]), c = disk_R * cos(q[3]);
    if (phi) {
        phi[0] = v[0] - c * v[2];
        phi[1] = v[1] - s * v[2];
    }
    if (phi_v) {
        phi_v[0] = phi_v[5] = 1.0;
        phi_v[1] = phi_v[3] = phi_v[4] = phi_v[7] = 0.0;
        phi_v[2] = -c;
        phi_v[6] = -s;
    }
    if (phi_q) {
        phi_q[0] = phi_q[1] = phi_q[2] = phi_q[4] = phi_q[5] = phi_q[6] = 0.0;
        phi_q[3] = s * v[2];
        phi_q[7] = -c * v[2];
    }
    return 0;
}

static const double particle_mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
static const double particle_state[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3};
static const double sleigh_mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 0.6};
static const double sleigh_state[6] = {0.0, 0.0, 0.0, 0.4, 0.8, 1.0};
static const double disk_mass[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.25};
static const double disk_state[8] = {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 1.0};

const dal_system_def bench_systems[BENCH_SYSTEMS] = {
    [BENCH_PARTICLE] = {.n = 3, .m = 1, .mass = particle_mass, .constraint = particle,
                        .steady = DAL_STEADY_PROVED, .name = "particle", .state = particle_state},
    [BENCH_SLEIGH] = {.n = 3, .m = 1, .mass = sleigh_mass, .constraint = sleigh,
                      .name = "sleigh", .state = sleigh_state},
    [BENCH_DISK] = {.n = 4, .m = 2, .mass = disk_mass, .constraint = disk,
                    .steady = DAL_STEADY_PROVED, .name = "disk", .state = disk_state},
};
