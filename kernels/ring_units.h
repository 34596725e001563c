// The products of `light_rings` and `gather_rings` on matrix units. A group computes sixteen tiles of cells, or the real and
// imaginary parts of 64 pairs of columns, of SLABS slabs, at a frequency and at that of conjugate entries; a warp, half of
// these rows of one slab. A step takes sixteen columns of the matrix. Each warp fetches its part of the entries and the
// light of a step into registers (entries half a step ahead, light a step ahead), and stores them as halves for all.
#include "matrix_units.h"
#define TILES 16
#define PAIRS 64
#define GROUP_KERNEL __kernel __attribute__((reqd_work_group_size(GROUP, 1, SLABS))) void
#define WARP ((int)(get_local_id(2) * GROUP + get_local_id(0)) / 32)
// Matrices of entries that a warp fetches, of eight, each of two tiles.
#define OWN (4 / SLABS)
#define EACH_PART(own, t) UNROLL for (int own = 0; own < OWN; own++) UNROLL for (int t = 0; t < 2; t++)

// Position of a group; those of the same entries follow each other. An unpaired frequency uses its position twice.
#define PLACE                                                                                                          \
    __local uint4 held[2][SLABS][2][2 * LIGHT], matrix[2][8][2 * MATRIX];                                             \
    __local float scale[2][SLABS][2];                                                                                  \
    const int blocks = get_num_groups(2), across = get_num_groups(0), item = WARP_ITEM, strip = get_local_id(0) / 32;  \
    const int number = get_group_id(0) + across * (get_group_id(1) + get_num_groups(1) * get_group_id(2));             \
    const int here = number / blocks % across, k = number / (blocks * across), last = (n_z - 1) / LANES;               \
    const int beside = get_local_id(2), slab = number % blocks * SLABS + beside;                                       \
    const int alone = k == 0 || 2 * k == n_k, other_k = alone ? k : n_k - k, turned = strip && !alone;                 \
    __global const int4 *tile = (__global const int4 *)order + k * n_tile;                                             \
    __global const float4 *frequency =                                                                                 \
        (__global const float4 *)(entries + (size_t)k * (n_entry / (n_k / 2 + 1))) + ENTRIES_OF_ITEM;                  \
    __local const uint4 *light_from = held[0][beside][0], *matrix_from = matrix[0][strip * TALL] + item;              \
    __local uint2 *light_to = (__local uint2 *)held[0][beside][strip];                                                \
    __local uint2 *matrix_to = (__local uint2 *)matrix[0][WARP * OWN] + PLACE_OF_ENTRIES;                              \
    const int place = place_of_light(item / 8, item % 8), lower = place_of_light(item / 8 + 4, item % 8);              \
    const int named = named_row_of_light(item);                                                                        \
    const float2 unit = scale_of(as_uint(greatest));                                                                   \
    float4 next_light[4], next_entries[OWN][2], sums[2][TALL][WIDE];                                                   \
    int there[OWN][2];                                                                                                 \
    UNROLL for (int which = 0; which < 2; which++) UNROLL for (int m = 0; m < TALL; m++)                               \
        UNROLL for (int n = 0; n < WIDE; n++) sums[which][m][n] = (float4)(0.0f);
// Where the light of a warp's slab and side begins in a field with this number of samples.
#define LIGHT_OF_WARP(field, samples)                                                                                  \
    (__global const float4 *)(field) + ((size_t)min(slab, last) * n_k + (strip ? other_k : k)) * (samples) * THREADS + item

// Where an item finds four entries of eight pairs of a tile, and stores those of the first of two tiles. Columns of the
// matrix are eight real parts, then eight imaginary ones, of rows that are cells; or the reverse.
#define ENTRIES_OF_ITEM (item / 2 % 8 * 4 + item / 16 * 2 + item % 2)
#define PLACE_OF_ENTRIES (item / 16 * (CELLS_IN_ROWS ? 32 : 16) + item % 16)
#define FETCH_ENTRIES(step)                                                                                            \
    EACH_PART(own, t) {                                                                                                \
        there[own][t] = THERE(step, own, t);                                                                           \
        next_entries[own][t] = fetched(frequency + (there[own][t] ? ENTRIES_OF(step, own, t) : 0));                    \
    }
