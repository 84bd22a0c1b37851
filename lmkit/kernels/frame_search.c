/* Searches for the poses of many frames in one call.  frame_search.py holds the definition. */
#include <stddef.h>

#include "pose_search.h"

LMKIT_EXPORT int lmkit_search_frames(const Corners *seen, const Search *search, int64_t frames, const int64_t *starts,
                                     const int64_t *of, const double *side_px, int64_t most, double *numbers,
                                     uint8_t *flags, int64_t *slots, double *R, double *p, double *cost, double *chi2,
                                     double *covariance, int64_t *found);

/* The observations of one frame; no landmark is uncertain. */
static Corners of_frame(const Corners *seen, int64_t first, int64_t end) {
    Corners own = *seen;
    own.count = end - first;
    own.points += 12 * first;
    own.R_camera += 9 * first;
    own.t_camera += 3 * first;
    own.rays += 8 * first;
    own.by_ray += 16 * first;
    own.whitener += 64 * first;
    return own;
}

static void copy(double *to, const double *from, int64_t count) {
    for (int64_t i = 0; i < count; i++) to[i] = from[i];
}

/* Memory for a frame with S observations, H = 2 S: `numbers` H (13 + 2 S), `flags` 2 H S, `slots` 2 H. */
int lmkit_search_frames(const Corners *seen, const Search *search, int64_t frames, const int64_t *starts,
                        const int64_t *of, const double *side_px, int64_t most, double *numbers, uint8_t *flags,
                        int64_t *slots, double *R, double *p, double *cost, double *chi2, double *covariance,
                        int64_t *found) {
    for (int64_t f = 0; f < frames; f++) {
        const int64_t first = starts[f];
        const Corners own = of_frame(seen, first, starts[f + 1]);
        const int64_t S = own.count, H = 2 * S;
        double *R_all = numbers, *p_all = R_all + 9 * H, *costs = p_all + 3 * H, *misfits = costs + H;
        int64_t *rows = slots + H;
        lmkit_search_poses(&own, NULL, search, of + first, side_px + first, R_all, p_all, misfits, misfits + H * S,
                           costs, flags, flags + H * S, slots, rows, found + f);
        for (int64_t k = 0; k < found[f] && k < most; k++) {
            copy(R + 9 * (most * f + k), R_all + 9 * rows[k], 9);
            copy(p + 3 * (most * f + k), p_all + 3 * rows[k], 3);
            cost[most * f + k] = costs[rows[k]];
        }
        if (!found[f]) continue;
        int any = 0;
        copy(chi2 + first, misfits + S * rows[0], S);
        for (int64_t s = 0; s < S; s++) any |= flags[s] = chi2[first + s] < search->limit;
        double C[36];
        if (any && !lmkit_pose_covariance(&own, NULL, R + 9 * most * f, p + 3 * most * f, flags, C))
            copy(covariance + 36 * f, C, 36);
    }
    return 0;
}
