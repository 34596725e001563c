#include "partial.h"

#ifdef COMPILE_partial_sum
FIELD_KERNEL partial_sum(__global const float *restrict a, __global float *restrict parts, int n_i, int n_j, int n_z,
                         int n_part) {
    OWN_PART;
    __global const float *source = a + slab_offset(n_i, n_j);
    SUMS(sum);
    EACH_SAMPLE EACH_VECTOR sum[v] += MASKED(REAL_LANES, LOAD(source + SAMPLE(i, j, n_j)));
    parts[part] = sum_of(sum);
}
#endif

#ifdef COMPILE_partial_dot
FIELD_KERNEL partial_dot(__global const float *a, __global const float *b, __global float *restrict parts, int n_i,
                         int n_j, int n_z, int n_part) {
    OWN_PART;
    const size_t slab = slab_offset(n_i, n_j);
    SUMS(sum);
    EACH_SAMPLE {
        const size_t at = slab + SAMPLE(i, j, n_j);
        EACH_VECTOR sum[v] += MASKED(REAL_LANES, LOAD(a + at) * LOAD(b + at));
    }
    parts[part] = sum_of(sum);
}
#endif

#ifdef COMPILE_partial_extent
FIELD_KERNEL partial_extent(__global const float *a, __global const float *mask, float lower, float upper,
                            float reach, __global float *restrict lows, __global float *restrict highs, int n_i,
                            int n_j, int n_z, int n_part) {
    OWN_PART;
    const size_t slab = slab_offset(n_i, n_j);
    Vector low[VECTORS], high[VECTORS];
    EACH_VECTOR low[v] = INFINITY, high[v] = -INFINITY;
    EACH_SAMPLE {
        const size_t at = slab + SAMPLE(i, j, n_j);
        if (disc_distance(i, j, n_i, n_j) > reach * reach) continue;
        EACH_VECTOR {
            const Vector value = LOAD(a + at), chosen_by = LOAD(mask + at);
            const Lanes chosen = REAL_LANES & (chosen_by >= lower) & (chosen_by < upper);
            low[v] = select(low[v], fmin(low[v], value), chosen);
            high[v] = select(high[v], fmax(high[v], value), chosen);
        }
    }
    float least = INFINITY, most = -INFINITY;
    EACH_VECTOR least = fmin(least, across_lanes(low[v], 1)), most = fmax(most, across_lanes(high[v], 2));
    lows[part] = least;
    highs[part] = most;
}
#endif

#ifdef COMPILE_fold
__kernel void fold(__global const float *restrict parts, int kind, __global float *restrict folded, int n_part,
                   int n_folded) {
    const int k = get_global_id(0);
    float result = kind == 0 ? 0.0f : kind == 1 ? INFINITY : -INFINITY;
    for (int part = k; part < n_part; part += n_folded) {
        const float value = parts[part];
        result = kind == 0 ? result + value : kind == 1 ? fmin(result, value) : fmax(result, value);
    }
    folded[k] = result;
}
#endif
