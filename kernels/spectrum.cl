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
#define BELT 16
#define TURN(value, c, s) (value) = (c) * (value) + sign * (s) * turned(value)
#define SWAP(a, b) { const Vector held = a; a = b; b = held; }

// Transforms of values that are `step` apart, in place.
static inline void of_two(Vector *g, int step) {
    const Vector a = g[0];
    g[0] = a + g[step];
    g[step] = a - g[step];
}

static inline void of_three(Vector *g, int step, float sign) {
    const Vector a = g[step] + g[2 * step], b = sign * 0.86602540f * turned(g[step] - g[2 * step]), c = g[0] - 0.5f * a;
    g[0] += a;
    g[step] = c + b;
    g[2 * step] = c - b;
}

static inline void of_four(Vector *g, int step, float sign) {
    const Vector a = g[0] + g[2 * step], b = g[0] - g[2 * step], c = g[step] + g[3 * step];
    const Vector d = sign * turned(g[step] - g[3 * step]);
    g[0] = a + c;
    g[step] = b + d;
    g[2 * step] = a - c;
    g[3 * step] = b - d;
}

static inline void of_five(Vector *g, int step, float sign) {
    const Vector a = g[step] + g[4 * step], b = g[step] - g[4 * step], c = g[2 * step] + g[3 * step];
    const Vector d = g[2 * step] - g[3 * step];
    const Vector low = g[0] + 0.30901699f * a - 0.80901699f * c, high = g[0] - 0.80901699f * a + 0.30901699f * c;
    const Vector slow = sign * turned(0.95105652f * b + 0.58778525f * d);
    const Vector fast = sign * turned(0.58778525f * b - 0.95105652f * d);
    g[0] += a + c;
    g[step] = low + slow;
    g[4 * step] = low - slow;
    g[2 * step] = high + fast;
    g[3 * step] = high - fast;
}

static inline void of_seven(Vector *g, float sign) {
    const Vector a = g[1] + g[6], b = g[2] + g[5], c = g[3] + g[4];
    const Vector d = sign * turned(g[1] - g[6]), e = sign * turned(g[2] - g[5]), f = sign * turned(g[3] - g[4]);
    const Vector one = g[0] + 0.62348980f * a - 0.22252093f * b - 0.90096887f * c;
    const Vector two = g[0] - 0.22252093f * a - 0.90096887f * b + 0.62348980f * c;
    const Vector three = g[0] - 0.90096887f * a + 0.62348980f * b - 0.22252093f * c;
    const Vector first = 0.78183148f * d + 0.97492791f * e + 0.43388374f * f;
    const Vector second = 0.97492791f * d - 0.43388374f * e - 0.78183148f * f;
    const Vector third = 0.43388374f * d - 0.78183148f * e + 0.97492791f * f;
    g[0] += a + b + c;
    g[1] = one + first;
    g[6] = one - first;
    g[2] = two + second;
    g[5] = two - second;
    g[3] = three + third;
    g[4] = three - third;
}

// The transform of up to FACTOR values in registers, in order.
static inline void of_few(Vector *g, int count, float sign) {
    switch (count) {
        case 2: of_two(g, 1); break;
        case 3: of_three(g, 1, sign); break;
        case 4: of_four(g, 1, sign); break;
        case 5: of_five(g, 1, sign); break;
        case 6: {
            of_three(g, 2, sign); of_three(g + 1, 2, sign);
            TURN(g[3], 0.5f, 0.86602540f); TURN(g[5], -0.5f, 0.86602540f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4];
            g[1] = c; g[2] = e; g[3] = b; g[4] = d;
            break;
        }
        case 7: of_seven(g, sign); break;
        case 8: {
            of_four(g, 2, sign); of_four(g + 1, 2, sign);
            TURN(g[3], 0.70710678f, 0.70710678f); g[5] = sign * turned(g[5]); TURN(g[7], -0.70710678f, 0.70710678f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1); of_two(g + 6, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4], f = g[5], h = g[6];
            g[1] = c; g[2] = e; g[3] = h; g[4] = b; g[5] = d; g[6] = f;
            break;
        }
        case 9: {
            of_three(g, 3, sign); of_three(g + 1, 3, sign); of_three(g + 2, 3, sign);
            TURN(g[4], 0.76604444f, 0.64278761f); TURN(g[5], 0.17364818f, 0.98480775f);
            TURN(g[7], 0.17364818f, 0.98480775f); TURN(g[8], -0.93969262f, 0.34202014f);
            of_three(g, 1, sign); of_three(g + 3, 1, sign); of_three(g + 6, 1, sign);
            SWAP(g[1], g[3]) SWAP(g[2], g[6]) SWAP(g[5], g[7])
            break;
        }
        case 10: {
            of_five(g, 2, sign); of_five(g + 1, 2, sign);
            TURN(g[3], 0.80901699f, 0.58778525f); TURN(g[5], 0.30901699f, 0.95105652f);
            TURN(g[7], -0.30901699f, 0.95105652f); TURN(g[9], -0.80901699f, 0.58778525f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1); of_two(g + 6, 1); of_two(g + 8, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4], f = g[5], h = g[6], i = g[7], j = g[8];
            g[1] = c; g[2] = e; g[3] = h; g[4] = j; g[5] = b; g[6] = d; g[7] = f; g[8] = i;
            break;
        }
    }
}

