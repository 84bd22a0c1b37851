/* Blurred coverage of a grid of black cells on white paper, and its slopes.
 *
 * With F_i the coverage below the i-th horizontal line of the grid and G_j the coverage right of its j-th vertical
 * line, black covers sum E_ij F_i G_j: E is the mixed second difference of the cells' darkness, zero beyond the
 * grid.  The point spread's covariance of x and y is left out, which shifts no edge.  `grid_pattern.py` holds the
 * definition.
 */
#ifndef LMKIT_GRID_H
#define LMKIT_GRID_H

#define MAX_GRID_LINES 13

static inline void grid_lines(const float *restrict at, const float *restrict variance, float half, int side, float sign, Edge *restrict out)
{
    block inverse_s, distance;
    EACH inverse_s[i] = 1.0f / sqrtf(variance[i]);
    for (int k = 0; k <= side; k++) {
        float offset = half * (2.0f * (float)k / (float)side - 1.0f);
        EACH distance[i] = sign * at[i] - offset;
        edge_slopes(distance, inverse_s, out + k);
    }
}

/* Black: value, d/dx, d/dy, d/dSxx, d/dSxy, d/dSyy. */
static inline void grid_black(const Drawing *d, const Points *restrict at, block *restrict black)
{
    Edge across[MAX_GRID_LINES], down[MAX_GRID_LINES];
    int side = d->side;
    grid_lines(at->x, at->sxx, d->squares[1], side, 1.0f, across);
    grid_lines(at->y, at->syy, d->squares[1], side, -1.0f, down);
    for (int k = 0; k < JET; k++)
        EACH black[k][i] = 0.0f;
    for (int r = 0; r <= side; r++) {
        block v, e, f;
        int used = 0;
        EACH v[i] = e[i] = f[i] = 0.0f;
        for (int c = 0; c <= side; c++) {
            float w = d->cells[r * (side + 1) + c];
            if (w == 0.0f)
                continue;
            used = 1;
            const Edge *a = across + c;
            EACH {
                v[i] += w * a->v[i];
                e[i] += w * a->e[i];
                f[i] += w * a->f[i];
            }
        }
        if (!used)
            continue;
        const Edge *b = down + r;
        EACH {
            black[0][i] += b->v[i] * v[i];
            black[1][i] += b->v[i] * e[i];
            black[2][i] -= b->e[i] * v[i];
            black[3][i] += b->v[i] * f[i];
            black[5][i] += b->f[i] * v[i];
        }
    }
}

#endif
