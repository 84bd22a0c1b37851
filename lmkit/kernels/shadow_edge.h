/* A straight edge between two lights; shadow_edge.py holds the definition. */
#ifndef LMKIT_SHADOW_EDGE_H
#define LMKIT_SHADOW_EDGE_H

#include "kernels.h"

/* at (n,2) positions; values and weights (n).  normals (D,2) directions.  room: 2 doubles for every bin and 3 for every
 * position.  edge (4): number of the direction across which the means of the values differ most for their number (Otsu
 * 1979), places counted in bins; then, to the position, how far along it the edge is, and the means before and behind.
 * Returns 1 for fewer than two positions. */
LMKIT_EXPORT int lmkit_shadow_edge(int64_t n, const double *at, const double *values, const double *weights,
                                   int64_t directions, const double *normals, int64_t bins, double *room,
                                   double *edge);

#endif
