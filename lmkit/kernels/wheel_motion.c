/* Planar motions between times from rows of wheel odometry, for several sets of its errors.
 * wheel_motion.py holds the definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_wheel_motions(int64_t rows, const double *times, const double *forward, const double *turn,
                                     const double *seconds, const double *rate, int64_t sets,
                                     const double *parameters, int64_t count, const double *at, double *path,
                                     double *motions);

LMKIT_EXPORT int lmkit_wheel_steps(int64_t rows, const double *times, const double *forward, const double *turn,
                                   const double *seconds, const double *rate, const double *parameters,
                                   const double *moves, int64_t count, const double *at, double *path,
                                   double *all, double *motions, double *by_parameters, double *grown);

enum { PARAMETERS = 6, DELAY = 5, SETS = 8 };

/* Position of the robot along its path at a time within it. */
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

/* Three cumulative sums up to a time; they are constant before the first row and after the last one. */
static void totals_by(int64_t rows, const double *times, const double *totals, double own, double *out) {
    int64_t low = 0, high = rows; /* the first row that is later */
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (times[middle] <= own)
            low = middle + 1;
        else
            high = middle;
    }
    const int64_t row = low < 1 ? 0 : low - 1;
    for (int i = 0; i < 3; i++) {
        const double *total = totals + 3 * row + i;
        const int is_between = low > 0 && low < rows;
        out[i] = is_between ? (total[3] - *total) / (times[row + 1] - times[row]) * (own - times[row]) + *total : *total;
    }
}

/* First and last row that the path between times needs, with the delays of all sets. */
static void rows_between(int64_t rows, const double *times, int64_t count, const double *at, double delay, double span,
                         int64_t *first, int64_t *last) {
    double low = at[0], high = at[0];
    for (int64_t k = 1; k < count; k++) {
        low = at[k] < low ? at[k] : low;
        high = at[k] > high ? at[k] : high;
    }
    low -= delay + span;
    high -= delay - span;
    *first = 0;
    *last = rows - 1;
    while (*first < rows - 2 && times[*first + 1] <= low) ++*first;
    while (*last > *first + 1 && times[*last - 1] >= high) --*last;
}

/* moves: step of each parameter for the differences (of the delay to both sides), and the longest time between rows
 * that does not count as a gap.  all (8,count-1,3) and path (rows,3) are scratch. */
int lmkit_wheel_steps(int64_t rows, const double *restrict times, const double *restrict forward,
                      const double *restrict turn, const double *restrict seconds, const double *restrict rate,
                      const double *restrict parameters, const double *restrict moves, int64_t count,
                      const double *restrict at, double *restrict path, double *restrict all,
                      double *restrict motions, double *restrict by_parameters, double *restrict grown) {
    double sets[SETS * PARAMETERS];
    for (int i = 0; i < SETS * PARAMETERS; i++) sets[i] = parameters[i % PARAMETERS];
    for (int i = 0; i < PARAMETERS; i++) sets[PARAMETERS * (i + 1) + i] += moves[i];
    sets[PARAMETERS * (SETS - 1) + DELAY] -= moves[DELAY];
    if (count > 0) {
        int64_t from, to;
        rows_between(rows, times, count, at, parameters[DELAY], fabs(moves[DELAY]), &from, &to);
        lmkit_wheel_motions(to - from + 1, times + from, forward + from, turn + from, seconds + from, rate + from, SETS,
                            sets, count, at, path, all);
    }
    const int64_t numbers = 3 * (count - 1);
    for (int64_t k = 0; k < numbers; k++) {
        motions[k] = all[k];
        for (int i = 0; i < DELAY; i++)
            by_parameters[PARAMETERS * k + i] = (all[numbers * (i + 1) + k] - all[k]) / moves[i];
        by_parameters[PARAMETERS * k + DELAY] =
            (all[numbers * PARAMETERS + k] - all[numbers * (PARAMETERS + 1) + k]) / (2 * moves[DELAY]);
    }
    double way = 0, turned = 0, gap = 0;
    for (int64_t row = 0; row < rows; row++) {
        path[3 * row] = way += fabs(forward[row]);
        path[3 * row + 1] = turned += fabs(turn[row]);
        path[3 * row + 2] = gap += seconds[row] > moves[PARAMETERS] ? seconds[row] : 0.0;
    }
    double before[3], now[3], beyond = 0;
    for (int64_t k = 0; k < count; k++) {
        const double own = at[k] - parameters[DELAY];
        const double outside = fmin(own, times[0]) + fmax(own, times[rows - 1]);
        totals_by(rows, times, path, own, now);
        if (k > 0) {
            double *out = grown + 4 * (k - 1);
            out[0] = fabs(at[k] - at[k - 1]);
            out[1] = fabs(now[0] - before[0]);
            out[2] = fabs(now[1] - before[1]);
            out[3] = fabs(now[2] - before[2]) + fabs(outside - beyond);
        }
        for (int i = 0; i < 3; i++) before[i] = now[i];
        beyond = outside;
    }
    return 0;
}
