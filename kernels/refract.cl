#include "common.h"

// Column index and weight of the light at a voxel (x, y), relative to the axis, at one pose.
static inline float2 look_up(__global const float2 *restrict light, int n_across, int n_along, float2 direction,
                             float x, float y) {
    const float across = fma(y, direction.x, -x * direction.y) + 0.5f * (n_across - 1);
    const float along = fma(-x, direction.x, -y * direction.y) + 0.5f * (n_along - 1);
    const int i = clamp((int)across, 0, n_across - 2), j = clamp((int)along, 0, n_along - 2);
    const float a = across - i, b = along - j;
    __global const float2 *here = light + i * n_along + j;
    const float2 near = here[0] + b * (here[1] - here[0]);
    const float2 far = here[n_along] + b * (here[n_along + 1] - here[n_along]);
    return near + a * (far - near);
}

// Half-integers below 2048 square exactly in float32, so both directions agree on every voxel.
static inline bool within(float x, float y, float radius) { return x * x + y * y <= radius * radius; }

// How much of a voxel, 2 reach - 1 = 1 / inverse columns wide, lies in a column that far from it.
static inline float overlap(float distance, float reach, float inverse) {
    return clamp(reach - fabs(distance), 0.0f, 1.0f) * inverse;
}

#ifdef GPU
// How far slab `s` of this item lies beyond its first; the surplus slabs of the last item repeat the last one there is.
static inline size_t slab_beyond(int s, int n_major, int n_minor, int n_z) {
    return (size_t)(min(ITEM_SLAB + s, (n_z - 1) / LANES) - ITEM_SLAB) * n_major * n_minor * LANES;
}
#endif

#ifdef CPU
// On a CPU core a look-up costs as much as the lanes it serves, so it is made once and noted, then applied to every slab
// and, where a quarter turn maps grid and poses onto themselves, to all four quarters (folds). TOGETHER neighbours are
// noted before any is applied, because they read the same samples: those then come from the nearest cache.
typedef struct {
    int count;
    float weight[CAPACITY];
    int from[4][CAPACITY];      // sample of the source field, per fold
    int to[4];                  // sample of the target field, per fold
} Notes;

