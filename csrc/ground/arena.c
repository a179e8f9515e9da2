/* One allocation carved into arrays; and arrays that grow. */
#include "ground/ground.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Every array starts on a cache line of its own. */
enum { ALIGNMENT = 64 };

size_t dal__times(size_t a, size_t b)
{
    return b != 0 && a > SIZE_MAX / b ? SIZE_MAX : a * b;
}

void dal__reserve(arena *a, void *slot, size_t count, size_t size)
{
    const size_t capacity = sizeof a->part / sizeof a->part[0];
    const size_t bytes = dal__times(count, size);
    assert(a->parts < capacity);
    if (bytes > PTRDIFF_MAX - 2 * (size_t)ALIGNMENT - a->size) {
        a->overflow = true;
        return;
    }
    a->part[a->parts].slot = slot;
    a->part[a->parts++].offset = a->size;
    a->size += (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

void dal__reserve_doubles(arena *a, size_t slots, double **const slot[], size_t count)
{
    for (size_t i = 0; i < slots; i++) dal__reserve(a, slot[i], count, sizeof(double));
}

int dal__allocate(arena *a, dal_error *error)
{
    if (a->overflow) return dal__fail(error, DAL_ENOMEM, "the size of the workspace overflows");
    const size_t bytes = a->size + ALIGNMENT;
    a->block = malloc(bytes);
    if (!a->block)
        return dal__fail(error, DAL_ENOMEM, "out of memory: could not allocate %zu bytes", bytes);
    memset(a->block, 0, bytes);
    const size_t misfit = (uintptr_t)a->block % ALIGNMENT;
    char *base = (char *)a->block + (misfit ? ALIGNMENT - misfit : 0);
    for (size_t i = 0; i < a->parts; i++) {
        void *array = base + a->part[i].offset;
        memcpy(a->part[i].slot, &array, sizeof array); /* all object pointers look alike */
    }
    return DAL_SUCCESS;
}

int dal__grow(void *slot, size_t count, size_t *room, size_t size, dal_error *error)
{
    void *array;
    if (count < *room) return DAL_SUCCESS;
    const size_t larger = *room > 0 ? dal__times(2, *room) : 16, bytes = dal__times(larger, size);
    memcpy(&array, slot, sizeof array);
    array = realloc(array, bytes);
    if (!array)
        return dal__fail(error, DAL_ENOMEM, "out of memory: could not allocate %zu bytes", bytes);
    memcpy(slot, &array, sizeof array);
    *room = larger;
    return DAL_SUCCESS;
}

void dal__release(arena *a)
{
    void *const block = a->block; /* which the object may lie in, with its arena */
    a->block = NULL;
    free(block);
}
