#include "common.h"

// One angle: directions, pitches along x, y, r and s, the radius of the resin; lengths in mm.
typedef struct {
    float cosine, sine, dx, dy, dr, step, radius;
} View;

static inline View view_of(__global const float *pose) {
    return (View){pose[0], pose[1], pose[2], pose[3], pose[4], pose[5], pose[6]};
}

#ifdef COMPILE_column_density
FIELD_KERNEL column_density(__global const float *restrict species, __global const uchar *restrict open,
                            __global const float *restrict pose, __global float *restrict path, int n_x, int n_y,
                            int n_z, int n_r, int n_s) {
    const int ray = ITEM_MAJOR;
    if (ray >= n_r || ITEM_MINOR >= 1 || ITEM_SLAB * LANES >= n_z) return;
    const View view = view_of(pose);
    species += slab_offset(n_x, n_y);
    path += slab_offset(n_r, n_s) + SAMPLE(ray, 0, n_s);
    const float r = (ray - 0.5f * (n_r - 1)) * view.dr;
    const float half_chord = sqrt(fmax(0.0f, view.radius * view.radius - r * r));
    Vector sum[VECTORS];
    EACH_VECTOR {
        sum[v] = (Vector)(0.0f);
        STORE(path, sum[v]);
    }
    float begin = -half_chord;
    for (int k = 1; k < n_s; k++) {
        const float end = clamp(view.step * k - view.radius, -half_chord, half_chord), s = 0.5f * (begin + end);
        if (end > begin) {
            const float i = (-r * view.sine - s * view.cosine) / view.dx + 0.5f * (n_x - 1);
            const float j = (r * view.cosine - s * view.sine) / view.dy + 0.5f * (n_y - 1);
            const int i0 = (int)floor(i), j0 = (int)floor(j);
            const float f = i - i0, g = j - j0;
            float weights = 0.0f, weight[4];
            int at[4];
            UNROLL for (int n = 0; n < 4; n++) {
                at[n] = clamp(i0 + n / 2, 0, n_x - 1) * n_y + clamp(j0 + n % 2, 0, n_y - 1);
                weight[n] = (n / 2 ? f : 1.0f - f) * (n % 2 ? g : 1.0f - g) * open[at[n]];
                weights += weight[n];
            }
            const float length = (end - begin) / fmax(weights, 1e-6f);
            UNROLL for (int n = 0; n < 4; n++) {
                __global const float *from = species + (size_t)at[n] * LANES;
                // walls may hold NaN
                if (weight[n] > 0.0f) EACH_VECTOR sum[v] = fma((Vector)(length * weight[n]), LOAD(from), sum[v]);
            }
            begin = end;
        }
        EACH_VECTOR STORE(path + (size_t)k * LANES, sum[v]);
    }
}
#endif

#ifdef COMPILE_expose
FIELD_KERNEL expose(__global const float *restrict path, __global const float *restrict visible_light,
                    __global const float *restrict ultraviolet_light, int angle, __global const float *restrict pose,
                    __global const float *restrict extinction, __global float *restrict visible,
                    __global float *restrict ultraviolet, int n_r, int n_s, int n_z, int n_angle, int n_x, int n_y) {
    const int first = ITEM_MAJOR * TILE_MAJOR, last = min(first + TILE_MAJOR, n_x);
    const View view = view_of(pose);
    path += slab_offset(n_r, n_s);
    visible_light += slab_offset(n_angle, n_r) + SAMPLE(angle, 0, n_r);
    ultraviolet_light += slab_offset(n_angle, n_r) + SAMPLE(angle, 0, n_r);
    const size_t slab = slab_offset(n_x, n_y);
    for (int row = first; row < last; row++)
        EACH_MINOR(column, n_y) {
            const float x = (row - 0.5f * (n_x - 1)) * view.dx, y = (column - 0.5f * (n_y - 1)) * view.dy;
            const float r = y * view.cosine - x * view.sine, s = -(x * view.cosine + y * view.sine);
            const float square = view.radius * view.radius, u = r / view.dr + 0.5f * (n_r - 1);
            const size_t at = slab + SAMPLE(row, column, n_y);
            // x² + y² rather than r² + s²: whether a voxel is resin must not depend on the rounding of an angle
            if (!(x * x + y * y <= square && u >= 0.0f && u <= n_r - 1)) {
                EACH_VECTOR {
                    STORE(visible + at, (Vector)(0.0f));
                    STORE(ultraviolet + at, (Vector)(0.0f));
                }
                continue;
            }
            const float length = fmax(0.0f, s + sqrt(fmax(0.0f, square - r * r)));
            const float w = clamp((s + view.radius) / view.step, 0.0f, n_s - 1.0f);
            const int i = clamp((int)u, 0, max(n_r - 2, 0)), k = clamp((int)w, 0, max(n_s - 2, 0));
            const int i1 = min(i + 1, n_r - 1), k1 = min(k + 1, n_s - 1);
            const float f = u - i, g = w - k;
            EACH_VECTOR {
                const Vector near = (1.0f - g) * LOAD(path + SAMPLE(i, k, n_s)) + g * LOAD(path + SAMPLE(i, k1, n_s));
                const Vector far = (1.0f - g) * LOAD(path + SAMPLE(i1, k, n_s)) + g * LOAD(path + SAMPLE(i1, k1, n_s));
                const Vector dense = (1.0f - f) * near + f * far;
                const size_t left = (size_t)i * LANES, right = (size_t)i1 * LANES;
                const Vector seen = (1.0f - f) * LOAD(visible_light + left) + f * LOAD(visible_light + right);
                const Vector hidden = (1.0f - f) * LOAD(ultraviolet_light + left) + f * LOAD(ultraviolet_light + right);
                STORE(visible + at, seen * exp(-extinction[0] * length - extinction[1] * dense));
                STORE(ultraviolet + at, hidden * exp(-extinction[2] * length - extinction[3] * dense));
            }
        }
}
#endif
