#include "common.h"

// One lane after the other: neighbors in z sit in one slab, or in the next.
FIELD_KERNEL blur_slices(__global const float *restrict source, __global const float *restrict taps,
                         __global float *restrict blurred, int n_i, int n_j, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    const size_t slab = (size_t)n_i * n_j * LANES;
    EACH_MINOR(j, n_j)
        for (int k = 0; k < ITEM_LANES; k++) {
            const int z = ITEM_Z + k;
            const int first = max(z - n_tap + 1, 0), last = min(z + n_tap - 1, n_z - 1);
            __global const float *column = source + SAMPLE(i, j, n_j);
            float sum = 0.0f;
            for (int s = first; s <= last; s++) sum = fma(taps[abs(s - z)], column[s / LANES * slab + s % LANES], sum);
            blurred[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = sum;
        }
}
