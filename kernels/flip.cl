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
