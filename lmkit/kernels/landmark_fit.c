/* The whole fit of one landmark in one call: sampled, decoded, registered, until the code stands; then registered and
 * decoded with all pixels.  detection/register_and_decode.py holds the definition. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "covering.h"
#include "hypotheses.h"
#include "kernels.h"
#include "landmark_fit.h"
#include "lens.h"
#include "linear.h"
#include "plane.h"
#include "shadow_edge.h"

#define HEAD 18 /* of a decoding: turn, code, four energies left, inks */
#define PRIORS 6
#define READ 1   /* phases */
#define FINISH 2
#define CORNERS 8
#define DISTORT_STEPS 6
#define DARKEST 1e-3f /* linear light */
#define LIMITS 6 /* of a registration; the last is the steps' own */

/* Steps of a registration. */
typedef struct {
    int64_t rounds, most;
    double to_px, negligible;
} Steps;

/* What stays the same for all landmarks of an image; the fields are those of `_Fit` in landmark_fit.py. */
typedef struct {
    int64_t height, width;
    const uint8_t *image;
    const float *linear, *white, *shift;
    const Lens *lens;
    const float *drawing, *edges;
    const int32_t *masks;
    int64_t squares, circles, codes, gaps;
    int64_t visited, least_pixels, coarse_pixels, pixels, read_rounds;
    Steps coarse, fine;
    double skew, reach, band, near_share, noise, floor, paper;
    double decoding[9], priors[PRIORS], limits[LIMITS - 1];
    double correlated, turn_margin, pattern, red_over_blue, least_contrast;
    double settled_code, settled_turn, settled_clear;           /* margins once the code stands */
    double least_blur, blur_share, blurred_side; /* where a fit begins */
    double least_error, few_edges, mosaic, growth, full, stretch; /* of the corners, px */
    double channel_weights[3], color_mosaic[4];
} Fit;

/* Pixels in use, planes of n values, and room for the kernels. */
typedef struct {
    float *at, *values, *light, *variance, *cells, *robust, *work;
    uint8_t *kinds;
    double *subsets;
    int64_t n, capacity;
} Pixels;

/* state (15) moves; out: pixels, error and weight of the priors, (15,15) normal matrix, decoding by the plain weights
 * and by the robust ones, corners in the image and their (8,8) covariance; a decoding whose turn is -1 failed.  Returns
 * 1 where nothing is there. */
LMKIT_EXPORT int lmkit_fit_landmark(const Fit *fit, const double *view, int64_t phases, int64_t fit_distortion,
                                    int64_t capacity, float *planes, float *work, uint8_t *kinds, double *subsets,
                                    double *state, double *out);

/* Both phases for `count` squares (count,8); the distortion is fitted where the side is larger than `distortion_side`.
 * The view's origin is not used.  rows (count, width): 1 where a landmark may be, else 0; the state; and
 * what `lmkit_fit_landmark` gives. */
LMKIT_EXPORT int lmkit_fit_landmarks(const Fit *fit, const double *view, int64_t count, const double *quads,
                                     double distortion_side, int64_t capacity, float *planes, float *work,
                                     uint8_t *kinds, double *subsets, int64_t width, double *rows);

/* From a state (15) on: how well the reading of a turn and a code fits, and how well its `rivals` likeliest other codes
 * do, each registered in `most` steps that end at `to_px` or `negligible`, as `Steps` do.  The view's origin is not used.
 * A rival is left out where its margin before that is over `hopeless` and over `by_error` times the reading's error.
 * masks: a copy of the family's, which is used up.  out: pixels, the reading's error and the least of the rivals', -1
 * where none was registered.  Returns 1 where nothing is there.  Definition: detection/rivals.py, rivals_of. */
LMKIT_EXPORT int lmkit_fit_rivals(const Fit *fit, const double *view, int64_t turn, int64_t code, int64_t rivals,
                                  int64_t most, double to_px, double negligible, double hopeless, double by_error,
                                  int64_t capacity, float *planes, float *work, uint8_t *kinds, double *subsets,
                                  int32_t *masks, double *state, double *out);

