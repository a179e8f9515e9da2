/* series.h - Taylor series of motions, for generated code.
 *
 * The numbers y[states] are the coordinates q[n] and w[states - n], from which v = E(t, q) w + e(t,
 * q) follows.  If D has such an E, w are n - m quasi-velocities, and v is in D for all w. Otherwise
 * w is v.  The coefficient Y_k of order k is that of s^k in y(t + s unit).  All of them are of the
 * same size if the unit is about the length of a step.
 *
 * The coefficient of order k of each product, quotient and function is a convolution, sum_j A_j
 * B_(k-j).  Its middle part, j = 1 ... k-1, has lower orders only.  So the middle parts of all
 * convolutions of order k are computed together, four in a vector.  The elements of vectors are
 * computed like scalars, so all processors give the same bits.  Header only: generated code has no
 * library to link. */
#ifndef DALEMBERT_SERIES_H
#define DALEMBERT_SERIES_H

#include <dalembert/lu.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

/* The highest order, and how many of the last coefficients determine the size of a step. */
enum { DAL_SERIES_MOST = 40, DAL_SERIES_LAST = 4 };

/* The beginning of a series. */
typedef struct dal_series_at {
    double t;              /* the time */
    double unit;           /* the unit of s, a power of 2 */
    size_t exact;          /* below this order coefficients are divided by k, which costs up to a
                              fourth of the time; from there on they are multiplied by the rounded
                              1/k.  For low orders that is a bias, by which the energy drifts */
    const double *y, *low; /* [width] the numbers, and their parts below the last digit */
    const double *u;       /* [inputs] */
    const double *side;    /* [switches] 1, -1, or 0 for a switch that is 0 */
    const double *crossed; /* [switches] not 0 for one that is 0 at t, but for roundoff */
} dal_series_at;

/* The series of a system.  The pointer p is ctx of its definition. */
#define DAL_SERIES_ABI 2u
typedef struct dal_series {
    unsigned abi;    /* DAL_SERIES_ABI, as the compiler saw it */
    size_t states;   /* of y */
    size_t switches; /* series that follow on those of y: until one of them changes its sign,
                        functions such as maxima have the branches of these sides */
    size_t exponents; /* series that follow on the switches: the arguments of exponentials, which
                        may rise from below the last digit; pieces limit their growth */
    size_t width;    /* numbers of a row: all together, to a multiple of four */
    size_t room;     /* numbers of workspace for each order */
    int in_D;        /* 1: v is in D for all y; 0: w is v */
    int is_doubtful; /* 1: a pulse or a branch may come that a series before it does not show */
    /* Y[(order + 1)*width] <- the coefficients; work[(order + 1)*room].  Both are aligned to 64. */
    void (*expand)(const dal_series_at *at, size_t order, double *Y, double *work, const void *p);
    /* The same for four motions, with the same bits; work[4*(order + 1)*room].  NULL if the system
     * was not compiled for it, or has switches. */
    void (*expand_four)(const dal_series_at *const *at, size_t order, double *const *Y,
                        double *work, const void *const *p);
    /* decay[DAL_SERIES_LAST] <- the largest |Y_k| of all states, relative to the largest of the
     * first coefficients of that state, for k = order - 3 ... order. */
    void (*decay)(size_t order, const double *Y, double *decay);
    /* change[width] <- y(t + s unit) - y(t) by the coefficients up to an order. */
    void (*sum)(size_t order, double s, const double *Y, double *change);
    /* slope[width] <- dy/ds at t + s unit. */
    void (*slope)(size_t order, double s, const double *Y, double *slope);
    /* v[n] <- the velocity of y; w[states - n] <- that of x[2n]. */
    void (*velocity)(double t, const double *y, const double *u, double *v, const void *p);
    void (*quasi)(double t, const double *x, const double *u, double *w, const void *p);
} dal_series;

/* The series of event functions along the motions of a system.  Those of a function that has not
 * been compiled for it are not known, and its values are compared instead. */
