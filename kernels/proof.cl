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
#ifdef CPU
#include "folds.h"
#else
typedef float Real;
#endif

// First and last bin whose light crosses a voxel (x, y), relative to the axis, and its share, at an angle's turn.
static inline float4 look_up(__global const float4 *restrict pose, int n_across, int n_along, float4 turn, float scale,
                             float x, float y, float away) {
    const float across = fma(y, turn.x, -x * turn.y) * scale, along = fma(-x, turn.x, -y * turn.y) * scale;
    return sampled(pose, n_across, n_along, fma(away, along, across) + 0.5f * (n_across - 1),
                   fma(-away, across, along) + 0.5f * (n_along - 1));
}

// The light that crosses a voxel while its ends move: least and greatest position of both, the bins it meets, its share.
typedef struct {
    float2 low, high;
    int first, stop;
    float share;
} Light;

static inline Light light_of(__global const float4 *restrict pose, int n_across, int n_along, float4 turn, float scale,
                             float x, float y, int n_bin) {
    const float4 before = look_up(pose, n_across, n_along, turn, scale, x, y, -turn.w);
    const float4 after = turn.w > 0.0f ? look_up(pose, n_across, n_along, turn, scale, x, y, turn.w) : before;
    Light light;
    light.low = fmin(before.xy, after.xy), light.high = fmax(before.xy, after.xy);
    light.first = max((int)floor(light.low.x - 0.5f), 0), light.stop = min((int)ceil(light.high.y + 0.5f), n_bin);
    light.share = 0.5f * turn.z * (before.z + after.z);
    return light;
}

// The path of an end: least and greatest position, and one over six times its length.
typedef struct {
    Real low, high, way;
} Path;

static inline Path path_of(Real low, Real high) {
    Path path = {low, high, 1.0f / (6.0f * fmax(high - low, (Real)(1e-6f)))};
    return path;
}

// Mean of t t / 2 over a path; t: distance beyond the middle of a bin, or 0.
static inline Real mean_beyond(const Path *path, Real bin) {
    const Real low = path->low - (bin + 0.5f), high = fmax(path->high - (bin + 0.5f), (Real)(0.0f));
    return select(high * high * high * path->way, (low * (low + high) + high * high) / 6.0f, low >= 0.0f);
}

// The same of the last end, minus that of the first.
static inline Real beyond(const Path *ends, Real bin) { return mean_beyond(ends + 1, bin) - mean_beyond(ends, bin); }

#ifdef CPU
// On a processor core, a look-up takes as long as the lanes that use it. WIDTH neighbors of a row therefore make theirs
// at once, for a block of turns (an arc and a branch); each is then applied to every slab and, if a quarter turn maps
// voxels and angles onto themselves, to all four quarters (folds). Items go through squares of voxels, which meet few bins.
typedef struct {
    int angle[4][TURNS];                                // by fold
    int first[TURNS][WIDTH], count[TURNS][WIDTH];       // bins that a voxel meets
    float weight[TURNS][BINS][WIDTH];
} Notes;

// Notes the bins from `skip` on, at most BINS of them, of the lit voxels at (x, y..); whether there are more.
static inline bool note(Notes *notes, int turn, int skip, __global const float4 *restrict pose, int n_across, int n_along,
                        float4 arc, float scale, float x, float y, const bool *lit, int n_bin) {
    float low[2][WIDTH], high[2][WIDTH], share[WIDTH], bin[WIDTH];
    int most = 0;
    for (int lane = 0; lane < WIDTH; lane++) {
        const Light light = light_of(pose, n_across, n_along, arc, scale, x, y + lane, n_bin);
        const int first = light.first + skip, rest = lit[lane] && light.share != 0.0f ? max(light.stop - first, 0) : 0;
        low[0][lane] = light.low.x, low[1][lane] = light.low.y;
        high[0][lane] = light.high.x, high[1][lane] = light.high.y;
        share[lane] = light.share, bin[lane] = first;
        notes->first[turn][lane] = first, notes->count[turn][lane] = min(rest, BINS);
        most = max(most, rest);
    }
    const Path ends[2] = {path_of(VLOAD(0, low[0]), VLOAD(0, high[0])), path_of(VLOAD(0, low[1]), VLOAD(0, high[1]))};
    const Vector first = VLOAD(0, bin), of = VLOAD(0, share);
    Vector before = beyond(ends, first - 1.0f), here = beyond(ends, first);
    for (int k = 0; k < min(most, BINS); k++) {
        const Vector next = beyond(ends, first + (k + 1.0f));
        VSTORE(of * (before - 2.0f * here + next), 0, notes->weight[turn][k]);
        before = here, here = next;
    }
    return most > BINS;
}