/* At a state (15): chi2 by which the reading of a turn and a code explains the pixels better than another code behind an
 * object does, and than another code alone; 0 where these pixels are read otherwise.  The view's origin is not used.
 * reach and price: of `CoveringRules`.  results: room for a decoding's head.  Returns 1 where nothing is there.
 * Definition: detection/covering.py, covering_of. */
LMKIT_EXPORT int lmkit_fit_covering(const Fit *fit, const double *view, int64_t turn, int64_t code, double reach,
                                    double price, int64_t capacity, float *planes, float *work, uint8_t *kinds,
                                    double *subsets, const double *state, double *results, double *out);

/* At a state (15), for the reading of a turn and a code: the edge of the light that falls on the landmark, as
 * `lmkit_shadow_edge` finds it in the logarithm of the light.  room: of that, and 6 doubles for every pixel.  out: the edge,
 * then least and largest x and y of the pixels in the image.  Returns 1 where nothing is there.  Definition:
 * detection/registration.py, edge_of_light. */
LMKIT_EXPORT int lmkit_fit_shadow_edge(const Fit *fit, const double *view, int64_t turn, int64_t code,
                                       int64_t directions, const double *normals, int64_t bins, int64_t capacity,
                                       float *planes, float *work, uint8_t *kinds, double *subsets,
                                       const double *state, double *room, double *out);

static double side_of(const double *c)
{
    double sum = 0.0;
    for (int i = 0; i < 4; i++)
        sum += hypot(c[(2 * i + 2) % 8] - c[2 * i], c[(2 * i + 3) % 8] - c[2 * i + 1]);
    return sum / 4.0;
}

/* A pixel without distortion as the guessed lens shows it: the inverse of x + displacement. */
static void distort(const double *view, double distortion, double *at)
{
    const double flat[2] = {at[0] - view[0], at[1] - view[1]};
    double x[2] = {flat[0], flat[1]};
    for (int k = 0; k < DISTORT_STEPS; k++) {
        double out[2], unused[2], J[4];
        displaced(view, distortion, x, out, unused, J);
        const double det = (1.0 + J[0]) * (1.0 + J[3]) - J[1] * J[2], over = 1.0 / (det > 0.05 ? det : 0.05);
        const double off_x = x[0] + out[0] - flat[0], off_y = x[1] + out[1] - flat[1];
        x[0] -= ((1.0 + J[3]) * off_x - J[1] * off_y) * over;
        x[1] -= ((1.0 + J[0]) * off_y - J[2] * off_x) * over;
    }
    at[0] = x[0] + view[0];
    at[1] = x[1] + view[1];
}

/* A pixel without distortion as the known lens shows it, and the slopes of its projection. */
static void through_lens(const Fit *f, double *at, double *slopes)
{
    const Lens *lens = f->lens;
    const double b = (at[1] - lens->cy) / lens->fy, a = (at[0] - lens->cx - f->skew * b) / lens->fx;
    project_ray(lens, a, b, at, slopes);
}

/* The view of a landmark with these corners: its origin is the whole pixel next to their middle. */
static void set_origin(const double *view, const double *corners, double *here)
{
    memcpy(here, view, VIEW * sizeof *here);
    for (int i = 0; i < 2; i++)
        here[i] = nearbyint(0.25 * (corners[i] + corners[2 + i] + corners[4 + i] + corners[6 + i]));
}

