#include "common.h"

#define BENDS 1
#define ABSORBS 2
#define BLOCKS 4
#define MARGIN 2
#define SOLID 0.397f

// What the resin carries: n_p x n_q x n_s samples, the first MARGIN of them outside the voxels.
typedef struct {
    __global const float4 *samples;
    int n_p, n_q, n_s;
} Medium;

typedef struct {
    float3 position, heading;
    float3 pull;                // half the gradient of the squared index there
    float3 missing;             // what rounding took from the position: hundreds of steps would add it up
    float light;
} Ray;

static inline float4 at_node(const Medium m, int i, int j, int k) {
    return m.samples[((size_t)i * m.n_q + j) * m.n_s + k];
}

// Gradient and extinction between the samples; adds the share of insert to opacity.
static inline float4 mixed(float4 node, float weight, float *opacity) {
    *opacity += node.w < 0.0f ? weight : 0.0f;
    return weight * (float4)(node.xyz, fmax(node.w, 0.0f));
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

// Turns a start of the laboratory into the resin's coordinates and moves it to the edge of the medium.
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

// One step; gives its middle and what it leaves there, and says whether the ray goes on.
static bool advance(const Medium m, Ray *ray, float top, float step, int kind, float3 *middle, float *weight) {
    const float3 here = ray->position, heading = ray->heading;
    float3 way = step * heading, turned = heading;
    if (kind & BENDS) {
        const float3 a = step * ray->pull;
        const float3 b = step * bend(m, here + step * (0.5f * heading + 0.125f * a));
        ray->pull = bend(m, here + step * (heading + 0.5f * b));   // serves as the next step's first
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

#ifdef COMPILE_trace_entries
static inline int write_pair(__global float2 *pairs, int n_capacity, int count, int x, int y, int n_x, int n_y,
                             float weight) {
    if (!(weight > 0.0f) || x < 0 || y < 0 || x >= n_x || y >= n_y) return count;
    if (count < n_capacity) pairs[count] = (float2)(x * n_y + y, weight);
    return count + 1;
}

__kernel void trace_entries(__global const float4 *restrict medium, __global const float8 *restrict starts,
                            __global const float2 *restrict directions, float step, int most, int kind,
                            __global int *restrict counts, __global float2 *restrict entries, int n_p, int n_q,
                            int n_s, int n_ray, int n_angle, int n_capacity) {
    const size_t index = get_global_id(1) * n_ray + get_global_id(0);
    const Medium m = {medium, n_p, n_q, n_s};
    const int n_x = n_p - 2 * MARGIN, n_y = n_q - 2 * MARGIN;
    __global float2 *pairs = entries + index * n_capacity;
    Ray ray;
    bool on = enter(m, starts[get_global_id(0)], directions[get_global_id(1)], 1e6f, &ray);
    int count = 0, x = -9, y = -9;
    float4 held = (float4)(0.0f);               // weights of cells (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1)
    for (int k = 0; k < most && on; k++) {
        float3 middle;
        float weight;
        on = advance(m, &ray, 1e6f, step, kind, &middle, &weight);
        const int i = (int)floor(middle.x), j = (int)floor(middle.y);
        if (i != x || j != y) {                 // write what is left behind, keep what is still near
            float old[4] = {held.x, held.y, held.z, held.w}, kept[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            for (int corner = 0; corner < 4; corner++) {
                const int at_x = x + (corner >> 1), at_y = y + (corner & 1), dx = at_x - i, dy = at_y - j;
                if ((dx == 0 || dx == 1) && (dy == 0 || dy == 1)) kept[2 * dx + dy] = old[corner];
                else count = write_pair(pairs, n_capacity, count, at_x, at_y, n_x, n_y, old[corner]);
            }
            held = (float4)(kept[0], kept[1], kept[2], kept[3]);
            x = i;
            y = j;
        }
        const float a = middle.x - i, b = middle.y - j;
        held += weight * (float4)((1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b);
    }
    count = write_pair(pairs, n_capacity, count, x, y, n_x, n_y, held.x);
    count = write_pair(pairs, n_capacity, count, x, y + 1, n_x, n_y, held.y);
    count = write_pair(pairs, n_capacity, count, x + 1, y, n_x, n_y, held.z);
    count = write_pair(pairs, n_capacity, count, x + 1, y + 1, n_x, n_y, held.w);
    counts[index] = on ? -1 : count;
}
#endif

#ifdef COMPILE_survey_rays
__kernel void survey_rays(__global const float4 *restrict medium, __global const float8 *restrict starts,
                          __global const float2 *restrict directions, float top, float step, int most, int kind,
                          __global int *restrict steps, int n_p, int n_q, int n_s, int n_ray, int n_angle,
                          int n_pixel) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), bundle = n_ray / n_pixel;
    int longest = 0;
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[get_global_id(1)], top, &ray);
        int k = 0;
        for (; k < most && on; k++) {
            float3 middle;
            float weight;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
        }
        longest = on || longest < 0 ? -1 : max(longest, k);
    }
    steps[get_global_id(1) * n_pixel + pixel] = longest;
}
#endif

#if defined(COMPILE_forward_traced) || defined(COMPILE_back_traced)
// Where voxel (x, y, z) lies in a field.
static inline size_t voxel(int x, int y, int z, int n_x, int n_y) {
    return (((size_t)(z / LANES) * n_x + x) * n_y + y) * LANES + z % LANES;
}

// Whether light may be left in a voxel: none is in an insert.
static inline bool takes(const Medium m, int x, int y, int z, int kind) {
    return !(kind & BLOCKS) || at_node(m, x + MARGIN, y + MARGIN, m.n_s > 1 ? z + MARGIN : 0).w >= 0.0f;
}

static inline size_t pixel_offset(int angle, int pixel, int n_angle, int n_r, int n_row, int lanes) {
    const int r = pixel / n_row, row = pixel % n_row;
    return (((size_t)(row / lanes) * n_angle + angle) * n_r + r) * lanes + row % lanes;
}

#define EACH_CORNER(middle)                                                                                      \
    const int x0 = (int)floor(middle.x), y0 = (int)floor(middle.y), z0 = (int)floor(middle.z);                   \
    const float fx = middle.x - x0, fy = middle.y - y0, fz = middle.z - z0;                                      \
    for (int corner = 0; corner < 8; corner++)

#define CORNER                                                                                                   \
    const int x = x0 + (corner >> 2), y = y0 + ((corner >> 1) & 1), z = z0 + (corner & 1);                       \
    if (x < 0 || y < 0 || z < 0 || x >= n_x || y >= n_y || z >= n_z || !takes(m, x, y, z, kind)) continue;       \
    const float share = (corner >> 2 ? fx : 1 - fx) * ((corner >> 1) & 1 ? fy : 1 - fy) * (corner & 1 ? fz : 1 - fz);
#endif

#ifdef COMPILE_forward_traced
__kernel void forward_traced(__global const float *restrict volume, __global const float4 *restrict medium,
                             __global const float8 *restrict starts, __global const float2 *restrict directions,
                             __global const int *restrict steps, float step, int kind, int lanes,
                             __global float *restrict sinogram, int n_x, int n_y, int n_z, int n_p, int n_q, int n_s,
                             int n_ray, int n_angle, int n_pixel, int n_r, int n_row) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), angle = get_global_id(1), bundle = n_ray / n_pixel;
    const int most = steps[(size_t)angle * n_pixel + pixel];
    const float top = n_z + 1.0f;
    float sum = 0.0f;
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[angle], top, &ray);
        for (int k = 0; k < most && on; k++) {
            float3 middle;
            float weight, met = 0.0f;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
            EACH_CORNER(middle) {
                CORNER
                met += share * volume[voxel(x, y, z, n_x, n_y)];
            }
            sum += weight * met;
        }
    }
    sinogram[pixel_offset(angle, pixel, n_angle, n_r, n_row, lanes)] = sum;
}
#endif

