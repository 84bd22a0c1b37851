/* Standard deviation of an image's noise, from its smoothest half (Immerkaer 1996).  noise.py holds the definition. */
#include <stddef.h>
#include <string.h>

#include "kernels.h"

/* rows (R): first rows of bands of three.  histogram (1025): counts of the absolute response in gray, scratch. */
LMKIT_EXPORT int lmkit_noise(int64_t width, const uint8_t *image, int64_t bands, const int64_t *rows, uint16_t *column,
                             int32_t *histogram, int64_t *median);

int lmkit_noise(int64_t width, const uint8_t *image, int64_t bands, const int64_t *rows, uint16_t *column,
                int32_t *histogram, int64_t *median)
{
    const int64_t most = 4096;
    int64_t total = 0, below = 0;
    memset(histogram, 0, (size_t)(most + 1) * sizeof *histogram);
    int16_t *across = (int16_t *)column;
    for (int64_t b = 0; b < bands; b++) {
        const uint8_t *top = image + 3 * width * rows[b], *middle = top + 3 * width, *bottom = middle + 3 * width;
        for (int64_t x = 0; x < width; x++) {
            int sum = 0;
            for (int c = 0; c < 3; c++) {
                int weight = c == 1 ? 2 : 1;
                sum += weight * (top[3 * x + c] - 2 * middle[3 * x + c] + bottom[3 * x + c]);
            }
            across[x] = (int16_t)sum;
        }
        for (int64_t x = 1; x + 1 < width; x++) {
            int response = across[x - 1] - 2 * across[x] + across[x + 1];
            response = response < 0 ? -response : response;
            histogram[response < most ? response : most]++;
        }
        total += width > 2 ? width - 2 : 0;
    }
    *median = 0;
    for (int64_t k = 0; k <= most; k++) {
        below += histogram[k];
        if (below >= (total + 1) / 2) {
            *median = k;
            break;
        }
    }
    return 0;
}
