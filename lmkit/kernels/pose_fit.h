/* Observed corners, the prior of a pose, and the kernels of reprojection.c, for kernels that call them. */
#ifndef LMKIT_POSE_FIT_H
#define LMKIT_POSE_FIT_H

#include "kernels.h"
#include "reprojection.h"

/* All that does not depend on the pose; the fields are those of `Corners` in reprojection.py. */
typedef struct {
    int64_t count;
    const double *points, *arms, *R_camera, *t_camera, *rays, *by_ray, *whitener;
    const double *roots;          /* null where no landmark is uncertain */
    const int64_t *group, *order; /* which observations share a landmark's error (-1: none), and observations by group */
    double nearest, nowhere;
} Corners;

/* Prior of the pose; NaN where there is none. */
typedef struct {
    double heading, heading_sigma, height, height_sigma, down[3], tilt_sigma;
} Prior;

LMKIT_EXPORT int lmkit_corner_chi2(const Corners *seen, int64_t poses, const double *R, const double *p,
                                      double *misfits, double *pixels);
LMKIT_EXPORT int lmkit_pose_equations(const Corners *seen, const Prior *prior, int64_t poses, const double *R,
                                      const double *p, const uint8_t *used, double *normal, double *gradient,
                                      double *squared);
LMKIT_EXPORT int lmkit_refine_poses(const Corners *seen, const Prior *prior, int64_t poses, const uint8_t *used,
                                    int64_t iterations, double converged, double most_damping, double *R, double *p);

/* Squared error of a pose relative to its prior, in standard deviations. */
double prior_cost(const Prior *prior, const double *R, const double *p);

#endif
