/* Calls a few kernels on fixed numbers and prints sums: the same on every processor.  See check_arm64.py. */
#include <stdint.h>
#include <stdio.h>

uint32_t lmkit_cpu_features(void);
extern const uint32_t lmkit_built_features;
int lmkit_square_poses(int64_t, const double *, const double *, double *, double *, double *);
int lmkit_clear_lines(const uint8_t *, int64_t, int64_t, double, double, double, double, int64_t, const double *,
                      const double *, uint8_t *);
int lmkit_planar_covariances(int64_t, const double *, const double *, const double *, double *);
int lmkit_box_mean(int64_t, int64_t, int64_t, const float *, float *);

static uint64_t state = 88172645463325252ull;

static double uniform(void) {
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

static void square_pose(void) {
    const double square[8] = {-.1, -.1, .1, -.1, .1, .1, -.1, .1};
    double rays[400], sizes[50], R[900], t[300], errors[100], sum = 0;
    for (int n = 0; n < 50; n++) {
        sizes[n] = .18;
        for (int i = 0; i < 8; i++) rays[8 * n + i] = square[i] * (.5 + .1 * uniform()) + .01 * uniform();
    }
    lmkit_square_poses(50, rays, sizes, R, t, errors);
    for (int i = 0; i < 300; i++) sum += t[i] * (i % 7 + 1);
    printf("square_pose %.10g\n", sum);
}

static void line_of_sight(void) {
    uint8_t grid[400], clear[100];
    double from[200], to[200];
    int sum = 0;
    for (int i = 0; i < 400; i++) grid[i] = uniform() < .95;
    for (int i = 0; i < 200; i++) {
        from[i] = uniform();
        to[i] = uniform();
    }
    lmkit_clear_lines(grid, 20, 20, .05, 0, 0, .07, 100, from, to, clear);
    for (int i = 0; i < 100; i++) sum += clear[i] * (i + 1);
    printf("line_of_sight %d\n", sum);
}

static void pose_coverage(void) {
    const double known[6] = {1e-4, 1e-4, 4e4, 3e4, 3e4, 1e-4};
    double information[720], arms[60], covariances[180], sum = 0;
    for (int n = 0; n < 20; n++) {
        double A[36];
        for (int i = 0; i < 36; i++) A[i] = uniform() - .5;
        for (int i = 0; i < 36; i++) {
            double product = 0;
            for (int k = 0; k < 6; k++) product += A[6 * (i / 6) + k] * A[6 * (i % 6) + k];
            information[36 * n + i] = 100 * product;
        }
        for (int i = 0; i < 3; i++) arms[3 * n + i] = uniform();
    }
    lmkit_planar_covariances(20, information, arms, known, covariances);
    for (int i = 0; i < 180; i++) sum += covariances[i];
    printf("planar_covariances %.10g\n", sum);
}

static void box_mean(void) {
    float image[540], mean[60];
    double sum = 0;
    for (int i = 0; i < 540; i++) image[i] = (float)uniform();
    lmkit_box_mean(4, 5, 3, image, mean);
    for (int i = 0; i < 60; i++) sum += mean[i];
    printf("box_mean %.17g\n", sum);
}

int main(void) {
    if (lmkit_built_features & ~lmkit_cpu_features()) return 1;
    square_pose();
    line_of_sight();
    pose_coverage();
    box_mean();
    return 0;
}
