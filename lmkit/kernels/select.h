/* Order statistics in place. */
#ifndef LMKIT_SELECT_H
#define LMKIT_SELECT_H

#include <stdint.h>

/* The k-th smallest of n values, which it reorders: all before position k are no larger (Hoare 1961). */
static inline float nth_smallest(float *v, int64_t n, int64_t k)
{
    int64_t low = 0, high = n - 1;
    while (low < high) {
        int64_t i = low, j = high, mid = low + (high - low) / 2;
        float pivot = v[mid];
        while (i <= j) {
            while (v[i] < pivot)
                i++;
            while (pivot < v[j])
                j--;
            if (i <= j) {
                float t = v[i];
                v[i++] = v[j];
                v[j--] = t;
            }
        }
        if (k <= j)
            high = j;
        else if (k >= i)
            low = i;
        else
            break;
    }
    return v[k];
}

/* Mean of the two values around fraction q of n values, as numpy's percentile interpolates; reorders them. */
static inline double quantile(float *v, int64_t n, double q)
{
    double at = q * (double)(n - 1);
    int64_t k = (int64_t)at;
    double low = (double)nth_smallest(v, n, k), rest = at - (double)k;
    if (k + 1 >= n || rest == 0.0)
        return low;
    float high = v[k + 1];
    for (int64_t i = k + 2; i < n; i++)
        high = v[i] < high ? v[i] : high;
    return low + rest * ((double)high - low);
}

static inline double median(float *v, int64_t n)
{
    return quantile(v, n, 0.5);
}

#endif