/* First and last pixels of the landmark and its margin, within the image; 0 where it is not there. */
static int bounding_box(const Fit *f, const double *view, const double *state, int64_t *box)
{
    double H[9], x0 = 1e30, x1 = -1e30, y0 = 1e30, y1 = -1e30;
    const double far = f->reach, larger = 10.0 * (double)(f->height > f->width ? f->height : f->width);
    homography(state, view[5], H);
    for (int k = 0; k < 4; k++) {
        double x = k == 0 || k == 3 ? -far : far, y = k < 2 ? far : -far, w = H[6] * x + H[7] * y + H[8];
        if (!(w > 0.0))
            return 0;
        double at[2] = {(H[0] * x + H[1] * y + H[2]) / w, (H[3] * x + H[4] * y + H[5]) / w};
        if (!(fabs(at[0]) < larger && fabs(at[1]) < larger))
            return 0;
        if (state[11] != 0.0)
            distort(view, state[11], at);
        if (f->lens) {
            double slopes[4];
            through_lens(f, at, slopes);
            if (!(fabs(at[0]) < larger && fabs(at[1]) < larger))
                return 0;
        }
        x0 = at[0] < x0 ? at[0] : x0, x1 = at[0] > x1 ? at[0] : x1;
        y0 = at[1] < y0 ? at[1] : y0, y1 = at[1] > y1 ? at[1] : y1;
    }
    const double ends[4] = {floor(x0), floor(y0), ceil(x1) + 1.0, ceil(y1) + 1.0};
    for (int k = 0; k < 2; k++) {
        int64_t size = k == 0 ? f->width : f->height;
        box[k] = ends[k] > 0.0 ? (int64_t)ends[k] : 0;
        box[2 + k] = ends[2 + k] < (double)size ? (int64_t)ends[2 + k] : size;
    }
    return box[2] - box[0] >= 6 && box[3] - box[1] >= 6;
}

/* The next step at which pixels are taken evenly; EVEN_STEPS in pixel_sampling.py. */
static int64_t even_step(int64_t step)
{
    static const int64_t even[] = {1, 2, 3, 5, 8, 11, 12, 15, 18, 21, 23, 29, 34, 39, 50, 59, 76, 98, 127, 143, 161, 209, 227, 275, 322, 390, 490, 595};
    for (size_t k = 0; k < sizeof even / sizeof *even; k++)
        if (even[k] >= step)
            return even[k];
    return step;
}

/* No pixels yet. */
static Pixels room_for_pixels(int64_t capacity, float *planes, float *work, uint8_t *kinds, double *subsets)
{
    return (Pixels){.at = planes, .robust = planes + 8 * capacity, .work = work, .kinds = kinds, .subsets = subsets, .capacity = capacity};
}

/* Pixels where the pattern now lies; 0 where too little of it lies in the image. */
static int take(const Fit *f, const double *view, const double *state, int64_t at_most, double near_share, Pixels *p)
{
    int64_t box[5];
    if (!bounding_box(f, view, state, box))
        return 0;
    box[4] = even_step((box[2] - box[0]) * (box[3] - box[1]) / (f->visited * at_most));
    const double rules[7] = {f->reach, f->band / side_of(state), (double)at_most, near_share, f->noise, f->floor, f->paper};
    const int64_t room = at_most + at_most / 5 + 64, c = room < p->capacity ? room : p->capacity;
    float *planes = p->at;
    if (lmkit_sample_pixels(f->height, f->width, f->image, f->linear, f->white, f->shift, view, state, box, f->edges, f->squares, f->circles, rules, p->kinds, c, planes, planes + 2 * c, planes + 5 * c, planes + 6 * c, planes + 7 * c, p->robust, &p->n))
        return 0;
    const int64_t n = p->n;
    for (int64_t k = 1; k < 8; k++)
        memmove(planes + k * n, planes + k * c, (size_t)n * sizeof *planes);
    p->values = planes + 2 * n;
    p->light = planes + 5 * n;
    p->variance = planes + 6 * n;
    p->cells = planes + 7 * n;
    return n >= f->least_pixels;
}

/* Decodes into out; its turn is -1 where the pixels do not determine the inks. */
static void read_code(const Fit *f, const double *view, const double *state, const Pixels *p, const float *variance, int wanted, double *out)
{
    if (decode_pixels(p->n, f->drawing, view, p->at, p->values, variance, state, f->masks, f->codes, f->decoding, wanted, p->work, p->subsets, out))
        out[0] = -1.0;
}

/* Log likelihood ratio of what another reading and the likeliest one leave. */
static double margin(const Fit *f, const double *decoded, double other, int64_t n)
{
    double left = decoded[2] > 1e-9 ? decoded[2] : 1e-9, ratio = other > left ? other / left : 1.0;
    return 3.0 * (double)n / f->correlated / 2.0 * log(ratio);
}

