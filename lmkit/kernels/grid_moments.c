/* Products of a grid's cells, border, margin and surroundings with each other and with the values of pixels.
 * grid_moments.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "lanes.h"
#include "plane.h"

#define MAX_INSIDE 100
#define MAX_ROWS (MAX_INSIDE + 6)

/* moments (R,R), R = inside cells + 6; sums: R (R + 1) / 2 lanes of scratch. */
LMKIT_EXPORT int lmkit_grid_moments(int64_t n, const float *drawing, int64_t border, const double *view,
                                    const float *at, const float *values, const float *variance,
                                    const double *state, float *sums, double *moments);

/* Coverage by the strips between lines of the grid. */
static void strips(const float *at, const float *variance, float half, int side, float sign, block *restrict out)
{
    block inverse_s, last;
    EACH inverse_s[i] = 1.0f / sqrtf(variance[i]);
    for (int k = 0; k <= side; k++) {
        float offset = half * (2.0f * (float)k / (float)side - 1.0f);
        EACH {
            float p;
            float v = normal_distribution((sign * at[i] - offset) * inverse_s[i], &p);
            if (k > 0)
                out[k - 1][i] = last[i] - v;
            last[i] = v;
        }
    }
}

int lmkit_grid_moments(int64_t n, const float *drawing, int64_t border, const double *view, const float *at,
                       const float *values, const float *variance, const double *state, float *sums,
                       double *moments)
{
    Drawing d = read_drawing(drawing);
    Plane plane = plane_of(view, state);
    const int side = d.side, inner = side - 2 * (int)border, inside = inner * inner, R = inside + 6;
    memset(sums, 0, (size_t)(R * (R + 1) / 2) * LANES * sizeof(float));
    for (int64_t start = 0; start < n; start += BLOCK) {
        int count = n - start < BLOCK ? (int)(n - start) : BLOCK;
        block x, y, light, root, rows[MAX_ROWS], across[MAX_GRID_LINES], down[MAX_GRID_LINES], face, paper[2];
        Points points;
        Jacobian J;
        load_block(at + start, count, x);
        load_block(at + n + start, count, y);
        map_block(&plane, x, y, &points, &J, light);
        load_root(variance + start, count, root);
        strips(points.x, points.sxx, d.squares[0], 1, 1.0f, paper);
        strips(points.y, points.syy, d.squares[0], 1, -1.0f, paper + 1);
        strips(points.x, points.sxx, d.squares[1], side, 1.0f, across);
        strips(points.y, points.syy, d.squares[1], side, -1.0f, down);
        for (int axis = 0; axis < 2; axis++) {
            block whole;
            EACH whole[i] = 0.0f;
            for (int k = 0; k < side; k++)
                EACH whole[i] += (axis ? down : across)[k][i];
            EACH face[i] = axis ? face[i] * whole[i] : whole[i];
        }
        EACH {
            light[i] *= root[i];
            paper[0][i] *= paper[1][i];
            rows[inside][i] = face[i];
            rows[inside + 1][i] = (paper[0][i] - face[i]) * light[i];
            rows[inside + 2][i] = (1.0f - paper[0][i]) * light[i];
        }
        for (int r = 0, k = 0; r < inner; r++)
            for (int c = 0; c < inner; c++, k++)
                EACH {
                    float cell = down[r + border][i] * across[c + border][i];
                    rows[inside][i] -= cell;
                    rows[k][i] = cell * light[i];
                }
        EACH rows[inside][i] *= light[i];
        for (int c = 0; c < 3; c++) {
            load_block(values + c * n + start, count, rows[inside + 3 + c]);
            EACH rows[inside + 3 + c][i] *= root[i];
        }
        lanes *row = (lanes *)sums;
        for (int r = 0; r < R; row += ++r)
            add_dots(row, rows[r], (const block *)rows, r + 1);
    }
    const lanes *sum = (const lanes *)sums;
    for (int r = 0; r < R; r++)
        for (int c = 0; c <= r; c++, sum++)
            moments[r * R + c] = moments[c * R + r] = total(sum);
    return 0;
}
