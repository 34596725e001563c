#include "common.h"

#ifdef LANES
// Half-integers below 2048 have exact squares in float32; every device therefore counts the same columns.
static inline bool counted(int i, int j, int n_i, int n_j, float radius) {
    const float x = i - 0.5f * (n_i - 1), y = j - 0.5f * (n_j - 1);
    return x * x + y * y <= radius * radius;
}

#define NO_CLASS -1e12f
#define OWN_Z min(ITEM_LANES, n_z - ITEM_Z)
#define IDLE (ITEM_MINOR > 0 || ITEM_MAJOR >= n_strip || OWN_Z <= 0)
#endif

#ifdef COMPILE_tally
FIELD_KERNEL tally(__global const float *restrict dose, __global const float *restrict target,
                   __global const float *restrict ranges, float level, float radius, __global uint *restrict partial,
                   int n_i, int n_j, int n_z, int n_slice, int n_strip, int n_bin) {
    if (IDLE) return;
    const int own = OWN_Z, begin = ITEM_MAJOR * TILE_MAJOR, end = min(begin + TILE_MAJOR, n_i);
    __global uint *mine = partial + ((size_t)ITEM_MAJOR * n_z + ITEM_Z) * 2 * n_bin;
    __global const float *range = ranges + (n_slice == 1 ? 0 : ITEM_Z * 6);
    const int next = n_slice == 1 ? 0 : 6;
    for (int k = 0; k < own * 2 * n_bin; k++) mine[k] = 0;
    dose += slab_offset(n_i, n_j);
    target += slab_offset(n_i, n_j);
    for (int i = begin; i < end; i++)
        for (int j = 0; j < n_j; j++) {
            if (!counted(i, j, n_i, n_j, radius)) continue;
            const size_t at = SAMPLE(i, j, n_j);
            for (int k = 0; k < own; k++) {
                const float value = dose[at + k];
                const int class = target[at + k] >= level;
                if (!class && target[at + k] < NO_CLASS) continue;
                __global const float *edges = range + k * next + 3 * class;
                const float low = edges[0], high = edges[1], scale = edges[2];
                int bin = 1 + min(max((int)((value - low) * scale), 0), n_bin - 3);
                bin = value < low ? 0 : (value >= high ? n_bin - 1 : bin);
                mine[(2 * k + class) * n_bin + bin]++;
            }
        }
}
#endif

#ifdef COMPILE_fold_counts
__kernel void fold_counts(__global const uint *restrict partial, __global uint *restrict counts,
                          int n_strip, int n_z, int n_bin, int n_slice) {
    const size_t bin = get_global_id(0), class = get_global_id(1), slice = get_global_id(2);
    const int begin = n_slice == n_z ? slice : 0, end = n_slice == n_z ? slice + 1 : n_z;
    uint sum = 0;
    for (int strip = 0; strip < n_strip; strip++)
        for (int z = begin; z < end; z++) sum += partial[(((size_t)strip * n_z + z) * 2 + class) * n_bin + bin];
    counts[(slice * 2 + class) * n_bin + bin] = sum;
}
#endif

#ifdef COMPILE_survey
FIELD_KERNEL survey(__global const float *restrict dose, __global const float *restrict target, float level,
                    float radius, __global float *restrict parts, int n_i, int n_j, int n_z, int n_strip) {
    if (IDLE) return;
    const int own = OWN_Z, begin = ITEM_MAJOR * TILE_MAJOR, end = min(begin + TILE_MAJOR, n_i);
    __global float *mine = parts + ((size_t)ITEM_MAJOR * n_z + ITEM_Z) * 6;
    float least[2][ITEM_LANES], greatest[2][ITEM_LANES], sum[2][ITEM_LANES];
    for (int class = 0; class < 2; class++)
        for (int k = 0; k < ITEM_LANES; k++) {
            least[class][k] = INFINITY;
            greatest[class][k] = -INFINITY;
            sum[class][k] = 0.0f;
        }
    dose += slab_offset(n_i, n_j);
    target += slab_offset(n_i, n_j);
    for (int i = begin; i < end; i++)
        for (int j = 0; j < n_j; j++) {
            if (!counted(i, j, n_i, n_j, radius)) continue;
            const size_t at = SAMPLE(i, j, n_j);
            for (int k = 0; k < ITEM_LANES; k++) {     // padding is read too, but never written
                const float value = dose[at + k];
                const bool in = target[at + k] >= level, out = !in && target[at + k] >= NO_CLASS;
                least[0][k] = fmin(least[0][k], out ? value : INFINITY);
                least[1][k] = fmin(least[1][k], in ? value : INFINITY);
                greatest[0][k] = fmax(greatest[0][k], out ? value : -INFINITY);
                greatest[1][k] = fmax(greatest[1][k], in ? value : -INFINITY);
                sum[0][k] += out ? value : 0.0f;
                sum[1][k] += in ? value : 0.0f;
            }
        }
    for (int k = 0; k < own; k++)
        for (int class = 0; class < 2; class++) {
            mine[6 * k + 3 * class] = least[class][k];
            mine[6 * k + 3 * class + 1] = greatest[class][k];
            mine[6 * k + 3 * class + 2] = sum[class][k];
        }
}
#endif

#ifdef COMPILE_fold_survey
// One item per number; sums carry their rounding error along (Kahan).
__kernel void fold_survey(__global const float *restrict parts, __global float *restrict statistics,
                          int n_strip, int n_z, int n_slice) {
    const int which = get_global_id(0), class = get_global_id(1), slice = get_global_id(2);
    const int begin = n_slice == n_z ? slice : 0, end = n_slice == n_z ? slice + 1 : n_z;
    float total = which == 0 ? INFINITY : (which == 1 ? -INFINITY : 0.0f), lost = 0.0f;
    for (int strip = 0; strip < n_strip; strip++)
        for (int z = begin; z < end; z++) {
            const float value = parts[(((size_t)strip * n_z + z) * 2 + class) * 3 + which];
            if (which == 0) total = fmin(total, value);
            else if (which == 1) total = fmax(total, value);
            else {
                const float corrected = value - lost, next = total + corrected;
                lost = (next - total) - corrected;
                total = next;
            }
        }
    statistics[(slice * 2 + class) * 3 + which] = total;
}
#endif
