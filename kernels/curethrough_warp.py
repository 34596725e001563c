"""Warp version of `curethrough`; a thread owns a strip of pixels, which on a GPU is one pixel."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def added(dose: float, rest: float, change: float):
    """Ω after a change, and the rounding error of the sum."""
    whole = change + rest
    total = dose + whole
    return wp.vec2(total, whole - (total - dose))


@wp.func
def bit_of(word: wp.uint32, n: int):
    return int((word >> wp.uint32(n)) & wp.uint32(1))


@wp.kernel
def pack_slices(
    levels: wp.array3d[wp.uint8], threshold: int, block: int, words: wp.array3d[wp.uint32],
    solid: wp.array2d[int], n_slice: int, n_y: int, n_x: int, n_word: int, n_strip: int,
) -> None:  # fmt: skip
    y, strip = wp.tid()
    width = (n_x + n_strip - 1) // n_strip
    count = int(0)
    for x in range(strip * width, wp.min((strip + 1) * width, n_x)):
        word = wp.uint32(0)
        for n in range(n_slice):
            if int(levels[n, y, x]) >= threshold:
                word = word | (wp.uint32(1) << wp.uint32(n))
                count += 1
        words[block % n_word, y, x] = word
    solid[y, strip] = count


@wp.kernel
def expose_slices(
    levels: wp.array3d[wp.uint8], light: wp.array[float], decay: float, part: float, fade: float,
    state: wp.array3d[float], doses: wp.array3d[float], peaks: wp.array2d[float],
    n_slice: int, n_y: int, n_x: int, n_kept: int, n_strip: int,
) -> None:  # fmt: skip
    y, strip = wp.tid()
    width = (n_x + n_strip - 1) // n_strip
    peak = float(0.0)
    for x in range(strip * width, wp.min((strip + 1) * width, n_x)):
        dose = state[0, y, x]
        rest = state[1, y, x]
        for k in range(n_slice):
            n = n_slice - 1 - k
            change = light[int(levels[n, y, x])] - decay * dose
            if n < n_kept:
                doses[n, y, x] = (dose + part * change) * fade
            both = added(dose, rest, change)
            dose = both[0]
            rest = both[1]
            peak = wp.max(peak, dose)
        state[0, y, x] = dose
        state[1, y, x] = rest
    peaks[y, strip] = peak


@wp.kernel
def judge_slices(
    levels: wp.array3d[wp.uint8], words: wp.array3d[wp.uint32], block: int, light: wp.array[float],
    decay: float, scale: float, layered: int, critical: float, state: wp.array3d[float],
    heights: wp.array3d[float], peaks: wp.array2d[float],
    n_slice: int, n_y: int, n_x: int, n_word: int, n_strip: int,
) -> None:  # fmt: skip
    y, strip = wp.tid()
    width = (n_x + n_strip - 1) // n_strip
    peak = float(0.0)
    for x in range(strip * width, wp.min((strip + 1) * width, n_x)):
        dose = state[0, y, x]
        rest = state[1, y, x]
        over = heights[0, y, x]
        under = heights[1, y, x]
        for k in range(n_slice):
            n = n_slice - 1 - k
            shown = light[int(levels[n, y, x])]
            start = dose
            both = added(dose, rest, shown - decay * dose)
            dose = both[0]
            rest = both[1]
            peak = wp.max(peak, dose)
            stop = dose
            limit = shown / decay
            if layered != 0:
                start = dose
                stop = (1.0 - decay) * dose
                limit = float(0.0)
            share = float(1.0)
            if (start >= critical) != (stop >= critical):
                share = wp.clamp(wp.log((critical - limit) / (start - limit)) * scale, 0.0, 1.0)
            cured = wp.where(start >= critical, share, 1.0 - share)
            if bit_of(words[block % n_word, y, x], n) == 1:
                under += 1.0 - cured
            else:
                over += cured
        state[0, y, x] = dose
        state[1, y, x] = rest
        heights[0, y, x] = over
        heights[1, y, x] = under
    peaks[y, strip] = peak
