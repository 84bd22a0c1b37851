/* Blurred coverage of a landmark's parts at blocks of points, with slopes (docs/landmark.md, section 4).
 *
 * A half plane at signed distance d covers a point by Phi(d / s), s^2 the variance of the point spread across the
 * edge; parts bounded by several edges multiply.  All loops run over blocks of BLOCK points without a branch or a
 * library call, so that compilers vectorize them.
 *
 * A drawing is a flat float array: ring count R, line count L, gap count G; half sides of paper, face, ground;
 * R x (inner, outer) radii; L x (nx, ny, offset); G x (ring, line, sign, line, sign); 4 x 3 x (line, sign) for the
 * triangle at four quarter turns.  `lmkit/kernels/pattern.py` builds and checks it.  A grid of cells (`grid.h`) has
 * minus its cells a side for a ring count, no lines and gaps, and (side + 1)^2 weights behind the half sides.
 */
#ifndef LMKIT_PATTERN_H
#define LMKIT_PATTERN_H

#include <math.h>
#include <stdint.h>

#define BLOCK 64
#define MAX_RINGS 4
#define MAX_LINES 40
#define MAX_GAPS 16
#define MAX_COLUMNS (9 + MAX_GAPS)
#define JET 6 /* value, d/dx, d/dy, d/dSxx, d/dSxy, d/dSyy */
#define INKS 4
#define EACH _Pragma("omp simd") for (int i = 0; i < BLOCK; i++)

typedef float block[BLOCK];

typedef struct {
    int rings, lines, gaps, side;
    const float *cells, *squares, *radii, *line, *gap, *triangle;
} Drawing;

/* One block of points of the landmark's plane: positions, mm, and covariance of the point spread, mm^2. */
typedef struct {
    block x, y, sxx, sxy, syy;
} Points;

/* Coverage by a straight edge: value, slope with the distance, slope with the variance. */
typedef struct {
    block v, e, f;
} Edge;

static inline Drawing read_drawing(const float *flat)
{
    Drawing d;
    d.side = flat[0] < 0.0f ? (int)-flat[0] : 0;
    d.cells = flat + 6;
    d.rings = d.side ? 0 : (int)flat[0];
    d.lines = (int)flat[1];
    d.gaps = (int)flat[2];
    d.squares = flat + 3;
    d.radii = d.squares + 3;
    d.line = d.radii + 2 * d.rings;
    d.gap = d.line + 3 * d.lines;
    d.triangle = d.gap + 5 * d.gaps;
    return d;
}

/* exp(x) for x <= 0, to 2e-7. */
static inline float exp_negative(float x)
{
    union {
        int32_t i;
        float f;
    } power;
    float t = x * 1.44269504f;
    /* Not the plain constant: compilers then branch on it, and the loop around no longer vectorizes. */
    float lowest = 0.0f * x - 120.0f;
    t = t < lowest ? lowest : t;
    int32_t n = (int32_t)(t - 0.5f);
    float r = (t - (float)n) * 0.69314718f;
    float p = 1.0f + r * (1.0f + r * (0.5f + r * (0.16666667f + r * (0.041666668f + r * (0.0083333333f + r * 0.0013888889f)))));
    /* Exactly 0 below 2^-33: products of tiny numbers underflow, and processors take a hundred cycles for that. */
    power.i = ((n + 127) << 23) & ~((n + 33) >> 31);
    return p * power.f;
}

/* Distribution of the standard normal, and its density (Abramowitz and Stegun 26.2.17, to 1e-7). */
static inline float normal_distribution(float a, float *density)
{
    float p = 0.39894228f * exp_negative(-0.5f * a * a);
    float t = 1.0f / (1.0f + 0.2316419f * fabsf(a));
    float tail = p * t * (0.319381530f + t * (-0.356563782f + t * (1.781477937f + t * (-1.821255978f + t * 1.330274429f))));
    *density = p;
    return a > 0.0f ? 1.0f - tail : tail;
}

/* log2 of x > 0, to 1e-6. */
static inline float log2_of(float x)
{
    union {
        float f;
        int32_t i;
    } bits;
    bits.f = x * 1.41421356f;
    int32_t e = (bits.i >> 23) - 127;
    bits.i = (bits.i & 0x007fffff) | 0x3f800000;
    float m = bits.f * 0.70710678f, s = (m - 1.0f) / (m + 1.0f), q = s * s;
    return (float)e + 2.88539008f * s * (1.0f + q * (0.33333333f + q * (0.2f + q * (0.14285714f + q * 0.11111111f))));
}

