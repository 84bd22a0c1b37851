/* A quick look at squares: all sampled on one grid of the landmark's plane, where the coverage of every part is known
 * beforehand; scored, and moved to where the pattern fits better (Gauss-Newton with the drawing's own gradient, after
 * Baker and Matthews 2004).  screening.py holds the definition. */
#include <stddef.h>

#include "hypotheses.h"
#include "kernels.h"
#include "lanes.h"
#include "plane.h"

#define LOOK 15 /* doubles of a look at a square */
#define GATE 30    /* points of the gate: ten on the margin, ten on the border, ten on the ground */
#define MAX_GRID 1024
#define MAX_SIDE 32
#define STILL 0.006 /* of the side */
#define SAME 0.05   /* of the side: two squares are one */
#define SAME_SHARE (1.0 / 256.0) /* shares nearer than this are the same */

/* Tables of one blur: columns (C,K), slopes with x (C,K) and y (C,K), all float; gram (C,C) double. */
typedef struct {
    const float *columns, *slope_x, *slope_y;
    const double *gram;
} Design;

/* One image of the pyramid. */
typedef struct {
    int64_t height, width;
    const uint8_t *image;
} Level;

/* What stays the same for a family; the fields are those of `_Task` in screening.py.  moves (2,8,K); columns: for every
 * blur, coverage and its slopes (3,C,K); grams (S,C,C).  rules: half side (mm), side looked at in full detail (px), blur
 * (px), ridge, damping, furthest move (mm), gate's white over ground and red over blue, least pattern to be moved, least
 * ratio of lights for a shadow, gate's white over border; then white over dark, white over ground, red over blue,
 * contrast and turn, first of squares as found, then of those that were moved. */
typedef struct {
    const float *grid, *moves, *gate, *columns;
    const double *blurs, *grams;
    const int32_t *masks;
    int64_t points, side, gaps, blur_count, codes;
    double rules[21];
} Task;

/* The image: levels (L,3) are height, width and address of the code values; linear (256). */
typedef struct {
    Level levels[16];
    Design designs[16];
    const float *linear, *grid, *moves, *gate;
    const double *rules, *blurs;
    const int32_t *masks;
    int64_t level_count, blur_count, points, side, window, codes;
    int gaps;
    double half, *subsets;
} Screen;

/* window: 0, or side (grid points) of the closing by which shadows are taken out. */
LMKIT_EXPORT int lmkit_screen(const Task *task, const int64_t *levels, int64_t level_count, const float *linear,
                              int64_t count, double *quads, int64_t rounds, int64_t window, double *subsets,
                              double *pattern);

/* Of `count` squares those that look like landmarks, moved to where they fit, into likely (count,8).  shares: of the
 * pattern before and after the moves.  room: 13 doubles for every square, and for its look. */
LMKIT_EXPORT int lmkit_likely_squares(const Task *task, const int64_t *levels, int64_t level_count,
                                      const float *linear, int64_t count, double *quads, const double *shares,
                                      int64_t rounds, int64_t window, double *subsets, double *room, double *pattern,
                                      double *likely, int64_t *found);

/* Colors of a level at points of the landmark's plane, bilinear, in linear light: out (3,n). */
static void sample_grid(const Screen *s, const Level *level, int64_t scale, const double *H, const float *grid, int64_t stride, int64_t n, float *out, int64_t out_stride)
{
    float m[9];
    for (int i = 0; i < 9; i++)
        m[i] = (float)H[i];
    const float inverse = 1.0f / (float)scale, right = (float)(level->width - 1), bottom = (float)(level->height - 1);
    const int64_t w = level->width;
    for (int64_t start = 0; start < n; start += BLOCK) {
        int some = n - start < BLOCK ? (int)(n - start) : BLOCK;
        block x, y;
        load_block(grid + start, some, x);
        load_block(grid + stride + start, some, y);
        EACH {
            float u = x[i], v = y[i], z = 1.0f / (m[6] * u + m[7] * v + m[8]);
            float px = ((m[0] * u + m[1] * v + m[2]) * z + 0.5f) * inverse - 0.5f;
            float py = ((m[3] * u + m[4] * v + m[5]) * z + 0.5f) * inverse - 0.5f;
            px = px > 0.0f ? px : 0.0f;
            py = py > 0.0f ? py : 0.0f;
            x[i] = px < right ? px : right;
            y[i] = py < bottom ? py : bottom;
        }
        for (int i = 0; i < some; i++) {
            int64_t x0 = (int64_t)x[i], y0 = (int64_t)y[i];
            int64_t dx = x0 + 1 < w ? 1 : 0, dy = y0 + 1 < level->height ? w : 0;
            float fx = x[i] - (float)x0, fy = y[i] - (float)y0;
            int64_t at = y0 * w + x0;
            const uint8_t *a = level->image + 3 * at, *b = a + 3 * dx, *c = a + 3 * dy, *d = c + 3 * dx;
            float wa = (1.0f - fx) * (1.0f - fy), wb = fx * (1.0f - fy), wc = (1.0f - fx) * fy, wd = fx * fy;
            for (int k = 0; k < 3; k++)
                out[k * out_stride + start + i] = s->linear[a[k]] * wa + s->linear[b[k]] * wb + s->linear[c[k]] * wc + s->linear[d[k]] * wd;
        }
    }
}

