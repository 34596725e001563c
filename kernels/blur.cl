#include "common.h"

// One lane after the other: neighbors in z sit in one slab, or in the next.
FIELD_KERNEL blur_slices(__global const float *restrict source, __global const float *restrict taps,
                         __global float *restrict blurred, int n_i, int n_j, int n_z, int n_tap) {
    const int begin = TILE_MINOR ? ITEM_MINOR : 0, end = TILE_MINOR ? min(begin + 1, n_j) : n_j, i = ITEM_MAJOR;
    if (i >= n_i) return;
    const size_t slab = (size_t)n_i * n_j * LANES;
    for (int j = begin; j < end; j++)
        for (int k = 0; k < WIDTH * VECTORS; k++) {
            const int z = ITEM_SLAB * LANES + ITEM_LANE + k;
            const int first = max(z - n_tap + 1, 0), last = min(z + n_tap - 1, n_z - 1);
            __global const float *column = source + SAMPLE(i, j, n_j);
            float sum = 0.0f;
            for (int s = first; s <= last; s++) sum = fma(taps[abs(s - z)], column[s / LANES * slab + s % LANES], sum);
            blurred[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = sum;
        }
}
