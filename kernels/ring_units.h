// The products of `light_rings` and `gather_rings` on matrix units. A group of eight warps computes 64 cells, or the real
// and imaginary parts of 32 pairs of columns, of four slabs; a warp 32 of these rows of one. What the next rounds take is on
// its way into local memory while one is computed.
#include "matrix_units.h"
#define ROUNDS 3
// From one row of local memory to the next, in fours of floats, so that what a warp reads lies in different banks.
#define LIGHT_STEP ((LANES + 8) / 4)
#define CELL_STEP ((CELLS + 8) / 4)
#define PAIR_STEP ((DEEP + 4) / 4)
#define CELLS 64
#define PAIRS 32
#define GROUP_KERNEL __kernel __attribute__((reqd_work_group_size(GROUP, 1, SLABS))) void
#define MEMBER ((int)(get_local_id(2) * GROUP + get_local_id(0)))
// Groups of the same frequency, and of the two that share their entries, follow each other.
#define PLACE                                                                                                          \
    const int blocks = get_num_groups(2), across = get_num_groups(0);                                                  \
    const int number = get_group_id(0) + across * (get_group_id(1) + get_num_groups(1) * get_group_id(2));             \
    const int here = number / blocks % across, turn = number / (blocks * across);                                      \
    const int k = turn % 2 ? n_k - (turn + 1) / 2 : turn / 2, beside = get_local_id(2), strip = get_local_id(0) / 32;  \
    const int last = (n_z - 1) / LANES, slab = number % blocks * SLABS + beside;                                      \
    const int row = get_local_id(0) / THREADS, lane = get_local_id(0) % THREADS;

#ifdef COMPILE_light_rings
GROUP_KERNEL light_rings(ARRAY folded, __global const float *restrict entries, __global const int *restrict tiles,
                         int mirrored, int tf32, __global float *restrict spectrum, int n_k, int n_pair, int n_z,
                         int n_entry, int n_tile, int n_cell) {
    PLACE
    ENTRIES
    __local float4 light[ROUNDS][SLABS][DEEP * LIGHT_STEP], matrix[ROUNDS][DEEP * CELL_STEP];
    __local int counts[CELLS / ROWS];
    // An item brings four lanes of a sum of columns, of a difference, and four entries of a tile.
    const int tile = here * (CELLS / ROWS) + MEMBER / 32, part = MEMBER % 32, middle = mirrored ? n_pair / 2 : 0;
    __global const int *own = TILE_OF(min(tile, n_tile - 1));
    const int count = tile < n_tile ? PAIRS_OF(own) : 0;
    if (part == 0) counts[MEMBER / 32] = count;
    barrier(CLK_LOCAL_MEM_FENCE);
    int most = 0;
    for (int t = 0; t < CELLS / ROWS; t++) most = max(most, counts[t]);
    const int rounds = most / ROWS;
    __global const float4 *sum =
        (__global const float4 *)folded + (((size_t)min(slab, last) * n_k + k) * n_pair + row) * THREADS + lane;
    __global const float4 *entry = (__global const float4 *)(frequency + own[0]) + part;
    __local float4 *light_to = light[0][beside] + row * LIGHT_STEP + lane;
    __local float4 *entry_to = matrix[0] + (part / 4 + part / 2 % 2 * ROWS) * CELL_STEP + MEMBER / 32 * 2 + part % 2;
#define BRING(round)                                                                                                   \
    {                                                                                                                  \
        const int side = (round) % ROUNDS;                                                                             \
        bring(light_to + side * SLABS * DEEP * LIGHT_STEP, sum + (round) * ROWS * THREADS, 1);                         \
        bring(light_to + (side * SLABS * DEEP + ROWS) * LIGHT_STEP, sum + ((round) * ROWS + middle) * THREADS, 1);     \
        bring(entry_to + side * DEEP * CELL_STEP, entry + (round) * 32, (round) * ROWS < count);                       \
    }
    UNROLL for (int round = 0; round < ROUNDS - 1; round++) {
        if (round < rounds) BRING(round)
        CLOSE_ROUND;
    }
    // Differences are multiplied by ±i.
    const int odd = WARP_ITEM / 4 % 2, swapped = odd ? -1 : 1;
    const uint negated = odd == back ? 0x80000000u : 0u;
    float4 sums[TALL][WIDE];
    UNROLL for (int m = 0; m < TALL; m++) UNROLL for (int n = 0; n < WIDE; n++) sums[m][n] = (float4)(0.0f);
    for (int round = 0; round < rounds; round++) {
        WAIT_FOR_ALL_BUT(ROUNDS - 2);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (round + ROUNDS - 1 < rounds) BRING(round + ROUNDS - 1)
        CLOSE_ROUND;
        const int side = round % ROUNDS;
        __local const float *matrix_of = (__local const float *)matrix[side] + strip * 16 * TALL;
        __local const float *light_of = (__local const float *)light[side][beside];
        if (tf32)
            add_products(sums, matrix_of, 1, 4 * CELL_STEP, light_of, 4 * LIGHT_STEP, swapped, negated, 1);
        else
            add_products(sums, matrix_of, 1, 4 * CELL_STEP, light_of, 4 * LIGHT_STEP, swapped, negated, 0);
    }
    if (slab > last) return;
    UNROLL for (int m = 0; m < TALL; m++) {
        const int cell = here * CELLS + strip * 16 * TALL + ROW_OF(m);
        __global float *to = spectrum + (((size_t)slab * n_k + k) * n_cell + cell) * LANES;
        UNROLL for (int n = 0; n < WIDE; n++) {
            if (cell < n_cell) *(__global float2 *)(to + SLICE_OF(n)) = sums[m][n].lo;
            if (cell + 8 < n_cell) *(__global float2 *)(to + 8 * LANES + SLICE_OF(n)) = sums[m][n].hi;
        }
    }
}
#endif

