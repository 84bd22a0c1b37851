/* Pixels of a landmark, thinned, in linear light, with their expected variance.  pixel_sampling.py holds the
 * definition. */
#include <stddef.h>

#include "kernels.h"
#include "landmark_fit.h"
#include "plane.h"
#include "select.h"

/* 2^32 over the plastic number and its square: multiples of both fill the plane evenly (Roberts 2018). */
#define ALONG 3242174889u
#define DOWN 2447445414u

/* box: x0, y0, x1, y1, step.  rules: reach (mm), band (mm), pixels at most, share near edges (0: no preference), noise
 * (code value over 255), floor of the variance, half side of the paper (mm).  white and shift may be null.  out_at,
 * values: planes of `capacity`. */

/* x^p for 0 < x <= 1 and p > 0, to 1e-6. */
static inline float power(float x, float p)
{
    return exp_negative(log2_of(x) * p * 0.69314718f);
}

/* First column of row y at which the lattice of this step lies. */
static inline int64_t first_column(int64_t y, int64_t x0, int64_t step)
{
    int64_t along = (step * 618 + 500) / 1000, at = (y * along) % step, off = (at - x0 % step + step) % step;
    return x0 + off;
}

/* Pixels of a row: 0 outside, 1 inside, 2 near an edge of the drawing.  Around the face, a pixel counts as outside if
 * one standard deviation of its point spread reaches beyond the paper: it may show the background. */
static void classify(const Plane *plane, const float *restrict x, const float *restrict y, const float *edges, int64_t squares, int64_t circles, float face, float reach, float paper, float band, float *restrict kind)
{
    Points at;
    Jacobian J;
    block light, square, spread_to, radius, near;
    map_block(plane, x, y, &at, &J, light);
    EACH {
        float ax = fabsf(at.x[i]), ay = fabsf(at.y[i]), far_x = ax + sqrtf(at.sxx[i]), far_y = ay + sqrtf(at.syy[i]);
        square[i] = ax > ay ? ax : ay;
        spread_to[i] = far_x > far_y ? far_x : far_y;
        radius[i] = sqrtf(at.x[i] * at.x[i] + at.y[i] * at.y[i]);
        near[i] = 1e9f;
    }
    for (int64_t k = 0; k < squares; k++)
        EACH {
            float d = fabsf(square[i] - edges[k]);
            near[i] = d < near[i] ? d : near[i];
        }
    for (int64_t k = squares; k < squares + circles; k++)
        EACH {
            float d = fabsf(radius[i] - edges[k]);
            near[i] = d < near[i] ? d : near[i];
        }
    EACH {
        float around = spread_to[i] < paper ? reach : face;
        float inside = square[i] < around ? 1.0f : 0.0f, close = near[i] < band ? 1.0f : 0.0f;
        kind[i] = inside * (1.0f + close);
    }
}

int lmkit_sample_pixels(int64_t height, int64_t width, const uint8_t *image, const float *linear,
                        const float *white, const float *shift, const double *view, const double *state,
                        const int64_t *box, const float *edges, int64_t squares, int64_t circles,
                        const double *rules, uint8_t *kinds, int64_t capacity, float *out_at, float *values,
                        float *light, float *variance, float *cells, float *scratch, int64_t *count)
{
    Plane plane = plane_of(view, state);
    const int64_t x0 = box[0], y0 = box[1], x1 = box[2], y1 = box[3], step = box[4];
    const float face = (float)view[5], reach = (float)rules[0], paper = (float)rules[6], band = (float)rules[1], origin_x = (float)view[0], origin_y = (float)view[1];
    int64_t found[3] = {0, 0, 0}, visited = 0;
    *count = 0;
    if (x0 < 0 || y0 < 0 || x1 > width || y1 > height || step < 1)
        return 1;
    for (int64_t y = y0; y < y1; y++)
        for (int64_t start = first_column(y, x0, step); start < x1; start += BLOCK * step) {
            block px, py, kind;
            int64_t left = (x1 - start + step - 1) / step;
            int n = left < BLOCK ? (int)left : BLOCK;
            EACH {
                px[i] = (float)(start + i * step) - origin_x;
                py[i] = (float)y - origin_y;
            }
            if (shift)
                for (int i = 0; i < n; i++) {
                    px[i] += shift[2 * (y * width + start + i * step)];
                    py[i] += shift[2 * (y * width + start + i * step) + 1];
                }
            classify(&plane, px, py, edges, squares, circles, face, reach, paper, band, kind);
            for (int i = 0; i < n; i++) {
                int k = (int)kind[i];
                kinds[visited++] = (uint8_t)k;
                found[k]++;
            }
        }
    const double most = rules[2], share = rules[3];
    int64_t total = found[1] + found[2];
    /* A pixel is taken where ALONG x + DOWN y, modulo 1, lies below the share that is wanted. */
    double wanted[3] = {0.0, most / (double)(total > 1 ? total : 1), 0.0};
    wanted[2] = wanted[1];
    if ((double)total > most && share > 0.0) {
        wanted[1] = most * (1.0 - share) / (double)(found[1] > 1 ? found[1] : 1);
        wanted[2] = most * share / (double)(found[2] > 1 ? found[2] : 1);
    }
    uint32_t limit[3] = {0, 0, 0};
    for (int k = 1; k < 3; k++)
        limit[k] = wanted[k] < 1.0 ? (uint32_t)(wanted[k] * 4294967295.0) : 4294967295u;
    int64_t n = 0, v = 0;
    for (int64_t y = y0; y < y1; y++)
        for (int64_t x = first_column(y, x0, step); x < x1; x += step) {
            int k = kinds[v++];
            if (!k)
                continue;
            uint32_t at = (uint32_t)x * ALONG + (uint32_t)y * DOWN;
            if (at > limit[k] || n >= capacity)
                continue;
            int64_t pixel = y * width + x;
            out_at[n] = (float)x - origin_x;
            out_at[capacity + n] = (float)y - origin_y;
            if (shift) {
                out_at[n] += shift[2 * pixel];
                out_at[capacity + n] += shift[2 * pixel + 1];
            }
            float lit = white && white[pixel] > 0.0f ? white[pixel] : 1.0f, inverse = 1.0f / lit;
            for (int c = 0; c < 3; c++)
                values[c * capacity + n] = linear[image[3 * pixel + c]] * inverse;
            light[n] = lit;
            cells[n] = (float)((y & 1) * 2 + (x & 1));
            n++;
        }
    *count = n;
    if (n == 0)
        return 0;
    const float noise = (float)rules[4], third = 1.0f / 3.0f;
    for (int64_t i = 0; i < n; i++)
        scratch[i] = variance[i] = (values[i] + values[capacity + i] + values[2 * capacity + i]) * third;
    double bright = 0.015 * quantile(scratch, n, 0.95);
    const float floor = (float)(bright * bright + rules[5]);
    for (int64_t start = 0; start < n; start += BLOCK) {
        int some = n - start < BLOCK ? (int)(n - start) : BLOCK;
        block value, lit;
        load_block(variance + start, some, value);
        load_block(light + start, some, lit);
        EACH {
            float seen = value[i] * lit[i];
            seen = seen > 1e-3f ? seen : 1e-3f;
            /* d linear / d code of a 2.2 gamma. */
            float slope = 2.2f * noise / lit[i];
            value[i] = slope * slope * power(seen, 1.0909091f) + floor;
        }
        for (int i = 0; i < some; i++)
            variance[start + i] = value[i];
    }
    return 0;
}
