/* Registration of a landmark's pattern: Gauss-Newton over corners, point spread, distortion, shading and bleed, the inks
 * eliminated (variable projection).  registration.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "landmark_fit.h"
#include "lanes.h"
#include "linear.h"
#include "mosaic.h"
#include "plane.h"
#include "select.h"

#define SHIFT 2 /* way of the red image from green, and of green from the blue one */
#define ROWS (STATE + 1 + INKS + SHIFT) /* slopes, residual, design, slopes with the shift */
#define DISTORTION 11 /* its place in the state */
#define JETS (JET * INKS * BLOCK)
#define TO_PLACE 100.0 /* fall of chi2 below which no step is looked at before the last round */

/* What is fitted, and how strongly priors hold: ridge, distortion prior, shading prior, bleed prior, prior weight, prior of
 * the shift of colors, which is estimated where they have weights of their own. */
typedef struct {
    Drawing drawing;
    const double *view, *rules;
    const float *at, *values, *variance;
    int64_t n;
    uint32_t open_gaps;
    int quarter, fit_distortion;
    float *scratch;
    const float *cells; /* of a color mosaic, whose values then have weights of their own; or null */
    float color_roots[3][PLACES], *roots;
} Problem;

LMKIT_EXPORT int lmkit_linearize(int64_t n, const float *drawing, const double *view, const float *at,
                                 const float *values, const float *variance, const double *rules,
                                 const double *state, int64_t open_gaps, int64_t quarter, int64_t fit_distortion,
                                 float *scratch, double *normal, double *gradient, double *error);

static int64_t blocks_of(int64_t n)
{
    return (n + BLOCK - 1) / BLOCK;
}

static int in_block(const Problem *p, int64_t b)
{
    int64_t left = p->n - b * BLOCK;
    return left < BLOCK ? (int)left : BLOCK;
}

/* Square roots of the weights into scratch: of blue, green and red, or of all at once where there is no mosaic. */
static void fill_roots(Problem *p)
{
    p->roots = p->scratch + blocks_of(p->n) * (JETS + BLOCK);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        const int count = in_block(p, b);
        float *first = p->roots + b * BLOCK;
        load_root(p->variance + b * BLOCK, count, first);
        if (!p->cells)
            continue;
        block cell;
        load_block(p->cells + b * BLOCK, count, cell);
        for (int c = 2; c >= 0; c--) {
            const float *w = p->color_roots[c];
            const float right = w[1] - w[0], down = w[2] - w[0], both = w[3] - w[2] - right;
            float *root = first + c * blocks_of(p->n) * BLOCK;
            EACH {
                float y = cell[i] >= 2.0f ? 1.0f : 0.0f, x = cell[i] - 2.0f * y;
                root[i] = first[i] * (w[0] + right * x + down * y + both * x * y);
            }
        }
    }
}

static inline const float *roots_of(const Problem *p, int64_t b, int color)
{
    return p->roots + ((p->cells ? color : 0) * blocks_of(p->n) + b) * BLOCK;
}

/* (4,4) gram of the design in scratch, with ridge, as a Cholesky factor. */
typedef struct {
    double factor[INKS * INKS];
} InkNormal;

static int ink_normal(double ridge, const lanes *gram, InkNormal *out)
{
    double trace = 0.0;
    int k = 0;
    for (int i = 0; i < INKS; i++)
        for (int j = 0; j <= i; j++, k++) {
            out->factor[i * INKS + j] = total(gram + k);
            if (i == j)
                trace += out->factor[i * INKS + j];
        }
    for (int i = 0; i < INKS; i++)
        out->factor[i * INKS + i] += ridge * trace / INKS;
    return factor(out->factor, INKS);
}

/* How inks blend, and what is drawn, at a block: out[c], blend[c]; only the values. */
static void draw_values(const block *design, const float *inks, const float *inverse_white, float bleed, block *restrict drawn, block *restrict blend)
{
    for (int c = 0; c < 3; c++) {
        float w = inks[c], r = inks[3 + c], u = inks[6 + c], s = inks[9 + c], iw = inverse_white[c];
        EACH {
            float mean = design[0][i] * w + design[1][i] * r + design[2][i] * u + design[3][i] * s;
            float square = design[0][i] * w * w + design[1][i] * r * r + design[2][i] * u * u + design[3][i] * s * s;
            float b = (square - mean * mean) * iw;
            blend[c][i] = b;
            drawn[c][i] = mean + bleed * b;
        }
    }
}

