/* How much too large faces seem, along their width and along their height: the part of observations in the equations.
 * face_swelling.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "landmark_bundle.h"

#define SWELLING 2

LMKIT_EXPORT int lmkit_outward(const Bundle *bundle, double *shifts);
LMKIT_EXPORT int lmkit_swelling_equations(const Bundle *bundle, const double *weights, const Sums *sums);

/* Ways along which corners stand too far out: they start at the top left and run with the clock. */
static const double SIGNS[SWELLING][4] = {{-1, 1, 1, -1}, {-1, -1, 1, 1}};

/* How the rays of an observation's corners change, in rows of `wide` numbers, if they stand 1 px farther out. */
static void outward_of(const Bundle *b, int64_t s, double *shifts, int wide) {
    const double *rays = b->rays + 8 * s, *B = b->by_ray + 16 * s;
    for (int k = 0; k < SWELLING; k++) {
        double way[2] = {0, 0};
        for (int c = 0; c < 4; c++)
            for (int i = 0; i < 2; i++)
                way[i] += SIGNS[k][c] * (B[4 * c + 2 * i] * rays[2 * c] + B[4 * c + 2 * i + 1] * rays[2 * c + 1]);
        const double length = sqrt(way[0] * way[0] + way[1] * way[1]);
        for (int c = 0; c < 4; c++) {
            const double *A = B + 4 * c, u = way[0] / length * SIGNS[k][c], v = way[1] / length * SIGNS[k][c];
            const double determinant = A[0] * A[3] - A[1] * A[2];
            const double x = (A[3] * u - A[1] * v) / determinant, y = (A[0] * v - A[2] * u) / determinant;
            /* A face without width or height has no outside. */
            shifts[2 * wide * c + k] = isfinite(x) ? x : 0;
            shifts[2 * wide * c + wide + k] = isfinite(y) ? y : 0;
        }
    }
}

int lmkit_outward(const Bundle *b, double *shifts) {
    for (int64_t s = 0; s < b->count; s++) outward_of(b, s, shifts + 8 * SWELLING * s, SWELLING);
    return 0;
}

/* The first columns of A (6,WIDE) are added to a symmetric matrix: to `column` and the next, from `row` on. */
static void add_both(double *corner, int64_t m, int64_t row, int64_t column, const double *A) {
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < SWELLING; k++) {
            corner[m * (row + i) + column + k] += A[WIDE * i + k];
            corner[m * (column + k) + row + i] += A[WIDE * i + k];
        }
}

int lmkit_swelling_equations(const Bundle *b, const double *weights, const Sums *sums) {
    const int64_t m = sums->shared, first = sums->own - SWELLING;
    for (int64_t s = 0; s < b->count; s++) {
        /* Those that do not count may be beyond all measure. */
        if (!(weights[s] > 0)) continue;
        const int64_t pose = b->at[s], landmark = b->of[s], camera = sums->camera ? sums->camera[s] : 0;
        double raw[64], block[64], M[9], shifts[64] = {0}, G[64], whole[64] = {0}, pulls[64] = {0}, X[64] = {0};
        errors_of(b, s, 1, raw, M);
        times8(b->whitener + 64 * s, raw, block);
        outward_of(b, s, shifts, WIDE);
        times8(b->whitener + 64 * s, shifts, G);
        for (int i = 0; i < 64; i++) {
            shifts[i] = G[i];
            G[i] *= weights[s];
        }
        add_transposed8(block, G, pulls); /* rows: pose and error; columns: the swelling */
        add_transposed8(shifts, G, whole);
        double *B = sums->border + 6 * sums->own * pose + first;
        for (int i = 0; i < 6; i++)
            for (int k = 0; k < SWELLING; k++) B[sums->own * i + k] += pulls[WIDE * i + k];
        for (int k = 0; k < SWELLING; k++) {
            for (int j = 0; j < SWELLING; j++) sums->corner[m * (first + k) + first + j] += whole[WIDE * k + j];
            sums->shared_gradient[first + k] += pulls[WIDE * 6 + k];
        }
        if (sums->place) {
            const double *center = b->p_landmark + 3 * landmark, *p = b->p + 3 * pose;
            const double d[3] = {center[0] - p[0], center[1] - p[1], center[2] - p[2]};
            by_landmark(d, pulls, X);
            add_both(sums->corner, m, sums->own + 6 * landmark, first, X);
        }
        if (camera) {
            into_camera(M, pulls, WIDE, SWELLING, X);
            add_both(sums->corner, m, sums->cameras + 6 * (camera - 1), first, X);
        }
    }
    return 0;
}
