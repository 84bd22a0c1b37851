/* Errors that images share (lasting errors), in an update of a filter's state; lasting_errors.py holds the
 * definition. */
#include "observation.h"

#define MOST 12 /* states */
#define PLACE 6 /* errors of a landmark's place */
#define OWN 8   /* errors of an observation's corners */

LMKIT_EXPORT int lmkit_lasting_errors(const Corners *seen, const double *R, const double *p, const uint8_t *used,
                                      int64_t states, const double *left, const double *by_pull,
                                      const int64_t *numbers, const int64_t *rows, const double *pixels,
                                      const double *shares, const double *per_px, int64_t places_before,
                                      const double *excess_before, const double *X_places_before,
                                      const double *pixels_before, const double *X_corners_before, int64_t places,
                                      double *excess, double *X_places, double *X_corners, double *scratch);

/* own (6,8) = H^T - pull (6,6) K^T. */
static void own_pull(const double *H, const double *K, const double *pull, double *own) {
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 8; j++) {
            double sum = H[WIDE * j + i];
            if (pull)
                for (int k = 0; k < 6; k++) sum -= pull[6 * i + k] * K[WIDE * j + k];
            own[8 * i + j] = sum;
        }
}

/* Effects on the pose of the errors of places (S,6,6) and of corners (S,6,8); 0 if they are not finite. */
static int error_pulls(const Corners *seen, const double *R, const double *p, const uint8_t *used, double *pulls,
                       double *own) {
    for (int64_t i = 0; i < 36 * seen->count; i++) pulls[i] = 0;
    for (int64_t i = 0; i < 48 * seen->count; i++) own[i] = 0;
    for (int64_t first = 0, end; first < seen->count; first = end) {
        const int64_t group = seen->roots ? seen->group[seen->order[first]] : -1;
        double inner[64], across[64] = {0}, pull[36], block[64], moved[64];
        identity(inner);
        for (end = first; end < seen->count; end++) {
            const int64_t s = seen->order[end];
            if (seen->roots && seen->group[s] != group) break;
            if (!used[s]) continue;
            observation(seen, s, R, p, 1, block, group >= 0 ? moved : NULL);
            if (group < 0) {
                own_pull(block, NULL, NULL, own + 48 * s);
                continue;
            }
            add_transposed8(moved, moved, inner);
            add_transposed8(moved, block, across);
        }
        if (group < 0) continue;
        if (!cholesky6(inner, WIDE)) return 0;
        forward6(inner, WIDE, across, WIDE, 6);
        for (int j = 0; j < 6; j++) {
            for (int i = 0; i < 6; i++) pull[6 * j + i] = across[WIDE * i + j];
            backward6(inner, WIDE, pull + 6 * j);
        }
        for (int64_t k = first; k < end; k++) {
            const int64_t s = seen->order[k];
            if (!used[s]) continue;
            observation(seen, s, R, p, 1, block, moved);
            own_pull(block, moved, pull, own + 48 * s);
            for (int i = 0; i < 36; i++) pulls[36 * s + i] = pull[i];
        }
    }
    return 1;
}

/* out (n,wide) = A (n,k) B (k,wide). */
static void product(const double *restrict A, const double *restrict B, int64_t n, int64_t k, int64_t wide,
                    double *restrict out) {
    for (int64_t i = 0; i < n; i++) {
        double *row = out + wide * i;
        for (int64_t c = 0; c < wide; c++) row[c] = 0;
        for (int64_t j = 0; j < k; j++)
            for (int64_t c = 0; c < wide; c++) row[c] += A[k * i + j] * B[wide * j + c];
    }
}

/* E (n,n) += X D^T + D X^T, with X and D (n,wide): covariance of the errors with the state before, and their effect
 * on the state. */
