/* hand_sum.h - a sum of many small changes as one writes it by hand, compensated or plain.
 *
 * Compensated summation: x + low is the sum, and x its rounding.  In a plain sum low remains -0.0,
 * which the compiler omits: y + -0.0 is y. */
#ifndef DALEMBERT_HAND_SUM_H
#define DALEMBERT_HAND_SUM_H

#include <stdbool.h>

/* For loops that are compiled once for each kind of sum. */
#define HAND_INLINE static inline __attribute__((always_inline))

typedef struct hand_sum {
    double x, low;
} hand_sum;

/* A sum during a step: its next x, and the changes since the last one, with low among them. */
typedef struct hand_way {
    double next, change;
} hand_way;

HAND_INLINE hand_sum hand_sum_of(double x)
{
    return (hand_sum){x, -0.0};
}

HAND_INLINE hand_way hand_start(hand_sum sum)
{
    return (hand_way){sum.x + sum.low, sum.low};
}

/* The way to node = x + change and on: the node does not wait for low. */
HAND_INLINE hand_way hand_pass(hand_sum sum, double node, double change)
{
    return (hand_way){node + sum.low, sum.low + change};
}

/* The way through node = x + (low/2 + first), at a constant rate.  If both halves are equal, the
 * node is their middle to the bit. */
HAND_INLINE hand_way hand_turn(hand_sum sum, double node, double first, double second, bool even)
{
    const double next = even ? node + (node - sum.x) : node + second;
    return (hand_way){next, sum.low + first + second};
}

HAND_INLINE void hand_go(hand_way *way, double change)
{
    way->next += change;
    way->change += change;
}

HAND_INLINE void hand_end(bool compensated, hand_sum *sum, hand_way way)
{
    if (compensated) sum->low = sum->x - way.next + way.change;
    sum->x = way.next;
}

#endif /* DALEMBERT_HAND_SUM_H */
