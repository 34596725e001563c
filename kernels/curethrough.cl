#include "common.h"
#ifndef UNROLL
#define UNROLL _Pragma("unroll")
#endif

// Pixels of a row are alike and next to each other: on a CPU an item owns a strip of a row and takes PACK pixels at a
// time, one a lane; on a GPU strips are one pixel wide.
#ifdef CPU
#define PACK 16
#define PACKS 4
typedef float16 Real;
typedef int16 Whole;
typedef uint16 Word;
typedef uchar16 Bytes;
#define ANY(mask) any(mask)
#define ALL(mask) all(mask)
#define LANE0(value) (value).s0
#define GATHER(T, table, i) (T)((table)[(i).s0], (table)[(i).s1], (table)[(i).s2], (table)[(i).s3], \
    (table)[(i).s4], (table)[(i).s5], (table)[(i).s6], (table)[(i).s7], (table)[(i).s8], (table)[(i).s9], \
    (table)[(i).sa], (table)[(i).sb], (table)[(i).sc], (table)[(i).sd], (table)[(i).se], (table)[(i).sf])
#define TO_REAL(value) convert_float16(value)
#define TO_WHOLE(value) convert_int16(value)
#define TO_BYTES(value) convert_uchar16(value)
#define AS_WHOLE(value) as_int16(value)
#define NUMBERS (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#define CURE_KERNEL __kernel __attribute__((vec_type_hint(float16))) void
#else
#define PACK 1
#define PACKS 1
typedef float Real;
typedef int Whole;
typedef uint Word;
typedef uchar Bytes;
#define ANY(mask) (mask)
#define ALL(mask) (mask)
#define LANE0(value) (value)
#define GATHER(T, table, i) ((table)[i])
#define TO_REAL(value) convert_float(value)
#define TO_WHOLE(value) convert_int(value)
#define TO_BYTES(value) convert_uchar(value)
#define AS_WHOLE(value) as_int(value)
#define NUMBERS 0
#define CURE_KERNEL __kernel void
#endif

#define BITS 32
#define BEYOND (1 << 20)
#define NEVER 1e30f
#define START_X 0.7548776662466927f
#define START_Y 0.5698402909980532f

// PACK neighbours from x on; the last pack of a row may be a part of one.
#ifdef CPU
#define PACKED(NAME, SCALAR, VECTOR, ZERO) \
    static inline VECTOR load_##NAME(__global const SCALAR *row, int x, int n_x) { \
        if (x + PACK <= n_x) return vload16(0, row + x); \
        SCALAR part[PACK]; \
        for (int k = 0; k < PACK; k++) part[k] = x + k < n_x ? row[x + k] : (SCALAR)(ZERO); \
        return vload16(0, part); \
    } \
    static inline void store_##NAME(__global SCALAR *row, int x, int n_x, VECTOR value) { \
        if (x + PACK <= n_x) { vstore16(value, 0, row + x); return; } \
        SCALAR part[PACK]; \
        vstore16(value, 0, part); \
        for (int k = 0; k < PACK && x + k < n_x; k++) row[x + k] = part[k]; \
    }
static inline int summed(int16 v) {
    const int8 a = v.lo + v.hi; const int4 b = a.lo + a.hi; const int2 c = b.lo + b.hi;
    return c.x + c.y;
}
static inline float highest(float16 v) {
    const float8 a = fmax(v.lo, v.hi); const float4 b = fmax(a.lo, a.hi); const float2 c = fmax(b.lo, b.hi);
    return fmax(c.x, c.y);
}
#else
#define PACKED(NAME, SCALAR, VECTOR, ZERO) \
    static inline VECTOR load_##NAME(__global const SCALAR *row, int x, int n_x) { return row[x]; } \
    static inline void store_##NAME(__global SCALAR *row, int x, int n_x, VECTOR value) { row[x] = value; }
static inline int summed(int v) { return v; }
static inline float highest(float v) { return v; }
#endif
PACKED(real, float, Real, 0)
PACKED(whole, int, Whole, 0)
PACKED(word, uint, Word, 0)
PACKED(bytes, uchar, Bytes, 0)

