// What kernels/ptx.h does, in plain OpenCL, so that kernels for matrix units run, slowly, where there are none: items pass
// on through memory what a warp's instructions share. Of up to GROUPS groups of up to MEMBERS items.
#define GROUPS 64
#define MEMBERS 256
__global uint4 shared_rows[GROUPS * MEMBERS];
__global uint2 shared_light[GROUPS * MEMBERS];

static inline size_t first_of_warp(void) {
    const size_t group = get_group_id(0) + get_num_groups(0) * (get_group_id(1) + get_num_groups(1) * get_group_id(2));
    const size_t item = get_local_id(0) + get_local_size(0) * (get_local_id(1) + get_local_size(1) * get_local_id(2));
    return group * MEMBERS + item / 32 * 32;
}
#define ITEM_OF_WARP (get_local_id(0) % 32)
#define SHARE(rows, light)                                                                                             \
    const size_t first = first_of_warp(), item = ITEM_OF_WARP;                                                         \
    shared_rows[first + item] = rows;                                                                                  \
    shared_light[first + item] = light;                                                                                \
    barrier(CLK_GLOBAL_MEM_FENCE);
#define SHARED barrier(CLK_GLOBAL_MEM_FENCE);

static inline void bring(__local int4 *to, __global const int4 *from, int there) {
    if (there) *to = *from;
    else *to = (int4)(0);
}
#define WAIT_FOR_BROUGHT
static inline float4 fetched(__global const float4 *from) { return *from; }
#define ASKED
static inline void call(__global const float4 *line) {}

static inline uint greatest_of_warp(uint own) {
    SHARE((uint4)(own), (uint2)(0))
    uint found = 0;
    for (int i = 0; i < 32; i++) found = max(found, shared_rows[first + i].x);
    SHARED
    return found;
}

static inline float number(uint both, int second) {
    const ushort own = second ? both >> 16 : both & 0xffff;
    return vload_half(0, (const half *)&own);
}
static inline uint halves(float one, float two) {
    ushort low, high;
    vstore_half_rte(one, 0, (half *)&low);
    vstore_half_rte(two, 0, (half *)&high);
    return low | (uint)high << 16;
}
static inline float2 numbers(uint both) { return (float2)(number(both, 0), number(both, 1)); }

static inline uint word(uint4 row, int i) { return i == 0 ? row.x : i == 1 ? row.y : i == 2 ? row.z : row.w; }
static inline uint4 from_words(const uint *words) { return (uint4)(words[0], words[1], words[2], words[3]); }
static inline uint4 matrices(__local const uint4 *row) {
    SHARE(*row, (uint2)(0))
    uint found[4];
    for (int m = 0; m < 4; m++) found[m] = word(shared_rows[first + 8 * m + item / 4], item % 4);
    SHARED
    return from_words(found);
}
static inline uint4 turned_matrices(__local const uint4 *row) {
    SHARE(*row, (uint2)(0))
    uint found[4];
    for (int m = 0; m < 4; m++) {
        const int shift = item / 4 % 2 * 16;
        const uint upper = word(shared_rows[first + 8 * m + item % 4 * 2], item / 8) >> shift;
        const uint lower = word(shared_rows[first + 8 * m + item % 4 * 2 + 1], item / 8) >> shift;
        found[m] = (upper & 0xffff) | lower << 16;
    }
    SHARED
    return from_words(found);
}

static inline float4 multiplied_more(float4 sums, uint4 rows, uint2 light) {
    SHARE(rows, light)
    float found[4];
    for (int part = 0; part < 4; part++) {
        const int below = part / 2, slice = item % 4 * 2 + part % 2;
        found[part] = 0.0f;
        for (int k = 0; k < 16; k++) {
            const uint entry = word(shared_rows[first + item / 4 * 4 + k % 8 / 2], k / 8 * 2 + below);
            const uint2 lit = shared_light[first + slice * 4 + k % 8 / 2];
            found[part] += number(entry, k % 2) * number(k / 8 ? lit.y : lit.x, k % 2);
        }
    }
    SHARED
    return sums + (float4)(found[0], found[1], found[2], found[3]);
}
static inline float4 multiplied(uint4 rows, uint2 light) { return multiplied_more((float4)(0.0f), rows, light); }
