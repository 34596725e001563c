#include "common.h"

#ifdef CPU
typedef Vector Real;            // a footprint for each of WIDTH neighbouring voxels
#define VLOAD PASTE(vload, WIDTH)
#define VSTORE PASTE(vstore, WIDTH)
#define CONVERT_INT PASTE(convert_int, WIDTH)
#define LANE_NUMBERS (Vector)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#include "footprint.h"

// Footprints cost more than the lanes they serve, so WIDTH neighbouring voxels of a row get theirs at once, for a block of
// poses; each is then applied to every slab and, where a quarter turn maps grid and poses onto themselves, to all four
// quarters (folds).
typedef struct {
    int first[ANGLES][WIDTH];               // column
    int taps[ANGLES];                       // columns from there on that light any of the voxels
    float weight[ANGLES][TAPS][WIDTH];
    bool lit[WIDTH];
} Notes;

// The poses, the light and the pixels' shape, as every item needs them.
typedef struct {
    __global const float2 *directions;
    __global const float4 *light;
    int n_angle, n_r, n_across, n_along, n_x, n_y, bent;
    float ratio, strength, fill, sigma, radius;
} Scene;

static inline Foot footprints(const Scene *k, float2 direction, float x, float y, Real *u) {
    if (!k->bent) {
        const Real column = y + LANE_NUMBERS;
        *u = (column * direction.x - x * direction.y) * k->ratio + 0.5f * (k->n_r - 1);
        return foot_of((Real)(fabs(k->ratio * direction.y)), (Real)(fabs(k->ratio * direction.x)), (Real)(k->strength),
                       k->fill, k->sigma);
    }
    float column[WIDTH], strength[WIDTH], a[WIDTH], b[WIDTH];
    for (int lane = 0; lane < WIDTH; lane++) {
        const float4 ray = look_up(k->light, k->n_across, k->n_along, direction, x, y + lane);
        column[lane] = ray.x;
        strength[lane] = ray.y;
        a[lane] = fabs(ray.z * direction.y + ray.w * direction.x);
        b[lane] = fabs(ray.z * direction.x - ray.w * direction.y);
    }
    *u = VLOAD(0, column);
    return foot_of(VLOAD(0, a), VLOAD(0, b), VLOAD(0, strength), k->fill, k->sigma);
}

static inline float greatest(Real value) {
    float lanes[WIDTH], most = 0.0f;
    VSTORE(value, 0, lanes);
    for (int lane = 0; lane < WIDTH; lane++) most = fmax(most, lanes[lane]);
    return most;
}

// Notes columns [skip, skip + taps) of those that light voxels (row, column..), at `count` poses; false if none is lit.
static inline bool note(const Scene *k, Notes *notes, int angle, int count, int row, int column, int skip, int taps) {
    const float x = row - 0.5f * (k->n_x - 1), y = column - 0.5f * (k->n_y - 1);
    const float inverse_sigma = k->sigma > 0.0f ? 1.0f / k->sigma : 0.0f;
    bool any = false;
    for (int lane = 0; lane < WIDTH; lane++) {
        notes->lit[lane] = column + lane < k->n_y && within(x, y + lane, k->radius);
        any |= notes->lit[lane];
    }
    if (!any) return false;
    for (int pose = 0; pose < count; pose++) {
        Real u;
        const Foot foot = footprints(k, k->directions[angle + pose], x, y, &u);
        const Real first = ceil(u - foot.reach) + skip;
        VSTORE(CONVERT_INT(first), 0, notes->first[pose]);
        const int most = clamp((int)(2.0f * greatest(foot.reach)) + 1 - skip, 0, taps);
        notes->taps[pose] = most;
        Real distance = u - first, above = edge(&foot, distance + 0.5f * k->fill, k->sigma, inverse_sigma);
        for (int tap = 0; tap < most; tap++, distance -= 1.0f) {
            const Real below = edge(&foot, distance - 0.5f * k->fill, k->sigma, inverse_sigma);
            VSTORE(faded(&foot, distance, k->sigma) * foot.gain * fmax(above - below, 0.0f), 0, notes->weight[pose][tap]);
            above = k->fill == 1.0f ? below : edge(&foot, distance - 1.0f + 0.5f * k->fill, k->sigma, inverse_sigma);
        }
    }
    return true;
}

