"""The stop by scattered light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.printing.scatter import STOP, ScatterStop


def frames(part: float, rate: float, dark: float = 2.0) -> Iterator[tuple[float, np.ndarray]]:
    """A camera on a part that starts to scatter after 30 s, in proportion to its volume."""
    for k in range(200):
        glow = max(0.0, 0.5 * k - 30.0) * rate * part
        yield 0.5 * k, np.full((20, 30), dark + glow / 600.0, np.float32)


def test_density_is_that_of_the_equation() -> None:
    stop = ScatterStop(voxels=50.0, threshold=1.0)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (4, 9, 7), np.uint8)
    found = [stop.see(float(k), image).density for k, image in enumerate(images)]
    wanted = images.reshape(4, -1).astype(float).sum(1) / 50.0
    assert found == pytest.approx(list(wanted - wanted[0]))


@pytest.mark.parametrize("part", [1e3, 4e5])
@pytest.mark.parametrize("dark", [0.0, 11.0])
def test_the_stop_depends_neither_on_the_part_nor_on_the_background(part: float, dark: float) -> None:
    stop = ScatterStop(voxels=part)
    assert stop.watch(frames(part, 0.11, dark)) == 33.5
    assert stop.crossing == pytest.approx(30.0 + STOP / 0.11, abs=1e-3)
    assert stop.readings[-1].seconds == 33.5


def test_a_faster_resin_stops_sooner() -> None:
    fresh, used = ScatterStop(1e4), ScatterStop(1e4)
    times = fresh.watch(frames(1e4, 0.03)), used.watch(frames(1e4, 0.07))
    assert times == (42.0, 35.0) and fresh.crossing == pytest.approx(30.0 + STOP / 0.03, abs=0.02)


def test_a_flash_stops_only_who_does_not_wait() -> None:
    def flashing() -> Iterator[tuple[float, np.ndarray]]:
        for seconds, image in frames(1e4, 0.11):
            yield seconds, image + (100.0 if seconds == 10.0 else 0.0)

    assert ScatterStop(1e4).watch(flashing()) == 10.0
    waiting = ScatterStop(1e4, steady=3)
    assert waiting.watch(flashing()) == 34.5 and waiting.crossing == pytest.approx(30.0 + STOP / 0.11, abs=1e-3)


def test_frames_that_end_first_stop_nothing() -> None:
    stop = ScatterStop(1e4, threshold=1e3)
    assert stop.watch(frames(1e4, 0.1)) is None and stop.crossing is None


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: ScatterStop(0.0), "voxels"),
        (lambda: ScatterStop(10.0, threshold=-1.0), "threshold"),
        (lambda: ScatterStop(10.0, steady=0), "steady"),
        (lambda: ScatterStop(10.0).see(0.0, np.zeros(4)), "shape"),
        (lambda: ScatterStop(10.0).see(0.0, np.full((2, 2), np.nan)), "finite"),
        (lambda: ScatterStop(10.0).watch([(0.0, np.zeros((2, 2))), (0.0, np.zeros((2, 2)))]), "rising times"),
        (lambda: ScatterStop(10.0).watch([(0.0, np.zeros((2, 2))), (1.0, np.zeros((3, 2)))]), "shape"),
    ],
)
def test_impossible_values_are_refused_by_name(make: Any, complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        make()