static void white_inverses(const float *inks, float *inverse)
{
    for (int c = 0; c < 3; c++)
        inverse[c] = 1.0f / (inks[c] > 1e-3f ? inks[c] : 1e-3f);
}

static void solve_inks(const InkNormal *normals, int weighings, lanes (*seen)[INKS], float *inks)
{
    for (int c = 0; c < 3; c++) {
        const InkNormal *normal = normals + (c < weighings ? c : 0);
        double b[INKS];
        for (int k = 0; k < INKS; k++)
            b[k] = total(&seen[c][k]);
        solve_lower(normal->factor, INKS, b);
        solve_upper(normal->factor, INKS, b);
        for (int k = 0; k < INKS; k++)
            inks[3 * k + c] = (float)b[k];
    }
}

/* The inks at their best for designs in scratch (one every `stride` floats). */
static int best_inks(const Problem *p, const double *state, int64_t stride, float *inks)
{
    const int weighings = p->cells ? 3 : 1;
    lanes gram[3][INKS * (INKS + 1) / 2], seen[3][INKS];
    memset(gram, 0, sizeof gram);
    memset(seen, 0, sizeof seen);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        const block *design = (const block *)(p->scratch + b * stride);
        block weighted[INKS], value;
        int count = in_block(p, b);
        for (int c = 0; c < 3; c++) {
            const float *root = roots_of(p, b, c);
            if (c < weighings) {
                for (int k = 0; k < INKS; k++)
                    EACH weighted[k][i] = design[k][i] * root[i];
                for (int i = 0; i < INKS; i++)
                    add_dots(gram[c] + i * (i + 1) / 2, weighted[i], (const block *)weighted, i + 1);
            }
            load_block(p->values + c * p->n + b * BLOCK, count, value);
            EACH value[i] *= root[i];
            add_dots(seen[c], value, (const block *)weighted, INKS);
        }
    }
    InkNormal normals[3];
    for (int c = 0; c < weighings; c++)
        if (!ink_normal(p->rules[0], gram[c], normals + c))
            return 0;
    solve_inks(normals, weighings, seen, inks);
    float bleed = (float)state[14];
    if (bleed == 0.0f)
        return 1;
    float inverse_white[3];
    white_inverses(inks, inverse_white);
    memset(seen, 0, sizeof seen);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        const block *design = (const block *)(p->scratch + b * stride);
        block weighted[INKS], value, drawn[3], blend[3];
        int count = in_block(p, b);
        draw_values(design, inks, inverse_white, bleed, drawn, blend);
        for (int c = 0; c < 3; c++) {
            const float *root = roots_of(p, b, c);
            if (c < weighings)
                for (int k = 0; k < INKS; k++)
                    EACH weighted[k][i] = design[k][i] * root[i];
            load_block(p->values + c * p->n + b * BLOCK, count, value);
            EACH value[i] = (value[i] - bleed * blend[c][i]) * root[i];
            add_dots(seen[c], value, (const block *)weighted, INKS);
        }
    }
    solve_inks(normals, weighings, seen, inks);
    return 1;
}

/* Design of every block into scratch, values only, light included. */
static void fill_designs(const Problem *p, const Plane *plane, int64_t stride)
{
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        block x, y, light;
        Points points;
        Jacobian J;
        int count = in_block(p, b);
        load_block(p->at + b * BLOCK, count, x);
        load_block(p->at + p->n + b * BLOCK, count, y);
        map_block(plane, x, y, &points, &J, light);
        block *design = (block *)(p->scratch + b * stride);
        ink_values(&p->drawing, &points, p->open_gaps, p->quarter, design);
        for (int k = 0; k < INKS; k++)
            EACH design[k][i] *= light[i];
    }
}

/* d homography / d corner coordinate, by central differences. */
static void homography_slopes(const double *view, const double *state, float (*dH)[9], float *H)
{
    double corners[8], plus[9], minus[9];
    relative_corners(view, state, corners);
    homography(corners, view[5], plus);
    for (int k = 0; k < 9; k++)
        H[k] = (float)plus[k];
    const double delta = 1e-3;
    for (int i = 0; i < 8; i++) {
        double kept = corners[i];
        corners[i] = kept + delta;
        homography(corners, view[5], plus);
        corners[i] = kept - delta;
        homography(corners, view[5], minus);
        corners[i] = kept;
        for (int k = 0; k < 9; k++)
            dH[i][k] = (float)((plus[k] - minus[k]) / (2.0 * delta));
    }
}

