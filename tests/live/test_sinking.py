"""A part that sinks while it is printed, and light that follows it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import shift
from small_print import PLANNED, overlap, printer, setup

import vamgpu
from vamgpu.live.fields import lowered
from vamgpu.live.printer import Truth, VirtualPrinter
from vamgpu.live.sinking import LEAST, USUAL, Sinking

FIRST, SPEED = 3, 0.15
"""Turn after which a print begins to sink, and its speed [pixels per turn]."""


def followed(speed: float, error: float = 0.0, seed: int = 0) -> Sinking:
    """After twelve turns of equal light; the part sinks from turn 5 and is seen from turn 8, with some error."""
    known, noise = Sinking(), np.random.default_rng(seed).normal(0.0, error, 13)
    below, lower = np.empty(0), np.empty(0)  # of the light of each turn: distance from the part, and as assumed
    for turn in range(1, 13):
        known, lower = known.turned(float(lower.size)), lower + known.speed
        below, lower = np.append(below, 0.0) + (speed if turn > 5 else 0.0), np.append(lower, 0.0)
        if turn >= 8:
            known = known.estimated(float((below - lower).mean()) + noise[turn], LEAST, float(turn))
    return known


@pytest.mark.parametrize("speed", [0.15, -0.15, 0.4])
def test_a_speed_is_found_while_the_light_follows(speed: float) -> None:
    known = followed(speed)
    assert known.speed == known.found == pytest.approx(speed, rel=0.15) and known.error < 0.2 * USUAL
    assert abs(known.found - speed) < 2.0 * known.error


def test_a_part_at_rest_does_not_sink() -> None:
    assert followed(0.0).found == 0.0
    some = [followed(0.0, LEAST, seed) for seed in range(100)]
    assert np.mean([each.speed == 0.0 for each in some]) >= 0.9


def test_one_estimate_shows_no_speed() -> None:
    assert Sinking().turned(1.0).estimated(0.5, 0.1, 2.0).speed == 0.0


@pytest.mark.parametrize("down", [0.0, 0.3, 1.0, -1.5])
def test_a_field_is_lowered_linearly_between_slices(down: float) -> None:
    field = np.random.default_rng(4).random((3, 5, 8)).astype(np.float32)
    expected = shift(field, (0.0, 0.0, -down), order=1, mode="nearest")
    device = vamgpu.open_device()
    assert np.allclose(lowered(device.field(field), down).numpy(), expected, atol=1e-6)


def sink(live: VirtualPrinter) -> None:
    """All resin, after a turn; its voxels are half as high as a pixel."""
    if live.turns > FIRST:
        live.state = np.stack([shift(each, (0.0, 0.0, -2.0 * SPEED), order=1, mode="nearest") for each in live.state])


@pytest.mark.slow
def test_a_part_that_sinks_is_printed_better_than_by_any_stop_of_the_plan() -> None:
    made, part, light = setup()
    best, planned = 0.0, printer(Truth(inhibitor=0.7))
    dose = planned.dose(light)
    for _ in range(PLANNED):
        planned.turn(dose)
        sink(planned)
        best = max(best, overlap(planned.printed()))
    loop, live = made.loop(part, light), printer(Truth(inhibitor=0.7))
    state, decision = loop.start(), None
    while decision is None or decision.action != "stop":
        live.turn(live.dose(np.asarray(state.light)))
        sink(live)
        state, decision = loop.decide(state, live.through())
    found = overlap(live.printed())
    assert found > best + 0.08 and decision.iou < found and not decision.doubt
    speed, error = decision.parameters["sinking"]
    assert speed == pytest.approx(SPEED * made.pixel, rel=0.15) and error < 0.25 * speed
