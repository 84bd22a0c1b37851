/* Whitened reprojection errors of landmark corners for many poses: chi2, normal equations, Levenberg-Marquardt.
 * reprojection.py holds the definition. */
#include "observation.h"

#define PI 3.14159265358979323846

int lmkit_corner_chi2(const Corners *seen, int64_t poses, const double *R, const double *p, double *chi2,
                         double *pixels) {
    for (int64_t h = 0; h < poses; h++) {
        for (int64_t s = 0; s < seen->count; s++) {
            double block[64], moved[64], M[9], raw[64];
            const int uncertain = seen->roots && seen->group[s] >= 0;
            observation(seen, s, R + 9 * h, p + 3 * h, uncertain, block, uncertain ? moved : NULL);
            double squared = 0, off = 0;
            for (int i = 0; i < 8; i++) squared += block[WIDE * i + 6] * block[WIDE * i + 6];
            if (uncertain) {
                /* Woodbury: (1 + K K^T)^-1 = 1 - K (1 + K^T K)^-1 K^T. */
                double inner[64], pull[6] = {0};
                identity(inner);
                add_transposed8(moved, moved, inner);
                for (int i = 0; i < 8; i++)
                    for (int k = 0; k < 6; k++) pull[k] += moved[WIDE * i + k] * block[WIDE * i + 6];
                if (cholesky6(inner, WIDE)) {
                    forward6(inner, WIDE, pull, 1, 1);
                    for (int k = 0; k < 6; k++) squared -= pull[k] * pull[k];
                }
            }
            map_to_camera(seen->R_camera + 9 * s, R + 9 * h, M);
            corner_errors(seen->points + 12 * s, NULL, M, seen->t_camera + 3 * s, p + 3 * h, seen->rays + 8 * s,
                          seen->nearest, seen->nowhere, 0, raw, NULL);
            for (int c = 0; c < 4; c++) {
                const double *B = seen->by_ray + 16 * s + 4 * c;
                const double du = raw[2 * WIDE * c + 6], dv = raw[2 * WIDE * c + WIDE + 6];
                const double x = B[0] * du + B[1] * dv, y = B[2] * du + B[3] * dv;
                off += x * x + y * y;
            }
            chi2[h * seen->count + s] = squared;
            pixels[h * seen->count + s] = off;
        }
    }
    return 0;
}

/* Take a row (6 derivatives, residual) into the products of a block. */
static void add_row(double *total, const double *row) {
    for (int i = 0; i < 7; i++)
        for (int j = 0; j < 7; j++) total[WIDE * i + j] += row[i] * row[j];
}

static void add_prior(const Prior *prior, const double *R, const double *p, double *total) {
    if (!isnan(prior->heading)) {
        const double a = R[2], b = R[5], c = R[8], flat = fmax(a * a + b * b, 1e-12);
        const double off = prior->heading - atan2(b, a), weight = 1 / prior->heading_sigma;
        const double row[7] = {0, 0, 0, -c * a / flat * weight, -c * b / flat * weight, weight,
                               atan2(sin(off), cos(off)) * weight};
        add_row(total, row);
    }
    if (!isnan(prior->height)) {
        const double row[7] = {0, 0, 1 / prior->height_sigma, 0, 0, 0, (prior->height - p[2]) / prior->height_sigma};
        add_row(total, row);
    }
    if (!isnan(prior->down[0])) {
        double lean[3];
        for (int i = 0; i < 3; i++)
            lean[i] = R[3 * i] * prior->down[0] + R[3 * i + 1] * prior->down[1] + R[3 * i + 2] * prior->down[2];
        const double weight = 1 / prior->tilt_sigma;
        const double along_x[7] = {0, 0, 0, 0, lean[2] * weight, -lean[1] * weight, -lean[0] * weight};
        const double along_y[7] = {0, 0, 0, -lean[2] * weight, 0, lean[0] * weight, -lean[1] * weight};
        const double upside_down[7] = {0, 0, 0, 0, 0, 0, lean[2] > 0 ? PI * weight : 0};
        add_row(total, along_x);
        add_row(total, along_y);
        add_row(total, upside_down);
    }
}

double prior_cost(const Prior *prior, const double *R, const double *p) {
    double total[64] = {0};
    if (prior) add_prior(prior, R, p, total);
    return total[WIDE * 6 + 6];
}

