/* Observations and poses of a recording, and how equations of landmarks and cameras follow from those of a pose. */
#ifndef LMKIT_LANDMARK_BUNDLE_H
#define LMKIT_LANDMARK_BUNDLE_H

#include <stdint.h>

#include "reprojection.h"

/* Observations and poses; the fields are those of `Bundle` in landmark_bundle.py. */
typedef struct {
    int64_t count;
    const int64_t *at, *of, *mount;
    const double *rays, *by_ray, *whitener, *R_camera, *t_camera;
    const double *R, *p, *R_landmark, *p_landmark, *arms;
    double nearest, nowhere;
} Bundle;

/* Sums that are added to; the fields are those of `Sums` in landmark_bundle.py. */
typedef struct {
    int64_t shared, own, cameras;
    const int64_t *place, *camera;
    double *diagonal, *gradient, *border, *blocks, *corner, *shared_gradient;
} Sums;

/* Errors of rays of one observation, derivatives with the rig, and R_camera_map (3,3). */
static void errors_of(const Bundle *b, int64_t s, int derivatives, double *block, double *M) {
    const int64_t pose = b->at[s], landmark = b->of[s], mount = b->mount[s];
    const double *L = b->R_landmark + 9 * landmark, *center = b->p_landmark + 3 * landmark;
    double arms[12], points[12];
    for (int c = 0; c < 4; c++) {
        const double *arm = b->arms + 12 * landmark + 3 * c;
        for (int i = 0; i < 3; i++) {
            arms[3 * c + i] = L[3 * i] * arm[0] + L[3 * i + 1] * arm[1] + L[3 * i + 2] * arm[2];
            points[3 * c + i] = center[i] + arms[3 * c + i];
        }
    }
    map_to_camera(b->R_camera + 9 * mount, b->R + 9 * pose, M);
    corner_errors(points, arms, M, b->t_camera + 3 * mount, b->p + 3 * pose, b->rays + 8 * s, b->nearest, b->nowhere,
                  derivatives, block, NULL);
}

/* X (6,columns) = blockdiag(-R, -R) A, rows of A and X `wide` numbers long: from axes of the map to those of a
 * camera. */
static void into_camera(const double *R, const double *A, int wide, int columns, double *X) {
    for (int half = 0; half < 6; half += 3)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < columns; j++)
                X[wide * (half + i) + j] = -(R[3 * i] * A[wide * half + j] + R[3 * i + 1] * A[wide * (half + 1) + j] +
                                             R[3 * i + 2] * A[wide * (half + 2) + j]);
}

/* X (3,WIDE) = A x d, column by column: the shift that turns a rotation about the rig into one about the center, `d`
 * from it. */
static void cross_rows(const double *d, const double *A, double *X) {
    for (int j = 0; j < WIDE; j++) {
        const double a = A[j], b = A[WIDE + j], c = A[2 * WIDE + j];
        X[j] = b * d[2] - c * d[1];
        X[WIDE + j] = c * d[0] - a * d[2];
        X[2 * WIDE + j] = a * d[1] - b * d[0];
    }
}

/* Rows of a landmark from those of the pose: a landmark shifts the other way, and rotates about its own center. */
static void by_landmark(const double *d, const double *A, double *X) {
    double turned[3 * WIDE];
    cross_rows(d, A, turned);
    for (int i = 0; i < 3 * WIDE; i++) {
        X[i] = -A[i];
        X[3 * WIDE + i] = -A[3 * WIDE + i] - turned[i];
    }
}

#endif
