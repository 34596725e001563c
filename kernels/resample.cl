#include "common.h"

// One lane after the other: neighbors in z sit in one slab, or in the next.
FIELD_KERNEL resample(__global const float *restrict source, __global const int *restrict first,
                      __global const float *restrict weights, int lanes, __global float *restrict target,
                      int n_i, int n_j, int n_source, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    for (int k = 0; k < ITEM_LANES; k++) {
        const int z = ITEM_Z + k;
        if (z >= n_z) return;
        const int begin = max(0, -first[z]), end = min(n_tap, n_source - first[z]);
        EACH_MINOR(j, n_j) {
            float sum = 0.0f;
            for (int tap = begin; tap < end; tap++) {
                const int s = first[z] + tap;
                const float value = source[slice_offset(i, j, s, n_i, n_j, lanes)];
                sum = fma(weights[z * n_tap + tap], value, sum);
            }
            target[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = sum;
        }
    }
}
