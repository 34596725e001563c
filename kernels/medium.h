// The co-rotating medium, and rays that march through it.
#include "common.h"

#define BENDS 1
#define ABSORBS 2
#define BLOCKS 4
#define MARGIN 2
#define SOLID 0.397f
#define WHOLE 64.0f
#define DARK 28.0f

// The medium: n_p x n_q x n_s samples, the first MARGIN of them outside the voxels.
typedef struct {
    __global const float4 *samples;
    int n_p, n_q, n_s;
} Medium;

typedef struct {
    float3 position, heading;
    float3 pull;                // half the gradient of the squared index there
    float3 missing;             // rounding error of the position, which would add up over hundreds of steps
    float light;
} Ray;

static inline float4 at_node(const Medium m, int i, int j, int k) {
    return m.samples[((size_t)i * m.n_q + j) * m.n_s + k];
}

// Interpolated gradient and extinction; adds the share of insert to opacity.
static inline float4 mixed(float4 node, float weight, float *opacity) {
    if (node.w < 0.0f) {
        const float insert = floor(-node.w), rest = -node.w - insert;
        *opacity += weight * (insert / WHOLE);
        node.w = rest / (1.0f - rest);
    }
    return weight * node;
}

static inline float4 look_up(const Medium m, float3 position, float *opacity) {
    const float x = clamp(position.x + MARGIN, 0.0f, m.n_p - 1.0f), y = clamp(position.y + MARGIN, 0.0f, m.n_q - 1.0f);
    const int i = min((int)x, m.n_p - 2), j = min((int)y, m.n_q - 2);
    const float a = x - i, b = y - j;
    *opacity = 0.0f;
    if (m.n_s == 1)
        return mixed(at_node(m, i, j, 0), (1 - a) * (1 - b), opacity) +
               mixed(at_node(m, i, j + 1, 0), (1 - a) * b, opacity) +
               mixed(at_node(m, i + 1, j, 0), a * (1 - b), opacity) +
               mixed(at_node(m, i + 1, j + 1, 0), a * b, opacity);
    const float z = clamp(position.z + MARGIN, 0.0f, m.n_s - 1.0f);
    const int k = min((int)z, m.n_s - 2);
    const float c = z - k;
    float4 sum = (float4)(0.0f);
    for (int corner = 0; corner < 8; corner++) {
        const int di = corner >> 2, dj = (corner >> 1) & 1, dk = corner & 1;
        const float weight = (di ? a : 1 - a) * (dj ? b : 1 - b) * (dk ? c : 1 - c);
        sum += mixed(at_node(m, i + di, j + dj, k + dk), weight, opacity);
    }
    return sum;
}

static inline float3 bend(const Medium m, float3 position) {
    float unused;
    return look_up(m, position, &unused).xyz;
}

static inline bool inside(const Medium m, float3 p, float top) {
    return p.x >= -MARGIN && p.y >= -MARGIN && p.z >= -MARGIN && p.x <= m.n_p - MARGIN - 1.0f &&
           p.y <= m.n_q - MARGIN - 1.0f && p.z <= top;
}

static inline void clip(float origin, float heading, float high, float *near, float *far) {
    if (fabs(heading) < 1e-9f) {
        if (origin < -MARGIN || origin > high) *near = 1e9f;
        return;
    }
    const float first = (-MARGIN - origin) / heading, second = (high - origin) / heading;
    *near = fmax(*near, fmin(first, second));
    *far = fmin(*far, fmax(first, second));
}

// Rotates a start from fixed coordinates into the resin's and moves it to the edge of the medium.
static bool enter(const Medium m, const float8 start, float2 direction, float top, Ray *ray) {
    const float c = direction.x, s = direction.y;
    const float x = 0.5f * (m.n_p - 2 * MARGIN - 1) - start.s0 * s - start.s1 * c;
    const float y = 0.5f * (m.n_q - 2 * MARGIN - 1) + start.s0 * c - start.s1 * s;
    ray->heading = (float3)(-start.s3 * s - start.s4 * c, start.s3 * c - start.s4 * s, start.s5);
    float near = 0.0f, far = 1e9f;
    clip(x, ray->heading.x, m.n_p - MARGIN - 1.0f, &near, &far);
    clip(y, ray->heading.y, m.n_q - MARGIN - 1.0f, &near, &far);
    clip(start.s2, ray->heading.z, top, &near, &far);
    ray->position = (float3)(x, y, start.s2) + near * ray->heading;
    ray->pull = bend(m, ray->position);
    ray->missing = (float3)(0.0f);
    ray->light = start.s6;
    return near < far && ray->light > 0.0f;
}

// One step; returns its middle and the light it leaves there, and whether the ray continues.
static bool advance(const Medium m, Ray *ray, float top, float step, int kind, float3 *middle, float *weight) {
    const float3 here = ray->position, heading = ray->heading;
    float3 way = step * heading, turned = heading;
    if (kind & BENDS) {
        const float3 a = step * ray->pull;
        const float3 b = step * bend(m, here + step * (0.5f * heading + 0.125f * a));
        ray->pull = bend(m, here + step * (heading + 0.5f * b));   // serves as the next step's first value
        way = step * (heading + (a + 2.0f * b) / 6.0f);
        turned = heading + (a + 4.0f * b + step * ray->pull) / 6.0f;
    }
    way -= ray->missing;
    const float3 next = here + way, both = heading + turned;
    const float length = 0.5f * step * sqrt(dot(both, both));
    *middle = here + 0.5f * way;
    *weight = ray->light * length;
    if (kind & (ABSORBS | BLOCKS)) {
        float opacity;
        const float extinction = look_up(m, *middle, &opacity).w;
        if (kind & ABSORBS) {
            *weight = -ray->light * expm1(-extinction * length);
            ray->light -= *weight;
        }
        if ((kind & BLOCKS) && opacity > SOLID) {
            *weight = 0.0f;
            return false;
        }
    }
    ray->missing = (next - here) - way;
    ray->position = next;
    ray->heading = turned;
    return inside(m, next, top);
}
