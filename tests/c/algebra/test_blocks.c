/* Matrices X Y^T of sparse rows, by blocks and bands, against the dense solver: patterns that fall
 * apart, chains in any order, combs, hubs, and rows at random. */
#include "fixtures.h"
#include "check.h"

enum { MOST = 60, WIDTH = 3 * MOST };

typedef enum kind { APART, CHAIN, SHUFFLED, COMB, LATTICE, HUB, RANDOM, KINDS } kind;

/* Rows with room for any. */
typedef struct room {
    size_t first[MOST + 1], column[MOST * WIDTH], above[WIDTH + 1];
    size_t entry[MOST * WIDTH], row[MOST * WIDTH];
    bool there[MOST][WIDTH];
    dal_rows rows;
} room;

static size_t below(size_t count, unsigned *seed)
{
    return (size_t)((0.5 + 0.5 * next_number(seed)) * (double)count) % count;
}

/* Which entries of row a of m there are. */
static void choose(room *r, kind which, size_t a, size_t m, size_t place, unsigned *seed)
{
    const size_t side = 7, n = 3 * m;
    for (size_t k = 0; k < 3; k++) r->there[a][3 * place + k] = true;
    if ((which == CHAIN || which == SHUFFLED) && place > 0) r->there[a][3 * place - 1] = true;
    if (which == COMB && place % 2 == 0 && place > 0) r->there[a][3 * place - 6] = true;
    if (which == COMB && place % 2 == 1) r->there[a][3 * place - 2] = true; /* a tooth */
    if (which == LATTICE && place % side > 0) r->there[a][3 * place - 1] = true;
    if (which == LATTICE && place >= side) r->there[a][3 * (place - side)] = true;
    if (which == HUB && a == m / 2)
        for (size_t b = 0; b < m; b++) r->there[a][3 * b + 1] = true;
    if (which == RANDOM && a % 3 > 0) r->there[a][below(n, seed)] = true;
}

static void fill_rows(room *r, kind which, size_t m, unsigned *seed)
{
    const size_t n = 3 * m;
    size_t place[MOST], entries = 0, k = 0;
    memset(r, 0, sizeof *r);
    for (size_t a = 0; a < m; a++) place[a] = a;
    for (size_t a = m; which == SHUFFLED && a-- > 1;) {
        const size_t b = below(a + 1, seed), other = place[a];
        place[a] = place[b];
        place[b] = other;
    }
    for (size_t a = 0; a < m; a++) {
        choose(r, which, a, m, place[a], seed);
        for (size_t i = 0; i < n; i++)
            if (r->there[a][i]) r->column[entries++] = i;
        r->first[a + 1] = entries;
    }
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < m; a++)
            for (size_t e = r->first[a]; e < r->first[a + 1]; e++)
                if (r->column[e] == i) r->entry[k] = e, r->row[k++] = a;
        r->above[i + 1] = k;
    }
    r->rows = (dal_rows){m, n, r->first, r->column, r->above, r->entry, r->row, n};
}

static size_t root_of(const size_t *owner, size_t a)
{
    while (owner[a] != a) a = owner[a];
    return a;
}

/* How many blocks there are: rows with a column in common have the same owner. */
static size_t count_blocks(const room *r)
{
    size_t owner[MOST], count = 0;
    const size_t m = r->rows.m;
    for (size_t a = 0; a < m; a++) owner[a] = a;
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < a; b++)
            for (size_t i = 0; i < r->rows.n; i++)
                if (r->there[a][i] && r->there[b][i]) owner[root_of(owner, a)] = root_of(owner, b);
    for (size_t a = 0; a < m; a++) count += owner[a] == a;
    return count;
}

static void check_pattern(const room *r, const dal__pattern *pattern, kind which)
{
    const size_t m = r->rows.m;
    bool seen[MOST] = {false};
    size_t rows = 0, stored = 0;
    CHECK(pattern->size == m && pattern->blocks == count_blocks(r));
    for (size_t k = 0; k < m; k++) {
        CHECK(!seen[pattern->order[k]]);
        seen[pattern->order[k]] = true;
    }
    for (size_t k = 0; k < pattern->blocks; k++) {
        const dal__block *const block = pattern->block + k;
        CHECK(block->begin == rows && block->offset == stored);
        rows += block->size;
        stored += block->size * (block->width == block->size ? block->size
                                                             : dal__band_length(block->width));
    }
    for (size_t a = 0; a < m; a++)
        for (size_t e = pattern->first[a]; e + 1 < pattern->first[a + 1]; e++)
            CHECK(pattern->column[e] < pattern->column[e + 1]);
    CHECK(rows == m && stored == pattern->stored && stored <= m * m);
    if (which == APART) CHECK(stored == m);
    if (which == CHAIN || which == SHUFFLED) CHECK(stored <= 4 * m);
    if (which == COMB) CHECK(stored <= 7 * m);
    if (which == LATTICE && m > 40) CHECK(stored <= 30 * m);
}

