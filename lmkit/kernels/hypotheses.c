/* Decoding of a registered pattern: the likeliest code and quarter turn, its inks, every white part by itself, and
 * tests for an object in front of it.  hypotheses.py holds the definition. */
#include <stddef.h>

#include "hypotheses.h"
#include "kernels.h"
#include "landmark_fit.h"
#include "lanes.h"
#include "occlusion.h"
#include "plane.h"

#define HEAD 18 /* turn, code, four unexplained energies, inks */
#define MAX_ROWS (MAX_COLUMNS + 3)

/* rules: ridge, ridge of the parts, then those of the occlusion. */

static int fit_parts(int gaps, const double *gram, const double *seen, const double *square, double n, int turn, const double *inks, double ridge, double *parts, double *sigmas)
{
    /* Unknowns: triangle, fixed stretches of the rings, every gap, frame by the four inks. */
    const int C = 9 + gaps, P = 6 + gaps;
    double contrast[3], length = 0.0, b[6 + MAX_GAPS], A[(6 + MAX_GAPS) * (6 + MAX_GAPS)], L[(6 + MAX_GAPS) * (6 + MAX_GAPS)];
    double M[6 + MAX_GAPS][MAX_COLUMNS];
    for (int c = 0; c < 3; c++) {
        contrast[c] = inks[c] - inks[6 + c];
        length += contrast[c] * contrast[c];
    }
    length = length > 1e-9 ? length : 1e-9;
    for (int i = 0; i < P; i++)
        for (int j = 0; j < C; j++)
            M[i][j] = 0.0;
    M[0][5 + turn] = 1.0;
    M[1][4] = 1.0;
    for (int g = 0; g < gaps; g++) {
        M[1][9 + g] = -1.0;
        M[2 + g][9 + g] = 1.0;
    }
    for (int k = 0; k < INKS; k++)
        M[2 + gaps + k][k] = 1.0;
    double trace = 0.0, energy = 0.0;
    for (int i = 0; i < P; i++) {
        double row[MAX_COLUMNS];
        for (int j = 0; j < C; j++) {
            row[j] = 0.0;
            for (int k = 0; k < C; k++)
                row[j] += M[i][k] * gram[k * C + j];
        }
        for (int j = 0; j < P; j++) {
            double sum = 0.0;
            for (int k = 0; k < C; k++)
                sum += row[k] * M[j][k];
            A[i * P + j] = sum;
        }
        trace += A[i * P + i];
        b[i] = 0.0;
        for (int k = 0; k < C; k++)
            for (int c = 0; c < 3; c++)
                b[i] += M[i][k] * seen[k * 3 + c] * contrast[c] / length;
    }
    for (int c = 0; c < 3; c++)
        for (int d = 0; d < 3; d++)
            energy += square[c * 3 + d] * contrast[c] * contrast[d] / (length * length);
    for (int i = 0; i < P * P; i++)
        L[i] = A[i];
    for (int i = 0; i < P; i++)
        L[i * P + i] += ridge * trace / P;
    if (!factor(L, P))
        return 0;
    double x[6 + MAX_GAPS];
    for (int i = 0; i < P; i++)
        x[i] = b[i];
    solve_lower(L, P, x);
    solve_upper(L, P, x);
    double misfit = energy;
    for (int i = 0; i < P; i++) {
        misfit -= 2.0 * x[i] * b[i];
        for (int j = 0; j < P; j++)
            misfit += x[i] * A[i * P + j] * x[j];
    }
    misfit = misfit > 0.0 ? misfit / n : 0.0;
    for (int k = 0; k < 2 + gaps; k++) {
        double e[6 + MAX_GAPS] = {0}, sum = 0.0;
        e[k] = 1.0;
        solve_lower(L, P, e);
        for (int i = 0; i < P; i++)
            sum += e[i] * e[i];
        parts[k] = x[k];
        sigmas[k] = sqrt(sum * misfit);
    }
    return 1;
}

