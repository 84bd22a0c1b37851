/* Dot products of blocks, kept as LANES partial sums so that they vectorise and keep their order. */
#ifndef LMKIT_LANES_H
#define LMKIT_LANES_H

#include <string.h>

#include "pattern.h"

#define LANES 16
typedef float lanes __attribute__((vector_size(4 * LANES)));

static inline lanes load_lanes(const float *from)
{
    lanes v;
    memcpy(&v, from, sizeof v);
    return v;
}

/* sum += a . b, lane by lane. */
static inline void add_dot(lanes *sum, const float *a, const float *b)
{
    lanes s = *sum;
    for (int k = 0; k < BLOCK; k += LANES)
        s += load_lanes(a + k) * load_lanes(b + k);
    *sum = s;
}

/* sums[j] += a . rows[j] for j < count; four at a time, so that a is loaded once. */
static inline void add_dots(lanes *sums, const float *a, const block *rows, int count)
{
    int j = 0;
    for (; j + 4 <= count; j += 4) {
        lanes s0 = sums[j], s1 = sums[j + 1], s2 = sums[j + 2], s3 = sums[j + 3];
        for (int k = 0; k < BLOCK; k += LANES) {
            lanes v = load_lanes(a + k);
            s0 += v * load_lanes(rows[j] + k);
            s1 += v * load_lanes(rows[j + 1] + k);
            s2 += v * load_lanes(rows[j + 2] + k);
            s3 += v * load_lanes(rows[j + 3] + k);
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
