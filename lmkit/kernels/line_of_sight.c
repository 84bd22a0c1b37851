/* Straight lines through an occupancy grid.  line_of_sight.py holds the definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_clear_lines(const uint8_t *is_free, int64_t rows, int64_t columns, double cell, double x0,
                                   double y0, double near, int64_t count, const double *from, const double *to,
                                   uint8_t *clear);

int lmkit_clear_lines(const uint8_t *is_free, int64_t rows, int64_t columns, double cell, double x0, double y0,
                      double near, int64_t count, const double *from, const double *to, uint8_t *clear) {
    for (int64_t n = 0; n < count; n++) {
        const double x = from[2 * n], y = from[2 * n + 1], dx = to[2 * n] - x, dy = to[2 * n + 1] - y;
        const double length = sqrt(dx * dx + dy * dy);
        /* Just before the wall. */
        const double share = fmax(length - near, 0.0) / fmax(length, 1e-9);
        clear[n] = 0;
        if (!(length * 2 / cell < 1e9)) continue;
        const int64_t steps = (int64_t)ceil(2 * length / cell);
        int64_t k = 0;
        for (; k <= steps; k++) {
            const double at = steps ? share * ((double)k / (double)steps) : 0;
            const double column = floor((x + at * dx - x0) / cell), row = floor((y + at * dy - y0) / cell);
            if (!(column >= 0 && row >= 0 && column < (double)columns && row < (double)rows)) break;
            if (!is_free[(int64_t)row * columns + (int64_t)column]) break;
        }
        clear[n] = k > steps;
    }
    return 0;
}
