"""Definitions of pointwise kernels against their formulas, voxel by voxel, and against independent solutions."""

from __future__ import annotations

from collections.abc import Callable
from math import exp, log, sqrt
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from vamgpu.kernels import (
    admm,
    camera,
    covering,
    dwell,
    flip,
    inhibition,
    loss,
    mask,
    pdhg,
    reduce,
    traced,
    update,
    watch,
)
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table

SHAPE = (3, 3, 2)
NEVER = 1e30


class Case(NamedTuple):
    """A kernel, what a voxel's formula gives (its loss, or numbers by argument), numbers, and ranges or values."""

    kernel: Kernel
    formula: Callable[[SimpleNamespace], Any]
    numbers: dict[str, float] = {}  # noqa: RUF012
    given: dict[str, Any] = {}  # noqa: RUF012


def within(value: float, low: float, high: float) -> float:
    """A number brought into a range."""
    return low if value < low else high if value > high else value


def find_levels(v: SimpleNamespace) -> dict[str, float]:
    dose = 2 * v.held + v.scaled_dual
    weight = 1.0 if v.near else 0.0 if v.target >= 0.5 else v.rim
    lack = v.least - min(dose, 1.0) if v.target >= 0.5 else 0.0
    leak = dose - v.leak if v.target < 0.5 else 0.0
    return {
        "below": weight * (lack > 0), "shorts": weight * max(lack, 0.0), "above": weight * (leak > 0),
        "over": weight * max(leak, 0.0),
    }  # fmt: skip


def clip_dose(v: SimpleNamespace) -> dict[str, float]:
    dose, part = 2 * v.held + v.scaled_dual, v.target >= 0.5
    clipped = within(dose, v.least, 1.0) if part else min(dose, v.leak)
    relaxed = v.relax * clipped + (1 - v.relax) * v.held
    weight = 1.0 if v.near else 0.0 if part else v.rim
    return {"pull": weight * (relaxed - dose), "scaled_dual": dose - v.held - relaxed}


def clip_light(v: SimpleNamespace) -> dict[str, float]:
    bright = 2 * v.light + v.scaled_dual
    driven = bright + v.push * (bright - v.white / 2)
    relaxed = v.relax * within(driven, 0.0, v.white) + (1 - v.relax) * v.light
    return {"pull": v.pull + v.base * (relaxed - bright), "scaled_dual": bright - v.light - relaxed}


def primal_step(v: SimpleNamespace) -> dict[str, float]:
    after = within(v.light - v.step * v.ahead / v.columns, 0.0, v.most) if v.columns > 0 else 0.0
    return {"after": after, "ahead": 2 * after - v.light, "moved": v.columns * (after - v.light) ** 2}


def dual_step(v: SimpleNamespace) -> dict[str, float]:
    part, counts = v.target >= 0.5, v.near and v.rows > 0
    excess = v.least - v.ahead if part else v.ahead - v.leak
    lower = max(0.0, v.lower + v.step * excess / (v.rows + 1)) if counts else 0.0
    upper = max(0.0, v.upper + v.step * (v.ahead - 1) / v.rows) if counts and part else 0.0
    rows, half = v.rows if counts else 1.0, (v.ahead - v.held) / 2
    change = upper - v.upper - (lower - v.lower) if part else lower - v.lower
    return {
        "lower_after": lower, "upper_after": upper, "inside": lower * part, "outside": lower * (not part),
        "moved": (rows + 1) * (lower - v.lower) ** 2 + rows * (upper - v.upper) ** 2, "crossed": change * half,
    }  # fmt: skip


def divide_prices(v: SimpleNamespace) -> dict[str, float]:
    lower, upper = max(v.lower, 0.0), max(v.upper, 0.0)
    if v.target >= 0.5:
        return {"paid": v.inside * lower, "cost": v.inside * upper}
    return {"paid": 0.0, "cost": v.outside * lower}


def light_short_pixels(v: SimpleNamespace) -> dict[str, float]:
    short = v.paid - v.cost
    if short <= 0:
        return {"light": 0.0}
    return {"light": within(v.light * (short / (v.scale * v.cover)) ** 2, 1e-9, 1.0) if v.cover > 0 else 1.0}


def cover_scale(v: SimpleNamespace) -> dict[str, float]:
    short = v.keep * v.paid - v.cost
    return {"highs": 0.0 if short <= 0 else short / v.cover if v.cover > 0 else NEVER}


