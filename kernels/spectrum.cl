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

#ifdef COMPILE_fold_columns
FIELD_KERNEL fold_columns(ARRAY sinogram, int mirrored, __global float *restrict folded, int n_k, int n_r, int n_z,
                          int n_pair) {
    const int k = ITEM_MAJOR, middle = n_pair / 2;
    if (k >= n_k) return;
    ARRAY from = sinogram + slab_offset(n_k, n_r);
    __global float *to = folded + slab_offset(n_k, n_pair);
    EACH_MINOR(p, n_pair) {
        const int pair = mirrored ? p % middle : p, right = mirrored ? n_r / 2 + pair : p;
        const int left = n_r - 1 - right, whole = !mirrored || right == left;
        const int dark = right >= n_r || p >= 2 * middle || (mirrored && whole && p >= middle);
        EACH_VECTOR {
            Vector sum = ZERO;
            if (!dark) {
                sum = LOAD(from + SAMPLE(k, right, n_r));
                if (!whole) sum += (p < middle ? 1.0f : -1.0f) * LOAD(from + SAMPLE(k, left, n_r));
            }
            STORE(to + SAMPLE(k, p, n_pair), sum);
        }
    }
}
#endif

#ifdef COMPILE_unfold_columns
FIELD_KERNEL unfold_columns(ARRAY folded, int mirrored, __global float *restrict sinogram, int n_k, int n_pair, int n_z,
                            int n_r) {
    const int k = ITEM_MAJOR, middle = n_pair / 2;
    if (k >= n_k) return;
    ARRAY from = folded + slab_offset(n_k, n_pair);
    __global float *to = sinogram + slab_offset(n_k, n_r);
    EACH_MINOR(r, n_r) {
        const int mirror = n_r - 1 - r, pair = mirrored ? max(r, mirror) - n_r / 2 : r;
        EACH_VECTOR {
            Vector sum = LOAD(from + SAMPLE(k, pair, n_pair));
            if (mirrored && r != mirror) sum += (r > mirror ? 1.0f : -1.0f) * LOAD(from + SAMPLE(k, middle + pair, n_pair));
            STORE(to + SAMPLE(k, r, n_r), sum);
        }
    }
}
#endif

#ifdef COMPILE_fourier
#ifdef AT_ONCE

// The radix of the next pass of a transform: of those that have a pass of their own the first, or the least factor.
static inline int radix_of(int n) {
    if (n % 4 == 0) return 4;
    if (n % 5 == 0) return 5;
    int radix = 2;
    while (n % radix) radix++;
    return radix;
}

#define TIMES(wave, value) ((wave).x * (value) + sign * (wave).y * turned(value))
// A pass of one radix: what it takes, `near`, is `apart` from the next; what it makes, `out`, is `done`. Waves of the first
// input are 1.
#define PASS(radix, ...)                                                                                               \
    for (int inner = 0; inner < done; inner++) {                                                                       \
        float2 turn[radix];                                                                                            \
        UNROLL for (int r = 1; r < radix; r++) turn[r] = wave[r * inner * turns * wide];                               \
        for (int start = 0; start < turns; start++) {                                                                  \
            const Vector *near = from + start * done + inner;                                                          \
            Vector *out = to + start * done * radix + inner, g[radix];                                                 \
            g[0] = near[0];                                                                                            \
            UNROLL for (int r = 1; r < radix; r++) g[r] = TIMES(turn[r], near[r * turns * done]);                      \
            __VA_ARGS__                                                                                                \
        }                                                                                                              \
    }