static void count(const double *X, const double *D, int64_t n, int64_t wide, double *E) {
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j <= i; j++) {
            double sum = 0;
            for (int64_t c = 0; c < wide; c++)
                sum += X[wide * i + c] * D[wide * j + c] + D[wide * i + c] * X[wide * j + c];
            E[n * i + j] += sum;
            if (j < i) E[n * j + i] += sum;
        }
}

/* Errors of one observation's corners: those of the detector, then those of the lens. */
static void own_errors(const double *own, int64_t n, double share, const double *by_pull, double *out) {
    double moved[MOST * OWN];
    const double lens = sqrt(share), detector = sqrt(1 - share);
    product(by_pull, own, n, 6, OWN, moved);
    for (int64_t i = 0; i < n; i++)
        for (int j = 0; j < OWN; j++) {
            out[2 * OWN * i + j] = detector * moved[OWN * i + j];
            out[2 * OWN * i + OWN + j] = lens * moved[OWN * i + j];
        }
}

/* Root mean square displacement of four corners, pixels. */
static double way(const double *from, const double *to) {
    double sum = 0;
    for (int i = 0; i < 8; i++) sum += (to[i] - from[i]) * (to[i] - from[i]);
    return sqrt(sum / 4);
}

/* Whether an earlier used observation has the same landmark; the error of its place must count once. */
static int is_counted(const int64_t *numbers, const uint8_t *used, int64_t s) {
    for (int64_t k = 0; k < s; k++)
        if (used[k] && numbers[k] == numbers[s]) return 1;
    return 0;
}

int lmkit_lasting_errors(const Corners *seen, const double *R, const double *p, const uint8_t *used, int64_t states,
                         const double *left, const double *by_pull, const int64_t *numbers, const int64_t *rows,
                         const double *pixels, const double *shares, const double *per_px, int64_t places_before,
                         const double *excess_before, const double *X_places_before, const double *pixels_before,
                         const double *X_corners_before, int64_t places, double *excess, double *X_places,
                         double *X_corners, double *scratch) {
    const int64_t n = states, place_size = n * PLACE, own_size = n * 2 * OWN;
    double *pulls = scratch, *own = scratch + 36 * seen->count, X[MOST * 2 * OWN], D[MOST * 2 * OWN];
    if (n > MOST) return 2;
    if (!error_pulls(seen, R, p, used, pulls, own)) return 1;
    product(left, excess_before, n, n, n, X);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++) {
            double sum = 0;
            for (int64_t k = 0; k < n; k++) sum += X[n * i + k] * left[n * j + k];
            excess[n * i + j] = sum;
        }
    for (int64_t k = 0; k < places; k++) {
        double *block = X_places + place_size * k;
        if (k < places_before)
            product(left, X_places_before + place_size * k, n, n, PLACE, block);
        else
            for (int64_t i = 0; i < place_size; i++) block[i] = 0;
    }
    for (int64_t s = 0; s < seen->count; s++) {
        double *block = X_corners + own_size * s;
        if (!used[s]) {
            for (int64_t i = 0; i < own_size; i++) block[i] = 0;
            continue;
        }
        if (numbers[s] >= 0 && !is_counted(numbers, used, s)) {
            double *place = X_places + place_size * numbers[s];
            product(by_pull, pulls + 36 * s, n, 6, PLACE, D);
            count(place, D, n, PLACE, excess);
            for (int64_t i = 0; i < place_size; i++) place[i] += D[i];
        }
        own_errors(own + 48 * s, n, shares[s], by_pull, block);
        if (rows[s] < 0) continue;
        const double moved = way(pixels_before + 8 * rows[s], pixels + 8 * s);
        const double alike[2] = {exp(moved * per_px[0]), exp(moved * per_px[1])};
        product(left, X_corners_before + own_size * rows[s], n, n, 2 * OWN, X);
        for (int64_t i = 0; i < own_size; i++) X[i] *= alike[i / OWN % 2];
        count(X, block, n, 2 * OWN, excess);
        for (int64_t i = 0; i < own_size; i++) block[i] += X[i];
    }
    return 0;
}