#ifdef COMPILE_back_traced
// Rays cross, so voxels have no owner: an addition that no other may come between.
static inline void add(volatile __global float *where, float value) {
    int expected = as_int(*where), found;
    while ((found = atomic_cmpxchg((volatile __global int *)where, expected, as_int(as_float(expected) + value))) !=
           expected)
        expected = found;
}

__kernel void back_traced(__global const float *restrict sinogram, __global const float4 *restrict medium,
                          __global const float8 *restrict starts, __global const float2 *restrict directions,
                          __global const int *restrict steps, float step, int kind, int lanes,
                          __global float *volume, int n_angle, int n_r, int n_row, int n_p, int n_q, int n_s,
                          int n_ray, int n_pixel, int n_x, int n_y, int n_z) {
    const Medium m = {medium, n_p, n_q, n_s};
    const int pixel = get_global_id(0), angle = get_global_id(1), bundle = n_ray / n_pixel;
    const int most = steps[(size_t)angle * n_pixel + pixel];
    const float top = n_z + 1.0f, light = sinogram[pixel_offset(angle, pixel, n_angle, n_r, n_row, lanes)];
    for (int b = 0; b < bundle; b++) {
        Ray ray;
        bool on = enter(m, starts[pixel * bundle + b], directions[angle], top, &ray);
        for (int k = 0; k < most && on; k++) {
            float3 middle;
            float weight;
            on = advance(m, &ray, top, step, kind, &middle, &weight);
            EACH_CORNER(middle) {
                CORNER
                if (share * weight > 0.0f) add(volume + voxel(x, y, z, n_x, n_y), share * weight * light);
            }
        }
    }
}
#endif

#ifdef COMPILE_clear_volume
FIELD_KERNEL clear_volume(__global float *restrict volume, int n_x, int n_y, int n_z) {
    const int begin = TILE_MINOR ? ITEM_MINOR : 0, end = TILE_MINOR ? min(begin + 1, n_y) : n_y;
    if (ITEM_MAJOR >= n_x) return;
    volume += slab_offset(n_x, n_y);
    for (int y = begin; y < end; y++) EACH_VECTOR STORE(volume + SAMPLE(ITEM_MAJOR, y, n_y), (Vector)(0.0f));
}
#endif
