/* Every code in every quarter turn, each with its own best inks, from the moments of the pattern's columns.
 *
 * A hypothesis says which columns are white and which are blue.  Red and surroundings are eliminated once (Schur's
 * complement); what the other two inks explain then depends on four sums over the open gaps, which double from subset
 * to subset. */
#ifndef LMKIT_HYPOTHESES_H
#define LMKIT_HYPOTHESES_H

#include <stdint.h>

#include "linear.h"
#include "pattern.h"

#define TURNS 4

typedef struct {
    int turn, code;          /* the likeliest hypothesis */
    double left;             /* energy that it leaves unexplained */
    double left_by_code;     /* least of another code in the same turn */
    double left_by_turn;     /* least in another turn */
    double left_by_frame;    /* of the framed square without rings and triangle */
    double ridge;
} Best;

/* Doubles that `best_hypothesis` needs: six sums and one score for every subset of gaps. */
static inline int64_t hypothesis_scratch(int gaps)
{
    return 7 * ((int64_t)1 << gaps);
}

/* out[subset] = sum over its gaps of values[gap]; pairs adds K[gap][gap'] for all pairs where not null. */
static inline void subset_sums(int gaps, const double *values, const double *K, int stride, double *restrict out)
{
    out[0] = 0.0;
    for (int g = 0; g < gaps; g++) {
        int64_t size = (int64_t)1 << g;
        double v = values[g];
        for (int64_t s = 0; s < size; s++)
            out[size + s] = out[s] + v;
        if (!K)
            continue;
        /* Cross terms with the gaps below, themselves by doubling. */
        for (int h = 0; h < g; h++) {
            double twice = 2.0 * K[g * stride + h];
            int64_t half = (int64_t)1 << h;
            for (int64_t s = size; s < 2 * size; s += 2 * half)
                for (int64_t t = s + half; t < s + 2 * half; t++)
                    out[t] += twice;
        }
    }
}

/* gram (C,C) and seen (C,3) are C'C and C'Y of the columns; masks (TURNS,codes) hold the open gaps of every hypothesis. */
static inline int best_hypothesis(int gaps, const double *gram, const double *seen, double energy, const int32_t *masks, int codes, double relative_ridge, double *restrict scratch, Best *out)
{
    const int C = 9 + gaps;
    double K[MAX_COLUMNS * MAX_COLUMNS], Y[MAX_COLUMNS * 3];
    double ridge = relative_ridge * (gram[0] + gram[C + 1] + gram[2 * C + 2] + gram[3 * C + 3]) / INKS;
    out->ridge = ridge;
    /* Eliminate red (1) and surroundings (3). */
    double a = gram[C + 1] + ridge, b = gram[C + 3], d = gram[3 * C + 3] + ridge, det = a * d - b * b, by_two = 0.0;
    if (!(det > 0.0))
        return 0;
    double ia = d / det, ib = -b / det, id = a / det;
    for (int i = 0; i < C; i++) {
        double p = gram[i * C + 1], q = gram[i * C + 3];
        double u = p * ia + q * ib, v = p * ib + q * id;
        for (int j = 0; j < C; j++)
            K[i * C + j] = gram[i * C + j] - u * gram[C + j] - v * gram[3 * C + j];
        for (int c = 0; c < 3; c++)
            Y[i * 3 + c] = seen[i * 3 + c] - u * seen[3 + c] - v * seen[9 + c];
    }
    for (int c = 0; c < 3; c++)
        by_two += ia * seen[3 + c] * seen[3 + c] + 2.0 * ib * seen[3 + c] * seen[9 + c] + id * seen[9 + c] * seen[9 + c];

    const int64_t subsets = (int64_t)1 << gaps;
    double *restrict gg = scratch, *restrict gw = scratch + subsets, *restrict gb = scratch + 2 * subsets;
    double *restrict y0 = scratch + 3 * subsets, *restrict y1 = scratch + 4 * subsets, *restrict y2 = scratch + 5 * subsets;
    double *restrict score = scratch + 6 * subsets;
    double values[MAX_GAPS + 1];
    for (int g = 0; g < gaps; g++)
        values[g] = K[(9 + g) * C + 9 + g];
    subset_sums(gaps, values, K + 9 * C + 9, C, gg);
    for (int c = 0; c < 3; c++) {
        for (int g = 0; g < gaps; g++)
            values[g] = Y[(9 + g) * 3 + c];
        subset_sums(gaps, values, 0, 0, scratch + (3 + c) * subsets);
    }
    double by_turn[TURNS], by_code = -1.0, best = -1.0;
    out->turn = 0, out->code = 0;
    for (int t = 0; t < TURNS; t++) {
        const int T = 5 + t;
        /* White: frame's white + rings + triangle; blue: frame's blue - rings - triangle. */
        double ww = 0.0, wb = 0.0, bb = 0.0, yw[3], yb[3];
        const int w[3] = {0, 4, T}, u[3] = {2, 4, T};
        const double sign[3] = {1.0, -1.0, -1.0};
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                ww += K[w[i] * C + w[j]];
                wb += sign[j] * K[w[i] * C + u[j]];
                bb += sign[i] * sign[j] * K[u[i] * C + u[j]];
            }
        for (int c = 0; c < 3; c++) {
            yw[c] = Y[c] + Y[12 + c] + Y[T * 3 + c];
            yb[c] = Y[6 + c] - Y[12 + c] - Y[T * 3 + c];
        }
        for (int g = 0; g < gaps; g++)
            values[g] = K[(9 + g) * C] + K[(9 + g) * C + 4] + K[(9 + g) * C + T];
        subset_sums(gaps, values, 0, 0, gw);
        for (int g = 0; g < gaps; g++)
            values[g] = K[(9 + g) * C + 2] - K[(9 + g) * C + 4] - K[(9 + g) * C + T];
        subset_sums(gaps, values, 0, 0, gb);
        double w0 = yw[0], w1 = yw[1], w2 = yw[2], b0 = yb[0], b1 = yb[1], b2 = yb[2];
        for (int64_t s = 0; s < subsets; s++) {
            double aa = ww - 2.0 * gw[s] + gg[s] + ridge, dd = bb + 2.0 * gb[s] + gg[s] + ridge;
            double o = wb + gw[s] - gb[s] - gg[s];
            double p0 = w0 - y0[s], p1 = w1 - y1[s], p2 = w2 - y2[s];
            double q0 = b0 + y0[s], q1 = b1 + y1[s], q2 = b2 + y2[s];
            double pp = p0 * p0 + p1 * p1 + p2 * p2, pq = p0 * q0 + p1 * q1 + p2 * q2, qq = q0 * q0 + q1 * q1 + q2 * q2;
            score[s] = (dd * pp - 2.0 * o * pq + aa * qq) / (aa * dd - o * o);
        }
        double first = -1.0, second = -1.0;
        int at = 0;
        for (int c = 0; c < codes; c++) {
            double e = score[masks[t * codes + c]];
            if (e > first) {
                second = first;
                first = e;
                at = c;
            } else if (e > second)
                second = e;
        }
        by_turn[t] = first;
        if (first > best) {
            best = first;
            by_code = second;
            out->turn = t;
            out->code = at;
        }
    }
    double other = -1.0;
    for (int t = 0; t < TURNS; t++)
        if (t != out->turn && by_turn[t] > other)
            other = by_turn[t];
    double aa = K[0] + ridge, dd = K[2 * C + 2] + ridge, o = K[2], frame = by_two;
    for (int c = 0; c < 3; c++)
        frame += (dd * Y[c] * Y[c] - 2.0 * o * Y[c] * Y[6 + c] + aa * Y[6 + c] * Y[6 + c]) / (aa * dd - o * o);
    out->left = energy - by_two - best;
    out->left_by_code = energy - by_two - by_code;
    out->left_by_turn = energy - by_two - other;
    out->left_by_frame = energy - frame;
    return best >= 0.0;
}

