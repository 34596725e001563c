// Fourier transforms of samples: a few in registers, by passes, by direct sums, and by the items of a group.
#define BAND 16
#define TURN(value, c, s) (value) = (c) * (value) + sign * (s) * turned(value)
#define SWAP(a, b) { const Vector held = a; a = b; b = held; }

// Transforms of values that are `step` apart, in place.
static inline void of_two(Vector *g, int step) {
    const Vector a = g[0];
    g[0] = a + g[step];
    g[step] = a - g[step];
}

static inline void of_three(Vector *g, int step, float sign) {
    const Vector a = g[step] + g[2 * step], b = sign * 0.86602540f * turned(g[step] - g[2 * step]), c = g[0] - 0.5f * a;
    g[0] += a;
    g[step] = c + b;
    g[2 * step] = c - b;
}

static inline void of_four(Vector *g, int step, float sign) {
    const Vector a = g[0] + g[2 * step], b = g[0] - g[2 * step], c = g[step] + g[3 * step];
    const Vector d = sign * turned(g[step] - g[3 * step]);
    g[0] = a + c;
    g[step] = b + d;
    g[2 * step] = a - c;
    g[3 * step] = b - d;
}

static inline void of_five(Vector *g, int step, float sign) {
    const Vector a = g[step] + g[4 * step], b = g[step] - g[4 * step], c = g[2 * step] + g[3 * step];
    const Vector d = g[2 * step] - g[3 * step];
    const Vector low = g[0] + 0.30901699f * a - 0.80901699f * c, high = g[0] - 0.80901699f * a + 0.30901699f * c;
    const Vector slow = sign * turned(0.95105652f * b + 0.58778525f * d);
    const Vector fast = sign * turned(0.58778525f * b - 0.95105652f * d);
    g[0] += a + c;
    g[step] = low + slow;
    g[4 * step] = low - slow;
    g[2 * step] = high + fast;
    g[3 * step] = high - fast;
}

static inline void of_seven(Vector *g, float sign) {
    const Vector a = g[1] + g[6], b = g[2] + g[5], c = g[3] + g[4];
    const Vector d = sign * turned(g[1] - g[6]), e = sign * turned(g[2] - g[5]), f = sign * turned(g[3] - g[4]);
    const Vector one = g[0] + 0.62348980f * a - 0.22252093f * b - 0.90096887f * c;
    const Vector two = g[0] - 0.22252093f * a - 0.90096887f * b + 0.62348980f * c;
    const Vector three = g[0] - 0.90096887f * a + 0.62348980f * b - 0.22252093f * c;
    const Vector first = 0.78183148f * d + 0.97492791f * e + 0.43388374f * f;
    const Vector second = 0.97492791f * d - 0.43388374f * e - 0.78183148f * f;
    const Vector third = 0.43388374f * d - 0.78183148f * e + 0.97492791f * f;
    g[0] += a + b + c;
    g[1] = one + first;
    g[6] = one - first;
    g[2] = two + second;
    g[5] = two - second;
    g[3] = three + third;
    g[4] = three - third;
}

// The transform of up to FACTOR values in registers, in order.
static inline void of_few(Vector *g, int count, float sign) {
    switch (count) {
        case 2: of_two(g, 1); break;
        case 3: of_three(g, 1, sign); break;
        case 4: of_four(g, 1, sign); break;
        case 5: of_five(g, 1, sign); break;
        case 6: {
            of_three(g, 2, sign); of_three(g + 1, 2, sign);
            TURN(g[3], 0.5f, 0.86602540f); TURN(g[5], -0.5f, 0.86602540f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4];
            g[1] = c; g[2] = e; g[3] = b; g[4] = d;
            break;
        }
        case 7: of_seven(g, sign); break;
        case 8: {
            of_four(g, 2, sign); of_four(g + 1, 2, sign);
            TURN(g[3], 0.70710678f, 0.70710678f); g[5] = sign * turned(g[5]); TURN(g[7], -0.70710678f, 0.70710678f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1); of_two(g + 6, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4], f = g[5], h = g[6];
            g[1] = c; g[2] = e; g[3] = h; g[4] = b; g[5] = d; g[6] = f;
            break;
        }
        case 9: {
            of_three(g, 3, sign); of_three(g + 1, 3, sign); of_three(g + 2, 3, sign);
            TURN(g[4], 0.76604444f, 0.64278761f); TURN(g[5], 0.17364818f, 0.98480775f);
            TURN(g[7], 0.17364818f, 0.98480775f); TURN(g[8], -0.93969262f, 0.34202014f);
            of_three(g, 1, sign); of_three(g + 3, 1, sign); of_three(g + 6, 1, sign);
            SWAP(g[1], g[3]) SWAP(g[2], g[6]) SWAP(g[5], g[7])
            break;
        }
        case 10: {
            of_five(g, 2, sign); of_five(g + 1, 2, sign);
            TURN(g[3], 0.80901699f, 0.58778525f); TURN(g[5], 0.30901699f, 0.95105652f);
            TURN(g[7], -0.30901699f, 0.95105652f); TURN(g[9], -0.80901699f, 0.58778525f);
            of_two(g, 1); of_two(g + 2, 1); of_two(g + 4, 1); of_two(g + 6, 1); of_two(g + 8, 1);
            const Vector b = g[1], c = g[2], d = g[3], e = g[4], f = g[5], h = g[6], i = g[7], j = g[8];
            g[1] = c; g[2] = e; g[3] = h; g[4] = j; g[5] = b; g[6] = d; g[7] = f; g[8] = i;
            break;
        }
    }
}

