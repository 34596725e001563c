#include "light.h"

#define WIDE(name) PASTE(name, WIDTH)

#ifdef COMPILE_spread_rows
// A vector of slices uses each row that lights any of them, times its shares.
FIELD_KERNEL spread_rows(__global const float *restrict light, __global const float *restrict shares,
                         __global const int2 *restrict span, int lanes, __global float *restrict spread,
                         int n_angle, int n_r, int n_row, int n_slice, int n_z) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    spread += slab_offset(n_angle, n_r);
    EACH_MINOR(r, n_r) EACH_VECTOR {
        const int z = ITEM_Z + v * WIDTH;
        const int first = span[z].x, stop = span[z + WIDTH - 1].y;
        Vector sum = (Vector)(0.0f);
        for (int row = first; row < stop; row++) {
            const float value = light[slice_offset(angle, r, row, n_angle, n_r, lanes)];
            sum = fma((Vector)(value), WIDE(vload)(0, shares + (size_t)row * n_slice + z), sum);
        }
        STORE(spread + SAMPLE(angle, r, n_r), sum);
    }
}
#endif

#ifdef COMPILE_spread_columns
FIELD_KERNEL spread_columns(__global const float *restrict spread, __global const int *restrict first,
                            __global const float *restrict shares, __global float *restrict profile,
                            int n_angle, int n_r, int n_z, int n_bin, int n_tap) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    spread += slab_offset(n_angle, n_r);
    profile += slab_offset(n_angle, n_bin);
    EACH_MINOR(bin, n_bin) {
        __global const float *sample = spread + SAMPLE(angle, first[bin], n_r);
        __global const float *share = shares + bin * n_tap;
        Vector sum[VECTORS];
        EACH_VECTOR sum[v] = (Vector)(0.0f);
        for (int tap = 0; tap < n_tap; tap++)
            EACH_VECTOR sum[v] = fma((Vector)(share[tap]), LOAD(sample + tap * LANES), sum[v]);
        EACH_VECTOR STORE(profile + SAMPLE(angle, bin, n_bin), sum[v]);
    }
}
#endif

#ifdef COMPILE_expose_voxels
// First and last bin whose light crosses a voxel (x, y), relative to the axis, and its share, at an angle's turn.
static inline float4 look_up(__global const float4 *restrict pose, int n_across, int n_along, float4 turn, float scale,
                             float x, float y, float away) {
    const float across = fma(y, turn.x, -x * turn.y) * scale, along = fma(-x, turn.x, -y * turn.y) * scale;
    return sampled(pose, n_across, n_along, fma(away, along, across) + 0.5f * (n_across - 1),
                   fma(-away, across, along) + 0.5f * (n_along - 1));
}

// The light that crosses a voxel while its ends move: least and greatest position of both, one over six times their
// path, the bins it meets, and its share.
typedef struct {
    float2 low, high, way;
    int first, stop;
    float share;
} Light;

static inline Light light_of(__global const float4 *restrict pose, int n_across, int n_along, float4 turn, float scale,
                             float x, float y, int n_bin) {
    const float4 before = look_up(pose, n_across, n_along, turn, scale, x, y, -turn.w);
    const float4 after = turn.w > 0.0f ? look_up(pose, n_across, n_along, turn, scale, x, y, turn.w) : before;
    Light light;
    light.low = fmin(before.xy, after.xy), light.high = fmax(before.xy, after.xy);
    light.way = 1.0f / (6.0f * fmax(light.high - light.low, 1e-6f));
    light.first = max((int)floor(light.low.x - 0.5f), 0), light.stop = min((int)ceil(light.high.y + 0.5f), n_bin);
    light.share = 0.5f * turn.z * (before.z + after.z);
    return light;
}

// Mean of t t / 2 over the path of the last end, minus that of the first; t: distance beyond the middle of a bin, or 0.
static inline float beyond(const Light *light, int bin) {
    const float2 low = light->low - (bin + 0.5f), high = fmax(light->high - (bin + 0.5f), 0.0f);
    const float2 mean = select(high * high * high * light->way, (low * (low + high) + high * high) / 6.0f, low >= 0.0f);
    return mean.y - mean.x;
}