/* The matrix as the pattern stores it, before it is factored. */
static void expand(const dal__linear *self, double *A)
{
    const dal__pattern *const pattern = self->pattern;
    const size_t m = self->size;
    memset(A, 0, m * m * sizeof *A);
    for (size_t a = 0; a < m; a++)
        for (size_t k = pattern->first[a]; k < pattern->first[a + 1]; k++)
            A[a * m + pattern->column[k]] = self->A[pattern->place[k]];
}

/* Both solvers for the same X, Y[m*n], whose entries are stored in x and y. */
typedef struct subject {
    dal__linear sparse, dense;
    double x[MOST * WIDTH], y[MOST * WIDTH], X[MOST * WIDTH], Y[MOST * WIDTH];
} subject;

/* X is Y, or near it or -Y row by row, so that the determinant has either sign. */
static void fill_values(subject *s, const room *r, bool same, unsigned *seed)
{
    const size_t m = r->rows.m, n = r->rows.n;
    memset(s->X, 0, sizeof s->X);
    memset(s->Y, 0, sizeof s->Y);
    for (size_t a = 0; a < m; a++) {
        const double sign = same || next_number(seed) > 0.0 ? 1.0 : -1.0;
        for (size_t e = r->first[a]; e < r->first[a + 1]; e++) {
            s->y[e] = s->Y[a * n + r->column[e]] = next_number(seed);
            s->x[e] = same ? s->y[e] : sign * (s->y[e] + 0.3 * next_number(seed));
            s->X[a * n + r->column[e]] = s->x[e];
        }
    }
}

/* A <- X Y^T and its sizes; then its factors, with the same sign; but the dense matrix, of which a
 * larger bound of the condition is known, may be called singular sooner. */
static int factor_both(subject *s, const room *r, double *A)
{
    const size_t m = r->rows.m, n = r->rows.n;
    double B[MOST * MOST];
    for (size_t a = 0; a < m; a++) {
        s->sparse.sizes[a] = s->dense.sizes[a] = sum_of_sizes(n, s->X + a * n);
        s->sparse.sizes[m + a] = s->dense.sizes[m + a] = sum_of_sizes(n, s->Y + a * n);
    }
    dal__linear_multiply(&s->sparse, &r->rows, n, s->x, s->y);
    dal__linear_multiply(&s->dense, NULL, n, s->X, s->Y);
    expand(&s->sparse, A);
    expand(&s->sparse, B);
    for (size_t k = 0; k < m * m; k++) CHECK(A[k] == s->dense.A[k]);
    const int dense = dal__linear_factor(&s->dense), sign = dal__linear_factor(&s->sparse);
    CHECK(sign == dense || dense == 0);
    return sign;
}

/* The residual of A x = b, or of A^T x = b, in roundings of its terms. */
static double defect(size_t m, const double *A, const double *x, const double *b, bool transposed)
{
    double worst = 0.0;
    for (size_t i = 0; i < m; i++) {
        double sum = -b[i], terms = fabs(b[i]);
        for (size_t k = 0; k < m; k++) {
            const double term = (transposed ? A[k * m + i] : A[i * m + k]) * x[k];
            sum += term;
            terms += fabs(term);
        }
        worst = fmax(worst, fabs(sum) / (terms * U));
    }
    return worst;
}

static void check_solutions(const subject *s, const double *A, unsigned *seed)
{
    const size_t m = s->sparse.size;
    for (int transposed = 0; transposed < 2; transposed++) {
        double b[MOST], c[MOST], x[MOST];
        for (size_t a = 0; a < m; a++) b[a] = c[a] = next_number(seed);
        if (transposed) dal__linear_solve_transposed(&s->sparse, c, x);
        else dal__linear_solve(&s->sparse, c, x);
        CHECK(defect(m, A, x, b, transposed) < 20.0 * (double)m);
        memcpy(c, b, sizeof c); /* in place */
        if (transposed) dal__linear_solve_transposed(&s->sparse, c, c);
        else dal__linear_solve(&s->sparse, c, c);
        CHECK(memcmp(c, x, m * sizeof *x) == 0);
    }
}

