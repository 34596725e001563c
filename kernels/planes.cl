#ifdef COMPILE_split_planes
// Sixteen columns as two longs of eight, each with its leftmost column in the highest byte's place of a row of bits.
static inline uchar16 turned(uchar16 v) { return v.s76543210fedcba98; }

static inline uchar16 part(__global const uchar *line, __global const uchar *mask, int column, int n_byte) {
    if (column >= 0 && column + 16 <= n_byte) return turned(vload16(0, line + column) & vload16(0, mask + column));
    uchar own[16];
    for (int k = 0; k < 16; k++) own[k] = column + k >= 0 && column + k < n_byte ? line[column + k] & mask[column + k] : 0;
    return turned(vload16(0, own));
}

// The 8 x 8 bits of every long turned about their diagonal.
static inline ulong8 turn_bits(ulong8 x) {
    ulong8 t = (x ^ (x >> 7)) & 0x00AA00AA00AA00AAul;
    x ^= t ^ (t << 7);
    t = (x ^ (x >> 14)) & 0x0000CCCC0000CCCCul;
    x ^= t ^ (t << 14);
    t = (x ^ (x >> 28)) & 0x00000000F0F0F0F0ul;
    return x ^ t ^ (t << 28);
}

// The bytes of eight longs sorted by their place in the long: byte p of each, then byte p + 1 of each.
static inline ulong8 sort_bytes(ulong8 x) {
    const ushort8 a = as_ushort8(as_uchar16(x.s01).s08192a3b4c5d6e7f), b = as_ushort8(as_uchar16(x.s23).s08192a3b4c5d6e7f);
    const ushort8 c = as_ushort8(as_uchar16(x.s45).s08192a3b4c5d6e7f), d = as_ushort8(as_uchar16(x.s67).s08192a3b4c5d6e7f);
    const uint4 ab_low = as_uint4((ushort8)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3));
    const uint4 cd_low = as_uint4((ushort8)(c.s0, d.s0, c.s1, d.s1, c.s2, d.s2, c.s3, d.s3));
    const uint4 ab_high = as_uint4((ushort8)(a.s4, b.s4, a.s5, b.s5, a.s6, b.s6, a.s7, b.s7));
    const uint4 cd_high = as_uint4((ushort8)(c.s4, d.s4, c.s5, d.s5, c.s6, d.s6, c.s7, d.s7));
    return (ulong8)(as_ulong2((uint4)(ab_low.s0, cd_low.s0, ab_low.s1, cd_low.s1)),
                    as_ulong2((uint4)(ab_low.s2, cd_low.s2, ab_low.s3, cd_low.s3)),
                    as_ulong2((uint4)(ab_high.s0, cd_high.s0, ab_high.s1, cd_high.s1)),
                    as_ulong2((uint4)(ab_high.s2, cd_high.s2, ab_high.s3, cd_high.s3)));
}

static inline int sum_of(ulong8 x) {
    const ushort16 low = as_ushort16(x.lo), high = as_ushort16(x.hi);
    const uint16 both = convert_uint16(low) + convert_uint16(high);
    const uint8 eight = both.lo + both.hi;
    const uint4 four = eight.lo + eight.hi;
    return (int)(four.s0 + four.s1 + four.s2 + four.s3);
}

// An item takes 64 columns at a time and writes eight bytes of every plane.
__kernel __attribute__((vec_type_hint(ulong8))) void split_planes(
    __global const uchar *restrict images, __global const uchar *restrict masks, __global const int *restrict chosen,
    int top, int left, __global uchar *restrict packed, __global int *restrict sent,
    int n_angle, int n_line, int n_byte, int n_bin, int n_picture, int n_row, int n_width, int n_strip) {
    const int strip = get_global_id(0), picture = get_global_id(1);
    if (strip >= n_strip || picture >= n_picture) return;
    const int across = n_width / 8, blocks = n_row * across, run = (blocks + n_strip - 1) / n_strip;
    const int begin = min(strip * run, blocks), end = min(begin + run, blocks);
    __global const uchar *image = images + (size_t)chosen[2 * picture] * n_line * n_byte;
    __global const uchar *mask = masks + (size_t)chosen[2 * picture + 1] * n_byte;
    const size_t plane = (size_t)n_row * n_width;
    __global uchar *out = packed + 8 * plane * picture;
    int row = begin / across, block = begin % across, sum = 0;
    ulong8 few = 0;
    for (int b = begin; b < end; b++) {
        const int y = row - top, column = 64 * block - left;
        ulong8 x = 0;
        if (y >= 0 && y < n_line && column < n_byte && column > -64) {
            __global const uchar *line = image + (size_t)y * n_byte;
            x.s01 = as_ulong2(part(line, mask, column, n_byte));
            x.s23 = as_ulong2(part(line, mask, column + 16, n_byte));
            x.s45 = as_ulong2(part(line, mask, column + 32, n_byte));
            x.s67 = as_ulong2(part(line, mask, column + 48, n_byte));
            few += (x & 0x00FF00FF00FF00FFul) + (x >> 8 & 0x00FF00FF00FF00FFul);
            x = sort_bytes(turn_bits(x));
        }
        __global uchar *place = out + (size_t)row * n_width + 8 * block;
#define PLANE(p) *(__global ulong *)(place + (7 - p) * plane) = x.s##p
        PLANE(0); PLANE(1); PLANE(2); PLANE(3); PLANE(4); PLANE(5); PLANE(6); PLANE(7);
        block++;
        if (block == across || block % 128 == 0 || b + 1 == end) {  // before 16 bits overflow
            sum += sum_of(few);
            few = 0;
        }
        if (block == across) {
            block = 0;
            row++;
        }
    }
    sent[(size_t)picture * n_strip + strip] = sum;
}
#endif

#ifdef COMPILE_pick_pictures
__kernel void pick_pictures(__global const uchar *restrict images, __global const uchar *restrict masks,
                            __global const int *restrict chosen, int top, int left, __global uchar *restrict picked,
                            int n_angle, int n_line, int n_byte, int n_bin, int n_picture, int n_row, int n_width) {
    const int byte = get_global_id(0), row = get_global_id(1), picture = get_global_id(2);
    if (byte >= n_width || row >= n_row || picture >= n_picture) return;
    uchar value = 0;
    const int y = row - top, x = byte - left;
    if (y >= 0 && y < n_line && x >= 0 && x < n_byte)
        value = images[((size_t)chosen[2 * picture] * n_line + y) * n_byte + x] &
                masks[(size_t)chosen[2 * picture + 1] * n_byte + x];
    picked[((size_t)picture * n_row + row) * n_width + byte] = value;
}
#endif
