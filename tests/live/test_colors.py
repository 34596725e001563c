"""Light of two colors for the turns that remain, proved by the kinetics at every pose."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from vamgpu.chemistry.species import Rates
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.live import ColorReplanner
from vamgpu.live.replan import Replanned
from vamgpu.methods.joint import KineticModel, LossWeights, Pair, SpeciesFields, TwoColorResin, optimize_colors
from vamgpu.operators.projection import Projection
from vamgpu.optics.vat import Vat

TURNS, SHOWN, POSES = 4, 2, 24
WEIGHTS = LossWeights(0.7, 1.4, 1.6)
SOLID = 1.05
"""The middle between outside and inside."""
LAMPS = {"visible": {"visible": 0.8}, "ultraviolet": {"ultraviolet": 0.8}}


@cache
def setup() -> tuple[np.ndarray, KineticModel, Pair, ColorReplanner]:
    """Part, model, light of one turn of the plan, and a replanner."""
    beam, grid = Beam((22, 2), 0.1, spread=0.0), Grid((22, 22, 2), 0.1)
    vats = (Vat(2.2, radius=1.1, absorption=mu) for mu in (0.05, 0.1))
    A, B = (Projection(grid, beam, Turntable(POSES, lit_share=0.0), vat, "numpy") for vat in vats)
    x, y, _ = np.meshgrid(*grid.axes(), indexing="ij")
    part = ((np.hypot(x, y) < 0.75) & (np.hypot(x - 0.2, y) > 0.26)).astype(float)
    rates = Rates(k_a=1 / 30, k_b=0.2138 / 30, k_c=1 / 30, k_2=0.43, supply=5.0)
    model = KineticModel(A, B, TwoColorResin.of(rates, A, B), TURNS, period=10.0, runs=6)
    light = optimize_colors(model, part, WEIGHTS, 16, warm=5).light
    most = (2.0 * float(light.visible.numpy().max()), 2.0 * float(light.ultraviolet.numpy().max()))
    return part, model, light, ColorReplanner(part, model, most, WEIGHTS)


def lit(light: Pair, turns: int, start: SpeciesFields | None = None, **lamps: Any) -> SpeciesFields:
    """What really becomes of the resin: every pose by itself, in two steps."""
    A, B = setup()[1].operators
    fine = KineticModel(A, B, setup()[1].resin, turns, period=10.0, runs=POSES, steps=2)
    return fine.going_on(turns, start, **lamps).state(light)


def judged(state: SpeciesFields) -> tuple[float, float, float, float]:
    """Overlap at the threshold, strict window, greatest effective dose of the void, least of the part."""
    part, model, _, _ = setup()
    dose = state.effective_dose(model.resin).numpy()
    inside, reach = part > 0.5, model.operators[0].grid.cylinder()[:, :, None] & np.ones(part.shape, bool)
    solid, leak = (dose > SOLID) & reach, float(dose[~inside & reach].max())
    window = (dose[inside].min() - leak) / dose.max()
    return float((solid & inside).sum() / (solid | inside).sum()), float(window), leak, float(dose[inside].min())


def replanned(evaluations: float = 10, **lamps: Any) -> Replanned[Any]:
    _, model, light, replanner = setup()
    believed = model.going_on(SHOWN, **lamps).state(light)
    return replanner.replan(
        model.going_on(1, **lamps), believed, light, TURNS - SHOWN, range(TURNS), evaluations=evaluations
    )


@pytest.mark.parametrize("weak", LAMPS)
def test_a_lamp_of_one_color_that_is_weak_is_made_up_for(weak: str) -> None:
    _, _, light, replanner = setup()
    nominal = judged(lit(light, TURNS))
    lamps: dict[str, Any] = LAMPS[weak]
    there = lit(light, SHOWN, **lamps)
    unchanged = judged(lit(light, TURNS - SHOWN, there, **lamps))
    found = replanned(20, **lamps)
    now = judged(lit(found.light, found.expected.turns, there, **lamps))
    assert nominal[0] == now[0] == 1.0 and now[1] > nominal[1] - 0.01 and now[3] > nominal[3] - 0.02
    if weak == "visible":
        assert unchanged[0] < 0.97
    else:
        assert unchanged[1] < nominal[1] - 0.01 and now[2] < unchanged[2] - 0.01, "what was not inhibited is now"
    assert found.evaluations <= 20 and found.expected.iou == pytest.approx(now[0], abs=0.01)
    assert found.expected.window == pytest.approx(now[1], abs=0.02) and found.kept.turns == TURNS - SHOWN
    for part, most in zip(found.light, replanner.most, strict=True):
        assert part.numpy().min() >= 0.0 and part.numpy().max() <= most * (1.0 + 1e-5)


def test_no_pixel_is_brighter_than_its_projector() -> None:
    part, model, light, _ = setup()
    most = tuple(float(each.numpy().max()) for each in light)
    tight = ColorReplanner(part, model, (most[0], 0.5 * most[1]), WEIGHTS)
    delivered = model.going_on(SHOWN, visible=0.6).state(light)
    found = tight.replan(model.going_on(1, visible=0.6), delivered, light, 2, range(1, 3), evaluations=12)
    assert found.expected.turns == 2 and found.expected is not found.kept
    for each, bound in zip(found.light, tight.most, strict=True):
        assert each.numpy().max() == pytest.approx(bound, rel=1e-5)


def test_a_state_in_between_is_that_of_one_run() -> None:
    _, model, light, _ = setup()
    between = model.going_on(TURNS - 1, model.going_on(1).state(light))
    whole, parts = model.state(light), between.state(light)
    for one, two in zip(whole, parts, strict=True):
        assert np.array_equal(one.numpy(), two.numpy())
    assert np.array_equal(model.expose(light).numpy(), whole.effective_dose(model.resin).numpy())
    assert np.array_equal(between.state(light).oxygen.numpy(), parts.oxygen.numpy()), "the start stays as it is"


def test_the_gradient_from_a_state_is_that_of_differences() -> None:
    _, model, light, _ = setup()
    rest = model.going_on(2, model.going_on(1).state(light), visible=0.9)
    device, rng = rest.device, np.random.default_rng(3)
    slope = rng.standard_normal(rest.operators[0].domain.shape).astype(np.float32)
    rest.expose(light)
    gradient = rest.gradient(device.upload(slope))
    for color in range(2):
        way = rng.random(light[color].shape) * light[color].numpy()
        sides = []
        for sign in (-1, 1):
            moved = [part.numpy().astype(np.float32) for part in light]
            moved[color] = (moved[color] + sign * 1e-2 * way).astype(np.float32)
            dose = rest.expose(Pair(*(device.upload(part) for part in moved))).numpy().astype(float)
            sides.append(float((dose * slope).sum()))
        found = float((gradient[color].numpy().astype(float) * way).sum())
        assert found == pytest.approx((sides[1] - sides[0]) / 2e-2, rel=2e-2, abs=1e-3)


def test_the_same_light_is_found_each_time_and_more_looks_find_no_worse() -> None:
    few, again, more = (replanned(n, visible=0.8) for n in (4, 4, 12))
    for one, two in zip(few.light, again.light, strict=True):
        assert np.array_equal(one.numpy(), two.numpy())
    assert [each.evaluations for each in (few, again, more)] == [4, 4, 12]
    assert more.expected.window >= few.expected.window


def test_a_print_that_has_its_dose_is_stopped_and_one_that_has_none_waits() -> None:
    part, model, light, replanner = setup()
    whole = model.state(light)
    content = ColorReplanner(part, model, replanner.most, LossWeights(0.9, 1.1, 1.9))
    found = content.replan(model, whole, light, 1, range(3), evaluations=3)
    assert found.expected.turns == 0 and not any(part.numpy().any() for part in found.light)
    assert found.expected.iou == 1.0
    none = replanner.replan(model, whole, light, 0, [0], evaluations=3)
    assert none.expected.turns == none.kept.turns == 0 and none.evaluations == 0.0


def test_void_that_is_solid_and_part_that_has_too_much_have_no_weight() -> None:
    part, model, light, replanner = setup()
    now = model.going_on(SHOWN).state(light).effective_dose(model.resin).numpy()
    assert replanner._loss(model, model.device.upload(now), 0.0).weight is None
    where = tuple(np.argwhere(part < 0.5)[200])
    inside = tuple(np.argwhere(part > 0.5)[7])
    now[where], now[inside] = 1.45, 1.65
    weight = replanner._loss(model, model.device.upload(now), 0.01).weight
    assert {tuple(at) for at in np.argwhere(weight == 0)} == {where, inside}
    assert replanner._loss(model, model.device.upload(now), 0.2).weight is None


def test_nonsense_is_refused() -> None:
    part, model, light, replanner = setup()
    state = model.going_on(1).state(light)
    bad = state._replace(lophyl=np.full(part.shape, np.nan))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="NaN"):
        replanner.replan(model, bad, light, 1, [1], evaluations=3)
    with pytest.raises(BadInput, match="whole numbers"):
        replanner.replan(model, state, light, 1, [], evaluations=3)
    with pytest.raises(BadInput, match="visible lamp"):
        model.going_on(1, state, visible=0.0)
    with pytest.raises(ShapeMismatch):
        model.going_on(1, state._replace(supply=np.ones((2, 2, 2))))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="greatest ultraviolet light"):
        ColorReplanner(part, model, (1.0, float("nan")))