// A turn by 90 degrees takes pose a to a + n_angle / 4 and voxel (x, y) to (-y, x), where the poses are evenly spread.
static inline int folds_of(const Scene *k) {
    if (k->n_angle % 4 || k->n_x != k->n_y || k->n_x % 2) return 1;
    const int quarter = k->n_angle / 4;
    for (int angle = 0; angle < k->n_angle; angle++) {
        const float2 first = k->directions[angle], turned = k->directions[(angle + quarter) % k->n_angle];
        if (fabs(turned.x + first.y) + fabs(turned.y - first.x) > 1e-6f) return 1;
    }
    return 4;
}
static inline int turned_voxel(const Scene *k, int fold, int x, int y) {
    const int last = k->n_y - 1;
    return fold == 0 ? x * k->n_y + y : fold == 1 ? (last - y) * k->n_y + x
         : fold == 2 ? (last - x) * k->n_y + last - y : y * k->n_y + last - x;
}
static inline size_t turned_row(const Scene *k, int fold, int angle) {
    return (size_t)((angle + fold * (k->n_angle / 4)) % k->n_angle) * k->n_r * LANES;
}
// The share [x, y) of `count` things that item `index` of `items` takes.
static inline int2 part_of(int index, int items, int count) {
    return (int2)((int)((long)index * count / items), (int)((long)(index + 1) * count / items));
}
// Taps of [0, count) whose columns, from `first` on, lie in the beam.
static inline int2 taps_in(int first, int count, int n_r) { return (int2)(max(-first, 0), min(count, n_r - first)); }
#else
typedef float Real;
#include "footprint.h"

// Items that differ in z alone share a tile of samples. Footprints cost more than the lanes they serve, so these items work
// out those of the next poses (or planes) together, one voxel (or cell) each, and all read them from local memory.
#define TILES ((int)(get_local_size(0) / THREADS * get_local_size(1)))
#define TILE ((int)(get_local_id(1) * (get_local_size(0) / THREADS) + get_local_id(0) / THREADS))
#define SHARERS (THREADS * (int)get_local_size(2))
#define SHARER ((int)(get_local_id(2) * THREADS + get_local_id(0) % THREADS))
#define ROUND min(8, SLOTS / TILES)     // poses or planes at a time
#define SLOT(turn) (TILE * ROUND + (turn))

// How far slab `s` of this item lies beyond its first; the surplus slabs of the last item repeat the last one there is.
static inline size_t slab_beyond(int s, int n_major, int n_minor, int n_z) {
    return (size_t)(min(ITEM_SLAB + s, (n_z - 1) / LANES) - ITEM_SLAB) * n_major * n_minor * LANES;
}

// Column, strength and footprint of one voxel at one pose.
static inline Foot footprint(__global const float4 *restrict light, int n_across, int n_along, int n_r, float2 direction,
                             float x, float y, int bent, float ratio, float strength, float fill, float sigma, float *u) {
    float4 ray = (float4)((y * direction.x - x * direction.y) * ratio + 0.5f * (n_r - 1), strength, ratio, 0.0f);
    if (bent) ray = look_up(light, n_across, n_along, direction, x, y);
    *u = ray.x;
    return foot_of(fabs(ray.z * direction.y + ray.w * direction.x), fabs(ray.z * direction.x - ray.w * direction.y), ray.y,
                   fill, sigma);
}

// Columns that no voxel has, and the columns of a tile: the first, leaving out ``skip``, and how many, a window at most.
#define NOWHERE (float2)(1e6f, -1e6f)
static inline int2 window_of(__local const float2 *lit, int skip, int n_r) {
    const float first = fmin(fmin(lit[0].x, lit[1].x), fmin(lit[2].x, lit[3].x));
    const float last = fmax(fmax(lit[0].y, lit[1].y), fmax(lit[2].y, lit[3].y));
    const int begin = max((int)first, 0) + skip;
    return (int2)(begin, clamp(min((int)last, n_r - 1) - begin + 1, 0, WINDOW));
}

// Adds sample k of a window.
#define ADD_SAMPLE(sample, k, slot) \
    do { \
        Vector value[TILE_SLABS]; \
        UNROLL for (int s = 0; s < TILE_SLABS; s++) value[s] = *(__global const Vector *)((sample) + beyond[s]); \
        const float4 weight = vload4(0, weights[k][slot]); \
        UNROLL for (int s = 0; s < TILE_SLABS; s++) { \
            sum[s][0] = fma((Vector)(weight.x), value[s], sum[s][0]); \
            sum[s][1] = fma((Vector)(weight.y), value[s], sum[s][1]); \
            sum[s][2] = fma((Vector)(weight.z), value[s], sum[s][2]); \
            sum[s][3] = fma((Vector)(weight.w), value[s], sum[s][3]); \
        } \
    } while (0)
#endif

