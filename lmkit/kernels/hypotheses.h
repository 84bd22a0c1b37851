/* Every code in every quarter turn, each with its own best inks, from the moments of the pattern's columns.
 *
 * A hypothesis says which columns are white and which are blue.  Red and surroundings are eliminated once (Schur's
 * complement).  White and blue together cover the same whatever the hypothesis, so that what both explain is a quotient
 * of two quadratic forms of the gaps; only their linear parts differ between quarter turns. */
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

/* out[subset] = start + sum over its gaps of values[gap]. */
static inline void subset_sums(int gaps, double start, const double *values, double *restrict out)
{
    out[0] = start;
    for (int g = 0; g < gaps; g++) {
        const int64_t size = (int64_t)1 << g;
        const double v = values[g];
        for (int64_t s = 0; s < size; s++)
            out[size + s] = out[s] + v;
    }
}

/* out[subset] = sum over its pairs of gaps of pairs[gap][gap'], a gap with itself too; room: for as many sums. */
static inline void pair_sums(int gaps, const double (*pairs)[MAX_GAPS], double *restrict room, double *restrict out)
{
    out[0] = 0.0;
    for (int g = 0; g < gaps; g++) {
        const int64_t size = (int64_t)1 << g;
        subset_sums(g, pairs[g][g], pairs[g], room);
        for (int64_t s = 0; s < size; s++)
            out[size + s] = out[s] + room[s];
    }
}

/* gram (C,C) and seen (C,3) are C'C and C'Y of the columns; masks (TURNS,codes) hold the open gaps of every hypothesis;
 * scratch: five sums for every subset of gaps. */
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

    /* Frame: white and blue together, n its normal, f what is seen of it.  With w the normal of white and p what is seen
       of white, m = white' K frame + ridge and t = f . p, inks explain (n p.p + f.f w - 2 t m) / (n w - m m). */
    const int64_t subsets = (int64_t)1 << gaps;
    double *restrict above = scratch, *restrict below = scratch + subsets, *restrict room = scratch + 4 * subsets;
    double *restrict above_turn = scratch + 2 * subsets, *restrict below_turn = scratch + 3 * subsets;
    double f[3], ff = 0.0, by_frame[MAX_GAPS], by_seen[MAX_GAPS], above_pairs[MAX_GAPS][MAX_GAPS], below_pairs[MAX_GAPS][MAX_GAPS];
    const double n = K[0] + 2.0 * K[2] + K[2 * C + 2] + 2.0 * ridge;
    for (int c = 0; c < 3; c++) {
        f[c] = Y[c] + Y[6 + c];
        ff += f[c] * f[c];
    }
    for (int g = 0; g < gaps; g++) {
        const double *y = Y + (9 + g) * 3;
        by_frame[g] = K[(9 + g) * C] + K[(9 + g) * C + 2];
        by_seen[g] = f[0] * y[0] + f[1] * y[1] + f[2] * y[2];
        for (int h = 0; h <= g; h++) {
            const double *z = Y + (9 + h) * 3, twice = h < g ? 2.0 : 1.0, k = K[(9 + g) * C + 9 + h];
            const double both = y[0] * z[0] + y[1] * z[1] + y[2] * z[2];
            above_pairs[g][h] = twice * (n * both + ff * k - by_seen[g] * by_frame[h] - by_seen[h] * by_frame[g]);
            below_pairs[g][h] = twice * (n * k - by_frame[g] * by_frame[h]);
        }
    }
    pair_sums(gaps, (const double(*)[MAX_GAPS])above_pairs, room, above);
    pair_sums(gaps, (const double(*)[MAX_GAPS])below_pairs, room, below);
    double by_turn[TURNS], by_code = -1.0, best = -1.0;
    out->turn = 0, out->code = 0;
    for (int t = 0; t < TURNS; t++) {
        /* White without open gaps: of the frame, rings and triangle. */
        const int white[3] = {0, 4, 5 + t};
        double w = ridge, m = ridge, p[3] = {0.0, 0.0, 0.0}, above_gaps[MAX_GAPS], below_gaps[MAX_GAPS];
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++)
                w += K[white[i] * C + white[j]];
            m += K[white[i] * C] + K[white[i] * C + 2];
            for (int c = 0; c < 3; c++)
                p[c] += Y[3 * white[i] + c];
        }
        const double seen_by_frame = f[0] * p[0] + f[1] * p[1] + f[2] * p[2], pp = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
        for (int g = 0; g < gaps; g++) {
            const double *k = K + (9 + g) * C, *y = Y + (9 + g) * 3;
            const double by_white = k[0] + k[4] + k[5 + t], both = y[0] * p[0] + y[1] * p[1] + y[2] * p[2];
            above_gaps[g] = 2.0 * (m * by_seen[g] + seen_by_frame * by_frame[g] - n * both - ff * by_white);
            below_gaps[g] = 2.0 * (m * by_frame[g] - n * by_white);
        }
        subset_sums(gaps, n * pp + ff * w - 2.0 * seen_by_frame * m, above_gaps, above_turn);
        subset_sums(gaps, n * w - m * m, below_gaps, below_turn);
        double first = -1.0, second = -1.0;
        int at = 0;
        for (int c = 0; c < codes; c++) {
            const int32_t s = masks[t * codes + c];
            const double e = (above[s] + above_turn[s]) / (below[s] + below_turn[s]);
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

/* Sums of one number for every column (every `stride` doubles) over white, red, blue and surroundings of a
 * hypothesis. */
static inline void sum_of_inks(int gaps, const double *columns, int64_t stride, int turn, uint32_t open, double *inks)
{
    double parts = columns[4 * stride] + columns[(5 + turn) * stride];
    for (int g = 0; g < gaps; g++)
        parts -= open >> g & 1 ? columns[(9 + g) * stride] : 0.0;
    for (int k = 0; k < INKS; k++)
        inks[k] = columns[k * stride];
    inks[0] += parts;
    inks[2] -= parts;
}

/* M' gram M and M' seen of one hypothesis, M (C,4) choosing what is white, red, blue and surroundings. */
static inline void hypothesis_normal(int gaps, const double *gram, const double *seen, int turn, uint32_t open, double *normal, double *by_inks)
{
    const int C = 9 + gaps;
    double GM[MAX_COLUMNS][INKS], by_channel[INKS];
    for (int i = 0; i < C; i++)
        sum_of_inks(gaps, gram + i * C, 1, turn, open, GM[i]);
    for (int k = 0; k < INKS; k++)
        sum_of_inks(gaps, GM[0] + k, INKS, turn, open, normal + k * INKS);
    for (int c = 0; c < 3; c++) {
        sum_of_inks(gaps, seen + c, 3, turn, open, by_channel);
        for (int k = 0; k < INKS; k++)
            by_inks[k * 3 + c] = by_channel[k];
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
