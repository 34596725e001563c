// What the OpenCL versions of pointwise kernels call.
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

// x to the same power, at least 0, in all lanes.
static inline Vector raised(Vector x, Vector power) {
    const float p = power.s0;
    return p == 0.0f ? (Vector)(1.0f) : p == 1.0f ? x : p == 3.0f ? x * x * x : pow(x, power);
}

// A table's numbers for neighboring slices; the last one repeats beyond them.
static inline Vector slices_of(__global const float *table, int first, int n_z) {
    float found[WIDTH];
    for (int k = 0; k < WIDTH; k++) found[k] = table[min(first + k, n_z - 1)];
    return PASTE(vload, WIDTH)(0, found);
}

// Sum (kind 0), least (1) or greatest (2) of all lanes.
static inline float across_vectors(const Vector *values, int kind) {
    float lane[WIDTH], result = values[0].s0;
    EACH_VECTOR {
        PASTE(vstore, WIDTH)(values[v], 0, lane);
        for (int k = v ? 0 : 1; k < WIDTH; k++)
            result = kind == 0 ? result + lane[k] : kind == 1 ? fmin(result, lane[k]) : fmax(result, lane[k]);
    }
    return result;
}

static inline float disc_distance(int i, int j, int n_i, int n_j) {
    const float a = i - 0.5f * (n_i - 1), b = j - 0.5f * (n_j - 1);
    return a * a + b * b;
}
