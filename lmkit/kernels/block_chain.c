/* Sums of small matrices into the rows and columns of a large one.  block_chain.py holds the definition. */
#include "kernels.h"

LMKIT_EXPORT int lmkit_subtract_at(int64_t wide, int64_t count, const int64_t *columns, int64_t stride,
                                   const double *values, double *matrix);

int lmkit_subtract_at(int64_t wide, int64_t count, const int64_t *restrict columns, int64_t stride,
                      const double *restrict values, double *restrict matrix) {
    for (int64_t i = 0; i < count; i++) {
        double *row = matrix + wide * columns[i];
        const double *from = values + stride * i;
        for (int64_t j = 0; j < count; j++) row[columns[j]] -= from[j];
    }
    return 0;
}
