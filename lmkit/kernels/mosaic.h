/* Position of the color mosaic in the pixels of one landmark, from the residuals of its fit.  mosaic.py holds the
 * definition. */
#ifndef LMKIT_MOSAIC_H
#define LMKIT_MOSAIC_H

#include <math.h>
#include <string.h>

#include "pattern.h"

#define PLACES 4 /* of red in a cell of 2 x 2 pixels: row times 2, plus column */
#define BLURS 2  /* interpolation without blur, or with the blur of a mean of neighbors */
#define FARTHEST 300.0f
#define EVIDENT_BLOCKS 10 /* number of blocks that are used at most */

/* error of interpolated values by curvature, weight of the evidence, log odds of a mosaic at any place against none, and
 * weight of an interpolated value. */
enum { ERROR_SHARE, EVIDENCE, LOG_ODDS, LEAST_WEIGHT, MOSAIC_RULES };

/* Log likelihoods of all residuals, by blur and place of red, and if all values have equal errors: small ones, or the
 * mean error of a mosaic. */
typedef struct {
    double by_place[BLURS][PLACES], alike[2];
} MosaicEvidence;

static inline float within(float x)
{
    return x < -FARTHEST ? -FARTHEST : x > FARTHEST ? FARTHEST : x;
}

/* x and y weights of the curvature of an interpolated value: a pixel of the row, of the column, or of the diagonals has
 * the color; 4: all four neighbors have it. */
static inline void neighbors(int kind, float *across, float *down)
{
    *across = kind == 4 ? 0.5f : (float)(kind & 1);
    *down = kind == 4 ? 0.5f : (float)(kind >> 1);
}

/* Kind of a color's value where red lies in cell `from_red` of the pixel's own; 0: measured. */
static inline int kind_of(int color, int from_red)
{
    if (color == 1)
        return from_red == 1 || from_red == 2 ? 0 : 4;
    return color == 2 ? from_red : from_red ^ 3;
}

/* Adds `count` pixels of a block: residuals and half the curvatures across and down, by color, over their scale; cells. */
static void add_mosaic_evidence(block *r, block *across, block *down, const float *cells, int count, const double *rules, MosaicEvidence *sum)
{
    const float squared = (float)(rules[ERROR_SHARE] * rules[ERROR_SHARE]);
    block likely[BLURS][PLACES], alike[2], width, left[BLURS];
    for (int c = 0; c < 3; c++)
        EACH {
            r[c][i] = within(r[c][i]);
            across[c][i] = within(across[c][i]);
            down[c][i] = within(down[c][i]);
        }
    for (int k = 0; k < PLACES; k++) {
        EACH width[i] = left[0][i] = left[1][i] = 1.0f;
        for (int c = 0; c < 3; c++) {
            float x, y, mean = c == 1 ? 0.25f : 0.5f;
            neighbors(kind_of(c, k), &x, &y);
            EACH {
                float both = across[c][i] + down[c][i], curved = x * across[c][i] + y * down[c][i];
                float v = 1.0f + squared * curved * curved, d = r[c][i] - (curved - mean * both);
                width[i] *= v;
                left[0][i] *= 3.0f * v + r[c][i] * r[c][i];
                left[1][i] *= 3.0f * v + d * d;
            }
        }
        EACH {
            float half = 1.5f * natural_log(width[i]);
            likely[0][k][i] = half - 2.0f * natural_log(left[0][i]);
            likely[1][k][i] = half - 2.0f * natural_log(left[1][i]);
        }
    }
    for (int k = 0; k < 2; k++) {
        const float average = k ? squared : 0.0f;
        EACH width[i] = left[0][i] = 1.0f;
        for (int c = 0; c < 3; c++)
            EACH {
                float x = across[c][i], y = down[c][i], both = x + y;
                float square = c == 1 ? 0.125f * both * both : 0.25f * (x * x + y * y + both * both);
                float v = 1.0f + average * square;
                width[i] *= v;
                left[0][i] *= 3.0f * v + r[c][i] * r[c][i];
            }
        EACH alike[k][i] = 1.5f * natural_log(width[i]) - 2.0f * natural_log(left[0][i]);
    }
    for (int i = 0; i < count; i++) {
        int cell = (int)cells[i];
        for (int k = 0; k < 2; k++)
            sum->alike[k] += alike[k][i];
        for (int b = 0; b < BLURS; b++)
            for (int red = 0; red < PLACES; red++)
                sum->by_place[b][red] += likely[b][cell ^ red][i];
    }
}

/* Square roots of the weights of blue, green and red in the four cells. */
static void mosaic_weights(const MosaicEvidence *sum, const double *rules, float weights[3][PLACES])
{
    double odds[PLACES], total = 1.0;
    for (int red = 0; red < PLACES; red++) {
        double best = fmax(sum->by_place[0][red], sum->by_place[1][red]) - fmax(sum->alike[0], sum->alike[1]);
        odds[red] = exp(fmin(fmax(rules[EVIDENCE] * best + rules[LOG_ODDS], -100.0), 100.0));
        total += odds[red];
    }
    for (int c = 0; c < 3; c++)
        for (int cell = 0; cell < PLACES; cell++) {
            double weight = 1.0;
            for (int red = 0; red < PLACES; red++)
                weight += odds[red] * (kind_of(c, cell ^ red) == 0 ? 1.0 : rules[LEAST_WEIGHT]);
            weights[c][cell] = (float)sqrt(weight / total);
        }
}

#endif
