// Rasterisation of 3D Gaussian splatting on the CPU: gsplat's rasterize_to_pixels and its gradient, for
// splats.py, which checks both against gsplat's own pure-torch reference. Gaussians come in order of
// depth; constants are gsplat's (alpha at most 0.999, at least 1/255, transmittance above 1e-4).
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { TILE = 8, AREA = TILE * TILE };
#define ALPHA_MAX 0.999f
#define ALPHA_MIN (1.0f / 255.0f)
#define TRANSMITTANCE_MIN 1e-4f

// Where Gaussian g may be seen, in tiles: x0, x1, y0, y1.
static void tiles_of(int g, const float *mean, const int *radius, int columns, int rows, int *range) {
    for (int axis = 0; axis < 2; axis++) {
        float centre = mean[2 * g + axis], extent = radius[2 * g + axis];
        int count = axis == 0 ? columns : rows, none = radius[2 * g] <= 0 || radius[2 * g + 1] <= 0;
        range[2 * axis] = none ? 0 : fmaxf(0, fminf(count, floorf((centre - extent) / TILE)));
        range[2 * axis + 1] = none ? 0 : fmaxf(0, fminf(count, ceilf((centre + extent) / TILE)));
    }
}

// Lists of Gaussians by tile, in order; list of tile t begins at start[t].
static int *lists(int n, const float *mean, const int *radius, int columns, int rows, int **start) {
    int tiles = columns * rows, range[4], *list = NULL;
    *start = calloc(tiles + 2, sizeof(int));
    for (int pass = 0; pass < 2; pass++) {
        for (int g = 0; g < n; g++) {
            tiles_of(g, mean, radius, columns, rows, range);
            for (int y = range[2]; y < range[3]; y++)
                for (int x = range[0]; x < range[1]; x++) {
                    int t = y * columns + x;
                    if (pass) list[(*start)[t + 1]++] = g;
                    else (*start)[t + 2]++;
                }
        }
        if (pass) break;
        for (int t = 0; t < tiles; t++) (*start)[t + 2] += (*start)[t + 1];
        list = malloc(sizeof(int) * ((*start)[tiles + 1] + 1));
    }
    return list;
}

// Pixels of a tile: place, transmittance so far, 1 until it ends, rendered values, gradient of the loss
// by these, and the gradient's product with what lies behind.
struct Tile {
    float x[AREA], y[AREA], trans[AREA], alive[AREA], value[4][AREA], grad[4][AREA], behind[AREA];
};

// The opacity of a Gaussian at pixel p before it is cut, and its share of the pixel.
#define BLEND                                                                                              \
    float dx = t->x[p] - m[0], dy = t->y[p] - m[1];                                                        \
    float uncut = o * expf(-0.5f * (k[0] * dx * dx + k[2] * dy * dy) - k[1] * dx * dy);                    \
    float alpha = fminf(uncut, ALPHA_MAX), before = t->trans[p], next = before * (1 - alpha);              \
    float counts = alpha >= ALPHA_MIN ? t->alive[p] : 0.0f;                                                \
    float ends = next <= TRANSMITTANCE_MIN ? counts : 0.0f;                                                \
    float alive = t->alive[p] - ends;                                                                      \
    counts -= ends;                                                                                        \
    float weight = counts * alpha * before;                                                                \
    t->alive[p] = alive, t->trans[p] = before - weight;                                                    \
    left += alive;

static float blend(struct Tile *t, const float *m, const float *k, const float *c, float o) {
    float left = 0;
#pragma omp simd reduction(+ : left)
    for (int p = 0; p < AREA; p++) {
        BLEND
        t->value[0][p] += weight * c[0], t->value[1][p] += weight * c[1], t->value[2][p] += weight * c[2];
        t->value[3][p] += weight;
    }
    return left;
}

static float pull_back(struct Tile *t, const float *m, const float *k, const float *c, float o, float *sum) {
    float left = 0, s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0, s8 = 0;
#pragma omp simd reduction(+ : left, s0, s1, s2, s3, s4, s5, s6, s7, s8)
    for (int p = 0; p < AREA; p++) {
        BLEND
        float q = t->grad[0][p] * c[0] + t->grad[1][p] * c[1] + t->grad[2][p] * c[2] + t->grad[3][p];
        float behind = t->behind[p] - q * weight;
        t->behind[p] = behind;
        float d_alpha = counts * (before * q - behind / (1 - alpha));
        float e = uncut > ALPHA_MAX ? 0.0f : d_alpha * uncut;
        s0 += e * (k[0] * dx + k[1] * dy), s1 += e * (k[1] * dx + k[2] * dy);
        s2 -= 0.5f * e * dx * dx, s3 -= e * dx * dy, s4 -= 0.5f * e * dy * dy;
        s5 += t->grad[0][p] * weight, s6 += t->grad[1][p] * weight, s7 += t->grad[2][p] * weight;
        s8 += e;
    }
    float all[9] = {s0, s1, s2, s3, s4, s5, s6, s7, s8 / o};
    for (int i = 0; i < 9; i++) sum[i] += all[i];
    return left;
}

// Renders colour and opacity, 4 values a pixel. With `gradient`, that of the loss by these, and the
// rendered `out` it adds up the gradients by mean, conic, colour and opacity instead, 9 values a Gaussian.
void rasterise(int n, const float *mean, const float *conic, const float *colour, const float *opacity,
               const int *radius, int width, int height, float *out, const float *gradient, float *sums) {
    int columns = (width + TILE - 1) / TILE, rows = (height + TILE - 1) / TILE, *start;
    int *list = lists(n, mean, radius, columns, rows, &start);
    struct Tile tile, *t = &tile;
    for (int number = 0; number < columns * rows; number++) {
        memset(t, 0, sizeof tile);
        for (int p = 0; p < AREA; p++) {
            int x = number % columns * TILE + p % TILE, y = number / columns * TILE + p / TILE;
            t->x[p] = x + 0.5f, t->y[p] = y + 0.5f, t->trans[p] = 1;
            t->alive[p] = x < width && y < height;
            for (int i = 0; i < 4 && gradient && t->alive[p] > 0; i++) {
                t->grad[i][p] = gradient[4 * (y * width + x) + i];
                t->behind[p] += t->grad[i][p] * out[4 * (y * width + x) + i];
            }
        }
        float left = 1;
        for (int i = start[number]; i < start[number + 1] && left > 0; i++) {
            int g = list[i];
            const float *m = mean + 2 * g, *k = conic + 3 * g, *c = colour + 3 * g;
            left = gradient ? pull_back(t, m, k, c, opacity[g], sums + 9 * g) : blend(t, m, k, c, opacity[g]);
        }
        for (int p = 0; p < AREA && !gradient; p++) {
            int x = number % columns * TILE + p % TILE, y = number / columns * TILE + p / TILE;
            for (int i = 0; i < 4 && x < width && y < height; i++) out[4 * (y * width + x) + i] = t->value[i][p];
        }
    }
    free(list), free(start);
}