#define FETCH_LIGHT(step) UNROLL for (int i = 0; i < 4; i++) next_light[i] = fetched(LIGHT_OF(step, i / 2, i % 2));
// 0, but not before sums are known: keeps compilers from waiting for fetches that run ahead of their products.
#define NOTHING(which) as_float(OR_OF(which, 0) | OR_OF(which, 1))
#define OR_OF(which, n)                                                                                                \
    ((as_uint(sums[which][0][n].x) | as_uint(sums[which][1][n].x) | as_uint(sums[which][2][n].x)                       \
      | as_uint(sums[which][3][n].x)) & (uint)(n_z >> 31))
#define LAY_ENTRIES(side, whole, nothing)                                                                              \
    {                                                                                                                  \
        const float factor = unit.x + nothing;                                                                         \
        EACH_PART(own, t) lay(matrix_to + ((side) * 8 + own) * 4 * MATRIX + t * (CELLS_IN_ROWS ? 16 : 32), 2 * MATRIX, \
                              (there[own][t] ? factor : 0.0f) * next_entries[own][t], whole);                          \
    }
#define LAY_LIGHT(side, whole, nothing)                                                                                \
    {                                                                                                                  \
        const float none = nothing;                                                                                    \
        PAIRED                                                                                                         \
        const float most = fmax(fmax(greatest_of(none, next_light[0]), greatest_of(none, next_light[1])),              \
                                fmax(greatest_of(none, next_light[2]), greatest_of(none, next_light[3])));             \
        const float2 factor = scale_of(greatest_of_warp(as_uint(most)));                                               \
        if (item == 0) scale[side][beside][strip] = factor.y * unit.y;                                                 \
        UNROLL for (int i = 0; i < 4; i++)                                                                             \
            lay(light_to + (side) * SLABS * 8 * LIGHT + i / 2 * LIGHT + (i % 2 ? lower : place), 2 * LIGHT,            \
                SCALED(next_light[i], factor.x, i / 2), whole);                                                        \
    }
#define MULTIPLY(side, which, whole)                                                                                   \
    add_products(sums[which], rows, rest, scale[side][beside][which],                                                  \
                 light_from + ((side) * SLABS * 2 + (which)) * 2 * LIGHT, named, whole);
#define EACH_STEP(whole)                                                                                               \
    {                                                                                                                  \
        FETCH_LIGHT(0)                                                                                                 \
        FETCH_ENTRIES(0)                                                                                               \
        LAY_LIGHT(0, whole, 0.0f)                                                                                      \
        FETCH_LIGHT(1)                                                                                                 \
        LAY_ENTRIES(0, whole, 0.0f)                                                                                    \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                                  \
        for (int step = 0; IS_STEP(step); step++) {                                                                    \
            const int side = step % 2;                                                                                 \
            uint4 rows[TALL], rest[TALL];                                                                              \
            UNROLL for (int m = 0; m < TALL; m++) {                                                                    \
                __local const uint4 *at = matrix_from + (side * 8 + m) * 2 * MATRIX;                                   \
                rows[m] = CELLS_IN_ROWS ? turned_matrices(at) : matrices(at);                                          \
                rest[m] = !(whole) ? (uint4)(0) : CELLS_IN_ROWS ? turned_matrices(at + MATRIX) : matrices(at + MATRIX); \
            }                                                                                                          \
            LOOK_AHEAD(step)                                                                                           \
            MULTIPLY(side, 0, whole)                                                                                   \
            LAY_LIGHT(1 - side, whole, NOTHING(0))                                                                     \
            FETCH_LIGHT(step + 2)                                                                                      \
            FETCH_ENTRIES(step + 1)                                                                                    \
            ASKED                                                                                                      \
            MULTIPLY(side, 1, whole)                                                                                   \
            LAY_ENTRIES(1 - side, whole, NOTHING(1))                                                                   \
            CLOSE_STEP                                                                                                 \
            barrier(CLK_LOCAL_MEM_FENCE);                                                                              \
        }                                                                                                              \
    }

