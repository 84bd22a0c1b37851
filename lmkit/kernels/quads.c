/* Squares darker than their surroundings: local threshold, contours with sub-pixel crossings, corners, four lines.
 * quads.py holds the definition of what comes out. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "kernels.h"
#include "plane.h"

#define CELL 4
#define DARK 1 /* flags of a pixel */
#define VISITED 2
#define BEGINS 4 /* dark, its left neighbor is not, and the step between them is large */
#define AROUND 16 /* four bits for what is dark around the upper left corner: upper left and right, lower left and right */
#define WIDEST 15 /* largest window whose sum fits into 16 bits */
#define BANDS 24 /* rows from which an image's changes are known */
#define STRETCHES 16 /* a polygon of more sides is no square with a hidden part */
#define LONGEST 6
#define IN_TURN 10 /* longest stretches of a strip, of which four in turn are a square's sides */
#define STRIP_LENGTH 7.0 /* least length of a strip's outline, of the side from which squares are completed */
#define STRIP_BROAD 0.013 /* most area within a strip over its outline's squared length */
#define STRIP_TURNS 1.3 /* least and most length of its outline, of that of the box around it */
#define STRIP_WINDS 2.05
#define EVEN 0.38 /* least distance of a corner from the diagonal beside it, of both together */
#define FULL 0.72 /* least share of its hull that lies between the corners of a square */
#define ROUND 0.003 /* least area over the squared number of pixel sides: 1/16 for a square */

/* rules: least side (px), darker (share of the local mean), longest contour, side from which hidden parts are completed
 * (px), how far a straight stretch may bend (share of the outline); the step at which an outline begins: so many times the
 * usual change between neighbors, but at least and at most so many gray levels. */
typedef struct {
    double least_side, darker, completed_side, straight, step_per_change, least_step, most_step;
    int64_t longest;
} QuadRules;

/* An outline's points, in order, clockwise.  Behind the n-th the last one is repeated, so that loops run over whole
 * vectors. */
typedef struct {
    const float *x, *y;
    int64_t n;
} Outline;

#define PAD 16
#define PADDED(n) (((n) + PAD - 1) & ~(int64_t)(PAD - 1))

static double length_of(double x, double y)
{
    return sqrt(x * x + y * y);
}

/* where (where_height,where_width): cells of an image with `halvings` fewer halvings than the plane (more if
 * negative), or null.  level: halvings of the plane; corners are in pixels of the image before them. */
LMKIT_EXPORT int lmkit_dark_quads(int64_t height, int64_t width, const uint8_t *plane, const uint8_t *where,
                                  int64_t where_height, int64_t where_width, int64_t halvings, int64_t level,
                                  int64_t window, const double *rules, int16_t *field, uint8_t *flags,
                                  uint16_t *sums, uint16_t *wide, float *points, int32_t *runs, int64_t capacity,
                                  float *quads, double *corners, int64_t *count);
LMKIT_EXPORT int lmkit_where_to_look(int64_t height, int64_t width, const uint8_t *image, double offset,
                                     const double *least, int64_t dilate, float *rows, float *cells,
                                     uint8_t *where);

/* Median change between horizontal neighbors, in gray levels. */
static int usual_change(const uint8_t *plane, int64_t height, int64_t width)
{
    int32_t counts[256] = {0};
    int64_t bands = height < BANDS ? height : BANDS, below = 0, half = (bands * (width - 1) + 1) / 2;
    for (int64_t b = 0; b < bands; b++) {
        const uint8_t *row = plane + (2 * b + 1) * height / (2 * bands) * width;
        for (int64_t x = 1; x < width; x++)
            counts[row[x] > row[x - 1] ? row[x] - row[x - 1] : row[x - 1] - row[x]]++;
    }
    int change = 0;
    for (below = counts[0]; below < half; below += counts[change])
        change++;
    return change;
}

static double step_to_begin(const uint8_t *plane, int64_t height, int64_t width, const QuadRules *rules)
{
    double step = rules->step_per_change * usual_change(plane, height, width);
    step = step > rules->least_step ? step : rules->least_step;
    return step < rules->most_step ? step : rules->most_step;
}

/* Flags of a row of n pixels, those of the row above it given; step: of the field.  Numbers of 16 bits throughout, and
 * masks in place of conditions, so that it vectorizes. */
static void mark_dark(const int16_t *restrict field, int64_t n, int16_t step, const uint8_t *restrict above, uint8_t *restrict flags)
{
    flags[0] = field[0] < 0 ? DARK : 0;
    for (int64_t x = 1; x < n; x++) {
        const int16_t here = field[x], left = field[x - 1];
        const int16_t dark = here >> 15, beside = left >> 15, falls = (int16_t)(here + step - left - 1) >> 15;
        /* What is dark above lies one row higher in the flags of the pixel above. */
        const int16_t over = (int16_t)(above[x] >> 2 & 3 * AROUND);
        flags[x] = (uint8_t)((dark & (DARK | AROUND << 3)) | (beside & AROUND << 2) | (dark & ~beside & falls & BEGINS) | over);
    }
}

/* Means over windows in 16 bits: a sum, shifted to the left, times the share of its number of pixels, without the lower
 * 16 bits. */
typedef struct {
    int shift;
    uint32_t shares[WIDEST * WIDEST + 1];
} Means;

