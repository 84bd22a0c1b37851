/* Covering margin: how much better a code explains a landmark than another code behind an object.  covering.py holds
 * the definition. */
#ifndef LMKIT_COVERING_H
#define LMKIT_COVERING_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "occlusion.h"

#define GRIDS 6 /* turned by a sixth of a quarter turn each */
#define QUARTER_TURN 1.5707963267948966
#define COVERING_SUMS (SUMS + MAX_GAPS)

#define HEAD_SUMS 8 /* the first sums of a cell: those of `occlusion`, and one more that fills a vector */

typedef double CoveringCells[CELLS][CELLS][COVERING_SUMS];

/* Sets of gaps in which other codes differ, without those that contain a smaller set; kept has room for all codes. */
static inline int smallest_differences(int gaps, uint32_t open, const int32_t *masks, int64_t codes, uint32_t *kept)
{
    int count = 0;
    for (int bits = 1; bits <= gaps; bits++)
        for (int64_t c = 0; c < codes; c++) {
            const uint32_t differ = (uint32_t)masks[c] ^ open;
            int size = 0, is_new = 1;
            for (int g = 0; g < gaps; g++)
                size += differ >> g & 1;
            for (int k = 0; size == bits && k < count && is_new; k++)
                is_new = (kept[k] & ~differ) != 0;
            if (size == bits && is_new)
                kept[count++] = differ;
        }
    return count;
}

/* The least evidence for the code, without the evidence that an object hides (`hidden`, for every gap). */
static inline double evidence_outside(int gaps, const double *total, const double *hidden, const uint32_t *differ, int count, double nothing)
{
    double outside[MAX_GAPS], least = nothing;
    for (int g = 0; g < gaps; g++)
        outside[g] = total[g] > hidden[g] ? total[g] - hidden[g] : 0.0;
    for (int k = 0; k < count; k++) {
        double sum = 0.0;
        for (int g = 0; g < gaps; g++)
            sum += differ[k] >> g & 1 ? outside[g] : 0.0;
        least = sum < least ? sum : least;
    }
    return least;
}

/* One grid: `most` is the gain of the best object, `other` the loss of the best other code with an object. */
static inline void covering_rectangles(int gaps, CoveringCells cells, const OcclusionRules *rules, double price, const double *total, const uint32_t *differ, int count, double nothing, double *most, double *other)
{
    const int sums = SUMS + gaps;
    double above[EDGES][EDGES][COVERING_SUMS] = {{{0}}};
    for (int i = 1; i < EDGES; i++)
        for (int j = 1; j < EDGES; j++)
            for (int k = 0; k < sums; k++)
                above[i][j][k] = above[i - 1][j][k] + above[i][j - 1][k] - above[i - 1][j - 1][k] + cells[i - 1][j - 1][k];
    for (int top = 0; top < CELLS; top++)
        for (int low = top + 1; low < EDGES; low++) {
            double strip[EDGES][HEAD_SUMS];
            for (int j = 0; j < EDGES; j++)
                for (int k = 0; k < HEAD_SUMS; k++)
                    strip[j][k] = above[low][j][k] - above[top][j][k];
            for (int left = 0; left < CELLS; left++)
                for (int right = left + 1; right < EDGES; right++) {
                    /* The gain of an object is at most the whole unexplained chi2. */
                    const double unexplained = strip[right][5] - strip[left][5];
                    if (unexplained <= *most && price - unexplained >= *other)
                        continue;
                    double s[HEAD_SUMS], hidden[MAX_GAPS];
                    for (int k = 0; k < HEAD_SUMS; k++)
                        s[k] = strip[right][k] - strip[left][k];
                    if (s[0] < rules->foreign_pixels)
                        continue;
                    const double own = s[6] - (s[2] * s[2] + s[3] * s[3] + s[4] * s[4]) / s[1], any = rules->foreign_pixel * s[0];
                    const double gain = unexplained - (own < 0.0 ? 0.0 : own < any ? own : any);
                    *most = gain > *most ? gain : *most;
                    if (price - gain >= *other)
                        continue;
                    for (int g = 0, k = SUMS; g < gaps; g++, k++)
                        hidden[g] = above[low][right][k] - above[top][right][k] - above[low][left][k] + above[top][left][k];
                    const double all = price - gain + evidence_outside(gaps, total, hidden, differ, count, nothing);
                    *other = all < *other ? all : *other;
                }
        }
}