static inline float natural_log(float x)
{
    return 0.69314718f * log2_of(x);
}

static inline void edge_values(const float *restrict distance, const float *restrict inverse_s, float *restrict v)
{
    EACH {
        float p;
        v[i] = normal_distribution(distance[i] * inverse_s[i], &p);
    }
}

static inline void edge_slopes(const float *restrict distance, const float *restrict inverse_s, Edge *restrict out)
{
    EACH {
        float p, q = inverse_s[i];
        out->v[i] = normal_distribution(distance[i] * q, &p);
        p *= q;
        out->e[i] = p;
        out->f[i] = -0.5f * p * distance[i] * q * q;
    }
}

static inline void line_geometry(const float *line, const Points *restrict at, float *restrict distance, float *restrict inverse_s)
{
    float nx = line[0], ny = line[1], offset = line[2];
    EACH {
        distance[i] = nx * at->x[i] + ny * at->y[i] - offset;
        inverse_s[i] = 1.0f / sqrtf(nx * nx * at->sxx[i] + 2.0f * nx * ny * at->sxy[i] + ny * ny * at->syy[i]);
    }
}

/* Deviations from an edge beyond which it covers exactly 0 or 1, and all slopes are 0: `exp_negative` ends before. */
#define SURE 6.9f

/* Largest entries of the point spread in a block. */
typedef struct {
    float xx, xy, yy;
} Most;

static inline Most most_spread(const Points *restrict at)
{
    float xx = 0.0f, xy = 0.0f, yy = 0.0f;
    _Pragma("omp simd reduction(max : xx, xy, yy)") for (int i = 0; i < BLOCK; i++) {
        float across = at->sxx[i], both = fabsf(at->sxy[i]), along = at->syy[i];
        xx = across > xx ? across : xx;
        xy = both > xy ? both : xy;
        yy = along > yy ? along : yy;
    }
    return (Most){xx, xy, yy};
}

/* -1 where an edge covers none of the block's points, 1 where it covers all of them, both exactly; else 0. */
static inline int side_of_line(const float *line, const Points *restrict at, const Most *most)
{
    const float nx = line[0], ny = line[1], offset = line[2];
    const float reach = SURE * sqrtf(nx * nx * most->xx + 2.0f * fabsf(nx * ny) * most->xy + ny * ny * most->yy);
    int not_before = 0, not_behind = 0;
    _Pragma("omp simd reduction(| : not_before, not_behind)") for (int i = 0; i < BLOCK; i++) {
        float distance = nx * at->x[i] + ny * at->y[i] - offset;
        not_before |= !(distance < -reach);
        not_behind |= !(distance > reach);
    }
    return !not_before ? -1 : !not_behind ? 1 : 0;
}

/* A point beyond a line on the side that counts, by its sign: nothing is covered. */
static inline int is_outside(const float *line, float sign, const Points *restrict at, const Most *most)
{
    const int side = side_of_line(line, at, most);
    return sign > 0.0f ? side < 0 : side > 0;
}

/* Coverage right of a straight edge at -h, and its density; constants where all points are far from it. */
static inline void axis_edge(const float *restrict at, float h, const float *restrict inverse_s, float reach, float *restrict v, float *restrict p)
{
    int not_before = 0, not_behind = 0;
    _Pragma("omp simd reduction(| : not_before, not_behind)") for (int i = 0; i < BLOCK; i++) {
        not_before |= !(at[i] + h < -reach);
        not_behind |= !(at[i] + h > reach);
    }
    if (not_before && not_behind) {
        EACH v[i] = normal_distribution((at[i] + h) * inverse_s[i], p + i);
        return;
    }
    float sure = not_before ? 1.0f : 0.0f;
    EACH v[i] = sure, p[i] = 0.0f;
}

/* What rings need of a block: direction, radius pushed outward by the blur along the circle, variances. */
typedef struct {
    block nx, ny, radius, inverse_s, variance, pushed, outward;
} Polar;

static inline void polar_geometry(const Points *restrict at, Polar *restrict p)
{
    EACH {
        float x = at->x[i], y = at->y[i];
        float r = sqrtf(x * x + y * y);
        r = r > 1.0f ? r : 1.0f;
        float nx = x / r, ny = y / r, sum = at->sxx[i] + at->syy[i];
        float variance = nx * nx * at->sxx[i] + 2.0f * nx * ny * at->sxy[i] + ny * ny * at->syy[i];
        variance = variance > 0.01f * sum ? variance : 0.01f * sum;
        float outward = (sum - variance) / (2.0f * r), most = 0.3f * r;
        outward = outward < most ? outward : most;
        p->nx[i] = nx;
        p->ny[i] = ny;
        p->radius[i] = r;
        p->variance[i] = variance;
        p->inverse_s[i] = 1.0f / sqrtf(variance);
        p->outward[i] = outward;
        p->pushed[i] = r + outward;
    }
}