/* Worth going on: far looser than what is accepted in the end. */
static int is_promising(const Fit *f, const double *decoded, int64_t n)
{
    if (decoded[0] < 0.0)
        return 0;
    const double *inks = decoded + 6;
    double left = decoded[2] > 1e-9 ? decoded[2] : 1e-9, frame = decoded[5] > 1e-9 ? decoded[5] : 1e-9;
    if (!(margin(f, decoded, decoded[4], n) > f->turn_margin && 1.0 - left / frame > f->pattern))
        return 0;
    double white = inks[0] + inks[1] + inks[2], ground = inks[6] + inks[7] + inks[8];
    double contrast = white / (ground > 1e-6 ? ground : 1e-6);
    return red_over_blue(inks) > f->red_over_blue && contrast > f->least_contrast;
}

/* Worth the last steps; a shadow that is not yet sharp costs margins, so that nothing is said of it. */
static int is_settled(const Fit *f, const double *decoded, int64_t n)
{
    double turn = margin(f, decoded, decoded[4], n);
    return f->white || turn > f->settled_clear || (turn > f->settled_turn && margin(f, decoded, decoded[3], n) > f->settled_code);
}

static void limits_of(const Fit *f, double negligible, double *limits)
{
    memcpy(limits, f->limits, sizeof f->limits);
    limits[LIMITS - 1] = negligible;
}

/* cells: of the color mosaic, or null where it does not count.  normal: or null, where nothing needs it. */
static int fit_step(const Fit *f, const double *view, const Steps *steps, int64_t fit_distortion, const double *decoded, const Pixels *p, const float *cells, double *state, double *normal, double *out)
{
    int64_t turn = (int64_t)decoded[0], code = (int64_t)decoded[1], open = f->masks[turn * f->codes + code];
    double limits[LIMITS];
    limits_of(f, steps->negligible, limits);
    return !lmkit_register(p->n, f->drawing, view, p->at, p->values, p->variance, f->priors, limits, open, turn, fit_distortion, steps->rounds, steps->most, steps->to_px, cells, f->color_mosaic, p->work, state, p->robust, out + 2, normal, out + 1);
}

static void weigh_channels(const Fit *f, Pixels *p)
{
    for (int c = 0; c < 3; c++) {
        const float weight = (float)f->channel_weights[c];
        float *values = p->values + c * p->n;
        for (int64_t i = 0; i < p->n; i++)
            values[i] *= weight;
    }
}

/* Corners as the image shows them, and their (8,12) slopes with the beginning of the state. */
static void seen_corners(const Fit *f, const double *view, const double *state, int64_t fit_distortion, double *corners, double (*J)[12])
{
    const double distortion = state[11];
    for (int i = 0; i < CORNERS; i++)
        for (int j = 0; j < 12; j++)
            J[i][j] = i == j ? 1.0 : 0.0;
    memcpy(corners, state, CORNERS * sizeof *corners);
    for (int i = 0; i < CORNERS; i += 2) {
        double *at = corners + i;
        if (f->lens) {
            const Lens *lens = f->lens;
            double slopes[4];
            through_lens(f, at, slopes);
            for (int r = 0; r < 2; r++) {
                J[i + r][i] = slopes[2 * r] / lens->fx;
                J[i + r][i + 1] = (slopes[2 * r + 1] - slopes[2 * r] * f->skew / lens->fx) / lens->fy;
            }
            continue;
        }
        if (!fit_distortion)
            continue;
        if (distortion != 0.0)
            distort(view, distortion, at);
        /* d flat / d seen = 1 + the displacement's slopes. */
        const double x[2] = {at[0] - view[0], at[1] - view[1]};
        double out[2], by_distortion[2], S[4];
        displaced(view, distortion, x, out, by_distortion, S);
        const double det = (1.0 + S[0]) * (1.0 + S[3]) - S[1] * S[2];
        J[i][i] = (1.0 + S[3]) / det, J[i][i + 1] = -S[1] / det;
        J[i + 1][i] = -S[2] / det, J[i + 1][i + 1] = (1.0 + S[0]) / det;
        for (int r = 0; r < 2; r++)
            J[i + r][11] = -(J[i + r][i] * by_distortion[0] + J[i + r][i + 1] * by_distortion[1]);
    }
}

