#include "common.h"

FIELD_KERNEL gather_rows(__global const float *restrict source, __global const int *restrict first,
                         __global const float2 *restrict entries, __global float *restrict out,
                         int n_u, int n_v, int n_z, int n_row, int n_entry, int n_i, int n_j) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    source += slab_offset(n_u, n_v);
    out += slab_offset(n_i, n_j);
    const int blocks = (n_row - 1) / (n_i * n_j);
    for (int block = 0; block < blocks; block++) EACH_MINOR(j, n_j) {
        const int row = (i * blocks + block) * n_j + j, stop = first[row + 1];
        Vector sum[VECTORS];
        EACH_VECTOR sum[v] = (Vector)(0.0f);
        for (int k = first[row]; k < stop; k++) {
            const float2 entry = entries[k];
            __global const float *near = source + (size_t)(int)entry.x * LANES;
            EACH_VECTOR sum[v] = fma((Vector)(entry.y), LOAD(near), sum[v]);
        }
        __global float *total = out + SAMPLE(i, j, n_j);
        EACH_VECTOR STORE(total, block ? LOAD(total) + sum[v] : sum[v]);
    }
}