// The transform of `radix` values, pass by pass between two private arrays; `wide` waves make one of theirs. Returns
// where the result is.
static inline Vector *passes(Vector *from, Vector *to, int radix, __global const float2 *wave, int wide, float sign) {
    for (int done = 1, part = 1; done < radix; done *= part) {
        part = radix_of(radix / done);
        const int turns = radix / (done * part);
        if (part == 4) PASS(4, {
            const Vector a = g[0] + g[2], b = g[0] - g[2], c = g[1] + g[3], d = sign * turned(g[1] - g[3]);
            out[0] = a + c; out[done] = b + d; out[2 * done] = a - c; out[3 * done] = b - d;
        })
        else if (part == 5) PASS(5, {
            const Vector a = g[1] + g[4], b = g[1] - g[4], c = g[2] + g[3], d = g[2] - g[3];
            const Vector low = g[0] + 0.30901699f * a - 0.80901699f * c, high = g[0] - 0.80901699f * a + 0.30901699f * c;
            const Vector slow = sign * turned(0.95105652f * b + 0.58778525f * d);
            const Vector fast = sign * turned(0.58778525f * b - 0.95105652f * d);
            out[0] = g[0] + a + c; out[done] = low + slow; out[4 * done] = low - slow;
            out[2 * done] = high + fast; out[3 * done] = high - fast;
        })
        else if (part == 3) PASS(3, {
            const Vector a = g[1] + g[2], b = sign * 0.86602540f * turned(g[1] - g[2]), c = g[0] - 0.5f * a;
            out[0] = g[0] + a; out[done] = c + b; out[2 * done] = c - b;
        })
        else if (part == 2) PASS(2, { out[0] = g[0] + g[1]; out[done] = g[0] - g[1]; })
        else for (int start = 0; start < turns; start++) for (int inner = 0; inner < done; inner++)
            for (int k = 0, step = inner * turns; k < part; k++, step += done * turns) {
                Vector along = ZERO, across = ZERO;
                for (int r = 0, phase = 0; r < part; r++, phase = (phase + step) % radix) {
                    const Vector given = from[(start + r * turns) * done + inner];
                    const float2 turn = wave[phase * wide];
                    along += turn.x * given;
                    across += turn.y * given;
                }
                to[start * done * part + inner + k * done] = along + sign * turned(across);
            }
        Vector *next = from;
        from = to;
        to = next;
    }
    return from;
}
#endif