/* From the covariance that residuals let expect to the one with the camera's processing, which makes landmarks wider
 * and higher (registration.py: with_processing). */
static void add_processing(const Fit *f, const double *corners, double *covariance)
{
    double offset[CORNERS], middle[2] = {0.0, 0.0}, length = 0.0, variance = 0.0;
    for (int i = 0; i < CORNERS; i++) {
        middle[i % 2] += 0.25 * corners[i];
        variance += covariance[CORNERS * i + i] / CORNERS;
    }
    for (int i = 0; i < CORNERS; i++) {
        offset[i] = corners[i] - middle[i % 2];
        length += offset[i] * offset[i];
    }
    const double growth = f->growth * fmin(sqrt(variance) / f->full, 1.0);
    const double weight = 2.0 * f->stretch * f->stretch * variance / length;
    for (int i = 0; i < CORNERS; i++)
        for (int j = 0; j < CORNERS; j++) {
            const double stretch = (i - j) % 2 ? 0.0 : weight * offset[i] * offset[j];
            double *at = covariance + CORNERS * i + j;
            *at = growth * (*at + stretch) + (i == j ? f->least_error * f->least_error : 0.0);
        }
}

/* Corners in the image and their (8,8) covariance; 0 where the normal matrix is singular. */
static int place_corners(const Fit *f, const double *view, const double *state, const double *normal, double error, int64_t fit_distortion, double *corners, double *covariance)
{
    double J[CORNERS][12], L[STATE * STATE], half[CORNERS][STATE], aligned = 0.0;
    seen_corners(f, view, state, fit_distortion, corners, J);
    memcpy(L, normal, sizeof L);
    if (!factor(L, STATE))
        return 0;
    for (int i = 0; i < CORNERS; i++) {
        for (int j = 0; j < STATE; j++)
            half[i][j] = j < 12 ? J[i][j] : 0.0;
        solve_lower(L, STATE, half[i]);
    }
    for (int i = 0; i < CORNERS; i += 2) {
        double dx = fabs(corners[(i + 2) % CORNERS] - corners[i]), dy = fabs(corners[(i + 3) % CORNERS] - corners[i + 1]);
        double far = (dx < dy ? dx : dy) / f->mosaic;
        aligned += 0.25 / (1.0 + far * far);
    }
    const double few = f->few_edges / side_of(corners), scale = error * f->correlated * (1.0 + aligned * few * few);
    for (int i = 0; i < CORNERS; i++)
        for (int j = 0; j < CORNERS; j++) {
            double sum = 0.0;
            for (int k = 0; k < STATE; k++)
                sum += half[i][k] * half[j][k];
            covariance[CORNERS * i + j] = scale * sum;
        }
    add_processing(f, corners, covariance);
    return 1;
}

int lmkit_fit_landmark(const Fit *f, const double *view, int64_t phases, int64_t fit_distortion, int64_t capacity,
                       float *planes, float *work, uint8_t *kinds, double *subsets, double *state, double *out)
{
    Pixels p = room_for_pixels(capacity, planes, work, kinds, subsets);
    const int64_t decoding = HEAD + 2 + 2 * (2 + f->gaps);
    double *plain = out + 3 + STATE * STATE, *robust = plain + decoding, *corners = robust + decoding;
    /* While the code may still change, its parts are of no use. */
    const int at_first = phases & FINISH ? 0 : PARTS;
    if (phases & READ) {
        if (!take(f, view, state, f->coarse_pixels, 0.0, &p))
            return 1;
        read_code(f, view, state, &p, p.variance, at_first, plain);
        if (!is_promising(f, plain, p.n))
            return 1;
        for (int64_t k = 0; k < f->read_rounds && plain[0] >= 0.0; k++) {
            const double turn = plain[0], code = plain[1];
            if (!fit_step(f, view, &f->coarse, 0, plain, &p, NULL, state, NULL, out) || !take(f, view, state, f->coarse_pixels, 0.0, &p))
                return 1;
            read_code(f, view, state, &p, p.variance, at_first, plain);
            if (plain[0] == turn && plain[1] == code)
                break;
        }
        if (!is_promising(f, plain, p.n) || !is_settled(f, plain, p.n))
            return 1;
    }
    if (phases & FINISH) {
        if (!take(f, view, state, f->pixels, f->near_share, &p))
            return 1;
        weigh_channels(f, &p);
        if (!fit_step(f, view, &f->fine, fit_distortion, plain, &p, p.cells, state, out + 3, out))
            return 1;
        read_code(f, view, state, &p, p.variance, PARTS, plain);
        /* Only its margins count. */
        read_code(f, view, state, &p, p.robust, SAME_COLUMNS, robust);
        if (!place_corners(f, view, state, out + 3, out[1], fit_distortion, corners, corners + CORNERS))
            return 1;
    }
    out[0] = (double)p.n;
    return 0;
}

