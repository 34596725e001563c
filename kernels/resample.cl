#include "common.h"

#ifdef SPAN
// One lane after another: neighbors in z are in one slab, or in the next.
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
#else
// The source slices of four slices: the first, a multiple of four, and how many times four of them.
static inline int quads_from(__global const int *first, int low, int n_source, int n_z, int n_tap, int *begin) {
    int from = n_source, end = 0;
    for (int z = low; z < min(low + 4, n_z); z++) {
        from = min(from, max(first[z], 0));
        end = max(end, min(first[z] + n_tap, n_source));
    }
    *begin = from - from % 4;
    return (max(end - *begin, 0) + 3) / 4;
}
#endif

FIELD_KERNEL resample(__global const float *restrict source, __global const int *restrict first,
                      __global const float *restrict weights, int lanes, __global float *restrict target,
                      int n_i, int n_j, int n_source, int n_z, int n_tap) {
    const int i = ITEM_MAJOR;
    target += slab_offset(n_i, n_j);
#ifdef SPAN
    // The contribution of every source slice to a vector of lanes is the same for all samples: it is gathered once.
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
        // Sums of neighbors are computed side by side, because one sum alone would wait for itself at every slice.
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
    // Shares of four slices each, of source slices from a multiple of four on, are stored once per group, some at a time.
    __local float4 shares[4 * QUADS * THREADS];
    const int lane = get_local_id(0) % THREADS, low = ITEM_Z;
    int begin, most = 0;
    for (int other = 0; other < THREADS; other++)
        most = max(most, quads_from(first, low + 4 * (other - lane), n_source, n_z, n_tap, &begin));
    const int quads = quads_from(first, low, n_source, n_z, n_tap, &begin);
    for (int block = 0, j = MINOR_BEGIN; block < TILE_MINOR; block += BESIDE, j += BESIDE) {
        Vector sum[BESIDE];
        UNROLL for (int k = 0; k < BESIDE; k++) sum[k] = (Vector)(0.0f);
        for (int done = 0; done < most; done += QUADS) {
            if (block == 0 || most > QUADS) {
                barrier(CLK_LOCAL_MEM_FENCE);
                for (int s = get_local_id(0) / THREADS; s < 4 * QUADS; s += get_local_size(0) / THREADS) {
                    float share[4];
                    for (int k = 0; k < 4; k++) {
                        const int tap = low + k < n_z ? begin + 4 * done + s - first[low + k] : -1;
                        share[k] = tap >= 0 && tap < n_tap ? weights[(low + k) * n_tap + tap] : 0.0f;
                    }
                    shares[s * THREADS + lane] = vload4(0, share);
                }
                barrier(CLK_LOCAL_MEM_FENCE);
            }
            for (int q = 0; q < min(QUADS, quads - done); q++) {
                const int s = begin + 4 * (done + q);
                float4 near[BESIDE];
                UNROLL for (int k = 0; k < BESIDE; k++) {
                    near[k] =
                        *(__global const float4 *)(source + slice_offset(i, min(j + k, n_j - 1), s, n_i, n_j, lanes));
                    if (s + 4 > n_source)
                        near[k] = select((float4)(0.0f), near[k], (int4)(s, s + 1, s + 2, s + 3) < n_source);
                }
                __local const float4 *share = shares + 4 * q * THREADS + lane;
                UNROLL for (int k = 0; k < BESIDE; k++) {
                    sum[k] = fma(share[0], (Vector)(near[k].x), sum[k]);
                    sum[k] = fma(share[THREADS], (Vector)(near[k].y), sum[k]);
                    sum[k] = fma(share[2 * THREADS], (Vector)(near[k].z), sum[k]);
                    sum[k] = fma(share[3 * THREADS], (Vector)(near[k].w), sum[k]);
                }
            }
        }
        for (int k = 0; k < min(BESIDE, n_j - j); k++) *(__global Vector *)(target + SAMPLE(i, j + k, n_j)) = sum[k];
    }
#endif
}