// An item computes OUTPUTS samples of a transform, which share what they are made of. Of a radix above ONE_SUM, where
// there is room for it, it computes all or none.
FIELD_KERNEL fourier(ARRAY source, __global const int *restrict belts, __global const float2 *restrict waves, float sign,
                     __global float *restrict sink, int n_a, int n_b, int n_z, int n_belt, int n_wave, int n_i, int n_j) {
    if (ITEM_MAJOR >= n_i || ITEM_Z >= n_z) return;
    ARRAY from = source + slab_offset(n_a, n_b);
    __global float *to = sink + slab_offset(n_i, n_j);
    const int items = (n_j + 1) / 2, first = ITEM_MAJOR * items, begin = TILE_MINOR ? ITEM_MINOR : 0;
    for (int item = first + begin, end = first + (TILE_MINOR ? min(begin + 1, items) : items); item < end; item++) {
        __global const int *belt = belts;
        int own = item, blocks = 0, b = 0;
        for (; b < n_belt; b++, belt += 14) {
            blocks = (belt[3] + OUTPUTS - 1) / OUTPUTS;
            const int count = belt[1] / belt[3] * blocks * belt[2];
            if (own < count) break;
            own -= count;
        }
        if (b == n_belt) return;
        const int n = belt[1], rings = belt[2], radix = belt[3], done = belt[4], turns = n / (done * radix);
#ifdef AT_ONCE
        if (radix > ONE_SUM && radix <= AT_ONCE) {
            if (own % blocks) continue;
            const int which = own / blocks, ring = which % rings, inner = which / rings % done, start = which / rings / done;
            __global const float2 *wave = waves + belt[5];
            Vector values[2 * AT_ONCE];
            EACH_VECTOR {
                for (int r = 0, sample = start * done + inner; r < radix; r++, sample += turns * done) {
                    const int at = belt[6] + sample % belt[7] * belt[8] + sample / belt[7] * belt[9] + ring;
                    const Vector given = LOAD(from + SAMPLE(0, at, 0));
                    const float2 turn = wave[(long)r * inner * turns % n];
                    values[r] = inner ? turn.x * given + sign * turn.y * turned(given) : given;
                }
                const Vector *found = passes(values, values + AT_ONCE, radix, wave, n / radix, sign);
                for (int b = 0; b < radix; b++) {
                    const int out = start * done * radix + inner + b * done;
                    const int at = belt[10] + out % belt[11] * belt[12] + out / belt[11] * belt[13] + ring;
                    STORE(to + SAMPLE(0, at, 0), found[b]);
                }
            }
            continue;
        }
#endif
        const int ring = own % rings, block = own / rings % blocks * OUTPUTS, group = own / rings / blocks;
        const int inner = group % done, start = group / done;
        __global const float2 *wave = waves + belt[5];
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
}
#endif

// The tile whose entries an item takes, and where those of its frequency begin.
#define ENTRIES                                                                                                        \
    const int back = 2 * k > n_k, kept = back ? n_k - k : k;                                                           \
    __global const float *frequency = entries + (size_t)kept * (n_entry / (n_k / 2 + 1));
#define TILE_OF(tile) (tiles + 5 * (back ? tiles[5 * (tile) + 2] : (tile)))
// How many pairs of columns light it at this frequency.
#define PAIRS_OF(own) (kept >= (own)[3] && kept < (own)[4] ? 0 : (own)[1])
// How far the slab after this item's own lies, for items of several; the last one again where there is none.
#define NEXT_SLAB(u, n_major, n_minor) \
    ((size_t)min(u, (n_z - 1) / LANES - ITEM_SLAB) * (n_major) * (n_minor) * LANES)
#define EACH_SLAB UNROLL for (int u = 0; u < TILE_SLABS; u++)
#define EACH_ROW(row) UNROLL for (int row = 0; row < ROWS; row++)

// Sums of `ROWS` entries times a vector in each slab: eight entries that follow each other are two loads.
#define ADD_EIGHT(sums, entry, values)                                                                                 \
    {                                                                                                                  \
        const float4 low = (entry)[0], high = (entry)[1];                                                              \
        EACH_SLAB {                                                                                                    \
            sums[u][0] += low.x * values[u]; sums[u][1] += low.y * values[u];                                          \
            sums[u][2] += low.z * values[u]; sums[u][3] += low.w * values[u];                                          \
            sums[u][4] += high.x * values[u]; sums[u][5] += high.y * values[u];                                        \
            sums[u][6] += high.z * values[u]; sums[u][7] += high.w * values[u];                                        \
        }                                                                                                              \
    }

#ifdef GPU
// A group computes TILES tiles of rows by all lanes of its slabs, from what its items fetch together.
#define TILES (GROUP / THREADS > 0 ? GROUP / THREADS : 1)
#define SLABS 4
#define CHUNK 8
#define LANE_ITEM ((int)get_local_id(0) % THREADS)
#define TILE_ITEM ((int)get_local_id(0) / THREADS)
#define MEMBER ((int)(get_local_id(2) * get_local_size(0) + get_local_id(0)))
#define MEMBERS ((int)(get_local_size(0) * get_local_size(2)))
#define GROUP_SLAB ((int)(get_group_id(2) * get_local_size(2)) * TILE_SLABS)
#define GROUP_TILE ((int)(get_group_id(0) * (get_local_size(0) / THREADS)))
#define HELD ((int)get_local_size(2) * TILE_SLABS)
#endif

#ifdef COMPILE_light_rings
FIELD_KERNEL light_rings(ARRAY folded, __global const float *restrict entries, __global const int *restrict tiles,
                         int mirrored, __global float *restrict spectrum, int n_k, int n_pair, int n_z, int n_entry,
                         int n_tile, int n_cell) {
#ifdef GPU
    const int k = min(ITEM_MAJOR, n_k - 1), tile = ITEM_MINOR, middle = mirrored ? n_pair / 2 : 0;
    const int last = (n_z - 1) / LANES;
    ENTRIES
    __local float4 light[2][CHUNK][SLABS][THREADS], shares[TILES][CHUNK][4];
    int most = 0;
    for (int t = 0; t < TILES && GROUP_TILE + t < n_tile; t++) most = max(most, PAIRS_OF(TILE_OF(GROUP_TILE + t)));
    Vector real[TILE_SLABS][ROWS], imaginary[TILE_SLABS][ROWS];
    EACH_SLAB EACH_ROW(row) real[u][row] = imaginary[u][row] = ZERO;
    for (int begin = 0; begin < most; begin += CHUNK) {
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int m = MEMBER; m < TILES * CHUNK * 4; m += MEMBERS) {
            const int t = m / (CHUNK * 4), rest = m % (CHUNK * 4);
            __global const int *own = TILE_OF(min(GROUP_TILE + t, n_tile - 1));
            ((__local float4 *)shares)[m] =
                begin < PAIRS_OF(own) ? ((__global const float4 *)(frequency + own[0] + 2 * ROWS * begin))[rest] : ZERO;
        }
        for (int m = MEMBER; m < 2 * CHUNK * HELD * THREADS; m += MEMBERS) {
            const int lane = m % THREADS, u = m / THREADS % HELD, p = m / THREADS / HELD % CHUNK;
            const int side = m / THREADS / HELD / CHUNK, slab = min(GROUP_SLAB + u, last);
            light[side][p][u][lane] = ((__global const float4 *)(folded + ((size_t)slab * n_k + k) * n_pair * LANES))
                [(begin + p + side * middle) * THREADS + lane];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        UNROLL for (int p = 0; p < CHUNK; p++) {
            __local const float4 *share = shares[TILE_ITEM][p];
            Vector sum[TILE_SLABS], difference[TILE_SLABS];
            EACH_SLAB {
                sum[u] = light[0][p][get_local_id(2) * TILE_SLABS + u][LANE_ITEM];
                difference[u] = light[1][p][get_local_id(2) * TILE_SLABS + u][LANE_ITEM];
            }
            ADD_EIGHT(real, share, sum)
            ADD_EIGHT(imaginary, share + 2, difference)
        }
    }
    if (ITEM_MAJOR >= n_k || tile >= n_tile || ITEM_SLAB > last) return;
    __global float *to = spectrum + slab_offset(n_k, n_cell) + SAMPLE(k, tile * ROWS, n_cell);
    const int v = 0;
    EACH_SLAB EACH_ROW(row) STORE(to + NEXT_SLAB(u, n_k, n_cell) + SAMPLE(0, row, 0),
                                  real[u][row] + (back ? -1.0f : 1.0f) * turned(imaginary[u][row]));
#else
    const int k = ITEM_MAJOR, tile = ITEM_MINOR, middle = mirrored ? n_pair / 2 : 0;
    if (k >= n_k || tile >= n_tile || ITEM_Z >= n_z) return;
    ENTRIES
    __global const int *own = TILE_OF(tile);
    ARRAY from = folded + slab_offset(n_k, n_pair) + SAMPLE(k, 0, n_pair);
    __global float *to = spectrum + slab_offset(n_k, n_cell) + SAMPLE(k, tile * ROWS, n_cell);
    EACH_VECTOR {
        Vector real[TILE_SLABS][ROWS], imaginary[TILE_SLABS][ROWS];
        EACH_SLAB EACH_ROW(row) real[u][row] = imaginary[u][row] = ZERO;
        __global const float *entry = frequency + own[0];
        for (int pair = 0, pairs = PAIRS_OF(own); pair < pairs; pair++, entry += 2 * ROWS) {
            Vector sum[TILE_SLABS], difference[TILE_SLABS];
            EACH_SLAB {
                sum[u] = LOAD(from + NEXT_SLAB(u, n_k, n_pair) + SAMPLE(0, pair, 0));
                difference[u] = LOAD(from + NEXT_SLAB(u, n_k, n_pair) + SAMPLE(0, middle + pair, 0));
            }
            ADD_EIGHT(real, (__global const float4 *)entry, sum)
            ADD_EIGHT(imaginary, (__global const float4 *)entry + 2, difference)
        }
        EACH_SLAB EACH_ROW(row) STORE(to + NEXT_SLAB(u, n_k, n_cell) + SAMPLE(0, row, 0),
                                      real[u][row] + (back ? -1.0f : 1.0f) * turned(imaginary[u][row]));
    }
#endif
}
#endif

#ifdef COMPILE_gather_rings
// Σ over rows of an entry and the one beside it times a vector.
#define DOT_EIGHT(sum, entry, values)                                                                                  \
    {                                                                                                                  \
        const float4 low = (entry)[0], high = (entry)[1];                                                              \
        EACH_SLAB sum[u] += low.x * values[u][0] + low.y * values[u][1] + low.z * values[u][2] + low.w * values[u][3] + \
            high.x * values[u][4] + high.y * values[u][5] + high.z * values[u][6] + high.w * values[u][7];             \
    }

#ifdef GPU
// The first tile from one on that a pair of columns lights.
static inline int next_lit(int tile, int n_tile, int pair, __global const int *tiles, int back, int kept) {
    while (tile < n_tile && PAIRS_OF(TILE_OF(tile)) <= pair) tile++;
    return tile;
}
#endif

FIELD_KERNEL gather_rings(ARRAY spectrum, __global const float *restrict entries, __global const int *restrict tiles,
                          int mirrored, __global float *restrict folded, int n_k, int n_cell, int n_z, int n_entry,
                          int n_tile, int n_pair) {
#ifdef GPU
    const int k = min(ITEM_MAJOR, n_k - 1), first = ITEM_MINOR * ROWS, middle = mirrored ? n_pair / 2 : 0;
    const int last = (n_z - 1) / LANES, begin = GROUP_TILE * ROWS;
    ENTRIES
    __local float4 light[ROWS][SLABS][THREADS], shares[TILES * ROWS][4];
    Vector real[ROWS][TILE_SLABS], imaginary[ROWS][TILE_SLABS];
    EACH_SLAB EACH_ROW(pair) real[pair][u] = imaginary[pair][u] = ZERO;
    for (int tile = next_lit(0, n_tile, begin, tiles, back, kept); tile < n_tile;
         tile = next_lit(tile + 1, n_tile, begin, tiles, back, kept)) {
        __global const int *own = TILE_OF(tile);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int m = MEMBER; m < TILES * ROWS * 4; m += MEMBERS)
            if (begin + m / 4 < PAIRS_OF(own))
                shares[m / 4][m % 4] = ((__global const float4 *)(frequency + own[0] + 2 * ROWS * begin))[m];
        for (int m = MEMBER; m < ROWS * HELD * THREADS; m += MEMBERS) {
            const int lane = m % THREADS, u = m / THREADS % HELD, row = m / THREADS / HELD;
            const int slab = min(GROUP_SLAB + u, last);
            light[row][u][lane] = ((__global const float4 *)(spectrum + ((size_t)slab * n_k + k) * n_cell * LANES))
                [(tile * ROWS + row) * THREADS + lane];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (PAIRS_OF(own) > first) {
            Vector ring[TILE_SLABS][ROWS];
            EACH_SLAB EACH_ROW(row) ring[u][row] = light[row][get_local_id(2) * TILE_SLABS + u][LANE_ITEM];
            EACH_ROW(pair) {
                __local const float4 *share = shares[first - begin + pair];
                DOT_EIGHT(real[pair], share, ring)
                DOT_EIGHT(imaginary[pair], share + 2, ring)
            }
        }
    }
    if (ITEM_MAJOR >= n_k || first >= (mirrored ? middle : n_pair) || ITEM_SLAB > last) return;
    __global float *to = folded + slab_offset(n_k, n_pair) + SAMPLE(k, first, n_pair);
    const int v = 0;
    EACH_SLAB EACH_ROW(pair) {
        __global float *at = to + NEXT_SLAB(u, n_k, n_pair);
        const Vector difference = (back ? 1.0f : -1.0f) * turned(imaginary[pair][u]);
        STORE(at + SAMPLE(0, pair, 0), middle ? real[pair][u] : real[pair][u] + difference);
        if (middle) STORE(at + SAMPLE(0, middle + pair, 0), difference);
    }
#else
    const int k = ITEM_MAJOR, first = ITEM_MINOR * ROWS, middle = mirrored ? n_pair / 2 : 0;
    if (k >= n_k || first >= (mirrored ? middle : n_pair) || ITEM_Z >= n_z) return;
    ENTRIES
    ARRAY from = spectrum + slab_offset(n_k, n_cell) + SAMPLE(k, 0, n_cell);
    __global float *to = folded + slab_offset(n_k, n_pair) + SAMPLE(k, first, n_pair);
    EACH_VECTOR {
        Vector real[ROWS][TILE_SLABS], imaginary[ROWS][TILE_SLABS];
        EACH_SLAB EACH_ROW(pair) real[pair][u] = imaginary[pair][u] = ZERO;
        for (int tile = 0; tile < n_tile; tile++) {
            __global const int *own = TILE_OF(tile);
            if (PAIRS_OF(own) <= first) continue;
            __global const float *entry = frequency + own[0] + 2 * ROWS * first;
            Vector ring[TILE_SLABS][ROWS];
            EACH_SLAB EACH_ROW(row)
                ring[u][row] = LOAD(from + NEXT_SLAB(u, n_k, n_cell) + SAMPLE(0, tile * ROWS + row, 0));
            EACH_ROW(pair) {
                DOT_EIGHT(real[pair], (__global const float4 *)(entry + 2 * ROWS * pair), ring)
                DOT_EIGHT(imaginary[pair], (__global const float4 *)(entry + 2 * ROWS * pair + ROWS), ring)
            }
        }
        EACH_SLAB EACH_ROW(pair) {
            __global float *at = to + NEXT_SLAB(u, n_k, n_pair);
            const Vector difference = (back ? 1.0f : -1.0f) * turned(imaginary[pair][u]);
            STORE(at + SAMPLE(0, pair, 0), middle ? real[pair][u] : real[pair][u] + difference);
            if (middle) STORE(at + SAMPLE(0, middle + pair, 0), difference);
        }
    }
#endif
}
#endif
