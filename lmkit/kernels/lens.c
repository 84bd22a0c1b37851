/* Landmark corners through a lens: rays without distortion, derivatives of pixels, and whitening of errors.
 * The way back through a lens is OpenCV's.  lens.py holds the definition. */
#include "lens.h"

#include <stddef.h>

#include "kernels.h"

LMKIT_EXPORT int lmkit_corners_through_lens(const Lens *lens, int64_t count, const double *corners,
                                            const double *covariance, double floor_px, double reached_px,
                                            double *rays, double *by_ray, double *whitener, uint8_t *reached);

/* One step of Newton's method toward a near pixel; returns 0 and changes nothing if the step does not come nearer. */
static int newton_step(const Lens *lens, const double *pixel, double *ray, double *there, double *J, double *error) {
    const double du = pixel[0] - there[0], dv = pixel[1] - there[1], scale = 1 / (J[0] * J[3] - J[1] * J[2]);
    const double x = ray[0] + (J[3] * du - J[1] * dv) * scale, y = ray[1] + (J[0] * dv - J[2] * du) * scale;
    double now[2], by_ray[4];
    project_rational(lens, x, y, now, by_ray);
    const double off = hypot(now[0] - pixel[0], now[1] - pixel[1]);
    if (!(off < *error)) return 0;
    ray[0] = x;
    ray[1] = y;
    for (int i = 0; i < 2; i++) there[i] = now[i];
    for (int i = 0; i < 4; i++) J[i] = by_ray[i];
    *error = off;
    return 1;
}

/* Ray of a pixel: fixed-point iteration of the radial and tangential part, and Newton's method once it is near. */
static void unproject_rational(const Lens *lens, const double *pixel, double *ray) {
    const double *k = lens->k, *B = lens->tilt_back;
    const double u = (pixel[0] - lens->cx) / lens->fx, v = (pixel[1] - lens->cy) / lens->fy;
    const double depth = B[6] * u + B[7] * v + B[8], inverse = depth != 0 ? 1 / depth : 1;
    const double x0 = (B[0] * u + B[1] * v + B[2]) * inverse, y0 = (B[3] * u + B[4] * v + B[5]) * inverse;
    double error = INFINITY, there[2], J[4];
    int nearing = 1;
    ray[0] = x0;
    ray[1] = y0;
    for (int i = 0; i < 100 && !(error < 1e-12); i++) {
        if (nearing && error < 1) {
            nearing = newton_step(lens, pixel, ray, there, J, &error);
            continue;
        }
        const double x = ray[0], y = ray[1], r2 = x * x + y * y;
        const double back = (1 + ((k[7] * r2 + k[6]) * r2 + k[5]) * r2) / (1 + ((k[4] * r2 + k[1]) * r2 + k[0]) * r2);
        if (back < 0) {
            ray[0] = u;
            ray[1] = v;
            break;
        }
        const double dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + k[8] * r2 + k[9] * r2 * r2;
        const double dy = k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r2 * r2;
        ray[0] = (x0 - dx) * back;
        ray[1] = (y0 - dy) * back;
        project_rational(lens, ray[0], ray[1], there, J);
        error = hypot(there[0] - pixel[0], there[1] - pixel[1]);
    }
}

/* Ray of a pixel: Newton's method on the angle from the optical axis. */
static void unproject_fisheye(const Lens *lens, const double *pixel, double *ray) {
    const double *k = lens->k, half_turn = 1.57079632679489661923;
    const double u = (pixel[0] - lens->cx) / lens->fx, v = (pixel[1] - lens->cy) / lens->fy;
    double bent = sqrt(u * u + v * v), scale = 0;
    int converged = 0;
    bent = bent > half_turn ? half_turn : bent;
    double theta = bent;
    if (bent > 1e-8) {
        for (int i = 0; i < 100 && !converged; i++) {
            const double t2 = theta * theta;
            const double value = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
            const double slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
            const double step = (value - bent) / slope;
            theta -= step;
            converged = fabs(step) < 1e-12;
        }
        scale = tan(theta) / bent;
    } else {
        converged = 1;
        scale = 1;
    }
    const int sound = converged && theta >= 0;
    ray[0] = sound ? u * scale : -1e6;
    ray[1] = sound ? v * scale : -1e6;
}

/* Inverse of the lower Cholesky factor of A + floor^2; 0 if this is not positive definite. */
static int inverse_factor8(const double *A, double floor_px, double *out) {
    double L[64];
    for (int i = 0; i < 8; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = (A ? A[8 * i + j] : 0) + (i == j ? floor_px * floor_px : 0);
            for (int k = 0; k < j; k++) sum -= L[8 * i + k] * L[8 * j + k];
            if (i == j && !(sum > 0)) return 0;
            L[8 * i + j] = i == j ? sqrt(sum) : sum / L[8 * j + j];
        }
    }
    for (int column = 0; column < 8; column++) {
        for (int i = 0; i < 8; i++) {
            double sum = i == column;
            for (int k = column; k < i; k++) sum -= L[8 * i + k] * out[8 * k + column];
            out[8 * i + column] = i < column ? 0 : sum / L[8 * i + i];
        }
    }
    return 1;
}

int lmkit_corners_through_lens(const Lens *lens, int64_t count, const double *corners, const double *covariance,
                               double floor_px, double reached_px, double *rays, double *by_ray, double *whitener,
                               uint8_t *reached) {
    for (int64_t n = 0; n < count; n++) {
        double *J = by_ray + 16 * n, *W = whitener + 64 * n, inverse[64];
        reached[n] = 1;
        for (int c = 0; c < 4; c++) {
            const double *seen = corners + 8 * n + 2 * c;
            double *ray = rays + 8 * n + 2 * c, back[2];
            if (lens->fisheye)
                unproject_fisheye(lens, seen, ray);
            else
                unproject_rational(lens, seen, ray);
            for (int i = 0; i < 2; i++)
                if (!isfinite(ray[i])) ray[i] = 0;
            project_ray(lens, ray[0], ray[1], back, J + 4 * c);
            const double du = back[0] - seen[0], dv = back[1] - seen[1];
            reached[n] = reached[n] && du * du + dv * dv < reached_px * reached_px;
        }
        if (!inverse_factor8(covariance ? covariance + 64 * n : NULL, floor_px, inverse)) return 1;
        for (int i = 0; i < 8; i++)
            for (int c = 0; c < 4; c++)
                for (int j = 0; j < 2; j++)
                    W[8 * i + 2 * c + j] =
                        inverse[8 * i + 2 * c] * J[4 * c + j] + inverse[8 * i + 2 * c + 1] * J[4 * c + 2 + j];
    }
    return 0;
}
