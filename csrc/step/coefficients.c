/* How far the coefficients of series lead. */
#include "step/coefficients.h"

/* Series do not see an exponential that is far below the last digit where they begin and large
 * later, as exp(-1000 x), or a narrow hill exp(-1000 x^2).  So its argument grows by at most RISE
 * in a piece, but from values where it is 0 in floating point to FAINT. */
static const double RISE = 20.0, FAINT = -700.0;

/* Of the length at which the last coefficients have the size that is allowed. */
static const double SAFETY = 0.96;

/* log2 x for a normal x > 0, between powers of 2 by a straight line, so at most 0.09 too small; 2^x
 * to 0.3 %.  Of a root of high order this is exact enough, and takes a tenth of the time. */
static double quick_log2(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (double)bits * 0x1p-52 - 1023.0;
}

static double quick_exp2(double x)
{
    if (!(fabs(x) < 1000.0)) return exp2(x);
    const double whole = floor(x), part = x - whole;
    const uint64_t bits = (uint64_t)(whole + 1023.0) << 52;
    double power;
    memcpy(&power, &bits, sizeof power);
    return power * (1.0 + part * (0.6565 + part * 0.3435));
}

/* Each of the last coefficients tells a radius of convergence, the least of which holds; a step is
 * that part of it of which the power order - 1 is the size. */
double dal__units_of(const double *decay, size_t order, double log_size)
{
    double least = HUGE_VAL;
    for (size_t l = 0; l < DAL_SERIES_LAST; l++) {
        if (!(decay[l] <= DBL_MAX)) return (double)NAN;
        if (decay[l] < DBL_MIN) continue;
        const double radius = -quick_log2(decay[l]) / (double)(order - DAL_SERIES_LAST + l);
        if (radius < least) least = radius;
    }
    const double share = log_size / (double)(order - 1);
    return least < HUGE_VAL ? SAFETY * quick_exp2(least + share) : least;
}

double dal__power_of_2(double x)
{
    int exponent;
    (void)frexp(x, &exponent);
    return ldexp(1.0, exponent);
}

/* The first change of sign of begin + sum_(k > 0) a_(zeros + k) r^k up to r = end, or end. */
static double first_change(const dal__columns *of, const double *a, size_t zeros, double begin,
                           double end)
{
    const size_t order = of->order - 1 - zeros;
    double c[DAL_ROOTS_MOST + 1], power = 1.0, rest = 0.0;
    c[0] = begin;
    for (size_t k = 1; k <= order; k++) {
        power *= of->direction * end;
        c[k] = a[(zeros + k) * of->next] * power;
        rest += fabs(c[k]);
    }
    if (rest < fabs(begin)) return end;
    dal__sign_changes found;
    dal__find_sign_changes(order, c, 0.0, &found);
    if (begin * found.first < 0.0) return 0.0; /* it begins at a zero but for roundoff */
    return found.count > 0 ? found.at[0] * end : end;
}

double dal__until_change(const dal__columns *of, size_t column, double side, size_t zeros,
                         double units)
{
    const double *const a = of->first + column;
    const double sign = zeros % 2 == 0 ? side : side * of->direction;
    const double begin = a[zeros * of->next];
    if (side == 0.0) return units;
    return sign * begin > 0.0 ? first_change(of, a, zeros, begin, units) : 0.0;
}

double dal__until_rise(const dal__columns *of, size_t column, double units)
{
    const double *const a = of->first + column;
    return first_change(of, a, 0, -fmax(RISE, FAINT - *a), units);
}

void dal__numbers_at(const dal__piece *piece, double s, double *y, double *low, double *change)
{
    piece->series->sum(piece->order, s, piece->coefficients, change);
    for (size_t i = 0; i < piece->series->states; i++) {
        double rest = piece->low[i];
        y[i] = dal__sum_with_low(piece->y[i], &rest, change[i]);
        low[i] = rest;
    }
}

/* Coefficients about s instead of 0, of vectors in rows that are so many apart.  Horner's sums for
 * one derivative after the other; four are led through the rows at once, each just behind the one
 * before. */
static void shift(size_t order, size_t apart, double s, dal_four *column)
{
    enum { AT_ONCE = 4 };
    for (size_t first = 0; first < order; first += AT_ONCE) {
        dal_four sum[AT_ONCE];
        size_t k = order;
        for (size_t i = 0; i < AT_ONCE; i++) sum[i] = column[order * apart];
        while (k-- > first + AT_ONCE - 1) {
            dal_four one = column[k * apart];
#pragma GCC unroll 4
            for (size_t i = 0; i < AT_ONCE; i++) one = sum[i] = one + s * sum[i];
            column[k * apart] = one;
        }
        for (size_t last = AT_ONCE - 1; last-- > 0;) { /* where the later ones have ended */
            if (first + last >= order) continue;
            dal_four one = column[(first + last) * apart];
            for (size_t i = 0; i <= last; i++) one = sum[i] = one + s * sum[i];
            column[(first + last) * apart] = one;
        }
    }
}

void dal__write_about(const dal__piece *piece, double s, double unit, double *Y)
{
    const size_t vectors = piece->series->width / 4, order = piece->order;
    const double ratio = unit / piece->unit;
    dal_four *const rows = (dal_four *)Y;
    double power = 1.0;
    memcpy(Y, piece->coefficients, (order + 1) * vectors * sizeof *rows);
    for (size_t c = 0; s != 0.0 && c < vectors; c++) shift(order, vectors, s, rows + c);
    for (size_t k = 1; ratio != 1.0 && k <= order; k++) {
        power *= ratio;
        for (size_t c = 0; c < vectors; c++) rows[k * vectors + c] *= power;
    }
}