/* The norm of the inverse of the scaled matrix, column by column. */
static void check_inverse_norm(const subject *s)
{
    const size_t m = s->sparse.size;
    const double *const sizes = s->sparse.sizes;
    double norm = 0.0;
    for (size_t j = 0; j < m; j++) {
        double e[MOST] = {0.0}, x[MOST], sum = 0.0;
        e[j] = sizes[j];
        dal__linear_solve(&s->sparse, e, x);
        for (size_t i = 0; i < m; i++) sum += fabs(x[i]) * sizes[m + i];
        norm = fmax(norm, sum);
    }
    const double found = dal__linear_inverse_norm(&s->sparse);
    CHECK(found <= norm * (1.0 + 1e-9) && found >= 0.2 * norm);
}

static void test_kind(kind which, size_t m, unsigned *seed)
{
    static room r;
    static subject s;
    static double A[MOST * MOST];
    arena memory = {0};
    dal__pattern *pattern = NULL;
    fill_rows(&r, which, m, seed);
    need(dal__pattern_new(&pattern, &r.rows, NULL), "pattern", "");
    check_pattern(&r, pattern, which);
    dal__linear_reserve_pattern(&s.sparse, m, pattern, &memory);
    dal__linear_reserve(&s.dense, m, &memory);
    need(dal__allocate(&memory, NULL), "linear", "");
    for (int same = 0; same < 2; same++) {
        fill_values(&s, &r, same, seed);
        if (factor_both(&s, &r, A) == 0) continue;
        check_solutions(&s, A, seed);
        check_inverse_norm(&s);
    }
    if (m > 1) { /* two constraints that coincide: as far as they have the same columns */
        const size_t a = m - 1, n = r.rows.n;
        fill_values(&s, &r, true, seed);
        for (size_t e = r.first[a]; e < r.first[a + 1]; e++)
            if (e + 1 < r.first[a + 1]) s.x[e] = s.X[a * n + r.column[e]] = 0.0;
        for (size_t e = r.first[a]; e < r.first[a + 1]; e++)
            if (e + 1 == r.first[a + 1]) s.y[e] = s.Y[a * n + r.column[e]] = 0.0;
        factor_both(&s, &r, A);
        s.x[r.first[a]] = s.X[a * n + r.column[r.first[a]]] = (double)NAN;
        s.sparse.sizes[a] = 1.0;
        dal__linear_multiply(&s.sparse, &r.rows, n, s.x, s.y);
        CHECK(dal__linear_factor(&s.sparse) == 0);
    }
    dal__release(&memory);
    dal__pattern_free(pattern);
}

/* In a chain two rows that differ by a small number: C, of condition 1/number^2, is regular up to
 * 1e-6, and from 1e-8 on it is not; in any units, and wherever they stand. */
static void test_singular(void)
{
    static room r;
    static subject s;
    unsigned seed = 5;
    const size_t m = 30, n = 3 * m;
    arena memory = {0};
    dal__pattern *pattern = NULL;
    fill_rows(&r, CHAIN, m, &seed);
    need(dal__pattern_new(&pattern, &r.rows, NULL), "pattern", "");
    CHECK(pattern->blocks == 1 && pattern->block[0].width == 1);
    dal__linear_reserve_pattern(&s.sparse, m, pattern, &memory);
    dal__linear_reserve(&s.dense, m, &memory);
    need(dal__allocate(&memory, NULL), "linear", "");
    for (int power = 0; power <= 20; power++)
        for (size_t where = 0; where + 1 < m; where++) {
            double A[MOST * MOST];
            fill_values(&s, &r, true, &seed);
            for (size_t a = where; a < where + 2; a++)
                for (size_t e = r.first[a]; e < r.first[a + 1]; e++) {
                    const double small = a > where && e + 1 == r.first[a + 1] ? 1.0 : 0.0;
                    const bool common = r.column[e] == 3 * where + 2;
                    s.y[e] = common ? 1.0 : small * pow(10.0, -power);
                }
            for (size_t a = 0; a < m; a++) {
                const double unit = pow(2.0, 100.0 * next_number(&seed));
                for (size_t e = r.first[a]; e < r.first[a + 1]; e++) {
                    s.y[e] *= unit;
                    s.x[e] = s.X[a * n + r.column[e]] = s.Y[a * n + r.column[e]] = s.y[e];
                }
            }
            const int sign = factor_both(&s, &r, A);
            if (power <= 5) CHECK(sign == 1);
            if (power >= 8) CHECK(sign == 0);
        }
    dal__release(&memory);
    dal__pattern_free(pattern);
}

