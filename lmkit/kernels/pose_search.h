/* The search for the poses that corners allow: settings, and the kernels of pose_search.c, for kernels that call them. */
#ifndef LMKIT_POSE_SEARCH_H
#define LMKIT_POSE_SEARCH_H

#include "pose_fit.h"

/* Settings; the fields are those of `Search` in pose_search.py. */
typedef struct {
    double gate_share, limit, listed_below, least_trace, same_place_squared, converged, most_damping;
    int64_t towards_near, to_the_end, rounds;
} Search;

LMKIT_EXPORT int lmkit_search_poses(const Corners *seen, const Prior *prior, const Search *search, const int64_t *of,
                                    const double *side_px, double *R, double *p, double *misfits, double *pixels,
                                    double *cost, uint8_t *used, uint8_t *before, int64_t *own, int64_t *rows,
                                    int64_t *found);
LMKIT_EXPORT int lmkit_pose_covariance(const Corners *seen, const Prior *prior, const double *R, const double *p,
                                       const uint8_t *used, double *covariance);

#endif
