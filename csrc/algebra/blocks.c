/* How a symmetric pattern falls into blocks, and the rows of each into an order in which its
 * entries lie in a band: that of E. Cuthill and J. McKee (Proc. ACM National Conf., 1969), whose
 * rows are those of one breadth-first search, begun far from the middle. */
#include "algebra/algebra.h"

#include <stdlib.h>
#include <string.h>

/* Of one search for neighbours of constraints: the last row that has met each. */
typedef struct meeting {
    const dal_rows *rows;
    size_t *met; /* [m] */
} meeting;

/* Those rows that have a column in common with row a, itself among them; how many. */
static size_t meet(const meeting *self, size_t a, size_t *found)
{
    const dal_rows *const rows = self->rows;
    size_t count = 0;
    self->met[a] = a;
    if (found) found[count] = a;
    count++;
    for (size_t e = rows->first[a]; e < rows->first[a + 1]; e++) {
        const size_t i = rows->column[e];
        for (size_t k = rows->above[i]; k < rows->above[i + 1]; k++) {
            const size_t b = rows->row[k];
            if (self->met[b] == a) continue;
            self->met[b] = a;
            if (found) found[count] = b;
            count++;
        }
    }
    return count;
}

static int by_size(const void *a, const void *b)
{
    const size_t x = *(const size_t *)a, y = *(const size_t *)b;
    return (x > y) - (x < y);
}

/* A row on its way into the order. */
typedef struct candidate {
    size_t degree, row;
} candidate;

static int by_degree(const void *a, const void *b)
{
    const candidate *const x = a, *const y = b;
    return x->degree != y->degree ? (x->degree > y->degree) - (x->degree < y->degree)
                                  : (x->row > y->row) - (x->row < y->row);
}

/* What one breadth-first search needs. */
typedef struct search {
    const dal__pattern *pattern;
    size_t *seen;         /* [size] the number of the last search that came here */
    size_t number;
    candidate *candidate; /* [size] */
} search;

static size_t degree(const dal__pattern *pattern, size_t a)
{
    return pattern->first[a + 1] - pattern->first[a];
}

/* order <- the rows of the block of row start, by their distance from it and, of the same, by their
 * degree; how many. */
static size_t spread(search *self, size_t start, size_t *order)
{
    const dal__pattern *const pattern = self->pattern;
    size_t count = 1;
    self->number++;
    order[0] = start;
    self->seen[start] = self->number;
    for (size_t k = 0; k < count; k++) {
        size_t fresh = 0;
        for (size_t e = pattern->first[order[k]]; e < pattern->first[order[k] + 1]; e++) {
            const size_t b = pattern->column[e];
            if (self->seen[b] == self->number) continue;
            self->seen[b] = self->number;
            self->candidate[fresh++] = (candidate){degree(pattern, b), b};
        }
        qsort(self->candidate, fresh, sizeof *self->candidate, by_degree);
        for (size_t j = 0; j < fresh; j++) order[count++] = self->candidate[j].row;
    }
    return count;
}

/* The block whose rows stand in the order from begin on. */
static dal__block measure(const dal__pattern *pattern, const size_t *position, size_t begin,
                          size_t size)
{
    dal__block block = {.begin = begin, .size = size};
    for (size_t k = begin; k < begin + size; k++) {
        const size_t a = pattern->order[k];
        for (size_t e = pattern->first[a]; e < pattern->first[a + 1]; e++) {
            const size_t b = position[pattern->column[e]];
            const size_t apart = b > k ? b - k : k - b;
            if (apart > block.width) block.width = apart;
        }
    }
    if (dal__band_length(block.width) >= size) block.width = size;
    return block;
}

/* The order, and the blocks. */
static void arrange(dal__pattern *pattern, search *self, size_t *position)
{
    enum { OUTWARDS = 3 }; /* the last row of a search is far from where it began */
    size_t done = 0, offset = 0;
    for (size_t a = 0; a < pattern->size; a++) {
        if (self->seen[a]) continue;
        size_t count = spread(self, a, pattern->order + done);
        for (int again = 0; again < OUTWARDS && count > 1; again++)
            spread(self, pattern->order[done + count - 1], pattern->order + done);
        for (size_t k = done; k < done + count; k++) position[pattern->order[k]] = k;
        dal__block block = measure(pattern, position, done, count);
        block.offset = offset;
        offset += block.width == count ? count * count : count * dal__band_length(block.width);
        pattern->block[pattern->blocks++] = block;
        done += count;
    }
    pattern->stored = offset;
}

/* Where the entries stand. */
static void find_places(dal__pattern *pattern, const size_t *position)
{
    for (size_t k = 0; k < pattern->blocks; k++) {
        const dal__block block = pattern->block[k];
        for (size_t i = 0; i < block.size; i++) {
            const size_t a = pattern->order[block.begin + i];
            for (size_t e = pattern->first[a]; e < pattern->first[a + 1]; e++) {
                const size_t j = position[pattern->column[e]] - block.begin;
                pattern->place[e] = block.offset
                                  + (block.width == block.size
                                         ? i * block.size + j
                                         : i * dal__band_length(block.width) + block.width + j - i);
            }
        }
    }
}

int dal__pattern_new(dal__pattern **made, const dal_rows *rows, dal_error *error)
{
    const size_t m = rows->m;
    dal__pattern shape = {.size = m}, *self;
    search along = {0};
    size_t *met, *position, entries = 0;
    arena scratch = {0};
    dal__reserve(&scratch, &met, m, sizeof *met);
    dal__reserve(&scratch, &position, m, sizeof *position);
    dal__reserve(&scratch, &along.seen, m, sizeof *along.seen);
    dal__reserve(&scratch, &along.candidate, m, sizeof *along.candidate);
    int status = dal__allocate(&scratch, error);
    if (status) return status;
    const meeting look = {rows, met};
    for (size_t a = 0; a < m; a++) met[a] = m;
    for (size_t a = 0; a < m; a++) entries += meet(&look, a, NULL);
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    dal__reserve(&shape.arena, &shape.block, m, sizeof *shape.block);
    dal__reserve(&shape.arena, &shape.order, m, sizeof *shape.order);
    dal__reserve(&shape.arena, &shape.first, m + 1, sizeof *shape.first);
    dal__reserve(&shape.arena, &shape.column, entries, sizeof *shape.column);
    dal__reserve(&shape.arena, &shape.place, entries, sizeof *shape.place);
    status = dal__allocate(&shape.arena, error);
    if (!status) {
        *self = shape;
        for (size_t a = 0; a < m; a++) { /* for b > a the last to meet b was b, or came later */
            const size_t count = meet(&look, a, self->column + self->first[a]);
            self->first[a + 1] = self->first[a] + count;
            qsort(self->column + self->first[a], count, sizeof *self->column, by_size);
        }
        along.pattern = self;
        arrange(self, &along, position);
        find_places(self, position);
        *made = self;
    }
    dal__release(&scratch);
    return status;
}

void dal__pattern_free(dal__pattern *pattern)
{
    if (pattern) dal__release(&pattern->arena);
}