#ifdef COMPILE_back_footprint
FIELD_KERNEL back_footprint(__global const float *restrict sinogram, __global const float2 *restrict directions,
                            __global const float4 *restrict light, int bent, float ratio, float strength, float fill,
                            float sigma, float radius, int taps, __global float *restrict volume,
                            int n_angle, int n_r, int n_z, int n_across, int n_along, int n_x, int n_y) {
#ifdef CPU
    sinogram += slab_offset(n_angle, n_r);
    volume += slab_offset(n_x, n_y);
    const Scene k = {directions, light, n_angle, n_r, n_across, n_along, n_x, n_y, bent, ratio, strength, fill, sigma, radius};
    const size_t from_slab = (size_t)n_angle * n_r * LANES, to_slab = (size_t)n_x * n_y * LANES;
    const int folds = folds_of(&k), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int2 rows = part_of(ITEM_MAJOR, get_global_size(1), folds == 4 ? n_x / 2 : n_x);
    const int y_end = folds == 4 ? n_y / 2 : n_y;
    Notes notes;
    for (int block = 0; block < n_angle; block += ANGLES) for (int skip = 0; skip < taps; skip += TAPS) {
        const int count = min(ANGLES, n_angle - block), width = min(TAPS, taps - skip);
        const bool begin = block == 0 && skip == 0;
        for (int row = rows.x; row < rows.y; row++) for (int column = 0; column < y_end; column += WIDTH) {
            const bool lit = note(&k, &notes, block, count, row, column, skip, width);
            if (!lit && !begin) continue;
            for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
                for (int lane = 0; lane < min(WIDTH, y_end - column); lane++) {
                    __global float *out = volume + slab * to_slab + (size_t)turned_voxel(&k, fold, row, column + lane) * LANES;
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
    // An item owns 2 x 2 voxels, which share most of the columns that light them.
    __local float weights[WINDOW][SLOTS][4];
    __local float2 lit[SLOTS][4];               // first and last column of each voxel
    const float inverse_sigma = sigma > 0.0f ? 1.0f / sigma : 0.0f;
    const int row = ITEM_MAJOR * 2, column = ITEM_MINOR * 2;
    const int widest = taps + (int)(1.4143f * ratio) + 1;       // columns of a tile, at most
    Vector sum[TILE_SLABS][4];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) UNROLL for (int i = 0; i < 4; i++) sum[s][i] = (Vector)(0.0f);
    size_t beyond[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) beyond[s] = slab_beyond(s, n_angle, n_r, n_z);
    sinogram += slab_offset(n_angle, n_r);
    for (int round = 0; round < n_angle; round += ROUND) {
        const int poses = min(ROUND, n_angle - round);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int work = SHARER; work < 4 * poses; work += SHARERS) {
            const int i = work % 4, slot = SLOT(work / 4);
            const float x = row + i / 2 - 0.5f * (n_x - 1), y = column + i % 2 - 0.5f * (n_y - 1);
            float u;
            const Foot foot = footprint(light, n_across, n_along, n_r, directions[round + work / 4], x, y, bent, ratio,
                                        strength, fill, sigma, &u);
            lit[slot][i] = within(x, y, radius) ? (float2)(ceil(u - foot.reach), floor(u + foot.reach)) : NOWHERE;
        }
        for (int skip = 0; skip < widest; skip += WINDOW) {
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int work = SHARER; work < 4 * poses; work += SHARERS) {
                const int i = work % 4, slot = SLOT(work / 4);
                const int2 window = window_of(lit[slot], skip, n_r);
                if (window.y == 0) continue;
                const float x = row + i / 2 - 0.5f * (n_x - 1), y = column + i % 2 - 0.5f * (n_y - 1);
                float u;
                const Foot foot = footprint(light, n_across, n_along, n_r, directions[round + work / 4], x, y, bent, ratio,
                                            strength, fill, sigma, &u);
                const float2 mine = lit[slot][i];
                float distance = u - window.x, above = 0.0f;
                bool fresh = true;          // whether the integral up to this column's upper edge is yet to be found
                for (int k = 0; k < window.y; k++, distance -= 1.0f) {
                    float weight = 0.0f;
                    if (window.x + k >= mine.x && window.x + k <= mine.y) {
                        if (fresh) above = edge(&foot, distance + 0.5f * fill, sigma, inverse_sigma);
                        const float below = edge(&foot, distance - 0.5f * fill, sigma, inverse_sigma);
                        weight = faded(&foot, distance, sigma) * foot.gain * fmax(above - below, 0.0f);
                        above = below;
                        fresh = fill != 1.0f;
                    }
                    weights[k][slot][i] = weight;
                }
            }
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int turn = 0; turn < poses; turn++) {
                const int slot = SLOT(turn);
                const int2 window = window_of(lit[slot], skip, n_r);
                __global const float *sample = sinogram + SAMPLE(round + turn, window.x, n_r);
                for (int k = 0; k < window.y; k++, sample += LANES) ADD_SAMPLE(sample, k, slot);
            }
        }
    }
    volume += slab_offset(n_x, n_y);
    UNROLL for (int i = 0; i < 4; i++) if (row + i / 2 < n_x && column + i % 2 < n_y)
        UNROLL for (int s = 0; s < TILE_SLABS; s++)
            *(__global Vector *)(volume + SAMPLE(row + i / 2, column + i % 2, n_y) + slab_beyond(s, n_x, n_y, n_z)) = sum[s][i];
