#include "common.h"

FIELD_KERNEL blur_planes(__global const float *restrict source, __global const float *restrict taps,
                         __global float *restrict blurred, int n_i, int n_j, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    const size_t slab = slab_offset(n_i, n_j);
    const int below = min(i, n_tap - 1), above = min(n_i - 1 - i, n_tap - 1), both = min(below, above);
    EACH_MINOR(j, n_j) {
        Vector sum[VECTORS];
        EACH_VECTOR sum[v] = taps[0] * LOAD(source + slab + SAMPLE(i, j, n_j));
        int t = 1;
        for (; t <= both; t++)
            EACH_VECTOR sum[v] += taps[t] * (LOAD(source + slab + SAMPLE(i - t, j, n_j)) +
                                             LOAD(source + slab + SAMPLE(i + t, j, n_j)));
        for (int s = t; s <= below; s++)
            EACH_VECTOR sum[v] += taps[s] * LOAD(source + slab + SAMPLE(i - s, j, n_j));
        for (int s = t; s <= above; s++)
            EACH_VECTOR sum[v] += taps[s] * LOAD(source + slab + SAMPLE(i + s, j, n_j));
        EACH_VECTOR STORE(blurred + slab + SAMPLE(i, j, n_j), sum[v]);
    }
}