static void fill_means(int64_t window, double darker, Means *m)
{
    m->shift = 0;
    while (255 * window * window << (m->shift + 1) <= 65535)
        m->shift++;
    for (int64_t pixels = 1; pixels <= window * window; pixels++)
        m->shares[pixels] = (uint32_t)(64.0 * (1.0 - darker) * (double)(65536 >> m->shift) / (double)pixels + 0.5);
}

/* out[x] of n pixels of a row, whose window is `window` neighboring sums; a constant, so that one pass does it all. */
static inline void field_of_row(const uint16_t *restrict sums, const int64_t window, const uint8_t *restrict row, int64_t n, int shift, uint16_t share, int16_t *restrict out)
{
    for (int64_t x = 0; x < n; x++) {
        uint16_t sum = sums[x];
        for (int64_t k = 1; k < window; k++)
            sum = (uint16_t)(sum + sums[x + k]);
        const uint16_t mean = (uint16_t)((uint32_t)(uint16_t)(sum << shift) * share >> 16);
        out[x] = (int16_t)(64 * row[x] + 32 - mean);
    }
}

/* field = 64 (plane - (1 - darker) mean + 0.5), the mean over a window cut off at the image's edges, with a border of
 * one pixel that is not dark.  flags: DARK where the field is negative, BEGINS where it falls by `step` gray levels.
 * sums, wide: room for a row each. */
static void local_field(int64_t height, int64_t width, const uint8_t *plane, int64_t window, double darker, double least_step, uint16_t *restrict sums, uint16_t *restrict wide, int16_t *field, uint8_t *flags)
{
    const int64_t half = window / 2, stride = width + 2, inner = width - 2 * half;
    const int16_t step = (int16_t)(64.0 * least_step);
    Means means;
    fill_means(window, darker, &means);
    for (int64_t x = 0; x < stride; x++)
        field[x] = field[(height + 1) * stride + x] = 1;
    memset(flags, 0, (size_t)stride);
    memset(sums, 0, (size_t)width * sizeof *sums);
    for (int64_t y = 0; y <= half && y < height; y++)
        for (int64_t x = 0; x < width; x++)
            sums[x] = (uint16_t)(sums[x] + plane[y * width + x]);
    for (int64_t y = 0; y < height; y++) {
        const int64_t top = y - half > 0 ? y - half : 0, bottom = y + half < height - 1 ? y + half : height - 1;
        const int64_t rows = bottom - top + 1;
        const uint8_t *restrict row = plane + y * width;
        int16_t *restrict out = field + (y + 1) * stride + 1;
        out[-1] = out[width] = 1;
        if (inner > 0) {
            const uint16_t share = (uint16_t)means.shares[rows * window];
            if (window == 5)
                field_of_row(sums, 5, row + half, inner, means.shift, share, out + half);
            else {
                memcpy(wide, sums, (size_t)inner * sizeof *wide);
                for (int64_t k = 1; k < window; k++)
                    for (int64_t x = 0; x < inner; x++)
                        wide[x] = (uint16_t)(wide[x] + sums[x + k]);
                field_of_row(wide, 1, row + half, inner, means.shift, share, out + half);
            }
        }
        for (int64_t x = 0; x < width; x++) {
            if (x == half && inner > 0)
                x = width - half;
            if (x == width)
                break;
            const int64_t left = x - half > 0 ? x - half : 0, right = x + half < width - 1 ? x + half : width - 1;
            uint64_t sum = 0;
            for (int64_t k = left; k <= right; k++)
                sum += sums[k];
            out[x] = (int16_t)(64 * row[x] + 32 - (int64_t)((sum << means.shift) * means.shares[rows * (right - left + 1)] >> 16));
        }
        /* Sums of the next row come before this row's field is read again: reading what was just written would wait. */
        if (y + half + 1 < height && y - half >= 0) {
            const uint8_t *restrict enters = plane + (y + half + 1) * width, *restrict leaves = plane + (y - half) * width;
            for (int64_t x = 0; x < width; x++)
                sums[x] = (uint16_t)(sums[x] + enters[x] - leaves[x]);
        } else if (y + half + 1 < height) {
            for (int64_t x = 0; x < width; x++)
                sums[x] = (uint16_t)(sums[x] + plane[(y + half + 1) * width + x]);
        } else if (y - half >= 0)
            for (int64_t x = 0; x < width; x++)
                sums[x] = (uint16_t)(sums[x] - plane[(y - half) * width + x]);
        mark_dark(out - 1, stride, step, flags + y * stride, flags + (y + 1) * stride);
    }
    mark_dark(field + (height + 1) * stride, stride, step, flags + height * stride, flags + (height + 1) * stride);
}

/* Outlines run clockwise along sides of pixels (0 right, 1 down, 2 left, 3 up) from corner to corner.  What is dark
 * around a corner (0 to 15) and the side that ends there (times 16) say which side is next: where it ends, and that
 * side times 16.  Tables replace branches, because processors cannot predict the turns of textured outlines; a step
 * from one corner to the next takes one byte and one table. */
typedef struct {
    int64_t move[64], next[64];
    int64_t sign[64], right[64]; /* of the side itself: what it adds to the area */
    int32_t code[64];            /* its code minus 4 times the position of the corner where it ends */
    uint8_t visit[64];
} Turns;