/* No point of the block is on a ring or near it. */
static inline int is_off_ring(const Polar *restrict polar, float inner, float outer)
{
    int on = 0;
    _Pragma("omp simd reduction(| : on)") for (int i = 0; i < BLOCK; i++) {
        float q = polar->inverse_s[i];
        on |= !((polar->pushed[i] - inner) * q < -SURE) & !((polar->pushed[i] - outer) * q > SURE);
    }
    return !on;
}

/* Coverage by paper, face and ground, all three products of two intervals. */
static inline void square_values(const Drawing *d, const Points *restrict at, const Most *most, block *restrict out)
{
    block ix, iy, left, right, low, high, p;
    const float reach_x = SURE * sqrtf(most->xx), reach_y = SURE * sqrtf(most->yy);
    EACH {
        ix[i] = 1.0f / sqrtf(at->sxx[i]);
        iy[i] = 1.0f / sqrtf(at->syy[i]);
    }
    for (int k = 0; k < 3; k++) {
        float h = d->squares[k];
        axis_edge(at->x, h, ix, reach_x, left, p);
        axis_edge(at->x, -h, ix, reach_x, right, p);
        axis_edge(at->y, h, iy, reach_y, low, p);
        axis_edge(at->y, -h, iy, reach_y, high, p);
        EACH out[k][i] = (left[i] - right[i]) * (low[i] - high[i]);
    }
}

#include "grid.h"

/* Nothing of a gap, or of the triangle, is on a point of the block or near it. */
static inline int is_off_gap(const Drawing *d, const float *gap, const Points *restrict at, const Most *most)
{
    return is_outside(d->line + 3 * (int)gap[1], gap[2], at, most) || is_outside(d->line + 3 * (int)gap[3], gap[4], at, most);
}

static inline int is_off_triangle(const Drawing *d, int quarter, const Points *restrict at, const Most *most)
{
    const float *t = d->triangle + 6 * quarter;
    for (int k = 0; k < 6; k += 2)
        if (is_outside(d->line + 3 * (int)t[k], t[k + 1], at, most))
            return 1;
    return 0;
}

/* White, nothing, black and surroundings of a grid: inks[INKS * k] for k < count, of values and slopes. */
static inline void grid_inks(const Drawing *d, const Points *restrict at, int count, block *restrict inks)
{
    block black[JET], paper[JET], ix, iy;
    grid_black(d, at, black);
    float h = d->squares[0];
    EACH {
        ix[i] = 1.0f / sqrtf(at->sxx[i]);
        iy[i] = 1.0f / sqrtf(at->syy[i]);
    }
    EACH {
        float p0, p1, q = ix[i], d0 = at->x[i] + h, d1 = at->x[i] - h;
        float across = normal_distribution(d0 * q, &p0) - normal_distribution(d1 * q, &p1);
        float across_x = (p0 - p1) * q, across_xx = -0.5f * (p0 * d0 - p1 * d1) * q * q * q;
        q = iy[i], d0 = at->y[i] + h, d1 = at->y[i] - h;
        float along = normal_distribution(d0 * q, &p0) - normal_distribution(d1 * q, &p1);
        float along_y = (p0 - p1) * q, along_yy = -0.5f * (p0 * d0 - p1 * d1) * q * q * q;
        paper[0][i] = across * along;
        paper[1][i] = across_x * along;
        paper[2][i] = across * along_y;
        paper[3][i] = across_xx * along;
        paper[4][i] = 0.0f;
        paper[5][i] = across * along_yy;
    }
    for (int k = 0; k < count; k++) {
        float one = k == 0 ? 1.0f : 0.0f;
        block *ink = inks + k * INKS;
        EACH {
            ink[0][i] = paper[k][i] - black[k][i];
            ink[1][i] = 0.0f;
            ink[2][i] = black[k][i];
            ink[3][i] = one - paper[k][i];
        }
    }
}

