/* check.h - the check macros that all C tests share.
 *
 * A test is a program: CHECK and CHECK_NEAR anywhere, `return check_done();` at the end of main.
 * A failed check prints where it stands and what it saw, and the program goes on. */
#ifndef DALEMBERT_CHECK_H
#define DALEMBERT_CHECK_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

static struct {
    unsigned long passed, failed;
} check_count;

static inline void check_record(bool passed)
{
    if (passed) check_count.passed++;
    else check_count.failed++;
}

static inline void check_true(bool condition, const char *text, const char *file, int line)
{
    check_record(condition);
    if (!condition) fprintf(stderr, "%s:%d: failed: %s\n", file, line, text);
}

/* Whether long loops are to be short: under valgrind and the sanitizers, where a few passes show as
 * much as many. */
static inline bool brief(void)
{
    return getenv("DALEMBERT_BRIEF") != NULL;
}

/* NaN is near nothing; an infinity is near itself. */
static inline void check_near(double a, double b, double tolerance, const char *text,
                              const char *file, int line)
{
    const bool near = a == b || fabs(a - b) <= tolerance;
    check_record(near);
    if (!near)
        fprintf(stderr, "%s:%d: failed: %s: %.17g and %.17g differ by %.3g > %.3g\n", file, line,
                text, a, b, fabs(a - b), tolerance);
}

/* Prints the counts; the exit status of the program. */
static inline int check_done(void)
{
    printf("%lu passed, %lu failed\n", check_count.passed, check_count.failed);
    return check_count.failed == 0 ? 0 : 1;
}

#define CHECK(condition) check_true((condition), #condition, __FILE__, __LINE__)
#define CHECK_NEAR(a, b, tolerance) \
    check_near((a), (b), (tolerance), #a " near " #b, __FILE__, __LINE__)

#endif /* DALEMBERT_CHECK_H */