static void fill_turns(int64_t stride, Turns *t)
{
    /* Seen from the side's pixel, which pixel around the corner lies ahead, and which beyond that one. */
    const int ahead[4] = {2, 0, 1, 3}, beyond[4] = {3, 2, 0, 1};
    const int64_t travel[4] = {stride, -1, -stride, 1}, corner[4] = {stride + 1, stride, 0, 1};
    for (int d = 0; d < 4; d++) {
        for (int dark = 0; dark < 16; dark++) {
            const int side = dark >> beyond[d] & 1 ? (d + 3) & 3 : dark >> ahead[d] & 1 ? d : (d + 1) & 3;
            t->move[16 * d + dark] = travel[side];
            t->next[16 * d + dark] = 16 * side;
        }
        t->sign[16 * d] = d == 0 ? 1 : d == 2 ? -1 : 0;
        t->right[16 * d] = d == 0 ? -stride : 0;
        t->code[16 * d] = d - 4 * (int32_t)corner[d];
        t->visit[16 * d] = d == 2 ? VISITED : 0;
    }
}

/* Follows the edge of a dark region clockwise from the left side of a pixel: code = 4 x place + side.  Returns how many
 * sides there are; those beyond `longest` are not written.  area: pixels within, since every row has as many right sides
 * as left ones. */
static int64_t follow(const Turns *restrict turns, uint8_t *flags, int64_t start, int64_t longest, int32_t *restrict codes, int64_t *area)
{
    int64_t n = 0, within = 0, at = start, side = 2 * 16;
    do {
        const uint8_t here = flags[at];
        if (n < longest)
            codes[n] = (int32_t)(4 * at) + turns->code[side];
        n++;
        /* A left side ends at the corner of its own pixel. */
        flags[at] = here | turns->visit[side];
        within += turns->sign[side] * at + turns->right[side];
        const int64_t turn = side | here >> 4;
        at += turns->move[turn];
        side = turns->next[turn];
    } while (at != start || side != 2 * 16);
    *area = within;
    return n;
}

/* Where the field crosses zero on every side, and the area within. */
static double crossings(const int16_t *field, int64_t stride, int32_t *restrict codes, int64_t n, float *restrict out_x, float *restrict out_y)
{
    const int32_t row = (int32_t)stride, step[4] = {1, row, -1, -row};
    const int64_t padded = PADDED(n);
    double twice = 0.0;
    for (int64_t i = n; i < padded; i++)
        codes[i] = codes[n - 1];
    for (int64_t i = 0; i < padded; i++) {
        const int16_t *at = field + (codes[i] >> 2);
        out_x[i] = (float)at[0];
        out_y[i] = (float)at[step[codes[i] & 3]];
    }
    /* No pixel of an outline lies in the border's columns, so that rounding never changes its row. */
    const double rows = 1.0 / (double)row;
    _Pragma("omp simd") for (int64_t i = 0; i < padded; i++)
    {
        const int32_t at = codes[i] >> 2, d = codes[i] & 3, y = (int32_t)((double)at * rows), x = at - y * row;
        const float inside = out_x[i], t = inside / (inside - out_y[i]);
        out_x[i] = (float)(x - 1) + t * (float)((d == 0) - (d == 2));
        out_y[i] = (float)(y - 1) + t * (float)((d == 1) - (d == 3));
    }
    out_x[padded] = out_x[n - 1];
    out_y[padded] = out_y[n - 1];
    _Pragma("omp simd reduction(+ : twice)") for (int64_t i = 0; i < padded; i++)
        twice += (double)(out_x[i] * out_y[i + 1] - out_y[i] * out_x[i + 1]);
    return 0.5 * (twice + (double)(out_x[n - 1] * out_y[0] - out_y[n - 1] * out_x[0]));
}

/* Farthest point from (x, y). */
static int64_t farthest(const Outline *o, float x, float y)
{
    const float *restrict const xs = o->x, *restrict const ys = o->y; /* as fields, they would be gathered */
    float most = -1.0f;
    const int64_t padded = PADDED(o->n);
    _Pragma("omp simd reduction(max : most)") for (int64_t i = 0; i < padded; i++)
    {
        float dx = xs[i] - x, dy = ys[i] - y, d = dx * dx + dy * dy;
        most = d > most ? d : most;
    }
    const int32_t last = (int32_t)o->n - 1;
    int32_t at = last;
    _Pragma("omp simd reduction(min : at)") for (int32_t i = 0; i < (int32_t)padded; i++)
    {
        float dx = xs[i] - x, dy = ys[i] - y;
        int32_t here = dx * dx + dy * dy == most ? i : last;
        at = here < at ? here : at;
    }
    return at;
}

/* Twice the area of the triangle of two points of an outline and a third; positive if the third lies to the right. */
typedef struct {
    float x, y, dx, dy;
} Way;

static Way way_of(const Outline *o, int64_t from, int64_t to)
{
    Way w = {o->x[from], o->y[from], o->x[to] - o->x[from], o->y[to] - o->y[from]};
    return w;
}

static inline float beside(Way w, float x, float y)
{
    return w.dx * (y - w.y) - w.dy * (x - w.x);
}

/* Four corners, clockwise: the point farthest from the center of the box, the point farthest from that one, and the
 * farthest points on both sides of the line between; 0 if they cannot be corners of a square.  area: of the outline's
 * hull, approximated by four parabolas on the sides. */