#endif
}
#endif

#ifdef COMPILE_forward_footprint
#ifdef GPU
// The cells of a plane between which the light of some columns may fall, from the chords on either side of it.
typedef struct {
    bool along_y;               // planes are of constant y
    int planes, cells;
    float2 from, to;            // crossing with plane 0 and drift per plane of either chord
    float slack;
} Span;

// Where a chord (p, cos d, sin d) turned to one pose crosses plane 0, and how far it drifts from plane to plane.
static inline float2 line(float4 chord, float2 direction, bool along_y, float planes_middle, float cells_middle) {
    const float c = direction.x * chord.y - direction.y * chord.z, s = direction.y * chord.y + direction.x * chord.z;
    const float p = chord.x;                // the chord is y c - x s = p
    const float slope = along_y ? c / s : s / c, start = along_y ? -p / s : p / c;
    return (float2)(start - planes_middle * slope + cells_middle, slope);
}

// Of columns r to r + 3.
static inline Span span_of(__global const float8 *restrict edges, int r, int n_r, float2 direction, int n_x, int n_y) {
    const int final = min(r + 3, n_r - 1);
    const float4 low = edges[min(r, n_r - 1)].lo, high = edges[final].hi;
    // the chord's own direction decides which planes it crosses most steeply
    const float c = direction.x * low.y - direction.y * low.z, s = direction.y * low.y + direction.x * low.z;
    Span span;
    span.along_y = fabs(s) > fabs(c);
    span.planes = span.along_y ? n_y : n_x;
    span.cells = span.along_y ? n_x : n_y;
    const float planes_middle = 0.5f * (span.planes - 1), cells_middle = 0.5f * (span.cells - 1);
    span.from = line(low, direction, span.along_y, planes_middle, cells_middle);
    span.to = line(high, direction, span.along_y, planes_middle, cells_middle);
    span.slack = 0.0f;
    for (int column = min(r, n_r - 1); column <= final; column++) span.slack = fmax(span.slack, edges[column].s3);
    return span;
}

// First cell of a plane, leaving out ``skip``, and how many from there on, a window at most.
static inline int2 cells_of(const Span *span, int plane, int skip) {
    const float a = span->from.x + plane * span->from.y, b = span->to.x + plane * span->to.y;
    const int first = max((int)ceil(fmin(a, b) - span->slack), 0) + skip;
    const int last = min((int)floor(fmax(a, b) + span->slack), span->cells - 1);
    return (int2)(first, plane < span->planes ? clamp(last - first + 1, 0, WINDOW) : 0);
}
#endif

