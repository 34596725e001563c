#pragma OPENCL FP_CONTRACT OFF                  // fused operations round otherwise, and photons then part

static inline uint4 philox(uint photon, uint segment, uint seed) {
    uint4 c = (uint4)(photon, segment, 0, 0);
    uint k = seed, l = 0;
    for (int turn = 0; turn < 7; turn++, k += 0x9E3779B9u, l += 0xBB67AE85u)
        c = (uint4)(mul_hi(0xCD9E8D57u, c.z) ^ c.y ^ k, 0xCD9E8D57u * c.z, mul_hi(0xD2511F53u, c.x) ^ c.w ^ l,
                    0xD2511F53u * c.x);
    return c;
}

static inline float unit(uint bits) { return ((float)(bits >> 9) + 0.5f) * 0x1p-23f; }

static inline float free_path(float share) {
    float power = 0.0f;
    for (; share < 0.70710677f; share *= 2.0f) power += 1.0f;
    const float z = (share - 1.0f) / (share + 1.0f), s = z * z;
    const float series = 1.0f + s * (0.33333334f + s * (0.2f + s * (0.14285715f + s * 0.11111111f)));
    return power * 0.6931472f - 2.0f * z * series;
}

static inline float turn_of(float x, float y) {
    const float wide = fabs(x), high = fabs(y), z = fmin(wide, high) / fmax(fmax(wide, high), 1e-30f), s = z * z;
    float angle = z * (0.15915132f + s * (-0.05293857f + s * (0.03080291f + s * (-0.01852985f + s * (0.00837909f +
                  s * -0.00186516f)))));
    angle = high > wide ? 0.25f - angle : angle;
    angle = x < 0 ? 0.5f - angle : angle;
    return y < 0 ? -angle : angle;
}

static inline float3 scattered(float3 u, uint bits, uint way, __global const float *cosines, int n_quantile,
                               __global const float2 *ways) {
    const float place = unit(bits) * (float)(n_quantile - 1);
    const int low = (int)place;
    const float cosine = cosines[low] + (place - (float)low) * (cosines[low + 1] - cosines[low]);
    const float sine = sqrt(fmax(1.0f - cosine * cosine, 0.0f)), flat = sqrt(u.x * u.x + u.y * u.y);
    const bool steep = flat < 1e-4f;
    const float over = fmax(flat, 1e-4f), cx = steep ? 1.0f : u.x / over, cy = steep ? 0.0f : u.y / over;
    const float along = sine * ways[way].x, across = sine * ways[way].y;
    const float x = (along * (cx * u.z) - across * cy) + u.x * cosine;
    const float y = (along * (cy * u.z) + across * cx) + u.y * cosine;
    const float z = u.z * cosine - along * flat, length = sqrt((x * x + y * y) + z * z);
    return (float3)(x / length, y / length, z / length);
}

static inline float to_face(float3 p, float3 u, int layer, __global const float4 *faces, bool *inward) {
    const float a = fmax(u.x * u.x + u.y * u.y, 1e-12f), b = p.x * u.x + p.y * u.y, square = p.x * p.x + p.y * p.y;
    const float inner = faces[max(layer - 1, 0)].x, outer = faces[layer].x;
    const float inside = b * b - a * fmax(square - inner * inner, 0.0f);
    const float outside = b * b + a * fmax(outer * outer - square, 0.0f);
    *inward = layer > 0 && b < 0 && inside > 0;
    return fmax((*inward ? -b - sqrt(fmax(inside, 0.0f)) : sqrt(outside) - b) / a, 0.0f);
}