#ifdef AT_ONCE
// The radix of the next pass of a transform: the greatest factor that is small enough, else the least factor.
static inline int radix_of(int n) {
    int radix = FACTOR;
    while (n % radix) radix--;
    for (int more = FACTOR + 1; radix == 1; more++) radix = n % more ? 1 : more;
    return radix;
}

// Positions of samples, `step` apart from a first one on.
static inline void places_of(int *places, int count, int sample, int step, __global const int *place, int ring) {
    int within = sample % place[1], beyond = sample / place[1];
    for (int r = 0; r < count; r++) {
        places[r] = place[0] + within * place[2] + beyond * place[3] + ring;
        for (within += step; within >= place[1]; beyond++) within -= place[1];
    }
}

#define GET(at) (first ? LOAD(from + SAMPLE(0, read[at], 0)) : near[at])
#define PUT(at, value)                                                                                                 \
    if (last) STORE(to + SAMPLE(0, write[at], 0), value);                                                              \
    else far[at] = value;
// A pass of one radix: its inputs are `apart` from each other, its outputs `done`.
#define PASS(radix)                                                                                                    \
    case radix:                                                                                                        \
        for (int inner = 0; inner < done; inner++) {                                                                   \
            float2 turn[radix];                                                                                        \
            UNROLL for (int r = 1; r < radix; r++) turn[r] = wave[r * inner * turns * wide];                           \
            for (int start = 0; start < turns; start++) {                                                              \
                Vector g[radix];                                                                                       \
                UNROLL for (int r = 0; r < radix; r++) g[r] = GET((start + r * turns) * done + inner);                 \
                if (inner) UNROLL for (int r = 1; r < radix; r++) TURN(g[r], turn[r].x, turn[r].y);                    \
                of_few(g, radix, sign);                                                                                \
                UNROLL for (int k = 0; k < radix; k++) { PUT(start * done * radix + inner + k * done, g[k]) }          \
            }                                                                                                          \
        }                                                                                                              \
        break;

// The transform of `radix` values, pass by pass from the source, or from `near`, to the sink; `wide` waves form one.
static inline void passes(ARRAY from, const int *read, Vector *near, Vector *far, __global float *to, const int *write,
                          int v, int first, int radix, __global const float2 *wave, int wide, float sign) {
    for (int done = 1, part = 1; done < radix; done *= part, first = 0) {
        part = radix_of(radix / done);
        const int turns = radix / (done * part), last = done * part == radix;
        switch (part) {
            PASS(2) PASS(3) PASS(4) PASS(5) PASS(6) PASS(7) PASS(8) PASS(9) PASS(10)
            default:
                for (int start = 0; start < turns; start++) for (int inner = 0; inner < done; inner++)
                    for (int k = 0, step = inner * turns; k < part; k++, step += done * turns) {
                        Vector along = ZERO, across = ZERO;
                        for (int r = 0, phase = 0; r < part; r++, phase = (phase + step) % radix) {
                            const Vector given = GET((start + r * turns) * done + inner);
                            const float2 turn = wave[phase * wide];
                            along += turn.x * given;
                            across += turn.y * given;
                        }
                        PUT(start * done * part + inner + k * done, along + sign * turned(across))
                    }
        }
        Vector *next = near;
        near = far;
        far = next;
    }
}
#endif

// OUTPUTS samples of a transform by direct sums: number `own` of those of a band.
static inline void direct_sums(ARRAY from, __global float *to, __global const int *band, __global const float2 *wave,
                               float sign, int own, int blocks) {
    const int n = band[1], rings = band[2], radix = band[3], done = band[4], turns = n / (done * radix);
    const int ring = own % rings, block = own / rings % blocks * OUTPUTS, group = own / rings / blocks;
    const int inner = group % done, start = group / done;
    EACH_VECTOR {
        Vector along[OUTPUTS], across[OUTPUTS];
        int phase[OUTPUTS], step[OUTPUTS];
        UNROLL for (int o = 0; o < OUTPUTS; o++) {
            along[o] = across[o] = ZERO;
            phase[o] = 0;
            step[o] = (inner + min(block + o, radix - 1) * done) * turns;
        }
        int sample = start * done + inner;
        for (int r = 0; r < radix; r++, sample += turns * done) {
            const int at = band[6] + sample % band[7] * band[8] + sample / band[7] * band[9] + ring;
            const Vector given = LOAD(from + SAMPLE(0, at, 0));
            UNROLL for (int o = 0; o < OUTPUTS; o++) {
                const float2 turn = wave[phase[o]];
                along[o] += turn.x * given;
                across[o] += turn.y * given;
                phase[o] += step[o];
                phase[o] -= phase[o] >= n ? n : 0;
            }
        }
        UNROLL for (int o = 0; o < OUTPUTS; o++) {
            if (block + o >= radix) break;
            const int out = start * done * radix + inner + (block + o) * done;
            const int at = band[10] + out % band[11] * band[12] + out / band[11] * band[13] + ring;
            STORE(to + SAMPLE(0, at, 0), along[o] + sign * turned(across[o]));
        }
    }
}

