#include "common.h"

FIELD_KERNEL to_lanes(__global const float *restrict plain, __global float *restrict field, int n_i, int n_j, int n_z) {
    const int i = ITEM_MAJOR;
    if (i >= n_i || ITEM_SLAB * LANES >= n_z) return;
    EACH_MINOR(j, n_j) {
        for (int k = 0; k < ITEM_LANES; k++) {
            const int z = ITEM_Z + k;
            const float value = z < n_z ? plain[((size_t)i * n_j + j) * n_z + z] : 0.0f;
            field[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k] = value;
        }
    }
}

FIELD_KERNEL from_lanes(__global const float *restrict field, __global float *restrict plain, int n_i, int n_j, int n_z) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    EACH_MINOR(j, n_j) {
        for (int k = 0; k < ITEM_LANES && ITEM_Z + k < n_z; k++)
            plain[((size_t)i * n_j + j) * n_z + ITEM_Z + k] = field[slab_offset(n_i, n_j) + SAMPLE(i, j, n_j) + k];
    }
}