/* Columns: frame by the four inks, closed rings, triangle at four quarter turns, gaps. */
static inline void coverage_columns(const Drawing *d, const Points *restrict at, block *restrict columns)
{
    block squares[3], lines[MAX_LINES], rings[MAX_RINGS], distance, inverse_s;
    int sides[MAX_LINES];
    const Most most = most_spread(at);
    square_values(d, at, &most, squares);
    EACH {
        columns[0][i] = squares[0][i] - squares[1][i];
        columns[1][i] = squares[1][i] - squares[2][i];
        columns[2][i] = squares[2][i];
        columns[3][i] = 1.0f - squares[0][i];
        columns[4][i] = 0.0f;
    }
    Polar polar;
    polar_geometry(at, &polar);
    for (int r = 0; r < d->rings; r++) {
        float inner = d->radii[2 * r], outer = d->radii[2 * r + 1];
        EACH {
            float p, q = polar.inverse_s[i];
            float v = normal_distribution((polar.pushed[i] - inner) * q, &p) - normal_distribution((polar.pushed[i] - outer) * q, &p);
            rings[r][i] = v;
            columns[4][i] += v;
        }
    }
    for (int l = 0; l < d->lines; l++) {
        sides[l] = side_of_line(d->line + 3 * l, at, &most);
        if (sides[l]) {
            float sure = sides[l] > 0 ? 1.0f : 0.0f;
            EACH lines[l][i] = sure;
            continue;
        }
        line_geometry(d->line + 3 * l, at, distance, inverse_s);
        edge_values(distance, inverse_s, lines[l]);
    }
    for (int q = 0; q < 4; q++) {
        const float *t = d->triangle + 6 * q;
        const float *a = lines[(int)t[0]], *b = lines[(int)t[2]], *c = lines[(int)t[4]];
        float a0 = 0.5f - 0.5f * t[1], b0 = 0.5f - 0.5f * t[3], c0 = 0.5f - 0.5f * t[5];
        EACH columns[5 + q][i] = (a0 + t[1] * a[i]) * (b0 + t[3] * b[i]) * (c0 + t[5] * c[i]);
    }
    for (int g = 0; g < d->gaps; g++) {
        const float *k = d->gap + 5 * g;
        const float *ring = rings[(int)k[0]], *a = lines[(int)k[1]], *b = lines[(int)k[3]];
        float a0 = 0.5f - 0.5f * k[2], b0 = 0.5f - 0.5f * k[4];
        if ((float)sides[(int)k[1]] == -k[2] || (float)sides[(int)k[3]] == -k[4]) {
            EACH columns[9 + g][i] = 0.0f;
            continue;
        }
        EACH columns[9 + g][i] = ring[i] * (a0 + k[2] * a[i]) * (b0 + k[4] * b[i]);
    }
}

/* Coverage by the four inks for one reading, values only. */
static inline void ink_values(const Drawing *d, const Points *restrict at, uint32_t open_gaps, int quarter, block *restrict inks)
{
    block squares[3], distance, inverse_s, white, sector, ring;
    Polar polar;
    if (d->side) {
        grid_inks(d, at, 1, inks);
        return;
    }
    const Most most = most_spread(at);
    square_values(d, at, &most, squares);
    polar_geometry(at, &polar);
    const float *t = d->triangle + 6 * quarter;
    const int is_off = is_off_triangle(d, quarter, at, &most);
    float begin = is_off ? 0.0f : 1.0f;
    EACH white[i] = begin;
    for (int k = 0; k < 3 && !is_off; k++) {
        line_geometry(d->line + 3 * (int)t[2 * k], at, distance, inverse_s);
        float sign = t[2 * k + 1];
        EACH {
            float p;
            white[i] *= normal_distribution(sign * distance[i] * inverse_s[i], &p);
        }
    }
    for (int r = 0; r < d->rings; r++) {
        float inner = d->radii[2 * r], outer = d->radii[2 * r + 1];
        if (is_off_ring(&polar, inner, outer))
            continue;
        EACH {
            float p, q = polar.inverse_s[i];
            ring[i] = normal_distribution((polar.pushed[i] - inner) * q, &p) - normal_distribution((polar.pushed[i] - outer) * q, &p);
            sector[i] = 1.0f;
        }
        for (int g = 0; g < d->gaps; g++) {
            const float *k = d->gap + 5 * g;
            if ((int)k[0] != r || !(open_gaps >> g & 1) || is_off_gap(d, k, at, &most))
                continue;
            block other, other_s;
            line_geometry(d->line + 3 * (int)k[1], at, distance, inverse_s);
            line_geometry(d->line + 3 * (int)k[3], at, other, other_s);
            float a = k[2], b = k[4];
            EACH {
                float p;
                sector[i] -= normal_distribution(a * distance[i] * inverse_s[i], &p) * normal_distribution(b * other[i] * other_s[i], &p);
            }
        }
        EACH white[i] += ring[i] * sector[i];
    }
    EACH {
        inks[0][i] = squares[0][i] - squares[1][i] + white[i];
        inks[1][i] = squares[1][i] - squares[2][i];
        inks[2][i] = squares[2][i] - white[i];
        inks[3][i] = 1.0f - squares[0][i];
    }
}