static int four_corners(const Outline *o, int64_t *corner, double *area)
{
    const int64_t padded = PADDED(o->n);
    const float *restrict const xs = o->x, *restrict const ys = o->y;
    float x0 = xs[0], x1 = x0, y0 = ys[0], y1 = y0;
    _Pragma("omp simd reduction(min : x0, y0) reduction(max : x1, y1)") for (int64_t i = 0; i < padded; i++)
    {
        x0 = xs[i] < x0 ? xs[i] : x0;
        x1 = xs[i] > x1 ? xs[i] : x1;
        y0 = ys[i] < y0 ? ys[i] : y0;
        y1 = ys[i] > y1 ? ys[i] : y1;
    }
    corner[0] = farthest(o, 0.5f * (x0 + x1), 0.5f * (y0 + y1));
    corner[2] = farthest(o, xs[corner[0]], ys[corner[0]]);
    const Way across = way_of(o, corner[0], corner[2]);
    float left = 0.0f, right = 0.0f;
    _Pragma("omp simd reduction(min : left) reduction(max : right)") for (int64_t i = 0; i < padded; i++)
    {
        float off = beside(across, xs[i], ys[i]);
        left = off < left ? off : left;
        right = off > right ? off : right;
    }
    const float whole = right - left;
    *area = 0.0;
    if (!(left < 0.0f && right > 0.0f))
        return 0;
    const int32_t n = (int32_t)o->n;
    int32_t leftmost = n, rightmost = n;
    _Pragma("omp simd reduction(min : leftmost, rightmost)") for (int32_t i = 0; i < (int32_t)padded; i++)
    {
        float off = beside(across, xs[i], ys[i]);
        int32_t at_left = off == left ? i : n, at_right = off == right ? i : n;
        leftmost = at_left < leftmost ? at_left : leftmost;
        rightmost = at_right < rightmost ? at_right : rightmost;
    }
    if (leftmost == n || rightmost == n)
        return 0;
    corner[1] = leftmost;
    corner[3] = rightmost;
    const Way a = way_of(o, corner[0], corner[1]), b = way_of(o, corner[1], corner[2]);
    const Way c = way_of(o, corner[2], corner[3]), d = way_of(o, corner[3], corner[0]);
    float beyond_a = 0.0f, beyond_b = 0.0f, beyond_c = 0.0f, beyond_d = 0.0f;
    _Pragma("omp simd reduction(min : beyond_a, beyond_b, beyond_c, beyond_d)") for (int64_t i = 0; i < padded; i++)
    {
        float x = xs[i], y = ys[i];
        float off_a = beside(a, x, y), off_b = beside(b, x, y), off_c = beside(c, x, y), off_d = beside(d, x, y);
        beyond_a = off_a < beyond_a ? off_a : beyond_a;
        beyond_b = off_b < beyond_b ? off_b : beyond_b;
        beyond_c = off_c < beyond_c ? off_c : beyond_c;
        beyond_d = off_d < beyond_d ? off_d : beyond_d;
    }
    *area = 0.5 * (double)whole - 2.0 / 3.0 * (double)(beyond_a + beyond_b + beyond_c + beyond_d);
    const float smaller = right < -left ? right : -left;
    return smaller >= (float)EVEN * whole && 0.5 * (double)whole >= FULL * *area;
}

/* Line fitted to the contour's points between two corners, without those near the ends and outliers: a point and a
 * direction. */
static void fit_line(const Outline *o, int64_t from, int64_t to, double *line)
{
    const double ax = o->x[from], ay = o->y[from];
    double dx = o->x[to] - ax, dy = o->y[to] - ay, length = length_of(dx, dy);
    line[0] = ax, line[1] = ay, line[2] = dx, line[3] = dy;
    if (length < 1e-6)
        return;
    double ux = dx / length, uy = dy / length, tolerance = 0.06 * length > 1.0 ? 0.06 * length : 1.0;
    double sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0, w = 0;
    int64_t steps = (to - from + o->n) % o->n;
    for (int64_t k = 0, at = from; k <= steps; k++) {
        double x = o->x[at] - ax, y = o->y[at] - ay, along = x * ux + y * uy, off = y * ux - x * uy;
        at = at + 1 < o->n ? at + 1 : 0;
        if (along < 0.1 * length || along > 0.9 * length || fabs(off) > tolerance)
            continue;
        sx += x, sy += y, sxx += x * x, sxy += x * y, syy += y * y, w += 1.0;
    }
    if (w < 3.0)
        return;
    sx /= w, sy /= w;
    sxx = sxx / w - sx * sx, sxy = sxy / w - sx * sy, syy = syy / w - sy * sy;
    /* Half the angle of (sxx - syy, 2 sxy); the larger of its cosine and sine first. */
    double apart = sxx - syy, twice = 2.0 * sxy, radius = length_of(apart, twice);
    if (radius < 1e-12)
        return;
    double larger = sqrt(0.5 * (1.0 + fabs(apart) / radius)), smaller = 0.5 * fabs(twice) / (radius * larger);
    line[0] = ax + sx, line[1] = ay + sy;
    line[2] = apart > 0.0 ? larger : smaller;
    line[3] = twice < 0.0 ? -(apart > 0.0 ? smaller : larger) : apart > 0.0 ? smaller : larger;
}

