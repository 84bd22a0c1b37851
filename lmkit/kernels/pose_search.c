/* Pose hypotheses from the corners of landmarks, and the covariance of a pose.  pose_search.py holds the definition. */
#include <stddef.h>

#include "pose_search.h"

/* Data of the hypotheses, one slot each; `rows` lists the slots of those that remain. */
typedef struct {
    const Corners *seen;
    const Prior *prior;
    const Search *search;
    double *R, *p, *misfits, *pixels, *cost;
    uint8_t *used, *before;
    int64_t *rows, count;
} Race;

int lmkit_square_poses(int64_t count, const double *rays, const double *sizes, double *R, double *t, double *errors);

/* T_map_rig (R, p) from T_camera_landmark, for the camera of an observation and the landmark with these corners. */
static void place_rig(const Corners *seen, int64_t s, double size, const double *R_eye, const double *t_eye,
                      double *R, double *p) {
    const double *P = seen->points + 12 * s, *C = seen->R_camera + 9 * s, *t = seen->t_camera + 3 * s;
    double x[3], y[3], back[3], moved[3];
    for (int i = 0; i < 3; i++) {
        x[i] = (P[3 + i] - P[i]) / size;
        y[i] = (P[i] - P[9 + i]) / size;
    }
    const double M[9] = {x[0], y[0], x[1] * y[2] - x[2] * y[1], x[1], y[1],
                         x[2] * y[0] - x[0] * y[2], x[2], y[2], x[0] * y[1] - x[1] * y[0]};
    for (int i = 0; i < 3; i++) moved[i] = t_eye[i] - t[i];
    /* Rows of T: the landmark's rotation in the frame of the rig, C^T R_camera_landmark. */
    double T[9];
    for (int i = 0; i < 3; i++) {
        back[i] = C[i] * moved[0] + C[3 + i] * moved[1] + C[6 + i] * moved[2];
        for (int j = 0; j < 3; j++) T[3 * i + j] = C[i] * R_eye[j] + C[3 + i] * R_eye[3 + j] + C[6 + i] * R_eye[6 + j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            R[3 * i + j] = M[3 * i] * T[3 * j] + M[3 * i + 1] * T[3 * j + 1] + M[3 * i + 2] * T[3 * j + 2];
    for (int i = 0; i < 3; i++)
        p[i] = (P[i] + P[3 + i] + P[6 + i] + P[9 + i]) / 4 -
               (R[3 * i] * back[0] + R[3 * i + 1] * back[1] + R[3 * i + 2] * back[2]);
}

/* Both poses of every landmark, from the camera in which it is larger; returns their number. */
static int64_t hypotheses(const Corners *seen, const int64_t *of, const double *side_px, double *R, double *p,
                          int64_t *own) {
    int64_t count = 0;
    for (int64_t s = 0; s < seen->count; s++) {
        int64_t best = s, other = 0;
        while (other < s && of[other] != of[s]) other++;
        if (other < s) continue;
        for (other = s + 1; other < seen->count; other++)
            if (of[other] == of[s] && side_px[other] > side_px[best]) best = other;
        const double *P = seen->points + 12 * best;
        const double dx = P[3] - P[0], dy = P[4] - P[1], dz = P[5] - P[2], size = sqrt(dx * dx + dy * dy + dz * dz);
        double R_eye[18], t_eye[6], errors[2];
        lmkit_square_poses(1, seen->rays + 8 * best, &size, R_eye, t_eye, errors);
        for (int k = 0; k < 2; k++) {
            double *place = p + 3 * count;
            place_rig(seen, best, size, R_eye + 9 * k, t_eye + 3 * k, R + 9 * count, place);
            if (!isfinite(place[0]) || !isfinite(place[1]) || !isfinite(place[2])) continue;
            own[count++] = of[s];
        }
    }
    return count;
}

/* Negative log likelihood: an outlier costs as much as an observation at the limit. */
static void judge(Race *race, int64_t h) {
    const int64_t S = race->seen->count;
    double sum = 0;
    for (int64_t s = 0; s < S; s++) {
        const double misfit = race->misfits[h * S + s];
        sum += misfit > race->search->limit ? race->search->limit : misfit;
    }
    race->cost[h] = (sum + prior_cost(race->prior, race->R + 9 * h, race->p + 3 * h)) / 2;
}

static void measure(Race *race, int64_t h) {
    const int64_t S = race->seen->count;
    lmkit_corner_chi2(race->seen, 1, race->R + 9 * h, race->p + 3 * h, race->misfits + h * S,
                         race->pixels + h * S);
}

static void refine(Race *race, int64_t h, int64_t iterations) {
    const Search *search = race->search;
    lmkit_refine_poses(race->seen, race->prior, 1, race->used + h * race->seen->count, iterations, search->converged,
                       search->most_damping, race->R + 9 * h, race->p + 3 * h);
}

static int is_same(const Race *race, int64_t a, int64_t b) {
    double trace = 0, apart = 0;
    for (int i = 0; i < 9; i++) trace += race->R[9 * a + i] * race->R[9 * b + i];
    for (int i = 0; i < 3; i++) {
        const double d = race->p[3 * a + i] - race->p[3 * b + i];
        apart += d * d;
    }
    return !(race->search->least_trace > trace) && !(apart > race->search->same_place_squared);
}

/* Sort by cost, and drop hypotheses with the same pose as a better one. */
static void keep_distinct(Race *race) {
    int64_t kept = 0;
    for (int64_t k = 1; k < race->count; k++) {
        const int64_t h = race->rows[k];
        int64_t to = k;
        for (; to > 0 && race->cost[race->rows[to - 1]] > race->cost[h]; to--) race->rows[to] = race->rows[to - 1];
        race->rows[to] = h;
    }
    for (int64_t k = 0; k < race->count; k++) {
        int same = 0;
        for (int64_t other = 0; other < kept && !same; other++) same = is_same(race, race->rows[other], race->rows[k]);
        if (!same) race->rows[kept++] = race->rows[k];
    }
    race->count = kept;
}

/* Refine every hypothesis on its own landmark and on all landmarks near their expected places; drop those that cannot
 * win. */
static void approach(Race *race, const int64_t *of, const double *side_px, const int64_t *own) {
    const int64_t S = race->seen->count;
    const Search *search = race->search;
    double best = INFINITY;
    for (int64_t h = 0; h < race->count; h++) {
        measure(race, h);
        for (int64_t s = 0; s < S; s++)
            race->used[h * S + s] =
                of[s] == own[h] || sqrt(race->pixels[h * S + s] / 8) < search->gate_share * side_px[s];
        refine(race, h, search->towards_near);
        measure(race, h);
        judge(race, h);
        if (race->cost[h] < best) best = race->cost[h];
    }
    int64_t kept = 0;
    for (int64_t h = 0; h < race->count; h++) {
        double least = 0;
        for (int64_t s = 0; s < S; s++) {
            const int64_t at = h * S + s;
            const int near = race->used[at] || sqrt(race->pixels[at] / 8) < search->gate_share * side_px[s] ||
                             race->misfits[at] < search->limit;
            if (!near) least += search->limit / 2;
        }
        if (least < best + search->listed_below) race->rows[kept++] = h;
    }
    race->count = kept;
}

/* Mark the inliers of a pose; without any, the observation that fits best is the only inlier.  Returns whether the
 * marks changed. */
static int mark_inliers(Race *race, int64_t h) {
    const int64_t S = race->seen->count;
    const double *misfits = race->misfits + h * S;
    uint8_t *used = race->used + h * S, *before = race->before + h * S;
    double least = INFINITY;
    int any = 0, changed = 0;
    for (int64_t s = 0; s < S; s++) {
        if (misfits[s] < least) least = misfits[s];
        any |= misfits[s] < race->search->limit;
    }
    for (int64_t s = 0; s < S; s++) {
        used[s] = misfits[s] < race->search->limit || (!any && misfits[s] == least);
        changed |= used[s] != before[s];
        before[s] = used[s];
    }
    return changed;
}

int lmkit_search_poses(const Corners *seen, const Prior *prior, const Search *search, const int64_t *of,
                       const double *side_px, double *R, double *p, double *misfits, double *pixels, double *cost,
                       uint8_t *used, uint8_t *before, int64_t *own, int64_t *rows, int64_t *found) {
    Race race = {seen, prior, search, R, p, misfits, pixels, cost, used, before, rows, 0};
    race.count = hypotheses(seen, of, side_px, R, p, own);
    const int64_t all = race.count * seen->count;
    approach(&race, of, side_px, own);
    keep_distinct(&race);
    for (int64_t k = 0; k < all; k++) before[k] = 2; /* neither 0 nor 1, so that the first marks count as a change */
    for (int64_t round = 0; round < search->rounds; round++) {
        int changed = 0;
        for (int64_t k = 0; k < race.count; k++) changed |= mark_inliers(&race, rows[k]);
        if (!changed) break;
        for (int64_t k = 0; k < race.count; k++) {
            refine(&race, rows[k], search->to_the_end);
            measure(&race, rows[k]);
            judge(&race, rows[k]);
        }
    }
    keep_distinct(&race);
    *found = race.count;
    return 0;
}

/* Inverse of a symmetric positive definite 6 x 6 matrix by its Cholesky factor; 0 where there is none. */
static int inverse6(const double *A, double *out) {
    double L[36];
    for (int i = 0; i < 36; i++) L[i] = A[i];
    if (!cholesky6(L, 6)) return 0;
    for (int column = 0; column < 6; column++) {
        double x[6] = {0};
        x[column] = 1;
        forward6(L, 6, x, 1, 1);
        backward6(L, 6, x);
        for (int i = 0; i < 6; i++) out[6 * i + column] = x[i];
    }
    return 1;
}

/* Largest eigenvalue of a symmetric 6 x 6 matrix and its vector (Jacobi's rotations; Golub and Van Loan, 8.5). */
static double largest6(const double *symmetric, double *vector) {
    double A[36], V[36];
    for (int i = 0; i < 36; i++) {
        A[i] = symmetric[i];
        V[i] = i % 7 == 0;
    }
    for (int sweep = 0; sweep < 30; sweep++) {
        int turned = 0;
        for (int a = 0; a < 5; a++) {
            for (int b = a + 1; b < 6; b++) {
                const double off = A[6 * a + b];
                if (fabs(off) <= 1e-16 * sqrt(fabs(A[7 * a] * A[7 * b]))) continue;
                turned = 1;
                const double theta = (A[7 * b] - A[7 * a]) / (2 * off);
                const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                const double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 6; k++) {
                    const double x = A[6 * k + a], y = A[6 * k + b];
                    A[6 * k + a] = c * x - s * y;
                    A[6 * k + b] = s * x + c * y;
                }
                for (int k = 0; k < 6; k++) {
                    const double x = A[6 * a + k], y = A[6 * b + k];
                    A[6 * a + k] = c * x - s * y;
                    A[6 * b + k] = s * x + c * y;
                    const double v = V[6 * k + a], w = V[6 * k + b];
                    V[6 * k + a] = c * v - s * w;
                    V[6 * k + b] = s * v + c * w;
                }
            }
        }
        if (!turned) break;
    }
    int best = 0;
    for (int i = 1; i < 6; i++)
        if (A[7 * i] > A[7 * best]) best = i;
    for (int i = 0; i < 6; i++) vector[i] = V[6 * i + best];
    return A[7 * best];
}

int lmkit_pose_covariance(const Corners *seen, const Prior *prior, const double *R, const double *p,
                          const uint8_t *used, double *covariance) {
    double normal[36], gradient[6], squared, there[36], vector[6];
    lmkit_pose_equations(seen, prior, 1, R, p, used, normal, gradient, &squared);
    if (!inverse6(normal, covariance)) return 1;
    const double value = largest6(covariance, vector), length = value > 0 ? sqrt(value) : 0;
    for (int sign = -1; sign <= 1; sign += 2) {
        double step[6], R_there[9], p_there[3];
        for (int i = 0; i < 6; i++) step[i] = sign * length * vector[i];
        turn_by(step + 3, R, R_there);
        for (int i = 0; i < 3; i++) p_there[i] = p[i] + step[i];
        lmkit_pose_equations(seen, prior, 1, R_there, p_there, used, normal, gradient, &squared);
        if (!inverse6(normal, there)) return 1;
        for (int i = 0; i < 36; i++) covariance[i] += there[i];
    }
    for (int i = 0; i < 36; i++) covariance[i] /= 3;
    return 0;
}
