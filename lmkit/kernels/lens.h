/* A camera, and the pixel of a ray.  Lens models are OpenCV's; lens.py holds the definition. */
#ifndef LMKIT_LENS_H
#define LMKIT_LENS_H

#include <math.h>
#include <stdint.h>

#define NUMBERS 14 /* distortion coefficients in OpenCV's order, the unused ones zero */

/* A camera; the fields are those of `Lens` in lens.py. */
typedef struct {
    int64_t fisheye;
    double fx, fy, cx, cy, k[NUMBERS], tilt[9], tilt_back[9];
} Lens;

/* Pixel of a ray, and (2,2) derivative. */
static inline void project_fisheye(const Lens *lens, double a, double b, double *pixel, double *J) {
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

static inline void project_rational(const Lens *lens, double a, double b, double *pixel, double *J) {
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

static inline void project_ray(const Lens *lens, double a, double b, double *pixel, double *J) {
    if (lens->fisheye)
        project_fisheye(lens, a, b, pixel, J);
    else
        project_rational(lens, a, b, pixel, J);
}

#endif