static int intersect(const double *a, const double *b, float *out)
{
    double det = a[2] * b[3] - a[3] * b[2];
    if (fabs(det) < 0.05 * length_of(a[2], a[3]) * length_of(b[2], b[3]))
        return 0;
    double t = ((b[0] - a[0]) * b[3] - (b[1] - a[1]) * b[2]) / det;
    out[0] = (float)(a[0] + t * a[2]);
    out[1] = (float)(a[1] + t * a[3]);
    return 1;
}

/* Convex, clockwise, no side under `least` or a seventh of the longest. */
static int is_fair(const float *q, double least)
{
    double ex[4], ey[4], length[4], longest = 0.0, shortest = 1e30;
    for (int i = 0; i < 4; i++) {
        ex[i] = (double)q[(2 * i + 2) % 8] - q[2 * i];
        ey[i] = (double)q[(2 * i + 3) % 8] - q[2 * i + 1];
        length[i] = length_of(ex[i], ey[i]);
        longest = length[i] > longest ? length[i] : longest;
        shortest = length[i] < shortest ? length[i] : shortest;
    }
    for (int i = 0; i < 4; i++) {
        int j = (i + 1) % 4;
        if (!(ex[i] * ey[j] - ey[i] * ex[j] > 0.05 * length[i] * length[j]))
            return 0;
    }
    return shortest > 0.15 * longest && shortest > least;
}

/* A square whose sides run along the outline between its corners. */
static int fit_quad(const Outline *o, const int64_t *corner, double least, float *quad)
{
    double lines[4][4];
    for (int i = 0; i < 4; i++)
        fit_line(o, corner[i], corner[(i + 1) % 4], lines[i]);
    float found[8];
    int first = 0;
    for (int i = 0; i < 4; i++) {
        if (!intersect(lines[(i + 3) % 4], lines[i], found + 2 * i))
            return 0;
        if (found[2 * i] + 0.6f * found[2 * i + 1] < found[2 * first] + 0.6f * found[2 * first + 1])
            first = i;
    }
    for (int i = 0; i < 8; i++)
        quad[i] = found[(2 * first + i) % 8];
    return is_fair(quad, least);
}

/* Corners of a closed polygon that stays within `tolerance` of the contour (Douglas and Peucker 1973), in order. */
static int64_t simplify(const Outline *o, double tolerance, int64_t most, int64_t *out)
{
    const int64_t n = o->n;
    int64_t stack[2 * 64], depth = 0, far = farthest(o, o->x[0], o->y[0]), count = 0;
    stack[depth++] = far, stack[depth++] = n;
    stack[depth++] = 0, stack[depth++] = far;
    while (depth > 0) {
        int64_t to = stack[--depth], from = stack[--depth], split = -1;
        const double ax = o->x[from % n], ay = o->y[from % n], dx = o->x[to % n] - ax, dy = o->y[to % n] - ay;
        double length = length_of(dx, dy), worst = tolerance * (length > 1e-9 ? length : 1.0);
        for (int64_t i = from + 1; i < to; i++) {
            double x = o->x[i] - ax, y = o->y[i] - ay, off = length > 1e-9 ? fabs(dx * y - dy * x) : length_of(x, y);
            if (off > worst)
                worst = off, split = i;
        }
        if (split < 0) {
            if (count == most)
                return most + 1;
            out[count++] = from;
        } else {
            if (depth + 4 > 2 * 64)
                return most + 1;
            stack[depth++] = split, stack[depth++] = to;
            stack[depth++] = from, stack[depth++] = split;
        }
    }
    return count;
}

/* Straight stretches of an outline: the longest, at most `most` of them, in order; ends[i] and the one after it bound
 * stretch i.  Returns how many; 0 where the outline is no polygon of few sides. */
static int64_t long_stretches(const Outline *o, double tolerance, int64_t most, int64_t *from, int64_t *to, double *length)
{
    int64_t corner[STRETCHES + 1], kept = 0;
    const int64_t sides = simplify(o, tolerance, STRETCHES, corner);
    double all[STRETCHES];
    if (sides < 4 || sides > STRETCHES)
        return 0;
    for (int64_t i = 0; i < sides; i++) {
        int64_t a = corner[i] % o->n, b = corner[(i + 1) % sides] % o->n;
        all[i] = length_of((double)o->x[b] - o->x[a], (double)o->y[b] - o->y[a]);
    }
    for (int64_t i = 0; i < sides; i++) {
        int64_t longer = 0;
        for (int64_t j = 0; j < sides; j++)
            longer += all[j] > all[i] || (all[j] == all[i] && j < i);
        if (longer >= most)
            continue;
        from[kept] = corner[i] % o->n, to[kept] = corner[(i + 1) % sides] % o->n, length[kept] = all[i];
        kept++;
    }
    return kept;
}

/* The square whose sides run along four stretches; 0 if there is none. */
static int square_of(const Outline *o, const int64_t *from, const int64_t *to, const int64_t *chosen, double outline, double least, float *q)
{
    double lines[4][4];
    for (int k = 0; k < 4; k++)
        fit_line(o, from[chosen[k]], to[chosen[k]], lines[k]);
    for (int k = 0; k < 4; k++)
        if (!intersect(lines[(k + 3) % 4], lines[k], q + 2 * k))
            return 0;
    if (!is_fair(q, least))
        return 0;
    float x0 = q[0], x1 = q[0], y0 = q[1], y1 = q[1];
    for (int k = 1; k < 4; k++) {
        x0 = q[2 * k] < x0 ? q[2 * k] : x0, x1 = q[2 * k] > x1 ? q[2 * k] : x1;
        y0 = q[2 * k + 1] < y0 ? q[2 * k + 1] : y0, y1 = q[2 * k + 1] > y1 ? q[2 * k + 1] : y1;
    }
    return (double)(x1 - x0) < outline && (double)(y1 - y0) < outline;
}