// A whole pack that is not read again soon: past the caches, which would fetch the old values first.
static inline void stream_real(__global float *at, Real value) {
#ifdef CPU
#if __has_builtin(__builtin_nontemporal_store)
    if (((size_t)at & (sizeof(Real) - 1)) == 0) { __builtin_nontemporal_store(value, (__global Real *)at); return; }
#endif
    vstore16(value, 0, at);
#else
    *at = value;
#endif
}

// The strip of this item: pixels x_begin to x_end of row y.
#define STRIP \
    const int y = get_global_id(1), strip = get_global_id(0); \
    const int width = ((n_x + n_strip - 1) / n_strip + PACK - 1) / PACK * PACK; \
    const int x_begin = strip * width, x_end = min(x_begin + width, n_x); \
    const size_t row = (size_t)y * n_x, plane = (size_t)n_y * n_x;

#ifdef CPU
// No bit set; compilers are slow at the built-in test of bytes.
static inline int NONE(Bytes value) {
    const ulong2 halves = as_ulong2(value);
    return (halves.x | halves.y) == 0;
}
#endif

// What a slice adds at each pixel. Neighbours mostly show the same level.
static inline Real light_of(__global const float *light, Bytes level) {
#ifdef CPU
    if (NONE(level ^ (Bytes)level.s0)) return (Real)light[level.s0];
#endif
    return GATHER(Real, light, level);
}

// The same for PACKS packs that follow each other.
static inline void light_of_packs(__global const float *light, __global const uchar *line, int x, int n_x, Real *out) {
    Bytes level[PACKS];
    UNROLL for (int v = 0; v < PACKS; v++) level[v] = load_bytes(line, x + v * PACK, n_x);
#ifdef CPU
    const Bytes one = (Bytes)level[0].s0;
    if (NONE((level[0] ^ one) | (level[1] ^ one) | (level[2] ^ one) | (level[3] ^ one))) {
        const Real all = (Real)light[level[0].s0];
        UNROLL for (int v = 0; v < PACKS; v++) out[v] = all;
        return;
    }
#endif
    UNROLL for (int v = 0; v < PACKS; v++) out[v] = light_of(light, level[v]);
}

static inline void add(Real *dose, Real *rest, Real change) {
    const Real whole = change + *rest, total = *dose + whole;
    *rest = whole - (total - *dose);
    *dose = total;
}

#ifdef COMPILE_pack_slices
CURE_KERNEL pack_slices(__global const uchar *restrict levels, int threshold, int block, __global uint *restrict words,
                        __global int *restrict solid, int n_slice, int n_y, int n_x, int n_word, int n_strip) {
    STRIP
    words += (block % n_word) * plane + row;
    int count = 0;
    for (int x = x_begin; x < x_end; x += PACK) store_word(words, x, n_x, (Word)0);
    for (int n = 0; n < n_slice; n++) {
        __global const uchar *line = levels + n * plane + row;
        for (int x = x_begin; x < x_end; x += PACK) {
            const Whole level = TO_WHOLE(load_bytes(line, x, n_x));
            const Whole yes = (level >= threshold && NUMBERS + x < n_x) ? (Whole)1 : (Whole)0;
            if (!ANY(yes != 0)) continue;
            count += summed(yes);
            const Whole word = AS_WHOLE(load_word(words, x, n_x)) | yes << n;
#ifdef CPU
            store_word(words, x, n_x, as_uint16(word));
#else
            store_word(words, x, n_x, as_uint(word));
#endif
        }
    }
    solid[(size_t)y * n_strip + strip] = count;
}
#endif

