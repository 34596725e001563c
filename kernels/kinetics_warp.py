"""Warp version of `kinetics`: one thread per item."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.curethrough_warp import added

wp.set_module_options({"enable_backward": False, "fast_math": False})

DEPLETED = 1.0e-6
FLOOR = 1.0e-12
MOST = 20000
NEVER = -1.0
UNSETTLED = -2.0
LONG = 1.0e30


@wp.struct
class Terms:
    a: float
    b: float
    p: float
    k2: float
    slope: float
    scale: float
    steady: int


@wp.struct
class Matrix:
    push: float
    pull: float
    first: float
    last: float
    pivot: float
    share: float
    pair: float
    slope: float


@wp.struct
class State:
    y: wp.vec3
    rest: wp.vec3  # rounding error of the last step
    trial: float
    taken: float


@wp.func
def share_of(y: wp.vec3, terms: Terms):
    return wp.clamp(y[0] / wp.max(y[0] + y[1], FLOOR * terms.scale), 0.0, 1.0)


@wp.func
def change_of(y: wp.vec3, terms: Terms):
    share = share_of(y, terms)
    made = terms.slope * y[2]
    if terms.steady != 0:
        made = terms.p
    paired = terms.k2 * y[1] * y[1]
    rest = wp.min(1.0 - share, wp.abs(y[1]) / (FLOOR * terms.scale))
    return wp.vec3(-terms.a * share, -terms.b * rest + 2.0 * (made - paired), paired - made)


@wp.func
def reach_of(y: wp.vec3, change: wp.vec3, terms: Terms):
    reach = float(LONG)
    fall = -(change[0] + change[1])
    if fall > 0.0:
        reach = (y[0] + y[1] - 0.5 * DEPLETED * terms.scale) / fall
    if terms.steady != 0 and change[2] < 0.0:
        reach = wp.min(reach, -y[2] / change[2])
    return reach


@wp.func
def solved(m: Matrix, right: wp.vec3):
    pushed = m.push * (1.0 - m.share) * right[0] / m.first
    middle = (right[1] + pushed + 2.0 * m.slope * right[2] / m.last) / m.pivot
    return wp.vec3((right[0] + m.pull * m.share * middle) / m.first, middle, (right[2] + m.pair * middle) / m.last)


@wp.func
def stepped(y: wp.vec3, change: wp.vec3, terms: Terms, h: float):
    """The change by a step of Rodas3, and its estimated error."""
    whole = wp.max(y[0] + y[1], FLOOR * terms.scale)
    g = 2.0 / h
    m = Matrix()
    m.share = share_of(y, terms)
    m.pull = terms.a / whole
    m.push = terms.b / whole
    m.pair = 2.0 * terms.k2 * y[1]
    m.slope = terms.slope
    m.first = g + m.pull * (1.0 - m.share)
    m.last = g + terms.slope
    m.pivot = g + m.push * m.share * g / m.first + 2.0 * m.pair * g / m.last
    per = 1.0 / h
    k1 = solved(m, change)
    k2 = solved(m, change + 4.0 * per * k1)
    base = y + 2.0 * k1
    k3 = solved(m, change_of(base, terms) + per * (k1 - k2))
    near = base + k3
    k4 = solved(m, change_of(near, terms) + per * (k1 - k2 - 8.0 / 3.0 * k3))
    more = 2.0 * k1 + k3 + k4
    return wp.vec4(more[0], more[1], more[2], wp.max(wp.abs(k4[0]), wp.max(wp.abs(k4[1]), wp.abs(k4[2]))))


@wp.func
def settled(y: wp.vec3, end: wp.vec3, terms: Terms):
    moved = wp.min(end[2], 0.0)
    if terms.steady != 0 and end[2] <= DEPLETED * terms.scale and end[2] < y[2]:
        moved = end[2]
    b = end[1] + 2.0 * moved
    below = wp.min(b, 0.0)
    return wp.vec3(wp.max(end[0], 0.0), b - below, wp.max(end[2] - moved + 0.5 * below, 0.0))


@wp.func
def is_depleted(y: wp.vec3, scale: float):
    return y[0] + y[1] <= DEPLETED * scale


@wp.func
def terms_of(rates: wp.array2d[float], resin: int, visible: float, made: float, y: wp.vec3):
    """The terms of a resin under light, in the state y."""
    terms = Terms()
    terms.scale = rates[resin, 4]
    terms.a = rates[resin, 0] * visible
    terms.b = rates[resin, 1] * visible
    terms.p = made
    terms.k2 = rates[resin, 3]
    terms.slope = 0.0
    terms.steady = 0
    if rates[resin, 5] != 0.0:
        terms.slope = made / rates[resin, 5]
    else:
        terms.steady = 1
        if y[2] <= 0.0 and made >= terms.k2 * y[1] * y[1]:
            terms.p = 0.0
            terms.k2 = 0.0
    return terms


@wp.func
def tried(state: State, terms: Terms, left: float, tolerance: float):
    """The state after a step, or the same if the step was too long; the error determines the next step."""
    y = state.y
    change = change_of(y, terms)
    h = wp.min(wp.min(state.trial, left), reach_of(y, change, terms))
    step = stepped(y, change, terms, h)
    increment = wp.vec3(step[0], step[1], step[2]) - state.rest
    end = y + increment
    error = step[3] / (tolerance * terms.scale)
    low = -tolerance * terms.scale
    grown = wp.clamp(0.9 / wp.cbrt(wp.max(error, 1.0e-6)), 0.2, 4.0)
    short = error <= 1.0 and end[0] >= low and end[1] >= low and end[2] >= low
    if not short:
        return State(y, state.rest, h * wp.min(grown, 0.5), 0.0)
    longer = h * grown
    if h < state.trial:
        longer = wp.max(longer, state.trial)
    rest = (end - y) - increment
    if end[0] < 0.0 or end[1] < 0.0 or end[2] <= DEPLETED * terms.scale:
        rest = wp.vec3(0.0, 0.0, 0.0)
    return State(settled(y, end, terms), rest, longer, h)


@wp.func
def lit_for(
    state: State, rates: wp.array2d[float], resin: int, visible: float, made: float, length: float, tolerance: float
):  # fmt: skip
    """The state after an interval of light, and the rest of the interval if the resin depletes or steps run out."""
    left = float(length)
    n = int(0)
    while left > 0.0 and n < MOST:
        state = tried(state, terms_of(rates, resin, visible, made, state.y), left, tolerance)
        left -= state.taken
        if is_depleted(state.y, rates[resin, 4]):
            break
        n += 1
    return state, left


@wp.func
def record(rows: wp.array2d[float], row: int, y: wp.vec3, dose: float):
    rows[row, 0] = y[0]
    rows[row, 1] = y[1]
    rows[row, 2] = y[2]
    rows[row, 3] = dose


@wp.kernel
def inhibit(
    before: wp.array2d[float], rates: wp.array2d[float], light: wp.array3d[float],
    lengths: wp.array1d[float], first: int, count: int, every: int, tolerance: float,
    after: wp.array2d[float], path: wp.array3d[float], times: wp.array1d[float],
    n_item: int, n_resin: int, n_source: int, n_interval: int, n_row: int,
) -> None:  # fmt: skip
    item = wp.tid()
    resin = int(wp.int64(item) * wp.int64(n_resin) // wp.int64(n_item))
    source = item % n_source
    scale = rates[resin, 4]
    y = wp.vec3(before[item, 0], before[item, 1], before[item, 2])
    dose = wp.vec2(before[item, 3], 0.0)  # and its rounding error
    clock = wp.vec2(0.0, 0.0)
    event = float(NEVER)
    if is_depleted(y, scale):
        y = wp.vec3(0.0, 0.0, y[2])
        event = float(0.0)
    state = State(y, wp.vec3(0.0, 0.0, 0.0), LONG, 0.0)
    record(path[item], 0, y, dose[0])
    row = int(1)
    due = int(every)
    k = int(0)
    while k < count and event == NEVER:
        now = (first + k) % n_interval
        length = lengths[now]
        visible = light[source, now, 0]
        state, left = lit_for(state, rates, resin, visible, rates[resin, 2] * light[source, now, 1], length, tolerance)
        if is_depleted(state.y, scale):
            state.y = wp.vec3(0.0, 0.0, state.y[2])
            event = clock[0] + (length - left)
        elif left > 0.0:
            event = float(UNSETTLED)
        spent = float(length)
        if event != NEVER:
            spent = wp.max(event - clock[0], 0.0)
        dose = added(dose[0], dose[1], visible * spent)
        clock = added(clock[0], clock[1], length)
        k += 1
        if k == due and row < n_row:
            record(path[item], row, state.y, dose[0])
            row += 1
            due += every
    while row < n_row:
        record(path[item], row, state.y, dose[0])
        row += 1
    record(after, item, state.y, dose[0])
    times[item] = event
