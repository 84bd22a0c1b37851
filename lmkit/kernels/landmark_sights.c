/* Landmarks in the images of a camera at many poses: sides in pixels, and the Fisher information of their corners. 
 * landmark_sights.py holds the definition. */
#include "kernels.h"
#include "lens.h"
#include "reprojection.h"

/* A camera of the rig; the fields are those of `Camera` in landmark_sights.py. */
typedef struct {
    const Lens *lens;
    double R[9], t[3], width, height, edge, nearest;
} Camera;

LMKIT_EXPORT int lmkit_faced_landmarks(int64_t poses, int64_t landmarks, const double *R, const double *p,
                                       const double *centers, const double *normals, const double *reach,
                                       double steepest, double nearest, double widest, uint8_t *faced);
LMKIT_EXPORT int lmkit_seen_sides(const Camera *camera, int64_t count, const int64_t *at, const int64_t *of,
                                  const double *R, const double *p, const double *corners, double *sides);
LMKIT_EXPORT int lmkit_add_information(const Camera *camera, int64_t count, const int64_t *at, const int64_t *of,
                                       const double *R, const double *p, const double *corners,
                                       const double *weights, double *information);

int lmkit_faced_landmarks(int64_t poses, int64_t landmarks, const double *R, const double *p, const double *centers,
                          const double *normals, const double *reach, double steepest, double nearest, double widest,
                          uint8_t *faced) {
    for (int64_t h = 0; h < poses; h++) {
        const double *Rh = R + 9 * h, *ph = p + 3 * h;
        for (int64_t k = 0; k < landmarks; k++) {
            const double *c = centers + 3 * k, *n = normals + 3 * k;
            const double x = c[0] - ph[0], y = c[1] - ph[1], z = c[2] - ph[2];
            const double distance = sqrt(x * x + y * y + z * z);
            const double facing = -(x * n[0] + y * n[1] + z * n[2]) / fmax(distance, 1e-9);
            const double ahead = x * Rh[2] + y * Rh[5] + z * Rh[8], aside = x * Rh[0] + y * Rh[3] + z * Rh[6];
            faced[h * landmarks + k] = (distance < reach[k]) & (facing > steepest) & (ahead > nearest) &
                                       (fabs(aside) < widest * ahead);
        }
    }
    return 0;
}

/* Pixels of the four corners, and derivatives with points in the camera; 0 where not all are in the image. */
static int corners_in_image(const Camera *camera, const double *M, const double *p, const double *corners,
                            double *pixels, double *by_point) {
    const Lens *lens = camera->lens;
    const double wide = camera->edge * camera->width / lens->fx, high = camera->edge * camera->height / lens->fy;
    for (int c = 0; c < 4; c++) {
        const double o[3] = {corners[3 * c] - p[0], corners[3 * c + 1] - p[1], corners[3 * c + 2] - p[2]};
        const double x = M[0] * o[0] + M[1] * o[1] + M[2] * o[2] + camera->t[0];
        const double y = M[3] * o[0] + M[4] * o[1] + M[5] * o[2] + camera->t[1];
        const double z = M[6] * o[0] + M[7] * o[1] + M[8] * o[2] + camera->t[2];
        if (!(z > camera->nearest && fabs(x) < wide * z && fabs(y) < high * z)) return 0;
        double J[4];
        const double u = x / z, v = y / z;
        project_ray(lens, u, v, pixels + 2 * c, J);
        for (int i = 0; i < 2; i++) {
            const double size = i ? camera->height : camera->width;
            if (!(pixels[2 * c + i] > -0.5 && pixels[2 * c + i] < size - 0.5)) return 0;
            double *g = by_point + 6 * c + 3 * i;
            g[0] = J[2 * i] / z;
            g[1] = J[2 * i + 1] / z;
            g[2] = -(J[2 * i] * u + J[2 * i + 1] * v) / z;
        }
    }
    return 1;
}

int lmkit_seen_sides(const Camera *camera, int64_t count, const int64_t *at, const int64_t *of, const double *R,
                     const double *p, const double *corners, double *sides) {
    for (int64_t n = 0; n < count; n++) {
        double M[9], pixels[8], by_point[24], sum = 0;
        map_to_camera(camera->R, R + 9 * at[n], M);
        if (corners_in_image(camera, M, p + 3 * at[n], corners + 12 * of[n], pixels, by_point)) {
            for (int c = 0; c < 4; c++) {
                const int d = (c + 3) % 4;
                const double x = pixels[2 * c] - pixels[2 * d], y = pixels[2 * c + 1] - pixels[2 * d + 1];
                sum += sqrt(x * x + y * y);
            }
        }
        sides[n] = sum / 4;
    }
    return 0;
}

int lmkit_add_information(const Camera *camera, int64_t count, const int64_t *at, const int64_t *of, const double *R,
                          const double *p, const double *corners, const double *weights, double *information) {
    for (int64_t n = 0; n < count; n++) {
        double M[9], pixels[8], by_point[24], block[64] = {0}, total[64] = {0};
        const double *ph = p + 3 * at[n], *X = corners + 12 * of[n];
        map_to_camera(camera->R, R + 9 * at[n], M);
        if (!(weights[n] > 0) || !corners_in_image(camera, M, ph, X, pixels, by_point)) continue;
        for (int i = 0; i < 8; i++) {
            const double *b = by_point + 3 * i, *corner = X + 3 * (i / 2);
            const double o[3] = {corner[0] - ph[0], corner[1] - ph[1], corner[2] - ph[2]};
            double g[3];
            for (int j = 0; j < 3; j++) g[j] = b[0] * M[j] + b[1] * M[3 + j] + b[2] * M[6 + j];
            derivative_row(g, o, -1, block + WIDE * i);
        }
        add_transposed8(block, block, total);
        for (int i = 0; i < 6; i++)
            for (int j = 0; j < 6; j++) information[36 * n + 6 * i + j] += weights[n] * total[WIDE * i + j];
    }
    return 0;
}
