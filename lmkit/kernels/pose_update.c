/* Update of a filter's state with the corners of landmarks (Bell and Cathey 1993).  pose_update.py holds the
 * definition. */
#include <string.h>

#include "pose_fit.h"

#define MOST 12 /* unknowns on a floor */
#define LEAN 3  /* of them, at the end: lift, roll, pitch */

/* Settings; the fields are those of `Update` in pose_update.py. */
typedef struct {
    double converged, limit;
    int64_t iterations;
} Update;

LMKIT_EXPORT int lmkit_update_space(const Corners *seen, const Update *update, const int64_t *of, const double *before,
                                    uint8_t *used, double *R, double *p, double *covariance, double *left,
                                    double *cost, double *misfits, double *pixels);
LMKIT_EXPORT int lmkit_update_planar(const Corners *seen, const Update *update, const int64_t *of, int64_t size,
                                     const double *before, const double *lean, const double *R_base,
                                     const double *t_base, uint8_t *used, double *state, double *R, double *p,
                                     double *covariance, double *left, double *by_pull, double *cost,
                                     double *misfits, double *pixels);

/* The state before and during the update. */
typedef struct {
    const Corners *seen;
    const Update *update;
    const double *known, *R_base, *t_base; /* R_base is null in 3D */
    int64_t size;
    double start[MOST], state[MOST]; /* on a floor */
    double R_start[9], p_start[3], R[9], p[3];
    double normal[MOST * MOST], cost;
} Fit;

/* Rotation vector of a rotation by less than half a turn. */
static void rotation_vector(const double *R, double *w) {
    w[0] = (R[7] - R[5]) / 2;
    w[1] = (R[2] - R[6]) / 2;
    w[2] = (R[3] - R[1]) / 2;
    const double s = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), c = (R[0] + R[4] + R[8] - 1) / 2;
    const double scale = s > 1e-10 ? atan2(s, c) / s : 1;
    for (int i = 0; i < 3; i++) w[i] *= scale;
}

/* The camera's pose for the state, on a floor. */
static void place_camera(Fit *fit) {
    const double *x = fit->state, *t = fit->t_base, *lean = x + fit->size - LEAN;
    const double c = cos(x[2]), s = sin(x[2]), w[3] = {lean[1], lean[2], 0};
    const double level[9] = {c, -s, 0, s, c, 0, 0, 0, 1};
    double turn[9];
    turn_by(w, level, turn);
    const double at[3] = {x[0], x[1], lean[0]};
    for (int i = 0; i < 3; i++) {
        fit->p[i] = at[i] + turn[3 * i] * t[0] + turn[3 * i + 1] * t[1] + turn[3 * i + 2] * t[2];
        for (int j = 0; j < 3; j++)
            fit->R[3 * i + j] = turn[3 * i] * fit->R_base[j] + turn[3 * i + 1] * fit->R_base[3 + j] +
                                turn[3 * i + 2] * fit->R_base[6 + j];
    }
}

/* (6,size) derivatives of the camera's pose with the state. */
static void camera_by_state(const Fit *fit, double *J) {
    const int64_t n = fit->size;
    memset(J, 0, sizeof(double) * 6 * MOST);
    if (!fit->R_base) {
        for (int i = 0; i < 6; i++) J[MOST * i + i] = 1;
        return;
    }
    const double *t = fit->t_base, c = cos(fit->state[2]), s = sin(fit->state[2]);
    const double x = c * t[0] - s * t[1], y = s * t[0] + c * t[1], z = t[2];
    J[0] = J[MOST + 1] = J[MOST * 5 + 2] = 1;
    J[2] = -y;
    J[MOST + 2] = x;
    /* The robot leans about its base on the floor, not about the camera. */
    const double lean[6][3] = {{0, 0, z}, {0, -z, 0}, {1, y, -x}, {0, 1, 0}, {0, 0, 1}, {0, 0, 0}};
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < LEAN; j++) J[MOST * i + n - LEAN + j] = lean[i][j];
}

/* Predicted state minus present state. */
static void offset(const Fit *fit, double *off) {
    if (fit->R_base) {
        for (int64_t i = 0; i < fit->size; i++) off[i] = fit->start[i] - fit->state[i];
        return;
    }
    double turned[9];
    for (int i = 0; i < 3; i++) {
        off[i] = fit->p_start[i] - fit->p[i];
        for (int j = 0; j < 3; j++)
            turned[3 * i + j] = fit->R_start[3 * i] * fit->R[3 * j] + fit->R_start[3 * i + 1] * fit->R[3 * j + 1] +
                                fit->R_start[3 * i + 2] * fit->R[3 * j + 2];
    }
    rotation_vector(turned, off + 3);
}

