#ifdef COMPILE_split_planes
#define LOW_BYTES 0x00FF00FF00FF00FFul

// 64 columns from one on, one byte each, cut by the mask; 0 outside the frame.
static inline ulong8 levels(__global const uchar *line, __global const uchar *mask, int column, int n_byte) {
    if (column <= -64 || column >= n_byte) return 0;
    if (column >= 0 && column + 64 <= n_byte) {
#ifdef CPU
        typedef ulong8 __attribute__((aligned(1))) Anywhere;
        return *(__global const Anywhere *)(line + column) & *(__global const Anywhere *)(mask + column);
#else
        __global const ulong2 *a = (__global const ulong2 *)(line + column), *b = (__global const ulong2 *)(mask + column);
        if ((((size_t)a | (size_t)b) & 15) == 0)
            return (ulong8)(a[0] & b[0], a[1] & b[1], a[2] & b[2], a[3] & b[3]);
#endif
    }
    ulong own[8];
    for (int k = 0; k < 8; k++) {
        own[k] = 0;
        for (int j = 0; j < 8; j++) {
            const int at = column + 8 * k + j;
            if (at >= 0 && at < n_byte) own[k] |= (ulong)(line[at] & mask[at]) << (8 * j);
        }
    }
    return (ulong8)(own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7]);
}

// Transposes every long as 8 x 8 bits: byte 0, the leftmost column, becomes the highest bits, and the highest bits
// become byte 0.
static inline ulong8 turn_bits(ulong8 x) {
    ulong8 t = (x ^ (x << 36)) & 0xF0F0F0F000000000ul;
    x ^= t ^ (t >> 36);
    t = (x ^ (x << 18)) & 0xCCCC0000CCCC0000ul;
    x ^= t ^ (t >> 18);
    t = (x ^ (x << 9)) & 0xAA00AA00AA00AA00ul;
    return x ^ t ^ (t >> 9);
}

// Transposes 8 x 8 bytes: byte p of long q and byte q of long p are exchanged.
static inline ulong8 turn_bytes(ulong8 x) {
    const ulong8 own1 = (ulong8)((ulong2)(LOW_BYTES, ~LOW_BYTES), (ulong2)(LOW_BYTES, ~LOW_BYTES),
                                 (ulong2)(LOW_BYTES, ~LOW_BYTES), (ulong2)(LOW_BYTES, ~LOW_BYTES));
    const ulong low2 = 0x0000FFFF0000FFFFul, low4 = 0x00000000FFFFFFFFul;
    const ulong8 own2 = (ulong8)(low2, low2, ~low2, ~low2, low2, low2, ~low2, ~low2);
    const ulong8 own4 = (ulong8)((ulong4)(low4), (ulong4)(~low4));
    x = bitselect(rotate(x.s10325476, (ulong8)(8, 56, 8, 56, 8, 56, 8, 56)), x, own1);
    x = bitselect(rotate(x.s23016745, (ulong8)(16, 16, 48, 48, 16, 16, 48, 48)), x, own2);
    return bitselect(rotate(x.s45670123, (ulong8)(32)), x, own4);
}

static inline int sum_of(ulong8 x) {
    const ushort16 low = as_ushort16(x.lo), high = as_ushort16(x.hi);
    const uint16 both = convert_uint16(low) + convert_uint16(high);
    const uint8 eight = both.lo + both.hi;
    const uint4 four = eight.lo + eight.hi;
    return (int)(four.s0 + four.s1 + four.s2 + four.s3);
}

// Whole cache lines that are written past the cache need not be read before.
#if defined(CPU) && defined(__has_builtin)
#if __has_builtin(__builtin_nontemporal_store)
#define PUT(place, value) __builtin_nontemporal_store(value, (__global ulong8 *)(place))
#endif
#endif
#ifndef PUT
#define PUT(place, value) *(__global ulong8 *)(place) = (value)
#endif

#define EACH(F) F(0) F(1) F(2) F(3) F(4) F(5) F(6) F(7)
#define MIX1(a, b) { const ulong8 u = (ulong8)(a.s0, b.s0, a.s2, b.s2, a.s4, b.s4, a.s6, b.s6); \
                     b = (ulong8)(a.s1, b.s1, a.s3, b.s3, a.s5, b.s5, a.s7, b.s7); a = u; }
#define MIX2(a, b) { const ulong8 u = (ulong8)(a.s01, b.s01, a.s45, b.s45); \
                     b = (ulong8)(a.s23, b.s23, a.s67, b.s67); a = u; }
