/* The whitened block of one observation at a pose, for kernels that sum over observations. */
#ifndef LMKIT_OBSERVATION_H
#define LMKIT_OBSERVATION_H

#include <stddef.h>

#include "pose_fit.h"

/* The whitened block of an observation, and that of its landmark's error if the landmark is uncertain (else null). 
 * Not inlined: inlined, it takes three times as long (GCC 12, blocks pass through memory in pieces). */
static __attribute__((noinline)) void observation(const Corners *seen, int64_t s, const double *R, const double *p,
                                                  int derivatives, double *block, double *moved) {
    double M[9], raw[64], raw_moved[64];
    map_to_camera(seen->R_camera + 9 * s, R, M);
    for (int i = 0; i < 64; i++) raw[i] = 0;
    corner_errors(seen->points + 12 * s, moved ? seen->arms + 12 * s : NULL, M, seen->t_camera + 3 * s, p,
                  seen->rays + 8 * s, seen->nearest, seen->nowhere, derivatives, raw, moved ? raw_moved : NULL);
    times8(seen->whitener + 64 * s, raw, block);
    if (!moved) return;
    double whitened[64], root[64] = {0};
    times8(seen->whitener + 64 * s, raw_moved, whitened);
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) root[WIDE * i + j] = seen->roots[36 * s + 6 * i + j];
    times8(whitened, root, moved);
}

static void identity(double *A) {
    for (int i = 0; i < 64; i++) A[i] = i % 9 == 0;
}

#endif