#ifdef COMPILE_expose_slices
CURE_KERNEL expose_slices(__global const uchar *restrict levels, __global const float *restrict light, float decay,
                          float part, float fade, __global float *restrict state, __global float *restrict doses,
                          __global float *restrict peaks, int n_slice, int n_y, int n_x, int n_kept, int n_strip) {
    STRIP
    __global float *own = state + row, *rests = state + plane + row;
    Real peak = (Real)0.0f;
    int x = x_begin;
    for (; x + PACKS * PACK <= x_end; x += PACKS * PACK) {  // a cache line of levels at a time, doses in registers
        Real dose[PACKS], rest[PACKS];
        UNROLL for (int v = 0; v < PACKS; v++) {
            dose[v] = load_real(own, x + v * PACK, n_x);
            rest[v] = load_real(rests, x + v * PACK, n_x);
        }
        for (int n = n_slice - 1; n >= 0; n--) {
            __global const uchar *line = levels + n * plane + row;
            Real change[PACKS];
            light_of_packs(light, line, x, n_x, change);
            UNROLL for (int v = 0; v < PACKS; v++) change[v] -= decay * dose[v];
            if (n < n_kept)
                UNROLL for (int v = 0; v < PACKS; v++)
                    stream_real(doses + n * plane + row + x + v * PACK, (dose[v] + part * change[v]) * fade);
            UNROLL for (int v = 0; v < PACKS; v++) {
                add(&dose[v], &rest[v], change[v]);
                peak = fmax(peak, dose[v]);
            }
        }
        UNROLL for (int v = 0; v < PACKS; v++) {
            store_real(own, x + v * PACK, n_x, dose[v]);
            store_real(rests, x + v * PACK, n_x, rest[v]);
        }
    }
    for (; x < x_end; x += PACK) {
        Real dose = load_real(own, x, n_x), rest = load_real(rests, x, n_x);
        for (int n = n_slice - 1; n >= 0; n--) {
            const Real change = light_of(light, load_bytes(levels + n * plane + row, x, n_x)) - decay * dose;
            if (n < n_kept) store_real(doses + n * plane + row, x, n_x, (dose + part * change) * fade);
            add(&dose, &rest, change);
            peak = fmax(peak, NUMBERS + x < n_x ? dose : (Real)0.0f);
        }
        store_real(own, x, n_x, dose);
        store_real(rests, x, n_x, rest);
    }
    peaks[(size_t)y * n_strip + strip] = highest(peak);
}
#endif

#ifdef COMPILE_correct_slices
typedef struct { Whole to_void, to_solid; } Ahead;

// Slices before the block that are like its first, should that be void or solid.
static inline Ahead look_ahead(__global const uint *words, int block, int platform, size_t row, size_t plane, int x,
                               int n_x, int n_word) {
    if (block == 0) return (Ahead){(Whole)BEYOND, (Whole)(platform ? BEYOND : 0)};
    Whole run = (Whole)0, open = (Whole)~0;
    Word last = (Word)0;
    int j = block - 1;
    for (; j >= 0 && j > block - n_word && ANY(open); j--) {
        const Word word = load_word(words + (j % n_word) * plane + row, x, n_x);
        if (j == block - 1) last = word >> (BITS - 1);
        const Word other = last != 0 ? ~word : word;
        run += open & AS_WHOLE(clz(other));
        open &= other == 0 ? (Whole)~0 : (Whole)0;
    }
    const Whole beyond = (AS_WHOLE(last) == 1 && (Whole)(j < 0 && !platform) != 0) ? (Whole)0 : (Whole)BEYOND;
    run += open & beyond;
    const Whole solid = AS_WHOLE(last) == 1 ? (Whole)~0 : (Whole)0;
    return (Ahead){run & ~solid, run & solid};
}

// An entry of a table for each pixel; neighbours mostly want the same one.
static inline Real looked_up(__global const float *table, Whole at) {
    if (ALL(at == LANE0(at))) return (Real)table[LANE0(at)];
    return GATHER(Real, table, at);
}

// The level nearest to what is wanted, and its light; in a void that leads up to a back side not below it.
static inline Whole choose(Real wanted, __global const float *light, __global const float *edges,
                           __global const uchar *first, float bins, int n_bin, float spread, Real shift, Whole solid,
                           Whole run, Real *shown) {
    const float low = light[0], full = light[255];
    // a dose that dies down stays a rounding error above level 0: that needs no search
    const float least = spread > 0.0f ? low : edges[0], most = spread > 0.0f ? full : edges[254];
    Whole level = wanted >= most ? (Whole)255 : (Whole)0;
    *shown = wanted >= most ? (Real)full : (Real)low;
    const Whole leads = (solid == 0 && run > 0 && wanted > low) ? (Whole)1 : (Whole)0;
    if (!ANY(wanted < most && (wanted > least || leads == 1))) return level;
    const Whole between = (wanted > low && wanted < full) ? (Whole)~0 : (Whole)0;
    const Real aim = between != 0 ? wanted + shift : wanted;
    const Whole bin = clamp(TO_WHOLE((clamp(aim, low, full) - low) * bins), (Whole)0, (Whole)(n_bin - 1));
    level = TO_WHOLE(GATHER(Bytes, first, bin));
    Whole more;
    do {
        more = (aim > GATHER(Real, edges, level) && level < 255) ? (Whole)1 : (Whole)0;
        level += more;
    } while (ANY(more != 0));
    *shown = GATHER(Real, light, level);
    const Whole up = (between != 0 && solid == 0 && run > 0 && *shown < wanted && level < 255) ? (Whole)1 : (Whole)0;
    if (ANY(up != 0)) {
        level += up;
        *shown = GATHER(Real, light, level);
    }
    return level;
}