#ifdef COMPILE_light_rings
#define CELLS_IN_ROWS 1
#define IS_STEP(step) ((step) < n_step)
// Right of the middle, or left; pairs beyond the last have entries that are zero, and any light.
#define LIGHT_OF(step, left, lower)                                                                                    \
    (own_light + ((left) ? leftmost : 0)                                                                               \
     + ((left) ? onward : THREADS) * min(RIGHT((step) * ROWS + item / 8 + 4 * (lower)), n_r - 1))
#define ENTRIES_OF(step, own, t) (from[own][t] + (step) * 32)
#define THERE(step, own, t) ((step) < steps[own][t])
#define LOOK_AHEAD(step) if ((step) + 3 < reach) call(ahead + ((step) + 3) * stride);
#define CLOSE_STEP
// Sums of columns, then differences.
#define PAIRED                                                                                                         \
    UNROLL for (int i = 0; i < 2; i++) {                                                                               \
        const float4 right = next_light[i], left = both * next_light[i + 2];                                           \
        next_light[i] = right + left;                                                                                  \
        next_light[i + 2] = right - left;                                                                              \
    }
// Differences are multiplied by ±i.
#define SCALED(value, factor, t)                                                                                       \
    ((t) ? sign * (factor) * (float4)(-(value).y, (value).x, -(value).w, (value).z) : (factor) * (value))
GROUP_KERNEL light_rings(ARRAY light, __global const float *restrict entries, float greatest,
                         __global const int *restrict tiles, __global const int *restrict lit,
                         __global const int *restrict order, int mirrored, int tf32,
                         __global float *restrict spectrum, int n_k, int n_r, int n_z, int n_entry, int n_tile,
                         int n_frequency, int n_cell) {
    PLACE
    const int n_step = max(tile[here * TILES].y / ROWS, 1);
    const int leftmost = mirrored ? (n_r - 1) * THREADS : 0, onward = mirrored ? -THREADS : THREADS;
    __global const float4 *own_light = LIGHT_OF_WARP(light, n_r) - item + item % THREADS;
    const float sign = turned ? -1.0f : 1.0f, both = mirrored ? 1.0f : 0.0f;
    int from[OWN][2], steps[OWN][2];
    EACH_PART(own, t) {
        const int at = here * TILES + (WARP * OWN + own) * 2 + t;
        const int4 given = tile[min(at, n_tile - 1)];
        from[own][t] = given.x / 4;
        steps[own][t] = at < n_tile ? given.y / ROWS : 0;
    }
    // A line of the warp's fetches: half of its items look ahead for light, half for entries, four lines per tile.
    const int line = item % 16, light_ahead = item < 16;
    const int4 given = tile[min(here * TILES + WARP * OWN * 2 + line / 4, n_tile - 1)];
    const int there_are = (n_r - RIGHT(line % 8) + ROWS - 1) / ROWS, steps_ahead = min(n_step, there_are);
    const int reach = light_ahead ? steps_ahead : given.y / ROWS, way = line / 8 ? onward : THREADS;
    const int stride = light_ahead ? ROWS * way : 32;
    __global const float4 *ahead = light_ahead ? own_light - item % THREADS + (line / 8 ? leftmost : 0) + way * RIGHT(line % 8)
                                               : frequency - ENTRIES_OF_ITEM + given.x / 4 + line % 4 * 8;
    if (tf32)
        EACH_STEP(0)
    else
        EACH_STEP(1)
    if (slab > last) return;
    UNROLL for (int m = 0; m < TALL; m++) UNROLL for (int t = 0; t < 2; t++) {
        const int at = here * TILES + (strip * TALL + m) * 2 + t;
        if (at >= n_tile) continue;
        const int4 own = tile[at];
        UNROLL for (int which = 0; which < 2; which++) {
            if (which && alone) continue;
            const int cell = (which ? own.w : own.z) * ROWS + item / 4;
            __global float *to = spectrum + (((size_t)slab * n_k + (which ? other_k : k)) * n_cell + cell) * LANES;
            UNROLL for (int n = 0; n < WIDE; n++)
                *(__global float2 *)(to + SLICE_OF(n)) = t ? sums[which][m][n].hi : sums[which][m][n].lo;
        }
    }
}
#endif