typedef struct dal_event_series {
    unsigned abi;     /* DAL_SERIES_ABI */
    size_t states;    /* those of dal_series */
    size_t functions; /* in the first columns */
    size_t switches, exponents, width, room; /* as above, in the columns that follow */
    int is_doubtful;
    /* Y[(order + 1)*width] <- the coefficients, from those of the states in rows of y_width; at has
     * the values of the states, with low parts.  work[(order + 1)*room].  The pointer p is the
     * context of the event.  All are aligned to 64. */
    void (*expand)(const dal_series_at *at, size_t order, const double *states, size_t y_width,
                   double *Y, double *work, const void *p);
    void (*decay)(size_t order, const double *Y, double *decay);
} dal_event_series;

#ifdef __GNUC__
typedef double dal_four __attribute__((vector_size(32), may_alias));

typedef long long dal_four_bits __attribute__((vector_size(32), may_alias));

/* The series of derivatives of a motion by its start, parameters and inputs, along a motion whose
 * series are known; four at once.  A direction a has the numbers dy of y, and dz of the parameters
 * and inputs, which are constant.  For order 1 the numbers are dy, dz.  For order 2 there are two
 * directions a and b.  First come dy in a, in b and in both, then dz in a and in b. */
typedef struct dal_variation_series {
    unsigned abi;  /* DAL_SERIES_ABI */
    int order;     /* 1 or 2 */
    size_t states, parameters, inputs;
    size_t switches; /* columns that follow on those of states: derivatives of the switches; none
                        for order 2 */
    size_t width;  /* columns */
    size_t room;   /* numbers of workspace for each order */
    /* Y[(order + 1)*width] <- the coefficients, from those of the states in rows of y_width;
     * columns[numbers].  work[(order + 1)*room].  All are aligned to 64. */
    void (*expand)(const dal_series_at *at, size_t order, const double *states, size_t y_width,
                   const dal_four *columns, dal_four *Y, double *work, const void *p);
    /* As those of dal_series, of all four; the columns of states change by their polynomials. */
    void (*decay)(size_t order, const dal_four *Y, double *decay);
    void (*lead)(size_t order, double s, const dal_four *Y, dal_four *columns);
    /* values <- the derivatives of v[n] in each direction. */
    void (*velocity)(double t, const double *y, const double *u, const double *columns,
                     double *values, const void *p);
    /* values[states - n] <- the derivatives of w, from dx[2n] and dz in one direction. */
    void (*quasi)(double t, const double *x, const double *u, const double *columns,
                  double *values, const void *p);
} dal_variation_series;

/* Operations of expand and expand_four.  Their texts differ in the type of the numbers: double, or
 * dal_four for four motions. */

/* x/k, exactly or by 1/k. */
#define DAL_SERIES_OVER(x, exact, k, inverse) ((exact) ? (x) / (k) : (x) * (inverse))

/* The rounding error of product = a b. */
#define DAL_SERIES_REST(type, a, b, product) \
    __extension__({ \
        const double both_ = 0x1p27 + 1.0; \
        const type a_ = (a), b_ = (b), x_ = both_ * a_, y_ = both_ * b_; \
        const type a1_ = x_ - (x_ - a_), b1_ = y_ - (y_ - b_), a2_ = a_ - a1_, b2_ = b_ - b1_; \
        ((a1_ * b1_ - (product)) + a1_ * b2_ + a2_ * b1_) + a2_ * b2_; \
    })

/* Operations of expand_four: a number, a function, a number of each motion, x or y by a condition,
 * and one/x, or 0 for x = 0.  The last one writes a row of four columns for each motion. */
#define DAL_SERIES_ALL(x) ((dal_four){x, x, x, x})
#define DAL_SERIES_EACH(function, x) \
    __extension__({ \
        const dal_four x_ = (x); \
        (dal_four){function(x_[0]), function(x_[1]), function(x_[2]), function(x_[3])}; \
    })
#define DAL_SERIES_EACH_OF_TWO(function, x, y) \
    __extension__({ \
        const dal_four x_ = (x), y_ = (y); \
        (dal_four){function(x_[0], y_[0]), function(x_[1], y_[1]), function(x_[2], y_[2]), \
                   function(x_[3], y_[3])}; \
    })
