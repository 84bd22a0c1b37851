/* Tests for an object in front of a decoded landmark; occlusion.py holds the definition. */
#ifndef LMKIT_OCCLUSION_H
#define LMKIT_OCCLUSION_H

#include <stdint.h>

#include "hypotheses.h"
#include "plane.h"
#include "select.h"

#define CELLS 8 /* of the grid, a side */
#define SUMS 7  /* of a cell: pixels, weights, weighted values, chi2 of the landmark, energy of the values */
#define EDGES (CELLS + 1)

/* rules of a decoding, from the third on. */
typedef struct {
    double model_share, usual_quantile, code_limit, foreign_limit, foreign_pixel, foreign_pixels, foreign_reach;
} OcclusionRules;

/* chi2 by which a rectangle of cells, in one color or in any at so much a pixel, explains more than the landmark does. */
static inline double foreign_rectangle(double cells[CELLS][CELLS][SUMS], const OcclusionRules *rules)
{
    static const double none[SUMS];
    double above[EDGES][EDGES][SUMS], most = 0.0;
    for (int i = 0; i < EDGES; i++)
        for (int j = 0; j < EDGES; j++) {
            const double *up = i ? above[i - 1][j] : none, *left = j ? above[i][j - 1] : none;
            const double *both = i && j ? above[i - 1][j - 1] : none, *here = i && j ? cells[i - 1][j - 1] : none;
            for (int k = 0; k < SUMS; k++)
                above[i][j][k] = up[k] + left[k] - both[k] + here[k];
        }
    for (int top = 0; top < CELLS; top++)
        for (int low = top + 1; low < EDGES; low++) {
            double strip[EDGES][SUMS];
            for (int j = 0; j < EDGES; j++)
                for (int k = 0; k < SUMS; k++)
                    strip[j][k] = above[low][j][k] - above[top][j][k];
            for (int left = 0; left < CELLS; left++)
                for (int right = left + 1; right < EDGES; right++) {
                    double s[SUMS];
                    for (int k = 0; k < SUMS; k++)
                        s[k] = strip[right][k] - strip[left][k];
                    if (s[0] < rules->foreign_pixels)
                        continue;
                    double own = s[6] - (s[2] * s[2] + s[3] * s[3] + s[4] * s[4]) / s[1];
                    double any = rules->foreign_pixel * s[0];
                    double gain = s[5] - (own < any ? own : any);
                    most = gain > most ? gain : most;
                }
        }
    return most;
}

/* Evidence: the least chi2 in favor of the code against another one in the same turn, with the chi2 of each pixel
 * limited. */
static inline double least_evidence(int gaps, const double *evidence, uint32_t open, const int32_t *masks, int64_t codes, double nothing)
{
    double least = nothing;
    for (int64_t c = 0; c < codes; c++) {
        uint32_t differ = (uint32_t)masks[c] ^ open;
        if (!differ)
            continue;
        double sum = 0.0;
        for (int g = 0; g < gaps; g++)
            if (differ >> g & 1)
                sum += evidence[g];
        least = sum < least ? sum : least;
    }
    return least;
}

/* Residuals of the pixels after a decoding. */
typedef struct {
    float *squares, *along; /* (n) squared length, and product with the contrast */
    float length;           /* squared, of the contrast: white less ground */
    float scale, least;     /* usual variance: the expected one times the scale, and no less than this */
} Residuals;