#ifdef COMPILE_gather_rings
#define CELLS_IN_ROWS 0
// The two tiles of a step: those that pairs from `begin` on do not light follow all others, and zeros come last.
#define GIVEN(step, t) given[(step) % 4][t]
#define LOOK_AHEAD(step)                                                                                               \
    if (WARP == 0 && item < 2)                                                                                         \
        bring(&GIVEN((step) + 3, item), tile + 2 * ((step) + 3) + item, 2 * ((step) + 3) + item < n_tile);
#define CLOSE_STEP WAIT_FOR_BROUGHT
#define IS_STEP(step) (GIVEN(step, 0).y > begin)
#define LIGHT_OF(step, t, lower) (own_light + ((turned ? GIVEN(step, t).w : GIVEN(step, t).z) * ROWS + 4 * (lower)) * THREADS)
#define ENTRIES_OF(step, own, t) (GIVEN(step, t).x / 4 + (begin / ROWS + WARP * OWN + own) * 32)
#define THERE(step, own, t) (begin + ROWS * (WARP * OWN + own) < GIVEN(step, t).y)
#define PAIRED
#define SCALED(value, factor, t) ((factor) * (value))
GROUP_KERNEL gather_rings(ARRAY spectrum, __global const float *restrict entries, float greatest,
                          __global const int *restrict tiles, __global const int *restrict lit,
                          __global const int *restrict order, int mirrored, int tf32,
                          __global float *restrict light, int n_k, int n_cell, int n_z, int n_entry, int n_tile,
                          int n_frequency, int n_r) {
    PLACE
    const int end = ALL_PAIRS, begin = here * PAIRS;
    if (begin >= end) return;
    __global const float4 *own_light = LIGHT_OF_WARP(spectrum, n_cell);
    __local int4 given[4][2];
    for (int step = -3; step < 0; step++) LOOK_AHEAD(step)
    WAIT_FOR_BROUGHT
    barrier(CLK_LOCAL_MEM_FENCE);
    if (tf32)
        EACH_STEP(0)
    else
        EACH_STEP(1)
    if (slab > last) return;
    UNROLL for (int m = 0; m < TALL; m++) {
        const int pair = begin + (strip * TALL + m) * ROWS + item / 4;
        if (pair >= end) continue;
        const int right = RIGHT(pair), left = mirrored ? LEFT(pair) : right, single = mirrored && right == left;
        UNROLL for (int which = 0; which < 2; which++) {
            if (which && alone) continue;
            __global float *to = light + ((size_t)slab * n_k + (which ? other_k : k)) * n_r * LANES;
            UNROLL for (int n = 0; n < WIDE; n++) {
                const float2 sum = sums[which][m][n].lo, other = sums[which][m][n].hi;
                const float2 difference = (which ? 1.0f : -1.0f) * (float2)(-other.y, other.x);
                *(__global float2 *)(to + left * LANES + SLICE_OF(n)) = sum - difference;
                *(__global float2 *)(to + right * LANES + SLICE_OF(n)) = sum + (single ? sum : difference);
            }
        }
    }
}
#endif
