#include "common.h"

// One lane after the other: neighbours in z sit in one slab, or in the next.
FIELD_KERNEL resample(__global const float *restrict source, __global const int *restrict first,
                      __global const float *restrict weights, int lanes, __global float *restrict target,
                      int n_i, int n_j, int n_source, int n_z, int n_tap) {
    const int j_begin = TILE_MINOR ? ITEM_MINOR : 0, j_end = TILE_MINOR ? min(j_begin + 1, n_j) : n_j, i = ITEM_MAJOR;
    if (i >= n_i) return;
    for (int k = 0; k < WIDTH * VECTORS; k++) {
        const int z = ITEM_SLAB * LANES + ITEM_LANE + k;
        if (z >= n_z) return;
        const int begin = max(0, -first[z]), end = min(n_tap, n_source - first[z]);
        for (int j = j_begin; j < j_end; j++) {
            float sum = 0.0f;
            for (int tap = begin; tap < end; tap++) {
                const int s = first[z] + tap;
                const float value = source[(((size_t)(s / lanes) * n_i + i) * n_j + j) * lanes + s % lanes];
                sum = fma(weights[z * n_tap + tap], value, sum);
            }
            target[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = sum;
        }
    }
}
