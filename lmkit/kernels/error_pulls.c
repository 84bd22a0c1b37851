/* How errors of landmarks and of corners pull on a pose; error_pulls.py holds the definition. */
#include "observation.h"

LMKIT_EXPORT int lmkit_error_pulls(const Corners *seen, const double *R, const double *p, const uint8_t *used,
                                   double *pulls, double *own);

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

int lmkit_error_pulls(const Corners *seen, const double *R, const double *p, const uint8_t *used, double *pulls,
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
        if (!cholesky6(inner, WIDE)) return 1;
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
    return 0;
}
