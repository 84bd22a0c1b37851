/* Decoding of a registered pattern: the likeliest code and quarter turn, its inks, every white part on its own, and
 * how badly the surroundings of the gaps fit.  hypotheses.py holds the definition. */
#include <stddef.h>

#include "hypotheses.h"
#include "kernels.h"
#include "landmark_fit.h"
#include "lanes.h"
#include "plane.h"
#include "select.h"

#define HEAD 18 /* turn, code, four energies left, inks */
#define MAX_ROWS (MAX_COLUMNS + 3)

/* rules: ridge, ridge of the parts, share of the contrast, worst misfit, least pixels around a gap, reach (mm).
 * sectors (G,5): radius of the ring's middle, half its thickness, unit vector to the gap's middle, half its angle. */

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

/* cos(a) for 0 <= a <= pi, to 1e-7 of a radian's worth of threshold. */
static inline float cosine(float a)
{
    float x = a - 1.57079633f, y = x * x;
    return -x * (1.0f + y * (-0.16666667f + y * (0.0083333333f + y * (-0.00019841270f + y * (2.7557319e-6f - y * 2.5052108e-8f)))));
}

/* The largest mean squared misfit around a gap, over what is usual; misfits (two arrays of n) are scratch. */
static double gap_residual(int64_t n, int gaps, const float *at, const float *values, const float *variance, const Plane *plane, const double *rules, const float *sectors, const double *inks, int turn, uint32_t open, const float *columns, float *misfits)
{
    const int C = 9 + gaps;
    float *sorted = misfits + n;
    float color[MAX_COLUMNS][3];
    for (int c = 0; c < 3; c++) {
        float white = (float)inks[c], blue = (float)inks[6 + c];
        for (int k = 0; k < INKS; k++)
            color[k][c] = (float)inks[3 * k + c];
        color[4][c] = white - blue;
        for (int t = 0; t < TURNS; t++)
            color[5 + t][c] = t == turn ? white - blue : 0.0f;
        for (int g = 0; g < gaps; g++)
            color[9 + g][c] = open >> g & 1 ? blue - white : 0.0f;
    }
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        const block *column = (const block *)(columns + start * C);
        block sum, value;
        EACH sum[i] = 0.0f;
        for (int c = 0; c < 3; c++) {
            load_block(values + c * n + start, count, value);
            for (int k = 0; k < C; k++) {
                float ink = color[k][c];
                EACH value[i] -= ink * column[k][i];
            }
            EACH sum[i] += value[i] * value[i];
        }
        for (int i = 0; i < count; i++) {
            misfits[start + i] = sum[i] * (1.0f / 3.0f);
            sorted[start + i] = misfits[start + i] / variance[start + i];
        }
    }
    double common = median(sorted, n), floor = 0.0, sums[MAX_GAPS] = {0}, counts[MAX_GAPS] = {0};
    float scale = common > 1.0 ? (float)common : 1.0f, worst = (float)rules[3], reach = (float)rules[5];
    for (int c = 0; c < 3; c++) {
        double share = rules[2] * (inks[c] - inks[6 + c]);
        floor += share * share / 3.0;
    }
    float least = (float)floor;
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        block x, y, light, misfit, radius, angle, used;
        Points points;
        Jacobian J;
        load_block(at + start, count, x);
        load_block(at + n + start, count, y);
        map_block(plane, x, y, &points, &J, light);
        load_block(misfits + start, count, misfit);
        load_block(variance + start, count, x);
        EACH {
            float usual = x[i] * scale;
            usual = usual > least ? usual : least;
            float m = misfit[i] / usual;
            misfit[i] = m < worst ? m : worst;
            float r = sqrtf(points.x[i] * points.x[i] + points.y[i] * points.y[i]);
            radius[i] = r > 1.0f ? r : 1.0f;
            angle[i] = reach / radius[i];
            used[i] = i < count ? 1.0f : 0.0f;
        }
        for (int g = 0; g < gaps; g++) {
            const float *s = sectors + 5 * g;
            float middle = s[0], beside = reach + s[1], gx = s[2], gy = s[3], half = s[4];
            float sum = 0.0f, number = 0.0f;
            block in, weight;
            EACH {
                float a = half + angle[i];
                a = a < 3.14159265f ? a : 3.14159265f;
                float near = fabsf(radius[i] - middle) < beside ? 1.0f : 0.0f;
                float around = points.x[i] * gx + points.y[i] * gy > radius[i] * cosine(a) ? 1.0f : 0.0f;
                weight[i] = near * around * used[i];
                in[i] = weight[i] * misfit[i];
            }
            for (int i = 0; i < BLOCK; i++) {
                sum += in[i];
                number += weight[i];
            }
            sums[g] += (double)sum;
            counts[g] += (double)number;
        }
    }
    double most = 0.0;
    for (int g = 0; g < gaps; g++)
        if (counts[g] >= rules[4] && sums[g] > most * counts[g])
            most = sums[g] / counts[g];
    return most;
}

int decode_pixels(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                  const float *variance, const double *state, const int32_t *masks, int64_t codes,
                  const double *rules, const float *sectors, int wanted, float *columns, double *subsets, double *out)
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
    double gram[MAX_COLUMNS * MAX_COLUMNS], seen[MAX_COLUMNS * 3], square[9];
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
    Best best;
    double energy = square[0] + square[4] + square[8], *inks = out + 6;
    if (!best_hypothesis(d.gaps, gram, seen, energy, masks, (int)codes, rules[0], subsets, &best))
        return 1;
    uint32_t open = (uint32_t)masks[best.turn * codes + best.code];
    if (!hypothesis_inks(d.gaps, gram, seen, best.turn, open, best.ridge, inks))
        return 1;
    out[0] = best.turn;
    out[1] = best.code;
    out[2] = best.left;
    out[3] = best.left_by_code;
    out[4] = best.left_by_turn;
    out[5] = best.left_by_frame;
    if (!(wanted & PARTS))
        return 0;
    out[HEAD] = gap_residual(n, d.gaps, at, values, variance, &plane, rules, sectors, inks, best.turn, open, columns, columns + (n + BLOCK) * C);
    double *parts = out + HEAD + 1;
    return !fit_parts(d.gaps, gram, seen, square, (double)n, best.turn, inks, rules[1], parts, parts + 2 + d.gaps);
}

int lmkit_decode(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                 const float *variance, const double *state, const int32_t *masks, int64_t codes,
                 const double *rules, const float *sectors, float *columns, double *subsets, double *out)
{
    return decode_pixels(n, drawing, view, at, values, variance, state, masks, codes, rules, sectors, PARTS, columns, subsets, out);
}
