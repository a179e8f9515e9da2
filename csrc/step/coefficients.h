/* coefficients.h - how far the coefficients of series lead. */
#ifndef DAL__COEFFICIENTS_H
#define DAL__COEFFICIENTS_H

#include "algebra/algebra.h"
#include "dalembert/series.h"

/* Columns of coefficients, of which that of order k is `next` numbers after the one before. */
typedef struct dal__columns {
    const double *first; /* the first one, of order 0 */
    size_t next, order;
    double direction;    /* 1, or -1 if the motion goes back */
} dal__columns;

/* How many units lead to coefficients of a size whose log2 is given, by the decay of the last ones
 * (series.h).  Infinite if those are 0, and NaN if one is not finite. */
double dal__units_of(const double *decay, size_t order, double log_size);

/* Of so many units, those to the first change of sign of a column: its sign now, and how many of
 * its first coefficients are zeros of the series that do not count. */
double dal__until_change(const dal__columns *of, size_t column, double side, size_t zeros,
                         double units);

/* Those to where the argument of an exponential, a column, has grown too much. */
double dal__until_rise(const dal__columns *of, size_t column, double units);

/* A power of 2 next to a positive number. */
double dal__power_of_2(double x);

/* The sum of a, its low part and b, with its own low part. */
static inline double dal__sum_with_low(double a, double *low, double b)
{
    const double part = b + *low, sum = a + part, back = sum - a;
    *low = (a - (sum - back)) + (part - back);
    return sum;
}

/* The polynomial of a piece: y at t + s unit, from t to end. */
typedef struct dal__piece {
    const dal_series *series;
    size_t order;
    double t, end, unit;
    double tolerance, log_tolerance;      /* of the coefficients; its log2 */
    const double *y, *low, *coefficients; /* [width], [width], [(order + 1)*width] */
    const double *input;
    const double *side, *crossed;         /* [switches], as in series.h */
    const void *parameters;
} dal__piece;

/* Y[(order + 1)*width] <- the coefficients of the states about s, in a unit. */
void dal__write_about(const dal__piece *piece, double s, double unit, double *Y);

/* y[width], low[width] <- the numbers at t + s unit; change[width], aligned to 32, is scratch. */
void dal__numbers_at(const dal__piece *piece, double s, double *y, double *low, double *change);

#endif /* DAL__COEFFICIENTS_H */