#ifdef CPU
// On a CPU core, a look-up takes as long as the lanes that use it. It is therefore made once and stored, then applied
// to every slab and, if a quarter turn maps voxels and angles onto themselves, to all four quarters (folds). TOGETHER
// neighbors are stored before any is applied, because they read the same bins; those then come from the nearest cache.
typedef struct {
    int count;
    float weight[CAPACITY];
    int from[4][CAPACITY];      // sample of the profile, per fold
    int to[4];                  // voxel, per fold
} Notes;

static inline void apply(const Notes *notes, int members, int folds, int slabs, __global const float *restrict profile,
                         size_t profile_slab, __global float *restrict dose, size_t dose_slab) {
    for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++) {
        __global const float *from = profile + slab * profile_slab;
        for (int member = 0; member < members; member++) {
            const Notes *own = notes + member;
            __global float *out = dose + slab * dose_slab + (size_t)own->to[fold] * LANES;
            Vector sum[VECTORS];
            EACH_VECTOR sum[v] = LOAD(out);
            for (int note = 0; note < own->count; note++) {
                const Vector weight = (Vector)(own->weight[note]);
                __global const float *sample = from + (size_t)own->from[fold][note] * LANES;
                EACH_VECTOR sum[v] = fma(weight, LOAD(sample), sum[v]);
            }
            EACH_VECTOR STORE(out, sum[v]);
        }
    }
}

// A turn by 90 degrees maps arc a to a + n_arc / 4 and voxel (x, y) to (-y, x), if angles are even over a turn.
static inline int folds_of(__global const float4 *poses, int n_arc, int n_x, int n_y) {
    if (n_arc % 4 || n_x != n_y || n_x % 2 == 0) return 1;
    for (int arc = 0; arc < n_arc; arc++) {
        const float4 here = poses[arc], turned = poses[(arc + n_arc / 4) % n_arc];
        const float4 off = fabs((float4)(turned.x + here.y, turned.y - here.x, turned.z - here.z, turned.w - here.w));
        if (off.x + off.y + off.z + off.w > 1e-4f) return 1;
    }
    return 4;
}
static inline int turned_voxel(int fold, int x, int y, int n_y) {
    const int last = n_y - 1;
    return fold == 0 ? x * n_y + y : fold == 1 ? (last - y) * n_y + x
         : fold == 2 ? (last - x) * n_y + last - y : y * n_y + last - x;
}
#endif

FIELD_KERNEL expose_voxels(__global const float *restrict profile, __global const float4 *restrict poses,
                           __global const float4 *restrict pose, float scale, float single, float radius,
                           __global float *restrict dose,
                           int n_angle, int n_bin, int n_z, int n_arc, int n_branch, int n_across, int n_along, int n_x, int n_y) {
    const float x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1);
    const size_t table = (size_t)n_across * n_along;
    const int arcs = n_arc / n_angle;
    profile += slab_offset(n_angle, n_bin);
    dose += slab_offset(n_x, n_y);
#ifdef CPU
    const size_t from_slab = (size_t)n_angle * n_bin * LANES, to_slab = (size_t)n_x * n_y * LANES;
    const int all = folds_of(poses, n_arc, n_x, n_y), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    // With folds: the rows behind the middle one, with the columns from the middle on, and the middle voxel by itself.
    const int rows = all == 4 ? n_x / 2 + 1 : n_x, items = get_global_size(1);
    const int from = (int)((long)ITEM_MAJOR * rows / items), to = (int)((long)(ITEM_MAJOR + 1) * rows / items);
    Notes notes[TOGETHER];
    for (int block = 0; block < n_arc; block += ARCS) for (int k = from; k < to; k++) {
        const int row = all == 4 ? n_x / 2 + k : k, alone = all == 4 && k == 0, folds = alone ? 1 : all;
        const int begin = all == 4 ? n_y / 2 : 0, end = alone ? begin + 1 : n_y;
        for (int first = begin; first < end; first += TOGETHER) {
            const int members = min(TOGETHER, end - first);
            for (int member = 0; member < members; member++) {
                Notes *own = notes + member;
                const float x = row - x0, y = first + member - y0;
                own->count = 0;
                for (int fold = 0; fold < folds; fold++) own->to[fold] = turned_voxel(fold, row, first + member, n_y);
                if (!block) for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++) {
                    __global float *out = dose + slab * to_slab + (size_t)own->to[fold] * LANES;
                    EACH_VECTOR STORE(out, (Vector)(0.0f));
                }
                if (!within(x, y, radius)) continue;
                const int branches = within(x, y, single) ? 1 : n_branch;
                for (int arc = block; arc < min(n_arc, block + ARCS); arc++)
                    for (int branch = 0; branch < branches; branch++) {
                        const Light light = light_of(pose + branch * table, n_across, n_along, poses[arc], scale, x, y, n_bin);
                        float before = beyond(&light, light.first - 1), here = beyond(&light, light.first);
                        for (int bin = light.first; bin < light.stop; bin++) {
                            if (own->count == CAPACITY) {
                                apply(own, 1, folds, slabs, profile, from_slab, dose, to_slab);
                                own->count = 0;
                            }
                            for (int fold = 0; fold < folds; fold++)
                                own->from[fold][own->count] = (arc + fold * (n_arc / 4)) % n_arc / arcs * n_bin + bin;
                            const float next = beyond(&light, bin + 1);
                            own->weight[own->count++] = light.share * (before - 2.0f * here + next);
                            before = here, here = next;
                        }
                    }
            }
            apply(notes, members, folds, slabs, profile, from_slab, dose, to_slab);
        }
    }
