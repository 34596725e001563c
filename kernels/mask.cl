#include "common.h"

#ifdef COMPILE_mask_bytes
__kernel void mask_bytes(__global const uchar *restrict images, __global const uchar *restrict mask,
                    __global uchar *restrict masked, int n_angle, int n_z, int n_byte) {
    const size_t row = (size_t)get_global_id(2) * n_z + get_global_id(1);
    masked[row * n_byte + get_global_id(0)] = images[row * n_byte + get_global_id(0)] & mask[get_global_id(0)];
}
#endif

#ifdef COMPILE_mask_rays
FIELD_KERNEL mask_rays(__global const float *light, __global const float *restrict shares, __global float *masked,
                       int n_angle, int n_r, int n_z) {
    const int angle = ITEM_MAJOR;
    if (angle >= n_angle) return;
    const size_t slab = slab_offset(n_angle, n_r);
    EACH_MINOR(r, n_r) {
        const size_t at = slab + SAMPLE(angle, r, n_r);
        EACH_VECTOR STORE(masked + at, shares[r] * LOAD(light + at));
    }
}
#endif
