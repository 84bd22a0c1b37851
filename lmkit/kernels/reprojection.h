/* Whitened errors of one landmark's four corners in a camera, with derivatives; and small matrices. */
#ifndef LMKIT_REPROJECTION_H
#define LMKIT_REPROJECTION_H

#include <math.h>
#include <stdint.h>

/* Eight rows, one a corner coordinate, of eight numbers: derivatives with shift and turn (6), the error, and zero.
 * The product of such a block with itself holds the normal matrix, the gradient and the squared error. */
#define WIDE 8

/* Pose of the camera of an observation: x_camera = M (X - p) + t. */
static inline void map_to_camera(const double *R_camera, const double *R, double *M) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            M[3 * i + j] = R_camera[3 * i] * R[3 * j] + R_camera[3 * i + 1] * R[3 * j + 1] +
                           R_camera[3 * i + 2] * R[3 * j + 2];
}

/* Row of a block: sign * g, and -sign * (g x arm) for a turn about the map's axes. */
static inline void derivative_row(const double *g, const double *arm, double sign, double *row) {
    for (int j = 0; j < 3; j++) row[j] = sign * g[j];
    row[3] = -sign * (g[1] * arm[2] - g[2] * arm[1]);
    row[4] = -sign * (g[2] * arm[0] - g[0] * arm[2]);
    row[5] = -sign * (g[0] * arm[1] - g[1] * arm[0]);
}

/* Errors of rays, and derivatives of the expected rays with the rig (block) and the landmark (moved, may be null).
 * With derivatives = 0 only the errors are filled in. */
static inline void corner_errors(const double *points, const double *arms, const double *M, const double *t,
                                 const double *p, const double *rays, double nearest, double nowhere,
                                 int derivatives, double *block, double *moved) {
    int behind = 0;
    for (int c = 0; c < 4; c++) {
        const double *X = points + 3 * c;
        const double o[3] = {X[0] - p[0], X[1] - p[1], X[2] - p[2]};
        const double x = M[0] * o[0] + M[1] * o[1] + M[2] * o[2] + t[0];
        const double y = M[3] * o[0] + M[4] * o[1] + M[5] * o[2] + t[1];
        const double z = M[6] * o[0] + M[7] * o[1] + M[8] * o[2] + t[2];
        const double near = z < nearest ? nearest : z;
        const double inverse = 1 / near, u = x * inverse, v = y * inverse;
        double *row = block + 2 * WIDE * c;
        behind |= z < nearest;
        row[6] = rays[2 * c] - u;
        row[WIDE + 6] = rays[2 * c + 1] - v;
        row[7] = row[WIDE + 7] = 0;
        if (!derivatives) continue;
        double gu[3], gv[3];
        for (int j = 0; j < 3; j++) {
            gu[j] = (M[j] - u * M[6 + j]) * inverse;
            gv[j] = (M[3 + j] - v * M[6 + j]) * inverse;
        }
        derivative_row(gu, o, -1, row);
        derivative_row(gv, o, -1, row + WIDE);
        if (!moved) continue;
        double *other = moved + 2 * WIDE * c;
        derivative_row(gu, arms + 3 * c, 1, other);
        derivative_row(gv, arms + 3 * c, 1, other + WIDE);
        other[6] = other[7] = other[WIDE + 6] = other[WIDE + 7] = 0;
    }
    if (behind)
        for (int i = 0; i < 8; i++) block[WIDE * i + 6] = nowhere;
}

/* A row of eight doubles as one vector, whatever the processor's registers hold (an extension of GCC and clang). */
typedef double Row __attribute__((vector_size(64), aligned(8), may_alias));

/* out (8,8) = W (8,8) B (8,8). */
static inline void times8(const double *restrict W, const double *restrict B, double *restrict out) {
    const Row *rows = (const Row *)B;
    for (int i = 0; i < 8; i++) {
        Row sum = W[8 * i] * rows[0];
        for (int k = 1; k < 8; k++) sum += W[8 * i + k] * rows[k];
        *(Row *)(out + WIDE * i) = sum;
    }
}

/* out (8,8) += A^T B. */
static inline void add_transposed8(const double *restrict A, const double *restrict B, double *restrict out) {
    const Row *rows = (const Row *)B;
    for (int i = 0; i < WIDE; i++) {
        Row sum = *(Row *)(out + WIDE * i);
        for (int k = 0; k < 8; k++) sum += A[WIDE * k + i] * rows[k];
        *(Row *)(out + WIDE * i) = sum;
    }
}

/* Lower Cholesky factor of the leading 6 x 6 part of rows of `stride` numbers, in place; 0 where there is none. */
static inline int cholesky6(double *A, int stride) {
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = A[stride * i + j];
            for (int k = 0; k < j; k++) sum -= A[stride * i + k] * A[stride * j + k];
            if (i == j) {
                if (!(sum > 0)) return 0;
                A[stride * i + i] = sqrt(sum);
            } else {
                A[stride * i + j] = sum / A[stride * j + j];
            }
        }
    }
    return 1;
}

/* L^-1 b, in place, for `count` columns in rows of `wide` numbers. */
static inline void forward6(const double *L, int stride, double *b, int wide, int count) {
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k < i; k++)
            for (int j = 0; j < count; j++) b[wide * i + j] -= L[stride * i + k] * b[wide * k + j];
        for (int j = 0; j < count; j++) b[wide * i + j] /= L[stride * i + i];
    }
}

/* L^-T b, in place, one column. */
static inline void backward6(const double *L, int stride, double *b) {
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++) b[i] -= L[stride * k + i] * b[k];
        b[i] /= L[stride * i + i];
    }
}

/* Rotation matrix of a rotation vector (Rodrigues), times R. */
static inline void turn_by(const double *w, const double *R, double *out) {
    const double squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], angle = sqrt(squared);
    const double a = angle < 1e-8 ? 1.0 : sin(angle) / angle;
    const double b = angle < 1e-8 ? 0.5 : (1 - cos(angle)) / squared;
    const double T[9] = {1 - b * (w[1] * w[1] + w[2] * w[2]), b * w[0] * w[1] - a * w[2], b * w[0] * w[2] + a * w[1],
                         b * w[0] * w[1] + a * w[2], 1 - b * (w[0] * w[0] + w[2] * w[2]), b * w[1] * w[2] - a * w[0],
                         b * w[0] * w[2] - a * w[1], b * w[1] * w[2] + a * w[0], 1 - b * (w[0] * w[0] + w[1] * w[1])};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = T[3 * i] * R[j] + T[3 * i + 1] * R[3 + j] + T[3 * i + 2] * R[6 + j];
}

#endif