/* A long chain of constraints v_i = v_(i+1): 1 where the rows are 2, -1 beside it.  Its condition,
 * m^2 / 2, leaves 5 digits. */
static void test_long_chain(void)
{
    enum { LONG = 200000 };
    const size_t length = dal__band_length(1);
    double *const A = calloc(LONG * length, sizeof *A), *const sizes = malloc(5 * LONG * sizeof *A);
    size_t *const row = malloc(LONG * sizeof *row);
    need(A && sizes && row ? 0 : DAL_ENOMEM, "memory", "");
    for (size_t i = 0; i < LONG; i++) {
        A[i * length + 1] = 2.0;
        if (i > 0) A[i * length] = -1.0;
        if (i + 1 < LONG) A[i * length + 2] = -1.0;
        sizes[i] = sizes[LONG + i] = sqrt(2.0);
    }
    CHECK(dal__band_factor(LONG, 1, A, sizes, row) == 1);
    free(A);
    free(sizes);
    free(row);
}

/* A band matrix, with sizes that need not be those of its entries, has the pivots that it has as a
 * dense one, and is as singular. */
static void check_band(size_t m, size_t width, const double *A, const double *sizes)
{
    double dense[MOST * MOST], band[MOST * 3 * MOST] = {0.0};
    double of_dense[5 * MOST], of_band[5 * MOST];
    size_t row[MOST], swaps[MOST];
    const size_t length = dal__band_length(width);
    memcpy(dense, A, m * m * sizeof *A);
    memcpy(of_dense, sizes, 2 * m * sizeof *sizes);
    memcpy(of_band, sizes, 2 * m * sizeof *sizes);
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < m; j++)
            if (j + width >= i && j <= i + width) band[i * length + width + j - i] = A[i * m + j];
    const int sign = dal_lu_factor(m, dense, of_dense, row);
    CHECK(dal__band_factor(m, width, band, of_band, swaps) == sign);
    for (size_t i = 0; i < m; i++) CHECK(band[i * length + width] == dense[i * (m + 1)]);
}

static void test_bands(void)
{
    enum { N = 8 };
    unsigned seed = 13;
    double A[MOST * MOST], sizes[2 * MOST];
    size_t regular = 0, singular = 0;
    for (int trial = 0; trial < 300; trial++) {
        const size_t m = 4 + below(MOST - 3, &seed), width = 1 + below(4, &seed);
        for (size_t k = 0; k < 2 * m; k++) sizes[k] = pow(2.0, 20.0 * next_number(&seed));
        for (size_t i = 0; i < m; i++)
            for (size_t j = 0; j < m; j++)
                A[i * m + j] = j + width >= i && j <= i + width
                             ? next_number(&seed) * sizes[i] * sizes[m + j] : 0.0;
        check_band(m, width, A, sizes);
    }
    for (int power = 0; power < 20; power++) /* where sizes are too small, U itself is large */
        for (int which = 0; which < 3; which++) {
            const double large = pow(10.0, power);
            double unit[2 * N], B[N * N] = {0.0};
            for (size_t k = 0; k < 2 * N; k++) unit[k] = 1.0;
            for (size_t i = 0; i < N; i++) B[i * (N + 1)] = which == 1 ? sqrt(large) : 1.0;
            if (which == 0) B[3 * (N + 1)] = large;
            if (which == 1) B[3 * (N + 1) + 1] = large;
            if (which == 2) B[4 * (N + 1)] = 1.0 / large;
            check_band(N, 1, B, unit);
            double C[N * N], of[5 * N];
            size_t row[N];
            memcpy(C, B, sizeof C);
            memcpy(of, unit, sizeof unit);
            *(dal_lu_factor(N, C, of, row) ? &regular : &singular) += 1;
        }
    CHECK(regular > 20 && singular > 10);
}

int main(void)
{
    unsigned seed = 3;
    for (kind which = APART; which < KINDS; which++)
        for (size_t m = 1; m <= MOST; m += 1 + m / 4) test_kind(which, m, &seed);
    test_singular();
    test_long_chain();
    test_bands();
    return check_done();
}