#define DAL_SERIES_OF(at, what) ((dal_four){at[0] what, at[1] what, at[2] what, at[3] what})
#define DAL_SERIES_CHOOSE(which, x, y) \
    __extension__({ \
        const dal_four_bits which_ = (which), x_ = (dal_four_bits)(x), y_ = (dal_four_bits)(y); \
        (dal_four)((x_ & which_) | (y_ & ~which_)); \
    })
#define DAL_SERIES_INVERSE(one, x) \
    __extension__({ \
        const dal_four x_ = (x), quotient_ = (one) / x_; \
        (dal_four)((dal_four_bits)quotient_ & (dal_four_bits)(x_ != 0.0)); \
    })

DAL_LU_INLINE void dal_series_deal(double *const *Y, size_t place, const dal_four *columns)
{
    for (size_t i = 0; i < 4; i++)
        *(dal_four *)(Y[i] + place) =
            (dal_four){columns[0][i], columns[1][i], columns[2][i], columns[3][i]};
}

/* M[vectors] <- sum_j A_j B_(k-j), j = 1 ... k-1, for A[k*vectors] and B[k*vectors], of a function
 * whose factors A are vectors, or numbers that all four share.  The sums of up to four vectors are
 * in registers.  The smallest terms come first in convergent series. */
#define DAL_SERIES_MIDDLE(name, part, factor) \
    DAL_LU_INLINE void part(size_t k, size_t vectors, size_t count, const factor *A, \
                            const dal_four *B, dal_four *M) \
    { \
        dal_four sum[4] = {{0.0}}, other[4] = {{0.0}}; \
        size_t j = k / 2, i = k - j; \
        if (i == j) { \
            _Pragma("GCC unroll 4") for (size_t c = 0; c < count; c++) \
                sum[c] = A[j * vectors + c] * B[j * vectors + c]; \
            j--, i++; \
        } \
        for (; j > 0; j--, i++) { \
            _Pragma("GCC unroll 4") for (size_t c = 0; c < count; c++) { \
                sum[c] += A[j * vectors + c] * B[i * vectors + c]; \
                other[c] += A[i * vectors + c] * B[j * vectors + c]; \
            } \
        } \
        _Pragma("GCC unroll 4") for (size_t c = 0; c < count; c++) M[c] = sum[c] + other[c]; \
    } \
    DAL_LU_INLINE void name(size_t k, size_t vectors, const factor *A, const dal_four *B, \
                            dal_four *M) \
    { \
        size_t c = 0; \
        for (; c + 4 <= vectors; c += 4) part(k, vectors, 4, A + c, B + c, M + c); \
        if (vectors % 4) part(k, vectors, vectors % 4, A + c, B + c, M + c); \
    }
DAL_SERIES_MIDDLE(dal_series_middle, dal_series_part, dal_four)
DAL_SERIES_MIDDLE(dal_series_shared, dal_series_shared_part, double)

DAL_LU_INLINE void dal_series_sum(size_t width, size_t order, double s, const double *Y,
                                  double *change)
{
    const dal_four *const coefficients = (const dal_four *)Y;
    const size_t vectors = width / 4;
    const double square = s * s;
    for (size_t c = 0; c < vectors; c++) { /* Horner's sums of odd and of even powers */
        const dal_four *const at = coefficients + c;
        dal_four one = at[order * vectors], other = at[(order - 1) * vectors];
        size_t k = order - 2;
        for (; k > 1; k -= 2) {
            one = one * square + at[k * vectors];
            other = other * square + at[(k - 1) * vectors];
        }
        if (k == 1) one = one * square + at[vectors];
        ((dal_four *)change)[c] = k == 1 ? one * s + other * square : one * square + other * s;
    }
}

