/* From pixels to the landmark's plane: homography of four corners, radial distortion, point spread, light. */
#ifndef LMKIT_PLANE_H
#define LMKIT_PLANE_H

#include <math.h>
#include <string.h>

#include "pattern.h"

/* State of a registration: corners 0..7 (px), point spread 8..10 (px^2), radial distortion 11, shading 12..13,
 * mixed-pixel bias 14. */
#define STATE 15

/* View: origin x, y (px; pixel coordinates are relative to it), center x, y (px), half width (px), half side (mm),
 * variance of a pixel's box (px^2). */
#define VIEW 7

typedef struct {
    float inverse[9], bend, to_center_x, to_center_y, inverse_half_width2, r2, xx, xy, yy, shade_x, shade_y;
} Plane;

/* Row-major homography from the landmark's plane to four corners given as x0 y0 x1 y1 ... (Heckbert 1989). */
static inline void homography(const double *c, double half, double *H)
{
    double dx1 = c[2] - c[4], dx2 = c[6] - c[4], sx = c[0] - c[2] + c[4] - c[6];
    double dy1 = c[3] - c[5], dy2 = c[7] - c[5], sy = c[1] - c[3] + c[5] - c[7];
    double det = dx1 * dy2 - dx2 * dy1, g = (sx * dy2 - sy * dx2) / det, h = (dx1 * sy - dy1 * sx) / det;
    double M[9] = {c[2] - c[0] + g * c[2], c[6] - c[0] + h * c[6], c[0], c[3] - c[1] + g * c[3], c[7] - c[1] + h * c[7], c[1], g, h, 1.0};
    for (int r = 0; r < 3; r++) {
        const double *m = M + 3 * r;
        H[3 * r] = 0.5 * m[0] / half;
        H[3 * r + 1] = -0.5 * m[1] / half;
        H[3 * r + 2] = 0.5 * m[0] + 0.5 * m[1] + m[2];
    }
}

static inline void invert3(const double *m, double *out)
{
    double a = m[4] * m[8] - m[5] * m[7], b = m[5] * m[6] - m[3] * m[8], c = m[3] * m[7] - m[4] * m[6];
    double s = 1.0 / (m[0] * a + m[1] * b + m[2] * c);
    double inverse[9] = {a, m[2] * m[7] - m[1] * m[8], m[1] * m[5] - m[2] * m[4], b, m[0] * m[8] - m[2] * m[6], m[2] * m[3] - m[0] * m[5], c, m[1] * m[6] - m[0] * m[7], m[0] * m[4] - m[1] * m[3]};
    for (int i = 0; i < 9; i++)
        out[i] = inverse[i] * s;
}

/* Corners relative to the view's origin. */
static inline void relative_corners(const double *view, const double *state, double *corners)
{
    for (int i = 0; i < 8; i++)
        corners[i] = state[i] - view[i & 1];
}

static inline Plane plane_of(const double *view, const double *state)
{
    Plane p;
    double corners[8], H[9], inverse[9];
    relative_corners(view, state, corners);
    homography(corners, view[5], H);
    invert3(H, inverse);
    for (int i = 0; i < 9; i++)
        p.inverse[i] = (float)inverse[i];
    p.bend = (float)state[11];
    p.to_center_x = (float)(view[0] - view[2]);
    p.to_center_y = (float)(view[1] - view[3]);
    p.inverse_half_width2 = (float)(1.0 / (view[4] * view[4]));
    p.r2 = (p.to_center_x * p.to_center_x + p.to_center_y * p.to_center_y) * p.inverse_half_width2;
    p.xx = (float)(state[8] + view[6]);
    p.xy = (float)state[9];
    p.yy = (float)(state[10] + view[6]);
    p.shade_x = (float)(state[12] / view[5]);
    p.shade_y = (float)(state[13] / view[5]);
    return p;
}

/* What slopes need beside the points: d plane / d pixel (a b; c d), undistorted pixel, radial direction. */
typedef struct {
    block a, b, c, d, flat_x, flat_y, radial_x, radial_y;
} Jacobian;

/* Displacement of a pixel at x from the view's origin by a distortion, its slope with the distortion and its slopes with x
 * (00 01 10 11); plane.py: displaced_numpy. */