int lmkit_fit_landmarks(const Fit *f, const double *view, int64_t count, const double *quads, double distortion_side,
                        int64_t capacity, float *planes, float *work, uint8_t *kinds, double *subsets, int64_t width,
                        double *rows)
{
    double here[VIEW];
    for (int64_t k = 0; k < count; k++) {
        const double *quad = quads + CORNERS * k;
        double *row = rows + width * k, *state = row + 1, side = side_of(quad);
        for (int i = 0; i < STATE; i++)
            state[i] = i < CORNERS ? quad[i] : 0.0;
        set_origin(view, quad, here);
        /* The blur starts generous, so that a wrong corner still feels its edge. */
        double blur = f->blur_share * (side < f->blurred_side ? side : f->blurred_side);
        blur = blur > f->least_blur ? blur : f->least_blur;
        state[8] = state[10] = blur * blur;
        row[0] = !lmkit_fit_landmark(f, here, READ | FINISH, side > distortion_side, capacity, planes, work, kinds, subsets, state, state + STATE);
    }
    return 0;
}

static void leave_out(int32_t *masks, int64_t codes, int64_t code)
{
    for (int64_t k = 0, to = 0; k < TURNS * codes; k++)
        if (k % codes != code)
            masks[to++] = masks[k];
}

int lmkit_fit_rivals(const Fit *f, const double *view, int64_t turn, int64_t code, int64_t rivals, int64_t most,
                     double to_px, double negligible, double hopeless, double by_error, int64_t capacity, float *planes,
                     float *work, uint8_t *kinds, double *subsets, int32_t *masks, double *state, double *out)
{
    Pixels p = room_for_pixels(capacity, planes, work, kinds, subsets);
    double here[VIEW];
    set_origin(view, state, here);
    if (!take(f, here, state, f->coarse_pixels, f->near_share, &p))
        return 1;
    weigh_channels(f, &p);
    double limits[LIMITS];
    limits_of(f, negligible, limits);
    double weight, error, moved[STATE], decoded[HEAD];
    int64_t codes = f->codes, open = masks[turn * codes + code];
    out[0] = (double)p.n;
    out[1] = 1.0;
    out[2] = -1.0;
    read_code(f, here, state, &p, p.variance, 0, decoded);
    const double far = fmax(hopeless, by_error * decoded[2] / (3.0 * (double)p.n));
    if (decoded[0] == (double)turn && decoded[1] == (double)code && fmin(margin(f, decoded, decoded[3], p.n), margin(f, decoded, decoded[4], p.n)) > far)
        return 0;
    if (lmkit_register(p.n, f->drawing, here, p.at, p.values, p.variance, f->priors, limits, open, turn, 0, 0, most, to_px, NULL, NULL, p.work, state, p.robust, &weight, NULL, &error))
        return 1;
    const double per_log = 3.0 * (double)p.n / f->correlated / 2.0, own = error > 1e-9 ? error : 1e-9;
    out[1] = own;
    Moments m;
    moments_of_pixels(p.n, f->drawing, here, p.at, p.values, p.variance, state, 0, p.work, &m);
    const double energy = m.square[0] + m.square[4] + m.square[8];
    for (int64_t k = 0; k < rivals && codes > 1; k++) {
        Best best;
        leave_out(masks, codes--, code);
        if (!best_hypothesis((int)f->gaps, m.gram, m.seen, energy, masks, (int)codes, f->decoding[0], p.subsets, &best))
            break;
        turn = best.turn, code = best.code;
        if (per_log * log(best.left / (3.0 * (double)p.n * own)) > far)
            break;
        memcpy(moved, state, sizeof moved);
        if (lmkit_register(p.n, f->drawing, here, p.at, p.values, p.variance, f->priors, limits, masks[turn * codes + code], turn, 0, 0, most, to_px, NULL, NULL, p.work, moved, p.robust, &weight, NULL, &error))
            break;
        out[2] = out[2] < 0.0 || error < out[2] ? error : out[2];
        if (out[2] < own)
            break;
    }
    return 0;
}

