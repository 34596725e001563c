// Samples of a curve at vectors of doses.
#include "partial.h"

// Samples at a vector of doses, and their increase from one to the next; a straight line needs no table.
static inline Vector look_up(Vector dose, __global const float *restrict samples, int n_sample, float start,
                             float density, Vector *slope) {
    const Vector position = (dose - start) * density;
    if (n_sample == 2) {
        *slope = samples[1] - samples[0];
        return samples[0] + (samples[1] - samples[0]) * position;
    }
    float at[WIDTH], first[WIDTH], rise[WIDTH];
    PASTE(vstore, WIDTH)(position, 0, at);
    for (int k = 0; k < WIDTH; k++) {
        const int cell = clamp((int)floor(fmin(at[k], 1e9f)), 0, n_sample - 2);
        rise[k] = samples[cell + 1] - samples[cell];
        first[k] = samples[cell] - rise[k] * cell;
    }
    *slope = PASTE(vload, WIDTH)(0, rise);
    return PASTE(vload, WIDTH)(0, first) + *slope * position;
}