static inline bool cross_face(float3 p, float3 *u, uint bits, float4 face, bool inward) {
    const float radius = sqrt(p.x * p.x + p.y * p.y), nx = p.x / radius, ny = p.y / radius;
    const float before = inward ? face.z : face.y, behind = inward ? face.y : face.z;
    const float normal = u->x * nx + u->y * ny, cosine = fabs(normal), ratio = before / behind;
    const float square = 1.0f - ratio * ratio * fmax(1.0f - cosine * cosine, 0.0f);
    const float after = sqrt(fmax(square, 0.0f));
    const float s = (before * cosine - behind * after) / (before * cosine + behind * after);
    const float q = (before * after - behind * cosine) / (before * after + behind * cosine);
    const bool passes = square > 0 && unit(bits) >= 0.5f * (s * s + q * q);
    const float bend = inward ? ratio * cosine - after : after - ratio * cosine;
    const float scale = passes ? ratio : 1.0f, shift = passes ? bend : -2.0f * normal;
    *u = (float3)(scale * u->x + shift * nx, scale * u->y + shift * ny, scale * u->z);
    return passes;
}

__kernel void photons(__global const float8 *restrict rays, __global const float4 *restrict faces,
                      __global const int2 *restrict rings, __global const int *restrict lags,
                      __global const float *restrict cosines, __global const float2 *restrict ways, float extinction,
                      float albedo, float per_ring, float per_slice, int first, int each, int most, int seed,
                      __global uint *restrict absorbed, __global uint *restrict escaped, __global uint *restrict tally,
                      int n_column, int n_ray, int n_face, int n_ring, int n_lag, int n_quantile, int n_way,
                      int n_item, int n_cell, int n_bin) {
    const int item = get_global_id(0);
    if (item >= n_item) return;
    uint lost = 0, left = 0;
    for (int number = 0; number < each; number++) {
        const uint photon = first + item * each + number;
        const int column = photon % n_column;
        const float8 own = rays[column * n_ray + photon / n_column % n_ray];
        const float weight = own.s6;
        uint4 bits = philox(photon, 0, seed);
        float path = free_path(1.0f - unit(bits.x) * own.s5) / extinction;
        float3 u = own.s234;
        float3 p = (float3)(own.s0 + u.x * path, own.s1 + u.y * path, (unit(bits.y) - 0.5f) + u.z * path * per_slice);
        u = scattered(u, bits.z, bits.w >> 22, cosines, n_quantile, ways);
        int layer = weight > 0 ? 0 : n_face;
        for (int segment = 1; segment <= most && layer < n_face; segment++) {
            bool inward;
            bits = philox(photon, segment, seed);
            path = to_face(p, u, layer, faces, &inward);
            const float free = free_path(unit(bits.x)) / extinction;
            const bool collides = layer == 0 && free < path;
            path = collides ? free : path;
            for (float half_way = 0.0f; half_way < 1.0f && layer == 0; half_way += 0.5f) {
                const float t = path * (unit(bits.y) * 0.5f + half_way);
                const float x = p.x + u.x * t, y = p.y + u.y * t, z = p.z + u.z * t * per_slice;
                const int ring = (int)(sqrt(x * x + y * y) * per_ring);
                const int lag = abs((int)floor(clamp(z, -1e6f, 1e6f) + 0.5f));
                if (ring >= n_ring || lag >= n_lag) continue;
                const int cells = rings[ring].y;
                int place = (int)floor(turn_of(x, y) * (float)cells + 0.5f);
                place = rings[ring].x + (place < 0 ? place + cells : place) % cells;
                __global uint *sum = tally + 2 * (((size_t)column * n_cell + place) * n_bin + lags[lag]);
                const uint value = (uint)(fmin(weight * path * 524288.0f, 4e9f) + 0.5f);
                if (atomic_add(sum, value) + value < value) atomic_inc(sum + 1);
            }
            p = (float3)(p.x + u.x * path, p.y + u.y * path, p.z + u.z * path * per_slice);
            if (!collides) {
                if (!cross_face(p, &u, bits.z, faces[layer - inward], inward)) continue;
                layer += inward ? -1 : 1;
            } else if ((float)(bits.w & 0x3FFFFF) * 0x1p-22f < albedo) {
                u = scattered(u, bits.z, bits.w >> 22, cosines, n_quantile, ways);
            } else {
                lost++;
                break;
            }
        }
        left += layer == n_face;
    }
    absorbed[item] = lost;
    escaped[item] = left;
}