/* Divides samples by the white around them, a closing of their brightness: the least of the largest values around. */
static void take_shadow_out(const Screen *s, float *samples)
{
    const int64_t side = s->side, reach = s->window / 2, K = s->points;
    /* Rows of a length that is known when this is compiled, so that loops along them vectorize. */
    float gray[MAX_SIDE][MAX_SIDE], across[MAX_SIDE][MAX_SIDE];
    for (int64_t i = 0; i < side; i++)
        for (int64_t j = 0; j < side; j++) {
            const float *at = samples + i * side + j;
            gray[i][j] = (at[0] + at[K] + at[2 * K]) * (1.0f / 3.0f);
        }
    for (int pass = 0; pass < 2; pass++) {
        const float sign = pass == 0 ? 1.0f : -1.0f;
        for (int64_t i = 0; i < side; i++) {
            float padded[3 * MAX_SIDE];
            for (int64_t j = 0; j < 3 * MAX_SIDE; j++)
                padded[j] = -1e30f;
            for (int64_t j = 0; j < side; j++)
                padded[MAX_SIDE + j] = sign * gray[i][j];
            for (int64_t j = 0; j < MAX_SIDE; j++)
                across[i][j] = -1e30f;
            for (int64_t k = MAX_SIDE - reach; k <= MAX_SIDE + reach; k++)
                for (int64_t j = 0; j < MAX_SIDE; j++)
                    across[i][j] = padded[k + j] > across[i][j] ? padded[k + j] : across[i][j];
        }
        for (int64_t i = 0; i < side; i++) {
            const int64_t low = i > reach ? i - reach : 0, high = i + reach < side ? i + reach : side - 1;
            float most[MAX_SIDE];
            for (int64_t j = 0; j < MAX_SIDE; j++)
                most[j] = -1e30f;
            for (int64_t k = low; k <= high; k++)
                for (int64_t j = 0; j < MAX_SIDE; j++)
                    most[j] = across[k][j] > most[j] ? across[k][j] : most[j];
            for (int64_t j = 0; j < MAX_SIDE; j++)
                gray[i][j] = sign * most[j];
        }
    }
    for (int c = 0; c < 3; c++)
        for (int64_t i = 0; i < side; i++)
            for (int64_t j = 0; j < side; j++)
                samples[c * K + i * side + j] /= gray[i][j] > 1e-3f ? gray[i][j] : 1e-3f;
}

/* 1, or 0 where no shadow may end on the square, or -1 where it is no landmark. */
static int passes_gate(const Screen *s, const Level *level, int64_t scale, const double *H)
{
    float seen[3 * GATE];
    double inks[9];
    sample_grid(s, level, scale, H, s->gate, GATE, GATE, seen, GATE);
    for (int ink = 0; ink < 3; ink++)
        for (int c = 0; c < 3; c++) {
            double sum = 0.0;
            for (int i = 0; i < GATE / 3; i++)
                sum += (double)seen[c * GATE + ink * (GATE / 3) + i];
            inks[3 * ink + c] = sum / (GATE / 3);
        }
    /* The ground is blue: green and red tell it from white. */
    const double white = inks[0] + inks[1] + inks[2], red = inks[3] + inks[4] + inks[5];
    if (!(white > s->rules[10] * red && inks[1] + inks[2] > s->rules[6] * (inks[7] + inks[8]) && red_over_blue(inks) > s->rules[7]))
        return -1;
    if (s->window == 0)
        return 1;
    /* A shadow that ends on the landmark ends on its margin. */
    float low = 1e30f, high = 0.0f;
    for (int i = 0; i < GATE / 3; i++) {
        float v = seen[i] + seen[GATE + i] + seen[2 * GATE + i];
        low = v < low ? v : low;
        high = v > high ? v : high;
    }
    return (double)high > s->rules[9] * (double)low;
}

