/* Planar motions between times from rows of wheel odometry, for several sets of its errors.
 * wheel_motion.py holds the definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_wheel_motions(int64_t rows, const double *times, const double *forward, const double *turn,
                                     const double *seconds, const double *rate, int64_t sets,
                                     const double *parameters, int64_t count, const double *at, double *path,
                                     double *motions);

/* Where the robot is along its path, by a time within it. */
static void place(int64_t rows, const double *times, const double *path, double time, double *out) {
    const double own = time < times[0] ? times[0] : time > times[rows - 1] ? times[rows - 1] : time;
    int64_t low = 0, high = rows - 1; /* the first row that is not earlier */
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (times[middle] < own)
            low = middle + 1;
        else
            high = middle;
    }
    const int64_t after = low < 1 ? 1 : low;
    const double share = (own - times[after - 1]) / (times[after] - times[after - 1]);
    for (int i = 0; i < 3; i++) out[i] = path[3 * (after - 1) + i] * (1 - share) + path[3 * after + i] * share;
}

int lmkit_wheel_motions(int64_t rows, const double *restrict times, const double *restrict forward,
                        const double *restrict turn, const double *restrict seconds, const double *restrict rate,
                        int64_t sets, const double *restrict parameters, int64_t count, const double *restrict at,
                        double *restrict path, double *restrict motions) {
    for (int64_t set = 0; set < sets; set++) {
        const double *p = parameters + 6 * set;
        double x = 0, y = 0, heading = 0;
        for (int64_t row = 0; row < rows; row++) {
            const double way = p[0] * forward[row] * (1 - p[4] * rate[row]);
            const double turned = p[1] * turn[row] + p[2] * seconds[row] + p[3] * way;
            heading += turned;
            const double middle = heading - turned / 2;
            x += way * cos(middle);
            y += way * sin(middle);
            path[3 * row] = x;
            path[3 * row + 1] = y;
            path[3 * row + 2] = heading;
        }
        double before[3], now[3];
        for (int64_t k = 0; k < count; k++) {
            place(rows, times, path, at[k] - p[5], now);
            if (k > 0) {
                const double dx = now[0] - before[0], dy = now[1] - before[1];
                const double c = cos(before[2]), s = sin(before[2]);
                double *motion = motions + 3 * ((count - 1) * set + k - 1);
                motion[0] = c * dx + s * dy;
                motion[1] = -s * dx + c * dy;
                motion[2] = now[2] - before[2];
            }
            for (int i = 0; i < 3; i++) before[i] = now[i];
        }
    }
    return 0;
}