static inline int cell_of(double at)
{
    const double cell = at + CELLS / 2.0;
    return cell < 0.0 ? 0 : cell >= CELLS ? CELLS - 1 : (int)cell;
}

/* out: chi2 with objects, and without any; the other arguments are those of `occlusion`.  kept has room for all codes. */
static inline void covering(int64_t n, int gaps, const float *at, const float *values, const float *variance, const Plane *plane, double half_mm, const OcclusionRules *rules, double reach_share, double price, const double *inks, int turn, uint32_t open, const int32_t *masks, int64_t codes, const float *columns, float *scratch, uint32_t *kept, double *out)
{
    const int C = 9 + gaps;
    const Residuals off = residuals_of(n, gaps, values, variance, rules, inks, turn, open, columns, scratch);
    const float limit = (float)rules->foreign_limit;
    const double per_cell = CELLS / 2.0 / (reach_share * half_mm);
    double total[MAX_GAPS] = {0}, cosine[GRIDS], sine[GRIDS];
    CoveringCells cells[GRIDS];
    memset(cells, 0, sizeof cells);
    for (int a = 0; a < GRIDS; a++)
        cosine[a] = cos(QUARTER_TURN / GRIDS * a), sine[a] = sin(QUARTER_TURN / GRIDS * a);
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        const block *column = (const block *)(columns + start * C);
        block x, y, light, variances;
        Points points;
        Jacobian J;
        load_block(at + start, count, x);
        load_block(at + n + start, count, y);
        map_block(plane, x, y, &points, &J, light);
        load_block(variance + start, count, variances);
        double sums[BLOCK][COVERING_SUMS] = {{0}};
        for (int i = 0; i < count; i++) {
            const float usual = variances[i] * off.scale, weight = 1.0f / (usual > off.least ? usual : off.least);
            const float chi2 = off.squares[start + i] * weight, toward = off.along[start + i];
            double *s = sums[i];
            s[0] = 1.0;
            s[1] = (double)weight;
            for (int c = 0; c < 3; c++) {
                const double v = (double)values[c * n + start + i];
                s[2 + c] = (double)weight * v;
                s[6] += (double)weight * v * v;
            }
            s[5] = (double)(chi2 < limit ? chi2 : limit);
            for (int g = 0; g < gaps; g++) {
                const float covered = open >> g & 1 ? column[9 + g][i] : -column[9 + g][i];
                const float other = chi2 + weight * covered * (covered * off.length - 2.0f * toward);
                s[SUMS + g] = (double)(other < limit ? other : limit) - s[5];
                total[g] += s[SUMS + g];
            }
        }
        for (int a = 0; a < GRIDS; a++)
            for (int i = 0; i < count; i++) {
                const double u = (double)points.x[i], v = (double)points.y[i];
                double *cell = cells[a][cell_of((cosine[a] * v - sine[a] * u) * per_cell)][cell_of((cosine[a] * u + sine[a] * v) * per_cell)];
                for (int k = 0; k < COVERING_SUMS; k++)
                    cell[k] += sums[i][k];
            }
    }
    const double none[MAX_GAPS] = {0};
    const int count = smallest_differences(gaps, open, masks, codes, kept);
    const double nothing = (double)limit * (double)n;
    double most = 0.0, other = evidence_outside(gaps, total, none, kept, count, nothing);
    out[1] = other;
    for (int a = 0; a < GRIDS; a++)
        covering_rectangles(gaps, cells[a], rules, price, total, kept, count, nothing, &most, &other);
    out[0] = other + (most > price ? most - price : 0.0);
}

#endif
