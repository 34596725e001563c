#include "common.h"

#define START_R 0.7548776662466927f
#define START_Z 0.5698402909980532f

// Placement of frames on the beam: whole pixels, fractions of one, and flips.
typedef struct {
    int shift_r, shift_z;
    float part_r, part_z;
    int flip_r, flip_z;
} Placement;

#define PLACEMENT (Placement){shift_r, shift_z, part_r, part_z, flip_r, flip_z}

static inline int row_of(const Placement p, int z, int n_z) { return p.flip_z ? z : n_z - 1 - z; }
static inline int column_of(const Placement p, int r, int n_r) { return p.flip_r ? n_r - 1 - r : r; }

// Brightness of the full-on mirror at (row, column); a table with one value means that all are equal.
static inline float brightness(__global const float *flat, int row, int column, int n_flat_row, int n_flat_column) {
    return flat[n_flat_row > 1 || n_flat_column > 1 ? row * n_flat_column + column : 0];
}

#if defined(COMPILE_count_light) || defined(COMPILE_quantize)
static inline float sample(__global const float *sinogram, int angle, int r, int z, int n_angle, int n_r, int n_z) {
    if (r < 0 || r >= n_r || z < 0 || z >= n_z) return 0.0f;
    return sinogram[slice_offset(angle, r, z, n_angle, n_r, LANES)];
}

// The light for frame pixel (r, z).
static inline float wanted(__global const float *sinogram, const Placement p, int angle, int r, int z,
                           int n_angle, int n_r, int n_z) {
    const int near_r = r - p.shift_r, near_z = z - p.shift_z;
    float light = (1.0f - p.part_r) * (1.0f - p.part_z) * sample(sinogram, angle, near_r, near_z, n_angle, n_r, n_z);
    if (p.part_r > 0.0f)
        light += p.part_r * (1.0f - p.part_z) * sample(sinogram, angle, near_r - 1, near_z, n_angle, n_r, n_z);
    if (p.part_z > 0.0f)
        light += (1.0f - p.part_r) * p.part_z * sample(sinogram, angle, near_r, near_z - 1, n_angle, n_r, n_z);
    if (p.part_r > 0.0f && p.part_z > 0.0f)
        light += p.part_r * p.part_z * sample(sinogram, angle, near_r - 1, near_z - 1, n_angle, n_r, n_z);
    return light;
}
#endif

#ifdef COMPILE_count_light
#ifdef CPU
#define ADD(counter, amount) (*(counter) += (amount))
#else
#define ADD(counter, amount) atomic_add(counter, amount)
#endif

// A group first counts for itself: on a CPU it is one item, on a GPU its items meet at the barriers.
FIELD_KERNEL count_light(__global const float *restrict sinogram, __global const float *restrict flat,
                         int shift_r, int shift_z, float part_r, float part_z, int flip_r, int flip_z,
                         int drop, int prefix, __global int *restrict counts,
                         int n_angle, int n_r, int n_z, int n_flat_row, int n_flat_column) {
    __local int own[1024];
    const int member = get_local_id(1) * get_local_size(0) + get_local_id(0);
    const int members = get_local_size(0) * get_local_size(1);
    for (int b = member; b < 1024; b += members) own[b] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    const Placement p = PLACEMENT;
    const int angle_begin = TILE_MAJOR ? ITEM_MAJOR * TILE_MAJOR : 0, z_end = min(ITEM_Z + ITEM_LANES, n_z);
    const int angle_end = TILE_MAJOR ? min(angle_begin + TILE_MAJOR, n_angle) : ITEM_MAJOR ? 0 : n_angle;
    for (int angle = angle_begin; angle < angle_end; angle++)
        EACH_MINOR(r, n_r)
            for (int z = ITEM_Z; z < z_end; z++) {
                const float light = wanted(sinogram, p, angle, r, z, n_angle, n_r, n_z);
                if (light <= 0.0f) continue;
                const float full = brightness(flat, row_of(p, z, n_z), column_of(p, r, n_r), n_flat_row, n_flat_column);
                const uint bits = as_uint(light / full) & 0x7fffffffu;
                if (bits >> (drop + 10) == (uint)prefix) ADD(own + ((bits >> drop) & 1023u), 1);
            }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int b = member; b < 1024; b += members) if (own[b]) atomic_add(counts + b, own[b]);
}
#endif

#ifdef COMPILE_quantize
#define EACH_LANE for (int k = 0; k < ITEM_LANES; k++)