/* Adds weight times the slopes of a line's coverage to the slopes of a product. */
static inline void add_line_slopes(const float *line, float sign, const Edge *restrict edge, const float *restrict weight, block *restrict jet)
{
    float nx = sign * line[0], ny = sign * line[1];
    float xx = sign * line[0] * line[0], xy = sign * 2.0f * line[0] * line[1], yy = sign * line[1] * line[1];
    EACH {
        float e = weight[i] * edge->e[i], f = weight[i] * edge->f[i];
        jet[1][i] += nx * e;
        jet[2][i] += ny * e;
        jet[3][i] += xx * f;
        jet[4][i] += xy * f;
        jet[5][i] += yy * f;
    }
}

/* A closed ring's coverage and slopes; both variances turn with the point: d(n'Sn)/dp = 2 (S n - (n'Sn) n) / r. */
static inline void ring_jets(const Points *restrict at, const Polar *restrict polar, float inner, float outer, block *restrict jet)
{
    EACH {
        float q = polar->inverse_s[i], p0, p1;
        float d0 = polar->pushed[i] - inner, d1 = polar->pushed[i] - outer;
        float v = normal_distribution(d0 * q, &p0) - normal_distribution(d1 * q, &p1);
        float by_distance = (p0 - p1) * q;
        float by_variance = -0.5f * (p0 * d0 - p1 * d1) * q * q * q;
        float nx = polar->nx[i], ny = polar->ny[i], r = polar->radius[i], variance = polar->variance[i];
        float tx = (at->sxx[i] * nx + at->sxy[i] * ny - variance * nx) * (2.0f / r);
        float ty = (at->sxy[i] * nx + at->syy[i] * ny - variance * ny) * (2.0f / r);
        float stretch = 1.0f - polar->outward[i] / r, aside = by_distance / (2.0f * r), turning = by_variance - aside;
        jet[0][i] = v;
        jet[1][i] = by_distance * nx * stretch + turning * tx;
        jet[2][i] = by_distance * ny * stretch + turning * ty;
        jet[3][i] = by_variance * nx * nx + aside * ny * ny;
        jet[4][i] = 2.0f * nx * ny * (by_variance - aside);
        jet[5][i] = by_variance * ny * ny + aside * nx * nx;
    }
}

/* The triangle's coverage and slopes. */
static inline void triangle_jets(const Drawing *d, int quarter, const Points *restrict at, const Most *most, block *restrict white)
{
    block distance, inverse_s, weight;
    Edge a, b, c;
    if (is_off_triangle(d, quarter, at, most)) {
        for (int k = 0; k < JET; k++)
            EACH white[k][i] = 0.0f;
        return;
    }
    const float *t = d->triangle + 6 * quarter;
    const float *la = d->line + 3 * (int)t[0], *lb = d->line + 3 * (int)t[2], *lc = d->line + 3 * (int)t[4];
    line_geometry(la, at, distance, inverse_s);
    edge_slopes(distance, inverse_s, &a);
    line_geometry(lb, at, distance, inverse_s);
    edge_slopes(distance, inverse_s, &b);
    line_geometry(lc, at, distance, inverse_s);
    edge_slopes(distance, inverse_s, &c);
    float sa = t[1], sb = t[3], sc = t[5];
    EACH {
        a.v[i] = 0.5f - 0.5f * sa + sa * a.v[i];
        b.v[i] = 0.5f - 0.5f * sb + sb * b.v[i];
        c.v[i] = 0.5f - 0.5f * sc + sc * c.v[i];
        white[0][i] = a.v[i] * b.v[i] * c.v[i];
        white[1][i] = white[2][i] = white[3][i] = white[4][i] = white[5][i] = 0.0f;
    }
    EACH weight[i] = b.v[i] * c.v[i];
    add_line_slopes(la, sa, &a, weight, white);
    EACH weight[i] = a.v[i] * c.v[i];
    add_line_slopes(lb, sb, &b, weight, white);
    EACH weight[i] = a.v[i] * b.v[i];
    add_line_slopes(lc, sc, &c, weight, white);
}

