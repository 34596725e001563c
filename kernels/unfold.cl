#include "common.h"

#ifdef COMPILE_shift_window
// Number of neighboring samples that one item sums at a time: on a CPU as many as half of its registers hold.
#ifdef CPU
#define TOGETHER (REGISTERS / VECTORS)
#else
#define TOGETHER TILE_MAJOR
#endif

// A band that lies inside the source for every sample. column: floats between neighbors along the source's major axis.
static inline void add_inside(__global const float *from, size_t column, int step, __global const float4 *weights,
                              int count, Vector *sum) {
#ifdef GPU
    if (step == 1) {            // four weights at a time; every sample is read once for all of them
        for (int k = 0; k < count; k += 4, weights++, from += 4 * column) {
            const int v = 0;
            const float4 w = *weights;
            Vector x[TOGETHER + 3];
            UNROLL for (int t = 0; t < TOGETHER + 3; t++) x[t] = LOAD(from + t * column);
            UNROLL for (int t = 0; t < TOGETHER; t++) {
                sum[t] = fma((Vector)(w.x), x[t], sum[t]);
                sum[t] = fma((Vector)(w.y), x[t + 1], sum[t]);
                sum[t] = fma((Vector)(w.z), x[t + 2], sum[t]);
                sum[t] = fma((Vector)(w.w), x[t + 3], sum[t]);
            }
        }
        return;
    }
#endif
    const size_t stride = step * column;
    __global const float *weight = (__global const float *)weights;
    for (int k = 0; k < count; k++, from += column) {
        const Vector w = (Vector)(weight[k]);
        UNROLL for (int t = 0; t < TOGETHER; t++) {
            __global const float *at = from + t * stride;
            EACH_VECTOR sum[t * VECTORS + v] = fma(w, LOAD(at), sum[t * VECTORS + v]);
        }
    }
}

// A band that leaves the source at some sample.
static inline void add_edge(__global const float *source, int first, size_t column, int step, int length,
                            __global const float4 *weights, int count, Vector *sum) {
    __global const float *weight = (__global const float *)weights;
    for (int k = 0; k < count; k++) {
        const Vector w = (Vector)(weight[k]);
        UNROLL for (int t = 0; t < TOGETHER; t++) {
            const int index = first + k + t * step;
            if (index < 0 || index >= length) continue;
            __global const float *at = source + index * column;
            EACH_VECTOR sum[t * VECTORS + v] = fma(w, LOAD(at), sum[t * VECTORS + v]);
        }
    }
}

// Samples m to m + TOGETHER of one phase and one row.
static inline void gather(__global const float *restrict source, __global const int *restrict rows,
                          __global const int4 *restrict bands, __global const float4 *restrict weights, int row, int m,
                          int step, int length, int n_minor, Vector *sum) {
    const size_t column = (size_t)n_minor * LANES;
    UNROLL for (int i = 0; i < TOGETHER * VECTORS; i++) sum[i] = (Vector)(0.0f);
    const int end = rows[row + 1], span = (TOGETHER - 1) * step;
    for (int b = rows[row]; b < end; b++) {
        const int4 band = bands[b];
        const int first = m * step + band.y, last = first + span + ((band.w + 3) & ~3);
        __global const float *lane = source + (size_t)band.x * LANES;
        if (first >= 0 && last <= length)
            add_inside(lane + first * column, column, step, weights + band.z, band.w, sum);
        else if (last > 0 && first < length)
            add_edge(lane, first, column, step, length, weights + band.z, band.w, sum);
    }
}

// The launch has items for one phase per tile; for remaining phases, items repeat.
FIELD_KERNEL shift_window(__global const float *restrict source, __global const int *restrict rows,
                          __global const int4 *restrict bands, __global const float4 *restrict weights, int step,
                          int phases, __global float *restrict target, int n_source_major, int n_source_minor, int n_z,
                          int n_row, int n_band, int n_chunk, int n_target_major, int n_target_minor) {
    const int begin = TILE_MINOR ? ITEM_MINOR : 0, end = TILE_MINOR ? begin + 1 : n_target_minor;
    const int longest = (n_target_major + phases - 1) / phases;
    const int tiles = (longest + TILE_MAJOR - 1) / TILE_MAJOR * phases;
    if (begin >= n_target_minor) return;
    source += slab_offset(n_source_major, n_source_minor);
    target += slab_offset(n_target_major, n_target_minor);
    for (int tile = ITEM_MAJOR; tile < tiles; tile += get_global_size(1)) {
        const int phase = tile % phases, m_begin = tile / phases * TILE_MAJOR;
        const int m_end = min(m_begin + TILE_MAJOR, (n_target_major - phase + phases - 1) / phases);
        for (int n = begin; n < end; n++)
            for (int m = m_begin; m < m_end; m += TOGETHER) {
                Vector sum[TOGETHER * VECTORS];
                gather(source, rows, bands, weights, phase * n_target_minor + n, m, step, n_source_major,
                       n_source_minor, sum);
                UNROLL for (int t = 0; t < TOGETHER; t++) if (m + t < m_end) {
                    __global float *out = target + SAMPLE((m + t) * phases + phase, n, n_target_minor);
                    EACH_VECTOR STORE(out, sum[t * VECTORS + v]);
                }
            }
    }
}
#endif

#ifdef COMPILE_mix_poses
FIELD_KERNEL mix_poses(__global const float *restrict source, __global const int *restrict rows,
                       __global const int *restrict indices, __global const float *restrict shares,
                       __global float *restrict target, int n_source_major, int n_i, int n_z, int n_row, int n_entry,
                       int n_target_major) {
    const int m_begin = ITEM_MAJOR * TILE_MAJOR, m_end = min(m_begin + TILE_MAJOR, n_target_major);
    const int i_begin = MINOR_BEGIN, i_end = MINOR_END(n_i);
    source += slab_offset(n_source_major, n_i);
    target += slab_offset(n_target_major, n_i);
    for (int m = m_begin; m < m_end; m++)
        for (int i = i_begin; i < i_end; i++) {
            Vector sum[VECTORS];
            EACH_VECTOR sum[v] = (Vector)(0.0f);
            for (int e = rows[m]; e < rows[m + 1]; e++) {
                const Vector share = (Vector)(shares[e]);
                EACH_VECTOR sum[v] = fma(share, LOAD(source + SAMPLE(indices[e], i, n_i)), sum[v]);
            }
            EACH_VECTOR STORE(target + SAMPLE(m, i, n_i), sum[v]);
        }
}
#endif
