#include "partial.h"
#ifdef LANES

#define ROWS 8

// i times each pair of lanes.
static inline Vector turned(Vector x) {
    Vector out;
    out.even = -x.odd;
    out.odd = x.even;
    return out;
}

#endif

#ifdef COMPILE_fourier
#include "fourier.h"

// An item computes OUTPUTS samples of a transform, which use the same inputs. For a radix above ONE_SUM, a processor's
// item computes all or none, if there is space for it. On GPUs an item computes all samples of a radix up to FACTOR; if
// the radix is FIRST · SECOND · THIRD · LAST, the items of a group exchange their results through local memory.
FIELD_KERNEL fourier(ARRAY source, __global const int *restrict bands, __global const float2 *restrict waves, float sign,
                     int first, int second, int third, int last, __global float *restrict sink, int n_a, int n_b,
                     int n_z, int n_band, int n_wave, int n_i, int n_j) {
    ARRAY from = source + slab_offset(n_a, n_b);
    __global float *to = sink + slab_offset(n_i, n_j);
#ifdef GPU
    const int groups = get_num_groups(0) * get_num_groups(1), items = get_local_size(0), item = get_local_id(0);
    __global const Vector *whole = (__global const Vector *)(from - ITEM_LANE);
    __global Vector *sunk = (__global Vector *)(to - ITEM_LANE);
#ifdef FIRST
    __local Vector held[RADIX * WIDE];
#endif
    for (int number = get_group_id(1) * get_num_groups(0) + get_group_id(0);; number += groups) {
        __global const int *band = bands;
        for (int next = 1; next < n_band && number >= bands[next * BAND + 15]; next++) band = bands + next * BAND;
        const int n = band[1], rings = band[2], radix = band[3], done = band[4], turns = n / (done * radix);
        const int at_once = band[14] ? band[14] : rings, batches = (rings + at_once - 1) / at_once, unit = (number - band[15]) / batches;
        if (unit >= n / radix) return;
        const int inner = unit % done, start = unit / done, ring = (number - band[15]) % batches * at_once;
        __global const float2 *wave = waves + band[5];
        const int2 read = row_of(band + 6, start * done + inner, turns * done);
        const int2 write = row_of(band + 10, start * done * radix + inner, done);
#ifdef FIRST
        for (int lanes = 0; lanes < THREADS; lanes += WIDE) {
            const int lane = ring * THREADS + min(lanes + item % WIDE, THREADS - 1);
            by_group(whole + read.x + lane, read.y, sunk + write.x + lane, write.y, held + item % WIDE, wave, n / RADIX,
                     inner * turns, sign);
        }
#else
        if (band[14] == 0) {
            const int blocks = (radix + OUTPUTS - 1) / OUTPUTS;
            for (int task = item / THREADS; task < blocks * rings; task += items / THREADS)
                direct_sums(from, to, band, wave, sign, unit * blocks * rings + task, blocks);
            continue;
        }
        for (int task = item; task < min(at_once, rings - ring) * THREADS; task += items) {
            __global const Vector *given = whole + read.x + ring * THREADS + task;
            __global Vector *found = sunk + write.x + ring * THREADS + task;
            switch (radix) { FEW(1) FEW(2) FEW(3) FEW(4) FEW(5) FEW(6) FEW(7) FEW(8) FEW(9) FEW(10) }
        }
#endif
    }
#else
    if (ITEM_MAJOR >= n_i || ITEM_Z >= n_z) return;
    const int items = (n_j + 1) / 2, row = ITEM_MAJOR * items, begin = TILE_MINOR ? ITEM_MINOR : 0;
    for (int item = row + begin, end = row + (TILE_MINOR ? min(begin + 1, items) : items); item < end; item++) {
        __global const int *band = bands;
        int own = item, blocks = 0, b = 0;
        for (; b < n_band; b++, band += BAND) {
            blocks = (band[3] + OUTPUTS - 1) / OUTPUTS;
            const int count = band[1] / band[3] * blocks * band[2];
            if (own < count) break;
            own -= count;
        }
        if (b == n_band) return;
        const int n = band[1], rings = band[2], radix = band[3], done = band[4], turns = n / (done * radix);
        __global const float2 *wave = waves + band[5];
        if (radix <= ONE_SUM || radix > AT_ONCE) {
            direct_sums(from, to, band, wave, sign, own, blocks);
            continue;
        }
        if (own % blocks) continue;
        const int which = own / blocks, ring = which % rings, inner = which / rings % done, start = which / rings / done;
        int read[AT_ONCE], write[AT_ONCE];
        places_of(read, radix, start * done + inner, turns * done, band + 6, ring);
        places_of(write, radix, start * done * radix + inner, done, band + 10, ring);
        Vector near[AT_ONCE], far[AT_ONCE];
        EACH_VECTOR {
            if (inner)
                for (int r = 0; r < radix; r++) {
                    near[r] = LOAD(from + SAMPLE(0, read[r], 0));
                    TURN(near[r], wave[(long)r * inner * turns % n].x, wave[(long)r * inner * turns % n].y);
                }
            passes(from, read, near, far, to, write, v, !inner, radix, wave, n / radix, sign);
        }
    }
#endif
}
#endif

