#include "partial.h"

#ifdef COMPILE_price_flips
static inline Vector off(Vector dose, Lanes part, Lanes void_, float least, float most, float leak) {
    const Vector beyond = select(dose - leak, fmax(least - dose, dose - most), part);
    const Vector found = select(ZERO, fmax(beyond, ZERO), part | void_);
    return found * found;
}

FIELD_KERNEL price_flips(ARRAY dose, ARRAY side, float least, float most, float leak, float step,
                         __global float *restrict brighter, __global float *restrict darker, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector given = LOAD(dose + at), where = LOAD(side + at);
        const Lanes part = where > ZERO, void_ = where < ZERO;
        const Vector now = off(given, part, void_, least, most, leak);
        STORE(brighter + at, (off(given + step, part, void_, least, most, leak) - now) / step);
        STORE(darker + at, (off(given - step, part, void_, least, most, leak) - now) / step);
    }
}
#endif

#ifdef COMPILE_flip_pixels
FIELD_KERNEL flip_pixels(ARRAY brighter, ARRAY darker, ARRAY step, __global float *restrict light,
                         __global float *restrict change, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector shown = LOAD(light + at), by = LOAD(step + at);
        const Vector off = select(ZERO, -by, LOAD(darker + at) < ZERO);
        const Vector on = select(ZERO, by, LOAD(brighter + at) < ZERO);
        const Vector added = select(on, off, shown > ZERO);
        STORE(change + at, added);
        STORE(light + at, shown + added);
    }
}
#endif

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
