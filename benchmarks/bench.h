/* bench.h - what the benchmarks share: systems, a clock, and the table that they print.
 *
 * A benchmark prints what it measured beside its bar and fails if a bar is missed.  Times are
 * minima over interleaved repetitions, and bars are ratios of times from the same run, so that
 * neither the machine nor its other work matters much. */
#ifndef DALEMBERT_BENCH_H
#define DALEMBERT_BENCH_H

#define _POSIX_C_SOURCE 200809L

#include "oracle/multiroot.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Free particle, sleigh, rolling disk: V = 0, diagonal mass; callbacks.c. */
enum { BENCH_PARTICLE, BENCH_SLEIGH, BENCH_DISK, BENCH_SYSTEMS };
extern const dal_system_def bench_systems[BENCH_SYSTEMS];

/* Seconds. */
static inline double bench_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static inline void bench_keep_least(double *least, double value)
{
    if (value < *least) *least = value;
}

/* A line of the table: what was measured, without a bar or with one that it keeps or misses. */
static inline void bench_report(const char *what, double measured, const char *unit)
{
    printf("  %-52s %8.2f %s\n", what, measured, unit);
}

static inline bool bench_at_most(const char *what, double measured, double bar)
{
    const bool kept = measured <= bar;
    printf("  %-52s %8.2f   <= %-4g %s\n", what, measured, bar, kept ? "ok" : "MISSED");
    return kept;
}

static inline bool bench_at_least(const char *what, double measured, double bar)
{
    const bool kept = measured >= bar;
    printf("  %-52s %8.2f   >= %-4g %s\n", what, measured, bar, kept ? "ok" : "MISSED");
    return kept;
}

/* Ends the program if a call of the library failed. */
static inline void bench_require(int status, const char *what)
{
    if (status == DAL_SUCCESS) return;
    fprintf(stderr, "%s: %s\n", what, dal_strerror(status));
    exit(EXIT_FAILURE);
}

/* A stepper of the midpoint scheme, not started. */
static inline dal_stepper *bench_stepper(way by, const dal_system *system)
{
    dal_scheme scheme;
    dal_stepper *stepper = NULL;
    bench_require(dal_scheme_find(&scheme, "midpoint", NULL), "dal_scheme_find");
    bench_require(new_stepper_by(by, &stepper, system, &scheme, NULL), "dal_stepper_new");
    return stepper;
}

/* Puts a stepper at the default initial data of its system. */
static inline void bench_start(dal_stepper *stepper, const dal_system_def *def, double h)
{
    bench_require(dal_stepper_start(stepper, 0.0, h, def->state, DAL_CHECK, DAL_INITIAL_NONE),
                  "dal_stepper_start");
}

#endif /* DALEMBERT_BENCH_H */
