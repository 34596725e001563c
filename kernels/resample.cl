#include "common.h"

// One lane after the other: neighbors in z sit in one slab, or in the next.
static inline void resample_lanes(__global const float *source, __global const int *first, __global const float *weights,
                                  int lanes, __global float *target, int i, int j, int begin, int end, int n_i, int n_j,
                                  int n_source, int n_tap) {
    for (int z = begin; z < end; z++, target++) {
        float sum = 0.0f;
        for (int tap = max(0, -first[z]), stop = min(n_tap, n_source - first[z]); tap < stop; tap++) {
            const float value = source[slice_offset(i, j, first[z] + tap, n_i, n_j, lanes)];
            sum = fma(weights[z * n_tap + tap], value, sum);
        }
        *target = sum;
    }
}

FIELD_KERNEL resample(__global const float *restrict source, __global const int *restrict first,
                      __global const float *restrict weights, int lanes, __global float *restrict target,
                      int n_i, int n_j, int n_source, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    if (i >= n_i) return;
    target += slab_offset(n_i, n_j);
#ifdef SPAN
    // What every source slice adds to a vector of lanes is the same for all samples: gathered once, then no lane is alone.
    EACH_VECTOR {
        const int low = ITEM_Z + v * WIDTH, high = min(low + WIDTH, n_z);
        int begin = n_source, end = 0;
        for (int z = low; z < high; z++) {
            begin = min(begin, max(first[z], 0));
            end = max(end, min(first[z] + n_tap, n_source));
        }
        if (end - begin > SPAN) {
            EACH_MINOR(j, n_j)
                resample_lanes(source, first, weights, lanes, target + SAMPLE(i, j, n_j) + v * WIDTH, i, j, low, high,
                               n_i, n_j, n_source, n_tap);
            continue;
        }
        Vector shares[SPAN];
        for (int s = begin; s < end; s++) {
            float share[WIDTH];
            for (int k = 0; k < WIDTH; k++) {
                const int tap = low + k < n_z ? s - first[low + k] : -1;
                share[k] = tap >= 0 && tap < n_tap ? weights[(low + k) * n_tap + tap] : 0.0f;
            }
            shares[s - begin] = PASTE(vload, WIDTH)(0, share);
        }
        // Sums of neighbors side by side: one alone would wait for itself at every slice.
        for (int j = MINOR_BEGIN, stop_j = MINOR_END(n_j); j < stop_j; j += BESIDE) {
            const int there = min(BESIDE, stop_j - j);
            Vector sum[BESIDE];
            long at[BESIDE];
            UNROLL for (int k = 0; k < BESIDE; k++) {
                sum[k] = (Vector)(0.0f);
                at[k] = min(k, there - 1) * lanes;
            }
            for (int s = begin; s < end;) {
                __global const float *near = source + slice_offset(i, j, s, n_i, n_j, lanes);
                for (const int stop = min(end, s - s % lanes + lanes); s < stop; s++, near++) {
                    const Vector share = shares[s - begin];
                    UNROLL for (int k = 0; k < BESIDE; k++) sum[k] = fma(share, (Vector)(near[at[k]]), sum[k]);
                }
            }
            for (int k = 0; k < there; k++) STORE(target + SAMPLE(i, j + k, n_j), sum[k]);
        }
    }
#else
    EACH_MINOR(j, n_j)
        resample_lanes(source, first, weights, lanes, target + SAMPLE(i, j, n_j), i, j, ITEM_Z, min(ITEM_Z + ITEM_LANES, n_z),
                       n_i, n_j, n_source, n_tap);
#endif
}