static inline void apply(const Notes *notes, int members, int folds, int slabs, __global const float *restrict source,
                         size_t source_slab, __global float *restrict target, size_t target_slab) {
    for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++) {
        __global const float *from = source + slab * source_slab;
        for (int member = 0; member < members; member++) {
            const Notes *own = notes + member;
            __global float *out = target + slab * target_slab + (size_t)own->to[fold] * LANES;
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

static inline void clear(const Notes *notes, int folds, int slabs, __global float *target, size_t target_slab) {
    for (int fold = 0; fold < folds; fold++) for (int slab = 0; slab < slabs; slab++) {
        __global float *out = target + slab * target_slab + (size_t)notes->to[fold] * LANES;
        EACH_VECTOR STORE(out, (Vector)(0.0f));
    }
}

// A turn by 90 degrees takes pose a to a + n_angle / 4 and voxel (x, y) to (-y, x), unless the poses are part of a turn.
static inline int folds_of(__global const float2 *directions, int n_angle, int n_x, int n_y) {
    if (n_angle % 4 || n_x != n_y || n_x % 2) return 1;
    const float2 first = directions[0], turned = directions[n_angle / 4];
    return fabs(turned.x + first.y) + fabs(turned.y - first.x) < 1e-4f ? 4 : 1;
}
static inline int turned_voxel(int fold, int x, int y, int n_y) {
    const int last = n_y - 1;
    return fold == 0 ? x * n_y + y : fold == 1 ? (last - y) * n_y + x
         : fold == 2 ? (last - x) * n_y + last - y : y * n_y + last - x;
}
static inline int turned_column(int fold, int angle, int column, int n_angle, int n_r) {
    return (angle + fold * (n_angle / 4)) % n_angle * n_r + column;
}
// The share [x, y) of `count` things that item `index` of `items` takes.
static inline int2 share(int index, int items, int count) {
    return (int2)((int)((long)index * count / items), (int)((long)(index + 1) * count / items));
}
#endif

#ifdef COMPILE_back_refracted
FIELD_KERNEL back_refracted(__global const float *restrict sinogram, __global const float2 *restrict directions,
                            __global const float2 *restrict light, float width, float radius,
                            __global float *restrict volume,
                            int n_angle, int n_r, int n_z, int n_across, int n_along, int n_x, int n_y) {
    const float inverse = 1.0f / width, reach = 0.5f * (1.0f + width), x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1);
    const int taps = (int)ceil(2.0f * reach);
    sinogram += slab_offset(n_angle, n_r);
    volume += slab_offset(n_x, n_y);
#ifdef CPU
    const size_t from_slab = (size_t)n_angle * n_r * LANES, to_slab = (size_t)n_x * n_y * LANES;
    const int folds = folds_of(directions, n_angle, n_x, n_y), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int2 rows = share(ITEM_MAJOR, get_global_size(1), folds == 4 ? n_x / 2 : n_x);
    const int y_end = folds == 4 ? n_y / 2 : n_y;
    Notes notes[TOGETHER];
    for (int block = 0; block < n_angle; block += ANGLES)
        for (int row = rows.x; row < rows.y; row++) for (int y_begin = 0; y_begin < y_end; y_begin += TOGETHER) {
            const int members = min(TOGETHER, y_end - y_begin);
            for (int member = 0; member < members; member++) {
                Notes *own = notes + member;
                const int column = y_begin + member;
                own->count = 0;
                for (int fold = 0; fold < folds; fold++) own->to[fold] = turned_voxel(fold, row, column, n_y);
                if (!block) clear(own, folds, slabs, volume, to_slab);
                if (!within(row - x0, column - y0, radius)) continue;
                for (int angle = block; angle < min(n_angle, block + ANGLES); angle++) {
                    const float2 ray = look_up(light, n_across, n_along, directions[angle], row - x0, column - y0);
                    const int first = (int)ceil(ray.x - reach);
                    for (int tap = max(first, 0); tap < min(first + taps, n_r); tap++) {
                        if (own->count == CAPACITY) {
                            apply(own, 1, folds, slabs, sinogram, from_slab, volume, to_slab);
                            own->count = 0;
                        }
                        for (int fold = 0; fold < folds; fold++)
                            own->from[fold][own->count] = turned_column(fold, angle, tap, n_angle, n_r);
                        own->weight[own->count++] = ray.y * overlap(ray.x - tap, reach, inverse);
                    }
                }
            }
            apply(notes, members, folds, slabs, sinogram, from_slab, volume, to_slab);
        }
#else
    const int row = ITEM_MAJOR, column = ITEM_MINOR;
    if (row >= n_x || column >= n_y) return;
    const float x = row - x0, y = column - y0;
    Vector sum[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) sum[s] = (Vector)(0.0f);
    if (within(x, y, radius)) for (int angle = 0; angle < n_angle; angle++) {
        const float2 ray = look_up(light, n_across, n_along, directions[angle], x, y);
        const int first = (int)ceil(ray.x - reach);
        for (int tap = max(first, 0); tap < min(first + taps, n_r); tap++) {
            const float weight = ray.y * overlap(ray.x - tap, reach, inverse);
            __global const float *sample = sinogram + SAMPLE(angle, tap, n_r);
            UNROLL for (int s = 0; s < TILE_SLABS; s++)
                sum[s] += weight * *(__global const Vector *)(sample + slab_beyond(s, n_angle, n_r, n_z));
        }
    }
    UNROLL for (int s = 0; s < TILE_SLABS; s++)
        *(__global Vector *)(volume + SAMPLE(row, column, n_y) + slab_beyond(s, n_x, n_y, n_z)) = sum[s];
#endif
}
#endif

#ifdef COMPILE_forward_refracted
// The cells of plane `plane` between which one column's light may fall, from the chords on either side of it.
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

static inline Span span_of(float8 edge, float2 direction, int n_x, int n_y) {
    const float4 low = edge.lo, high = edge.hi;
    // the chord's own direction decides which planes it crosses most steeply
    const float c = direction.x * low.y - direction.y * low.z, s = direction.y * low.y + direction.x * low.z;
    Span span;
    span.along_y = fabs(s) > fabs(c);
    span.planes = span.along_y ? n_y : n_x;
    span.cells = span.along_y ? n_x : n_y;
    const float planes_middle = 0.5f * (span.planes - 1), cells_middle = 0.5f * (span.cells - 1);
    span.from = line(low, direction, span.along_y, planes_middle, cells_middle);
    span.to = line(high, direction, span.along_y, planes_middle, cells_middle);
    span.slack = low.w;
    return span;
}

static inline int2 cells_of(const Span *span, int plane) {
    const float a = span->from.x + plane * span->from.y, b = span->to.x + plane * span->to.y;
    return (int2)(max((int)ceil(fmin(a, b) - span->slack), 0), min((int)floor(fmax(a, b) + span->slack), span->cells - 1));
}

FIELD_KERNEL forward_refracted(__global const float *restrict volume, __global const float2 *restrict directions,
                               __global const float2 *restrict light, __global const float8 *restrict edges,
                               float width, float radius, __global float *restrict sinogram,
                               int n_x, int n_y, int n_z, int n_angle, int n_across, int n_along, int n_r) {
    const float inverse = 1.0f / width, reach = 0.5f * (1.0f + width), x0 = 0.5f * (n_x - 1), y0 = 0.5f * (n_y - 1);
    volume += slab_offset(n_x, n_y);
    sinogram += slab_offset(n_angle, n_r);
#ifdef CPU
    const size_t from_slab = (size_t)n_x * n_y * LANES, to_slab = (size_t)n_angle * n_r * LANES;
    const int folds = folds_of(directions, n_angle, n_x, n_y), slabs = min(TILE_SLABS, (n_z + LANES - 1) / LANES - ITEM_SLAB);
    const int2 angles = share(ITEM_MAJOR, get_global_size(1), n_angle / folds);
    const int longest = max(n_x, n_y);
    Notes notes[POSES * RAYS];
    for (int strip = 0; strip < longest; strip += STRIP)
        for (int group = angles.x; group < angles.y; group += POSES) for (int r_begin = 0; r_begin < n_r; r_begin += RAYS) {
            const int poses = min(POSES, angles.y - group), rays = min(RAYS, n_r - r_begin);
            for (int member = 0; member < poses * rays; member++) {
                Notes *own = notes + member;
                const int angle = group + member / rays, r = r_begin + member % rays;
                const float2 direction = directions[angle];
                const Span span = span_of(edges[r], direction, n_x, n_y);
                own->count = 0;
                for (int fold = 0; fold < folds; fold++) own->to[fold] = turned_column(fold, angle, r, n_angle, n_r);
                if (!strip) clear(own, folds, slabs, sinogram, to_slab);
                for (int plane = strip; plane < min(strip + STRIP, span.planes); plane++) {
                    const int2 cells = cells_of(&span, plane);
                    for (int cell = cells.x; cell <= cells.y; cell++) {
                        const int i = span.along_y ? cell : plane, j = span.along_y ? plane : cell;
                        if (!within(i - x0, j - y0, radius)) continue;
                        const float2 ray = look_up(light, n_across, n_along, direction, i - x0, j - y0);
                        const float weight = ray.y * overlap(ray.x - r, reach, inverse);
                        if (weight == 0.0f) continue;
                        if (own->count == CAPACITY) {
                            apply(own, 1, folds, slabs, volume, from_slab, sinogram, to_slab);
                            own->count = 0;
                        }
                        for (int fold = 0; fold < folds; fold++)
                            own->from[fold][own->count] = turned_voxel(fold, i, j, n_y);
                        own->weight[own->count++] = weight;
                    }
                }
            }
            apply(notes, poses * rays, folds, slabs, volume, from_slab, sinogram, to_slab);
        }
#else
    const int angle = ITEM_MAJOR, r = ITEM_MINOR;
    if (angle >= n_angle || r >= n_r) return;
    const float2 direction = directions[angle];
    const Span span = span_of(edges[r], direction, n_x, n_y);
    Vector sum[TILE_SLABS];
    UNROLL for (int s = 0; s < TILE_SLABS; s++) sum[s] = (Vector)(0.0f);
    for (int plane = 0; plane < span.planes; plane++) {
        const int2 cells = cells_of(&span, plane);
        for (int cell = cells.x; cell <= cells.y; cell++) {
            const int i = span.along_y ? cell : plane, j = span.along_y ? plane : cell;
            if (!within(i - x0, j - y0, radius)) continue;
            const float2 ray = look_up(light, n_across, n_along, direction, i - x0, j - y0);
            const float weight = ray.y * overlap(ray.x - r, reach, inverse);
            __global const float *sample = volume + SAMPLE(i, j, n_y);
            if (weight > 0.0f) UNROLL for (int s = 0; s < TILE_SLABS; s++)
                sum[s] += weight * *(__global const Vector *)(sample + slab_beyond(s, n_x, n_y, n_z));
        }
    }
    UNROLL for (int s = 0; s < TILE_SLABS; s++)
        *(__global Vector *)(sinogram + SAMPLE(angle, r, n_r) + slab_beyond(s, n_angle, n_r, n_z)) = sum[s];
#endif
}
#endif
