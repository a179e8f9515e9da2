/* One step of the explicit Runge-Kutta method of order 8 with an embedded one of order 7, in 13
 * stages: P. J. Prince, J. R. Dormand, High order embedded Runge-Kutta formulae, J. Comput. Appl.
 * Math. 7 (1981) 67-75, RK8(7)13M.
 *
 * GSL has it too, and the numbers are its: here its sums cost less than a small system's field.
 * They are taken by packets, the last of which overlaps the one before where the entries do not
 * come out even.  No packet has entries of both halves of a state: the rates of q are the v of a
 * stage, so the next q is at hand while the accelerations are still being worked out. */
#include "algebra/algebra.h"

#include <string.h>

#if defined(__GNUC__)
typedef double packet
    __attribute__((vector_size(2 * sizeof(double)), aligned(sizeof(double)), may_alias));
#define GATHER(x) ((packet){(x)[0], (x)[1]})
#define INLINE static inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 16")
#else
typedef double packet;
#define GATHER(x) (*(x))
#define INLINE static inline
#define UNROLL
#endif

enum { WIDTH = sizeof(packet) / sizeof(double), STAGES = 13, MOST_TERMS = 9 };

/* first k_0 + sum_r a_r k_(from+r) of the stages before, and where on the step the result is. */
typedef struct sum {
    double at, first;
    size_t from, count;
    double a[MOST_TERMS];
} sum;

static const sum points[STAGES] = {
    {.at = 0.0}, /* its slope is known */
    {1.0 / 18.0, 1.0 / 18.0, 1, 0, {0.0}},
    {1.0 / 12.0, 1.0 / 48.0, 1, 1, {1.0 / 16.0}},
    {1.0 / 8.0, 1.0 / 32.0, 2, 1, {3.0 / 32.0}},
    {5.0 / 16.0, 5.0 / 16.0, 2, 2, {-75.0 / 64.0, 75.0 / 64.0}},
    {3.0 / 8.0, 3.0 / 80.0, 3, 2, {3.0 / 16.0, 3.0 / 20.0}},
    {59.0 / 400.0, 29443841.0 / 614563906.0, 3, 3,
     {77736538.0 / 692538347.0, -28693883.0 / 1125000000.0, 23124283.0 / 1800000000.0}},
    {93.0 / 200.0, 16016141.0 / 946692911.0, 3, 4,
     {61564180.0 / 158732637.0, 22789713.0 / 633445777.0, 545815736.0 / 2771057229.0,
      -180193667.0 / 1043307555.0}},
    {5490023248.0 / 9719169821.0, 39632708.0 / 573591083.0, 3, 5,
     {-433636366.0 / 683701615.0, -421739975.0 / 2616292301.0, 100302831.0 / 723423059.0,
      790204164.0 / 839813087.0, 800635310.0 / 3783071287.0}},
    {13.0 / 20.0, 246121993.0 / 1340847787.0, 3, 6,
     {-37695042795.0 / 15268766246.0, -309121744.0 / 1061227803.0, -12992083.0 / 490766935.0,
      6005943493.0 / 2108947869.0, 393006217.0 / 1396673457.0, 123872331.0 / 1001029789.0}},
    {1201146811.0 / 1299019798.0, -1028468189.0 / 846180014.0, 3, 7,
     {8478235783.0 / 508512852.0, 1311729495.0 / 1432422823.0, -10304129995.0 / 1701304382.0,
      -48777925059.0 / 3047939560.0, 15336726248.0 / 1032824649.0, -45442868181.0 / 3398467696.0,
      3065993473.0 / 597172653.0}},
    {1.0, 185892177.0 / 718116043.0, 3, 8,
     {-3185094517.0 / 667107341.0, -477755414.0 / 1098053517.0, -703635378.0 / 230739211.0,
      5731566787.0 / 1027545527.0, 5232866602.0 / 850066563.0, -4093664535.0 / 808688257.0,
      3962137247.0 / 1805957418.0, 65686358.0 / 487910083.0}},
    {1.0, 403863854.0 / 491063109.0, 3, 9, /* the last slope takes part, to be looked at */
     {-5068492393.0 / 434740067.0, -411421997.0 / 543043805.0, 652783627.0 / 914296604.0,
      11173962825.0 / 925320556.0, -13158990841.0 / 6184727034.0, 3936647629.0 / 1978049680.0,
      -160528059.0 / 685178525.0, 248638103.0 / 1413531060.0, 0.0}},
};

static const sum end_of_order_8 = {
    1.0, 14005451.0 / 335480064.0, 5, 8,
    {-59238493.0 / 1068277825.0, 181606767.0 / 758867731.0, 561292985.0 / 797845732.0,
     -1041891430.0 / 1371343529.0, 760417239.0 / 1151165299.0, 118820643.0 / 751138087.0,
     -528747749.0 / 2220607170.0, 1.0 / 4.0}};

