/* Small dense linear algebra in double precision: Cholesky factors in lower triangles, row-major. */
#ifndef LMKIT_LINEAR_H
#define LMKIT_LINEAR_H

#include <math.h>

/* Factor of a symmetric matrix, in place; 0 unless positive definite. */
static inline int factor(double *A, int n)
{
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < j; k++)
            for (int i = j; i < n; i++)
                A[i * n + j] -= A[i * n + k] * A[j * n + k];
        double d = A[j * n + j];
        if (!(d > 0.0))
            return 0;
        d = 1.0 / sqrt(d);
        for (int i = j; i < n; i++)
            A[i * n + j] *= d;
    }
    return 1;
}

static inline void solve_lower(const double *L, int n, double *b)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= L[i * n + k] * b[k];
        b[i] /= L[i * n + i];
    }
}

static inline void solve_upper(const double *L, int n, double *b)
{
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++)
            b[i] -= L[k * n + i] * b[k];
        b[i] /= L[i * n + i];
    }
}

#endif