CURE_KERNEL correct_slices(__global const uint *restrict words, int block, __global const float *restrict light,
                           __global const float *restrict edges, __global const uchar *restrict first, float bins,
                           float decay, __global const float *restrict inner, __global const float *restrict back,
                           int platform, float reached, float opened, float spread, __global float *restrict state,
                           __global int *restrict flaws, __global uchar *restrict levels, __global int *restrict missed,
                           int n_word, int n_y, int n_x, int n_bin, int n_below, int n_above, int n_void, int n_slice,
                           int n_strip) {
    STRIP
    __global const uint *here = words + (block % n_word) * plane + row;
    Whole lost = (Whole)0;
    // Slices lie far apart in memory: what belongs to one cache line is gathered before it goes there.
    Bytes own[BITS * PACKS];
    for (int x_line = x_begin; x_line < x_end; x_line += PACKS * PACK) {
        for (int v = 0; v < PACKS && x_line + v * PACK < x_end; v++) {
            const int x = x_line + v * PACK;
            Real dose = load_real(state + row, x, n_x), rest = load_real(state + plane + row, x, n_x);
            const Word word = load_word(here, x, n_x);
            const Ahead ahead = look_ahead(words, block, platform, row, plane, x, n_x, n_word);
            Real lowest = load_real(state + 2 * plane + row, x, n_x);
            Whole done = TO_WHOLE(load_real(state + 3 * plane + row, x, n_x)), low_count = (Whole)0, closed = (Whole)0;
            const Real lean = TO_REAL(NUMBERS + x) * START_X + y * START_Y;
            const Real shift = spread * (lean - floor(lean) - 0.5f);
            const int void_all = ALL(word == 0) && ALL(ahead.to_void >= n_void - 1);
            const int solid_all =
                ALL(word == ~0u) && ALL(ahead.to_solid >= n_above - 1) && ALL(done >= max(n_below - 1, 1));
            if (void_all || solid_all) {  // far from every edge
                const Real target = (Real)(void_all ? back[n_void - 1] : inner[n_below * n_above - 1]);
                for (int n = n_slice - 1; n >= 0; n--) {
                    Real shown;
                    const Whole level = choose(target - dose + decay * dose, light, edges, first, bins, n_bin, spread,
                                               shift, (Whole)solid_all, (Whole)BEYOND, &shown);
                    own[n * PACKS + v] = TO_BYTES(level);
                    const Real before = dose;
                    add(&dose, &rest, shown - decay * dose);
                    if (void_all) lowest = fmin(fmin(lowest, before), dose);
                }
                store_real(state + row, x, n_x, dose);
                store_real(state + plane + row, x, n_x, rest);
                if (void_all) store_real(state + 2 * plane + row, x, n_x, lowest);
                store_real(state + 3 * plane + row, x, n_x, void_all ? (Real)0.0f : TO_REAL(done + n_slice));
                continue;
            }
            for (int n = n_slice - 1; n >= 0; n--) {
                const Whole bit = AS_WHOLE(word >> n) & 1;
                const Whole solid = bit == 1 ? (Whole)~0 : (Whole)0;
                const Whole other = (AS_WHOLE(word) ^ solid) & (int)((1u << n) - 1u);
                const Whole carried = (ahead.to_solid & solid) | (ahead.to_void & ~solid);
                const Whole run = other != 0 ? n - BITS + AS_WHOLE(clz(other)) : n + carried;
                const Whole starts = (bit == 1 && done == 0) ? (Whole)1 : (Whole)0;
                if (ANY(starts != 0)) {
                    low_count += dose < reached ? starts : (Whole)0;
                    closed += lowest > opened ? starts : (Whole)0;
                }
                Real target;
                if (!ANY(bit == 1)) target = looked_up(back, min(run, n_void - 1));
                else {
                    const Whole place = min(done, n_below - 1) * n_above + min(run, n_above - 1);
                    const Real want = looked_up(inner, solid & place);
                    target = ALL(bit == 1) ? want : bit == 1 ? want : looked_up(back, ~solid & min(run, n_void - 1));
                }
                Real shown;
                const Whole level = choose(target - dose + decay * dose, light, edges, first, bins, n_bin, spread,
                                           shift, bit, run, &shown);
                own[n * PACKS + v] = TO_BYTES(level);
                const Real before = dose;
                add(&dose, &rest, shown - decay * dose);
                lowest = bit == 1 ? (Real)NEVER : fmin(fmin(lowest, before), dose);
                done = bit == 1 ? done + 1 : (Whole)0;
            }
            store_real(state + row, x, n_x, dose);
            store_real(state + plane + row, x, n_x, rest);
            store_real(state + 2 * plane + row, x, n_x, lowest);
            store_real(state + 3 * plane + row, x, n_x, TO_REAL(done));
            if (ANY(low_count != 0)) store_whole(flaws + row, x, n_x, load_whole(flaws + row, x, n_x) + low_count);
            if (ANY(closed != 0))
                store_whole(flaws + plane + row, x, n_x, load_whole(flaws + plane + row, x, n_x) + closed);
            lost += NUMBERS + x < n_x ? low_count : (Whole)0;
        }
        for (int n = 0; n < n_slice; n++)
            for (int v = 0; v < PACKS && x_line + v * PACK < x_end; v++)
                store_bytes(levels + n * plane + row, x_line + v * PACK, n_x, own[n * PACKS + v]);
    }
    missed[(size_t)y * n_strip + strip] = summed(lost);
}
#endif

