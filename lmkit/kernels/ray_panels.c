/* Intersections of an image's rays with a textured panel, and the texture's values there; single precision, each
 * operation rounded as in numpy, so that a seed gives the same image on every machine.  ray_panels.py holds the
 * definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_meet_panel(int64_t rows, int64_t columns, int64_t stride, const float *rays, const float *depth,
                                  const float *R, const float *eye, float bend, float width,
                                  float half_width, float half_height, float *u, float *v, float *distance,
                                  uint8_t *hit);
LMKIT_EXPORT int lmkit_paint_panel(int64_t rows, int64_t columns, int64_t stride, const uint8_t *hit,
                                   const float *color, const float *distance, float *image, float *depth);
LMKIT_EXPORT int lmkit_box_mean(int64_t rows, int64_t columns, int64_t size, const float *image, float *mean);

int lmkit_meet_panel(int64_t rows, int64_t columns, int64_t stride, const float *restrict rays,
                     const float *restrict depth, const float *restrict R, const float *restrict eye, float bend,
                     float width, float half_width, float half_height, float *restrict u,
                     float *restrict v, float *restrict distance, uint8_t *restrict hit) {
    for (int64_t row = 0; row < rows; row++) {
        const float *ray = rays + 2 * stride * row, *behind = depth + stride * row;
        for (int64_t k = 0; k < columns; k++) {
            const int64_t at = columns * row + k;
            const float x = ray[2 * k], y = ray[2 * k + 1];
            const float dx = R[0] * x + R[3] * y + R[6], dy = R[1] * x + R[4] * y + R[7];
            const float dz = R[2] * x + R[5] * y + R[8];
            float far = (0.0f - eye[2]) / dz, across = eye[0] + far * dx;
            for (int step = 0; step < (bend != 0.0f ? 3 : 0); step++) {
                const float share = 2.0f * across / width;
                float lift = 1.0f - share * share;
                lift = lift < -1.0f ? -1.0f : lift > 1.0f ? 1.0f : lift;
                far = (bend * lift - eye[2]) / dz;
                across = eye[0] + far * dx;
            }
            const float down = eye[1] + far * dy;
            u[at] = across;
            v[at] = down;
            distance[at] = far;
            hit[at] = (far > 0.05f) & (far < behind[k]) & (fabsf(across) < half_width) & (fabsf(down) < half_height);
        }
    }
    return 0;
}

int lmkit_paint_panel(int64_t rows, int64_t columns, int64_t stride, const uint8_t *hit, const float *color,
                      const float *distance, float *image, float *depth) {
    for (int64_t row = 0; row < rows; row++)
        for (int64_t k = 0; k < columns; k++) {
            const int64_t from = columns * row + k, to = stride * row + k;
            if (!hit[from]) continue;
            for (int c = 0; c < 3; c++) image[3 * to + c] = color[3 * from + c];
            depth[to] = distance[from];
        }
    return 0;
}

int lmkit_box_mean(int64_t rows, int64_t columns, int64_t size, const float *restrict image, float *restrict mean) {
    const float count = (float)(size * size);
    for (int64_t row = 0; row < rows; row++)
        for (int64_t k = 0; k < columns; k++) {
            float sum[3] = {0, 0, 0};
            for (int64_t i = 0; i < size; i++) {
                const float *from = image + 3 * (size * columns * (size * row + i) + size * k);
                for (int64_t j = 0; j < size; j++)
                    for (int c = 0; c < 3; c++) sum[c] += from[3 * j + c];
            }
            for (int c = 0; c < 3; c++) mean[3 * (columns * row + k) + c] = sum[c] / count;
        }
    return 0;
}