static const sum end_of_order_7 = {
    1.0, 13451932.0 / 455176623.0, 5, 8,
    {-808719846.0 / 976000145.0, 1757004468.0 / 5645159321.0, 656045339.0 / 265891186.0,
     -3867574721.0 / 1518517206.0, 465885868.0 / 322736535.0, 53011238.0 / 667516719.0,
     2.0 / 45.0, 0.0}};

void dal__rk8pd_reserve(dal__rk8pd *self, size_t N, arena *a)
{
    const size_t row = N > WIDTH ? N : WIDTH;
    self->N = N;
    DAL__RESERVE(a, dal__times(STAGES, row), &self->slopes);
    DAL__RESERVE(a, row, &self->start, &self->point, &self->difference);
}

/* How many packets N numbers have that are one half of a state. */
INLINE size_t packets(size_t N) { return (N + WIDTH - 1) / WIDTH; }

/* Where packet k of a state of N numbers begins. */
INLINE size_t place(size_t N, size_t k)
{
    const size_t half = N / 2, before = packets(half);
    const size_t begin = k < before ? 0 : half, end = k < before ? half : N;
    const size_t i = begin + (k - (k < before ? 0 : before)) * WIDTH;
    return i + WIDTH <= end ? i : end > WIDTH ? end - WIDTH : 0;
}

/* The packet at i of a sum over the slopes, which are rows of so many numbers.  The last of them
 * has just been written, and is read number by number: at once it would have to wait until it is
 * in memory. */
INLINE packet add_up(const sum *of, size_t row, const double *slopes, size_t i)
{
    packet total = of->first * *(const packet *)(slopes + i);
    slopes += of->from * row + i;
    UNROLL for (size_t r = 0; r + 1 < of->count; r++)
        total += of->a[r] * *(const packet *)(slopes + r * row);
    if (of->count == 0) return total;
    const volatile double *const last = slopes + (of->count - 1) * row;
    return total + of->a[of->count - 1] * GATHER(last);
}

/* The same text for any size, and for those whose loops are unrolled: what the slopes or a stage
 * have that is not finite is in the next point. */
INLINE int step(dal__rk8pd *self, size_t N, double t0, double elapsed, double h, double *y,
                const double *slope, double *step_error, dal_error *error)
{
    const size_t row = N > WIDTH ? N : WIDTH, count = packets(N / 2) + packets(N - N / 2);
    double *const start = self->start, *const point = self->point, *const slopes = self->slopes;
    memcpy(start, y, N * sizeof *y);
    memcpy(slopes, slope, N * sizeof *slope);
    UNROLL for (size_t s = 1; s < STAGES; s++) {
        packet zeros = {0};
        for (size_t k = 0; k < count; k++) {
            const size_t i = place(N, k);
            const packet entries = *(packet *)(start + i) + h * add_up(&points[s], row, slopes, i);
            *(packet *)(point + i) = entries;
            zeros += entries * 0.0;
        }
        double zero[WIDTH];
        memcpy(zero, &zeros, sizeof zero);
        if (zero[0] + zero[WIDTH - 1] != 0.0) {
            const bool before = !dal__all_finite(N, slopes + (s - 1) * row);
            return dal__not_finite(error, before ? "field" : "state",
                                   t0 + (elapsed + points[before ? s - 1 : s].at * h));
        }
        self->evaluations++;
        const int status = self->field(t0 + (elapsed + points[s].at * h), point, slopes + s * row,
                                       self->ctx, error);
        if (status) return status;
    }
    for (size_t k = 0; k < count; k++) {
        const size_t i = place(N, k);
        const packet change = add_up(&end_of_order_8, row, slopes, i);
        *(packet *)(self->difference + i) =
            h * (add_up(&end_of_order_7, row, slopes, i) - change);
        *(packet *)(point + i) = *(packet *)(start + i) + h * change;
    }
    memcpy(y, point, N * sizeof *y);
    memcpy(step_error, self->difference, N * sizeof *step_error);
    return DAL_SUCCESS;
}

int dal__rk8pd_step(dal__rk8pd *self, double t0, double elapsed, double h, double *y,
                    const double *slope, double *step_error, dal_error *error)
{
    const size_t N = self->N;
    if (N == 6) return step(self, 6, t0, elapsed, h, y, slope, step_error, error);
    if (N == 8) return step(self, 8, t0, elapsed, h, y, slope, step_error, error);
    return step(self, N, t0, elapsed, h, y, slope, step_error, error);
}