static inline void displaced(const double *view, double distortion, const double *x, double *out, double *by_distortion, double *by_x)
{
    const double scale = 1.0 / (view[4] * view[4]), c[2] = {view[0] - view[2], view[1] - view[3]};
    const double r2 = (c[0] * c[0] + c[1] * c[1]) * scale, near = (x[0] * x[0] + x[1] * x[1]) * scale;
    const double grown = near + 2.0 * (x[0] * c[0] + x[1] * c[1]) * scale;
    const double more_near = distortion * (grown * grown + 2.0 * r2 * near);
    const double more = distortion * (grown * grown + 2.0 * r2 * grown);
    for (int i = 0; i < 2; i++) {
        out[i] = distortion * (c[i] * (near + more_near) + x[i] * (grown + more));
        by_distortion[i] = c[i] * (near + 2.0 * more_near) + x[i] * (grown + 2.0 * more);
        for (int j = 0; j < 2; j++) {
            const double d_near = 2.0 * scale * x[j], d_grown = 2.0 * scale * (c[j] + x[j]);
            const double by_near = d_near + 2.0 * distortion * (grown * d_grown + r2 * d_near);
            const double by_grown = d_grown + 2.0 * distortion * (grown + r2) * d_grown;
            by_x[2 * i + j] = distortion * (c[i] * by_near + x[i] * by_grown + (i == j ? grown + more : 0.0));
        }
    }
}

static inline void map_block(const Plane *p, const float *restrict x, const float *restrict y, Points *restrict out, Jacobian *restrict J, float *restrict light)
{
    const float *m = p->inverse;
    EACH {
        float near = (x[i] * x[i] + y[i] * y[i]) * p->inverse_half_width2;
        float grown = near + 2.0f * (x[i] * p->to_center_x + y[i] * p->to_center_y) * p->inverse_half_width2;
        float more_near = p->bend * (grown * grown + 2.0f * p->r2 * near);
        float more = p->bend * (grown * grown + 2.0f * p->r2 * grown);
        float rx = p->to_center_x * (near + 2.0f * more_near) + x[i] * (grown + 2.0f * more);
        float ry = p->to_center_y * (near + 2.0f * more_near) + y[i] * (grown + 2.0f * more);
        float fx = x[i] + p->bend * (p->to_center_x * (near + more_near) + x[i] * (grown + more));
        float fy = y[i] + p->bend * (p->to_center_y * (near + more_near) + y[i] * (grown + more));
        float w = 1.0f / (m[6] * fx + m[7] * fy + m[8]);
        float u = (m[0] * fx + m[1] * fy + m[2]) * w, v = (m[3] * fx + m[4] * fy + m[5]) * w;
        float a = (m[0] - u * m[6]) * w, b = (m[1] - u * m[7]) * w;
        float c = (m[3] - v * m[6]) * w, d = (m[4] - v * m[7]) * w;
        out->x[i] = u;
        out->y[i] = v;
        out->sxx[i] = a * a * p->xx + 2.0f * a * b * p->xy + b * b * p->yy;
        out->sxy[i] = a * c * p->xx + (a * d + b * c) * p->xy + b * d * p->yy;
        out->syy[i] = c * c * p->xx + 2.0f * c * d * p->xy + d * d * p->yy;
        J->a[i] = a, J->b[i] = b, J->c[i] = c, J->d[i] = d;
        J->flat_x[i] = fx, J->flat_y[i] = fy, J->radial_x[i] = rx, J->radial_y[i] = ry;
        float lit = 1.0f + u * p->shade_x + v * p->shade_y;
        light[i] = lit > 0.1f ? lit : 0.1f;
    }
}

/* One block of n <= BLOCK values, the last one repeated. */
static inline void load_block(const float *from, int n, float *restrict to)
{
    for (int i = 0; i < n; i++)
        to[i] = from[i];
    for (int i = n; i < BLOCK; i++)
        to[i] = from[n - 1];
}

/* 1 / standard deviation, 0 beyond the n-th. */
static inline void load_root(const float *variance, int n, float *restrict to)
{
    for (int i = 0; i < n; i++)
        to[i] = 1.0f / sqrtf(variance[i]);
    for (int i = n; i < BLOCK; i++)
        to[i] = 0.0f;
}

#endif
