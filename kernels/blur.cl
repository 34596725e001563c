#include "common.h"

// Whole vectors: an item has all lanes of a slab and uses the slabs on either side. If taps reach farther, or each
// neighbor has one lane, lanes are processed one after another.
FIELD_KERNEL blur_slices(__global const float *restrict source, __global const float *restrict taps,
                         __global float *restrict blurred, int n_i, int n_j, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    const size_t slab = (size_t)n_i * n_j * LANES;
    blurred += slab_offset(n_i, n_j);
#if THREADS == 1
    if (n_tap <= LANES) {
        float near[3 * LANES];
        EACH_MINOR(j, n_j) {
            for (int side = 0; side < 3; side++) {
                const int z = ITEM_Z + (side - 1) * LANES, known = z < 0 ? 0 : min(n_z - z, LANES);
                __global const float *column = source + z / LANES * (long)slab + SAMPLE(i, j, n_j);
                for (int k = 0; k < LANES; k++) near[side * LANES + k] = k < known ? column[k] : 0.0f;
            }
            EACH_VECTOR {
                Vector sum = (Vector)(0.0f);
                for (int d = 1 - n_tap; d < n_tap; d++)
                    sum = fma((Vector)(taps[abs(d)]), PASTE(vload, WIDTH)(v, near + LANES + d), sum);
                STORE(blurred + SAMPLE(i, j, n_j), sum);
            }
        }
        return;
    }
#endif
    EACH_MINOR(j, n_j)
        for (int k = 0; k < ITEM_LANES; k++) {
            const int z = ITEM_Z + k;
            const int first = max(z - n_tap + 1, 0), last = min(z + n_tap - 1, n_z - 1);
            __global const float *column = source + SAMPLE(i, j, n_j);
            float sum = 0.0f;
            for (int s = first; s <= last; s++) sum = fma(taps[abs(s - z)], column[s / LANES * slab + s % LANES], sum);
            blurred[SAMPLE(i, j, n_j) + k] = sum;
        }
}
