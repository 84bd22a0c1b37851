/* Normal equations of rig poses and landmark poses from all observations of a recording (bundle adjustment).
 * landmark_bundle.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "landmark_bundle.h"

LMKIT_EXPORT int lmkit_bundle_chi2(const Bundle *bundle, double *chi2, double *pixels);
LMKIT_EXPORT int lmkit_bundle_equations(const Bundle *bundle, const uint8_t *used, double cauchy, double noise,
                                        const Sums *sums, double *cost);

int lmkit_bundle_chi2(const Bundle *b, double *chi2, double *pixels) {
    for (int64_t s = 0; s < b->count; s++) {
        double block[64], M[9];
        const double *W = b->whitener + 64 * s;
        errors_of(b, s, 0, block, M);
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

/* Normal equations of a camera's place in the rig, from its observations at one pose.  A camera that is moved in the
 * rig sees the same as if the rig were moved the other way, so they follow from A, the sum for the pose (derivatives
 * and error). */
static void add_relation(const Sums *sums, int64_t pose, int64_t camera, const double *R, const double *A) {
    const int64_t m = sums->shared, column = sums->cameras + 6 * (camera - 1);
    double C[64], by_camera[36], own[36];
    into_camera(R, A, WIDE, WIDE, C); /* rows: camera; columns: pose and error */
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) by_camera[6 * j + i] = C[WIDE * i + j];
    into_camera(R, by_camera, 6, 6, own);
    double *B = sums->border + 6 * sums->own * pose + column, *K = sums->corner + m * column + column;
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 6; j++) {
            B[sums->own * i + j] += by_camera[6 * i + j];
            K[m * i + j] += own[6 * i + j];
        }
        sums->shared_gradient[column + i] += C[WIDE * i + 6];
    }
}

/* Normal equations of the landmark of one observation; A is the observation's sum for the pose (derivatives and
 * error). */
static void add_landmark(const Bundle *b, const Sums *sums, int64_t s, int64_t camera, const double *R, const double *A) {
    const double *center = b->p_landmark + 3 * b->of[s], *p = b->p + 3 * b->at[s];
    const double d[3] = {center[0] - p[0], center[1] - p[1], center[2] - p[2]};
    const int64_t m = sums->shared, column = sums->own + 6 * b->of[s];
    double K[64], across[64] = {0}, inner[64] = {0}, seen[64];
    by_landmark(d, A, K); /* rows: landmark; columns: pose and error */
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) across[WIDE * i + j] = K[WIDE * j + i];
    by_landmark(d, across, inner);
    double *B = sums->blocks + 36 * sums->place[s], *C = sums->corner + m * column + column;
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j < 6; j++) {
            B[6 * i + j] += across[WIDE * i + j];
            C[m * i + j] += inner[WIDE * i + j];
        }
        sums->shared_gradient[column + i] += K[WIDE * i + 6];
    }
    if (!camera) return;
    const int64_t row = sums->cameras + 6 * (camera - 1);
    into_camera(R, across, WIDE, 6, seen);
    double *upper = sums->corner + m * row + column, *lower = sums->corner + m * column + row;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) {
            upper[m * i + j] += seen[WIDE * i + j];
            lower[m * j + i] += seen[WIDE * i + j];
        }
}

int lmkit_bundle_equations(const Bundle *b, const uint8_t *used, double cauchy, double noise, const Sums *sums,
                           double *cost) {
    double total = 0;
    for (int64_t s = 0; s < b->count;) {
        /* The observations of one camera of the rig at one pose. */
        const int64_t pose = b->at[s], mount = b->mount[s], camera = sums->camera ? sums->camera[s] : 0;
        double whole[64] = {0}, M[9];
        int any = 0;
        for (; s < b->count && b->at[s] == pose && b->mount[s] == mount; s++) {
            if (sums->camera && sums->camera[s] != camera) break;
            if (!used[s]) continue;
            double raw[64], block[64], weighted[64], A[64] = {0};
            any = 1;
            errors_of(b, s, 1, raw, M);
            times8(b->whitener + 64 * s, raw, block);
            double squared = 0;
            for (int i = 0; i < 8; i++) squared += block[WIDE * i + 6] * block[WIDE * i + 6];
            squared /= 8 * cauchy * cauchy * noise;
            total += log1p(squared);
            const double weight = 1 / ((1 + squared) * noise);
            for (int i = 0; i < 64; i++) weighted[i] = weight * block[i];
            add_transposed8(block, weighted, A);
            for (int i = 0; i < 48; i++) whole[i] += A[i];
            if (sums->place) add_landmark(b, sums, s, camera, M, A);
        }
        if (!any) continue;
        double *D = sums->diagonal + 36 * pose, *g = sums->gradient + 6 * pose;
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 6; j++) D[6 * i + j] += whole[WIDE * i + j];
            g[i] += whole[WIDE * i + 6];
        }
        if (camera) add_relation(sums, pose, camera, M, whole);
    }
    *cost = 8 * cauchy * cauchy * total;
    return 0;
}