#ifdef AT_ONCE
// The radix of the next pass of a transform: the greatest factor that is small enough, else the least of all.
static inline int radix_of(int n) {
    int radix = FACTOR;
    while (n % radix) radix--;
    for (int more = FACTOR + 1; radix == 1; more++) radix = n % more ? 1 : more;
    return radix;
}

// Where samples lie, `step` apart from a first one on.
static inline void places_of(int *places, int count, int sample, int step, __global const int *place, int ring) {
    int within = sample % place[1], beyond = sample / place[1];
    for (int r = 0; r < count; r++) {
        places[r] = place[0] + within * place[2] + beyond * place[3] + ring;
        for (within += step; within >= place[1]; beyond++) within -= place[1];
    }
}

#define GET(at) (first ? LOAD(from + SAMPLE(0, read[at], 0)) : near[at])
#define PUT(at, value)                                                                                                 \
    if (last) STORE(to + SAMPLE(0, write[at], 0), value);                                                              \
    else far[at] = value;
// A pass of one radix: what it takes is `apart` from the next, what it makes `done`.
#define PASS(radix)                                                                                                    \
    case radix:                                                                                                        \
        for (int inner = 0; inner < done; inner++) {                                                                   \
            float2 turn[radix];                                                                                        \
            UNROLL for (int r = 1; r < radix; r++) turn[r] = wave[r * inner * turns * wide];                           \
            for (int start = 0; start < turns; start++) {                                                              \
                Vector g[radix];                                                                                       \
                UNROLL for (int r = 0; r < radix; r++) g[r] = GET((start + r * turns) * done + inner);                 \
                if (inner) UNROLL for (int r = 1; r < radix; r++) TURN(g[r], turn[r].x, turn[r].y);                    \
                of_few(g, radix, sign);                                                                                \
                UNROLL for (int k = 0; k < radix; k++) { PUT(start * done * radix + inner + k * done, g[k]) }          \
            }                                                                                                          \
        }                                                                                                              \
        break;

// The transform of `radix` values, pass by pass from the source, or from `near`, to the sink; `wide` waves make one.
static inline void passes(ARRAY from, const int *read, Vector *near, Vector *far, __global float *to, const int *write,
                          int v, int first, int radix, __global const float2 *wave, int wide, float sign) {
    for (int done = 1, part = 1; done < radix; done *= part, first = 0) {
        part = radix_of(radix / done);
        const int turns = radix / (done * part), last = done * part == radix;
        switch (part) {
            PASS(2) PASS(3) PASS(4) PASS(5) PASS(6) PASS(7) PASS(8) PASS(9) PASS(10)
            default:
                for (int start = 0; start < turns; start++) for (int inner = 0; inner < done; inner++)
                    for (int k = 0, step = inner * turns; k < part; k++, step += done * turns) {
                        Vector along = ZERO, across = ZERO;
                        for (int r = 0, phase = 0; r < part; r++, phase = (phase + step) % radix) {
                            const Vector given = GET((start + r * turns) * done + inner);
                            const float2 turn = wave[phase * wide];
                            along += turn.x * given;
                            across += turn.y * given;
                        }
                        PUT(start * done * part + inner + k * done, along + sign * turned(across))
                    }
        }
        Vector *next = near;
        near = far;
        far = next;
    }
}
#endif