#ifdef COMPILE_gather_rings
GROUP_KERNEL gather_rings(ARRAY spectrum, __global const float *restrict entries, __global const int *restrict tiles,
                          int mirrored, int tf32, __global float *restrict folded, int n_k, int n_cell, int n_z,
                          int n_entry, int n_tile, int n_pair) {
    PLACE
    ENTRIES
    const int middle = mirrored ? n_pair / 2 : 0, end = mirrored ? middle : n_pair, begin = here * PAIRS;
    if (begin >= end) return;
    __local float4 light[ROUNDS][SLABS][DEEP * LIGHT_STEP], matrix[ROUNDS][2 * PAIRS * PAIR_STEP];
    // An item brings four lanes of a cell of each of two tiles, and four entries of one. Rows are real parts of 16 pairs,
    // then their imaginary parts.
    const int which = MEMBER / (4 * PAIRS), part = MEMBER % (4 * PAIRS), pair = part / 4;
    __global const float4 *ring =
        (__global const float4 *)spectrum + (((size_t)min(slab, last) * n_k + k) * n_cell + row) * THREADS + lane;
    __global const float4 *entry = (__global const float4 *)(frequency + 2 * ROWS * begin) + part;
    __local float4 *light_to = light[0][beside] + row * LIGHT_STEP + lane;
    __local float4 *entry_to =
        matrix[0] + (pair / 16 * 32 + part / 2 % 2 * 16 + pair % 16) * PAIR_STEP + which * 2 + part % 2;
    int tile[2], pairs[2], start = 0, found = 0, next = 0;
// The next two tiles that pairs from `begin` on light.
#define FIND                                                                                                           \
    UNROLL for (int t = 0; t < 2; t++) {                                                                               \
        pairs[t] = 0;                                                                                                  \
        while (next < n_tile && (pairs[t] = PAIRS_OF(TILE_OF(next))) <= begin) next++;                                 \
        if (next == n_tile) pairs[t] = 0;                                                                              \
        tile[t] = min(next, n_tile - 1);                                                                               \
        if (t == which) start = TILE_OF(tile[t])[0] / 4;                                                               \
        next = min(next + 1, n_tile);                                                                                  \
    }
#define BRING(round)                                                                                                   \
    if (pairs[0]) {                                                                                                    \
        const int side = (round) % ROUNDS;                                                                             \
        bring(light_to + side * SLABS * DEEP * LIGHT_STEP, ring + tile[0] * ROWS * THREADS, 1);                        \
        bring(light_to + (side * SLABS * DEEP + ROWS) * LIGHT_STEP, ring + tile[1] * ROWS * THREADS, 1);               \
        bring(entry_to + side * 2 * PAIRS * PAIR_STEP, entry + start, begin + pair < (which ? pairs[1] : pairs[0]));   \
        found++;                                                                                                       \
    }
    UNROLL for (int round = 0; round < ROUNDS - 1; round++) {
        FIND
        BRING(round)
        CLOSE_ROUND;
    }
    float4 sums[TALL][WIDE];
    UNROLL for (int m = 0; m < TALL; m++) UNROLL for (int n = 0; n < WIDE; n++) sums[m][n] = (float4)(0.0f);
    for (int round = 0; round < found; round++) {
        FIND
        WAIT_FOR_ALL_BUT(ROUNDS - 2);
        barrier(CLK_LOCAL_MEM_FENCE);
        BRING(round + ROUNDS - 1)
        CLOSE_ROUND;
        const int side = round % ROUNDS;
        __local const float *matrix_of = (__local const float *)(matrix[side] + strip * 16 * TALL * PAIR_STEP);
        __local const float *light_of = (__local const float *)light[side][beside];
        if (tf32)
            add_products(sums, matrix_of, 4 * PAIR_STEP, 1, light_of, 4 * LIGHT_STEP, 0, 0u, 1);
        else
            add_products(sums, matrix_of, 4 * PAIR_STEP, 1, light_of, 4 * LIGHT_STEP, 0, 0u, 0);
    }
    if (slab > last) return;
    const float sign = back ? 1.0f : -1.0f;
    __global float *to = folded + ((size_t)slab * n_k + k) * n_pair * LANES;
    UNROLL for (int n = 0; n < WIDE; n++) UNROLL for (int below = 0; below < 2; below++) {
        const int at = begin + strip * 16 + ROW_OF(0) + 8 * below;
        const float2 sum = below ? sums[0][n].hi : sums[0][n].lo, other = below ? sums[1][n].hi : sums[1][n].lo;
        const float2 difference = sign * (float2)(-other.y, other.x);
        if (at < end) *(__global float2 *)(to + at * LANES + SLICE_OF(n)) = middle ? sum : sum + difference;
        if (at < end && middle) *(__global float2 *)(to + (middle + at) * LANES + SLICE_OF(n)) = difference;
    }
}
#endif
