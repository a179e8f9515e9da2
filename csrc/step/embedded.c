/* The error of a step, from the states between its stages: E = sum_i w_i (Y_i - Y_0) = O(h^(q+1)).
 *
 * A first order map of step g is a series 1 + g D_1 + g^2 D_2 + ... in operators of which nothing
 * is known, its adjoint the inverse of that at -g, and Y_i has a coefficient for each word of them.
 * E is O(h^(q+1)) if the weights cancel all words of degree q and less, which are linear equations;
 * of their solutions with w = 1 for the last state the shortest is taken.  A symmetric map is a
 * first order map of half the step and then its adjoint: no word tells one from the other. */
#include "step/embedded.h"

#include <math.h>
#include <string.h>

/* A word is a number: each letter D_k is a 1 and k-1 zeros, in binary.  So those of degree d are
 * the numbers from 2^(d-1) to 2^d - 1, and 0 is the word without letters. */
enum { MOST = 9, WORDS = 1 << MOST }; /* the highest degree, and the words up to it */

/* The last letter of a word, which is not 0. */
static unsigned last_letter(unsigned word)
{
    unsigned k = 1;
    for (; !(word & 1); word >>= 1) k++;
    return k;
}

/* y[words] <- the series after a step g by the map, or by its adjoint; with all terms positive if
 * sizes. */
static void multiply(unsigned words, double g, bool adjoint, bool sizes, double *y)
{
    double power[MOST + 1] = {1.0};
    const double base = sizes ? fabs(g) : adjoint ? -g : g;
    for (unsigned k = 1; k <= MOST; k++) power[k] = base * power[k - 1];
    for (unsigned i = 1; i < words; i++) {
        const unsigned word = adjoint ? i : words - i, k = last_letter(word);
        const double term = power[k] * y[word >> k];
        y[word] += adjoint && !sizes ? -term : term;
    }
}

/* series[(stages+1)*words] <- those of the states before the stages, and of the last one. */
static void expand(const dal__composition *of, unsigned words, bool sizes, double *series)
{
    double y[WORDS] = {1.0};
    memcpy(series, y, words * sizeof *y);
    for (size_t i = 0, j = 0; i < of->stages; i++) {
        for (; j < of->ends[i]; j++) {
            const double beta = of->substep[j].beta, g = of->substep[j].fraction;
            if (beta == 0.5) {
                multiply(words, g / 2, false, sizes, y);
                multiply(words, g / 2, true, sizes, y);
            } else {
                multiply(words, g, beta != of->substep[0].beta, sizes, y);
            }
        }
        memcpy(series + (i + 1) * words, y, words * sizeof *y);
    }
}

/* Whether all sub-steps are of one map and its adjoint. */
static bool is_of_one_map(const dal__composition *of)
{
    for (size_t j = 0; j < of->ends[of->stages - 1]; j++)
        if (of->substep[j].beta != of->substep[0].beta
            && of->substep[j].beta != 1.0 - of->substep[0].beta)
            return false;
    return true;
}

/* x.y, in four sums, none of which waits for another. */
static double dot(size_t count, const double *x, const double *y)
{
    double sum[4] = {0.0};
    size_t i = 0;
    for (; i + 4 <= count; i += 4)
        for (size_t j = 0; j < 4; j++) sum[j] += x[i + j] * y[i + j];
    for (; i < count; i++) sum[0] += x[i] * y[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* One more equation row.w = right for the weights: made orthogonal to those before it, row[known]
 * of length 1 with right[known]; size is that of the terms of its entries.  False if it
 * contradicts them. */
static bool add_equation(size_t stages, double size, size_t *known, double *row, double *right)
{
    static const double noise = 1e-13; /* those that are regular in known records are above 1e-11 */
    double *const mine = row + *known * stages, terms = size, length = size;
    for (int pass = 0; pass < 2 && length > noise * size; pass++) { /* most are dependent */
        for (size_t k = 0; k < *known; k++) {
            const double *const other = row + k * stages;
            const double part = dot(stages, mine, other);
            for (size_t i = 0; i < stages; i++) mine[i] -= part * other[i];
            right[*known] -= part * right[k];
            terms += fabs(part * right[k]);
        }
        length = sqrt(dot(stages, mine, mine));
    }
    if (length <= noise * size) return fabs(right[*known]) <= noise * terms;
    for (size_t i = 0; i < stages; i++) mine[i] /= length;
    right[(*known)++] /= length;
    return true;
}

int dal__embedded_weights(const dal__composition *of, double *weight, int *q, dal_error *error)
{
    const size_t stages = of->stages;
    const int most = of->order - 1 < MOST ? of->order - 1 : MOST;
    *q = 0;
    if (most < 1 || !is_of_one_map(of)) return DAL_SUCCESS;
    const unsigned words = 1u << most;
    double *series, *sizes, *row, *right;
    arena memory = {0};
    DAL__RESERVE(&memory, dal__times(stages + 1, words), &series, &sizes);
    DAL__RESERVE(&memory, dal__times(stages + 1, stages), &row);
    DAL__RESERVE(&memory, stages + 1, &right);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    expand(of, words, false, series);
    expand(of, words, true, sizes);
    bool possible = true;
    size_t known = 0;
    for (unsigned word = 0; possible && word < words; word++) {
        double size = 0.0;
        for (size_t i = 0; i < stages; i++) {
            row[known * stages + i] = series[i * words + word];
            size += sizes[i * words + word] * sizes[i * words + word];
        }
        right[known] = -series[stages * words + word];
        possible = add_equation(stages, sqrt(size), &known, row, right);
        if (!possible || (word & (word + 1))) continue;
        /* the last word of its degree */
        memset(weight, 0, stages * sizeof *weight);
        for (size_t k = 0; k < known; k++) dal__add(stages, right[k], row + k * stages, weight);
        weight[stages] = 1.0;
        *q = 0;
        for (unsigned w = word; w; w >>= 1) ++*q;
    }
    dal__release(&memory);
    return DAL_SUCCESS;
}
