"""Warp version of `levels`; a thread owns a strip of pixels, which on a GPU is one pixel."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.curethrough_warp import added, bit_of

wp.set_module_options({"enable_backward": False, "fast_math": False})

BEYOND = 1 << 20
NEVER = 1e30
START_X = 0.7548776662466927
START_Y = 0.5698402909980532


@wp.func
def run_ahead(words: wp.array3d[wp.uint32], block: int, platform: int, y: int, x: int, solid: int):
    """Number of slices before a block that equal its first slice, which is void or solid."""
    if block > 0:
        n_word = words.shape[0]
        run = int(0)
        j = block - 1
        while j >= 0 and j > block - n_word:
            word = words[j % n_word, y, x]
            n = int(31)
            while n >= 0 and bit_of(word, n) == solid:
                n -= 1
                run += 1
            if n >= 0:
                return run
            j -= 1
        if j >= 0 or solid == 0 or platform != 0:
            run += BEYOND
        return run
    if solid == 1 and platform == 0:
        return 0
    return BEYOND


@wp.func
def run_of(words: wp.array3d[wp.uint32], block: int, platform: int, y: int, x: int, n: int, solid: int):
    """Number of slices before slice n of a block that equal it."""
    word = words[block % words.shape[0], y, x]
    k = n - 1
    while k >= 0 and bit_of(word, k) == solid:
        k -= 1
    if k >= 0:
        return n - 1 - k
    return n + run_ahead(words, block, platform, y, x, solid)


@wp.func
def level_of(
    light: wp.array[float], edges: wp.array[float], first: wp.array[wp.uint8], bins: float, required: float,
    shift: float, run: int,
):  # fmt: skip
    """The level of light nearest to the required light, shifted; in a void before other slices, a sufficient one."""
    low = light[0]
    full = light[255]
    level = int(0)
    if required >= full:
        level = int(255)
    elif required > low:
        aim = required + shift
        place = int((wp.clamp(aim, low, full) - low) * bins)
        level = int(first[wp.clamp(place, 0, first.shape[0] - 1)])
        while level < 255 and aim > edges[level]:
            level += 1
        if run > 0 and level < 255 and light[level] < required:
            level += 1
    return level


@wp.func
def count_flaws(flaws: wp.array3d[int], y: int, x: int, dose: float, lowest: float, reached: float, opened: float):
    """Count flaws where a feature begins: a closed void, and a back side with too little dose, which returns 1."""
    if lowest > opened:
        flaws[1, y, x] = flaws[1, y, x] + 1
    if dose < reached:
        flaws[0, y, x] = flaws[0, y, x] + 1
        return 1
    return 0


@wp.func
def target_of(inner: wp.array2d[float], back: wp.array[float], solid: int, done: int, run: int):
    """The dose of a slice by the solid slices before and after it, or by the void ones after it."""
    if solid == 1:
        return inner[wp.min(done, inner.shape[0] - 1), wp.min(run, inner.shape[1] - 1)]
    return back[wp.min(run, back.shape[0] - 1)]


@wp.kernel
def correct_slices(
    words: wp.array3d[wp.uint32], block: int, light: wp.array[float], edges: wp.array[float],
    first: wp.array[wp.uint8], bins: float, decay: float, inner: wp.array2d[float],
    back: wp.array[float], platform: int, reached: float, opened: float, spread: float,
    state: wp.array3d[float], flaws: wp.array3d[int], levels: wp.array3d[wp.uint8],
    missed: wp.array2d[int], n_word: int, n_y: int, n_x: int, n_bin: int, n_below: int, n_above: int,
    n_void: int, n_slice: int, n_strip: int,
) -> None:  # fmt: skip
    y, strip = wp.tid()
    width = (n_x + n_strip - 1) // n_strip
    lost = int(0)
    for x in range(strip * width, wp.min((strip + 1) * width, n_x)):
        word = words[block % n_word, y, x]
        dose = state[0, y, x]
        rest = state[1, y, x]
        lowest = state[2, y, x]
        done = int(state[3, y, x])
        lean = float(x) * START_X + float(y) * START_Y
        shift = spread * (lean - wp.floor(lean) - 0.5)
        run = int(0)
        was = int(-1)
        for k in range(n_slice):
            n = n_slice - 1 - k
            solid = bit_of(word, n)
            if solid == was:
                run -= 1
            else:
                run = run_of(words, block, platform, y, x, n, solid)
            was = solid
            if solid == 1 and done == 0:
                lost += count_flaws(flaws, y, x, dose, lowest, reached, opened)
            wanted = target_of(inner, back, solid, done, run) - dose + decay * dose
            level = level_of(light, edges, first, bins, wanted, shift, wp.where(solid == 0, run, 0))
            levels[n, y, x] = wp.uint8(level)
            before = dose
            both = added(dose, rest, light[level] - decay * dose)
            dose = both[0]
            rest = both[1]
            if solid == 1:
                lowest = float(NEVER)
                done += 1
            else:
                lowest = wp.min(wp.min(lowest, before), dose)
                done = int(0)
        state[0, y, x] = dose
        state[1, y, x] = rest
        state[2, y, x] = lowest
        state[3, y, x] = float(done)
    missed[y, strip] = lost