/* Coverage by the four inks for one reading and its slopes: jets[JET][INKS][BLOCK]. */
static inline void ink_jets(const Drawing *d, const Points *restrict at, uint32_t open_gaps, int quarter, block (*restrict jets)[INKS])
{
    block distance, inverse_s, white[JET], squares[3][JET];
    Edge a, b;
    Polar polar;
    block ix, iy, left, right, low, high, left_p, right_p, low_p, high_p;
    if (d->side) {
        grid_inks(d, at, JET, jets[0]);
        return;
    }
    const Most most = most_spread(at);
    const float reach_x = SURE * sqrtf(most.xx), reach_y = SURE * sqrtf(most.yy);
    EACH {
        ix[i] = 1.0f / sqrtf(at->sxx[i]);
        iy[i] = 1.0f / sqrtf(at->syy[i]);
    }
    for (int k = 0; k < 3; k++) {
        float h = d->squares[k];
        axis_edge(at->x, h, ix, reach_x, left, left_p);
        axis_edge(at->x, -h, ix, reach_x, right, right_p);
        axis_edge(at->y, h, iy, reach_y, low, low_p);
        axis_edge(at->y, -h, iy, reach_y, high, high_p);
        EACH {
            float q = ix[i], across = left[i] - right[i], across_x = (left_p[i] - right_p[i]) * q;
            float across_xx = -0.5f * (left_p[i] * (at->x[i] + h) - right_p[i] * (at->x[i] - h)) * q * q * q;
            q = iy[i];
            float along = low[i] - high[i], along_y = (low_p[i] - high_p[i]) * q;
            float along_yy = -0.5f * (low_p[i] * (at->y[i] + h) - high_p[i] * (at->y[i] - h)) * q * q * q;
            squares[k][0][i] = across * along;
            squares[k][1][i] = across_x * along;
            squares[k][2][i] = across * along_y;
            squares[k][3][i] = across_xx * along;
            squares[k][4][i] = 0.0f;
            squares[k][5][i] = across * along_yy;
        }
    }
    triangle_jets(d, quarter, at, &most, white);
    polar_geometry(at, &polar);
    for (int r = 0; r < d->rings; r++) {
        block ring[JET], sector[JET];
        if (is_off_ring(&polar, d->radii[2 * r], d->radii[2 * r + 1]))
            continue;
        ring_jets(at, &polar, d->radii[2 * r], d->radii[2 * r + 1], ring);
        EACH {
            sector[0][i] = 1.0f;
            sector[1][i] = sector[2][i] = sector[3][i] = sector[4][i] = sector[5][i] = 0.0f;
        }
        for (int g = 0; g < d->gaps; g++) {
            const float *k = d->gap + 5 * g;
            if ((int)k[0] != r || !(open_gaps >> g & 1) || is_off_gap(d, k, at, &most))
                continue;
            const float *la = d->line + 3 * (int)k[1], *lb = d->line + 3 * (int)k[3];
            const float sa = k[2], sb = k[4];
            line_geometry(la, at, distance, inverse_s);
            edge_slopes(distance, inverse_s, &a);
            line_geometry(lb, at, distance, inverse_s);
            edge_slopes(distance, inverse_s, &b);
            EACH {
                a.v[i] = 0.5f - 0.5f * sa + sa * a.v[i];
                b.v[i] = 0.5f - 0.5f * sb + sb * b.v[i];
                sector[0][i] -= a.v[i] * b.v[i];
            }
            add_line_slopes(la, -sa, &a, b.v, sector);
            add_line_slopes(lb, -sb, &b, a.v, sector);
        }
        EACH white[0][i] += ring[0][i] * sector[0][i];
        for (int k = 1; k < JET; k++)
            EACH white[k][i] += ring[k][i] * sector[0][i] + ring[0][i] * sector[k][i];
    }
    for (int k = 0; k < JET; k++) {
        float one = k == 0 ? 1.0f : 0.0f;
        EACH {
            jets[k][0][i] = squares[0][k][i] - squares[1][k][i] + white[k][i];
            jets[k][1][i] = squares[1][k][i] - squares[2][k][i];
            jets[k][2][i] = squares[2][k][i] - white[k][i];
            jets[k][3][i] = one - squares[0][k][i];
        }
    }
}

#endif