/* Coverage and slopes of every block into scratch, light included. */
static void draw_jets(const Problem *p, const double *state)
{
    Plane plane = plane_of(p->view, state);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        block x, y, light;
        Points points;
        Jacobian J;
        int count = in_block(p, b);
        load_block(p->at + b * BLOCK, count, x);
        load_block(p->at + p->n + b * BLOCK, count, y);
        map_block(&plane, x, y, &points, &J, light);
        block(*jets)[INKS] = (block(*)[INKS])(p->scratch + b * JETS);
        ink_jets(&p->drawing, &points, p->open_gaps, p->quarter, jets);
        for (int k = 0; k < JET; k++)
            for (int j = 0; j < INKS; j++)
                EACH jets[k][j][i] *= light[i];
    }
}

/* How far distortion, shading and bleed are from what is likely, in squared standard deviations. */
static double prior_of(const Problem *p, const double *state)
{
    const double distortion = state[DISTORTION] / p->rules[1], bleed = state[14] / p->rules[3];
    const double across = state[12] / p->rules[2], along = state[13] / p->rules[2];
    return distortion * distortion + across * across + along * along + bleed * bleed;
}

/* Where slopes with a number of the state lie among the rows of a block: the distortion is last, so that it can be left
 * out; the residual follows. */
static int row_of(int i)
{
    return i < DISTORTION ? i : i == DISTORTION ? STATE - 1 : i - 1;
}

/* Sums of a shift of colors, over the pixels of blue and red. */
typedef struct {
    lanes slopes[SHIFT][STATE + 1], own[SHIFT][SHIFT], seen[3][INKS][SHIFT];
} ShiftSums;

/* Rows of a color of which red lies `sign` times the shift from green: its slopes, and what they have with the others. */
static void add_shift(ShiftSums *sum, const block by_x, const block by_y, float sign, int c, block *rows, int used)
{
    block *own = rows + STATE + 1 + INKS;
    EACH {
        own[0][i] = sign * by_x[i];
        own[1][i] = sign * by_y[i];
    }
    for (int k = 0; k < SHIFT; k++) {
        add_dots(sum->slopes[k], own[k], (const block *)rows, used + 1);
        add_dots(sum->own[k], own[k], (const block *)own, k + 1);
    }
    for (int k = 0; k < INKS; k++)
        add_dots(sum->seen[c][k], rows[STATE + 1 + k], (const block *)own, SHIFT);
}

/* Takes out what a shift of colors explains, beyond the inks; `projected`: share of slopes and residual in the inks.
 * Returns the fall of chi2. */
static double take_out_shift(const ShiftSums *sum, const InkNormal *normals, double (*projected)[STATE + 1][INKS], double precision, int used, double *normal, double *gradient)
{
    double S[SHIFT][STATE], K[SHIFT][SHIFT], g[SHIFT];
    for (int k = 0; k < SHIFT; k++) {
        for (int i = 0; i < STATE; i++)
            S[k][i] = row_of(i) < used ? total(&sum->slopes[k][row_of(i)]) : 0.0;
        g[k] = total(&sum->slopes[k][used]);
        for (int j = 0; j < SHIFT; j++)
            K[k][j] = total(&sum->own[k > j ? k : j][k > j ? j : k]) + (k == j ? precision : 0.0);
    }
    for (int c = 0; c < 3; c += 2) {
        double own[SHIFT][INKS];
        for (int k = 0; k < SHIFT; k++) {
            for (int j = 0; j < INKS; j++)
                own[k][j] = total(&sum->seen[c][j][k]);
            solve_lower(normals[c].factor, INKS, own[k]);
        }
        for (int k = 0; k < SHIFT; k++)
            for (int j = 0; j < INKS; j++) {
                for (int i = 0; i < STATE; i++)
                    S[k][i] -= own[k][j] * projected[c][i][j];
                g[k] -= own[k][j] * projected[c][STATE][j];
                for (int m = 0; m < SHIFT; m++)
                    K[k][m] -= own[k][j] * own[m][j];
            }
    }
    const double det = K[0][0] * K[1][1] - K[0][1] * K[1][0];
    const double inverse[SHIFT][SHIFT] = {{K[1][1] / det, -K[0][1] / det}, {-K[1][0] / det, K[0][0] / det}};
    double fall = 0.0;
    for (int k = 0; k < SHIFT; k++)
        for (int m = 0; m < SHIFT; m++) {
            fall += g[k] * inverse[k][m] * g[m];
            for (int i = 0; i < STATE; i++) {
                gradient[i] -= S[k][i] * inverse[k][m] * g[m];
                for (int j = 0; j <= i; j++)
                    normal[i * STATE + j] -= S[k][i] * inverse[k][m] * S[m][j];
            }
        }
    return fall;
}

