/* Dot products of blocks, kept as LANES partial sums so that they vectorize and keep their order. */
#ifndef LMKIT_LANES_H
#define LMKIT_LANES_H

#include "pattern.h"

#define LANES 16
typedef float lanes[LANES];

/* As many floats as one register of the processor holds: compilers take larger vectors apart in memory.  The lanes are
 * the same whatever the width, and with them the sums to the last bit. */
#if defined(__AVX512F__)
#define WIDTH 16
#elif defined(__AVX__)
#define WIDTH 8
#else
#define WIDTH 4
#endif
/* Where floats lie; a function would return a vector, whose calling convention differs between processors. */
typedef float wide __attribute__((vector_size(4 * WIDTH), aligned(4), may_alias));
#define AT(floats) (*(wide *)(floats))
#define LOAD(floats) (*(const wide *)(floats))

/* sum += a . b, lane by lane. */
static inline void add_dot(lanes *sum, const float *a, const float *b)
{
    for (int lane = 0; lane < LANES; lane += WIDTH) {
        wide s = LOAD(*sum + lane);
        for (int k = lane; k < BLOCK; k += LANES)
            s += LOAD(a + k) * LOAD(b + k);
        AT(*sum + lane) = s;
    }
}

/* sums[j] += a . rows[j] for j < count; four at a time, so that a is loaded once. */
static inline void add_dots(lanes *sums, const float *a, const block *rows, int count)
{
    int j = 0;
    for (; j + 4 <= count; j += 4)
        for (int lane = 0; lane < LANES; lane += WIDTH) {
            wide s0 = LOAD(sums[j] + lane), s1 = LOAD(sums[j + 1] + lane);
            wide s2 = LOAD(sums[j + 2] + lane), s3 = LOAD(sums[j + 3] + lane);
            for (int k = lane; k < BLOCK; k += LANES) {
                wide v = LOAD(a + k);
                s0 += v * LOAD(rows[j] + k);
                s1 += v * LOAD(rows[j + 1] + k);
                s2 += v * LOAD(rows[j + 2] + k);
                s3 += v * LOAD(rows[j + 3] + k);
            }
            AT(sums[j] + lane) = s0, AT(sums[j + 1] + lane) = s1;
            AT(sums[j + 2] + lane) = s2, AT(sums[j + 3] + lane) = s3;
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
