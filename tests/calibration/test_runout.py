"""A pin's runout over a turn: apart from the axis, in pictures and in numbers, with errors that hold the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from vamgpu.calibration.runout import CameraMap, find_pin, fit_runout
from vamgpu.errors import BadInput, ShapeMismatch

ANGLES = np.radians(np.arange(0.0, 360.0, 15.0))
AXIS, LEAN, ACROSS, TILT = 95.3, 0.006, (2.4, -1.3), (0.01, 0.014)


def pin(column: float, slope: float, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """A pin of 20 pixels before light that falls off to the right."""
    row, place = np.meshgrid(np.arange(100.0), np.arange(200.0), indexing="ij")
    distance = place - column - slope * row
    shade = ndtr((distance + 10.0) / 1.7) - ndtr((distance - 10.0) / 1.7)
    light = (200.0 - 0.1 * place) * (1.0 - 0.95 * shade)
    return light + noise * np.random.default_rng(seed).standard_normal(light.shape)


def turn(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    rng, wave = np.random.default_rng(seed), np.stack([np.cos(ANGLES), np.sin(ANGLES)])
    columns = AXIS + ACROSS @ wave + noise * rng.standard_normal(ANGLES.size)
    return columns, LEAN + TILT @ wave + 0.01 * noise * rng.standard_normal(ANGLES.size)


@pytest.mark.parametrize("slope", [0.0, 0.05, -0.12])
def test_a_pin_is_found_between_its_edges(slope: float) -> None:
    found = find_pin(pin(93.4, slope, noise=2.0)[5:95, 8:190], (5, 8))
    assert found.column == pytest.approx(93.4, abs=0.05) and found.slope == pytest.approx(slope, abs=0.001)
    assert found.width == pytest.approx(20.0, abs=0.2)


def test_without_noise_axis_eccentricity_and_wobble_are_apart() -> None:
    found = fit_runout(ANGLES + 0.2, *turn(0, 0.0))
    turned = complex(*ACROSS) * np.exp(0.2j)
    assert (found.axis, found.lean) == pytest.approx((AXIS, LEAN))
    assert complex(*found.across) == pytest.approx(turned) and found.eccentricity == pytest.approx(abs(turned))
    assert found.wobble == pytest.approx(np.hypot(*TILT)) and found.left < 1e-12
    rows = found.columns(ANGLES + 0.2, 11)
    np.testing.assert_allclose(found.axis + rows[:, 5], turn(0, 0.0)[0])
    np.testing.assert_allclose(np.diff(rows, axis=1)[:, 0], turn(0, 0.0)[1])
    np.testing.assert_allclose(found.columns(ANGLES, 3, turning=False), np.tile([-LEAN, 0.0, LEAN], (24, 1)))


def test_errors_hold_the_truth_as_often_as_they_say() -> None:
    """All poses alike, and poses with a gap; within two standard errors lie 95 % of all."""
    pulls = []
    for seed in range(40):
        found = fit_runout(ANGLES, *turn(seed, 0.1))
        truth = ((found.axis - AXIS) / found.axis_error, (found.lean - LEAN) / found.lean_error,
                 *((a - b) / found.across_error for a, b in zip(found.across, ACROSS, strict=True)),
                 *((a - b) / found.tilt_error for a, b in zip(found.tilt, TILT, strict=True)))  # fmt: skip
        pulls.append(truth)
    assert 0.91 <= (np.abs(pulls) < 2.0).mean() <= 0.99 and 0.8 < np.std(pulls) < 1.25


def test_lit_lines_tell_where_mirrors_lie() -> None:
    row, place = np.meshgrid(np.arange(100.0), np.arange(200.0), indexing="ij")
    columns = [(n, np.exp(-0.5 * (place - 20.0 + 1.7 * (n - 60) - 0.03 * row) ** 2)) for n in range(-40, 80, 9)]
    rows = [(n, np.exp(-0.5 * (row - 10.0 - 1.8 * n) ** 2)) for n in range(0, 90, 9)]
    found = CameraMap.of(columns, rows)
    assert (found.column, found.pitch, found.lean) == pytest.approx((122.0, -1.7, 0.03), abs=0.01)
    assert (found.row, found.height) == pytest.approx((10.0, 1.8), abs=0.01)
    with pytest.raises(BadInput, match="sees 1 of 1 lit rows"):
        CameraMap.of(columns, rows[3:4])
    with pytest.raises(BadInput, match="sees 0 of 2 lit columns"):
        CameraMap.of([(0, np.zeros((9, 9))), (1, np.zeros((9, 9)))], rows)


def test_what_tells_no_runout_is_refused() -> None:
    for picture, why in (
        (100.0 + np.random.default_rng(0).standard_normal((64, 64)), "shadow of one pin"),
        (pin(3.0, 0.0), "light on both sides"),
        (np.full((64, 64), np.nan), "finite"),
        (np.zeros((4, 4)), "16 × 16"),
    ):
        with pytest.raises(BadInput, match=why):
            find_pin(picture)
    columns, slopes = turn(0, 0.1)
    with pytest.raises(BadInput, match="all around a turn"):
        fit_runout(ANGLES[:18], columns[:18], slopes[:18])
    with pytest.raises(BadInput, match="5 angles"):
        fit_runout(ANGLES[::5], columns[::5], slopes[::5])
    with pytest.raises(BadInput, match="not finite"):
        fit_runout(ANGLES, columns * np.nan, slopes)
    with pytest.raises(ShapeMismatch, match="expected one shape"):
        fit_runout(ANGLES, columns[1:], slopes)