/* Error of a state whose jets are in scratch, and its slopes. */
static int assemble(const Problem *p, const double *state, double *normal, double *gradient, double *error)
{
    Plane plane = plane_of(p->view, state);
    float inks[3 * INKS], inverse_white[3], H[9], dH[8][9];
    if (!best_inks(p, state, JETS, inks))
        return 0;
    white_inverses(inks, inverse_white);
    homography_slopes(p->view, state, dH, H);
    float bleed = (float)state[14], inverse_half = (float)(1.0 / p->view[5]);
    const int used = p->fit_distortion ? STATE : STATE - 1; /* slopes; the residual is the row behind them */
    const int weighings = p->cells ? 3 : 1;
    lanes sums[STATE + 1][STATE + 1], seen[3][INKS][STATE + 1], gram[3][INKS * (INKS + 1) / 2];
    memset(sums, 0, sizeof sums);
    memset(seen, 0, sizeof seen);
    memset(gram, 0, sizeof gram);
    ShiftSums shift;
    if (p->cells)
        memset(&shift, 0, sizeof shift);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        block x, y, light, move_x[8], move_y[8], rows[ROWS];
        Points points;
        Jacobian J;
        int count = in_block(p, b);
        load_block(p->at + b * BLOCK, count, x);
        load_block(p->at + p->n + b * BLOCK, count, y);
        map_block(&plane, x, y, &points, &J, light);
        EACH x[i] = 1.0f / (H[6] * points.x[i] + H[7] * points.y[i] + H[8]);
        for (int k = 0; k < 8; k++) {
            const float *m = dH[k];
            EACH {
                float u = points.x[i], v = points.y[i];
                float third = m[6] * u + m[7] * v + m[8];
                move_x[k][i] = (m[0] * u + m[1] * v + m[2] - J.flat_x[i] * third) * x[i];
                move_y[k][i] = (m[3] * u + m[4] * v + m[5] - J.flat_y[i] * third) * x[i];
            }
        }
        const block(*jets)[INKS] = (const block(*)[INKS])(p->scratch + b * JETS);
        for (int c = 0; c < 3; c++) {
            const float *root = roots_of(p, b, c);
            if (c < weighings) {
                for (int k = 0; k < INKS; k++)
                    EACH rows[STATE + 1 + k][i] = jets[0][k][i] * root[i];
                for (int i = 0; i < INKS; i++)
                    add_dots(gram[c] + i * (i + 1) / 2, rows[STATE + 1 + i], (const block *)rows + STATE + 1, i + 1);
            }
            float w = inks[c], r = inks[3 + c], u = inks[6 + c], s = inks[9 + c], iw = inverse_white[c];
            block drawn[JET], blend, value, by_x, by_y;
            load_block(p->values + c * p->n + b * BLOCK, count, value);
            for (int k = 0; k < JET; k++) {
                const block *jet = jets[k];
                float twice = k == 0 ? 1.0f : 2.0f;
                EACH {
                    float mean0 = jets[0][0][i] * w + jets[0][1][i] * r + jets[0][2][i] * u + jets[0][3][i] * s;
                    float mean = jet[0][i] * w + jet[1][i] * r + jet[2][i] * u + jet[3][i] * s;
                    float square = jet[0][i] * w * w + jet[1][i] * r * r + jet[2][i] * u * u + jet[3][i] * s * s;
                    float spread = (square - twice * mean0 * mean) * iw;
                    drawn[k][i] = mean + bleed * spread;
                    if (k == 0)
                        blend[i] = spread;
                }
            }
            EACH {
                by_x[i] = (drawn[1][i] * J.a[i] + drawn[2][i] * J.c[i]) * root[i];
                by_y[i] = (drawn[1][i] * J.b[i] + drawn[2][i] * J.d[i]) * root[i];
                rows[used][i] = (value[i] - drawn[0][i]) * root[i];
            }
            for (int k = 0; k < 8; k++)
                EACH rows[k][i] = move_x[k][i] * by_x[i] + move_y[k][i] * by_y[i];
            EACH {
                float a = J.a[i], bb = J.b[i], cc = J.c[i], d = J.d[i], q = root[i];
                float xx = drawn[3][i], xy = drawn[4][i], yy = drawn[5][i];
                rows[8][i] = -(xx * a * a + xy * a * cc + yy * cc * cc) * q;
                rows[9][i] = -(xx * 2.0f * a * bb + xy * (a * d + bb * cc) + yy * 2.0f * cc * d) * q;
                rows[10][i] = -(xx * bb * bb + xy * bb * d + yy * d * d) * q;
                float lit = drawn[0][i] / light[i] * inverse_half * q;
                rows[11][i] = -lit * points.x[i];
                rows[12][i] = -lit * points.y[i];
                rows[13][i] = -blend[i] * q;
            }
            if (p->fit_distortion)
                EACH rows[STATE - 1][i] = -(by_x[i] * J.radial_x[i] + by_y[i] * J.radial_y[i]);
            for (int k = 0; k <= used; k++)
                add_dots(sums[k], rows[k], (const block *)rows, k + 1);
            for (int k = 0; k < INKS; k++)
                add_dots(seen[c][k], rows[STATE + 1 + k], (const block *)rows, p->cells ? used + 1 : used);
            if (p->cells && c != 1)
                add_shift(&shift, by_x, by_y, (float)(c - 1), c, rows, used);
        }
    }
    /* Variable projection (Kaufman 1975): take out what the inks could explain. */
    InkNormal normals[3];
    for (int c = 0; c < weighings; c++)
        if (!ink_normal(p->rules[0], gram[c], normals + c))
            return 0;
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j <= i; j++) {
            int a = row_of(i), b = row_of(j);
            normal[i * STATE + j] = a < used && b < used ? total(&sums[a > b ? a : b][a > b ? b : a]) : 0.0;
        }
    double projected[3][STATE + 1][INKS];
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k <= STATE; k++) {
            const int row = k < STATE ? row_of(k) : used;
            for (int j = 0; j < INKS; j++)
                projected[c][k][j] = row < used || k == STATE ? total(&seen[c][j][row]) : 0.0;
            solve_lower(normals[c < weighings ? c : 0].factor, INKS, projected[c][k]);
        }
        for (int i = 0; i < STATE; i++)
            for (int j = 0; j <= i; j++)
                for (int k = 0; k < INKS; k++)
                    normal[i * STATE + j] -= projected[c][i][k] * projected[c][j][k];
    }
    for (int j = 0; j < STATE; j++)
        gradient[j] = row_of(j) < used ? total(&sums[used][row_of(j)]) : 0.0;
    double chi2 = total(&sums[used][used]);
    if (p->cells)
        chi2 -= take_out_shift(&shift, normals, projected, p->rules[4] / (p->rules[5] * p->rules[5]), used, normal, gradient);
    double weight = p->rules[4], distortion = 1.0 / (p->rules[1] * p->rules[1]);
    double shading = 1.0 / (p->rules[2] * p->rules[2]), spill = 1.0 / (p->rules[3] * p->rules[3]);
    if (p->fit_distortion) {
        normal[DISTORTION * STATE + DISTORTION] += weight * distortion;
        gradient[DISTORTION] += weight * state[DISTORTION] * distortion;
    } else
        normal[DISTORTION * STATE + DISTORTION] = 1e12;
    for (int k = 12; k < 14; k++) {
        normal[k * STATE + k] += weight * shading;
        gradient[k] += weight * state[k] * shading;
    }
    normal[14 * STATE + 14] += weight * spill;
    gradient[14] += weight * state[14] * spill;
    for (int k = 0; k < 11; k++)
        normal[k * STATE + k] += k < 8 ? 1e-6 : 1e-3;
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j < i; j++)
            normal[j * STATE + i] = normal[i * STATE + j];
    *error = (chi2 + weight * prior_of(p, state)) / (3.0 * (double)p->n);
    return isfinite(*error);
}