DAL_LU_INLINE void dal_series_slope(size_t width, size_t order, double s, const double *Y,
                                    double *slope)
{
    const dal_four *const coefficients = (const dal_four *)Y;
    const size_t vectors = width / 4;
    const double square = s * s;
    for (size_t c = 0; c < vectors; c++) {
        const dal_four *const at = coefficients + c;
        dal_four one = (double)order * at[order * vectors];
        dal_four other = (double)(order - 1) * at[(order - 1) * vectors];
        size_t k = order - 2;
        for (; k > 1; k -= 2) {
            one = one * square + (double)k * at[k * vectors];
            other = other * square + (double)(k - 1) * at[(k - 1) * vectors];
        }
        if (k == 1) one = one * square + at[vectors];
        ((dal_four *)slope)[c] = k == 1 ? one + other * s : one * s + other;
    }
}

/* *most <- the larger of it and factor |x|; *size <- |x|.  Vectors that functions return would
 * depend on the set of instructions. */
DAL_LU_INLINE void dal_series_look(const dal_four *x, const dal_four *factor, dal_four *size,
                                   dal_four *most)
{
    *size = (dal_four)((dal_four_bits)*x & 0x7fffffffffffffffLL);
    const dal_four one = *size * *factor;
    const dal_four_bits is_larger = one > *most;
    *most = (dal_four)(((dal_four_bits)one & is_larger) | ((dal_four_bits)*most & ~is_larger));
}

DAL_LU_INLINE double dal_series_most(const dal_four *x)
{
    const double one = (*x)[0] > (*x)[1] ? (*x)[0] : (*x)[1];
    const double other = (*x)[2] > (*x)[3] ? (*x)[2] : (*x)[3];
    return one > other ? one : other;
}

/* A change that is so much smaller than the largest number of y needs no digits of its own. */
#define DAL_SERIES_FLOOR 0x1p-500

/* dal_series_decay where a state has no coefficients of orders 1 to 3. */
DAL_LU_RARE void dal_series_decay_of_any(size_t width, size_t order, const double *Y,
                                         double *decay)
{
    for (size_t l = 0; l < DAL_SERIES_LAST; l++) decay[l] = 0.0;
    for (size_t i = 0; i < width; i++) {
        double size = 0.0;
        for (size_t k = 1; k <= order && (k <= 3 || size == 0.0); k++)
            size = fmax(size, fabs(Y[k * width + i]));
        for (size_t l = 0; l < DAL_SERIES_LAST && size > 0.0; l++) {
            const double last = fabs(Y[(order - DAL_SERIES_LAST + 1 + l) * width + i]);
            decay[l] = fmax(decay[l], last / size);
        }
    }
}

DAL_LU_INLINE void dal_series_decay(size_t width, size_t order, const double *Y, double *decay)
{
    const dal_four *const all = (const dal_four *)Y;
    const size_t vectors = width / 4;
    const dal_four *const last = all + (order - DAL_SERIES_LAST + 1) * vectors;
    const dal_four unit = {1.0, 1.0, 1.0, 1.0};
    dal_four most[DAL_SERIES_LAST] = {{0.0}}, sum = {0.0}, place = {0.0}, ignored;
    dal_four_bits lost = {0};
    for (size_t c = 0; c < vectors; c++) dal_series_look(&all[c], &unit, &ignored, &place);
    const double floor = DAL_SERIES_FLOOR * dal_series_most(&place) + DBL_MIN;
    const dal_four least = {floor, floor, floor, floor};
    for (size_t c = 0; c < vectors; c++) {
        dal_four size = {0.0}, one;
        for (size_t k = 1; k <= 3; k++)
            dal_series_look(&all[k * vectors + c], &unit, &one, &size);
        const dal_four per = 1.0 / (size + least);
#pragma GCC unroll 4
        for (size_t l = 0; l < DAL_SERIES_LAST; l++) {
            dal_series_look(&last[l * vectors + c], &per, &one, &most[l]);
            lost |= (size == 0.0) & (one != 0.0);
            sum += one;
        }
    }
    if (lost[0] | lost[1] | lost[2] | lost[3]) dal_series_decay_of_any(width, order, Y, decay);
    else
        for (size_t l = 0; l < DAL_SERIES_LAST; l++) decay[l] = dal_series_most(&most[l]);
    const double total = (sum[0] + sum[1]) + (sum[2] + sum[3]);
    if (!(total <= 0x1p1000)) decay[0] = (double)NAN;
}
#endif

#endif /* DALEMBERT_SERIES_H */