static double length_around(const Outline *o)
{
    double outline = 0.0;
    for (int64_t i = 0; i < o->n; i++)
        outline += length_of((double)o->x[(i + 1) % o->n] - o->x[i], (double)o->y[(i + 1) % o->n] - o->y[i]);
    return outline;
}

/* Squares from the longest straight stretches of an outline, for partly hidden squares.  An object over a corner or a
 * side adds stretches of its own; those of the square are among the longest. */
static int64_t complete(const Outline *o, const QuadRules *rules, float *quads, int64_t capacity)
{
    const double outline = length_around(o);
    int64_t from[STRETCHES], to[STRETCHES], found = 0;
    double length[STRETCHES];
    const int64_t kept = long_stretches(o, rules->straight * outline, LONGEST, from, to, length);
    for (int set = 0; set < 1 << kept; set++) {
        int64_t chosen[4];
        int c = 0;
        double sum = 0.0;
        for (int k = 0; k < kept; k++)
            if (set >> k & 1) {
                if (c < 4) {
                    chosen[c] = k;
                    sum += length[k];
                }
                c++;
            }
        if (c == 4 && sum >= 0.45 * outline && found < capacity)
            found += square_of(o, from, to, chosen, outline, rules->least_side, quads + 8 * found);
    }
    return found;
}

/* The square of which one side and pieces of both neighboring sides are visible; it is taken to be as deep as it is
 * wide. */
static int square_from_three(const Outline *o, const int64_t *from, const int64_t *to, const int64_t *chosen, double least, float *q)
{
    double lines[3][4];
    for (int k = 0; k < 3; k++)
        fit_line(o, from[chosen[k]], to[chosen[k]], lines[k]);
    if (!intersect(lines[0], lines[1], q + 2) || !intersect(lines[1], lines[2], q + 4))
        return 0;
    const double wide = length_of((double)q[4] - q[2], (double)q[5] - q[3]);
    for (int k = 0; k < 2; k++) {
        const double *line = lines[2 * k];
        const float *near = q + 2 + 2 * k;
        float *far = q + 6 * k;
        int64_t outer = k ? to[chosen[2]] : from[chosen[0]];
        double along = line[2] * ((double)o->x[outer] - near[0]) + line[3] * ((double)o->y[outer] - near[1]);
        double scale = (along < 0.0 ? -wide : wide) / length_of(line[2], line[3]);
        far[0] = (float)(near[0] + scale * line[2]);
        far[1] = (float)(near[1] + scale * line[3]);
    }
    return is_fair(q, least);
}

/* Squares inside a bright strip, such as the margin of a square that a dark object over a corner joins to its dark
 * surroundings: four consecutive long stretches of the strip's outline are the sides of the square.  A hard shadow
 * cuts the margin in two: the middle one of three consecutive stretches is then a whole side. */
static int64_t complete_inside(const Outline *o, const QuadRules *rules, float *quads, int64_t capacity)
{
    const double outline = length_around(o);
    int64_t from[STRETCHES], to[STRETCHES], found = 0;
    double length[STRETCHES];
    const int64_t kept = long_stretches(o, 0.5 * rules->straight * outline, IN_TURN, from, to, length);
    for (int64_t first = 0; first < kept && kept > 4; first++) {
        int64_t chosen[4];
        double sum = 0.0;
        for (int64_t k = 0; k < 4; k++) {
            chosen[k] = (first + k) % kept;
            sum += length[chosen[k]];
        }
        if (sum >= 0.25 * outline && found < capacity)
            found += square_of(o, from, to, chosen, outline, rules->least_side, quads + 8 * found);
        if (sum - length[chosen[3]] >= 0.25 * outline && found < capacity)
            found += square_from_three(o, from, to, chosen, rules->least_side, quads + 8 * found);
    }
    return found;
}

/* Whether an outline runs around something without winding: its length compared with that of the bounding box of
 * every eighth of its pixels. */
static int is_strip(const int32_t *codes, int64_t n, int32_t stride)
{
    int32_t x0 = INT32_MAX, x1 = 0, y0 = INT32_MAX, y1 = 0;
    for (int64_t i = 0; i < n; i += 8) {
        const int32_t at = codes[i] >> 2, y = at / stride, x = at - y * stride;
        x0 = x < x0 ? x : x0, x1 = x > x1 ? x : x1;
        y0 = y < y0 ? y : y0, y1 = y > y1 ? y : y1;
    }
    const double box = 2.0 * ((double)(x1 - x0) + (double)(y1 - y0));
    return (double)n > STRIP_TURNS * box && (double)n < STRIP_WINDS * box;
}

static double quad_area(const float *q)
{
    double twice = 0.0;
    for (int i = 0; i < 8; i += 2)
        twice += (double)q[i] * q[(i + 3) % 8] - (double)q[i + 1] * q[(i + 2) % 8];
    return 0.5 * twice;
}

