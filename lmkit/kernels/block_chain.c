/* Block tridiagonal matrices: Cholesky factor, substitution, the shared columns that a piece of a chain touches, and
 * sums into rows and columns of a large matrix.  block_chain.py holds the definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_subtract_piece(int64_t size, int64_t inner, int64_t wide, int64_t count, const int64_t *columns,
                                      const double *product, double *diagonal, double *following, double *gradient,
                                      double *border, double *corner, double *shared_gradient);
LMKIT_EXPORT int lmkit_factor_chain(int64_t count, int64_t size, const double *diagonal, const double *following,
                                    double *factor);
LMKIT_EXPORT int lmkit_forward_chain(int64_t count, int64_t size, const double *factor, int64_t wide, double *right);
LMKIT_EXPORT int lmkit_backward_chain(int64_t count, int64_t size, const double *factor, int64_t wide, double *right);
LMKIT_EXPORT int lmkit_used_columns(int64_t rows, int64_t wide, const double *matrix, uint8_t *used);
LMKIT_EXPORT int lmkit_take_columns(int64_t rows, int64_t wide, const double *matrix, int64_t count,
                                    const int64_t *columns, int64_t stride, double *taken);
LMKIT_EXPORT int lmkit_put_blocks(int64_t count, int64_t size, int64_t wide, const double *values,
                                  const int64_t *states, const int64_t *places, int64_t stride, double *into);

int lmkit_subtract_piece(int64_t size, int64_t inner, int64_t wide, int64_t count, const int64_t *restrict columns,
                         const double *restrict product, double *restrict diagonal, double *restrict following,
                         double *restrict gradient, double *restrict border, double *restrict corner,
                         double *restrict shared_gradient) {
    const int64_t stride = inner + count + 1;
    for (int64_t row = 0; row < inner; row++) {
        const double *from = product + stride * row;
        const int64_t first = row - row % size;
        for (int64_t j = 0; j < size; j++) diagonal[size * row + j] -= from[first + j];
        if (first + size < inner)
            for (int64_t j = 0; j < size; j++) following[size * row + j] -= from[first + size + j];
        for (int64_t j = 0; j < count; j++) border[wide * row + columns[j]] -= from[inner + j];
        gradient[row] -= from[inner + count];
    }
    for (int64_t i = 0; i < count; i++) {
        double *row = corner + wide * columns[i];
        const double *from = product + stride * (inner + i) + inner;
        for (int64_t j = 0; j < count; j++) row[columns[j]] -= from[j];
        shared_gradient[columns[i]] -= from[count];
    }
    return 0;
}

/* Row i of the factor has 2 size numbers; it is stored from the first column of the previous block on. */
int lmkit_factor_chain(int64_t count, int64_t size, const double *restrict diagonal, const double *restrict following,
                       double *restrict factor) {
    const int64_t band = 2 * size;
    for (int64_t block = 0; block < count; block++) {
        for (int64_t i = 0; i < size; i++) {
            double *row = factor + band * (size * block + i);
            for (int64_t j = 0; j < band; j++) row[j] = 0;
            for (int64_t j = block ? 0 : size; j <= size + i; j++) {
                /* Columns below size belong to the previous block, whose rows start a block earlier. */
                const int before = j < size;
                const double *other = factor + band * (size * (block - before) + (before ? j : j - size));
                double sum = before ? following[size * (size * (block - 1) + j) + i]
                                    : diagonal[size * (size * block + i) + j - size];
                if (before)
                    for (int64_t k = 0; k < j; k++) sum -= row[k] * other[size + k];
                else
                    for (int64_t k = 0; k < j; k++) sum -= row[k] * other[k];
                if (j < size + i) {
                    row[j] = sum / other[before ? size + j : j];
                } else {
                    if (!(sum > 0)) return 1;
                    row[j] = sqrt(sum);
                }
            }
        }
    }
    return 0;
}

int lmkit_forward_chain(int64_t count, int64_t size, const double *restrict factor, int64_t wide,
                        double *restrict right) {
    const int64_t band = 2 * size;
    for (int64_t row = 0; row < size * count; row++) {
        const double *L = factor + band * row;
        const int64_t block = row / size, own = size + row % size, first = size * (block - 1);
        double *into = right + wide * row;
        /* Two rows at a time: half the loads and stores of the row that is written. */
        int64_t k = block ? 0 : size;
        for (; k + 1 < own; k += 2) {
            const double a = L[k], b = L[k + 1], *x = right + wide * (first + k), *y = x + wide;
            for (int64_t j = 0; j < wide; j++) into[j] -= a * x[j] + b * y[j];
        }
        if (k < own) {
            const double a = L[k], *x = right + wide * (first + k);
            for (int64_t j = 0; j < wide; j++) into[j] -= a * x[j];
        }
        const double inverse = 1 / L[own];
        for (int64_t j = 0; j < wide; j++) into[j] *= inverse;
    }
    return 0;
}

int lmkit_backward_chain(int64_t count, int64_t size, const double *restrict factor, int64_t wide,
                         double *restrict right) {
    const int64_t band = 2 * size;
    for (int64_t row = size * count - 1; row >= 0; row--) {
        const double *L = factor + band * row;
        const int64_t block = row / size, own = size + row % size, first = size * (block - 1);
        double *done = right + wide * row;
        for (int64_t j = 0; j < wide; j++) done[j] /= L[own];
        for (int64_t k = block ? 0 : size; k < own; k++) {
            double *into = right + wide * (first + k);
            for (int64_t j = 0; j < wide; j++) into[j] -= L[k] * done[j];
        }
    }
    return 0;
}

int lmkit_used_columns(int64_t rows, int64_t wide, const double *restrict matrix, uint8_t *restrict used) {
    for (int64_t j = 0; j < wide; j++) used[j] = 0;
    for (int64_t i = 0; i < rows; i++)
        for (int64_t j = 0; j < wide; j++) used[j] |= matrix[wide * i + j] != 0;
    return 0;
}

int lmkit_take_columns(int64_t rows, int64_t wide, const double *restrict matrix, int64_t count,
                       const int64_t *restrict columns, int64_t stride, double *restrict taken) {
    for (int64_t i = 0; i < rows; i++)
        for (int64_t j = 0; j < count; j++) taken[stride * i + j] = matrix[wide * i + columns[j]];
    return 0;
}

int lmkit_put_blocks(int64_t count, int64_t size, int64_t wide, const double *restrict values,
                     const int64_t *restrict states, const int64_t *restrict places, int64_t stride,
                     double *restrict into) {
    for (int64_t b = 0; b < count; b++)
        for (int64_t i = 0; i < size; i++) {
            const double *from = values + wide * (size * b + i);
            double *to = into + stride * (size * states[b] + i) + wide * places[b];
            for (int64_t j = 0; j < wide; j++) to[j] = from[j];
        }
    return 0;
}
