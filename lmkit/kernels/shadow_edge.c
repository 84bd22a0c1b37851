/* A straight edge between two lights, from the pixels on both sides of it.  shadow_edge.py holds the definition. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "shadow_edge.h"

#define SHARE 1e-9 /* of the weight: less of it on a side counts as nothing */

static void project(int64_t n, const double *at, const double *normal, double *restrict along)
{
    const double across = normal[0], down = normal[1];
    _Pragma("omp simd") for (int64_t i = 0; i < n; i++) along[i] = at[2 * i] * across + at[2 * i + 1] * down;
}

/* Sums of weights, and of weighted values, up to and with every bin along a direction. */
static void fill_bins(int64_t n, const double *along, const double *values, const double *weights, int64_t bins, double *weight, double *total)
{
    double low = INFINITY, high = -INFINITY;
    _Pragma("omp simd reduction(min : low) reduction(max : high)") for (int64_t i = 0; i < n; i++)
    {
        low = along[i] < low ? along[i] : low;
        high = along[i] > high ? along[i] : high;
    }
    memset(weight, 0, (size_t)bins * sizeof *weight);
    memset(total, 0, (size_t)bins * sizeof *total);
    const double scale = high > low ? ((double)bins - 1e-6) / (high - low) : 0.0;
    for (int64_t i = 0; i < n; i++) {
        const int64_t bin = (int64_t)((along[i] - low) * scale);
        weight[bin] += weights[i];
        total[bin] += weights[i] * values[i];
    }
    double so_far = 0.0, sum = 0.0;
    for (int64_t b = 0; b < bins; b++) {
        weight[b] = so_far += weight[b];
        total[b] = sum += total[b];
    }
}

/* Variance between both sides of a split, without the terms that are the same for all splits. */
static inline double between(double before, double sum, double weight, double total)
{
    const double behind = weight - before, rest = total - sum;
    const double found = sum * sum / before + rest * rest / behind;
    return before > 0.0 && behind > SHARE * weight ? found : -1.0;
}

/* Largest variance between two sides, from sums up to and with every one of n parts. */
static double best_split(int64_t n, const double *weight, const double *total)
{
    const double all = weight[n - 1], sum = total[n - 1];
    double best = -1.0;
    _Pragma("omp simd reduction(max : best)") for (int64_t i = 0; i < n - 1; i++)
    {
        const double found = between(weight[i], total[i], all, sum);
        best = found > best ? found : best;
    }
    return best;
}

/* Numbers of n values in rising order, equal ones in their own; room for as many. */
static void sort(int64_t n, const double *values, int64_t *order, int64_t *room)
{
    for (int64_t i = 0; i < n; i++)
        order[i] = i;
    for (int64_t size = 1; size < n; size *= 2) {
        for (int64_t start = 0; start < n; start += 2 * size) {
            const int64_t middle = start + size < n ? start + size : n, end = start + 2 * size < n ? start + 2 * size : n;
            int64_t i = start, j = middle;
            for (int64_t k = start; k < end; k++)
                room[k] = i < middle && (j >= end || values[order[i]] <= values[order[j]]) ? order[i++] : order[j++];
        }
        memcpy(order, room, (size_t)n * sizeof *order);
    }
}

/* The split of n values in an order: its place along the direction, and the means before and behind. */
static void split(int64_t n, const int64_t *order, const double *along, const double *values, const double *weights, double *out)
{
    double all = 0.0, total = 0.0, before = 0.0, sum = 0.0, best = -2.0;
    for (int64_t i = 0; i < n; i++) {
        all += weights[order[i]];
        total += weights[order[i]] * values[order[i]];
    }
    for (int64_t i = 0; i + 1 < n; i++) {
        before += weights[order[i]];
        sum += weights[order[i]] * values[order[i]];
        const double found = between(before, sum, all, total);
        if (found > best) {
            best = found;
            out[0] = 0.5 * (along[order[i]] + along[order[i + 1]]);
            out[1] = sum / before;
            out[2] = (total - sum) / (all - before);
        }
    }
}

int lmkit_shadow_edge(int64_t n, const double *at, const double *values, const double *weights, int64_t directions,
                      const double *normals, int64_t bins, double *room, double *edge)
{
    double *along = room, *weight = along + n, *total = weight + bins, best = -1.0;
    if (n < 2)
        return 1;
    edge[0] = 0.0;
    for (int64_t d = 0; d < directions; d++) {
        project(n, at, normals + 2 * d, along);
        fill_bins(n, along, values, weights, bins, weight, total);
        const double found = best_split(bins, weight, total);
        if (found > best) {
            best = found;
            edge[0] = (double)d;
        }
    }
    int64_t *order = (int64_t *)(along + n);
    project(n, at, normals + 2 * (int64_t)edge[0], along);
    sort(n, along, order, order + n);
    split(n, order, along, values, weights, edge + 1);
    return 0;
}