// OUTPUTS samples of a transform by direct sums: number `own` of those of a belt.
static inline void direct_sums(ARRAY from, __global float *to, __global const int *belt, __global const float2 *wave,
                               float sign, int own, int blocks) {
    const int n = belt[1], rings = belt[2], radix = belt[3], done = belt[4], turns = n / (done * radix);
    const int ring = own % rings, block = own / rings % blocks * OUTPUTS, group = own / rings / blocks;
    const int inner = group % done, start = group / done;
    EACH_VECTOR {
        Vector along[OUTPUTS], across[OUTPUTS];
        int phase[OUTPUTS], step[OUTPUTS];
        UNROLL for (int o = 0; o < OUTPUTS; o++) {
            along[o] = across[o] = ZERO;
            phase[o] = 0;
            step[o] = (inner + min(block + o, radix - 1) * done) * turns;
        }
        int sample = start * done + inner;
        for (int r = 0; r < radix; r++, sample += turns * done) {
            const int at = belt[6] + sample % belt[7] * belt[8] + sample / belt[7] * belt[9] + ring;
            const Vector given = LOAD(from + SAMPLE(0, at, 0));
            UNROLL for (int o = 0; o < OUTPUTS; o++) {
                const float2 turn = wave[phase[o]];
                along[o] += turn.x * given;
                across[o] += turn.y * given;
                phase[o] += step[o];
                phase[o] -= phase[o] >= n ? n : 0;
            }
        }
        UNROLL for (int o = 0; o < OUTPUTS; o++) {
            if (block + o >= radix) break;
            const int out = start * done * radix + inner + (block + o) * done;
            const int at = belt[10] + out % belt[11] * belt[12] + out / belt[11] * belt[13] + ring;
            STORE(to + SAMPLE(0, at, 0), along[o] + sign * turned(across[o]));
        }
    }
}

#ifdef GPU
// Samples of a ring, `step` apart from a first one on: their place, and how far the next one is.
static inline int2 row_of(__global const int *place, int sample, int step) {
    return (int2)(place[0] + sample % place[1] * place[2] + sample / place[1] * place[3],
                  step % place[1] * place[2] + step / place[1] * place[3]) * THREADS;
}

#define TURN_BY(value, number)                                                                                         \
    {                                                                                                                  \
        const float2 turn = wave[number];                                                                              \
        TURN(value, turn.x, turn.y);                                                                                   \
    }
// Of up to FACTOR samples, which stay in registers.
#define FEW(count)                                                                                                     \
    case count: {                                                                                                      \
        Vector g[count];                                                                                               \
        UNROLL for (int i = 0; i < count; i++) g[i] = given[i * read.y];                                               \
        if (inner) UNROLL for (int i = 1; i < count; i++) TURN_BY(g[i], i * inner * turns)                             \
        of_few(g, count, sign);                                                                                        \
        UNROLL for (int i = 0; i < count; i++) found[i * write.y] = g[i];                                              \
        break;                                                                                                         \
    }

#ifdef FIRST
#define RADIX (FIRST * SECOND * THIRD * LAST)
// Lanes that are held at once, and the items of a group that share one of them.
#define FIT(lanes) (RADIX * (lanes) <= HELD)
#define WIDE (FIT(THREADS) ? THREADS : FIT(THREADS / 2) ? THREADS / 2 : FIT(THREADS / 4) ? THREADS / 4 : 1)
#define SLOTS ((int)get_local_size(0) / WIDE)
#define SLOT ((int)get_local_id(0) / WIDE)
// Of COUNT samples, BEYOND apart, that the passes before have BEFORE of: in place.
#define PASS_ON(COUNT, BEFORE, BEYOND)                                                                                 \
    if (COUNT > 1) {                                                                                                   \
        for (int task = SLOT; task < RADIX / COUNT; task += SLOTS) {                                                   \
            const int q = task % (BEYOND);                                                                             \
            __local Vector *at = own + (task / (BEYOND) * COUNT * (BEYOND) + q) * WIDE;                                \
            Vector g[COUNT];                                                                                           \
            UNROLL for (int i = 0; i < COUNT; i++) g[i] = at[i * (BEYOND) * WIDE];                                     \
            of_few(g, COUNT, sign);                                                                                    \
            UNROLL for (int i = 1; i < COUNT; i++) TURN_BY(g[i], i * q * (BEFORE) * turn_of_one)                       \
            UNROLL for (int i = 0; i < COUNT; i++) at[i * (BEYOND) * WIDE] = g[i];                                     \
        }                                                                                                              \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                                  \
    }

