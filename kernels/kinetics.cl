#include "packs.h"

#ifdef CPU
#define LANE(value, n) (value).s##n
#define EACH_LANE(M) M(0) M(1) M(2) M(3) M(4) M(5) M(6) M(7) M(8) M(9) M(a) M(b) M(c) M(d) M(e) M(f)
#else
#define LANE(value, n) (value)
#define EACH_LANE(M) M(0)
#endif

#define DEPLETED 1e-6f      // share of the scale below which A + B counts as 0
#define FLOOR 1e-12f        // lower limit of A + B as a divisor, as a share of the scale
#define MOST 20000          // steps within one interval
#define NEVER -1.0f
#define UNSETTLED -2.0f
#define LONG 1e30f

typedef struct { Real a, b, c; } State;
typedef struct { Real a, b, p, k2, slope, scale; Whole steady; } Terms;

static inline State sum(State x, Real share, State y) {
    return (State){fma(share, y.a, x.a), fma(share, y.b, x.b), fma(share, y.c, x.c)};
}
static inline State chosen(Whole mask, State yes, State no) {
    return (State){mask ? yes.a : no.a, mask ? yes.b : no.b, mask ? yes.c : no.c};
}

// A + B, with a lower limit, and the share of A in it.
static inline Real share_of(State y, Terms terms, Real *whole) {
    *whole = fmax(y.a + y.b, FLOOR * terms.scale);
    return clamp(y.a / *whole, (Real)0.0f, (Real)1.0f);
}

static inline State change_of(State y, Terms terms) {
    Real whole;
    const Real share = share_of(y, terms, &whole);
    const Real made = terms.steady ? terms.p : terms.slope * y.c, paired = terms.k2 * y.b * y.b;
    const Real rest = fmin(1.0f - share, fabs(y.b) / (FLOOR * terms.scale));
    return (State){-terms.a * share, fma(-terms.b, rest, 2.0f * (made - paired)), paired - made};
}

// Time that A + B, and for order 0 also C, would last at their present rates.
static inline Real reach_of(State y, State change, Terms terms) {
    const Real fall = -(change.a + change.b), whole = y.a + y.b - 0.5f * DEPLETED * terms.scale;
    const Real reach = fall > 0.0f ? whole / (fall > 0.0f ? fall : (Real)1.0f) : (Real)LONG;
    const Whole ends = terms.steady & (change.c < 0.0f);
    return fmin(reach, ends ? y.c / (ends ? -change.c : (Real)1.0f) : (Real)LONG);
}

typedef struct { Real g, push, pull, first, last, pivot, share, rest, pair, slope; } Matrix;

static inline State solved(Matrix m, State right) {
    const Real middle = (right.b + m.push * m.rest * right.a / m.first + 2.0f * m.slope * right.c / m.last) / m.pivot;
    return (State){(right.a + m.pull * m.share * middle) / m.first, middle, (right.c + m.pair * middle) / m.last};
}

// The change by a step of Rodas3, and its estimated error.
static inline State stepped(State y, State change, Terms terms, Real h, Real *error) {
    Real whole;
    Matrix m;
    m.share = share_of(y, terms, &whole);
    m.rest = 1.0f - m.share;
    m.g = 2.0f / h;
    m.pull = terms.a / whole;
    m.push = terms.b / whole;
    m.pair = 2.0f * terms.k2 * y.b;
    m.slope = terms.slope;
    m.first = fma(m.pull, m.rest, m.g);
    m.last = m.g + terms.slope;
    m.pivot = m.g + m.push * m.share * m.g / m.first + 2.0f * m.pair * m.g / m.last;
    const Real per = 1.0f / h;
    const State k1 = solved(m, change), k2 = solved(m, sum(change, 4.0f * per, k1));
    const State base = sum(y, (Real)2.0f, k1), apart = sum(k1, (Real)-1.0f, k2);
    const State k3 = solved(m, sum(change_of(base, terms), per, apart));
    const State near = sum(base, (Real)1.0f, k3), last = sum(apart, (Real)(-8.0f / 3.0f), k3);
    const State k4 = solved(m, sum(change_of(near, terms), per, last));
    *error = fmax(fabs(k4.a), fmax(fabs(k4.b), fabs(k4.c)));
    return sum(sum(k4, (Real)1.0f, k3), (Real)2.0f, k1);
}

// The rounding errors of hundreds of small steps are carried along: [C] may be large and change little.
static inline Real added(Real total, Real change, Real *rest) {
    const Real wanted = change - *rest, sum = total + wanted;
    *rest = (sum - total) - wanted;
    return sum;
}

// Traces below 0 are removed; missing B is taken from C, and the reverse.
static inline State settled(State y, State end, Terms terms) {
    const Whole used = terms.steady & (end.c <= DEPLETED * terms.scale) & (end.c < y.c);
    const Real moved = used ? end.c : fmin(end.c, (Real)0.0f), b = end.b + 2.0f * moved, below = fmin(b, (Real)0.0f);
    return (State){fmax(end.a, (Real)0.0f), b - below, fmax(end.c - moved + 0.5f * below, (Real)0.0f)};
}

// ---- memory --------------------------------------------------------------------------------------------------------
// Lanes are named, not indexed: an array of them would lie on the stack, once for every item of a group.
static inline Real taken(__global const float *from, Whole places, int stride, int column) {
    Real value;
#define TAKE(s) LANE(value, s) = from[(size_t)LANE(places, s) * stride + column];
    EACH_LANE(TAKE)
    return value;
}
static inline void put(Real value, __global float *to, size_t stride, int last) {
#define PUT(s) if (0x##s <= last) to[0x##s * stride] = LANE(value, s);
    EACH_LANE(PUT)
}
static inline void put_state(State y, Real dose, __global float *to, size_t stride, int last) {
    put(y.a, to, stride, last);
    put(y.b, to + 1, stride, last);
    put(y.c, to + 2, stride, last);
    put(dose, to + 3, stride, last);
}

