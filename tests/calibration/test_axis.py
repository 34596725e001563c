"""The roller's axis from synthetic line scans with noise, uneven light and blur, and what `pack` does with it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from vamgpu.backend import open_device
from vamgpu.calibration.axis import find_axis
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.printing.pack import pack

COLUMNS = 1920
RADIUS = 7.5 / 0.0144
"""The paper's roller in columns of 14.4 µm."""


def scan(axis: float, radius: float, seed: int, noise: float = 0.01, blur: float = 2.5) -> np.ndarray:
    """A photodiode's readings behind a roller: a beam brighter in the middle, blurred edges, stray light, noise."""
    x = np.arange(COLUMNS, dtype=float)
    beam = np.exp(-0.5 * ((x - 900.0) / 1400.0) ** 2)
    inside = x[:, None] + np.linspace(-0.49, 0.49, 50)
    past = 0.5 * (1.0 + erf((np.abs(inside - axis) - radius) / (np.sqrt(2.0) * blur))).mean(axis=1)
    rng = np.random.default_rng(seed)
    return 3.0 * beam * past + 0.11 + 3.0 * noise * rng.standard_normal(COLUMNS)


@pytest.mark.parametrize("seed", range(24))
def test_two_edges_give_the_axis_within_a_tenth_of_a_pixel(seed: int) -> None:
    axis = 955.0 + 11.0 * np.random.default_rng(seed + 1000).random()
    found = find_axis(scan(axis, RADIUS, seed))
    assert found.column == pytest.approx(axis, abs=0.1)
    assert found.radius == pytest.approx(RADIUS, abs=0.1)
    assert 0 < found.error < 0.05
    assert [edge.rising for edge in found.edges] == [False, True]
    assert found.edges[0].width == pytest.approx(2.5, abs=0.3)


@pytest.mark.parametrize("blur", [0.05, 0.4, 15.0])
def test_sharp_and_soft_edges_give_the_axis_too(blur: float) -> None:
    for seed in range(6):
        axis = 955.0 + 11.0 * np.random.default_rng(seed).random()
        assert find_axis(scan(axis, RADIUS, seed, 0.005, blur)).column == pytest.approx(axis, abs=0.1)


@pytest.mark.parametrize("side", [-1, 1])
def test_one_edge_needs_the_radius(side: int) -> None:
    axis = 960.0 + side * 700.3
    for seed in range(8):
        read = scan(axis, RADIUS, seed)
        assert find_axis(read, radius=RADIUS).column == pytest.approx(axis, abs=0.1)
        with pytest.raises(BadInput, match=r"one edge, at column \d+.*radius="):
            find_axis(read)


def test_errors_are_what_the_scatter_of_many_scans_says() -> None:
    found = [find_axis(scan(961.3, RADIUS, seed)) for seed in range(40)]
    assert np.std([f.column for f in found]) == pytest.approx(np.mean([f.error for f in found]), rel=0.4)
    assert np.mean([f.column for f in found]) == pytest.approx(961.3, abs=0.02)


def test_errors_hold_the_truth_as_often_as_they_say() -> None:
    """Scans of many axes, by both edges and by one; within two standard errors lie 95 % of all."""
    places = 955.0 + 11.0 * np.random.default_rng(7).random(24)
    scans = [scan(axis, RADIUS, seed) for seed, axis in enumerate(places)]
    both = [find_axis(each) for each in scans]
    one = [find_axis(each[: COLUMNS // 2], radius=RADIUS) for each in scans]
    for found in (both, one):
        pulls = [(each.column - axis) / each.error for each, axis in zip(found, places, strict=True)]
        assert (np.abs(pulls) < 2.0).mean() >= 0.87 and 0.6 < np.std(pulls) < 1.4


def test_a_coarse_scan_is_still_sub_pixel() -> None:
    at = np.arange(0, COLUMNS, 3)
    for seed in range(8):
        found = find_axis(scan(958.7, RADIUS, seed, noise=0.005)[at], at)
        assert found.column == pytest.approx(958.7, abs=0.1)


@pytest.mark.parametrize("flip_r", [False, True])
def test_the_shift_puts_the_axis_of_pictures_on_the_roller(flip_r: bool) -> None:
    light = np.zeros((1, 41, 3))
    light[0, 20] = 1.0
    plan = SimpleNamespace(sinogram=open_device("numpy").upload(light))
    axis = find_axis(scan(955.0, RADIUS, 3, noise=0.0))
    shift = axis.shift(COLUMNS, flip_r=flip_r)
    assert shift == pytest.approx((-1 if flip_r else 1) * (955.0 - 959.5), abs=0.01)
    frames = pack(plan, flip_r=flip_r, shift=(shift, 0.0), scale=1.0)  # type: ignore[arg-type]
    row = frames.levels()[0, 1].astype(float)
    center = (row * np.arange(41)).sum() / row.sum()
    assert center - 20.0 == pytest.approx(955.0 - 959.5, abs=0.02)


def test_bad_scans_are_refused_with_numbers() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(BadInput, match="noise of"):
        find_axis(1.0 + 0.01 * rng.standard_normal(400))
    with pytest.raises(BadInput, match="noise of"):
        find_axis(np.full(100, 2.0))
    with pytest.raises(BadInput, match="4 edges"):
        find_axis(np.minimum(scan(400.0, 100.0, 1, 0.0), scan(1400.0, 100.0, 1, 0.0)))
    with pytest.raises(BadInput, match="light lies between"):
        find_axis(4.0 - scan(960.0, RADIUS, 1))
    with pytest.raises(BadInput, match="has 5 readings"):
        find_axis(np.ones(5))
    with pytest.raises(ShapeMismatch, match="one for each"):
        find_axis(np.ones(50), np.arange(49))
    with pytest.raises(BadInput, match="do not rise"):
        find_axis(np.ones(50), np.arange(50)[::-1])
    with pytest.raises(BadInput, match="not finite"):
        find_axis(np.full(50, np.nan))
    with pytest.raises(BadInput, match="radius"):
        find_axis(scan(960.0, RADIUS, 1), radius=-1.0)
