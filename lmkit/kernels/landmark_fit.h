/* Kernels that the fit of one landmark calls; their own files describe the arguments. */
#ifndef LMKIT_LANDMARK_FIT_H
#define LMKIT_LANDMARK_FIT_H

#include "kernels.h"
#include "pattern.h"

LMKIT_EXPORT int lmkit_sample_pixels(int64_t height, int64_t width, const uint8_t *image, const float *linear,
                                     const float *white, const float *shift, const double *view,
                                     const double *state, const int64_t *box, const float *edges,
                                     int64_t squares, int64_t circles, const double *rules, uint8_t *kinds,
                                     int64_t capacity, float *out_at, float *values, float *light,
                                     float *variance, float *cells, float *scratch, int64_t *count);

LMKIT_EXPORT int lmkit_decode(int64_t n, const float *drawing, const double *view, const float *at,
                              const float *values, const float *variance, const double *state,
                              const int32_t *masks, int64_t codes, const double *rules, float *columns,
                              double *subsets, double *out);

/* A decoding may skip the parts and the occlusion, or reuse the columns of the previous one. */
#define PARTS 1
#define SAME_COLUMNS 2

/* Products of the columns at a state (15), with each other, (C,C), and with what is seen, (C,3), and of what is seen. */
typedef struct {
    double gram[MAX_COLUMNS * MAX_COLUMNS], seen[MAX_COLUMNS * 3], square[9];
} Moments;

void moments_of_pixels(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                       const float *variance, const double *state, int wanted, float *columns, Moments *out);

int decode_pixels(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                  const float *variance, const double *state, const int32_t *masks, int64_t codes,
                  const double *rules, int wanted, float *columns, double *subsets, double *out);

/* normal: null where nothing needs the slopes of the last state, whose error alone takes a quarter of the time. */
LMKIT_EXPORT int lmkit_register(int64_t n, const float *drawing, const double *view, const float *at,
                                const float *values, const float *variance, const double *rules,
                                const double *limits, int64_t open_gaps, int64_t quarter, int64_t fit_distortion,
                                int64_t rounds, int64_t iterations, double to_px, const float *cells,
                                const double *mosaic, float *scratch, double *state,
                                float *robust_variance, double *prior_weight, double *normal, double *error);

LMKIT_EXPORT int lmkit_robust_weights(int64_t n, const float *drawing, const double *view, const float *at,
                                      const float *values, const float *variance, const double *rules,
                                      const double *state, int64_t open_gaps, int64_t quarter, float *scratch,
                                      float *drawn, float *robust_variance, double *prior_weight);

#endif
