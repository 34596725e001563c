// Sums on matrix units of NVIDIA's GPUs. A warp adds to TALL · 16 rows of WIDE · 8 slices the products of sixteen
// columns of a matrix with sixteen rows of light. The units multiply half-precision numbers ("halves") of eleven bits.
// Split into two halves, numbers keep twenty-two bits, by three products in place of one; sums are computed outside
// the units, which round toward zero. Numbers are scaled by powers of two towards the upper end of halves' range.
#define TALL 4
#define WIDE 4
#define WARP_ITEM ((int)get_local_id(0) % 32)
// Sums of an item: of rows item / 4 of m, and eight below, two successive slices of n.
#define SLICE_OF(n) (8 * (n) + WARP_ITEM % 4 * 2)
// Sixteen bytes of a matrix of entries and of a slab of light, of their high parts; the low parts follow.
#define MATRIX 32
#define LIGHT 64

#include "ptx.h"

static inline float greatest_of(float most, float4 values) {
    return fmax(fmax(fmax(most, fabs(values.x)), fabs(values.y)), fmax(fmax(most, fabs(values.z)), fabs(values.w)));
}

// Factor that brings a number that is not negative to 2¹⁴ or more, below 2¹⁵, and its inverse.
static inline float2 scale_of(uint number) {
    const uint exponent = max(number >> 23, 15u);
    return (float2)(as_float((268 - exponent) << 23), as_float((exponent - 14) << 23));
}

#define INLINE static inline __attribute__((always_inline)) void
// Stores four numbers as halves and, if full precision is required, their remainders `apart` from there.
INLINE lay(__local uint2 *to, int apart, float4 value, int whole) {
    const uint2 high = (uint2)(halves(value.x, value.y), halves(value.z, value.w));
    *to = high;
    if (!whole) return;
    const float2 first = numbers(high.x), second = numbers(high.y);
    to[apart] = (uint2)(halves(value.x - first.x, value.y - first.y), halves(value.z - second.x, value.w - second.y));
}

// Position of four slices of a row of light, which puts rows into different banks, and the row that an item names, of
// its first two pairs of matrices; that of the others is two beside, by exclusive or.
static inline int place_of_light(int row, int four) { return row * 8 + (four / 2 ^ row / 2 % 4) * 2 + four % 2; }
static inline int named_row_of_light(int item) { return item % 16 * 4 + (item / 16 ^ item % 16 / 2 % 4); }

// sums += scale · rows · light; rest and less are the remainders of rows and light.
INLINE add_products(float4 sums[TALL][WIDE], const uint4 *rows, const uint4 *rest, float scale, __local const uint4 *light,
                    int named, int whole) {
    UNROLL for (int two = 0; two < WIDE / 2; two++) {
        __local const uint4 *at = light + (named ^ 2 * two);
        const uint4 near = turned_matrices(at), less = whole ? turned_matrices(at + LIGHT) : (uint4)(0);
        UNROLL for (int n = 0; n < 2; n++) UNROLL for (int m = 0; m < TALL; m++) {
            const uint2 high = n ? near.hi : near.lo, low = n ? less.hi : less.lo;
            const float4 sum = whole
                ? multiplied_more(multiplied_more(multiplied(rest[m], high), rows[m], low), rows[m], high)
                : multiplied(rows[m], high);
            sums[m][2 * two + n] += scale * sum;
        }
    }
}