static double quad_area(const double *q)
{
    double twice = 0.0;
    for (int i = 0; i < 4; i++)
        twice += q[2 * i] * q[(2 * i + 3) % 8] - q[2 * i + 1] * q[(2 * i + 2) % 8];
    return 0.5 * twice;
}

/* Convex, clockwise, not needle-thin. */
static int well_shaped(const double *q)
{
    double ex[4], ey[4], length[4], longest = 0.0, shortest = 1e30;
    for (int i = 0; i < 4; i++) {
        ex[i] = q[(2 * i + 2) % 8] - q[2 * i];
        ey[i] = q[(2 * i + 3) % 8] - q[2 * i + 1];
        length[i] = sqrt(ex[i] * ex[i] + ey[i] * ey[i]);
        longest = length[i] > longest ? length[i] : longest;
        shortest = length[i] < shortest ? length[i] : shortest;
    }
    for (int i = 0; i < 4; i++) {
        int j = (i + 1) % 4;
        if (!(ex[i] * ey[j] - ey[i] * ex[j] > 0.05 * length[i] * length[j]))
            return 0;
    }
    return shortest > 0.15 * longest && shortest > 3.0;
}

typedef struct {
    double inks[3 * INKS], pattern;
    int turn;
    uint32_t open;
    const Design *design;
} Look;

_Static_assert(sizeof(Look) <= LOOK * sizeof(double), "room for looks");

/* sums[c] += column . samples of channel c, over K points. */
static inline void add_products(lanes *sums, const float *column, const float *samples, int64_t K)
{
    for (int lane = 0; lane < LANES; lane += WIDTH) {
        wide s0 = LOAD(sums[0] + lane), s1 = LOAD(sums[1] + lane), s2 = LOAD(sums[2] + lane);
        for (int64_t k = lane; k < K; k += LANES) {
            wide v = LOAD(column + k);
            s0 += LOAD(samples + k) * v;
            s1 += LOAD(samples + K + k) * v;
            s2 += LOAD(samples + 2 * K + k) * v;
        }
        AT(sums[0] + lane) = s0, AT(sums[1] + lane) = s1, AT(sums[2] + lane) = s2;
    }
}

/* Best hypothesis of samples (3,K); the pattern is 0 where a threshold (white over dark, ...) is not reached. */
static int look(const Screen *s, const Design *design, const float *samples, const double *thresholds, Look *out)
{
    const int C = 9 + s->gaps;
    const int64_t K = s->points;
    double seen[MAX_COLUMNS * 3], energy = 0.0;
    for (int k = 0; k < C; k++) {
        lanes sums[3];
        memset(sums, 0, sizeof sums);
        add_products(sums, design->columns + k * K, samples, K);
        for (int c = 0; c < 3; c++)
            seen[3 * k + c] = total(sums + c);
    }
    for (int c = 0; c < 3; c++) {
        lanes sum;
        memset(&sum, 0, sizeof sum);
        for (int64_t start = 0; start < K; start += BLOCK)
            add_dot(&sum, samples + c * K + start, samples + c * K + start);
        energy += total(&sum);
    }
    Best best;
    out->pattern = 0.0;
    out->design = design;
    if (!best_hypothesis(s->gaps, design->gram, seen, energy, s->masks, (int)s->codes, s->rules[3], s->subsets, &best))
        return 0;
    out->turn = best.turn;
    out->open = (uint32_t)s->masks[best.turn * s->codes + best.code];
    if (!hypothesis_inks(s->gaps, design->gram, seen, out->turn, out->open, best.ridge, out->inks))
        return 0;
    double left = best.left > 1e-9 ? best.left : 1e-9, frame = best.left_by_frame > 1e-9 ? best.left_by_frame : 1e-9;
    double ink[3], contrast = 1e9;
    for (int k = 0; k < 3; k++)
        ink[k] = (out->inks[3 * k] + out->inks[3 * k + 1] + out->inks[3 * k + 2]) / 3.0;
    for (int c = 0; c < 3; c++) {
        double white = out->inks[c] > 1e-3 ? out->inks[c] : 1e-3, share = 1.0 - out->inks[6 + c] / white;
        contrast = share < contrast ? share : contrast;
    }
    double dark = ink[1] > ink[2] ? ink[1] : ink[2], turned = best.left_by_turn > left ? best.left_by_turn : left;
    if (ink[0] > thresholds[0] * dark && ink[0] > thresholds[1] * ink[2] && red_over_blue(out->inks) > thresholds[2] && contrast > thresholds[3] && log(turned / left) > thresholds[4] - 1e-12)
        out->pattern = 1.0 - left / frame;
    return 1;
}