// An item owns its pixels at every angle; errors can then be carried from one angle to the next.
FIELD_KERNEL quantize(__global const float *restrict sinogram, __global const float *restrict flat,
                      __global const float *restrict curve, __global const float *restrict bounds, float gain,
                      int shift_r, int shift_z, float part_r, float part_z, int flip_r, int flip_z,
                      float carry, __global uchar *restrict images,
                      int n_angle, int n_r, int n_z, int n_flat_row, int n_flat_column, int n_level) {
    const Placement p = PLACEMENT;
    const int r_begin = ITEM_MINOR * TILE_MINOR, r_end = min(r_begin + TILE_MINOR, n_r);
    const int z_begin = ITEM_Z;
    if (ITEM_MAJOR) return;
    const float black = curve[0], white = curve[n_level - 1];
    float error[TILE_MINOR][ITEM_LANES];
    for (int r = r_begin; r < r_end; r++) EACH_LANE {
        const float start = row_of(p, z_begin + k, n_z) * START_Z + column_of(p, r, n_r) * START_R;
        error[r - r_begin][k] = carry * (start - floor(start) - 0.5f);
    }
    for (int angle = 0; angle < n_angle; angle++)
        for (int r = r_begin; r < r_end; r++) {
            const int column = column_of(p, r, n_r), lanes = min(ITEM_LANES, n_z - z_begin);
            float aim[ITEM_LANES];
            int level[ITEM_LANES];
            EACH_LANE {
                const int z = min(z_begin + k, n_z - 1);
                const float full = brightness(flat, row_of(p, z, n_z), column, n_flat_row, n_flat_column);
                const float light = wanted(sinogram, p, angle, r, z, n_angle, n_r, n_z) * gain / full;
                aim[k] = clamp(light, black, white) + error[r - r_begin][k];
                level[k] = 0;
            }
            for (int step = 128; step; step >>= 1)
                EACH_LANE level[k] += aim[k] > bounds[level[k] + step - 1] ? step : 0;
            for (int k = 0; k < lanes; k++)
                images[((size_t)angle * n_z + row_of(p, z_begin + k, n_z)) * n_r + column] = (uchar)level[k];
            if (carry > 0.0f) EACH_LANE error[r - r_begin][k] = aim[k] - curve[level[k]];
        }
}
#endif

#ifdef COMPILE_fold_bits
__kernel void fold_bits(__global const uchar *restrict images, __global uchar *restrict folded,
                   int n_angle, int n_z, int n_r, int n_byte) {
    const int byte = get_global_id(0);
    const size_t frame_row = (size_t)get_global_id(2) * n_z + get_global_id(1);
    uchar bits = 0;
    for (int column = 8 * byte; column < min(8 * byte + 8, n_r); column++)
        bits |= (images[frame_row * n_r + column] & 1) << (7 - column % 8);
    folded[frame_row * n_byte + byte] = bits;
}
#endif

#ifdef COMPILE_unpack
static inline float shown(__global const uchar *images, __global const float *flat, __global const float *curve,
                          int bits, const Placement p, int angle, int r, int z, int n_z, int n_byte,
                          int n_flat_row, int n_flat_column, int n_r) {
    if (r < 0 || r >= n_r || z < 0 || z >= n_z) return 0.0f;
    const int row = row_of(p, z, n_z), column = column_of(p, r, n_r);
    __global const uchar *line = images + ((size_t)angle * n_z + row) * n_byte;
    const int level = bits == 8 ? line[column] : line[column >> 3] >> (7 - (column & 7)) & 1;
    return curve[level] * brightness(flat, row, column, n_flat_row, n_flat_column);
}

FIELD_KERNEL unpack(__global const uchar *restrict images, __global const float *restrict flat,
                    __global const float *restrict curve, int bits, float scale,
                    int shift_r, int shift_z, float part_r, float part_z, int flip_r, int flip_z,
                    __global float *restrict light,
                    int n_angle, int n_z, int n_byte, int n_flat_row, int n_flat_column, int n_level, int n_r) {
    const Placement p = PLACEMENT;
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    light += slab_offset(n_angle, n_r);
#define SHOWN(r, z) shown(images, flat, curve, bits, p, angle, r, z, n_z, n_byte, n_flat_row, n_flat_column, n_r)
    EACH_MINOR(r, n_r)
        for (int k = 0; k < ITEM_LANES; k++) {
            const int near_r = r + shift_r, near_z = ITEM_Z + k + shift_z;
            float sum = (1.0f - part_r) * (1.0f - part_z) * SHOWN(near_r, near_z);
            if (part_r > 0.0f) sum += part_r * (1.0f - part_z) * SHOWN(near_r + 1, near_z);
            if (part_z > 0.0f) sum += (1.0f - part_r) * part_z * SHOWN(near_r, near_z + 1);
            if (part_r > 0.0f && part_z > 0.0f) sum += part_r * part_z * SHOWN(near_r + 1, near_z + 1);
            light[SAMPLE(angle, r, n_r) + k] = scale * sum;
        }
}
#endif