static void move(Fit *fit, const double *step) {
    if (fit->R_base) {
        for (int64_t i = 0; i < fit->size; i++) fit->state[i] += step[i];
        place_camera(fit);
        return;
    }
    double R[9];
    turn_by(step + 3, fit->R, R);
    memcpy(fit->R, R, sizeof R);
    for (int i = 0; i < 3; i++) fit->p[i] += step[i];
}

/* Solve A x = b for a symmetric positive definite A (n,n) in rows of MOST; 0 where it is not. */
static int solve(const double *A, int64_t n, double *b) {
    double L[MOST * MOST];
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j <= i; j++) {
            double sum = A[MOST * i + j];
            for (int64_t k = 0; k < j; k++) sum -= L[MOST * i + k] * L[MOST * j + k];
            if (i == j && !(sum > 0)) return 0;
            L[MOST * i + j] = i == j ? sqrt(sum) : sum / L[MOST * j + j];
        }
        for (int64_t k = 0; k < i; k++) b[i] -= L[MOST * i + k] * b[k];
        b[i] /= L[MOST * i + i];
    }
    for (int64_t i = n - 1; i >= 0; i--) {
        for (int64_t k = i + 1; k < n; k++) b[i] -= L[MOST * k + i] * b[k];
        b[i] /= L[MOST * i + i];
    }
    return 1;
}

/* Inverse (n,n) of a symmetric positive definite matrix in rows of `stride`; 0 where it is not. */
static int inverse(const double *A, int64_t stride, int64_t n, double *out) {
    double L[MOST * MOST], M[MOST * MOST]; /* the factor and its inverse */
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j <= i; j++) {
            double sum = A[stride * i + j];
            for (int64_t k = 0; k < j; k++) sum -= L[MOST * i + k] * L[MOST * j + k];
            if (i == j && !(sum > 0)) return 0;
            L[MOST * i + j] = i == j ? sqrt(sum) : sum / L[MOST * j + j];
        }
        for (int64_t j = 0; j <= i; j++) {
            double sum = i == j;
            for (int64_t k = j; k < i; k++) sum -= L[MOST * i + k] * M[MOST * k + j];
            M[MOST * i + j] = sum / L[MOST * i + i];
        }
    }
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j <= i; j++) {
            double sum = 0;
            for (int64_t k = i; k < n; k++) sum += M[MOST * k + i] * M[MOST * k + j];
            out[n * i + j] = out[n * j + i] = sum;
        }
    return 1;
}

/* Normal matrix and gradient of the prediction and of the used observations. */
static void linearize(Fit *fit, const uint8_t *used, double *gradient) {
    const int64_t n = fit->size;
    double N[36], g[6], squared, J[6 * MOST], NJ[6 * MOST], off[MOST];
    lmkit_pose_equations(fit->seen, NULL, 1, fit->R, fit->p, used, N, g, &squared);
    camera_by_state(fit, J);
    offset(fit, off);
    for (int i = 0; i < 6; i++)
        for (int64_t j = 0; j < n; j++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += N[6 * i + k] * J[MOST * k + j];
            NJ[MOST * i + j] = sum;
        }
    for (int64_t i = 0; i < n; i++) {
        double pull = 0;
        for (int64_t j = 0; j < n; j++) {
            double sum = fit->known[n * i + j];
            pull += sum * off[j];
            for (int k = 0; k < 6; k++) sum += J[MOST * k + i] * NJ[MOST * k + j];
            fit->normal[MOST * i + j] = sum;
        }
        for (int k = 0; k < 6; k++) pull += J[MOST * k + i] * g[k];
        gradient[i] = pull;
    }
}

/* The state that fits the prediction and the used observations best; 0 if they do not determine it. */
static int fit_state(Fit *fit, const uint8_t *used, double *misfits, double *pixels) {
    const int64_t n = fit->size;
    for (int64_t k = 0; k < fit->update->iterations; k++) {
        double step[MOST], gradient[MOST], promised = 0;
        linearize(fit, used, gradient);
        memcpy(step, gradient, sizeof step);
        if (!solve(fit->normal, n, step)) return 0;
        for (int64_t i = 0; i < n; i++) promised += step[i] * gradient[i];
        move(fit, step);
        if (promised < fit->update->converged) break;
    }
    double off[MOST];
    offset(fit, off);
    lmkit_corner_chi2(fit->seen, 1, fit->R, fit->p, misfits, pixels);
    fit->cost = 0;
    for (int64_t s = 0; s < fit->seen->count; s++)
        if (used[s]) fit->cost += misfits[s];
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++) fit->cost += off[i] * fit->known[n * i + j] * off[j];
    return 1;
}

