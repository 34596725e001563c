// Light of one pixel in a voxel: three boxes convolved with a Gaussian, in closed form (see footprint.py).
#ifdef DIVIDE
#elif defined(__NV_CL_C_VERSION)    // right to two units in the last place there, but not everywhere
#define DIVIDE native_divide
#else
#define DIVIDE(a, b) ((a) / (b))
#endif
#define TAIL 2.75f
#define FAR 4.0f
#define FADE 0.25f
#define SHARP 1e-3f
#define THINNEST 0.05f
#define BLURRED 0.2f

// Third integral of a Gaussian about 0; with sigma 0, of a point.
static inline Real third_integral(Real x, float sigma, float inverse_sigma) {
    const Real above = fmax(x, (Real)(0.0f));
    if (sigma == 0.0f) return 0.5f * above * above;
    const Real t = fabs(x) * inverse_sigma;
    Real series = fma(t, (Real)(7.122526186e-05f), (Real)(2.423642034e-04f));
    series = fma(t, series, (Real)(3.491863407e-03f));
    series = fma(t, series, (Real)(2.202380776e-02f));
    series = fma(t, series, (Real)(9.973836443e-02f));
    series = fma(t, series, (Real)(1.0f));
    series *= series;
    series *= series;
    series *= series;
    series *= series;
    const float square = sigma * sigma;
    const Real tail = DIVIDE(0.25f * square, series);
    return x > 0.0f ? 0.5f * fma(x, x, (Real)(square)) - tail : tail;
}

// A voxel as seen by the columns: half sum and half difference of its two boxes, the divisor of entries, its reach.
// Boxes of a square voxel are a and b wide; c is that of its motion while it is lit. The widest of the three is kept.
typedef struct {
    Real outer, inner, gain, reach;
} Foot;

static inline Foot foot_of(Real a, Real b, Real c, Real strength, float fill, float sigma) {
    const Real narrow = fmin(a, b), side = fmax(a, b), next = fmin(side, c);
    const Real merged = c > 0.0f ? sqrt(fma(narrow, narrow, next * next)) : narrow;
    const Real least = (Real)(THINNEST + BLURRED * sigma);
    const Real thin = fmax(fmin(fmax(side, c), merged), least);
    const Real wide = sqrt(fmax(c * c + (a * a + b * b) - thin * thin, least * least));
    Foot foot;
    foot.outer = 0.5f * (wide + thin);
    foot.inner = 0.5f * (wide - thin);
    foot.gain = strength / (wide * thin * fill);
    foot.reach = fmax(foot.outer + (0.5f * fill + TAIL * sigma), (Real)(FAR * sigma));
    return foot;
}

// Columns by which a voxel moves while it is lit, from the gradient of the column across and along the light.
static inline float swept(float2 gradient, float3 direction, float x, float y) {
    const float across = fma(y, direction.x, -x * direction.y), along = fma(-x, direction.x, -y * direction.y);
    return fabs(gradient.x * along - gradient.y * across) * direction.z;
}

// Integral of the voxel's blurred trapezoid from -infinity to x, times the areas of its boxes.
static inline Real edge(const Foot *foot, Real x, float sigma, float inverse_sigma) {
    return (third_integral(x + foot->outer, sigma, inverse_sigma) + third_integral(x - foot->outer, sigma, inverse_sigma))
         - (third_integral(x + foot->inner, sigma, inverse_sigma) + third_integral(x - foot->inner, sigma, inverse_sigma));
}

// Weight of a share: 1 except near the end of its reach.
static inline Real faded(const Foot *foot, Real distance, float sigma) {
    return clamp((foot->reach - fabs(distance)) * (1.0f / (FADE * sigma + SHARP)), (Real)(0.0f), (Real)(1.0f));
}

// Column of the light, its strength, and the gradient of the column across and along the light, at a voxel.
static inline float4 look_up(__global const float4 *restrict light, int n_across, int n_along, float2 direction,
                             float x, float y) {
    const float across = fma(y, direction.x, -x * direction.y) + 0.5f * (n_across - 1);
    const float along = fma(-x, direction.x, -y * direction.y) + 0.5f * (n_along - 1);
    return sampled(light, n_across, n_along, across, along);
}
