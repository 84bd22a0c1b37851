/* Unexplained energy of one square under every code of a family of cells.  cell_codes.py holds the definition. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "kernels.h"
#include "linear.h"
#include "select.h"

#define MAX_CELLS 64
#define COLUMNS (MAX_CELLS + 2) /* cells, border, margin */
#define BYTES (MAX_CELLS / 8)

/* Products of the columns with each other and with the values, after the surroundings are eliminated. */
typedef struct {
    int cells;
    double G[COLUMNS][COLUMNS], S[COLUMNS][3], total[COLUMNS], energy, weight, all;
} Sums;

/* words (rows), bit k set where cell k is white; moments (K+6,K+6) as grid_moments gives them; scratch: 2 rows
 * floats.  out: row of the best code, unexplained energy of this and of the next code and of a plain inside, weight,
 * inks (2,3), cells (K).  Returns 1 if white would be darker than black. */
LMKIT_EXPORT int lmkit_cell_codes(int64_t cells, int64_t rows, int64_t shortlist, double ridge, const uint64_t *words,
                                  const double *moments, float *scratch, double *out);

static void free_of_surroundings(int K, const double *moments, Sums *s)
{
    const int R = K + 6, beyond = K + 2;
    const double *last = moments + beyond * R;
    const double own = last[beyond] > 1e-9 ? last[beyond] : 1e-9;
    s->cells = K, s->energy = s->weight = s->all = 0.0;
    for (int c = 0; c < 3; c++) {
        const double seen = last[K + 3 + c];
        s->energy += moments[(K + 3 + c) * R + K + 3 + c] - seen * seen / own;
    }
    for (int i = 0; i < K + 3; i++)
        for (int j = 0; j < K + 3; j++)
            s->weight += 3.0 * moments[i * R + j];
    for (int i = 0; i < K + 2; i++) {
        const double share = last[i] / own;
        for (int j = 0; j < K + 2; j++)
            s->G[i][j] = moments[i * R + j] - share * last[j];
        for (int c = 0; c < 3; c++)
            s->S[i][c] = moments[i * R + K + 3 + c] - share * last[K + 3 + c];
        s->total[i] = 0.0;
        for (int j = 0; j < K; j++)
            s->total[i] += s->G[i][j];
    }
    for (int k = 0; k < K; k++)
        s->all += s->total[k];
}

/* Unexplained energy for a set of white cells, from its sums with itself, all cells, border, margin and values;
 * infinite if white would be darker than black. */
static double left_by(const Sums *s, double square, double by_total, double by_border, double by_margin,
                      const double *seen, double *inks)
{
    const int K = s->cells;
    const double dark = 2.0 * s->total[K] + s->all + s->G[K][K];
    const double ww = s->G[K + 1][K + 1] + 2.0 * by_margin + square;
    const double wb = s->G[K][K + 1] + s->total[K + 1] + by_border + by_total - by_margin - square;
    const double bb = dark - 2.0 * (by_border + by_total) + square;
    double det = ww * bb - wb * wb, left = s->energy, white = 0.0, black = 0.0;
    det = det > 1e-6 * ww * bb ? det : 1e-6 * ww * bb;
    for (int c = 0; c < 3; c++) {
        double white_seen = s->S[K + 1][c] + seen[c], black_seen = s->S[K][c] - seen[c];
        for (int k = 0; k < K; k++)
            black_seen += s->S[k][c];
        inks[c] = (bb * white_seen - wb * black_seen) / det;
        inks[3 + c] = (ww * black_seen - wb * white_seen) / det;
        left -= inks[c] * white_seen + inks[3 + c] * black_seen;
        white += inks[c], black += inks[3 + c];
    }
    return white > black ? left : INFINITY;
}

static double left_by_word(const Sums *s, uint64_t word, double *inks)
{
    const int K = s->cells;
    double square = 0.0, by_total = 0.0, by_border = 0.0, by_margin = 0.0, seen[3] = {0.0, 0.0, 0.0};
    int white[MAX_CELLS], n = 0;
    for (int k = 0; k < K; k++)
        if (word >> k & 1)
            white[n++] = k;
    for (int i = 0; i < n; i++) {
        const double *row = s->G[white[i]];
        for (int j = 0; j < n; j++)
            square += row[white[j]];
        by_total += s->total[white[i]];
        by_border += row[K];
        by_margin += row[K + 1];
        for (int c = 0; c < 3; c++)
            seen[c] += s->S[white[i]][c];
    }
    return left_by(s, square, by_total, by_border, by_margin, seen, inks);
}