#define MIX4(a, b) { const ulong8 u = (ulong8)(a.lo, b.lo); b = (ulong8)(a.hi, b.hi); a = u; }

// Strips are runs of blocks of 64 columns, which processors take by eight to write whole cache lines; or columns of
// blocks, with which neighbors on a GPU read and write side by side.
__kernel __attribute__((vec_type_hint(ulong8))) void split_planes(
    __global const uchar *restrict images, __global const uchar *restrict masks, __global const int *restrict chosen,
    int top, int left, __global uchar *restrict packed, __global int *restrict sent,
    int n_angle, int n_line, int n_byte, int n_bin, int n_frame, int n_row, int n_width, int n_strip) {
    const int strip = get_global_id(0), frame = get_global_id(1);
    if (strip >= n_strip || frame >= n_frame) return;
    const int across = n_width / 8, blocks = n_row * across;
    const int columns = n_strip > n_row && n_strip % across == 0, step = columns ? across : 1;
    const int bands = n_strip / across, run = columns ? (n_row + bands - 1) / bands * across
                                                      : (blocks + 8 * n_strip - 1) / (8 * n_strip) * 8;
    const int place = columns ? strip / across : strip;
    const int end = min((place + 1) * run, blocks);
    int b = min(place * run + (columns ? strip % across : 0), blocks);
    __global const uchar *image = images + (size_t)chosen[2 * frame] * n_line * n_byte;
    __global const uchar *mask = masks + (size_t)chosen[2 * frame + 1] * n_byte;
    const size_t plane = (size_t)n_row * n_width;
    __global uchar *out = packed + 8 * plane * frame;
    int row = b / across, block = b % across, sum = 0, many = 0;
    ulong8 few = 0;
#define TAKE(x) \
        ulong8 x = row >= top && row < top + n_line \
            ? levels(image + (size_t)(row - top) * n_byte, mask, 64 * block - left, n_byte) : (ulong8)(0); \
        few += (x & LOW_BYTES) + (x >> 8 & LOW_BYTES); \
        x = turn_bytes(turn_bits(x));
#define FLUSH(count) if ((many += count) > 120) { sum += sum_of(few); few = 0; many = 0; }  // before 16 bits overflow
#ifdef CPU
    if (!columns && (((size_t)out | plane) & 63) == 0)
        for (; b + 8 <= end; b += 8) {
#define NEXT(k) TAKE(x##k) if (++block == across) { block = 0; row++; }
            EACH(NEXT)
            MIX1(x0, x1) MIX1(x2, x3) MIX1(x4, x5) MIX1(x6, x7)
            MIX2(x0, x2) MIX2(x1, x3) MIX2(x4, x6) MIX2(x5, x7)
            MIX4(x0, x4) MIX4(x1, x5) MIX4(x2, x6) MIX4(x3, x7)
#define PLANE(p) PUT(out + p * plane + 8 * (size_t)b, x##p);
            EACH(PLANE)
#undef PLANE
            FLUSH(8)
        }
#endif
    for (; b < end; b += step) {
        TAKE(x)
#define PLANE(p) *(__global ulong *)(out + p * plane + 8 * (size_t)b) = x.s##p;
        EACH(PLANE)
        FLUSH(1)
        if ((block += step) >= across) {
            block -= across;
            row++;
        }
    }
    sent[(size_t)frame * n_strip + strip] = sum + sum_of(few);
}
#endif

#ifdef COMPILE_pick_frames
__kernel void pick_frames(__global const uchar *restrict images, __global const uchar *restrict masks,
                            __global const int *restrict chosen, int top, int left, __global uchar *restrict picked,
                            int n_angle, int n_line, int n_byte, int n_bin, int n_frame, int n_row, int n_width) {
    const int tile = TILE_MINOR ? TILE_MINOR : n_width, first = tile * get_global_id(0), last = min(first + tile, n_width);
    const int row = get_global_id(1), frame = get_global_id(2), y = row - top;
    if (row >= n_row || frame >= n_frame) return;
    __global const uchar *restrict line = images + ((size_t)chosen[2 * frame] * n_line + y) * n_byte - left;
    __global const uchar *restrict mask = masks + (size_t)chosen[2 * frame + 1] * n_byte - left;
    __global uchar *restrict out = picked + ((size_t)frame * n_row + row) * n_width;
    const int begin = y >= 0 && y < n_line ? max(first, left) : last, end = max(begin, min(last, left + n_byte));
    for (int k = first; k < min(begin, last); k++) out[k] = 0;
    for (int k = begin; k < end; k++) out[k] = line[k] & mask[k];
    for (int k = end; k < last; k++) out[k] = 0;
}
#endif