void moments_of_pixels(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                       const float *variance, const double *state, int wanted, float *columns, Moments *out)
{
    Drawing d = read_drawing(drawing);
    Plane plane = plane_of(view, state);
    const int C = 9 + d.gaps, R = C + 3;
    lanes sums[MAX_ROWS * (MAX_ROWS + 1) / 2];
    memset(sums, 0, sizeof sums);
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        block x, y, light, root, rows[MAX_ROWS];
        Points points;
        Jacobian J;
        load_root(variance + start, count, root);
        block *column = (block *)(columns + start * C);
        if (!(wanted & SAME_COLUMNS)) {
            load_block(at + start, count, x);
            load_block(at + n + start, count, y);
            map_block(&plane, x, y, &points, &J, light);
            coverage_columns(&d, &points, column);
            for (int k = 0; k < C; k++)
                EACH column[k][i] *= light[i];
        }
        for (int k = 0; k < C; k++)
            EACH rows[k][i] = column[k][i] * root[i];
        for (int c = 0; c < 3; c++) {
            load_block(values + c * n + start, count, rows[C + c]);
            EACH rows[C + c][i] *= root[i];
        }
        lanes *sum = sums;
        for (int k = 0; k < R; k++) {
            add_dots(sum, rows[k], (const block *)rows, k + 1);
            sum += k + 1;
        }
    }
    double *gram = out->gram, *seen = out->seen, *square = out->square;
    const lanes *sum = sums;
    for (int k = 0; k < R; k++)
        for (int j = 0; j <= k; j++, sum++) {
            double t = total(sum);
            if (k < C)
                gram[k * C + j] = gram[j * C + k] = t;
            else if (j < C)
                seen[j * 3 + k - C] = t;
            else
                square[(k - C) * 3 + j - C] = square[(j - C) * 3 + k - C] = t;
        }
}

int decode_pixels(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                  const float *variance, const double *state, const int32_t *masks, int64_t codes,
                  const double *rules, int wanted, float *columns, double *subsets, double *out)
{
    const Drawing d = read_drawing(drawing);
    const int C = 9 + d.gaps;
    Moments m;
    moments_of_pixels(n, drawing, view, at, values, variance, state, wanted, columns, &m);
    Best best;
    double energy = m.square[0] + m.square[4] + m.square[8], *inks = out + 6;
    if (!best_hypothesis(d.gaps, m.gram, m.seen, energy, masks, (int)codes, rules[0], subsets, &best))
        return 1;
    uint32_t open = (uint32_t)masks[best.turn * codes + best.code];
    if (!hypothesis_inks(d.gaps, m.gram, m.seen, best.turn, open, best.ridge, inks))
        return 1;
    out[0] = best.turn;
    out[1] = best.code;
    out[2] = best.left;
    out[3] = best.left_by_code;
    out[4] = best.left_by_turn;
    out[5] = best.left_by_frame;
    if (!(wanted & PARTS))
        return 0;
    const OcclusionRules hiding = {rules[2], rules[3], rules[4], rules[5], rules[6], rules[7], rules[8]};
    const Plane plane = plane_of(view, state);
    occlusion(n, d.gaps, at, values, variance, &plane, view[5], &hiding, inks, best.turn, open, masks + best.turn * codes, codes, columns, columns + (n + BLOCK) * C, out + HEAD);
    double *parts = out + HEAD + 2;
    return !fit_parts(d.gaps, m.gram, m.seen, m.square, (double)n, best.turn, inks, rules[1], parts, parts + 2 + d.gaps);
}

int lmkit_decode(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                 const float *variance, const double *state, const int32_t *masks, int64_t codes,
                 const double *rules, float *columns, double *subsets, double *out)
{
    return decode_pixels(n, drawing, view, at, values, variance, state, masks, codes, rules, PARTS, columns, subsets, out);
}