#ifdef COMPILE_judge_slices
CURE_KERNEL judge_slices(__global const uchar *restrict levels, __global const uint *restrict words, int block,
                         __global const float *restrict light, float decay, float scale, int layered, float critical,
                         __global float *restrict state, __global float *restrict heights, __global float *restrict peaks,
                         int n_slice, int n_y, int n_x, int n_word, int n_strip) {
    STRIP
    words += (block % n_word) * plane + row;
    __global float *own = state + row, *rests = state + plane + row, *over = heights + row, *under = over + plane;
    Real peak = (Real)0.0f;
    for (int n = n_slice - 1; n >= 0; n--) {
        __global const uchar *line = levels + n * plane + row;
        for (int x = x_begin; x < x_end; x += PACK) {
            const Real before = load_real(own, x, n_x);
            Real dose = before, rest = load_real(rests, x, n_x);
            const Real shown = light_of(light, load_bytes(line, x, n_x));
            add(&dose, &rest, shown - decay * dose);
            store_real(own, x, n_x, dose);
            store_real(rests, x, n_x, rest);
            peak = fmax(peak, (NUMBERS + x < n_x) ? dose : (Real)0.0f);
            const Real start = layered ? dose : before, stop = layered ? (1.0f - decay) * dose : dose;
            const Whole was = start >= critical ? (Whole)1 : (Whole)0, is = stop >= critical ? (Whole)1 : (Whole)0;
            const Whole solid = AS_WHOLE(load_word(words, x, n_x) >> n) & 1;
            if (!ANY(was != solid || is != solid)) continue;
            Real share = (Real)1.0f;
            if (ANY(was != is)) {
                const Real limit = layered ? (Real)0.0f : shown / decay;
                const Real past = was != is ? (critical - limit) / (start - limit) : (Real)1.0f;
                share = was != is ? clamp(log(past) * scale, 0.0f, 1.0f) : (Real)1.0f;
            }
            const Real cured = was == 1 ? share : 1.0f - share;
            store_real(over, x, n_x, load_real(over, x, n_x) + (solid == 1 ? (Real)0.0f : cured));
            store_real(under, x, n_x, load_real(under, x, n_x) + (solid == 1 ? 1.0f - cured : (Real)0.0f));
        }
    }
    peaks[(size_t)y * n_strip + strip] = highest(peak);
}
#endif
