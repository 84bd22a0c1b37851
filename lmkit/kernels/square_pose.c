/* Both poses of a square seen by one camera (Collins and Bartoli 2014, IPPE).  square_pose.py holds the definition. */
#include <math.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_square_poses(int64_t count, const double *rays, const double *sizes, double *R, double *t,
                                    double *errors);

/* Shift that fits the rays best, for a given rotation (least squares), and the root mean square error of the rays. */
static double fit_shift(const double *R, double half, const double *rays, double *t) {
    const double X[4][2] = {{-half, half}, {half, half}, {half, -half}, {-half, -half}};
    double u_sum = 0, v_sum = 0, squares = 0, b0 = 0, b1 = 0, b2 = 0, sum = 0, P[4][3];
    for (int c = 0; c < 4; c++) {
        const double u = rays[2 * c], v = rays[2 * c + 1];
        for (int i = 0; i < 3; i++) P[c][i] = R[3 * i] * X[c][0] + R[3 * i + 1] * X[c][1];
        const double du = u * P[c][2] - P[c][0], dv = v * P[c][2] - P[c][1];
        u_sum += u;
        v_sum += v;
        squares += u * u + v * v;
        b0 += du;
        b1 += dv;
        b2 -= u * du + v * dv;
    }
    /* [4 0 -u; 0 4 -v; -u -v uu] t = b */
    t[2] = (b2 + (u_sum * b0 + v_sum * b1) / 4) / (squares - (u_sum * u_sum + v_sum * v_sum) / 4);
    t[0] = (b0 + u_sum * t[2]) / 4;
    t[1] = (b1 + v_sum * t[2]) / 4;
    for (int c = 0; c < 4; c++) {
        const double z = P[c][2] + t[2];
        const double du = (P[c][0] + t[0]) / z - rays[2 * c], dv = (P[c][1] + t[1]) / z - rays[2 * c + 1];
        sum += du * du + dv * dv;
    }
    return sqrt(sum / 8);
}

static double root(double value) { return value > 0 ? sqrt(value) : 0; }

static void square_poses(const double *rays, double size, double *R, double *t, double *errors) {
    const double half = size / 2;
    /* Homography of the unit square (Heckbert 1989), and its value and derivative in the center. */
    const double x0 = rays[0], y0 = rays[1], x1 = rays[2], y1 = rays[3];
    const double x2 = rays[4], y2 = rays[5], x3 = rays[6], y3 = rays[7];
    const double dx1 = x1 - x2, dx2 = x3 - x2, dy1 = y1 - y2, dy2 = y3 - y2;
    const double sx = x0 - x1 + x2 - x3, sy = y0 - y1 + y2 - y3, determinant = dx1 * dy2 - dx2 * dy1;
    const double g = (sx * dy2 - dx2 * sy) / determinant, h = (dx1 * sy - sx * dy1) / determinant;
    const double xu = x1 - x0 + g * x1, xv = x3 - x0 + h * x3, yu = y1 - y0 + g * y1, yv = y3 - y0 + h * y3;
    const double w = 1 + (g + h) / 2;
    const double p = (xu / 2 + xv / 2 + x0) / w, q = (yu / 2 + yv / 2 + y0) / w;
    const double J[4] = {(xu - p * g) / w / size, -(xv - p * h) / w / size, (yu - q * g) / w / size,
                         -(yv - q * h) / w / size};
    /* Rotation from the optical axis to the ray of the center. */
    const double n = sqrt(p * p + q * q + 1), x = p / n, y = q / n, z = 1 / n, k = 1 / (1 + z);
    const double V[9] = {1 - x * x * k, -x * y * k, x, -x * y * k, 1 - y * y * k, y, -x, -y, z};
    const double b[4] = {V[0] - p * V[6], V[1] - p * V[7], V[3] - q * V[6], V[4] - q * V[7]};
    const double d = 1 / (b[0] * b[3] - b[1] * b[2]);
    const double A[4] = {d * (b[3] * J[0] - b[1] * J[2]), d * (b[3] * J[1] - b[1] * J[3]),
                         d * (b[0] * J[2] - b[2] * J[0]), d * (b[0] * J[3] - b[2] * J[1])};
    const double aa = A[0] * A[0] + A[1] * A[1], ac = A[0] * A[2] + A[1] * A[3], cc = A[2] * A[2] + A[3] * A[3];
    const double gamma = sqrt((aa + cc + sqrt((aa - cc) * (aa - cc) + 4 * ac * ac)) / 2);
    const double r[4] = {A[0] / gamma, A[1] / gamma, A[2] / gamma, A[3] / gamma};
    const double c0 = root(1 - r[0] * r[0] - r[2] * r[2]);
    double c1 = root(1 - r[1] * r[1] - r[3] * r[3]);
    if (-r[0] * r[1] - r[2] * r[3] < 0) c1 = -c1;
    for (int sign = 0; sign < 2; sign++) {
        const double b0 = sign ? -c0 : c0, b1 = sign ? -c1 : c1;
        const double S[9] = {r[0], r[1], b1 * r[2] - b0 * r[3], r[2], r[3], b0 * r[1] - b1 * r[0],
                             b0,   b1,   r[0] * r[3] - r[1] * r[2]};
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                R[9 * sign + 3 * i + j] = V[3 * i] * S[j] + V[3 * i + 1] * S[3 + j] + V[3 * i + 2] * S[6 + j];
        errors[sign] = fit_shift(R + 9 * sign, half, rays, t + 3 * sign);
    }
    if (errors[1] < errors[0]) {
        for (int i = 0; i < 9; i++) {
            const double kept = R[i];
            R[i] = R[9 + i];
            R[9 + i] = kept;
        }
        for (int i = 0; i < 3; i++) {
            const double kept = t[i];
            t[i] = t[3 + i];
            t[3 + i] = kept;
        }
        const double kept = errors[0];
        errors[0] = errors[1];
        errors[1] = kept;
    }
}

int lmkit_square_poses(int64_t count, const double *rays, const double *sizes, double *R, double *t, double *errors) {
    for (int64_t n = 0; n < count; n++)
        square_poses(rays + 8 * n, sizes[n], R + 18 * n, t + 6 * n, errors + 2 * n);
    return 0;
}