#ifdef GPU
// Samples of a ring, `step` apart from a first one on: their position, and the distance to the next.
static inline int2 row_of(__global const int *place, int sample, int step) {
    return (int2)(place[0] + sample % place[1] * place[2] + sample / place[1] * place[3],
                  step % place[1] * place[2] + step / place[1] * place[3]) * THREADS;
}

#define TURN_BY(value, number)                                                                                         \
    {                                                                                                                  \
        const float2 turn = wave[number];                                                                              \
        TURN(value, turn.x, turn.y);                                                                                   \
    }
// For up to FACTOR samples, which stay in registers.
#define FEW(count)                                                                                                     \
    case count: {                                                                                                      \
        Vector g[count];                                                                                               \
        UNROLL for (int i = 0; i < count; i++) g[i] = given[i * read.y];                                               \
        if (inner) UNROLL for (int i = 1; i < count; i++) TURN_BY(g[i], i * inner * turns)                             \
        of_few(g, count, sign);                                                                                        \
        UNROLL for (int i = 0; i < count; i++) found[i * write.y] = g[i];                                              \
        break;                                                                                                         \
    }

#ifdef FIRST
#define RADIX (FIRST * SECOND * THIRD * LAST)
// Number of lanes held at a time, and of the items of a group that share one of them.
#define FIT(lanes) (RADIX * (lanes) <= HELD)
#define WIDE (FIT(THREADS) ? THREADS : FIT(THREADS / 2) ? THREADS / 2 : FIT(THREADS / 4) ? THREADS / 4 : 1)
#define SLOTS ((int)get_local_size(0) / WIDE)
#define SLOT ((int)get_local_id(0) / WIDE)
// For COUNT samples, BEYOND apart; the earlier passes have made BEFORE of them: in place.
#define PASS_ON(COUNT, BEFORE, BEYOND)                                                                                 \
    if (COUNT > 1) {                                                                                                   \
        for (int task = SLOT; task < RADIX / COUNT; task += SLOTS) {                                                   \
            const int q = task % (BEYOND);                                                                             \
            __local Vector *at = own + (task / (BEYOND) * COUNT * (BEYOND) + q) * WIDE;                                \
            Vector g[COUNT];                                                                                           \
            UNROLL for (int i = 0; i < COUNT; i++) g[i] = at[i * (BEYOND) * WIDE];                                     \
            of_few(g, COUNT, sign);                                                                                    \
            UNROLL for (int i = 1; i < COUNT; i++) TURN_BY(g[i], i * q * (BEFORE) * turn_of_one)                       \
            UNROLL for (int i = 0; i < COUNT; i++) at[i * (BEYOND) * WIDE] = g[i];                                     \
        }                                                                                                              \
        barrier(CLK_LOCAL_MEM_FENCE);                                                                                  \
    }

// The transform of RADIX samples, from `given`, `read` apart, to `found`, `write` apart, by the items of a group. They
// compute FIRST values, exchange results through local memory, of which `own` is an item's lane, and so on to LAST.
// Twiddle factors: turn_of_one, a RADIX-th of a turn; turn_of_inner, for each sample, the rest from earlier passes.
static inline void by_group(__global const Vector *given, int read, __global Vector *found, int write, __local Vector *own,
                            __global const float2 *wave, int turn_of_one, int turn_of_inner, float sign) {
    const int rest = RADIX / FIRST;
    for (int q = SLOT; q < rest; q += SLOTS) {
        Vector g[FIRST];
        UNROLL for (int i = 0; i < FIRST; i++) g[i] = given[(i * rest + q) * read];
        if (turn_of_inner) UNROLL for (int i = 0; i < FIRST; i++) TURN_BY(g[i], (i * rest + q) * turn_of_inner)
        of_few(g, FIRST, sign);
        UNROLL for (int i = 1; i < FIRST; i++) TURN_BY(g[i], i * q * turn_of_one)
        UNROLL for (int i = 0; i < FIRST; i++) own[(i * rest + q) * WIDE] = g[i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    PASS_ON(SECOND, FIRST, THIRD * LAST)
    PASS_ON(THIRD, FIRST * SECOND, LAST)
    for (int task = SLOT; task < RADIX / LAST; task += SLOTS) {
        const int k = task / (SECOND * THIRD) + (task / THIRD % SECOND + task % THIRD * SECOND) * FIRST;
        Vector g[LAST];
        UNROLL for (int i = 0; i < LAST; i++) g[i] = own[(task * LAST + i) * WIDE];
        of_few(g, LAST, sign);
        UNROLL for (int i = 0; i < LAST; i++) found[(i * (RADIX / LAST) + k) * write] = g[i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}
#endif
#endif
