#include "partial.h"

#ifdef COMPILE_step_pixels
typedef PASTE(uint, WIDTH) Places;

FIELD_KERNEL step_pixels(ARRAY brighter, ARRAY darker, float worth, int seed, int first, float step,
                         float most, __global float *restrict light, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector up = LOAD(brighter + at), down = LOAD(darker + at), shown = LOAD(light + at);
        const Places z = PASTE(convert_uint, WIDTH)(first + ITEM_Z + v * WIDTH + LANE_IDS);
        const Places place = (uint)i * 3518319155u + (uint)j * 2882110345u + z * 2360945575u + (uint)seed * 2654435769u;
        const Vector share = PASTE(convert_float, WIDTH)(place >> 8u) * 0x1p-24f;
        const Vector stepped = clamp(shown + select((Vector)(-step), (Vector)(step), up <= down), 0.0f, most);
        STORE(light + at, select(shown, stepped, share * worth < -fmin(up, down)));
    }
}
#endif