/* Squares of one contour. */
static int64_t contour_quads(const Outline *o, const QuadRules *rules, float *quads, int64_t capacity)
{
    int64_t corner[4], found = 0;
    double area;
    const int is_square = four_corners(o, corner, &area);
    if (area < 0.7 * rules->least_side * rules->least_side || capacity < 1)
        return 0;
    if (is_square && fit_quad(o, corner, 0.5 * rules->least_side, quads)) {
        double own = quad_area(quads);
        if (area >= 0.7 * own && area <= 1.4 * own)
            found = 1;
        if (found && area > 0.95 * own && area < 1.05 * own)
            return 1;
    }
    if (area > rules->completed_side * rules->completed_side)
        found += complete(o, rules, quads + 8 * found, capacity - found);
    return found;
}

/* Begin and end of each run of pixels to be searched, in a row of cells; returns the number of runs.  Cells of the
 * plane may lie within one of `where` (halvings < 0) or contain several; at odd sizes the last ones reach further. */
static int64_t active_runs(const uint8_t *where, int64_t down, int64_t across, int64_t halvings, int64_t row, int64_t width, int32_t *restrict runs)
{
    const int64_t tall = halvings > 0 ? (int64_t)1 << halvings : 1, size = halvings < 0 ? (int64_t)CELL << -halvings : CELL;
    const int64_t first = halvings < 0 ? row >> -halvings : row * tall, last = (down - 1) / tall * tall;
    const int64_t top = first < last ? first : last, bottom = top + tall < down ? top + tall : down;
    int64_t found = 0, x = 0;
    int within = 0;
    for (int64_t j = 0; j < across && x < width; j += tall, x += size) {
        const int64_t right = j + tall < across ? j + tall : across;
        int any = 0;
        for (int64_t i = top; i < bottom; i++)
            for (int64_t k = j; k < right; k++)
                any |= where[i * across + k];
        if ((any != 0) != within) {
            runs[2 * found + within] = (int32_t)x;
            found += within;
            within = !within;
        }
    }
    if (within)
        runs[2 * found++ + 1] = (int32_t)width;
    return found;
}

/* Room for outlines, and where they begin. */
typedef struct {
    const int16_t *field;
    uint8_t *flags;
    float *x, *y;
    int32_t *codes;
    int64_t stride, capacity, found;
    float *quads;
} Outlines;

/* Squares of the outlines that begin at pixels x to end of row y; 0 where there is no more room. */
static int begin_outlines(Outlines *o, const Turns *turns, const QuadRules *rules, int64_t y, int64_t x, int64_t end)
{
    uint8_t *const flags = o->flags;
    for (int64_t at = (y + 1) * o->stride + x + 1; x < end; x++, at++) {
        if ((flags[at] & (BEGINS | VISITED)) != BEGINS)
            continue;
        int64_t area, n = follow(turns, flags, at, rules->longest, o->codes, &area);
        if (n > rules->longest || (double)n < 3.2 * rules->least_side)
            continue;
        if (o->capacity - o->found < 32)
            return 0;
        const Outline outline = {o->x, o->y, n};
        const double square = (double)n * (double)n;
        float *const quads = o->quads + 8 * o->found;
        const int64_t room = o->capacity - o->found;
        /* No crossing lies further than half a pixel from its side.  Bright regions run the other way around; a
         * winding outline encloses little area for its length. */
        if ((double)area + 0.5 * (double)n > ROUND * square) {
            if (crossings(o->field, o->stride, o->codes, n, o->x, o->y) > ROUND * square)
                o->found += contour_quads(&outline, rules, quads, room);
        } else if ((double)n >= STRIP_LENGTH * rules->completed_side && -(double)area <= STRIP_BROAD * square && is_strip(o->codes, n, (int32_t)o->stride)) {
            crossings(o->field, o->stride, o->codes, n, o->x, o->y);
            o->found += complete_inside(&outline, rules, quads, room);
        }
    }
    return 1;
}

int lmkit_dark_quads(int64_t height, int64_t width, const uint8_t *plane, const uint8_t *where, int64_t where_height,
                     int64_t where_width, int64_t halvings, int64_t level, int64_t window, const double *numbers,
                     int16_t *field, uint8_t *flags, uint16_t *sums, uint16_t *wide, float *points, int32_t *runs,
                     int64_t capacity, float *quads, double *corners, int64_t *count)
{
    const QuadRules rules = {numbers[0], numbers[1], numbers[3], numbers[4], numbers[5], numbers[6], numbers[7], (int64_t)numbers[2]};
    const int64_t stride = width + 2;
    const int64_t room = PADDED(rules.longest) + PAD;
    Outlines o = {field, flags, points, points + room, (int32_t *)(points + 2 * room), stride, capacity, 0, quads};
    local_field(height, width, plane, window, rules.darker, step_to_begin(plane, height, width, &rules), sums, wide, field, flags);
    Turns turns;
    fill_turns(stride, &turns);
    int64_t found = 1;
    runs[0] = 0, runs[1] = (int32_t)width;
    for (int64_t y = 0; y < height; y++) {
        if (y % CELL == 0 && where)
            found = active_runs(where, where_height, where_width, halvings, y / CELL, width, runs);
        for (int64_t k = 0; k < found; k++)
            for (int64_t x = runs[2 * k]; x < runs[2 * k + 1]; x += 8) {
                /* Eight pixels at once; the row below is read with the last ones. */
                uint64_t here;
                memcpy(&here, flags + (y + 1) * stride + x + 1, sizeof here);
                if (!(here & BEGINS * 0x0101010101010101u))
                    continue;
                if (!begin_outlines(&o, &turns, &rules, y, x, x + 8 < runs[2 * k + 1] ? x + 8 : runs[2 * k + 1]))
                    return 2;
            }
    }
    /* Pixel k of a halved image covers the span [k, k + 1) * 2 of the one before. */
    const double scale = (double)((int64_t)1 << level);
    for (int64_t i = 0; i < 8 * o.found; i++)
        corners[i] = ((double)quads[i] + 0.5) * scale - 0.5;
    *count = o.found;
    return 0;
}