/* One step of Gauss-Newton over the corners, in the landmark's plane: quad moves to where the samples fit better. */
static int align(const Screen *s, const Look *l, const float *samples, const double *H, double *quad)
{
    const int C = 9 + s->gaps;
    const int64_t K = s->points;
    float color[MAX_COLUMNS][3];
    for (int c = 0; c < 3; c++) {
        float white = (float)l->inks[c], blue = (float)l->inks[6 + c];
        for (int k = 0; k < INKS; k++)
            color[k][c] = (float)l->inks[3 * k + c];
        color[4][c] = white - blue;
        for (int t = 0; t < TURNS; t++)
            color[5 + t][c] = t == l->turn ? white - blue : 0.0f;
        for (int g = 0; g < s->gaps; g++)
            color[9 + g][c] = l->open >> g & 1 ? blue - white : 0.0f;
    }
    lanes sums[9 * 10 / 2];
    memset(sums, 0, sizeof sums);
    for (int64_t start = 0; start < K; start += BLOCK)
        for (int c = 0; c < 3; c++) {
            block rows[9], by_x, by_y;
            const float *value = samples + c * K + start;
            EACH {
                rows[8][i] = value[i];
                by_x[i] = by_y[i] = 0.0f;
            }
            for (int k = 0; k < C; k++) {
                float ink = color[k][c];
                if (ink == 0.0f)
                    continue;
                const float *column = l->design->columns + k * K + start;
                const float *x = l->design->slope_x + k * K + start, *y = l->design->slope_y + k * K + start;
                EACH {
                    rows[8][i] -= ink * column[i];
                    by_x[i] += ink * x[i];
                    by_y[i] += ink * y[i];
                }
            }
            for (int p = 0; p < 8; p++) {
                const float *mx = s->moves + p * K + start, *my = s->moves + (8 + p) * K + start;
                EACH rows[p][i] = mx[i] * by_x[i] + my[i] * by_y[i];
            }
            lanes *sum = sums;
            for (int p = 0; p < 9; p++) {
                add_dots(sum, rows[p], (const block *)rows, p + 1);
                sum += p + 1;
            }
        }
    double normal[64], step[8], trace = 0.0;
    const lanes *sum = sums;
    for (int p = 0; p < 9; p++)
        for (int q = 0; q <= p; q++, sum++) {
            double t = total(sum);
            if (p < 8)
                normal[8 * p + q] = normal[8 * q + p] = t;
            else if (q < 8)
                step[q] = -t;
        }
    for (int p = 0; p < 8; p++)
        trace += normal[9 * p];
    for (int p = 0; p < 8; p++)
        normal[9 * p] += s->rules[4] * trace / 8.0 + 1e-12;
    if (!factor(normal, 8))
        return 0;
    solve_lower(normal, 8, step);
    solve_upper(normal, 8, step);
    const double far = s->rules[5], half = s->half, corners[8] = {-half, half, half, half, half, -half, -half, -half};
    for (int i = 0; i < 4; i++) {
        double x = step[2 * i], y = step[2 * i + 1];
        x = corners[2 * i] + (x < -far ? -far : x > far ? far : x);
        y = corners[2 * i + 1] + (y < -far ? -far : y > far ? far : y);
        double z = H[6] * x + H[7] * y + H[8];
        quad[2 * i] = (H[0] * x + H[1] * y + H[2]) / z;
        quad[2 * i + 1] = (H[3] * x + H[4] * y + H[5]) / z;
    }
    return well_shaped(quad);
}

