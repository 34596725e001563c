// Instructions of NVIDIA's GPUs that OpenCL does not have; those of a warp act on all of its items at once.

// Copies sixteen bytes, or as many zeros, into local memory while the item continues. All items can read them after it
// has waited and a barrier follows.
static inline void bring(__local int4 *to, __global const int4 *from, int there) {
    __asm__ volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;"
                     :: "r"((uint)(size_t)to), "l"(from), "r"(there ? 16 : 0) : "memory");
}
#define WAIT_FOR_BROUGHT __asm__ volatile("cp.async.wait_all;" ::: "memory");

// Requests four numbers, before the instructions that follow ASKED.
static inline float4 fetched(__global const float4 *from) {
    float4 found;
    __asm__ volatile("ld.global.v4.f32 {%0, %1, %2, %3}, [%4];"
                     : "=f"(found.x), "=f"(found.y), "=f"(found.z), "=f"(found.w) : "l"(from) : "memory");
    return found;
}
#define ASKED __asm__ volatile("bar.warp.sync 0xffffffff;" ::: "memory");

// Brings a line of memory into the cache.
static inline void call(__global const float4 *line) { __asm__ volatile("prefetch.global.L2 [%0];" :: "l"(line) : "memory"); }

// The greatest value of the items of a warp.
static inline uint greatest_of_warp(uint own) {
    uint found;
    __asm__ volatile("redux.sync.max.u32 %0, %1, 0xffffffff;" : "=r"(found) : "r"(own));
    return found;
}

// Two numbers as halves, the first one low, and halves as numbers.
static inline uint halves(float first, float second) {
    uint both;
    __asm__("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(second), "f"(first));
    return both;
}
static inline float2 numbers(uint both) {
    float2 found;
    __asm__("{.reg .b16 low, high; mov.b32 {low, high}, %2; cvt.f32.f16 %0, low; cvt.f32.f16 %1, high;}"
            : "=f"(found.x), "=f"(found.y) : "r"(both));
    return found;
}

// Four matrices of eight rows of eight halves; the items of a warp name the rows, eight per matrix. Of each matrix, an
// item gets two neighbors of row item / 4; transposed: of column item / 4.
#define MATRICES(how)                                                                                                  \
    uint4 found;                                                                                                       \
    __asm__ volatile("ldmatrix.sync.aligned.m8n8.x4" how ".shared.b16 {%0, %1, %2, %3}, [%4];"                         \
                     : "=r"(found.x), "=r"(found.y), "=r"(found.z), "=r"(found.w)                                      \
                     : "r"((uint)(size_t)row) : "memory");                                                             \
    return found;
static inline uint4 matrices(__local const uint4 *row) { MATRICES("") }
static inline uint4 turned_matrices(__local const uint4 *row) { MATRICES(".trans") }

#define PRODUCT "mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
#define OF_ROWS_AND_LIGHT "r"(rows.x), "r"(rows.y), "r"(rows.z), "r"(rows.w), "r"(light.x), "r"(light.y)
static inline float4 multiplied(uint4 rows, uint2 light) {
    float4 sums;
    __asm__(PRODUCT "{%10, %10, %10, %10};" : "=f"(sums.x), "=f"(sums.y), "=f"(sums.z), "=f"(sums.w)
            : OF_ROWS_AND_LIGHT, "f"(0.0f));
    return sums;
}
static inline float4 multiplied_more(float4 sums, uint4 rows, uint2 light) {
    __asm__(PRODUCT "{%0, %1, %2, %3};" : "+f"(sums.x), "+f"(sums.y), "+f"(sums.z), "+f"(sums.w) : OF_ROWS_AND_LIGHT);
    return sums;
}
