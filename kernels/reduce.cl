#include "partial.h"

#ifdef COMPILE_fold
__kernel void fold(__global const float *restrict parts, int kind, __global float *restrict folded, int n_part,
                   int n_folded) {
    const int k = get_global_id(0);
    float result = kind == 0 ? 0.0f : kind == 1 ? INFINITY : -INFINITY;
    for (int part = k; part < n_part; part += n_folded) {
        const float value = parts[part];
        result = kind == 0 ? result + value : kind == 1 ? fmin(result, value) : fmax(result, value);
    }
    folded[k] = result;
}
#endif