FIELD_KERNEL forward_footprint(__global const float *restrict volume, __global const float2 *restrict directions,
                               __global const float4 *restrict light, __global const float8 *restrict edges, int bent,
                               float ratio, float strength, float fill, float sigma, float radius, int taps, int cells,
                               __global float *restrict sinogram,
                               int n_x, int n_y, int n_z, int n_angle, int n_across, int n_along, int n_r) {
#ifdef CPU
    volume += slab_offset(n_x, n_y);
    sinogram += slab_offset(n_angle, n_r);
    const Scene k = {directions, light, n_angle, n_r, n_across, n_along, n_x, n_y, bent, ratio, strength, fill, sigma, radius};
    const size_t from_slab = (size_t)n_x * n_y * LANES, to_slab = (size_t)n_angle * n_r * LANES;
    const int folds = folds_of(&k), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int x_end = folds == 4 ? n_x / 2 : n_x, y_end = folds == 4 ? n_y / 2 : n_y;
    const int2 angles = part_of(ITEM_MAJOR, get_global_size(1), folds == 4 ? n_angle / 4 : n_angle);
    for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
        for (int angle = angles.x; angle < angles.y; angle++) {
            __global float *out = sinogram + slab * to_slab + turned_row(&k, fold, angle);
            for (int r = 0; r < n_r * VECTORS; r++) *(__global Vector *)(out + r * WIDTH) = (Vector)(0.0f);
        }
    // An item owns whole poses, so that voxels may add to any column of them.
    Notes notes;
    for (int block = angles.x; block < angles.y; block += ANGLES) for (int skip = 0; skip < taps; skip += TAPS) {
        const int count = min(ANGLES, angles.y - block), width = min(TAPS, taps - skip);
        // Footprints are those of a quarter of the grid at all poses, as in the other direction, rounded the same.
        for (int quarter = 0; quarter < folds; quarter++) for (int row = 0; row < x_end; row++)
        for (int column = 0; column < y_end; column += WIDTH) {
            const int first_pose = block + quarter * (n_angle / 4);
            if (!note(&k, &notes, first_pose, count, row, column, skip, width)) continue;
            for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++)
                for (int lane = 0; lane < min(WIDTH, y_end - column); lane++) {
                    if (!notes.lit[lane]) continue;
                    __global const float *from =
                        volume + slab * from_slab + (size_t)turned_voxel(&k, fold, row, column + lane) * LANES;
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
    // An item owns four neighbouring columns of one pose, whose rays share most of the cells that they meet in a plane.
    __local float weights[WINDOW][SLOTS][4];
    const float inverse_sigma = sigma > 0.0f ? 1.0f / sigma : 0.0f;
    const int angle = min((int)ITEM_MAJOR, n_angle - 1), r = ITEM_MINOR * 4;
    const float2 direction = directions[angle];
    const Span span = span_of(edges, r, n_r, direction, n_x, n_y);
    const int step = span.along_y ? n_y * LANES : LANES;
    Vector sum[TILE_SLABS][4];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) UNROLL for (int i = 0; i < 4; i++) sum[s][i] = (Vector)(0.0f);
    size_t beyond[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) beyond[s] = slab_beyond(s, n_x, n_y, n_z);
    volume += slab_offset(n_x, n_y);
    for (int round = 0; round < max(n_x, n_y); round += ROUND) for (int skip = 0; skip < cells; skip += WINDOW) {
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int work = SHARER; work < ROUND * WINDOW; work += SHARERS) {
            const int turn = work / WINDOW, k = work % WINDOW, plane = round + turn;
            const int2 window = cells_of(&span, plane, skip);
            if (k >= window.y) continue;
            const float x = (span.along_y ? window.x + k : plane) - 0.5f * (n_x - 1);
            const float y = (span.along_y ? plane : window.x + k) - 0.5f * (n_y - 1);
            float u;
            const Foot foot = footprint(light, n_across, n_along, n_r, direction, x, y, bent, ratio, strength, fill, sigma, &u);
            float weight[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            if (within(x, y, radius) && u - r + foot.reach >= 0.0f && u - r - foot.reach <= 3.0f) {
                float distance = u - r, above = edge(&foot, distance + 0.5f * fill, sigma, inverse_sigma);
                UNROLL for (int i = 0; i < 4; i++, distance -= 1.0f) {
                    const float below = edge(&foot, distance - 0.5f * fill, sigma, inverse_sigma);
                    weight[i] = faded(&foot, distance, sigma) * foot.gain * fmax(above - below, 0.0f);
                    above = fill == 1.0f ? below : edge(&foot, distance - 1.0f + 0.5f * fill, sigma, inverse_sigma);
                }
            }
            vstore4((float4)(weight[0], weight[1], weight[2], weight[3]), 0, weights[k][SLOT(turn)]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int turn = 0; turn < ROUND; turn++) {
            const int slot = SLOT(turn), plane = round + turn;
            const int2 window = cells_of(&span, plane, skip);
            __global const float *sample =
                volume + (span.along_y ? SAMPLE(window.x, plane, n_y) : SAMPLE(plane, window.x, n_y));
            for (int k = 0; k < window.y; k++, sample += step) ADD_SAMPLE(sample, k, slot);
        }
    }
    sinogram += slab_offset(n_angle, n_r);
    if (ITEM_MAJOR < n_angle) UNROLL for (int i = 0; i < 4; i++) if (r + i < n_r)
        UNROLL for (int s = 0; s < TILE_SLABS; s++)
            *(__global Vector *)(sinogram + SAMPLE(angle, r + i, n_r) + slab_beyond(s, n_angle, n_r, n_z)) = sum[s][i];
#endif
}
#endif