/* M' gram M and M' seen of one hypothesis, M (C,4) choosing what is white, red, blue and surroundings. */
static inline void hypothesis_normal(int gaps, const double *gram, const double *seen, int turn, uint32_t open, double *normal, double *by_inks)
{
    const int C = 9 + gaps;
    double M[MAX_COLUMNS][INKS], GM[MAX_COLUMNS][INKS];
    for (int i = 0; i < C; i++)
        for (int k = 0; k < INKS; k++)
            M[i][k] = i == k ? 1.0 : 0.0;
    M[4][0] = M[5 + turn][0] = 1.0;
    M[4][2] = M[5 + turn][2] = -1.0;
    for (int g = 0; g < gaps; g++)
        if (open >> g & 1) {
            M[9 + g][0] = -1.0;
            M[9 + g][2] = 1.0;
        }
    for (int i = 0; i < C; i++)
        for (int k = 0; k < INKS; k++) {
            GM[i][k] = 0.0;
            for (int j = 0; j < C; j++)
                GM[i][k] += gram[i * C + j] * M[j][k];
        }
    for (int k = 0; k < INKS; k++) {
        for (int l = 0; l < INKS; l++) {
            normal[k * INKS + l] = 0.0;
            for (int i = 0; i < C; i++)
                normal[k * INKS + l] += M[i][k] * GM[i][l];
        }
        for (int c = 0; c < 3; c++) {
            by_inks[k * 3 + c] = 0.0;
            for (int i = 0; i < C; i++)
                by_inks[k * 3 + c] += M[i][k] * seen[i * 3 + c];
        }
    }
}

/* inks (4,3) of one hypothesis. */
static inline int hypothesis_inks(int gaps, const double *gram, const double *seen, int turn, uint32_t open, double ridge, double *inks)
{
    double normal[INKS * INKS], b[INKS];
    hypothesis_normal(gaps, gram, seen, turn, open, normal, inks);
    for (int k = 0; k < INKS; k++)
        normal[k * INKS + k] += ridge;
    if (!factor(normal, INKS))
        return 0;
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < INKS; k++)
            b[k] = inks[k * 3 + c];
        solve_lower(normal, INKS, b);
        solve_upper(normal, INKS, b);
        for (int k = 0; k < INKS; k++)
            inks[k * 3 + c] = b[k];
    }
    return 1;
}

static inline double log_ratio(double red, double blue, double white_red, double white_blue)
{
    double r = red / (white_red > 1e-3 ? white_red : 1e-3), b = blue / (white_blue > 1e-3 ? white_blue : 1e-3);
    r = r < 0.0 ? 0.0 : r > 1.5 ? 1.5 : r;
    b = b < 0.0 ? 0.0 : b > 1.5 ? 1.5 : b;
    return log((r + 0.03) / (b + 0.03));
}

/* How much redder the border is than the ground, relative to the white; inks (.,3) BGR of white, red, blue. */
static inline double red_over_blue(const double *inks)
{
    return log_ratio(inks[5], inks[3], inks[2], inks[0]) - log_ratio(inks[8], inks[6], inks[2], inks[0]);
}

#endif
