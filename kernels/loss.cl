#include "curve.h"

#ifdef COMPILE_dark_loss
FIELD_KERNEL dark_loss(__global float *dose, __global const float *restrict weight, float most,
                       __global float *restrict parts, SIZES, int n_part) {
    OWN_PART;
    SUMS(sum);
    EACH_VECTOR_AT {
        const Vector over = fmax(LOAD(dose + at) - most, ZERO), slope = weight[j] * over;
        STORE(dose + at, slope);
        sum[v] += MASKED(REAL_LANES, 0.5f * slope * over);
    }
    parts[part] = sum_of(sum);
}
#else

// A loss declares PARAMETERS and their NAMES. It takes a vector of doses, target fractions and weights (1 if there are
// none), returns the losses, and overwrites the doses with the derivatives.
#ifdef COMPILE_band_loss
#define PARAMETERS                                                                                                     \
    __global const float *restrict response, float start, float density, float low, float high, float slack_low,       \
        float slack_high, float gain_low, float gain_high, float power, float ridge
#define NAMES response, start, density, low, high, slack_low, slack_high, gain_low, gain_high, power, ridge

static inline Vector loss_of(Vector *dose, Vector f, Vector weight, int n_sample, PARAMETERS) {
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
    const Vector gain = MASKED(wrong, (gain_low + (gain_high - gain_low) * f) * weight);
    *dose = (copysign(gain * power * root, difference) + 2.0f * ridge * value) * slope * density;
    return gain * root * amount + ridge * value * value;
}
#elif defined(COMPILE_ramp_loss)
#define PARAMETERS float outside, float inside, float most
#define NAMES outside, inside, most

static inline Vector loss_of(Vector *dose, Vector f, Vector weight, int n_sample, PARAMETERS) {
    const Vector over = *dose - (outside + (inside - outside) * f);
    const Vector within = fmin(over, ZERO) + fmax(*dose - most, ZERO);
    const Vector error = select(fmax(over, ZERO), within, f >= 0.5f);
    *dose = weight * error;
    return 0.5f * weight * error * error;
}
#else
#define PARAMETERS __global const float *restrict outer, __global const float *restrict inner, float start, float density
#define NAMES outer, inner, start, density

static inline Vector loss_of(Vector *dose, Vector f, Vector weight, int n_sample, PARAMETERS) {
    Vector below, above;
    const Vector void_loss = look_up(*dose, outer, n_sample, start, density, &below);
    const Vector part_loss = look_up(*dose, inner, n_sample, start, density, &above);
    *dose = weight * (below + (above - below) * f) * density;
    return weight * (void_loss + (part_loss - void_loss) * f);
}
#endif

#define KERNEL(NAME)                                                                                                   \
    FIELD_KERNEL NAME(__global float *dose, ARRAY target, ARRAY weight, int weighted, PARAMETERS, int binary,          \
                      float reach, __global float *restrict parts, SIZES, int n_sample, int n_part) {                  \
        evaluate(dose, target, weight, weighted, binary, reach, parts, n_i, n_j, n_z, n_sample, n_part, NAMES);        \
    }

static inline void evaluate(__global float *dose, ARRAY target, ARRAY weight, int weighted, int binary, float reach,
                            __global float *restrict parts, SIZES, int n_sample, int n_part, PARAMETERS) {
    OWN_PART;
    SUMS(sum);
    EACH_VECTOR_AT {
        if (disc_distance(i, j, n_i, n_j) > reach * reach) {
            STORE(dose + at, ZERO);
            continue;
        }
        const Vector fraction = LOAD(target + at);
        const Vector f = binary ? select(ZERO, (Vector)(1.0f), fraction >= 0.5f) : fraction;
        Vector value = LOAD(dose + at);
        const Vector loss = loss_of(&value, f, weighted ? LOAD(weight + at) : (Vector)(1.0f), n_sample, NAMES);
        STORE(dose + at, value);
        sum[v] += MASKED(REAL_LANES, loss);
    }
    parts[part] = sum_of(sum);
}

#ifdef COMPILE_band_loss
KERNEL(band_loss)
#elif defined(COMPILE_ramp_loss)
FIELD_KERNEL ramp_loss(__global float *dose, ARRAY target, ARRAY weight, int weighted, PARAMETERS, float reach,
                       __global float *restrict parts, SIZES, int n_part) {
    evaluate(dose, target, weight, weighted, 0, reach, parts, n_i, n_j, n_z, 0, n_part, NAMES);
}
#else
KERNEL(sampled_loss)
#endif
#endif
