/* Whitened reprojection errors of a landmark's four corners, in normalised rays, with derivatives.
 * reprojection.py holds the definition. */
#include <math.h>
#include <stddef.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_reprojection(int64_t poses, int64_t sightings, const double *points, const double *arms,
                                    const double *R_camera, const double *t_camera, const double *rays,
                                    const double *whitener, const double *R, const double *p, double nearest,
                                    double nowhere, double *residuals, double *by_pose, double *by_landmark);

/* out (8,6) = W (8,8) J (8,6). */
static void whiten6(const double *W, const double *J, double *out) {
    for (int i = 0; i < 8; i++) {
        double row[6] = {0, 0, 0, 0, 0, 0};
        for (int k = 0; k < 8; k++) {
            const double w = W[8 * i + k];
            for (int j = 0; j < 6; j++) row[j] += w * J[6 * k + j];
        }
        for (int j = 0; j < 6; j++) out[6 * i + j] = row[j];
    }
}

/* Row of a Jacobian: sign * g, and -sign * (g x arm) for a turn about the map's axes. */
static void pose_row(const double *g, const double *arm, double sign, double *row) {
    for (int j = 0; j < 3; j++) row[j] = sign * g[j];
    row[3] = -sign * (g[1] * arm[2] - g[2] * arm[1]);
    row[4] = -sign * (g[2] * arm[0] - g[0] * arm[2]);
    row[5] = -sign * (g[0] * arm[1] - g[1] * arm[0]);
}

int lmkit_reprojection(int64_t poses, int64_t sightings, const double *restrict points, const double *restrict arms,
                       const double *restrict R_camera, const double *restrict t_camera,
                       const double *restrict rays, const double *restrict whitener, const double *restrict R,
                       const double *restrict p, double nearest, double nowhere, double *restrict residuals,
                       double *restrict by_pose, double *restrict by_landmark) {
    for (int64_t h = 0; h < poses; h++) {
        const double *Rh = R + 9 * h, *ph = p + 3 * h;
        for (int64_t s = 0; s < sightings; s++) {
            const double *E = R_camera + 9 * s, *t = t_camera + 3 * s, *W = whitener + 64 * s;
            double M[9]; /* from the map into this camera: E R^T */
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    M[3 * i + j] = E[3 * i] * Rh[3 * j] + E[3 * i + 1] * Rh[3 * j + 1] + E[3 * i + 2] * Rh[3 * j + 2];
            double error[8], J[48], K[48];
            int behind = 0;
            for (int c = 0; c < 4; c++) {
                const double *X = points + 12 * s + 3 * c, *seen = rays + 8 * s + 2 * c;
                const double o[3] = {X[0] - ph[0], X[1] - ph[1], X[2] - ph[2]};
                const double x = M[0] * o[0] + M[1] * o[1] + M[2] * o[2] + t[0];
                const double y = M[3] * o[0] + M[4] * o[1] + M[5] * o[2] + t[1];
                const double z = M[6] * o[0] + M[7] * o[1] + M[8] * o[2] + t[2];
                const double depth = z > nearest ? z : nearest;
                const double u = x / depth, v = y / depth;
                behind |= z < nearest;
                error[2 * c] = seen[0] - u;
                error[2 * c + 1] = seen[1] - v;
                if (!by_pose && !by_landmark) continue;
                double gu[3], gv[3];
                for (int j = 0; j < 3; j++) {
                    gu[j] = (M[j] - u * M[6 + j]) / depth;
                    gv[j] = (M[3 + j] - v * M[6 + j]) / depth;
                }
                pose_row(gu, o, -1, J + 12 * c);
                pose_row(gv, o, -1, J + 12 * c + 6);
                if (!by_landmark) continue;
                pose_row(gu, arms + 12 * s + 3 * c, 1, K + 12 * c);
                pose_row(gv, arms + 12 * s + 3 * c, 1, K + 12 * c + 6);
            }
            if (behind)
                for (int i = 0; i < 8; i++) error[i] = nowhere;
            const int64_t at = h * sightings + s;
            for (int i = 0; i < 8; i++) {
                double sum = 0;
                for (int k = 0; k < 8; k++) sum += W[8 * i + k] * error[k];
                residuals[8 * at + i] = sum;
            }
            if (by_pose) whiten6(W, J, by_pose + 48 * at);
            if (by_landmark) whiten6(W, K, by_landmark + 48 * at);
        }
    }
    return 0;
}
