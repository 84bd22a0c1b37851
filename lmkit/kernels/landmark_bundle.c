/* Normal equations of rig poses and landmark poses from all observations of a recording (bundle adjustment).
 * landmark_bundle.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "reprojection.h"

/* Observations and where everything stands; the fields are those of `Bundle` in landmark_bundle.py. */
typedef struct {
    int64_t count;
    const int64_t *at, *of;
    const double *rays, *by_ray, *whitener, *R_camera, *t_camera;
    const double *R, *p, *R_landmark, *p_landmark, *arms;
    double nearest, nowhere;
} Bundle;

LMKIT_EXPORT int lmkit_bundle_chi2(const Bundle *bundle, double *chi2, double *pixels);
LMKIT_EXPORT int lmkit_bundle_equations(const Bundle *bundle, const uint8_t *used, double cauchy, int64_t own,
                                        int64_t shared, double *diagonal, double *gradient, double *border,
                                        double *corner, double *shared_gradient, double *cost);

/* Errors of rays of one observation, and derivatives with the rig and the landmark. */
static void errors_of(const Bundle *b, int64_t s, int derivatives, double *block, double *moved) {
    const int64_t pose = b->at[s], landmark = b->of[s];
    const double *L = b->R_landmark + 9 * landmark, *center = b->p_landmark + 3 * landmark;
    double M[9], arms[12], points[12];
    for (int c = 0; c < 4; c++) {
        const double *arm = b->arms + 12 * landmark + 3 * c;
        for (int i = 0; i < 3; i++) {
            arms[3 * c + i] = L[3 * i] * arm[0] + L[3 * i + 1] * arm[1] + L[3 * i + 2] * arm[2];
            points[3 * c + i] = center[i] + arms[3 * c + i];
        }
    }
    map_to_camera(b->R_camera + 9 * s, b->R + 9 * pose, M);
    corner_errors(points, arms, M, b->t_camera + 3 * s, b->p + 3 * pose, b->rays + 8 * s, b->nearest, b->nowhere,
                  derivatives, block, moved);
}

int lmkit_bundle_chi2(const Bundle *b, double *chi2, double *pixels) {
    for (int64_t s = 0; s < b->count; s++) {
        double block[64];
        const double *W = b->whitener + 64 * s;
        errors_of(b, s, 0, block, NULL);
        double squared = 0, off = 0;
        for (int i = 0; i < 8; i++) {
            double sum = 0;
            for (int k = 0; k < 8; k++) sum += W[8 * i + k] * block[WIDE * k + 6];
            squared += sum * sum;
        }
        for (int c = 0; c < 4; c++) {
            const double *B = b->by_ray + 16 * s + 4 * c;
            const double du = block[2 * WIDE * c + 6], dv = block[2 * WIDE * c + WIDE + 6];
            const double x = B[0] * du + B[1] * dv, y = B[2] * du + B[3] * dv;
            off += x * x + y * y;
        }
        chi2[s] = squared;
        pixels[s] = off;
    }
    return 0;
}

int lmkit_bundle_equations(const Bundle *b, const uint8_t *used, double cauchy, int64_t own, int64_t shared,
                           double *diagonal, double *gradient, double *border, double *corner,
                           double *shared_gradient, double *cost) {
    double total = 0;
    for (int64_t s = 0; s < b->count; s++) {
        if (!used[s]) continue;
        double raw[64], raw_moved[64], block[64], moved[64], A[64] = {0};
        errors_of(b, s, 1, raw, border ? raw_moved : NULL);
        times8(b->whitener + 64 * s, raw, block);
        double squared = 0;
        for (int i = 0; i < 8; i++) squared += block[WIDE * i + 6] * block[WIDE * i + 6];
        squared /= 8 * cauchy * cauchy;
        total += log1p(squared);
        const double weight = 1 / (1 + squared);
        double weighted[64];
        for (int i = 0; i < 64; i++) weighted[i] = weight * block[i];
        add_transposed8(block, weighted, A);
        double *D = diagonal + 36 * b->at[s], *g = gradient + 6 * b->at[s];
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 6; j++) D[6 * i + j] += A[WIDE * i + j];
            g[i] += A[WIDE * i + 6];
        }
        if (!border) continue;
        times8(b->whitener + 64 * s, raw_moved, moved);
        double across[64] = {0}, inner[64] = {0};
        add_transposed8(weighted, moved, across); /* rows: pose and error; columns: landmark */
        for (int i = 0; i < 64; i++) weighted[i] = weight * moved[i];
        add_transposed8(moved, weighted, inner);
        const int64_t column = own + 6 * b->of[s];
        double *B = border + 6 * shared * b->at[s] + column, *C = corner + shared * column + column;
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 6; j++) {
                B[shared * i + j] += across[WIDE * i + j];
                C[shared * i + j] += inner[WIDE * i + j];
            }
            shared_gradient[column + i] += across[WIDE * 6 + i];
        }
    }
    *cost = 8 * cauchy * cauchy * total;
    return 0;
}
