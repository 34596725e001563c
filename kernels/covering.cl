#include "partial.h"

#define FAINT 1e-9f
#define NEVER 1e30f

#ifdef COMPILE_divide_prices
FIELD_KERNEL divide_prices(ARRAY lower, ARRAY upper, ARRAY target, float inside, float outside,
                           __global float *restrict paid, __global float *restrict cost, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Lanes body = LOAD(target + at) >= 0.5f;
        const Vector price = fmax(ZERO, LOAD(lower + at)), top = fmax(ZERO, LOAD(upper + at));
        STORE(paid + at, select(ZERO, inside * price, body));
        STORE(cost + at, select(outside * price, inside * top, body));
    }
}
#endif

#ifdef COMPILE_light_short_pixels
FIELD_KERNEL light_short_pixels(ARRAY paid, ARRAY cost, ARRAY cover, float scale, __global float *light, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Vector lack = LOAD(paid + at) - LOAD(cost + at), covered = LOAD(cover + at);
        const Lanes reached = covered > ZERO;
        const Vector share = fmax(ZERO, lack) / select((Vector)(1.0f), scale * covered, reached);
        const Vector grown = fmin(fmax(LOAD(light + at) * share * share, FAINT), 1.0f);
        STORE(light + at, select(ZERO, select((Vector)(1.0f), grown, reached), lack > ZERO));
    }
}
#endif

#ifdef COMPILE_level_cover
FIELD_KERNEL level_cover(ARRAY rows, float reach, __global float *cover, SIZES) {
    if (!MINE) return;
    EACH_VECTOR_AT {
        const Lanes circle = (Lanes)(disc_distance(i, j, n_i, n_j) <= reach * reach ? -1 : 0);
        const Vector row = LOAD(rows + at);
        const Lanes near = circle & (row > ZERO);
        STORE(cover + at, select(ZERO, LOAD(cover + at) / select((Vector)(1.0f), row, near), near));
    }
}
#endif

#ifdef COMPILE_cover_scale
FIELD_KERNEL cover_scale(ARRAY paid, ARRAY cost, ARRAY cover, float keep, __global float *restrict highs, SIZES,
                         int n_part) {
    OWN_PART;
    SUMS(high);
    EACH_VECTOR_AT {
        const Vector lack = keep * LOAD(paid + at) - LOAD(cost + at), covered = LOAD(cover + at);
        const Lanes reached = covered > ZERO;
        const Vector scale = select((Vector)(NEVER), lack / select((Vector)(1.0f), covered, reached), reached);
        high[v] = fmax(high[v], MASKED(REAL_LANES & (lack > ZERO), scale));
    }
    float most = 0.0f;
    EACH_VECTOR most = fmax(most, across_lanes(high[v], 2));
    highs[part] = most;
}
#endif
