#include "partial.h"

// sum = taps convolved with the row of n_r samples at `row`, at sample r.
static inline void convolve(__global const float *row, __global const float *restrict taps, int stride, int r, int n_r,
                            int n_tap, Vector *sum) {
    EACH_VECTOR sum[v] = taps[0] * LOAD(row + (size_t)r * LANES);
    const int left = min(r, n_tap - 1), right = min(n_r - 1 - r, n_tap - 1), both = min(left, right);
    int t = 1;
    for (; t <= both; t += stride)
        EACH_VECTOR sum[v] += taps[t] * (LOAD(row + (size_t)(r - t) * LANES) + LOAD(row + (size_t)(r + t) * LANES));
    for (int s = t; s <= left; s += stride) EACH_VECTOR sum[v] += taps[s] * LOAD(row + (size_t)(r - s) * LANES);
    for (int s = t; s <= right; s += stride) EACH_VECTOR sum[v] += taps[s] * LOAD(row + (size_t)(r + s) * LANES);
}

#define n_i n_angle
#define n_j n_r

#ifdef COMPILE_filter_rows
FIELD_KERNEL filter_rows(__global const float *restrict sinogram, __global const float *restrict taps, int stride,
                         float floor, __global float *restrict filtered, int n_angle, int n_r, int n_z, int n_tap) {
    if (part_index(n_i, n_j, n_z) < 0) return;
    const size_t slab = slab_offset(n_i, n_j);
    EACH_SAMPLE {
        Vector sum[VECTORS];
        convolve(sinogram + slab + SAMPLE(i, 0, n_j), taps, stride, j, n_r, n_tap, sum);
        EACH_VECTOR STORE(filtered + slab + SAMPLE(i, j, n_j), fmax((Vector)(floor), sum[v]));
    }
}
#endif

#ifdef COMPILE_filtered_step
FIELD_KERNEL filtered_step(__global const float *restrict gradient, __global const float *restrict taps, int stride,
                           float step, float momentum, __global float *restrict light, __global float *restrict ahead,
                           int n_angle, int n_r, int n_z, int n_tap) {
    if (part_index(n_i, n_j, n_z) < 0) return;
    const size_t slab = slab_offset(n_i, n_j);
    EACH_SAMPLE {
        const size_t at = slab + SAMPLE(i, j, n_j);
        Vector sum[VECTORS];
        convolve(gradient + slab + SAMPLE(i, 0, n_j), taps, stride, j, n_r, n_tap, sum);
        EACH_VECTOR {
            const Vector before = LOAD(light + at), from = LOAD(ahead + at);
            const Lanes held = (from <= ZERO) & (LOAD(gradient + at) >= ZERO);
            const Vector new = select(fmax(ZERO, from - step * sum[v]), ZERO, held);
            STORE(ahead + at, new + momentum * (new - before));
            STORE(light + at, new);
        }
    }
}
#endif
