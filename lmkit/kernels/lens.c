/* Landmark corners through a lens: rays without distortion, derivatives of pixels, and whitening of errors.
 * Lens models, and the way back through them, are OpenCV's.  lens.py holds the definition. */
#include <math.h>
#include <stddef.h>

#include "kernels.h"

#define NUMBERS 14 /* distortion coefficients in OpenCV's order, the unused ones zero */

/* A camera; the fields are those of `Lens` in lens.py. */
typedef struct {
    int64_t fisheye;
    double fx, fy, cx, cy, k[NUMBERS], tilt[9], tilt_back[9];
} Lens;

LMKIT_EXPORT int lmkit_corners_through_lens(const Lens *lens, int64_t count, const double *corners,
                                            const double *covariance, double floor_px, double reached_px,
                                            double *rays, double *by_ray, double *whitener, uint8_t *reached);

/* Pixel of a ray, and (2,2) derivative. */
static void project_fisheye(const Lens *lens, double a, double b, double *pixel, double *J) {
    const double *k = lens->k;
    const double r = sqrt(a * a + b * b), theta = atan(r), t2 = theta * theta;
    const double bent = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    const double slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
    const double scale = r > 1e-8 ? bent / r : 1;
    /* d scale / d r, over r */
    const double change = r > 1e-8 ? (slope / (1 + r * r) - scale) / (r * r) : 0;
    pixel[0] = lens->fx * scale * a + lens->cx;
    pixel[1] = lens->fy * scale * b + lens->cy;
    J[0] = lens->fx * (scale + change * a * a);
    J[1] = lens->fx * change * a * b;
    J[2] = lens->fy * change * a * b;
    J[3] = lens->fy * (scale + change * b * b);
}

static void project_rational(const Lens *lens, double a, double b, double *pixel, double *J) {
    const double *k = lens->k, *T = lens->tilt;
    const double r2 = a * a + b * b;
    const double over = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    const double under = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
    const double radial = over / under;
    /* d radial / d r^2 */
    const double d_over = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4]), d_under = k[5] + r2 * (2 * k[6] + r2 * 3 * k[7]);
    const double change = (d_over - radial * d_under) / under;
    const double x = a * radial + 2 * k[2] * a * b + k[3] * (r2 + 2 * a * a) + r2 * (k[8] + r2 * k[9]);
    const double y = b * radial + k[2] * (r2 + 2 * b * b) + 2 * k[3] * a * b + r2 * (k[10] + r2 * k[11]);
    const double prism_x = k[8] + 2 * k[9] * r2, prism_y = k[10] + 2 * k[11] * r2;
    const double xa = radial + 2 * a * a * change + 2 * k[2] * b + 6 * k[3] * a + 2 * a * prism_x;
    const double xb = 2 * a * b * change + 2 * k[2] * a + 2 * k[3] * b + 2 * b * prism_x;
    const double ya = 2 * a * b * change + 2 * k[2] * a + 2 * k[3] * b + 2 * a * prism_y;
    const double yb = radial + 2 * b * b * change + 6 * k[2] * b + 2 * k[3] * a + 2 * b * prism_y;
    const double depth = T[6] * x + T[7] * y + T[8], inverse = depth != 0 ? 1 / depth : 1;
    const double u = (T[0] * x + T[1] * y + T[2]) * inverse, v = (T[3] * x + T[4] * y + T[5]) * inverse;
    const double ux = (T[0] - u * T[6]) * inverse, uy = (T[1] - u * T[7]) * inverse;
    const double vx = (T[3] - v * T[6]) * inverse, vy = (T[4] - v * T[7]) * inverse;
    pixel[0] = lens->fx * u + lens->cx;
    pixel[1] = lens->fy * v + lens->cy;
    J[0] = lens->fx * (ux * xa + uy * ya);
    J[1] = lens->fx * (ux * xb + uy * yb);
    J[2] = lens->fy * (vx * xa + vy * ya);
    J[3] = lens->fy * (vx * xb + vy * yb);
}

/* Ray of a pixel: fixed-point iteration of the radial and tangential part. */
static void unproject_rational(const Lens *lens, const double *pixel, double *ray) {
    const double *k = lens->k, *B = lens->tilt_back;
    const double u = (pixel[0] - lens->cx) / lens->fx, v = (pixel[1] - lens->cy) / lens->fy;
    const double depth = B[6] * u + B[7] * v + B[8], inverse = depth != 0 ? 1 / depth : 1;
    const double x0 = (B[0] * u + B[1] * v + B[2]) * inverse, y0 = (B[3] * u + B[4] * v + B[5]) * inverse;
    double x = x0, y = y0, error = INFINITY, there[2], J[4];
    for (int i = 0; i < 100 && !(error < 1e-12); i++) {
        const double r2 = x * x + y * y;
        const double back = (1 + ((k[7] * r2 + k[6]) * r2 + k[5]) * r2) / (1 + ((k[4] * r2 + k[1]) * r2 + k[0]) * r2);
        if (back < 0) {
            x = u;
            y = v;
            break;
        }
        const double dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + k[8] * r2 + k[9] * r2 * r2;
        const double dy = k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r2 * r2;
        x = (x0 - dx) * back;
        y = (y0 - dy) * back;
        project_rational(lens, x, y, there, J);
        error = hypot(there[0] - pixel[0], there[1] - pixel[1]);
    }
    ray[0] = x;
    ray[1] = y;
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

/* Inverse of the lower Cholesky factor of A + floor^2; 0 where A is no covariance. */
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
            if (lens->fisheye)
                project_fisheye(lens, ray[0], ray[1], back, J + 4 * c);
            else
                project_rational(lens, ray[0], ray[1], back, J + 4 * c);
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
