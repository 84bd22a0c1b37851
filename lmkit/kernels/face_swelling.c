/* Swelling of faces (how much too large a face appears, along width and height): the part of the normal equations
 * that comes from the observations.  face_swelling.py holds the definition. */
#include <stddef.h>

#include "kernels.h"
#include "landmark_bundle.h"

#define SWELLING 2

/* Sums that are added to; the fields are those of `FaceSums` in face_swelling.py. */
typedef struct {
    int64_t unknown;
    const int64_t *place, *camera;
    double *border, *landmarks, *cameras, *corner, *gradient;
} Faces;

LMKIT_EXPORT int lmkit_outward(const Bundle *bundle, double *shifts);
LMKIT_EXPORT int lmkit_face_equations(const Bundle *bundle, const double *weights, const Faces *faces);

/* Directions in which corners are displaced outward; corners start at the top left and run clockwise. */
static const double SIGNS[SWELLING][4] = {{-1, 1, 1, -1}, {-1, -1, 1, 1}};

/* Derivative of the rays of an observation's corners, in rows of `wide` numbers, with an outward displacement of 1 px
 * along the directions between `rays`. */
static void outward_of(const double *rays, const double *B, double *shifts, int wide) {
    for (int k = 0; k < SWELLING; k++) {
        double way[2] = {0, 0};
        for (int c = 0; c < 4; c++)
            for (int i = 0; i < 2; i++)
                way[i] += SIGNS[k][c] * (B[4 * c + 2 * i] * rays[2 * c] + B[4 * c + 2 * i + 1] * rays[2 * c + 1]);
        const double length = sqrt(way[0] * way[0] + way[1] * way[1]);
        for (int c = 0; c < 4; c++) {
            const double *A = B + 4 * c, u = way[0] / length * SIGNS[k][c], v = way[1] / length * SIGNS[k][c];
            const double determinant = A[0] * A[3] - A[1] * A[2];
            const double x = (A[3] * u - A[1] * v) / determinant, y = (A[0] * v - A[2] * u) / determinant;
            /* A face without width or height has no outward direction. */
            shifts[2 * wide * c + k] = isfinite(x) ? x : 0;
            shifts[2 * wide * c + wide + k] = isfinite(y) ? y : 0;
        }
    }
}

int lmkit_outward(const Bundle *b, double *shifts) {
    for (int64_t s = 0; s < b->count; s++)
        outward_of(b->rays + 8 * s, b->by_ray + 16 * s, shifts + 8 * SWELLING * s, SWELLING);
    return 0;
}

/* The first columns of A, `rows` rows of WIDE numbers, are added to X (rows,SWELLING). */
static void add_columns(const double *A, int rows, double *X) {
    for (int i = 0; i < rows; i++)
        for (int k = 0; k < SWELLING; k++) X[SWELLING * i + k] += A[WIDE * i + k];
}

int lmkit_face_equations(const Bundle *b, const double *weights, const Faces *faces) {
    for (int64_t s = 0; s < b->count; s++) {
        /* Observations that are not used may have infinite errors. */
        if (!(weights[s] > 0)) continue;
        const int64_t pose = b->at[s], landmark = b->of[s], camera = faces->camera ? faces->camera[s] : 0;
        double raw[64], block[64], M[9], expected[8], shifts[64] = {0}, G[64], whole[64] = {0}, pulls[64] = {0}, X[64] = {0};
        errors_of(b, s, 1, raw, M);
        times8(b->whitener + 64 * s, raw, block);
        /* Directions between expected corners: those between observed corners turn with the errors, and the errors
         * would then seem to be a swelling. */
        for (int i = 0; i < 8; i++) expected[i] = b->rays[8 * s + i] - raw[WIDE * i + 6];
        outward_of(expected, b->by_ray + 16 * s, shifts, WIDE);
        times8(b->whitener + 64 * s, shifts, G);
        for (int i = 0; i < 64; i++) {
            shifts[i] = G[i];
            G[i] *= weights[s];
        }
        add_transposed8(block, G, pulls); /* rows: pose and error; columns: the swelling */
        add_transposed8(shifts, G, whole);
        add_columns(pulls, 6, faces->border + 6 * SWELLING * faces->place[s]);
        add_columns(pulls + 6 * WIDE, 1, faces->gradient + SWELLING * landmark);
        add_columns(whole, SWELLING, faces->corner + SWELLING * SWELLING * landmark);
        const double *center = b->p_landmark + 3 * landmark, *p = b->p + 3 * pose;
        const double d[3] = {center[0] - p[0], center[1] - p[1], center[2] - p[2]};
        by_landmark(d, pulls, X);
        add_columns(X, 6, faces->landmarks + 6 * SWELLING * landmark);
        if (camera) {
            into_camera(M, pulls, WIDE, SWELLING, X);
            add_columns(X, 6, faces->cameras + 6 * SWELLING * (faces->unknown * landmark + camera - 1));
        }
    }
    return 0;
}
