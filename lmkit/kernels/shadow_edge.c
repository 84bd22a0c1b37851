/* Direction of a straight edge between two lights.  shadow_edge.py holds the definition. */
#include <math.h>
#include <stddef.h>

#include "kernels.h"

/* at (n,2) positions; values and weights (n).  normals (D,2) directions.  sums: two doubles for every bin.  direction: of
 * the edge across which the means of the values differ most for their number (Otsu 1979), places counted in bins. */
LMKIT_EXPORT int lmkit_shadow_direction(int64_t n, const double *at, const double *values, const double *weights,
                                        int64_t directions, const double *normals, int64_t bins, double *sums,
                                        int64_t *direction);

/* Sums of weights and of weighted values in bins along a direction. */
static void fill_bins(int64_t n, const double *at, const double *values, const double *weights, const double *normal, int64_t bins, double *sums)
{
    double low = INFINITY, high = -INFINITY;
    for (int64_t i = 0; i < n; i++) {
        double along = at[2 * i] * normal[0] + at[2 * i + 1] * normal[1];
        low = along < low ? along : low;
        high = along > high ? along : high;
    }
    for (int64_t b = 0; b < 2 * bins; b++)
        sums[b] = 0.0;
    const double scale = high > low ? ((double)bins - 1e-6) / (high - low) : 0.0;
    for (int64_t i = 0; i < n; i++) {
        double along = at[2 * i] * normal[0] + at[2 * i + 1] * normal[1];
        double *bin = sums + 2 * (int64_t)((along - low) * scale);
        bin[0] += weights[i];
        bin[1] += weights[i] * values[i];
    }
}

/* Largest variance between both sides of an edge, without the terms that are the same for all edges. */
static double best_split(int64_t bins, const double *sums)
{
    double weight = 0.0, total = 0.0, before = 0.0, sum = 0.0, best = -1.0;
    for (int64_t b = 0; b < bins; b++) {
        weight += sums[2 * b];
        total += sums[2 * b + 1];
    }
    for (int64_t b = 0; b + 1 < bins; b++) {
        before += sums[2 * b];
        sum += sums[2 * b + 1];
        double behind = weight - before;
        if (!(before > 0.0 && behind > 1e-9 * weight))
            continue;
        double between = sum * sum / before + (total - sum) * (total - sum) / behind;
        best = between > best ? between : best;
    }
    return best;
}

int lmkit_shadow_direction(int64_t n, const double *at, const double *values, const double *weights, int64_t directions,
                           const double *normals, int64_t bins, double *sums, int64_t *direction)
{
    double best = -1.0;
    *direction = 0;
    for (int64_t d = 0; d < directions; d++) {
        fill_bins(n, at, values, weights, normals + 2 * d, bins, sums);
        double between = best_split(bins, sums);
        if (between > best) {
            best = between;
            *direction = d;
        }
    }
    return 0;
}