static int linearize(const Problem *p, const double *state, double *normal, double *gradient, double *error)
{
    draw_jets(p, state);
    return assemble(p, state, normal, gradient, error);
}

static double mean_side(const double *c)
{
    double sum = 0.0;
    for (int i = 0; i < 4; i++)
        sum += hypot(c[(2 * i + 2) % 8] - c[2 * i], c[(2 * i + 3) % 8] - c[2 * i + 1]);
    return sum / 4.0;
}

/* Convex, clockwise, and not collapsed. */
static int is_sane(const double *c)
{
    double length[4], ex[4], ey[4];
    for (int i = 0; i < 4; i++) {
        ex[i] = c[(2 * i + 2) % 8] - c[2 * i];
        ey[i] = c[(2 * i + 3) % 8] - c[2 * i + 1];
        length[i] = hypot(ex[i], ey[i]);
    }
    for (int i = 0; i < 4; i++) {
        int j = (i + 1) % 4;
        if (!(ex[i] * ey[j] - ey[i] * ex[j] > 0.02 * length[i] * length[j]) || !(length[i] > 2.0))
            return 0;
    }
    return 1;
}

static double clamp(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* The nearest allowed point spread: eigenvalues from low to high. */
static void clamp_spread(double *s, double low, double high)
{
    double mean = 0.5 * (s[0] + s[2]), half = 0.5 * (s[0] - s[2]), radius = sqrt(half * half + s[1] * s[1]);
    double large = clamp(mean + radius, low, high), small = clamp(mean - radius, low, high);
    double middle = 0.5 * (large + small), scale = radius > 0.0 ? 0.5 * (large - small) / radius : 0.0;
    s[0] = middle + scale * half;
    s[2] = middle - scale * half;
    s[1] *= scale;
}

/* state + step, within limits: least and most eigenvalue of the spread, distortion, shading, bleed. */
static void move(const double *state, const double *step, const double *limits, double *out)
{
    for (int i = 0; i < STATE; i++)
        out[i] = state[i] + step[i];
    /* Where edges run along the axes, hardly anything is known of the point spread across them, and a long step there
       spoils the whole. */
    double largest = 0.5 * (state[8] + state[10]);
    out[9] = state[9] + clamp(step[9], -largest, largest);
    clamp_spread(out + 8, limits[0], limits[1]);
    out[11] = clamp(out[11], -limits[2], limits[2]);
    out[12] = clamp(out[12], -limits[3], limits[3]);
    out[13] = clamp(out[13], -limits[3], limits[3]);
    out[14] = clamp(out[14], -limits[4], limits[4]);
}

static Problem problem_of(int64_t n, const float *drawing, const double *view, const float *at, const float *values, const float *variance, const double *rules, int64_t open_gaps, int64_t quarter, int64_t fit_distortion, float *scratch)
{
    Problem p = {read_drawing(drawing), view, rules, at, values, variance, n, (uint32_t)open_gaps, (int)quarter, (int)fit_distortion, scratch, NULL, {{0.0f}}, NULL};
    return p;
}

int lmkit_linearize(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                    const float *variance, const double *rules, const double *state, int64_t open_gaps,
                    int64_t quarter, int64_t fit_distortion, float *scratch, double *normal, double *gradient,
                    double *error)
{
    Problem p = problem_of(n, drawing, view, at, values, variance, rules, open_gaps, quarter, fit_distortion, scratch);
    fill_roots(&p);
    return !linearize(&p, state, normal, gradient, error);
}

/* Error of a state alone, for a quarter of what its slopes cost; the designs in scratch take the place of jets. */
static int error_of(const Problem *p, const double *state, double *error)
{
    Plane plane = plane_of(p->view, state);
    float inks[3 * INKS], inverse_white[3], bleed = (float)state[14];
    fill_designs(p, &plane, INKS * BLOCK);
    if (!best_inks(p, state, INKS * BLOCK, inks))
        return 0;
    white_inverses(inks, inverse_white);
    lanes sum;
    memset(&sum, 0, sizeof sum);
    for (int64_t b = 0; b < blocks_of(p->n); b++) {
        block value, drawn[3], blend[3];
        int count = in_block(p, b);
        draw_values((const block *)(p->scratch + b * INKS * BLOCK), inks, inverse_white, bleed, drawn, blend);
        for (int c = 0; c < 3; c++) {
            const float *root = roots_of(p, b, c);
            load_block(p->values + c * p->n + b * BLOCK, count, value);
            EACH value[i] = (value[i] - drawn[c][i]) * root[i];
            add_dot(&sum, value, value);
        }
    }
    *error = (total(&sum) + p->rules[4] * prior_of(p, state)) / (3.0 * (double)p->n);
    return isfinite(*error);
}

/* negligible: fall of chi2 below which a step is not looked at.  normal: null where nothing needs the slopes of the last
 * state.  *drawn: 1 where the jets in scratch are those of the state; before and behind. */
static int gauss_newton(const Problem *p, const double *limits, double negligible, int64_t iterations, double to_px, double *state, double *normal, double *error, int *drawn)
{
    const int64_t sloped = normal ? iterations : iterations - 1; /* steps after which slopes are needed */
    double own_normal[STATE * STATE];
    normal = normal ? normal : own_normal;
    double gradient[STATE], trial_normal[STATE * STATE], trial_gradient[STATE];
    double damping = 1e-3;
    if (!*drawn)
        draw_jets(p, state);
    *drawn = 1;
    if (!assemble(p, state, normal, gradient, error))
        return 0;
    for (int64_t k = 0; k < iterations; k++) {
        double step[STATE], trial[STATE], trial_error = 0.0, most = 0.0;
        int better = 0;
        for (int attempt = 0; attempt < 4 && !better; attempt++) {
            double A[STATE * STATE];
            memcpy(A, normal, sizeof A);
            for (int i = 0; i < STATE; i++) {
                A[i * STATE + i] *= 1.0 + damping;
                step[i] = -gradient[i];
            }
            if (factor(A, STATE)) {
                solve_lower(A, STATE, step);
                solve_upper(A, STATE, step);
                most = 1e-9;
                for (int i = 0; i < 8; i++)
                    most = fabs(step[i]) > most ? fabs(step[i]) : most;
                /* No corner moves further than a quarter of the side at once. */
                double shorter = 0.25 * mean_side(state) / most;
                if (shorter < 1.0) {
                    for (int i = 0; i < STATE; i++)
                        step[i] *= shorter;
                    most *= shorter;
                }
                move(state, step, limits, trial);
                if (is_sane(trial)) {
                    *drawn = 0;
                    double fall = 0.0;
                    for (int i = 0; i < STATE; i++)
                        fall -= gradient[i] * step[i];
                    /* A last step whose gain is smaller than the noise is taken without another look. */
                    if (attempt == 0 && fall < negligible * *error) {
                        memcpy(state, trial, sizeof trial);
                        return 1;
                    }
                    /* Shorter steps often fail as the first one did, and then need no slopes, unless a shift of colors does. */
                    const int by_slopes = k < sloped && (attempt == 0 || p->cells);
                    better = by_slopes || (error_of(p, trial, &trial_error) && trial_error < *error);
                    if (better && k < sloped)
                        better = linearize(p, trial, trial_normal, trial_gradient, &trial_error) && trial_error < *error;
                }
            }
            if (!better)
                damping *= 10.0;
        }
        if (!better)
            break;
        double gain = 1.0 - trial_error / *error;
        memcpy(state, trial, sizeof trial);
        *error = trial_error;
        if (k >= sloped)
            break;
        memcpy(normal, trial_normal, sizeof trial_normal);
        memcpy(gradient, trial_gradient, sizeof gradient);
        *drawn = 1;
        damping = damping * 0.1 > 1e-6 ? damping * 0.1 : 1e-6;
        if (most < to_px || gain < 1e-5)
            break;
    }
    return 1;
}

/* Weights from designs in scratch, one every `stride` floats; misfit is room for n floats behind them.  inks (12) and
 * misfit_scale: what explains the values best, and the root of the median squared misfit then. */
static int weigh(const Problem *p, const double *state, int64_t stride, float *misfit, float *drawn, float *robust_variance, double *prior_weight, float *inks, double *misfit_scale)
{
    const int64_t n = p->n;
    float inverse_white[3], bleed = (float)state[14];
    if (!best_inks(p, state, stride, inks))
        return 0;
    white_inverses(inks, inverse_white);
    for (int64_t b = 0; b < blocks_of(n); b++) {
        block model[3], blend[3];
        draw_values((const block *)(p->scratch + b * stride), inks, inverse_white, bleed, model, blend);
        for (int i = 0; i < in_block(p, b); i++) {
            int64_t k = b * BLOCK + i;
            float sum = 0.0f;
            for (int c = 0; c < 3; c++) {
                float off = p->values[c * n + k] - model[c][i];
                if (drawn)
                    drawn[c * n + k] = model[c][i];
                sum += off * off;
            }
            /* Squared misfit, twice: the median reorders one of them. */
            robust_variance[k] = misfit[k] = sum / (3.0f * p->variance[k]);
        }
    }
    double squared = median(misfit, n);
    *misfit_scale = sqrt(squared) > 1e-6 ? sqrt(squared) : 1e-6;
    double scale = 2.5 * *misfit_scale;
    float inverse = (float)(1.0 / (scale * scale));
    for (int64_t k = 0; k < n; k++)
        robust_variance[k] = p->variance[k] * (1.0f + robust_variance[k] * inverse);
    *prior_weight = squared / 0.79;
    return 1;
}

int lmkit_robust_weights(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                         const float *variance, const double *rules, const double *state, int64_t open_gaps,
                         int64_t quarter, float *scratch, float *drawn, float *robust_variance,
                         double *prior_weight)
{
    Problem p = problem_of(n, drawing, view, at, values, variance, rules, open_gaps, quarter, 0, scratch);
    Plane plane = plane_of(view, state);
    fill_roots(&p);
    fill_designs(&p, &plane, INKS * BLOCK);
    float *misfit = scratch + blocks_of(n) * INKS * BLOCK, inks[3 * INKS];
    double scale;
    return !weigh(&p, state, INKS * BLOCK, misfit, drawn, robust_variance, prior_weight, inks, &scale);
}

/* Weights of the colors in the cells of a mosaic, from residuals at a state whose jets are in scratch. */
static void weigh_mosaic(const Problem *p, const double *state, const float *inks, double scale, const float *cells, const double *rules, float weights[3][PLACES])
{
    Plane plane = plane_of(p->view, state);
    float inverse_white[3], bleed = (float)state[14], over = (float)(1.0 / scale);
    MosaicEvidence evidence;
    memset(&evidence, 0, sizeof evidence);
    white_inverses(inks, inverse_white);
    for (int64_t b = 0; b < blocks_of(p->n); b += 1 + blocks_of(p->n) / EVIDENT_BLOCKS) {
        block x, y, light, root, value, drawn[3], blend[3], r[3], across[3], down[3];
        Points points;
        Jacobian J;
        int count = in_block(p, b);
        load_block(p->at + b * BLOCK, count, x);
        load_block(p->at + p->n + b * BLOCK, count, y);
        map_block(&plane, x, y, &points, &J, light);
        load_root(p->variance + b * BLOCK, count, root);
        const block(*jets)[INKS] = (const block(*)[INKS])(p->scratch + b * JETS);
        draw_values(jets[0], inks, inverse_white, bleed, drawn, blend);
        for (int c = 0; c < 3; c++) {
            float w = inks[c], q = inks[3 + c], u = inks[6 + c], s = inks[9 + c];
            load_block(p->values + c * p->n + b * BLOCK, count, value);
            EACH {
                float a = J.a[i], bb = J.b[i], cc = J.c[i], d = J.d[i], weight = root[i] * over;
                float xx = jets[3][0][i] * w + jets[3][1][i] * q + jets[3][2][i] * u + jets[3][3][i] * s;
                float xy = jets[4][0][i] * w + jets[4][1][i] * q + jets[4][2][i] * u + jets[4][3][i] * s;
                float yy = jets[5][0][i] * w + jets[5][1][i] * q + jets[5][2][i] * u + jets[5][3][i] * s;
                across[c][i] = (xx * a * a + xy * a * cc + yy * cc * cc) * weight;
                down[c][i] = (xx * bb * bb + xy * bb * d + yy * d * d) * weight;
                r[c][i] = (value[i] - drawn[c][i]) * weight;
            }
        }
        add_mosaic_evidence(r, across, down, cells + b * BLOCK, count, rules, &evidence);
    }
    mosaic_weights(&evidence, rules, weights);
}

int lmkit_register(int64_t n, const float *drawing, const double *view, const float *at, const float *values,
                   const float *variance, const double *rules, const double *limits, int64_t open_gaps,
                   int64_t quarter, int64_t fit_distortion, int64_t rounds, int64_t iterations, double to_px,
                   const float *cells, const double *mosaic, float *scratch, double *state, float *robust_variance, double *prior_weight, double *normal,
                   double *error)
{
    Problem plain = problem_of(n, drawing, view, at, values, variance, rules, open_gaps, quarter, fit_distortion, scratch);
    double weighted_rules[6];
    memcpy(weighted_rules, rules, sizeof weighted_rules);
    memcpy(robust_variance, variance, (size_t)n * sizeof *variance);
    float *misfit = scratch + blocks_of(n) * JETS, inks[3 * INKS];
    double scale = 1.0;
    int drawn = 0;
    for (int64_t round = 0; round < (rounds > 0 ? rounds : 1); round++) {
        if (rounds > 0) {
            if (!drawn)
                draw_jets(&plain, state);
            drawn = 1;
            fill_roots(&plain);
            if (!weigh(&plain, state, JETS, misfit, NULL, robust_variance, weighted_rules + 4, inks, &scale))
                return 1;
        }
        Problem weighted = plain;
        weighted.variance = robust_variance;
        weighted.rules = weighted_rules;
        if (cells && round > 0) {
            weighted.cells = cells;
            weigh_mosaic(&plain, state, inks, scale, cells, mosaic, weighted.color_roots);
        }
        fill_roots(&weighted);
        /* With a mosaic, rounds before the last only bring the drawing to its place. */
        const double negligible = cells && round + 1 < rounds ? TO_PLACE : limits[5];
        double *slopes = round + 1 < rounds ? NULL : normal;
        if (!gauss_newton(&weighted, limits, negligible, iterations, to_px, state, slopes, error, &drawn))
            return 1;
    }
    *prior_weight = weighted_rules[4];
    return 0;
}
