// Slices of a print as packs of pixels, which are next to each other in a row: on a CPU an item owns a strip of a row,
// on a GPU strips are one pixel wide. Also the dose that exposing a slice adds.
#include "packs.h"
#ifdef CPU
#define PACKS 4
typedef uint16 Word;
typedef uchar16 Bytes;
#define ALL(mask) all(mask)
#define LANE0(value) (value).s0
#define GATHER(T, table, i) (T)((table)[(i).s0], (table)[(i).s1], (table)[(i).s2], (table)[(i).s3], \
    (table)[(i).s4], (table)[(i).s5], (table)[(i).s6], (table)[(i).s7], (table)[(i).s8], (table)[(i).s9], \
    (table)[(i).sa], (table)[(i).sb], (table)[(i).sc], (table)[(i).sd], (table)[(i).se], (table)[(i).sf])
#define TO_BYTES(value) convert_uchar16(value)
#define AS_WHOLE(value) as_int16(value)
#define AS_WORD(value) as_uint16(value)
#else
#define PACKS 1
typedef uint Word;
typedef uchar Bytes;
#define ALL(mask) (mask)
#define LANE0(value) (value)
#define GATHER(T, table, i) ((table)[i])
#define TO_BYTES(value) convert_uchar(value)
#define AS_WHOLE(value) as_int(value)
#define AS_WORD(value) as_uint(value)
#endif

// PACK neighbors from x on; the last pack of a row may be incomplete.
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

// A whole pack that is not read again soon: written past the caches, which would fetch the old values first.
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
// No bit set; compilers are slow with the built-in test of bytes.
static inline int NONE(Bytes value) {
    const ulong2 halves = as_ulong2(value);
    return (halves.x | halves.y) == 0;
}
#endif

// The dose that a slice adds at each pixel. Neighbors mostly show the same level.
static inline Real light_of(__global const float *light, Bytes level) {
#ifdef CPU
    if (NONE(level ^ (Bytes)level.s0)) return (Real)light[level.s0];
#endif
    return GATHER(Real, light, level);
}

// The same for PACKS successive packs.
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