/* Products (8,8) of all observations used and the prior: normal matrix, gradient, squared error. */
static void pose_products(const Corners *seen, const Prior *prior, const double *R, const double *p,
                          const uint8_t *used, double *total) {
    double inner[64], across[64];
    int64_t open = -1; /* the landmark whose observations are being summed up */
    for (int i = 0; i < 64; i++) total[i] = 0;
    for (int64_t k = 0; k <= seen->count; k++) {
        const int64_t s = k == seen->count ? -1 : seen->order[k];
        const int64_t group = s < 0 || !seen->roots ? -1 : seen->group[s];
        if (open >= 0 && group != open) {
            /* The landmark's own error is eliminated: total -= across^T inner^-1 across. */
            if (cholesky6(inner, WIDE)) {
                forward6(inner, WIDE, across, WIDE, WIDE);
                for (int i = 0; i < WIDE; i++)
                    for (int row = 0; row < 6; row++)
                        for (int j = 0; j < WIDE; j++)
                            total[WIDE * i + j] -= across[WIDE * row + i] * across[WIDE * row + j];
            }
        }
        if (s < 0) break;
        if (group != open && group >= 0) {
            identity(inner);
            for (int i = 0; i < 64; i++) across[i] = 0;
        }
        open = group;
        if (!used[s]) continue;
        double block[64], moved[64];
        observation(seen, s, R, p, 1, block, group >= 0 ? moved : NULL);
        add_transposed8(block, block, total);
        if (group >= 0) {
            add_transposed8(moved, moved, inner);
            add_transposed8(moved, block, across);
        }
    }
    if (prior) add_prior(prior, R, p, total);
}

int lmkit_pose_equations(const Corners *seen, const Prior *prior, int64_t poses, const double *R, const double *p,
                         const uint8_t *used, double *normal, double *gradient, double *squared) {
    for (int64_t h = 0; h < poses; h++) {
        double total[64];
        pose_products(seen, prior, R + 9 * h, p + 3 * h, used + seen->count * h, total);
        for (int i = 0; i < 6; i++) {
            for (int j = 0; j < 6; j++) normal[36 * h + 6 * i + j] = total[WIDE * i + j];
            gradient[6 * h + i] = total[WIDE * i + 6];
        }
        squared[h] = total[WIDE * 6 + 6];
    }
    return 0;
}

/* One pose, in place. */
static void refine_pose(const Corners *seen, const Prior *prior, const uint8_t *used, int64_t iterations,
                        double converged, double most_damping, double *R, double *p) {
    double total[64], damping = 1e-6;
    pose_products(seen, prior, R, p, used, total);
    for (int64_t k = 0; k < iterations && damping <= most_damping; k++) {
        double L[64], step[6], gain = 0, there[64], R_there[9], p_there[3];
        for (int i = 0; i < 64; i++) L[i] = total[i];
        for (int i = 0; i < 6; i++) {
            L[WIDE * i + i] = L[WIDE * i + i] * (1 + damping) + 1e-9;
            step[i] = total[WIDE * i + 6];
        }
        if (!cholesky6(L, WIDE)) {
            damping *= 300;
            continue;
        }
        forward6(L, WIDE, step, 1, 1);
        backward6(L, WIDE, step);
        for (int i = 0; i < 6; i++) gain += step[i] * total[WIDE * i + 6];
        turn_by(step + 3, R, R_there);
        for (int i = 0; i < 3; i++) p_there[i] = p[i] + step[i];
        /* Predicted decrease of the cost by this step. */
        int better = gain < converged;
        if (!better) {
            pose_products(seen, prior, R_there, p_there, used, there);
            better = there[WIDE * 6 + 6] < total[WIDE * 6 + 6];
            for (int i = 0; better && i < 64; i++) total[i] = there[i];
            damping = better ? fmax(damping / 10, 1e-9) : damping * 300;
        }
        for (int i = 0; better && i < 9; i++) R[i] = R_there[i];
        for (int i = 0; better && i < 3; i++) p[i] = p_there[i];
        if (gain < converged) return;
    }
}

int lmkit_refine_poses(const Corners *seen, const Prior *prior, int64_t poses, const uint8_t *used,
                       int64_t iterations, double converged, double most_damping, double *R, double *p) {
    for (int64_t h = 0; h < poses; h++)
        refine_pose(seen, prior, used + seen->count * h, iterations, converged, most_damping, R + 9 * h, p + 3 * h);
    return 0;
}
