#include "common.h"

// One lane after the other: neighbours in z sit in one slab, or in the next.
FIELD_KERNEL resample(__global const float *restrict source, float ratio, float reach, float most, float gain, int lanes,
                      __global float *restrict target, int n_i, int n_j, int n_source, int n_z) {
    const int j_begin = TILE_MINOR ? ITEM_MINOR : 0, j_end = TILE_MINOR ? min(j_begin + 1, n_j) : n_j, i = ITEM_MAJOR;
    if (i >= n_i) return;
    for (int j = j_begin; j < j_end; j++)
        for (int k = 0; k < WIDTH * VECTORS; k++) {
            const int z = ITEM_SLAB * LANES + ITEM_LANE + k;
            const float position = (z - 0.5f * (n_z - 1)) * ratio + 0.5f * (n_source - 1);
            const int first = max((int)ceil(position - reach), 0), last = min((int)floor(position + reach), n_source - 1);
            float sum = 0.0f;
            for (int s = first; s <= last; s++) {
                const float value = source[(((size_t)(s / lanes) * n_i + i) * n_j + j) * lanes + s % lanes];
                sum = fma(gain * clamp(reach - fabs(s - position), 0.0f, most), value, sum);
            }
            target[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = sum;
        }
}
