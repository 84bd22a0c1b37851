/* Dot products of blocks, kept as LANES partial sums so that they vectorize and keep their order. */
#ifndef LMKIT_LANES_H
#define LMKIT_LANES_H

#include "pattern.h"

#define LANES 16
typedef float lanes __attribute__((vector_size(4 * LANES)));

/* Read where floats lie; a function would return a vector, whose calling convention differs between processors. */
typedef float unaligned_lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));
#define LOAD(from) (*(const unaligned_lanes *)(from))

/* sum += a . b, lane by lane. */
static inline void add_dot(lanes *sum, const float *a, const float *b)
{
    lanes s = *sum;
    for (int k = 0; k < BLOCK; k += LANES)
        s += LOAD(a + k) * LOAD(b + k);
    *sum = s;
}

/* sums[j] += a . rows[j] for j < count; four at a time, so that a is loaded once. */
static inline void add_dots(lanes *sums, const float *a, const block *rows, int count)
{
    int j = 0;
    for (; j + 4 <= count; j += 4) {
        lanes s0 = sums[j], s1 = sums[j + 1], s2 = sums[j + 2], s3 = sums[j + 3];
        for (int k = 0; k < BLOCK; k += LANES) {
            lanes v = LOAD(a + k);
            s0 += v * LOAD(rows[j] + k);
            s1 += v * LOAD(rows[j + 1] + k);
            s2 += v * LOAD(rows[j + 2] + k);
            s3 += v * LOAD(rows[j + 3] + k);
        }
        sums[j] = s0, sums[j + 1] = s1, sums[j + 2] = s2, sums[j + 3] = s3;
    }
    for (; j < count; j++)
        add_dot(sums + j, a, rows[j]);
}

static inline double total(const lanes *sum)
{
    double t = 0.0;
    for (int k = 0; k < LANES; k++)
        t += (double)(*sum)[k];
    return t;
}

#endif
