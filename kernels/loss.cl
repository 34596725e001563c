#include "partial.h"

// Samples at a vector of doses, and their rise from one to the next; a straight line needs no looking up.
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

#ifdef COMPILE_band_loss
// One vector of doses against its bands: returns the losses, and the derivatives through dose.
static inline Vector band(Vector *dose, Vector f, Vector weight, __global const float *restrict response, int n_sample,
                          float start, float density, float low, float high, float slack_low, float slack_high,
                          float power, float ridge) {
    Vector slope;
    const Vector value = look_up(*dose, response, n_sample, start, density, &slope);
    const Vector difference = value - (low + (high - low) * f);
    const Vector excess = fabs(difference) - (slack_low + (slack_high - slack_low) * f);
    const Lanes wrong = excess > ZERO;
    if (ridge == 0.0f && !any(wrong)) {
        *dose = ZERO;
        return ZERO;
    }
    const Vector amount = fmax(excess, 1e-30f);
    const Vector root = power == 2.0f ? amount : power == 1.0f ? (Vector)(1.0f) : pow(amount, (Vector)(power - 1.0f));
    const Vector gain = MASKED(wrong, weight);
    *dose = (copysign(gain * power * root, difference) + 2.0f * ridge * value) * slope * density;
    return gain * root * amount + ridge * value * value;
}

FIELD_KERNEL band_loss(__global float *dose, __global const float *target, __global const float *weight, int weighted,
                       __global const float *restrict response, float start, float density, float low, float high,
                       float slack_low, float slack_high, float gain_low, float gain_high, float power, float ridge, int binary,
                       float reach, __global float *restrict parts, int n_i, int n_j, int n_z, int n_sample,
                       int n_part) {
    const int part = part_index(n_i, n_j, n_z);
    if (part < 0 || part >= n_part) return;
    const size_t slab = slab_offset(n_i, n_j);
    Vector sum[VECTORS];
    EACH_VECTOR sum[v] = ZERO;
    EACH_SAMPLE {
        const size_t at = slab + SAMPLE(i, j, n_j);
        const int outside = disc_distance(i, j, n_i, n_j) > reach * reach;
        EACH_VECTOR {
            if (outside) {
                STORE(dose + at, ZERO);
                continue;
            }
            const Vector fraction = LOAD(target + at);
            const Vector f = binary ? select(ZERO, (Vector)(1.0f), fraction >= 0.5f) : fraction;
            Vector gain = gain_low + (gain_high - gain_low) * f, value = LOAD(dose + at);
            if (weighted) gain *= LOAD(weight + at);
            const Vector loss = band(&value, f, gain, response, n_sample, start, density, low, high, slack_low,
                                     slack_high, power, ridge);
            STORE(dose + at, value);
            sum[v] += MASKED(REAL_LANES, loss);
        }
    }
    float result = 0.0f;
    EACH_VECTOR result += across_lanes(sum[v], 0);
    parts[part] = result;
}
#endif

#ifdef COMPILE_sampled_loss
FIELD_KERNEL sampled_loss(__global float *dose, __global const float *target, __global const float *weight, int weighted,
                          __global const float *restrict outer, __global const float *restrict inner, float start,
                          float density, int binary, float reach, __global float *restrict parts, int n_i, int n_j,
                          int n_z, int n_sample, int n_part) {
    const int index = part_index(n_i, n_j, n_z);
    if (index < 0 || index >= n_part) return;
    const size_t slab = slab_offset(n_i, n_j);
    Vector sum[VECTORS];
    EACH_VECTOR sum[v] = ZERO;
    EACH_SAMPLE {
        const size_t at = slab + SAMPLE(i, j, n_j);
        const int outside = disc_distance(i, j, n_i, n_j) > reach * reach;
        EACH_VECTOR {
            if (outside) {
                STORE(dose + at, ZERO);
                continue;
            }
            const Vector fraction = LOAD(target + at), here = LOAD(dose + at);
            const Vector f = binary ? select(ZERO, (Vector)(1.0f), fraction >= 0.5f) : fraction;
            Vector gain = (Vector)(1.0f), below, above;
            if (weighted) gain = LOAD(weight + at);
            const Vector void_loss = look_up(here, outer, n_sample, start, density, &below);
            const Vector part_loss = look_up(here, inner, n_sample, start, density, &above);
            STORE(dose + at, gain * (below + (above - below) * f) * density);
            sum[v] += MASKED(REAL_LANES, gain * (void_loss + (part_loss - void_loss) * f));
        }
    }
    float result = 0.0f;
    EACH_VECTOR result += across_lanes(sum[v], 0);
    parts[index] = result;
}
#endif