// The tile whose entries an item uses, and where those of its frequency begin.
#define ENTRIES                                                                                                        \
    const int back = 2 * k > n_k, kept = back ? n_k - k : k;                                                           \
    __global const float *frequency = entries + (size_t)kept * (n_entry / (n_k / 2 + 1));
#define KEPT_TILE(tile) (back ? tiles[2 * (tile) + 1] : (tile))
#define FIRST_OF(tile) tiles[2 * KEPT_TILE(tile)]
// Columns of a pair: right and left of the middle if they mirror each other, else one. Number of pairs.
#define RIGHT(pair) ((mirrored ? n_r / 2 : 0) + (pair))
#define LEFT(pair) (n_r - 1 - RIGHT(pair))
#define ALL_PAIRS (n_r - RIGHT(0))
// Number of pairs of columns that light it at this frequency.
#define PAIRS_OF(tile) lit[kept * n_tile + KEPT_TILE(tile)]
#ifdef MATRIX_UNITS
#include "ring_units.h"
#else
#define EACH_ROW(row) UNROLL for (int row = 0; row < ROWS; row++)

// Adds `ROWS` successive entries, which are two loads, times a vector.
#define ADD_EIGHT(sums, entry, value)                                                                                  \
    {                                                                                                                  \
        const float4 low = (entry)[0], high = (entry)[1];                                                              \
        (sums)[0] += low.x * (value); (sums)[1] += low.y * (value); (sums)[2] += low.z * (value);                      \
        (sums)[3] += low.w * (value); (sums)[4] += high.x * (value); (sums)[5] += high.y * (value);                    \
        (sums)[6] += high.z * (value); (sums)[7] += high.w * (value);                                                  \
    }

#ifdef GPU
// A group computes the contributions of its ITEMS items along minor, of TILE_MINOR cells or pairs each, for the lanes
// of its slabs. Items of a warp are lanes of the same cells; an entry is then one read for all of them. Data of the
// next step are fetched into registers while this one is computed, and then stored where all items read them.
#define ITEMS (GROUP / THREADS > 0 ? GROUP / THREADS : 1)
#define EACH (TILE_MINOR / ROWS)
#define MEMBER ((int)(get_local_id(2) * get_local_size(0) + get_local_id(0)))
#define MEMBERS ((int)(get_local_size(2) * get_local_size(0)))
#define SPREAD ((int)get_local_size(2) * THREADS)
#define GROUP_ITEM ((int)get_group_id(0) * ITEMS)
// Two buffers, one written while the other is read; one if a group has too many items for two.
#define SIDES (THREADS > 1 ? 2 : 1)
#define OTHER(side) (SIDES - 1 - (side))
#define WAIT_FOR_READERS if (SIDES == 1) barrier(CLK_LOCAL_MEM_FENCE);
#define PLACE \
    const int spread = SPREAD, item = MEMBER / spread, near = MEMBER % spread, last = (n_z - 1) / LANES;               \
    const int beside = get_local_size(2), slab = get_group_id(2) * beside * TILE_SLABS + near / THREADS;               \
    const int lane = near % THREADS;