static double left_by_gray(const Sums *s, double *inks)
{
    const int K = s->cells;
    double by_border = 0.0, by_margin = 0.0, seen[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < K; k++) {
        by_border += 0.5 * s->G[k][K];
        by_margin += 0.5 * s->G[k][K + 1];
        for (int c = 0; c < 3; c++)
            seen[c] += 0.5 * s->S[k][c];
    }
    return left_by(s, 0.25 * s->all, 0.5 * s->all, by_border, by_margin, seen, inks);
}

/* Brightness of every cell by itself, given the inks. */
static void solve_cells(const Sums *s, const double *L, double ridge, const double *inks, double *cells)
{
    const int K = s->cells;
    const double black = (inks[3] + inks[4] + inks[5]) / 3.0;
    const double contrast = (inks[0] + inks[1] + inks[2]) / 3.0 - black, by = contrast > 1e-6 ? contrast : 1e-6;
    for (int k = 0; k < K; k++) {
        const double mean = (s->S[k][0] + s->S[k][1] + s->S[k][2]) / 3.0, margin = s->G[k][K + 1];
        const double light = mean - black * (s->total[k] + s->G[k][K] + margin);
        cells[k] = (light - contrast * margin) / by + 0.5 * ridge;
    }
    solve_lower(L, K, cells);
    solve_upper(L, K, cells);
}

/* Distance of every word from the cells: minus the sum over its white cells, looked up by bytes of the word. */
static void liken(int K, int64_t rows, const uint64_t *words, const double *cells, float *alike)
{
    float by_byte[BYTES][256];
    const int bytes = (K + 7) / 8;
    for (int b = 0; b < bytes; b++) {
        by_byte[b][0] = 0.0f;
        for (int bit = 0; bit < 8; bit++) {
            const int k = 8 * b + bit;
            const float more = k < K ? (float)(cells[k] - 0.5) : 0.0f;
            for (int v = 0; v < 1 << bit; v++)
                by_byte[b][v | 1 << bit] = by_byte[b][v] + more;
        }
    }
    for (int64_t r = 0; r < rows; r++) {
        float sum = 0.0f;
        for (int b = 0; b < bytes; b++)
            sum += by_byte[b][words[r] >> (8 * b) & 255];
        alike[r] = -sum;
    }
}

int lmkit_cell_codes(int64_t cells, int64_t rows, int64_t shortlist, double ridge, const uint64_t *words,
                     const double *moments, float *scratch, double *out)
{
    const int K = (int)cells;
    Sums s;
    double L[MAX_CELLS * MAX_CELLS], gray[6], inks[6], trace = 0.0;
    free_of_surroundings(K, moments, &s);
    out[3] = left_by_gray(&s, gray);
    out[4] = s.weight;
    if (!isfinite(out[3]))
        return 1;
    for (int k = 0; k < K; k++)
        trace += s.G[k][k];
    ridge *= trace / K;
    for (int i = 0; i < K; i++)
        for (int j = 0; j < K; j++)
            L[i * K + j] = s.G[i][j] + (i == j ? ridge : 0.0);
    if (!factor(L, K))
        return 1;
    solve_cells(&s, L, ridge, gray, out + 11);
    liken(K, rows, words, out + 11, scratch);
    float least = INFINITY;
    if (shortlist < rows) {
        memcpy(scratch + rows, scratch, (size_t)rows * sizeof *scratch);
        least = nth_smallest(scratch + rows, rows, shortlist - 1);
    }
    out[0] = -1.0, out[1] = out[2] = INFINITY;
    for (int64_t r = 0; r < rows; r++) {
        if (!(scratch[r] <= least))
            continue;
        const double left = left_by_word(&s, words[r], inks);
        if (left < out[1]) {
            out[0] = (double)r, out[2] = out[1], out[1] = left;
            memcpy(out + 5, inks, sizeof inks);
        } else if (left < out[2])
            out[2] = left;
    }
    if (!isfinite(out[2]))
        return 1;
    solve_cells(&s, L, ridge, out + 5, out + 11);
    return 0;
}