/* The square moved `rounds` times, and its pattern.  seen: the look at it as it was found, taken over where it has a
 * design; else it is written. */
static double screen_one(const Screen *s, double *quad, int64_t rounds, Look *seen)
{
    const double *first = s->rules + 11, *moved = s->rules + 16;
    float samples[3 * MAX_GRID];
    memset(samples, 0, sizeof samples);
    if (!well_shaped(quad))
        return -1.0;
    int still = 0, is_seen = seen->design != NULL;
    for (int64_t round = 0;; round++, is_seen = 0) {
        double side = sqrt(quad_area(quad)), H[9];
        int64_t level = 0;
        while (level + 1 < s->level_count && side / (double)((int64_t)1 << level) > s->rules[1])
            level++;
        homography(quad, s->half, H);
        const Level *at = s->levels + level;
        const int64_t scale = (int64_t)1 << level;
        int passed = round == 0 && !is_seen ? passes_gate(s, at, scale, H) : 1;
        if (passed <= 0)
            return (double)passed;
        double blur = s->rules[2] * 2.0 * s->half / (side / (double)scale), nearest = 1e30;
        const Design *design = s->designs;
        for (int64_t b = 0; b < s->blur_count; b++) {
            double off = fabs(log(s->blurs[b] / blur));
            if (off < nearest) {
                nearest = off;
                design = s->designs + b;
            }
        }
        sample_grid(s, at, scale, H, s->grid, s->points, s->side * s->side, samples, s->points);
        if (s->window > 0)
            take_shadow_out(s, samples);
        Look l = *seen;
        int last = round == rounds || still;
        if (!is_seen && !look(s, design, samples, rounds > 0 && last ? moved : first, &l))
            return 0.0;
        if (round == 0)
            *seen = l;
        if (last)
            return l.pattern;
        if (round == 0 && l.pattern < s->rules[8])
            return 0.0;
        double before[8], most = 0.0;
        memcpy(before, quad, sizeof before);
        if (!align(s, &l, samples, H, quad))
            return 0.0;
        for (int i = 0; i < 8; i++)
            most = fabs(quad[i] - before[i]) > most ? fabs(quad[i] - before[i]) : most;
        /* Where it hardly moves, one more look scores it. */
        still = most < STILL * side;
    }
}

/* An earlier square that passed the gate, with the same corners, from whichever corner on; -1 where there is none. */
static int64_t find_twin(const double *quads, const double *pattern, int64_t k)
{
    const double *q = quads + 8 * k, close = SAME * sqrt(fabs(quad_area(q)));
    const double x = q[0] + q[2] + q[4] + q[6], y = q[1] + q[3] + q[5] + q[7];
    for (int64_t i = 0; i < k; i++) {
        const double *r = quads + 8 * i;
        if (!(pattern[i] >= 0.0 && fabs(r[0] + r[2] + r[4] + r[6] - x) < 4.0 * close && fabs(r[1] + r[3] + r[5] + r[7] - y) < 4.0 * close))
            continue;
        for (int turn = 0; turn < 8; turn += 2) {
            int same = 1;
            for (int j = 0; j < 8 && same; j++)
                same = fabs(r[(j + turn) % 8] - q[j]) < close;
            if (same)
                return i;
        }
    }
    return -1;
}

/* 0 where the task is not of the sizes that there is room for. */
static int begin(const Task *t, const int64_t *levels, int64_t level_count, const float *linear, int64_t window, double *subsets, Screen *s)
{
    const int64_t C = 9 + t->gaps;
    if (level_count > 16 || t->blur_count > 16 || t->points > MAX_GRID || t->points % BLOCK || t->side < 3 || t->side > MAX_SIDE || t->side * t->side > t->points)
        return 0;
    for (int64_t i = 0; i < level_count; i++) {
        const int64_t *l = levels + 3 * i;
        Level level = {l[0], l[1], (const uint8_t *)(intptr_t)l[2]};
        s->levels[i] = level;
    }
    for (int64_t i = 0; i < t->blur_count; i++) {
        const float *columns = t->columns + 3 * i * C * t->points;
        Design design = {columns, columns + C * t->points, columns + 2 * C * t->points, t->grams + i * C * C};
        s->designs[i] = design;
    }
    s->linear = linear, s->grid = t->grid, s->moves = t->moves, s->gate = t->gate;
    s->rules = t->rules, s->blurs = t->blurs, s->masks = t->masks;
    s->level_count = level_count, s->blur_count = t->blur_count, s->points = t->points, s->side = t->side;
    s->window = window, s->codes = t->codes, s->gaps = (int)t->gaps;
    s->half = t->rules[0], s->subsets = subsets;
    return 1;
}