/* Fit, and drop the landmark that fits worst, one after another, until all fit together. */
static int fit_believed(Fit *fit, const int64_t *of, uint8_t *used, double *misfits, double *pixels) {
    const Fit start = *fit;
    const int64_t S = fit->seen->count;
    for (;;) {
        *fit = start;
        if (!fit_state(fit, used, misfits, pixels)) return 0;
        int64_t worst = -1;
        for (int64_t s = 0; s < S; s++)
            if (used[s] && (worst < 0 || misfits[s] > misfits[worst])) worst = s;
        if (worst < 0 || misfits[worst] < fit->update->limit) return 1;
        /* Observations of a landmark by several cameras are kept or dropped together. */
        const int64_t landmark = of[worst];
        for (int64_t s = 0; s < S; s++)
            if (of[s] == landmark) used[s] = 0;
    }
}

/* Result for the states that are kept: covariance, and the factor (wide,wide) by which errors of the prediction
 * remain. */
static int remains(const Fit *fit, int64_t wide, double *covariance, double *left, double *inverted) {
    const int64_t n = fit->size;
    if (!inverse(fit->normal, MOST, n, inverted)) return 0;
    for (int64_t i = 0; i < wide; i++)
        for (int64_t j = 0; j < wide; j++) {
            double sum = 0;
            for (int64_t k = 0; k < n; k++) sum += inverted[n * i + k] * fit->known[n * k + j];
            left[wide * i + j] = sum;
            covariance[wide * i + j] = inverted[n * i + j];
        }
    return 1;
}

int lmkit_update_space(const Corners *seen, const Update *update, const int64_t *of, const double *before,
                       uint8_t *used, double *R, double *p, double *covariance, double *left, double *cost,
                       double *misfits, double *pixels) {
    double known[36], inverted[36];
    Fit fit = {.seen = seen, .update = update, .known = known, .size = 6};
    memcpy(fit.R_start, R, sizeof fit.R_start);
    memcpy(fit.p_start, p, sizeof fit.p_start);
    memcpy(fit.R, R, sizeof fit.R);
    memcpy(fit.p, p, sizeof fit.p);
    if (!inverse(before, 6, 6, known)) return 1;
    if (!fit_believed(&fit, of, used, misfits, pixels)) return 1;
    memcpy(R, fit.R, sizeof fit.R);
    memcpy(p, fit.p, sizeof fit.p);
    *cost = fit.cost;
    return !remains(&fit, 6, covariance, left, inverted);
}

int lmkit_update_planar(const Corners *seen, const Update *update, const int64_t *of, int64_t size,
                        const double *before, const double *lean, const double *R_base, const double *t_base,
                        uint8_t *used, double *state, double *R, double *p, double *covariance, double *left,
                        double *by_pull, double *cost, double *misfits, double *pixels) {
    const int64_t n = size + LEAN;
    double known[MOST * MOST] = {0}, inverted[MOST * MOST], J[6 * MOST];
    Fit fit = {.seen = seen, .update = update, .known = known, .R_base = R_base, .t_base = t_base, .size = n};
    if (size < 3 || n > MOST) return 2;
    if (!inverse(before, size, size, inverted)) return 1;
    for (int64_t i = 0; i < size; i++) {
        fit.start[i] = fit.state[i] = state[i];
        for (int64_t j = 0; j < size; j++) known[n * i + j] = inverted[size * i + j];
    }
    for (int64_t i = 0; i < LEAN; i++) {
        fit.start[size + i] = fit.state[size + i] = 0;
        known[(n + 1) * (size + i)] = lean[i];
    }
    place_camera(&fit);
    if (!fit_believed(&fit, of, used, misfits, pixels)) return 1;
    memcpy(state, fit.state, sizeof(double) * (size_t)size);
    memcpy(R, fit.R, sizeof fit.R);
    memcpy(p, fit.p, sizeof fit.p);
    *cost = fit.cost;
    if (!remains(&fit, size, covariance, left, inverted)) return 1;
    camera_by_state(&fit, J);
    for (int64_t i = 0; i < size; i++)
        for (int j = 0; j < 6; j++) {
            double sum = 0;
            for (int64_t k = 0; k < n; k++) sum += inverted[n * i + k] * J[MOST * j + k];
            by_pull[6 * i + j] = sum;
        }
    return 0;
}