// The transform of RADIX samples, from `given`, `read` apart, to `found`, `write` apart, by the items of a group, which
// take FIRST at once, pass on what they made in local memory, of which `own` is an item's lane, and so on to LAST. Numbers
// of waves: turn_of_one, a RADIX-th of a turn; turn_of_inner, for each sample, what passes before left to turn it by.
static inline void by_group(__global const Vector *given, int read, __global Vector *found, int write, __local Vector *own,
                            __global const float2 *wave, int turn_of_one, int turn_of_inner, float sign) {
    const int rest = RADIX / FIRST;
    for (int q = SLOT; q < rest; q += SLOTS) {
        Vector g[FIRST];
        UNROLL for (int i = 0; i < FIRST; i++) g[i] = given[(i * rest + q) * read];
        if (turn_of_inner) UNROLL for (int i = 0; i < FIRST; i++) TURN_BY(g[i], (i * rest + q) * turn_of_inner)
        of_few(g, FIRST, sign);
        UNROLL for (int i = 1; i < FIRST; i++) TURN_BY(g[i], i * q * turn_of_one)
        UNROLL for (int i = 0; i < FIRST; i++) own[(i * rest + q) * WIDE] = g[i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    PASS_ON(SECOND, FIRST, THIRD * LAST)
    PASS_ON(THIRD, FIRST * SECOND, LAST)
    for (int task = SLOT; task < RADIX / LAST; task += SLOTS) {
        const int k = task / (SECOND * THIRD) + (task / THIRD % SECOND + task % THIRD * SECOND) * FIRST;
        Vector g[LAST];
        UNROLL for (int i = 0; i < LAST; i++) g[i] = own[(task * LAST + i) * WIDE];
        of_few(g, LAST, sign);
        UNROLL for (int i = 0; i < LAST; i++) found[(i * (RADIX / LAST) + k) * write] = g[i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}
#endif
#endif

// An item computes OUTPUTS samples of a transform, which share what they are made of. Of a radix above ONE_SUM a
// processor's item computes all or none, where there is room for it. On GPUs all samples of a radix of up to FACTOR are
// an item's; where it is FIRST · SECOND · THIRD · LAST, the items of a group pass on what they made through local memory.
FIELD_KERNEL fourier(ARRAY source, __global const int *restrict belts, __global const float2 *restrict waves, float sign,
                     int first, int second, int third, int last, __global float *restrict sink, int n_a, int n_b,
                     int n_z, int n_belt, int n_wave, int n_i, int n_j) {
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
        __global const int *belt = belts;
        for (int next = 1; next < n_belt && number >= belts[next * BELT + 15]; next++) belt = belts + next * BELT;
        const int n = belt[1], rings = belt[2], radix = belt[3], done = belt[4], turns = n / (done * radix);
        const int at_once = belt[14] ? belt[14] : rings, batches = (rings + at_once - 1) / at_once, unit = (number - belt[15]) / batches;
        if (unit >= n / radix) return;
        const int inner = unit % done, start = unit / done, ring = (number - belt[15]) % batches * at_once;
        __global const float2 *wave = waves + belt[5];
        const int2 read = row_of(belt + 6, start * done + inner, turns * done);
        const int2 write = row_of(belt + 10, start * done * radix + inner, done);
#ifdef FIRST
        for (int lanes = 0; lanes < THREADS; lanes += WIDE) {
            const int lane = ring * THREADS + min(lanes + item % WIDE, THREADS - 1);
            by_group(whole + read.x + lane, read.y, sunk + write.x + lane, write.y, held + item % WIDE, wave, n / RADIX,
                     inner * turns, sign);
        }
#else
        if (belt[14] == 0) {
            const int blocks = (radix + OUTPUTS - 1) / OUTPUTS;
            for (int task = item / THREADS; task < blocks * rings; task += items / THREADS)
                direct_sums(from, to, belt, wave, sign, unit * blocks * rings + task, blocks);
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
        __global const int *belt = belts;
        int own = item, blocks = 0, b = 0;
        for (; b < n_belt; b++, belt += BELT) {
            blocks = (belt[3] + OUTPUTS - 1) / OUTPUTS;
            const int count = belt[1] / belt[3] * blocks * belt[2];
            if (own < count) break;
            own -= count;
        }
        if (b == n_belt) return;
        const int n = belt[1], rings = belt[2], radix = belt[3], done = belt[4], turns = n / (done * radix);
        __global const float2 *wave = waves + belt[5];
        if (radix <= ONE_SUM || radix > AT_ONCE) {
            direct_sums(from, to, belt, wave, sign, own, blocks);
            continue;
        }
        if (own % blocks) continue;
        const int which = own / blocks, ring = which % rings, inner = which / rings % done, start = which / rings / done;
        int read[AT_ONCE], write[AT_ONCE];
        places_of(read, radix, start * done + inner, turns * done, belt + 6, ring);
        places_of(write, radix, start * done * radix + inner, done, belt + 10, ring);
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

// The tile whose entries an item takes, and where those of its frequency begin.
#define ENTRIES                                                                                                        \
    const int back = 2 * k > n_k, kept = back ? n_k - k : k;                                                           \
    __global const float *frequency = entries + (size_t)kept * (n_entry / (n_k / 2 + 1));
#define KEPT_TILE(tile) (back ? tiles[2 * (tile) + 1] : (tile))
#define FIRST_OF(tile) tiles[2 * KEPT_TILE(tile)]
// Columns of a pair: right and left of the middle where they mirror each other, else one. How many pairs there are.
#define RIGHT(pair) ((mirrored ? n_r / 2 : 0) + (pair))
#define LEFT(pair) (n_r - 1 - RIGHT(pair))
#define ALL_PAIRS (n_r - RIGHT(0))
// How many pairs of columns light it at this frequency.
#define PAIRS_OF(tile) lit[kept * n_tile + KEPT_TILE(tile)]
#ifdef MATRIX_UNITS
#include "ring_units.h"
#else
#define EACH_ROW(row) UNROLL for (int row = 0; row < ROWS; row++)

// Adds `ROWS` entries that follow each other, which are two loads, times a vector.
#define ADD_EIGHT(sums, entry, value)                                                                                  \
    {                                                                                                                  \
        const float4 low = (entry)[0], high = (entry)[1];                                                              \
        (sums)[0] += low.x * (value); (sums)[1] += low.y * (value); (sums)[2] += low.z * (value);                      \
        (sums)[3] += low.w * (value); (sums)[4] += high.x * (value); (sums)[5] += high.y * (value);                    \
        (sums)[6] += high.z * (value); (sums)[7] += high.w * (value);                                                  \
    }

#ifdef GPU
// A group computes what its ITEMS items along minor, of TILE_MINOR cells or pairs each, make of the lanes of its slabs.
// Items of a warp are lanes of the same cells, so that an entry is one read for all of them. What the next step takes is
// fetched into registers while this one is computed, and then laid where all items read it.
#define ITEMS (GROUP / THREADS > 0 ? GROUP / THREADS : 1)
#define EACH (TILE_MINOR / ROWS)
#define MEMBER ((int)(get_local_id(2) * get_local_size(0) + get_local_id(0)))
#define MEMBERS ((int)(get_local_size(2) * get_local_size(0)))
#define SPREAD ((int)get_local_size(2) * THREADS)
#define GROUP_ITEM ((int)get_group_id(0) * ITEMS)
// Two sides, one laid while the other is read; where a group has so many items that both do not fit, one.
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
// Values that an item fetches, of ROWS of all lanes and slabs, and of entries. It takes every ITEMS-th row.
#define PART_OF_ROWS(rows) MIN_ONE((rows) / ITEMS)
#define PART(total) MIN_ONE((total) / (ITEMS * THREADS * SLABS))
// Fetch `part` of `count` values, from a first on and `step` apart, that are VALUE(m); the rest when they are laid.
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
    // m counts slabs of an item, pairs, then right and left; entries of a pair, pairs, then tiles. Pairs beyond all have
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
// Adds Σ of four entries that follow each other times a vector each.
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
    // m counts slabs of an item, then cells; entries of a pair, then pairs.
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