static void screen_all(const Screen *s, int64_t count, double *quads, int64_t rounds, double *pattern)
{
    for (int64_t i = 0; i < count; i++) {
        int64_t twin = rounds == 0 ? find_twin(quads, pattern, i) : -1;
        Look seen = {.design = NULL};
        pattern[i] = twin >= 0 ? -1.0 : screen_one(s, quads + 8 * i, rounds, &seen);
    }
}

int lmkit_screen(const Task *task, const int64_t *levels, int64_t level_count, const float *linear, int64_t count,
                 double *quads, int64_t rounds, int64_t window, double *subsets, double *pattern)
{
    Screen s;
    if (!begin(task, levels, level_count, linear, window, subsets, &s))
        return 1;
    screen_all(&s, count, quads, rounds, pattern);
    return 0;
}

/* Squares whose pattern is at least `share`, in falling order, at most `most` of one place and size; their quads into
 * `kept`, their places in the list at the beginning of `room`: 4 doubles for every square. */
static int64_t best_first(int64_t count, const double *quads, const double *pattern, double share, int64_t most, double *room, double *kept)
{
    double *order = room, *places = room + count;
    int64_t some = 0, chosen = 0;
    for (int64_t i = 0; i < count; i++) {
        if (!(pattern[i] >= share))
            continue;
        int64_t at = some++;
        const double step = floor(pattern[i] / SAME_SHARE);
        for (; at > 0 && floor(pattern[(int64_t)order[at - 1]] / SAME_SHARE) < step; at--)
            order[at] = order[at - 1];
        order[at] = (double)i;
    }
    for (int64_t k = 0; k < some; k++) {
        const double *q = quads + 8 * (int64_t)order[k];
        const double x = (q[0] + q[2] + q[4] + q[6]) / 4.0, y = (q[1] + q[3] + q[5] + q[7]) / 4.0;
        const double side = sqrt(fabs((q[4] - q[0]) * (q[7] - q[3]) - (q[5] - q[1]) * (q[6] - q[2])) / 2.0);
        int64_t same = 0;
        for (int64_t j = 0; j < chosen && same < most; j++) {
            const double *p = places + 3 * j, dx = p[0] - x, dy = p[1] - y, ratio = p[2] / side;
            same += sqrt(dx * dx + dy * dy) < 0.25 * side && ratio > 0.7 && ratio < 1.4;
        }
        if (same >= most)
            continue;
        places[3 * chosen] = x, places[3 * chosen + 1] = y, places[3 * chosen + 2] = side;
        order[chosen] = order[k];
        memcpy(kept + 8 * chosen++, q, 8 * sizeof *q);
    }
    return chosen;
}

int lmkit_likely_squares(const Task *task, const int64_t *levels, int64_t level_count, const float *linear,
                         int64_t count, double *quads, const double *shares, int64_t rounds, int64_t window,
                         double *subsets, double *room, double *pattern, double *likely, int64_t *found)
{
    Screen s;
    if (!begin(task, levels, level_count, linear, window, subsets, &s))
        return 1;
    double *moved = room + 4 * count, *moved_pattern = room + 12 * count;
    Look *looks = (Look *)(room + 13 * count);
    for (int64_t i = 0; i < count; i++) {
        looks[i].design = NULL;
        pattern[i] = find_twin(quads, pattern, i) >= 0 ? -1.0 : screen_one(&s, quads + 8 * i, 0, looks + i);
    }
    const int64_t some = best_first(count, quads, pattern, shares[0], 2, room, moved);
    /* Moves begin with the look that is taken already. */
    for (int64_t i = 0; i < some; i++)
        moved_pattern[i] = screen_one(&s, moved + 8 * i, rounds, looks + (int64_t)room[i]);
    *found = best_first(some, moved, moved_pattern, shares[1], 1, room, likely);
    return 0;
}