// Adds the noted light of a voxel to it and to those of some folds; together they keep the adders busy.
#define FOLDS (VECTORS > 2 ? 1 : 4 / VECTORS)
static inline void apply(const Notes *notes, int turns, int lane, int fold, const int folds, int row, int column, int n_y,
                         int n_bin, bool begin, __global const float *profile, __global float *dose) {
    Vector sum[FOLDS][VECTORS];
    __global float *out[FOLDS];
    __global const float *from[FOLDS];
    UNROLL for (int f = 0; f < folds; f++) {
        out[f] = dose + (size_t)turned_voxel(fold + f, row, column, n_y) * LANES;
        EACH_VECTOR sum[f][v] = begin ? (Vector)(0.0f) : LOAD(out[f]);
    }
    for (int turn = 0; turn < turns; turn++) {
        UNROLL for (int f = 0; f < folds; f++)
            from[f] = profile + SAMPLE(notes->angle[fold + f][turn], notes->first[turn][lane], n_bin);
        for (int k = 0; k < notes->count[turn][lane]; k++) {
            const Vector weight = (Vector)(notes->weight[turn][k][lane]);
            UNROLL for (int f = 0; f < folds; f++)
                EACH_VECTOR sum[f][v] = fma(weight, LOAD(from[f] + k * LANES), sum[f][v]);
        }
    }
    UNROLL for (int f = 0; f < folds; f++) EACH_VECTOR STORE(out[f], sum[f][v]);
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
    const int slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB), items = get_global_size(1);
    const int all = folds_of((__global const float *)poses, 4, n_arc, n_x, n_y, 1);
    // With folds: the rows behind the middle one, with the columns from the middle on, and the middle voxel by itself.
    const int start = all == 4 ? n_x / 2 : 0, across = (n_y - start + WIDTH - 1) / WIDTH;
    const int squares = across * ((n_x - start + WIDTH - 1) / WIDTH), end = (int)((long)(ITEM_MAJOR + 1) * squares / items);
    Notes notes;
    for (int square = (int)((long)ITEM_MAJOR * squares / items); square < end; square++) {
        const int top = start + square / across * WIDTH, bottom = min(top + WIDTH, n_x);
        const int left = start + square % across * WIDTH, right = min(left + WIDTH, n_y);
        bool folded = false;                // whether any voxel is on several branches
        for (int row = top; row < bottom; row++) for (int column = left; column < right; column++)
            folded |= !within(row - x0, column - y0, single);
        const int branches = folded ? n_branch : 1, turns = n_arc * branches;
        for (int block = 0; block < turns; block += TURNS) for (int row = top; row < bottom; row++) {
            const bool alone = all == 4 && row == start;
            const int columns = clamp((alone ? start + 1 : right) - left, 0, WIDTH);
            bool lit[2][WIDTH], any = false;            // on the first branch, and on the others
            for (int lane = 0; lane < WIDTH; lane++) {
                const float x = row - x0, y = left + lane - y0;
                lit[0][lane] = lane < columns && within(x, y, radius), lit[1][lane] = lit[0][lane] && !within(x, y, single);
                any |= lit[0][lane];
            }
            if (!any && block) continue;
            const int count = any ? min(TURNS, turns - block) : 0;
            bool more = true;
            for (int skip = 0; more; skip += BINS) {
                more = false;
                for (int turn = 0; turn < count; turn++) {
                    const int arc = (block + turn) / branches, branch = (block + turn) % branches;
                    for (int fold = 0; fold < 4; fold++) notes.angle[fold][turn] = (arc + fold * (n_arc / 4)) % n_arc / arcs;
                    more |= note(&notes, turn, skip, pose + branch * table, n_across, n_along, poses[arc], scale,
                                 row - x0, left - y0, lit[branch > 0], n_bin);
                }
                for (int slab = 0; slab < slabs; slab++) for (int lane = 0; lane < columns; lane++) {
                    __global const float *from = profile + slab * from_slab;
                    __global float *to = dose + slab * to_slab;
                    const bool begin = !block && !skip;
                    if (alone || all == 1) apply(&notes, count, lane, 0, 1, row, left + lane, n_y, n_bin, begin, from, to);
                    else for (int fold = 0; fold < 4; fold += FOLDS)
                        apply(&notes, count, lane, fold, FOLDS, row, left + lane, n_y, n_bin, begin, from, to);
                }
            }
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
        const Path ends[2] = {path_of(light.low.x, light.high.x), path_of(light.low.y, light.high.y)};
        float before = beyond(ends, light.first - 1), here = beyond(ends, light.first);
        for (int bin = light.first; bin < light.stop; bin++) {
            const float next = beyond(ends, bin + 1), weight = light.share * (before - 2.0f * here + next);
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
