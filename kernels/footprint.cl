#include "light.h"

#ifdef CPU
#include "footprint_notes.h"
#else
#include "footprint_tile.h"
#endif

#ifdef COMPILE_back_footprint
FIELD_KERNEL back_footprint(__global const float *restrict sinogram, __global const float *restrict directions,
                            __global const float4 *restrict light, int bent, float ratio, float strength, float fill,
                            float sigma, float radius, int taps, __global float *restrict volume,
                            int n_angle, int n_r, int n_z, int n_across, int n_along, int n_x, int n_y) {
#ifdef CPU
    sinogram += slab_offset(n_angle, n_r);
    volume += slab_offset(n_x, n_y);
    const Scene k = {directions, light, n_angle, n_r, n_across, n_along, n_x, n_y, bent, ratio, strength, fill, sigma, radius};
    const size_t from_slab = (size_t)n_angle * n_r * LANES, to_slab = (size_t)n_x * n_y * LANES;
    const int folds = folds_of(directions, 3, n_angle, n_x, n_y, 0), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int2 rows = part_of(ITEM_MAJOR, get_global_size(1), folds == 4 ? n_x / 2 : n_x);
    const int y_end = folds == 4 ? n_y / 2 : n_y;
    Notes notes;
    for (int column = 0; column < y_end; column += WIDTH)       // its voxels share columns, which stay in the caches
    for (int block = 0; block < n_angle; block += ANGLES) for (int skip = 0; skip < taps; skip += TAPS) {
        const int count = min(ANGLES, n_angle - block), width = min(TAPS, taps - skip);
        const bool begin = block == 0 && skip == 0;
        for (int row = rows.x; row < rows.y; row++) {
            const bool lit = note(&k, &notes, block, count, row, column, skip, width);
            if (!lit && !begin) continue;
            for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
                for (int lane = 0; lane < min(WIDTH, y_end - column); lane++) {
                    __global float *out = volume + slab * to_slab + (size_t)turned_voxel(fold, row, column + lane, n_y) * LANES;
                    Vector sum[VECTORS];
                    EACH_VECTOR sum[v] = begin ? (Vector)(0.0f) : LOAD(out);
                    if (lit && notes.lit[lane]) for (int pose = 0; pose < count; pose++) {
                        const int first = notes.first[pose][lane];
                        const int2 in = taps_in(first, notes.taps[pose], n_r);
                        __global const float *from = sinogram + slab * from_slab + turned_row(&k, fold, block + pose);
                        for (int tap = in.x; tap < in.y; tap++) {
                            const Vector weight = (Vector)(notes.weight[pose][tap][lane]);
                            __global const float *sample = from + (first + tap) * LANES;
                            EACH_VECTOR sum[v] = fma(weight, LOAD(sample), sum[v]);
                        }
                    }
                    EACH_VECTOR STORE(out, sum[v]);
                }
        }
    }
#else
    // An item owns 2 x 2 voxels, which are lit mostly by the same columns.
    const Place at = place();
    DECLARE_KEPT;
    const float inverse_sigma = sigma > 0.0f ? 1.0f / sigma : 0.0f;
    const int row = at.major * 2, column = at.minor * 2;
    const int widest = taps + (int)(1.4143f * ratio) + 1;       // greatest number of columns of a tile
    const int at_once = clamp(samples / max(widest, 8), 1, TURNS);
    Vector sum[TILE_SLABS][4];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) UNROLL for (int i = 0; i < 4; i++) sum[s][i] = (Vector)(0.0f);
    __global const float *from[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) from[s] = sinogram + lane_of(at, s, n_angle, n_r, n_z);
    for (int first = 0; first < n_angle; first += at_once) for (int skip = 0; skip < widest; skip += samples) {
        const int turns = min(at_once, n_angle - first);
        meet();
        __local int2 *lit = (__local int2 *)shares;             // first and last column of each voxel, before its shares
        for (int work = at.member; work < 4 * turns; work += MEMBERS) {
            const float x = row + work % 4 / 2 - 0.5f * (n_x - 1), y = column + work % 2 - 0.5f * (n_y - 1);
            float u;
            const Foot foot = footprint(light, n_across, n_along, n_r, vload3(first + work / 4, directions), x, y, bent, ratio,
                                        strength, fill, sigma, &u);
            lit[work] = within(x, y, radius) ? (int2)((int)ceil(u - foot.reach), (int)floor(u + foot.reach))
                                             : (int2)(1000000, -1);
        }
        meet();
        for (int turn = at.member; turn < turns; turn += MEMBERS) {
            __local const int2 *of = lit + 4 * turn;
            const int begin = max(min(min(of[0].x, of[1].x), min(of[2].x, of[3].x)), 0) + skip;
            const int final = min(max(max(of[0].y, of[1].y), max(of[2].y, of[3].y)), n_r - 1);
            windows[turn] = (int2)(begin, clamp(final - begin + 1, 0, min(widest, samples)));
        }
        meet();
        for (int work = at.member; work < 4 * turns; work += MEMBERS) {
            const int i = work % 4, turn = work / 4, before = samples_before(windows, turn);
            const int2 window = windows[turn];
            const float x = row + i / 2 - 0.5f * (n_x - 1), y = column + i % 2 - 0.5f * (n_y - 1);
            float u;
            const Foot foot = footprint(light, n_across, n_along, n_r, vload3(first + turn, directions), x, y, bent, ratio,
                                        strength, fill, sigma, &u);
            const float gain = within(x, y, radius) ? foot.gain : 0.0f;
            float distance = u - window.x, above = edge(&foot, distance + 0.5f * fill, sigma, inverse_sigma);
            for (int k = 0; k < window.y; k++, distance -= 1.0f) {
                const float below = edge(&foot, distance - 0.5f * fill, sigma, inverse_sigma);
                ((__local float *)(shares + before + k))[i] =
                    faded(&foot, distance, sigma) * gain * fmax(above - below, 0.0f);
                if (i == 0) indices[before + k] = SAMPLE(first + turn, window.x + k, n_r);
                above = fill == 1.0f ? below : edge(&foot, distance - 1.0f + 0.5f * fill, sigma, inverse_sigma);
            }
        }
        meet();
        gather(sum, from, shares, indices, samples_before(windows, turns));
    }
    UNROLL for (int i = 0; i < 4; i++) if (row + i / 2 < n_x && column + i % 2 < n_y)
        UNROLL for (int s = 0; s < TILE_SLABS; s++)
            *(__global Vector *)(volume + lane_of(at, s, n_x, n_y, n_z) + SAMPLE(row + i / 2, column + i % 2, n_y)) = sum[s][i];
