#include "common.h"

#ifdef COMPILE_mask_bytes
__kernel void mask_bytes(__global const uchar *restrict images, __global const uchar *restrict mask,
                    __global uchar *restrict masked, int n_angle, int n_z, int n_byte) {
    const size_t row = (size_t)get_global_id(2) * n_z + get_global_id(1);
    masked[row * n_byte + get_global_id(0)] = images[row * n_byte + get_global_id(0)] & mask[get_global_id(0)];
}
#endif

