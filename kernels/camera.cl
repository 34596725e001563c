#include "partial.h"

#define FAINTEST 2.0f

#ifdef COMPILE_measure_depth
FIELD_KERNEL measure_depth(__global const float *restrict images, __global const float *restrict open,
                           __global const float *restrict reached, float floor, float gain, float brightest,
                           __global float *restrict depth, __global float *restrict weight, int n_angle, int n_z,
                           int n_r, int n_shot) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    images += (size_t)angle * n_z * n_r;
    open += (size_t)(angle % n_shot) * n_z * n_r;
    EACH_MINOR(r, n_r) {
        const size_t at = slab_offset(n_angle, n_r) + SAMPLE(angle, r, n_r);
        const float share = reached[r];
        for (int k = 0; k < ITEM_LANES; k++) {
            const size_t pixel = (size_t)min(ITEM_Z + k, n_z - 1) * n_r + r;
            const float level = images[pixel], field = open[pixel], variance = floor + gain * fmax(level, 0.0f);
            const bool good = ITEM_Z + k < n_z && share > 0.0f && field > 0.0f && level < brightest &&
                              level * level > FAINTEST * FAINTEST * variance;
            depth[at + k] = good ? share * log(field / level) : 0.0f;
            weight[at + k] = good ? level * level / (variance * share * share) : 0.0f;
        }
    }
}
#endif

#ifdef COMPILE_draw_noise
static inline uint hashed(uint number) {
    const uint state = number * 747796405u + 2891336453u;
    const uint word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737u;
    return (word >> 22) ^ word;
}

FIELD_KERNEL draw_noise(ARRAY weight, __global const int *restrict slices, int seed, __global float *restrict noise,
                        int n_angle, int n_r, int n_z) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    EACH_MINOR(r, n_r) {
        const size_t at = slab_offset(n_angle, n_r) + SAMPLE(angle, r, n_r);
        const uint column = hashed((uint)angle * n_r + r + (uint)seed * 2654435769u);
        for (int k = 0; k < ITEM_LANES; k++) {
            const int z = min(ITEM_Z + k, n_z - 1);
            const uint first = hashed(column + slices[z]), second = hashed(first);
            const float near = ((first >> 8) + 0.5f) * 0x1p-24f, turn = ((second >> 8) + 0.5f) * 0x1p-24f;
            const float known = ITEM_Z + k < n_z ? weight[at + k] : 0.0f;
            noise[at + k] = known > 0.0f ? sqrt(-2.0f * log(near) / known) * cospi(2.0f * turn) : 0.0f;
        }
    }
}
#endif