// Slabs of an item, TILE_SLABS of them, and where they begin in fields of `samples` samples.
#define SLAB(u) (slab + (u) * beside)
#define SLAB_AT(u, samples) ((size_t)min(SLAB(u), last) * (samples) * THREADS)
#define EACH_SLAB(u) UNROLL for (int u = 0; u < TILE_SLABS; u++)
#define HELD_SLABS (SLABS * TILE_SLABS * THREADS)
#define MIN_ONE(count) ((count) > 0 ? (count) : 1)
// Values that an item fetches: of ROWS of all lanes and slabs, and of entries. It takes every ITEMS-th row.
#define PART_OF_ROWS(rows) MIN_ONE((rows) / ITEMS)
#define PART(total) MIN_ONE((total) / (ITEMS * THREADS * SLABS))
// Fetch `part` of `count` values, from a first on and `step` apart, given by VALUE(m); the rest when they are stored.
#define FETCH(held, part, first, step, count, VALUE)                                                                   \
    UNROLL for (int i = 0; i < part; i++)                                                                              \
        if ((first) + i * (step) < (count)) held[i] = VALUE((first) + i * (step));
#define LAY(held, part, first, step, count, VALUE, to, PLACE_OF)                                                       \
    {                                                                                                                  \
        UNROLL for (int i = 0; i < part; i++)                                                                          \
            if ((first) + i * (step) < (count)) (to)[PLACE_OF((first) + i * (step))] = held[i];                        \
        for (int m = (first) + part * (step); m < (count); m += (step)) (to)[PLACE_OF(m)] = VALUE(m);                  \
    }
#define OF_ROW(row) ((row) * spread + near)
#define ITSELF(m) (m)
#endif