#else
    const int row = ITEM_MAJOR, column = ITEM_MINOR;
    if (row >= n_x || column >= n_y) return;
    const float x = row - x0, y = column - y0;
    const int branches = within(x, y, single) ? 1 : n_branch, last = (n_z - 1) / LANES;
    Vector sum[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) sum[s] = (Vector)(0.0f);
    if (within(x, y, radius)) for (int arc = 0; arc < n_arc; arc++) for (int branch = 0; branch < branches; branch++) {
        const Light light = light_of(pose + branch * table, n_across, n_along, poses[arc], scale, x, y, n_bin);
        float before = beyond(&light, light.first - 1), here = beyond(&light, light.first);
        for (int bin = light.first; bin < light.stop; bin++) {
            const float next = beyond(&light, bin + 1), weight = light.share * (before - 2.0f * here + next);
            before = here, here = next;
            __global const float *sample = profile + SAMPLE(arc / arcs, bin, n_bin);
            UNROLL for (int s = 0; s < TILE_SLABS; s++) {   // the surplus slabs of the last item repeat the last one
                const size_t ahead = (size_t)(min(ITEM_SLAB + s, last) - ITEM_SLAB) * n_angle * n_bin * LANES;
                sum[s] += weight * *(__global const Vector *)(sample + ahead);
            }
        }
    }
    UNROLL for (int s = 0; s < TILE_SLABS; s++) {
        const size_t ahead = (size_t)(min(ITEM_SLAB + s, last) - ITEM_SLAB) * n_x * n_y * LANES;
        *(__global Vector *)(dose + SAMPLE(row, column, n_y) + ahead) = sum[s];
    }
#endif
}
#endif

#ifdef COMPILE_average_voxels
FIELD_KERNEL average_voxels(__global const float *restrict fine, __global const float *restrict taps,
                            int finer, int corner_x, int corner_y, int first, __global float *restrict volume,
                            int n_u, int n_v, int n_level, int n_tap, int n_x, int n_y, int n_z) {
    const int x = ITEM_MAJOR, slab = ITEM_SLAB - first / LANES;
    if (x >= n_x || slab < 0 || slab * LANES >= n_level) return;
    fine += (size_t)slab * n_u * n_v * LANES + ITEM_LANE;
    volume += slab_offset(n_x, n_y);
    EACH_MINOR(y, n_y) {
        Vector sum[VECTORS];
        EACH_VECTOR sum[v] = (Vector)(0.0f);
        for (int a = 0; a < n_tap; a++) for (int b = 0; b < n_tap; b++) {
            const int i = corner_x + finer * x + a, j = corner_y + finer * y + b;
            if (i < 0 || i >= n_u || j < 0 || j >= n_v) continue;
            const Vector weight = (Vector)(taps[a] * taps[n_tap + b]);
            EACH_VECTOR sum[v] = fma(weight, LOAD(fine + SAMPLE(i, j, n_v)), sum[v]);
        }
        EACH_VECTOR STORE(volume + SAMPLE(x, y, n_y), sum[v]);
    }
}
#endif
