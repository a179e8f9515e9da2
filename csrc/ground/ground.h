/* ground.h - errors, memory and small things that every floor needs.
 *
 * Private functions that cross files are called dal__name. */
#ifndef DAL__GROUND_H
#define DAL__GROUND_H

#include "dalembert.h"

#include <float.h>
#include <stdbool.h>
#include <stdint.h>

/* Unit roundoff u = 2^-53, and the bound on the residual of D (residual.h) after every step. */
#define DAL_ROUNDOFF (DBL_EPSILON / 2)
#define DAL_RESIDUAL_BOUND(n) (4.0 * (double)(n) * DAL_ROUNDOFF)
/* The same of initial data that are taken to be meant to lie in D. */
#define DAL_CONSISTENT 1e-8

#define DAL_LENGTH(array) (sizeof(array) / sizeof(array)[0])

#if defined(__GNUC__)
__attribute__((format(printf, 3, 4)))
#endif
/* Writes the text (printf format) and the status to error, which may be NULL; returns status. */
int dal__fail(dal_error *error, int status, const char *format, ...);

#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
/* Adds words to the text, as many as there is room for. */
void dal__add_words(dal_error *error, const char *format, ...);

/* A number that a callback gives; the callback is NULL where the text need not name it. */
typedef struct dal__entry {
    const char *callback, *output;
    size_t row, column;
    double value;
} dal__entry;

#if defined(__GNUC__)
__attribute__((format(printf, 4, 5)))
#endif
/* The same about an entry: "callback: output[row,column]" stands before the text. */
int dal__fail_entry(dal_error *error, int status, const dal__entry *entry, const char *format, ...);

#if defined(__GNUC__)
__attribute__((format(printf, 4, 5)))
#endif
/* The same with the record of its cause, whose text comes after the words given here; nothing on
 * success. */
int dal__fail_because(dal_error *error, int status, const dal_error *cause, const char *format,
                      ...);

/* The name of an argument, and whether it is given: a pointer may stand there. */
typedef struct dal__argument {
    const char *name;
    bool given;
} dal__argument;

/* Clears the record; DAL_EINVAL with the name of the first argument that is NULL. */
int dal__require_arguments(dal_error *error, size_t count, const dal__argument *arguments);
#define DAL__REQUIRE(error, ...) \
    dal__require_arguments(error, DAL_LENGTH(((dal__argument[]){__VA_ARGS__})), \
                           (dal__argument[]){__VA_ARGS__})

/* An argument that has to be there, and its x[count] finite. */
typedef struct dal__numbers {
    const char *name;
    size_t count;
    const double *x;
} dal__numbers;

/* DAL_EINVAL, and the text names the first that is not as it has to be. */
int dal__require_numbers(dal_error *error, size_t count, const dal__numbers *arguments);
#define DAL__REQUIRE_FINITE(error, ...) \
    dal__require_numbers(error, DAL_LENGTH(((dal__numbers[]){__VA_ARGS__})), \
                        (dal__numbers[]){__VA_ARGS__})

/* DAL_EINVAL unless h is a step: finite and not 0. */
int dal__require_step(dal_error *error, double h);

/* DAL_EDOMAIN unless x[count], an output of this name, is NULL or finite. */
int dal__require_output(dal_error *error, const char *name, size_t count, const double *x);

/* A result of this name, and where it goes: NULL, if it is not wanted. */
typedef struct dal__result {
    const char *name;
    size_t count;
    const double *from;
    double *to; /* [count], both */
} dal__result;

/* All that is wanted, or nothing of it: DAL_EDOMAIN if a number is not finite. */
int dal__deliver(dal_error *error, size_t count, const dal__result *results);
#define DAL__DELIVER(error, ...) \
    dal__deliver(error, DAL_LENGTH(((dal__result[]){__VA_ARGS__})), (dal__result[]){__VA_ARGS__})

/* Status of what a user's callback returned: 0, DAL_EDOMAIN for > 0, DAL_EUSER for < 0. */
int dal__callback_status(int returned);

/* Seconds, of the time of day: it may be set back or forward. */
double dal__clock(void);

/* A caller's watch, asked every so many seconds. */
#define DAL_WATCH_SECONDS 0.05
typedef struct dal__watch {
    dal_watch_fn function; /* or NULL */
    void *ctx;
    double asked;          /* when */
    double made;           /* what dal__relay tells */
} dal__watch;

/* A watch of the caller's own watch ctx, for what is part of a longer computation: it sees how much
 * of that was made. */
int dal__relay(double far, void *ctx);

/* Asks the watch, unless that was done a moment ago.  DAL_STOPPED, DAL_EUSER. */
int dal__ask(dal__watch *watch, double far, dal_error *error);

/* A plan of arrays that share one allocation.  Usage: an arena {0}; dal__reserve for each array;
 * dal__allocate once; then the pointers are valid until dal__release. */
typedef struct arena {
    struct {
        void *slot; /* address of the pointer to set */
        size_t offset;
    } part[192];
    size_t parts, size;
    bool overflow;
    void *block;
} arena;

/* Plans count elements of size bytes for *slot (the address of a pointer to any object type). */
void dal__reserve(arena *a, void *slot, size_t count, size_t size);
/* The same of doubles for each of slot[slots]; as a call, for each of the addresses given. */
void dal__reserve_doubles(arena *a, size_t slots, double **const slot[], size_t count);
#define DAL__RESERVE(a, count, ...) \
    dal__reserve_doubles(a, DAL_LENGTH(((double **[]){__VA_ARGS__})), (double **[]){__VA_ARGS__}, \
                         count)
/* Zero-filled memory for all that was reserved; DAL_ENOMEM. */
int dal__allocate(arena *a, dal_error *error);
/* Room for one more element of size bytes in *slot, which has count: doubles the array where it is
 * full.  Free it by free().  DAL_ENOMEM. */
int dal__grow(void *slot, size_t count, size_t *room, size_t size, dal_error *error);
/* The arena may be part of what lies in its memory. */
void dal__release(arena *a);

/* a*b, or SIZE_MAX where that overflows. */
size_t dal__times(size_t a, size_t b);

static inline bool dal__all_finite(size_t count, const double *x)
{
    double zero = 0.0; /* x * 0 is NaN for Inf and NaN, and NaN stays; by threes, for speed */
    size_t i = 0;
    for (; i + 2 < count; i += 3) zero += (x[i] * 0.0 + x[i + 1] * 0.0) + x[i + 2] * 0.0;
    for (; i < count; i++) zero += x[i] * 0.0;
    return zero == 0.0;
}

#endif /* DAL__GROUND_H */