#ifdef COMPILE_light_rings
FIELD_KERNEL light_rings(ARRAY light, __global const float *restrict entries, float greatest,
                         __global const int *restrict tiles, __global const int *restrict lit,
                         __global const int *restrict order, int mirrored, int tf32,
                         __global float *restrict spectrum, int n_k, int n_r, int n_z, int n_entry, int n_tile,
                         int n_frequency, int n_cell) {
#ifdef GPU
    const int k = ITEM_MAJOR;
    ENTRIES
    PLACE
    __local float4 seen[SIDES][2 * CHUNK * HELD_SLABS], shares[SIDES][ITEMS * EACH * CHUNK * 4];
    __local int starts[ITEMS * EACH], counts[ITEMS * EACH];
    for (int m = MEMBER; m < ITEMS * EACH; m += MEMBERS) {
        const int tile = GROUP_ITEM * EACH + m;
        starts[m] = FIRST_OF(min(tile, n_tile - 1));
        counts[m] = tile < n_tile ? PAIRS_OF(tile) : 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const float both = mirrored ? 1.0f : 0.0f;
    int most = 0, mine = 0;
    for (int t = 0; t < ITEMS * EACH; t++) most = max(most, counts[t]);
    for (int t = 0; t < EACH; t++) mine = max(mine, counts[item * EACH + t]);
    __global const float4 *from = (__global const float4 *)light + (size_t)k * n_r * THREADS + lane;
    Vector real[EACH][TILE_SLABS][ROWS], imaginary[EACH][TILE_SLABS][ROWS];
    UNROLL for (int t = 0; t < EACH; t++) EACH_SLAB(u) EACH_ROW(row) real[t][u][row] = imaginary[t][u][row] = ZERO;
#define LIT (2 * CHUNK * TILE_SLABS)
#define SHARED (ITEMS * EACH * CHUNK * 4)
    float4 next_light[PART_OF_ROWS(LIT)], next_shares[PART(SHARED)];
    // m counts slabs of an item, pairs, then right and left; for entries, pairs, then tiles. Pairs beyond the last have
    // entries that are zero, and any light.
#define LIGHT_AT(m)                                                                                                    \
    from[SLAB_AT((m) % TILE_SLABS, n_k * n_r)                                                                          \
         + (mirrored && (m) / TILE_SLABS >= CHUNK ? LEFT(PAIR_AT(m)) : RIGHT(PAIR_AT(m))) * THREADS]
#define PAIR_AT(m) min(begin + (m) / TILE_SLABS % CHUNK, ALL_PAIRS - 1)
#define SHARES_AT(m)                                                                                                   \
    (begin < counts[(m) / (CHUNK * 4)]                                                                                 \
         ? ((__global const float4 *)(frequency + starts[(m) / (CHUNK * 4)] + 2 * ROWS * begin))[(m) % (CHUNK * 4)]   \
         : (float4)(0.0f))
    for (int begin = -CHUNK, side = SIDES - 1; begin < most; side = OTHER(side)) {
        const int done = begin;
        begin += CHUNK;
        if (begin < most) {
            FETCH(next_light, PART_OF_ROWS(LIT), item, ITEMS, LIT, LIGHT_AT)
            FETCH(next_shares, PART(SHARED), MEMBER, MEMBERS, SHARED, SHARES_AT)
        }
        if (done >= 0 && done < mine)
            UNROLL for (int p = 0; p < CHUNK; p++) {
                UNROLL for (int t = 0; t < EACH; t++) {
                    __local const float4 *share = shares[side] + ((item * EACH + t) * CHUNK + p) * 4;
                    EACH_SLAB(u) {
                        const float4 right = seen[side][(p * TILE_SLABS + u) * spread + near];
                        const float4 left = both * seen[side][((CHUNK + p) * TILE_SLABS + u) * spread + near];
                        ADD_EIGHT(real[t][u], share, right + left)
                        ADD_EIGHT(imaginary[t][u], share + 2, right - left)
                    }
                }
            }
        WAIT_FOR_READERS
        if (begin < most) {
            LAY(next_light, PART_OF_ROWS(LIT), item, ITEMS, LIT, LIGHT_AT, seen[OTHER(side)], OF_ROW)
            LAY(next_shares, PART(SHARED), MEMBER, MEMBERS, SHARED, SHARES_AT, shares[OTHER(side)], ITSELF)
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    UNROLL for (int t = 0; t < EACH; t++) EACH_SLAB(u) {
        const int tile = (GROUP_ITEM + item) * EACH + t;
        if (tile >= n_tile || SLAB(u) > last) break;
        __global float4 *to = (__global float4 *)spectrum + ((size_t)SLAB(u) * n_k + k) * n_cell * THREADS + lane;
        EACH_ROW(row) to[(tile * ROWS + row) * THREADS] =
            real[t][u][row] + (back ? -1.0f : 1.0f) * turned(imaginary[t][u][row]);
    }
#else
    const int k = ITEM_MAJOR, tile = ITEM_MINOR;
    if (k >= n_k || tile >= n_tile || ITEM_Z >= n_z) return;
    ENTRIES
    ARRAY from = light + slab_offset(n_k, n_r) + SAMPLE(k, 0, n_r);
    __global float *to = spectrum + slab_offset(n_k, n_cell) + SAMPLE(k, tile * ROWS, n_cell);
    EACH_VECTOR {
        Vector real[ROWS], imaginary[ROWS];
        EACH_ROW(row) real[row] = imaginary[row] = ZERO;
        __global const float *entry = frequency + FIRST_OF(tile);
        for (int pair = 0, pairs = min(PAIRS_OF(tile), ALL_PAIRS); pair < pairs; pair++, entry += 2 * ROWS) {
            const Vector right = LOAD(from + SAMPLE(0, RIGHT(pair), 0));
            const Vector left = mirrored ? LOAD(from + SAMPLE(0, LEFT(pair), 0)) : ZERO;
            ADD_EIGHT(real, (__global const float4 *)entry, right + left)
            ADD_EIGHT(imaginary, (__global const float4 *)entry + 2, right - left)
        }
        EACH_ROW(row) STORE(to + SAMPLE(0, row, 0), real[row] + (back ? -1.0f : 1.0f) * turned(imaginary[row]));
    }
#endif
}
#endif

#ifdef COMPILE_gather_rings
// Adds Σ of four successive entries times a vector each.
#define DOT_FOUR(sum, entry, values)                                                                                   \
    {                                                                                                                  \
        const float4 four = entry;                                                                                     \
        sum += four.x * (values)[0]; sum += four.y * (values)[1];                                                      \
        sum += four.z * (values)[2]; sum += four.w * (values)[3];                                                      \
    }

#ifdef GPU
// The first tile from one on that a pair of columns lights.
static inline int next_lit(int tile, int n_tile, int pair, __global const int *tiles, __global const int *lit, int back,
                           int kept) {
    while (tile < n_tile && PAIRS_OF(tile) <= pair) tile++;
    return tile;
}
#endif

FIELD_KERNEL gather_rings(ARRAY spectrum, __global const float *restrict entries, float greatest,
                          __global const int *restrict tiles, __global const int *restrict lit,
                          __global const int *restrict order, int mirrored, int tf32,
                          __global float *restrict light, int n_k, int n_cell, int n_z, int n_entry, int n_tile,
                          int n_frequency, int n_r) {
    const int end = ALL_PAIRS;
#ifdef GPU
    const int k = ITEM_MAJOR, begin = GROUP_ITEM * TILE_MINOR;
    ENTRIES
    PLACE
    const int first = begin + item * TILE_MINOR;
    if (begin >= end) return;
    __local float4 seen[SIDES][ROWS * HELD_SLABS], shares[SIDES][ITEMS * TILE_MINOR * 4];
    __global const float4 *from = (__global const float4 *)spectrum + (size_t)k * n_cell * THREADS + lane;
    Vector real[TILE_SLABS][TILE_MINOR], imaginary[TILE_SLABS][TILE_MINOR];
    EACH_SLAB(u) UNROLL for (int pair = 0; pair < TILE_MINOR; pair++) real[u][pair] = imaginary[u][pair] = ZERO;
#define LIT (ROWS * TILE_SLABS)
#define SHARED (ITEMS * TILE_MINOR * 4)
    float4 next_light[PART_OF_ROWS(LIT)], next_shares[PART(SHARED)];
    // m counts slabs of an item, then cells; for entries, pairs.
#define LIGHT_OF(m) from[SLAB_AT((m) % TILE_SLABS, n_k * n_cell) + (tile * ROWS + (m) / TILE_SLABS) * THREADS]
#define SHARES_OF(m)                                                                                                   \
    (begin + (m) / 4 < pairs ? ((__global const float4 *)(frequency + FIRST_OF(own) + 2 * ROWS * begin))[m] : (float4)(0.0f))
    int tile = -1, pairs = 0;
    for (int side = SIDES - 1; tile < n_tile; side = OTHER(side)) {
        const int laid = pairs;
        tile = next_lit(tile + 1, n_tile, begin, tiles, lit, back, kept);
        const int own = min(tile, n_tile - 1);
        pairs = PAIRS_OF(own);
        if (tile < n_tile) {
            FETCH(next_light, PART_OF_ROWS(LIT), item, ITEMS, LIT, LIGHT_OF)
            FETCH(next_shares, PART(SHARED), MEMBER, MEMBERS, SHARED, SHARES_OF)
        }
        if (laid > first)
            for (int upper = 0; upper < 2; upper++) {
                Vector ring[TILE_SLABS][4];
                EACH_SLAB(u) UNROLL for (int row = 0; row < 4; row++)
                    ring[u][row] = seen[side][((4 * upper + row) * TILE_SLABS + u) * spread + near];
                __local const float4 *share = shares[side] + item * TILE_MINOR * 4 + upper;
                UNROLL for (int pair = 0; pair < TILE_MINOR; pair++) EACH_SLAB(u) {
                    DOT_FOUR(real[u][pair], share[4 * pair], ring[u])
                    DOT_FOUR(imaginary[u][pair], share[4 * pair + 2], ring[u])
                }
            }
        WAIT_FOR_READERS
        if (tile < n_tile) {
            LAY(next_light, PART_OF_ROWS(LIT), item, ITEMS, LIT, LIGHT_OF, seen[OTHER(side)], OF_ROW)
            LAY(next_shares, PART(SHARED), MEMBER, MEMBERS, SHARED, SHARES_OF, shares[OTHER(side)], ITSELF)
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    EACH_SLAB(u) UNROLL for (int pair = 0; pair < TILE_MINOR; pair++) {
        if (first + pair >= end || SLAB(u) > last) break;
        __global float4 *to = (__global float4 *)light + ((size_t)SLAB(u) * n_k + k) * n_r * THREADS + lane;
        const int right = RIGHT(first + pair), left = mirrored ? LEFT(first + pair) : right;
        const Vector difference = (back ? 1.0f : -1.0f) * turned(imaginary[u][pair]);
        to[left * THREADS] = real[u][pair] - difference;
        to[right * THREADS] = real[u][pair] + (mirrored && right == left ? real[u][pair] : difference);
    }
#else
    const int k = ITEM_MAJOR, first = ITEM_MINOR * ROWS;
    if (k >= n_k || first >= end || ITEM_Z >= n_z) return;
    ENTRIES
    ARRAY from = spectrum + slab_offset(n_k, n_cell) + SAMPLE(k, 0, n_cell);
    __global float *to = light + slab_offset(n_k, n_r) + SAMPLE(k, 0, n_r);
    EACH_VECTOR {
        Vector real[ROWS], imaginary[ROWS];
        EACH_ROW(pair) real[pair] = imaginary[pair] = ZERO;
        for (int tile = 0; tile < n_tile; tile++) {
            if (PAIRS_OF(tile) <= first) continue;
            __global const float4 *entry = (__global const float4 *)(frequency + FIRST_OF(tile) + 2 * ROWS * first);
            Vector ring[ROWS];
            EACH_ROW(row) ring[row] = LOAD(from + SAMPLE(0, tile * ROWS + row, 0));
            EACH_ROW(pair) {
                DOT_FOUR(real[pair], entry[4 * pair], ring)
                DOT_FOUR(real[pair], entry[4 * pair + 1], ring + 4)
                DOT_FOUR(imaginary[pair], entry[4 * pair + 2], ring)
                DOT_FOUR(imaginary[pair], entry[4 * pair + 3], ring + 4)
            }
        }
        for (int pair = 0; pair < min(ROWS, end - first); pair++) {
            const int right = RIGHT(first + pair), left = mirrored ? LEFT(first + pair) : right;
            const Vector difference = (back ? 1.0f : -1.0f) * turned(imaginary[pair]);
            STORE(to + SAMPLE(0, left, 0), real[pair] - difference);
            STORE(to + SAMPLE(0, right, 0), real[pair] + (mirrored && right == left ? real[pair] : difference));
        }
    }
#endif
}
#endif
#endif
