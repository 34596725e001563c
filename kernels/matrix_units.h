// Matrix units and copies into local memory of NVIDIA's GPUs, by inline PTX. A warp adds to TALL · 16 rows of WIDE · 8
// slices what STEPS · 8 columns of a matrix make of as many rows of light. The units take eleven bits of a number. Split in
// two, numbers keep twenty-two, by three products in place of one; sums are then taken outside the units, which round toward
// zero.
#define TALL 2
#define WIDE 4
#define STEPS 2
#define DEEP (8 * STEPS)
#define WARP_ITEM ((int)get_local_id(0) % 32)
// Where the sums of an item lie: rows of m, and eight below; two slices of n that follow each other.
#define ROW_OF(m) (16 * (m) + WARP_ITEM / 4)
#define SLICE_OF(n) (8 * (n) + WARP_ITEM % 4 * 2)

// Copies sixteen bytes, or as many zeros, into local memory while the item goes on.
static inline void bring(__local float4 *to, __global const float4 *from, int there) {
    __asm__ volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;"
                     :: "r"((uint)(size_t)to), "l"(from), "r"(there ? 16 : 0) : "memory");
}
#define CLOSE_ROUND __asm__ volatile("cp.async.commit_group;" ::: "memory")
#define WAIT_FOR_ALL_BUT(rounds) __asm__ volatile("cp.async.wait_group %0;" :: "n"(rounds) : "memory")

// The eleven highest bits of a number, rounded, and what they lack; of both the units leave off the bits beyond eleven.
static inline uint high_part(float value) { return as_uint(value) + 0x1000u; }
static inline uint low_part(float value) { return as_uint(value - as_float(high_part(value) & 0xffffe000u)); }

#define PRODUCT "mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
#define OF_ROWS_AND_LIGHT "r"(rows[0]), "r"(rows[1]), "r"(rows[2]), "r"(rows[3]), "r"(light[0]), "r"(light[1])
static inline float4 multiplied(const uint *rows, const uint *light) {
    float4 sums;
    __asm__(PRODUCT "{%10, %10, %10, %10};" : "=f"(sums.x), "=f"(sums.y), "=f"(sums.z), "=f"(sums.w)
            : OF_ROWS_AND_LIGHT, "f"(0.0f));
    return sums;
}
static inline float4 multiplied_more(float4 sums, const uint *rows, const uint *light) {
    __asm__(PRODUCT "{%0, %1, %2, %3};" : "+f"(sums.x), "+f"(sums.y), "+f"(sums.z), "+f"(sums.w) : OF_ROWS_AND_LIGHT);
    return sums;
}

// sums += matrix · light. Entry (row, column) of the matrix lies at row · down + column · on, a row of light `far` from the
// next. The last eight rows of light are read `swapped` slices on, their signs changed where `negated` has one; tf32: of
// eleven bits.
static inline void add_products(float4 sums[TALL][WIDE], __local const float *matrix, int down, int on,
                                __local const float *light, int far, int swapped, uint negated, int tf32) {
    const int high = WARP_ITEM / 4, low = WARP_ITEM % 4;
    UNROLL for (int s = 0; s < STEPS; s++) {
        uint rows[TALL][4], rest[TALL][4];
        UNROLL for (int m = 0; m < TALL; m++) UNROLL for (int i = 0; i < 4; i++) {
            const float entry = matrix[(16 * m + high + i % 2 * 8) * down + (8 * s + low + i / 2 * 4) * on];
            rows[m][i] = high_part(entry);
            rest[m][i] = low_part(entry);
        }
        UNROLL for (int n = 0; n < WIDE; n++) {
            uint near[2], less[2];
            UNROLL for (int i = 0; i < 2; i++) {
                const int at = (8 * s + low + 4 * i) * far + 8 * n + high;
                const float value = s ? as_float(as_uint(light[at + swapped]) ^ negated) : light[at];
                near[i] = high_part(value);
                less[i] = low_part(value);
            }
            UNROLL for (int m = 0; m < TALL; m++) {
                if (tf32)
                    sums[m][n] = multiplied_more(sums[m][n], rows[m], near);
                else
                    sums[m][n] += multiplied_more(multiplied_more(multiplied(rest[m], near), rows[m], less), rows[m], near);
            }
        }
    }
}
