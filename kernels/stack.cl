#include "common.h"

// One lane after another: slices of the source begin anywhere in a slab of the stack.
FIELD_KERNEL put_slices(__global const float *restrict source, int first, float factor, int keep, int lanes,
                        __global float *restrict stack, int n_i, int n_j, int n_source, int n_z) {
    const int i = ITEM_MAJOR;
    const int begin = max(first - ITEM_Z, 0), end = min(first + n_source - ITEM_Z, ITEM_LANES);
    if (i >= n_i || begin >= end) return;
    EACH_MINOR(j, n_j) {
        __global float *restrict to = stack + slab_offset(n_i, n_j) + SAMPLE(i, j, n_j);
        for (int k = begin; k < end; k++) {
            const float value = factor * source[slice_offset(i, j, ITEM_Z + k - first, n_i, n_j, lanes)];
            to[k] = keep ? to[k] + value : value;
        }
    }
}