PACK_KERNEL inhibit(__global const float *restrict before, __global const float *restrict rates,
                        __global const float *restrict light, __global const float *restrict lengths, int first, int count,
                        int every, float tolerance, __global float *restrict after, __global float *restrict path,
                        __global float *restrict times, int n_item, int n_resin, int n_source, int n_interval, int n_row) {
    const int item = (int)get_global_id(0), last = n_item - item - 1;
    if (item % PACK) return;
    const Whole items = min((Whole)item + NUMBERS, (Whole)(n_item - 1)), sources = items % n_source;
    Whole resins;
#define RESIN(s) LANE(resins, s) = (int)((long)LANE(items, s) * n_resin / n_item);
    EACH_LANE(RESIN)
    const Real k_a = taken(rates, resins, 8, 0), k_b = taken(rates, resins, 8, 1), k_c = taken(rates, resins, 8, 2);
    const Real k_2 = taken(rates, resins, 8, 3), scale = taken(rates, resins, 8, 4), reference = taken(rates, resins, 8, 5);
    State y = {taken(before, items, 4, 0), taken(before, items, 4, 1), taken(before, items, 4, 2)};
    State rest = {(Real)0.0f, (Real)0.0f, (Real)0.0f};
    Real dose = taken(before, items, 4, 3), dose_rest = (Real)0.0f, trial = (Real)LONG, event = (Real)NEVER;
    Whole live = y.a + y.b > DEPLETED * scale;
    event = live ? event : (Real)0.0f;
    y.a = live ? y.a : (Real)0.0f;
    y.b = live ? y.b : (Real)0.0f;
    const size_t stride = (size_t)4 * n_row;
    __global float *own = path + stride * item;
    put_state(y, dose, own, stride, last);
    float clock = 0.0f, clock_rest = 0.0f;
    int row = 1, due = every;
    Terms terms;
    terms.scale = scale;
    terms.steady = reference == 0.0f;
    for (int k = 0; k < count && ANY(live); k++) {
        const int now = (first + k) % n_interval;
        const float length = lengths[now];
        const Real visible = taken(light, sources, 2 * n_interval, 2 * now);
        const Real made = k_c * taken(light, sources, 2 * n_interval, 2 * now + 1);
        terms.a = k_a * visible;
        terms.b = k_b * visible;
        Real left = (Real)length;
        Whole on = live & (left > 0.0f);
        for (int n = 0; n < MOST && ANY(on); n++) {
            const Whole slides = terms.steady & (y.c <= 0.0f) & (made >= k_2 * y.b * y.b);
            terms.p = slides ? (Real)0.0f : made;
            terms.k2 = slides ? (Real)0.0f : k_2;
            terms.slope = terms.steady ? (Real)0.0f : made / (terms.steady ? (Real)1.0f : reference);
            const State change = change_of(y, terms);
            const Real h = on ? fmin(fmin(trial, left), reach_of(y, change, terms)) : (Real)1.0f;
            Real error;
            const State more = stepped(y, change, terms, h, &error);
            State left_over = rest;
            State end = {added(y.a, more.a, &left_over.a), added(y.b, more.b, &left_over.b),
                         added(y.c, more.c, &left_over.c)};
            error /= tolerance * scale;
            const Real low = -tolerance * scale;
            const Whole good = on & (error <= 1.0f) & (end.a >= low) & (end.b >= low) & (end.c >= low);
            const Real grown = clamp(0.9f / cbrt(fmax(error, (Real)1e-6f)), (Real)0.2f, (Real)4.0f);
            const Real next = good ? fmax(h * grown, h < trial ? trial : (Real)0.0f) : h * fmin(grown, (Real)0.5f);
            trial = on ? next : trial;
            const Whole below = (end.a < 0.0f) | (end.b < 0.0f) | (end.c <= DEPLETED * scale);
            end = settled(y, end, terms);
            const Whole gone = good & (end.a + end.b <= DEPLETED * scale), over = good & (gone | (h >= left));
            end.a = gone ? (Real)0.0f : end.a;
            end.b = gone ? (Real)0.0f : end.b;
            y = chosen(good, end, y);
            rest = chosen(good, chosen(below, (State){(Real)0.0f, (Real)0.0f, (Real)0.0f}, left_over), rest);
            left = good ? left - h : left;
            event = gone ? clock + ((Real)length - left) : event;
            live &= !gone;
            on &= !over;
        }
        event = on ? (Real)UNSETTLED : event;
        live &= !on;
        const Real wanted = visible * ((event == NEVER) ? (Real)length : fmax(event - clock, (Real)0.0f)) - dose_rest;
        const Real total = dose + wanted;
        dose_rest = (total - dose) - wanted;
        dose = total;
        const float step = length - clock_rest, later = clock + step;
        clock_rest = (later - clock) - step;
        clock = later;
        if (k + 1 == due && row < n_row) {
            put_state(y, dose, own + 4 * row++, stride, last);
            due += every;
        }
    }
    for (; row < n_row; row++) put_state(y, dose, own + 4 * row, stride, last);
    put_state(y, dose, after + 4 * item, 4, last);
    put(event, times + item, 1, last);
}