/* Larger of two rows into the first, element by element. */
static void take_larger(float *restrict into, const float *restrict other, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        into[i] = other[i] > into[i] ? other[i] : into[i];
}

/* Largest of every three neighbors in a row; `out` is another row. */
static void largest_of_three(const float *restrict row, float *restrict out, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        out[i] = row[i];
    take_larger(out, row + 1, n - 1);
    take_larger(out + 1, row, n - 1);
}

/* Cells of 4 x 4 pixels with enough contrast around them both in red over blue and in brightness: 1 from the first two
 * ranges of `least` on, 2 from the other two on.  The range of a
 * logarithm is the ratio of the largest and the smallest value: `rows` holds, for every column, the largest of both and
 * of their negatives; `cells` twice the same for every cell. */
int lmkit_where_to_look(int64_t height, int64_t width, const uint8_t *image, double offset, const double *least,
                        int64_t dilate, float *rows, float *cells, uint8_t *where)
{
    const int64_t down = (height + CELL - 1) / CELL, across = (width + CELL - 1) / CELL, count = down * across;
    const float o = (float)offset, ratio = (float)exp(least[0]), luma = (float)exp(least[1]);
    const float more_ratio = (float)exp(least[2]), more_luma = (float)exp(least[3]);
    float *wide = cells + 4 * count;
    for (int64_t i = 0; i < down; i++) {
        float *restrict red = rows, *restrict blue = rows + width, *restrict bright = rows + 2 * width, *restrict dark = rows + 3 * width;
        for (int64_t x = 0; x < 4 * width; x++)
            rows[x] = -1e30f;
        int64_t y1 = (i + 1) * CELL < height ? (i + 1) * CELL : height;
        for (int64_t y = i * CELL; y < y1; y++) {
            const uint8_t *restrict p = image + 3 * y * width;
            for (int64_t x = 0; x < width; x++) {
                float b = (float)p[3 * x], g = (float)p[3 * x + 1], r = (float)p[3 * x + 2];
                float color = (r + o) / (b + o), light = 0.25f * (b + 2.0f * g + r) + o;
                red[x] = color > red[x] ? color : red[x];
                blue[x] = -color > blue[x] ? -color : blue[x];
                bright[x] = light > bright[x] ? light : bright[x];
                dark[x] = -light > dark[x] ? -light : dark[x];
            }
        }
        for (int k = 0; k < 4; k++) {
            const float *row = rows + k * width;
            float *cell = cells + k * count + i * across;
            for (int64_t j = 0; j < width / CELL; j++) {
                float a = row[4 * j], b = row[4 * j + 1], c = row[4 * j + 2], d = row[4 * j + 3];
                a = b > a ? b : a, c = d > c ? d : c;
                cell[j] = c > a ? c : a;
            }
            for (int64_t x = width / CELL * CELL; x < width; x++)
                cell[across - 1] = x % CELL == 0 || row[x] > cell[across - 1] ? row[x] : cell[across - 1];
            largest_of_three(cell, wide + k * count + i * across, across);
        }
    }
    for (int64_t i = 0; i < down; i++) {
        float *near[4];
        for (int k = 0; k < 4; k++) {
            near[k] = cells + k * count + i * across;
            const float *same = wide + k * count + i * across;
            for (int64_t j = 0; j < across; j++)
                near[k][j] = same[j];
            if (i > 0)
                take_larger(near[k], same - across, across);
            if (i + 1 < down)
                take_larger(near[k], same + across, across);
        }
        for (int64_t j = 0; j < across; j++) {
            const float least_red = -near[1][j], least_light = -near[3][j];
            int much = near[0][j] > least_red * ratio && near[2][j] > least_light * luma;
            int more = near[0][j] > least_red * more_ratio && near[2][j] > least_light * more_luma;
            where[i * across + j] = (uint8_t)(much + (much && more));
        }
    }
    if (!dilate)
        return 0;
    for (int64_t i = 0; i < count; i++)
        cells[i] = (float)where[i];
    for (int64_t i = 0; i < down; i++)
        largest_of_three(cells + i * across, wide + i * across, across);
    for (int64_t i = 0; i < down; i++)
        for (int64_t j = 0; j < across; j++) {
            const float *same = wide + i * across + j;
            float most = same[0];
            if (i > 0 && same[-across] > most)
                most = same[-across];
            if (i + 1 < down && same[across] > most)
                most = same[across];
            where[i * across + j] = (uint8_t)most;
        }
    return 0;
}