int lmkit_fit_covering(const Fit *f, const double *view, int64_t turn, int64_t code, double reach, double price,
                       int64_t capacity, float *planes, float *work, uint8_t *kinds, double *subsets, const double *state,
                       double *results, double *out)
{
    Pixels p = room_for_pixels(capacity, planes, work, kinds, subsets);
    double here[VIEW];
    set_origin(view, state, here);
    if (!take(f, here, state, f->pixels, f->near_share, &p))
        return 1;
    weigh_channels(f, &p);
    read_code(f, here, state, &p, p.variance, 0, results);
    out[0] = out[1] = 0.0;
    if (results[0] != (double)turn || results[1] != (double)code)
        return 0;
    const double *r = f->decoding;
    const OcclusionRules hiding = {r[2], r[3], r[4], r[5], r[6], r[7], r[8]};
    const Plane plane = plane_of(here, state);
    const int gaps = (int)f->gaps;
    float *scratch = p.work + (p.n + BLOCK) * (9 + gaps);
    const int32_t *masks = f->masks + turn * f->codes;
    covering(p.n, gaps, p.at, p.values, p.variance, &plane, here[5], &hiding, reach, price, results + 6, (int)turn, (uint32_t)masks[code], masks, f->codes, p.work, scratch, (uint32_t *)p.subsets, out);
    return 0;
}

int lmkit_fit_shadow_edge(const Fit *f, const double *view, int64_t turn, int64_t code, int64_t directions,
                          const double *normals, int64_t bins, int64_t capacity, float *planes, float *work,
                          uint8_t *kinds, double *subsets, const double *state, double *room, double *out)
{
    Pixels p = room_for_pixels(capacity, planes, work, kinds, subsets);
    if (!take(f, view, state, f->coarse_pixels, 0.0, &p))
        return 1;
    const int64_t n = p.n;
    double *at = room, *light = at + 2 * n, *weights = light + n, prior_weight;
    float *drawn = (float *)(weights + n);
    if (lmkit_robust_weights(n, f->drawing, view, p.at, p.values, p.variance, f->priors, state, f->masks[turn * f->codes + code], turn, p.work, drawn, p.robust, &prior_weight))
        return 1;
    double *low = out + 4, *high = out + 6;
    low[0] = low[1] = INFINITY, high[0] = high[1] = -INFINITY;
    for (int64_t i = 0; i < n; i++) {
        const float expected = (drawn[i] + drawn[n + i] + drawn[2 * n + i]) / 3.0f;
        const float seen = (p.values[i] + p.values[n + i] + p.values[2 * n + i]) / 3.0f;
        const double bright = (double)(expected > DARKEST ? expected : DARKEST);
        light[i] = log((double)(seen > DARKEST ? seen : DARKEST) / bright * (double)p.light[i]);
        weights[i] = bright * bright;
        double here[2] = {(double)p.at[i] + view[0], (double)p.at[n + i] + view[1]}, slopes[4];
        if (f->lens)
            through_lens(f, here, slopes);
        for (int k = 0; k < 2; k++) {
            at[2 * i + k] = here[k];
            low[k] = here[k] < low[k] ? here[k] : low[k];
            high[k] = here[k] > high[k] ? here[k] : high[k];
        }
    }
    return lmkit_shadow_edge(n, at, light, weights, directions, normals, bins, room + 6 * capacity, out);
}