def match_dose(v: SimpleNamespace) -> dict[str, float]:
    known = v.dose > v.least and v.got > v.least
    return {"gain": v.gain * within(v.dose / v.got, 1 / v.most, v.most) if known else v.gain}


def spare_voxels(v: SimpleNamespace) -> dict[str, float]:
    sure = v.dose - v.share * v.deviation - v.margin
    return {"weight": 0.0 if (sure > v.greatest if v.target >= 0.5 else sure >= v.inside) else 1.0}


def curve(samples: Any, start: float, density: float, dose: float) -> tuple[float, float]:
    """A sampled function and its derivative, straight beyond its ends."""
    k = int(within((dose - start) * density // 1, 0, len(samples) - 2))
    rise = samples[k + 1] - samples[k]
    return samples[k] + rise * ((dose - start) * density - k), rise * density


def likelihood_weights(v: SimpleNamespace) -> dict[str, float]:
    if v.deviation <= 0 or v.judged[v.i, v.j] <= 0:
        return {"weight": 0.0, "pull": 0.0}
    made, slope = curve(v.samples, v.start, v.density, v.dose)
    by_gain = slope * v.dose  # the derivative of the curve by a relative gain
    return {"weight": (by_gain / v.deviation) ** 2, "pull": by_gain * (v.seen - made) / v.deviation**2}


def share_gain(v: SimpleNamespace) -> dict[str, float]:
    gain = v.pull / (v.weight + v.least)
    return {"dose": v.dose * (1 + gain), "deviation": abs(v.dose) / sqrt(v.weight / v.shared + v.strength)}


def take_bias(v: SimpleNamespace) -> dict[str, float]:
    lit = v.reached[v.j]
    return {"depth": v.depth - (-lit * log(max(1 - v.dark, 1e-6)) - v.linear) if lit > 0 else v.depth}


def dim_light(v: SimpleNamespace) -> dict[str, float]:
    return {"dark": 1 - exp(-v.path / v.reached[v.j]) if v.reached[v.j] > 0 else 0.0}


def price_flips(v: SimpleNamespace) -> dict[str, float]:
    def error(dose: float) -> float:
        if v.side > 0:
            return (v.least - dose) ** 2 if dose < v.least else (dose - v.most) ** 2 if dose > v.most else 0.0
        return max(dose - v.leak, 0.0) ** 2 if v.side < 0 else 0.0

    now = error(v.dose)
    return {"brighter": (error(v.dose + v.step) - now) / v.step, "darker": (error(v.dose - v.step) - now) / v.step}


def flip_pixels(v: SimpleNamespace) -> dict[str, float]:
    change = (-v.step if v.darker < 0 else 0.0) if v.light > 0 else (v.step if v.brighter < 0 else 0.0)
    return {"light": v.light + change, "change": change}


def apply_penalty(v: SimpleNamespace) -> dict[str, float]:
    lit = max(v.light, 0.0)
    slope = v.gradient + v.weight * v.power * lit ** (v.power - 1)
    if v.hold and (v.light <= 0 and slope > 0 or v.light >= v.most and slope < 0):
        slope = 0.0  # a step against it would leave the range
    return {"gradient": slope, "parts": v.weight * lit**v.power}


def correct_by_ratio(v: SimpleNamespace) -> dict[str, float]:
    goal, got = v.low + (v.high - v.low) * v.target, v.scale * v.dose
    return {"model": v.model * (min(v.most, goal / got) if got > 0 else v.most)}


def correct_by_difference(v: SimpleNamespace) -> dict[str, float]:
    got, change = v.scale * v.dose, 0.0
    if v.target >= 0.5 and got < v.high:
        change = v.gain_inside * (v.high - got)
    if v.target < 0.5 and got > v.low:
        change = -v.gain_outside * (got - v.low)
    return {"model": v.model + change if v.near else v.model}


def partial_extent(v: SimpleNamespace) -> dict[str, float]:
    chosen = v.lower <= v.mask < v.upper and v.near
    return {"lows": v.a if chosen else np.inf, "highs": v.a if chosen else -np.inf}


def raise_peak(v: SimpleNamespace) -> dict[str, float]:
    dose = v.x - v.a - v.b / v.alpha
    return {"peak": max(dose, v.peak), "when": max(v.when, v.number) if dose > v.peak else v.when}


def consume_oxygen(v: SimpleNamespace) -> dict[str, float]:
    """The step left by bisection of left − a + v·left/(left + floor) = 0."""
    dose, low, high = v.gain * v.dose, 0.0, v.a
    for _ in range(80):
        left = 0.5 * (low + high)
        low, high = (left, high) if left - v.a + dose * left / (left + v.floor) < 0.0 else (low, left)
    return {"a": left, "x": v.x + dose - (v.a - left)}


def add_peak_slope(v: SimpleNamespace) -> dict[str, float]:
    own = v.slope if v.when == v.number else 0.0
    return {"a_slope": v.a_slope - own, "b_slope": v.b_slope - own / v.alpha, "x_slope": v.x_slope + own}


SHUFFLED = {"a": np.arange(18.0).reshape(SHAPE) - 9, "mask": np.arange(18).reshape(SHAPE) * 7 % 18 / 18}
HELD = {"weight": 0.3, "power": 2.5, "hold": 1, "most": 0.7}
STEEP = {"gradient": (-2.0, 2.0), "light": (-0.5, 1.0)}
SIGNED = {"lower": (-1.0, 1.0), "upper": (-1.0, 1.0)}
COVERED = {"paid": (0.0, 0.5), "cost": np.full(SHAPE, 0.48)}
SOME = np.where(np.arange(18).reshape(SHAPE) % 3 == 0, 0.0, 0.7)
"""Positive numbers, and 0."""
REFLECTED = {"held": (0.0, 0.8), "scaled_dual": (-0.5, 0.5)}
LEVELS = {"least": 0.8, "leak": 0.6, "reach": 1.0, "rim": 0.3}
WINDOW = {"least": 0.8, "leak": 0.6, "reach": 1.0, "step": 0.9}
CURVE, SAMPLES = {"start": 0.1, "density": 4.0}, np.array([0.1, 0.2, 0.5, 0.9])
CORRECTED = {"scale": 1.3, "low": 0.5, "high": 0.9}
CASES = {
    "find_levels": Case(admm.find_levels, find_levels, LEVELS, REFLECTED),
    "clip_dose": Case(admm.clip_dose, clip_dose, LEVELS | {"relax": 1.6}, REFLECTED),
    "clip_light": Case(admm.clip_light, clip_light, {"push": 0.3, "base": 0.7, "relax": 1.6}, {"white": (0.2, 1.0)}),
    "primal_step": Case(pdhg.primal_step, primal_step, {"step": 0.9, "most": 0.8}, {"columns": SOME}),
    "dual_step": Case(pdhg.dual_step, dual_step, WINDOW, {"rows": SOME, "ahead": (0.0, 2.0), "lower": (0.0, 0.3)}),
    "dual_dose": Case(pdhg.dual_dose, lambda v: {"pull": v.upper - v.lower if v.target >= 0.5 else v.lower}),
    "divide_prices": Case(covering.divide_prices, divide_prices, {"inside": 0.3, "outside": 0.7}, SIGNED),
    "light_short_pixels": Case(covering.light_short_pixels, light_short_pixels, {"scale": 0.7}, {"cover": SOME}),
    "level_cover": Case(
        covering.level_cover,
        lambda v: {"cover": v.cover / v.rows if v.near and v.rows > 0 else 0.0}, {"reach": 1.0}, {"rows": SOME},
    ),
    "cover_scale": Case(covering.cover_scale, cover_scale, {"keep": 0.9}, {"cover": (0.5, 1.0)}),
    "cover_scale, never": Case(covering.cover_scale, cover_scale, {"keep": 0.9}, {"cover": SOME}),
    "cover_scale, covered": Case(covering.cover_scale, cover_scale, {"keep": 0.9}, COVERED),
    "tilted_gain": Case(
        watch.tilted_gain,
        lambda v: {"gain": v.level * (1 + v.along * v.up[v.k] + v.across * v.aside[v.i, v.j])},
        {"level": 1.2, "along": 0.3, "across": -0.4},
    ),
    "match_dose": Case(
        watch.match_dose, match_dose, {"least": 0.3, "most": 1.5}, {"dose": (0.0, 1.0), "got": (0.0, 1.0)}
    ),
    "spare_voxels": Case(
        watch.spare_voxels, spare_voxels, {"share": 0.5, "margin": 0.1, "inside": 0.2, "greatest": 0.4}
    ),
    "likelihood_weights": Case(
        watch.likelihood_weights, likelihood_weights, CURVE,
        {"samples": SAMPLES, "deviation": SOME, "judged": np.arange(9.0).reshape(3, 3) % 4},
    ),
    "share_gain": Case(
        watch.share_gain, share_gain, {"least": 0.2, "shared": 3.0, "strength": 0.5}, {"weight": (0.0, 1.0)}
    ),
    "take_bias": Case(camera.take_bias, take_bias, {}, {"dark": (0.5, 1.2), "reached": np.array([0.9, 0.4, 0.0])}),
    "dim_light": Case(camera.dim_light, dim_light, {}, {"reached": np.array([0.9, 0.4, 0.0])}),
    "price_flips": Case(
        flip.price_flips, price_flips, {"least": 0.6, "most": 0.8, "leak": 0.3, "step": 0.25},
        {"side": np.arange(18).reshape(SHAPE) % 3 - 1.0},
    ),
    "flip_pixels": Case(flip.flip_pixels, flip_pixels, {}, dict.fromkeys(("brighter", "darker", "light"), (-1.0, 1.0))),
    "weigh_poses": Case(
        dwell.weigh_poses, lambda v: {"weighted": v.light * v.times[v.i % 2]}, {}, {"times": np.array([0.3, 0.8])}
    ),
    "mask_rays": Case(mask.mask_rays, lambda v: {"masked": v.light * v.shares[v.j]}),
    "clear_volume": Case(traced.clear_volume, lambda v: {"volume": 0.0}),
    "partial_sum": Case(reduce.partial_sum, lambda v: {"parts": v.a}),
    "partial_dot": Case(reduce.partial_dot, lambda v: {"parts": v.a * v.b}),
    "partial_extent": Case(reduce.partial_extent, partial_extent, {"lower": 0.2, "upper": 0.7, "reach": 1.0}, SHUFFLED),
    "linear": Case(
        update.linear, lambda v: {"out": max(v.floor, v.a * v.x + v.b * v.y)}, {"a": 0.7, "b": -1.2, "floor": 0.1}
    ),
    "multiply": Case(update.multiply, lambda v: {"out": v.x * v.y}),
    "apply_penalty": Case(update.apply_penalty, apply_penalty, HELD, STEEP),
    "apply_penalty, free": Case(
        update.apply_penalty, apply_penalty, {"weight": 0.3, "power": 1.5, "hold": 0, "most": 0.7}
    ),
    "fill_background": Case(
        update.fill_background,
        lambda v: {"model": v.low + (v.high - v.low) * v.target if v.near else 0.0},
        {"low": 0.2, "high": 0.9, "reach": 1.0},
    ),
    "correct_by_ratio": Case(update.correct_by_ratio, correct_by_ratio, CORRECTED | {"most": 1.5}),
    "correct_by_difference": Case(
        update.correct_by_difference, correct_by_difference,
        CORRECTED | {"gain_outside": 0.7, "gain_inside": 0.4, "reach": 1.0},
    ),
    "raise_peak": Case(
        inhibition.raise_peak, raise_peak, {"alpha": 1.5, "number": 3.0},
        {"peak": (-0.6, 0.2), "when": np.arange(18).reshape(SHAPE) % 6 - 1.0, "x": (0.0, 1.0)},
    ),
    "consume_oxygen": Case(
        inhibition.consume_oxygen, consume_oxygen, {"gain": 0.7, "floor": 0.05}, {"a": (0.0, 1.0), "dose": (0.0, 1.5)},
    ),
    "add_peak_slope": Case(
        inhibition.add_peak_slope, add_peak_slope, {"number": 2.0, "alpha": 1.5},
        {"when": np.arange(18).reshape(SHAPE) % 4 - 1.0},
    ),
}  # fmt: skip
"""Kernels by name, which a comma ends."""


def arrays_of(case: Case) -> dict[str, Any]:
    """Arrays of a kernel: random ones within their range, from -0.3 to 1.3 by default."""
    rng, found = np.random.default_rng(7), dict[str, Any]()
    for name, spec in case.kernel.arguments.items():
        if isinstance(spec, Field | Table):
            sizes = dict(zip(case.kernel.arguments[case.kernel.over].axes, SHAPE, strict=True))  # type: ignore[union-attr]
            shape = tuple(sizes.get(axis, 1) for axis in spec.axes)
            given = case.given.get(name, (-0.3, 1.3))
            found[name] = rng.uniform(given[0], given[1], shape) if isinstance(given, tuple) else np.array(given, float)
    return found


def expected(case: Case, arrays: dict[str, Any]) -> dict[str, Any]:
    """What the formula gives at every voxel; sums, or extremes, of what each gives to partial results."""
    kernel, found = case.kernel, dict[str, Any]()
    for i, j, k in np.ndindex(SHAPE):
        near = (i - 1) ** 2 + (j - 1) ** 2 <= case.numbers.get("reach", 0.0) ** 2
        values = {n: a[i, j, k] if isinstance(kernel.arguments[n], Field) else a for n, a in arrays.items()}
        for name, value in case.formula(SimpleNamespace(**values, **case.numbers, i=i, j=j, k=k, near=near)).items():
            if isinstance(kernel.arguments[name], Field):
                found.setdefault(name, np.zeros(SHAPE))[i, j, k] = value
            else:
                found.setdefault(name, []).append(value)
    folds = {"lows": min, "highs": max}
    return {n: folds.get(n, sum)(value) if isinstance(value, list) else value for n, value in found.items()}


@pytest.mark.parametrize("name", CASES)
def test_a_definition_computes_its_formula(name: str) -> None:
    case = CASES[name]
    arrays = arrays_of(case)
    wanted = expected(case, arrays)
    written = {n for n, spec in case.kernel.arguments.items() if not isinstance(spec, Scalar) and spec.writes}
    assert case.kernel.name == name.split(",")[0] and wanted.keys() == written
    case.kernel.definition(**arrays, **case.numbers)
    for output, value in wanted.items():
        assert np.allclose(arrays[output], value, rtol=1e-12, atol=1e-14), output


def band_loss(v: SimpleNamespace) -> float:
    share = float(v.target >= 0.5) if v.binary else v.target
    made = curve(v.response, v.start, v.density, v.dose)[0]
    off = abs(made - (v.low + (v.high - v.low) * share)) - (v.slack_low + (v.slack_high - v.slack_low) * share)
    gain = (v.gain_low + (v.gain_high - v.gain_low) * share) * (v.weight if v.weighted else 1.0)
    return v.near * (gain * max(off, 0.0) ** v.power + v.ridge * made**2)


def sampled_loss(v: SimpleNamespace) -> float:
    share = float(v.target >= 0.5) if v.binary else v.target
    outer, inner = (curve(samples, v.start, v.density, v.dose)[0] for samples in (v.outer, v.inner))
    return v.near * (v.weight if v.weighted else 1.0) * ((1 - share) * outer + share * inner)


def ramp_loss(v: SimpleNamespace) -> float:
    threshold, weight = v.outside + (v.inside - v.outside) * v.target, v.weight if v.weighted else 1.0
    if v.target >= 0.5:
        error = v.dose - threshold if v.dose < threshold else 0.0
        error += v.dose - v.most if v.dose > v.most else 0.0
    else:
        error = max(v.dose - threshold, 0.0)
    return v.near * weight * error**2 / 2


def dark_loss(v: SimpleNamespace) -> float:
    return v.weight[v.j] * max(v.dose - v.most, 0.0) ** 2 / 2


BAND = {"low": 0.3, "high": 0.8, "slack_low": 0.05, "slack_high": 0.12, "gain_low": 0.7, "gain_high": 1.5, "reach": 1.0}
OF_DOSE = {"dose": (0.0, 1.2), "target": (0.0, 1.0), "weight": (0.0, 2.0), "response": SAMPLES}
SAMPLED = {"outer": SAMPLES, "inner": SAMPLES[::-1] ** 2}
RAMP: dict[str, float] = {"outside": 0.3, "inside": 0.8, "most": 0.9, "reach": 1.0, "hold": 0}
LOSSES: dict[str, Case] = {
    "band, cubic": Case(
        loss.band_loss, band_loss, BAND | CURVE | {"power": 3.0, "ridge": 0.2, "weighted": 1, "binary": 0}, OF_DOSE
    ),
    "band, plain": Case(
        loss.band_loss, band_loss, BAND | CURVE | {"power": 1.0, "ridge": 0.0, "weighted": 0, "binary": 1}, OF_DOSE
    ),
    "sampled": Case(
        loss.sampled_loss, sampled_loss, CURVE | {"weighted": 1, "binary": 0, "reach": 1.0}, OF_DOSE | SAMPLED
    ),
    "sampled, binary": Case(
        loss.sampled_loss, sampled_loss, CURVE | {"weighted": 0, "binary": 1, "reach": 1.0}, OF_DOSE | SAMPLED
    ),
    "ramp": Case(loss.ramp_loss, ramp_loss, RAMP | {"weighted": 1}, OF_DOSE),
    "ramp, plain": Case(loss.ramp_loss, ramp_loss, RAMP | {"weighted": 0}, OF_DOSE),
    "dark": Case(loss.dark_loss, dark_loss, {"most": 0.4}, OF_DOSE),
}
"""Losses of a voxel, whose slopes are their finite differences."""


@pytest.mark.parametrize("name", LOSSES)
def test_the_slope_of_a_loss_is_its_difference(name: str) -> None:
    kernel, voxel, numbers, given = case = LOSSES[name]
    arrays = arrays_of(case)

    def total(dose: np.ndarray) -> np.ndarray:
        return expected(case._replace(formula=lambda v: {"dose": voxel(v)}), arrays | {"dose": dose})["dose"]

    losses, small = total(arrays["dose"]), 1e-6
    slopes = (total(arrays["dose"] + small) - total(arrays["dose"] - small)) / (2 * small)
    kernel.definition(**arrays, **numbers)
    assert np.count_nonzero(losses) >= 4 and arrays["parts"].sum() == pytest.approx(losses.sum(), rel=1e-12)
    assert np.allclose(arrays["dose"], slopes, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("weighted", [0, 1])
def test_a_ramp_gives_the_derivatives_by_its_step_and_leaves_the_dose(weighted: int) -> None:
    case = Case(loss.ramp_loss, ramp_loss, RAMP | {"weighted": weighted, "hold": 1}, OF_DOSE)
    arrays = arrays_of(case)
    before = arrays["dose"].copy()

    def at(more: float) -> float:
        apart = case.numbers | {"outside": 0.3 - more, "inside": 0.8 + more, "most": 0.9 + more}
        formula = case._replace(numbers=apart, formula=lambda v: {"parts": ramp_loss(v)})
        return expected(formula, arrays | {"dose": before})["parts"]

    loss.ramp_loss.definition(**arrays, **case.numbers)
    lower, middle, upper = (at(more) for more in (-1e-5, 0.0, 1e-5))
    assert arrays["slopes"].sum() == pytest.approx((upper - lower) / 2e-5, rel=1e-6)
    assert arrays["bends"].sum() == pytest.approx((upper - 2.0 * middle + lower) / 1e-10, rel=1e-4)
    assert arrays["parts"].sum() == pytest.approx(middle, rel=1e-12) and np.array_equal(arrays["dose"], before)


Rates = Callable[[list[np.ndarray]], list[Any]]


def solved(rates: Rates, state: list[np.ndarray], steps: int = 2000) -> list[np.ndarray]:
    """The state after a time of 1, by the classical method of Runge and Kutta."""
    h = 1.0 / steps
    for _ in range(steps):
        k = [rates(state)]
        for part in (0.5, 0.5, 1.0):
            k.append(rates([s + part * h * rate for s, rate in zip(state, k[-1], strict=True)]))
        state = [s + h / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, *k, strict=True)]
    return state


RATES = {"visible_gain": 0.9, "ultraviolet_gain": 1.3, "cross_gain": 0.2, "alpha": 1.7, "pairing": 0.8, "floor": 0.05}
INHIBITION = {"visible": (0.0, 1.0), "ultraviolet": (0.0, 1.0), "a": (0.2, 1.0), "b": (0.0, 0.5), "c": (0.1, 0.5)}
STATE = {f"{name}_end": (0.0, 1.0) for name in "abcx"}
OXYGEN = {"dose": (0.0, 1.5), "used": (0.0, 0.9), "x": (0.0, 1.0)}


def test_inhibition_solves_its_rates_piece_by_piece() -> None:
    """Half the ultraviolet, half the pairing, the visible light, half the pairing, half the ultraviolet."""
    given, r = (
        arrays_of(Case(inhibition.inhibition_step, lambda v: {}, RATES, INHIBITION | STATE)),
        SimpleNamespace(**RATES),
    )
    light = r.visible_gain * given["visible"] + r.cross_gain * given["ultraviolet"]
    split = 0.5 * r.ultraviolet_gain * given["ultraviolet"]

    def ultraviolet(s: list[np.ndarray]) -> list[Any]:
        return [0.0, 2 * split * s[2], -split * s[2], 0.0]

    def pairing(s: list[np.ndarray]) -> list[Any]:
        return [0.0, -r.pairing * s[1] ** 2, 0.5 * r.pairing * s[1] ** 2, 0.0]

    def visible(s: list[np.ndarray]) -> list[Any]:
        share = light / (s[0] + s[1] + r.floor)
        return [-s[0] * share, -r.alpha * s[1] * share, 0.0, r.floor * share]

    state = [given[name].copy() for name in "abcx"]
    for rates in (ultraviolet, pairing, visible, pairing, ultraviolet):
        state = solved(rates, state, 1000)
    inhibition.inhibition_step.definition(**given, **RATES)
    for name, value in zip("abcx", state, strict=True):
        assert np.allclose(given[f"{name}_end"], value, rtol=0.0, atol=2e-7), name


def test_oxygen_solves_its_rate() -> None:
    numbers = {"gain": 0.9, "floor": 0.03}
    given = arrays_of(Case(inhibition.oxygen_step, lambda v: {}, numbers, OXYGEN))
    light = 0.9 * given["dose"]
    left, x = solved(
        lambda s: [-light * s[0] / (s[0] + 0.03), light * 0.03 / (s[0] + 0.03)], [1 - given["used"], given["x"]]
    )
    inhibition.oxygen_step.definition(**given, **numbers)
    assert np.allclose(given["used_end"], 1 - left, rtol=0.0, atol=1e-10)
    assert np.allclose(given["x_end"], x, rtol=0.0, atol=1e-10)


def differences(step: Kernel, given: dict[str, Any], numbers: dict[str, float], slopes: dict[str, Any], by: str) -> Any:
    """Σ of slopes times the derivative of a step's outputs by an input of it, voxel by voxel."""
    sides = []
    for small in (1e-5, -1e-5):
        arrays = {name: array + small if name == by else array.copy() for name, array in given.items()}
        step.definition(**arrays, **numbers)
        sides.append(sum(slope * arrays[f"{name}_end"] for name, slope in slopes.items()))
    return (sides[0] - sides[1]) / 2e-5


def test_the_adjoint_of_inhibition_has_its_derivatives() -> None:
    given = arrays_of(Case(inhibition.inhibition_step, lambda v: {}, RATES, INHIBITION | STATE))
    slopes = {name: np.random.default_rng(k).uniform(-1, 1, SHAPE) for k, name in enumerate("abcx")}
    wanted = {by: differences(inhibition.inhibition_step, given, RATES, slopes, by) for by in INHIBITION}
    now = {f"{name}_slope": slope.copy() for name, slope in slopes.items()}
    now |= {"visible_slope": np.full(SHAPE, 2.0), "ultraviolet_slope": np.full(SHAPE, 3.0)}
    state = {name: given[name] for name in INHIBITION}
    inhibition.inhibition_adjoint.definition(**state, **now, **RATES)
    for by, value in wanted.items():
        before = {"visible": 2.0, "ultraviolet": 3.0}.get(by, 0.0)
        assert np.allclose(now[f"{by}_slope"] - before, value, rtol=1e-4, atol=1e-6), by


def test_the_adjoint_of_oxygen_has_its_derivatives() -> None:
    numbers = {"gain": 0.9, "floor": 0.03}
    given = arrays_of(Case(inhibition.oxygen_step, lambda v: {}, numbers, OXYGEN))
    slopes = {name: np.random.default_rng(k).uniform(-1, 1, SHAPE) for k, name in enumerate(("used", "x"))}
    wanted = {by: differences(inhibition.oxygen_step, given, numbers, slopes, by) for by in ("used", "dose")}
    now = {"used_slope": slopes["used"].copy(), "x_slope": slopes["x"], "dose_slope": np.full(SHAPE, 2.0)}
    inhibition.oxygen_adjoint.definition(dose=given["dose"], used=given["used"], **now, **numbers)
    assert np.allclose(now["used_slope"], wanted["used"], rtol=1e-4, atol=1e-6)
    assert np.allclose(now["dose_slope"] - 2.0, wanted["dose"], rtol=1e-4, atol=1e-6)
