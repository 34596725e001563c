"""Turbidity of a resin, found while it is printed, in images that other rays and finer voxels make."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_print import PLANNED, overlap, printer, setup

from vamgpu.live.darkness import Darkening, Darkness
from vamgpu.live.loop import LiveLoop
from vamgpu.live.printer import Truth, VirtualPrinter
from vamgpu.live.trust import mean_level

UNSURE, USED = 0.25, Truth(inhibitor=0.8, lamp=1.1)
"""Error of the turbidity before the print, and a print that differs from its plan."""


@cache
def loop(error: float = UNSURE) -> LiveLoop:
    made, part, light = setup()
    return replace(made, turbidity=replace(made.turbidity, error=error)).loop(part, light)


def turbid(share: float, truth: Truth = USED) -> VirtualPrinter:
    """A print in resin whose extinction is a share of the assumed one."""
    made, one = setup()[0], printer(truth)
    one.turbidity = replace(made.turbidity, extinction=[share * each for each in made.turbidity.extinction])
    return one


@cache
def watched(share: float, wander: float = 0.0) -> tuple[Darkening, list[Darkness]]:
    """Darkness of every turn of the planned print in such resin; wander: of the camera's gain, from turn to turn."""
    _, _, light = setup()
    live, told, A = turbid(share), loop()._darkening, loop().estimator.operator
    dose, even, seen = live.dose(light), np.asarray(A.T(light)), list[Darkness]()
    for turn in range(1, PLANNED + 1):
        live.turn(dose)
        level = mean_level((1.0 + wander * np.sin(2.0 * turn)) * live.images(), live.camera.shape)
        assert level is not None
        seen.append(told.seen(level, A.device.field((turn - live.resin.dark) * even)))
    return told, seen


@pytest.mark.parametrize("share", [0.8, 1.0, 1.25])
def test_turbidity_is_found_in_used_resin_under_a_lamp_that_nobody_measured(share: float) -> None:
    told, seen = watched(share)
    found, error = told.turbidity(seen, loop().prior)
    assert found == pytest.approx(share, rel=0.1) and abs(found - share) < 2.0 * error < 0.2


def test_every_turn_tells_more_and_clear_images_tell_nothing() -> None:
    told, seen = watched(0.8)
    errors = [told.turbidity(seen[:turns], loop().prior)[1] for turns in (1, 3, PLANNED - 2, PLANNED)]
    assert errors[0] == pytest.approx(UNSURE) and errors[1] == pytest.approx(UNSURE, rel=0.02)
    assert 0.7 * UNSURE > errors[2] > 1.2 * errors[3]
    assert told.turbidity([seen[0], seen[-1]], loop().prior)[1] > 0.9 * UNSURE, "the last turn alone tells nothing"


def test_the_gain_of_a_camera_is_no_turbidity() -> None:
    (told, seen), (_, wandering) = watched(0.8), watched(0.8, 0.2)
    assert told.turbidity(wandering, loop().prior) == pytest.approx(told.turbidity(seen, loop().prior), rel=1e-3)


def test_pixels_that_are_dark_before_the_print_do_not_count() -> None:
    made, part, light = setup()
    field = np.full(made.camera().shape[1:], 800.0)
    field[:, :4] = 0.0
    told = replace(made, open_field=field.tolist()).loop(part, light)._darkening
    assert not told._pixels[:, :4].any() and told._pixels[:, 4:].all()
    assert told._pixels.sum() == pytest.approx(0.0, abs=1e-6 * float(np.abs(told._pixels).sum()))


def test_darkness_that_no_turbidity_explains_widens_the_error() -> None:
    """By a light that wavers by a fifth of the darkness of the planned print."""
    told, seen = watched(0.8)
    usual, errors = told.turbidity(seen, loop().prior)[1], list[float]()
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0.0, 0.2, len(seen))
        wavering = [(dark + each, dose) for (dark, dose), each in zip(seen, noise, strict=True)]
        found, error = told.turbidity(wavering, loop().prior)
        errors.append((found - 0.8) / error)
        assert error > 1.3 * usual
    assert np.sqrt(np.mean(np.square(errors))) < 1.5


def test_a_turbidity_without_error_is_not_fitted() -> None:
    assert loop(0.0)._darkening.turbidity(watched(0.8)[1], loop().prior) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("share", "error"),
    [
        (0.75, UNSURE),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.75, 0.0), (1.3, UNSURE), (1.3, 0.0))),
    ],
)
def test_a_print_in_resin_of_another_turbidity_is_saved_if_that_may_err(share: float, error: float) -> None:
    live, by = turbid(share, Truth(inhibitor=0.7)), loop(error)
    state, decision = by.start(), None
    while decision is None or decision.action != "stop":
        live.turn(live.dose(np.asarray(state.light)))
        state, decision = by.decide(state, live.through())
    assert (overlap(live.printed()) > 0.98) == (error > 0.0)
    assert ("turbidity" in decision.parameters) == (error > 0.0)
    value, spread = decision.parameters.get("turbidity", (share, 1.0))
    assert abs(value - share) < 2.0 * spread