#endif
}
#endif

#ifdef COMPILE_forward_footprint
FIELD_KERNEL forward_footprint(__global const float *restrict volume, __global const float *restrict directions,
                               __global const float4 *restrict light, __global const float8 *restrict edges, int bent,
                               float ratio, float strength, float fill, float sigma, float radius, int taps, int cells,
                               __global float *restrict sinogram,
                               int n_x, int n_y, int n_z, int n_angle, int n_across, int n_along, int n_r) {
#ifdef CPU
    volume += slab_offset(n_x, n_y);
    sinogram += slab_offset(n_angle, n_r);
    const Scene k = {directions, light, n_angle, n_r, n_across, n_along, n_x, n_y, bent, ratio, strength, fill, sigma, radius};
    const size_t from_slab = (size_t)n_x * n_y * LANES, to_slab = (size_t)n_angle * n_r * LANES;
    const int folds = folds_of(directions, 3, n_angle, n_x, n_y, 0), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int x_end = folds == 4 ? n_x / 2 : n_x, y_end = folds == 4 ? n_y / 2 : n_y;
    const int2 angles = part_of(ITEM_MAJOR, get_global_size(1), folds == 4 ? n_angle / 4 : n_angle);
    for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
        for (int angle = angles.x; angle < angles.y; angle++) {
            __global float *out = sinogram + slab * to_slab + turned_row(&k, fold, angle);
            for (int r = 0; r < n_r * VECTORS; r++) *(__global Vector *)(out + r * WIDTH) = (Vector)(0.0f);
        }
    // An item owns whole angles; voxels may therefore add to any column of them.
    Notes notes;
    for (int block = angles.x; block < angles.y; block += ANGLES) for (int skip = 0; skip < taps; skip += TAPS) {
        const int count = min(ANGLES, angles.y - block), width = min(TAPS, taps - skip);
        // Footprints are those of a quarter of the grid at all angles, rounded as in the other direction.
        for (int quarter = 0; quarter < folds; quarter++) for (int row = 0; row < x_end; row++)
        for (int column = 0; column < y_end; column += WIDTH) {
            const int first_pose = block + quarter * (n_angle / 4);
            if (!note(&k, &notes, first_pose, count, row, column, skip, width)) continue;
            for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
                for (int lane = 0; lane < min(WIDTH, y_end - column); lane++) {
                    if (!notes.lit[lane]) continue;
                    __global const float *from =
                        volume + slab * from_slab + (size_t)turned_voxel(fold, row, column + lane, n_y) * LANES;
                    Vector value[VECTORS];
                    EACH_VECTOR value[v] = LOAD(from);
                    for (int pose = 0; pose < count; pose++) {
                        const int first = notes.first[pose][lane];
                        const int2 in = taps_in(first, notes.taps[pose], n_r);
                        __global float *out = sinogram + slab * to_slab + turned_row(&k, fold, first_pose + pose);
                        for (int tap = in.x; tap < in.y; tap++) {
                            const Vector weight = (Vector)(notes.weight[pose][tap][lane]);
                            __global float *sample = out + (first + tap) * LANES;
                            EACH_VECTOR STORE(sample, fma(weight, value[v], LOAD(sample)));
                        }
                    }
                }
        }
    }
#else
    // An item owns four neighbouring columns of one angle, whose rays meet mostly the same cells in a plane.
    const Place at = place();
    DECLARE_KEPT;
    const float inverse_sigma = sigma > 0.0f ? 1.0f / sigma : 0.0f;
    const int angle = min(at.major, n_angle - 1), r = at.minor * 4;
    const Span span = span_of_four(edges, r, n_r, vload3(angle, directions).xy, n_x, n_y);
    const int most = ALONE ? min(most_cells(&span), cells) : cells, across = min(most, samples);
    const int at_once = clamp(samples / across, 1, TURNS);
    Vector sum[TILE_SLABS][4];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) UNROLL for (int i = 0; i < 4; i++) sum[s][i] = (Vector)(0.0f);
    __global const float *from[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) from[s] = volume + lane_of(at, s, n_x, n_y, n_z);
    for (int first = 0; first < max(n_x, n_y); first += at_once) for (int skip = 0; skip < most; skip += samples) {
        const int turns = clamp(span.planes - first, 0, at_once);
        meet();
        for (int turn = at.member; turn < turns; turn += MEMBERS) {
            const int2 ends = cells_of(&span, first + turn);
            windows[turn] = (int2)(ends.x + skip, clamp(ends.y - ends.x - skip + 1, 0, across));
        }
        meet();
        for (int work = at.member; work < turns * across; work += MEMBERS) {
            const int turn = work / across, k = work % across, plane = first + turn;
            const int2 window = windows[turn];
            if (k >= window.y) continue;
            const int slot = samples_before(windows, turn) + k;
            const int2 cell = span.along_y ? (int2)(window.x + k, plane) : (int2)(plane, window.x + k);
            const float x = cell.x - 0.5f * (n_x - 1), y = cell.y - 0.5f * (n_y - 1);
            // Loaded here, not before the loop: Intel's compiler for processors keeps a negated float across a barrier
            // only for the last item of a group, and moves the direction's minus sign out of the loop.
            const float3 direction = vload3(angle, directions);
            float u;
            const Foot foot = footprint(light, n_across, n_along, n_r, direction, x, y, bent, ratio, strength, fill, sigma, &u);
            float share[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            if (within(x, y, radius) && u - r + foot.reach >= 0.0f && u - r - foot.reach <= 3.0f) {
                float distance = u - r, above = edge(&foot, distance + 0.5f * fill, sigma, inverse_sigma);
                UNROLL for (int i = 0; i < 4; i++, distance -= 1.0f) {
                    const float below = edge(&foot, distance - 0.5f * fill, sigma, inverse_sigma);
                    share[i] = faded(&foot, distance, sigma) * foot.gain * fmax(above - below, 0.0f);
                    above = fill == 1.0f ? below : edge(&foot, distance - 1.0f + 0.5f * fill, sigma, inverse_sigma);
                }
            }
            shares[slot] = (float4)(share[0], share[1], share[2], share[3]);
            indices[slot] = SAMPLE(cell.x, cell.y, n_y);
        }
        meet();
        gather(sum, from, shares, indices, samples_before(windows, turns));
    }
    if (at.major < n_angle) UNROLL for (int i = 0; i < 4; i++) if (r + i < n_r)
        UNROLL for (int s = 0; s < TILE_SLABS; s++)
            *(__global Vector *)(sinogram + lane_of(at, s, n_angle, n_r, n_z) + SAMPLE(angle, r + i, n_r)) = sum[s][i];
#endif
}
#endif
