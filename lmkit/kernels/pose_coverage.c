/* Expected errors of poses on a floor, from the information on the camera's pose, compared with a demand. 
 * pose_coverage.py holds the definition. */
#include <math.h>

#include "kernels.h"
#include "reprojection.h"

#define MOST_HEADINGS 256

/* All poses, place by place, and the demand; the fields are those of `Coverage` in pose_coverage.py. */
typedef struct {
    int64_t headings, enough, asked;
    double *information, *scores, *held;
    int64_t *in_view;
    const double *arms;
    double known[6], error_m, heading_rad, blind_m;
} Coverage;

LMKIT_EXPORT int lmkit_planar_covariances(int64_t poses, const double *information, const double *arms,
                                          const double *known, double *covariances);
LMKIT_EXPORT int lmkit_change_coverage(const Coverage *all, int64_t count, const int64_t *rows, const double *told,
                                       const uint8_t *shown, int64_t sign, int64_t apply, double *gain,
                                       int64_t *newly);

/* Covariance (3,3) of the base's x, y, heading; 0 if the information is not positive definite. */
static int planar_covariance(const double *information, const double *arm, const double *known, double *C) {
    double L[36], Y[18] = {0};
    for (int i = 0; i < 36; i++) L[i] = information[i];
    for (int i = 0; i < 6; i++) L[7 * i] += known[i];
    if (!cholesky6(L, 6)) return 0;
    /* Transposed derivatives of the base's position and heading with the camera's pose: p_base = p_camera - arm. */
    Y[0] = Y[4] = Y[17] = 1;
    Y[12] = -arm[2];
    Y[15] = arm[1];
    Y[10] = arm[2];
    Y[16] = -arm[0];
    forward6(L, 6, Y, 3, 3);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 6; k++) sum += Y[3 * k + i] * Y[3 * k + j];
            C[3 * i + j] = sum;
        }
    return 1;
}

int lmkit_planar_covariances(int64_t poses, const double *information, const double *arms, const double *known,
                             double *covariances) {
    for (int64_t h = 0; h < poses; h++)
        if (!planar_covariance(information + 36 * h, arms + 3 * h, known, covariances + 9 * h)) return 1;
    return 0;
}

static double score(const Coverage *all, const double *information, const double *arm, int64_t in_view) {
    double C[9];
    double near = 0;
    if (planar_covariance(information, arm, all->known, C)) {
        const double error = sqrt(C[0] + C[4]) / all->error_m, turn = sqrt(C[8]) / all->heading_rad;
        const double worst = error > turn ? error : turn;
        near = 1 - log(worst > 1 ? worst : 1) / log(all->blind_m / all->error_m);
        near = near < 0 ? 0 : near > 1 ? 1 : near;
    }
    const double least = (double)(in_view < all->asked ? in_view : all->asked);
    return ((all->asked ? least / (double)all->asked : 1) + near) / 2;
}

/* Mean of the best `enough` of a place's scores. */
static double mean_of_best(const double *scores, int64_t count, int64_t enough) {
    double sorted[MOST_HEADINGS], sum = 0;
    for (int64_t i = 0; i < count; i++) {
        int64_t k = i;
        for (; k > 0 && sorted[k - 1] < scores[i]; k--) sorted[k] = sorted[k - 1];
        sorted[k] = scores[i];
    }
    for (int64_t i = 0; i < enough; i++) sum += sorted[i];
    return sum / (double)enough;
}

int lmkit_change_coverage(const Coverage *all, int64_t count, const int64_t *rows, const double *told,
                          const uint8_t *shown, int64_t sign, int64_t apply, double *gain, int64_t *newly) {
    const int64_t wide = all->headings;
    if (wide > MOST_HEADINGS) return 1;
    *gain = 0;
    *newly = 0;
    for (int64_t n = 0; n < count;) {
        const int64_t place = rows[n] / wide;
        double scores[MOST_HEADINGS];
        for (int64_t i = 0; i < wide; i++) scores[i] = all->scores[wide * place + i];
        for (; n < count && rows[n] / wide == place; n++) {
            const int64_t row = rows[n], in_view = all->in_view[row] + sign * shown[n];
            double information[36];
            for (int i = 0; i < 36; i++)
                information[i] = all->information[36 * row + i] + (double)sign * told[36 * n + i];
            scores[row % wide] = score(all, information, all->arms + 3 * row, in_view);
            if (!apply) continue;
            for (int i = 0; i < 36; i++) all->information[36 * row + i] = information[i];
            all->in_view[row] = in_view;
            all->scores[row] = scores[row % wide];
        }
        const double before = all->held[place], after = mean_of_best(scores, wide, all->enough);
        *gain += after - before;
        *newly += (after >= 1 - 1e-9) - (before >= 1 - 1e-9);
        if (apply) all->held[place] = after;
    }
    return 0;
}