/* columns are the pattern's, inks (4,3) and open those of the decoding; scratch has room for 3 n. */
static inline Residuals residuals_of(int64_t n, int gaps, const float *values, const float *variance, const OcclusionRules *rules, const double *inks, int turn, uint32_t open, const float *columns, float *scratch)
{
    const int C = 9 + gaps;
    float *squares = scratch, *along = scratch + n, *sorted = scratch + 2 * n, color[MAX_COLUMNS][3], contrast[3], length = 0.0f;
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < INKS; k++)
            color[k][c] = (float)inks[3 * k + c];
        contrast[c] = color[0][c] - color[2][c];
        length += contrast[c] * contrast[c];
        color[4][c] = contrast[c];
        for (int t = 0; t < TURNS; t++)
            color[5 + t][c] = t == turn ? contrast[c] : 0.0f;
        for (int g = 0; g < gaps; g++)
            color[9 + g][c] = open >> g & 1 ? -contrast[c] : 0.0f;
    }
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        const block *column = (const block *)(columns + start * C);
        block sum, toward, value;
        EACH sum[i] = toward[i] = 0.0f;
        for (int c = 0; c < 3; c++) {
            load_block(values + c * n + start, count, value);
            for (int k = 0; k < C; k++) {
                float ink = color[k][c];
                EACH value[i] -= ink * column[k][i];
            }
            EACH sum[i] += value[i] * value[i];
            EACH toward[i] += value[i] * contrast[c];
        }
        for (int i = 0; i < count; i++) {
            squares[start + i] = sum[i];
            along[start + i] = toward[i];
            sorted[start + i] = sum[i] / 3.0f / variance[start + i];
        }
    }
    const double common = quantile(sorted, n, rules->usual_quantile);
    const float share = (float)rules->model_share;
    return (Residuals){squares, along, length, common > 1.0 ? (float)common : 1.0f, share * share * length / 3.0f};
}

/* out: the least evidence for the code, and what a foreign rectangle explains.  columns are the pattern's, inks (4,3)
 * and open those of the decoding, masks (codes) the open gaps of all codes in its turn; scratch has room for 3 n. */
static inline void occlusion(int64_t n, int gaps, const float *at, const float *values, const float *variance, const Plane *plane, double half_mm, const OcclusionRules *rules, const double *inks, int turn, uint32_t open, const int32_t *masks, int64_t codes, const float *columns, float *scratch, double *out)
{
    const int C = 9 + gaps;
    const Residuals off = residuals_of(n, gaps, values, variance, rules, inks, turn, open, columns, scratch);
    const float *squares = off.squares, *along = off.along, length = off.length, scale = off.scale, least = off.least;
    const float limit = (float)rules->code_limit, most = (float)rules->foreign_limit;
    const double reach = rules->foreign_reach * half_mm;
    double evidence[MAX_GAPS] = {0}, cells[CELLS][CELLS][SUMS] = {{{0}}};
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        const block *column = (const block *)(columns + start * C);
        block x, y, light, value[3], toward, weight, chi2;
        Points points;
        Jacobian J;
        load_block(at + start, count, x);
        load_block(at + n + start, count, y);
        map_block(plane, x, y, &points, &J, light);
        load_block(squares + start, count, chi2);
        load_block(variance + start, count, x);
        EACH {
            float usual = x[i] * scale;
            weight[i] = i < count ? 1.0f / (usual > least ? usual : least) : 0.0f;
            chi2[i] *= weight[i];
        }
        load_block(along + start, count, toward);
        for (int c = 0; c < 3; c++)
            load_block(values + c * n + start, count, value[c]);
        for (int g = 0; g < gaps; g++) {
            const float sign = open >> g & 1 ? 1.0f : -1.0f;
            block more;
            EACH {
                float covered = sign * column[9 + g][i];
                float other = chi2[i] + weight[i] * covered * (covered * length - 2.0f * toward[i]);
                more[i] = (other < limit ? other : limit) - (chi2[i] < limit ? chi2[i] : limit);
            }
            double sum = 0.0;
            for (int i = 0; i < count; i++)
                sum += (double)more[i];
            evidence[g] += sum;
        }
        for (int i = 0; i < count; i++) {
            double column_at = floor(((double)points.x[i] / reach + 1.0) * (CELLS / 2.0));
            double row_at = floor(((double)points.y[i] / reach + 1.0) * (CELLS / 2.0));
            int col = column_at < 0.0 ? 0 : column_at > CELLS - 1 ? CELLS - 1 : (int)column_at;
            int row = row_at < 0.0 ? 0 : row_at > CELLS - 1 ? CELLS - 1 : (int)row_at;
            double *cell = cells[row][col], w = (double)weight[i], energy = 0.0;
            cell[0] += 1.0;
            cell[1] += w;
            for (int c = 0; c < 3; c++) {
                double v = (double)value[c][i];
                cell[2 + c] += w * v;
                energy += w * v * v;
            }
            cell[5] += (double)(chi2[i] < most ? chi2[i] : most);
            cell[6] += energy;
        }
    }
    out[0] = least_evidence(gaps, evidence, open, masks, codes, rules->code_limit * (double)n);
    out[1] = foreign_rectangle(cells, rules);
}

#endif
