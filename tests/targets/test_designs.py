"""Test patterns, and the figure of merit of the calibration disk."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.metrics.merit import acceptable, merit
from vamgpu.targets.designs import (
    BLOCKS,
    Block,
    covered,
    dot_array,
    gray_wedges,
    side,
    usaf,
    usaf_bars,
)
from vamgpu.targets.shapes import exposure_disk
from vamgpu.targets.target import Target


def test_a_slice_has_its_diagonal_on_the_diameter() -> None:
    target = dot_array(80, 300)
    assert np.hypot(*target.grid.shape[:2]) * target.grid.pitch == pytest.approx(30.0)
    assert dot_array(80).grid.shape == (1500, 1500, 1)


@pytest.mark.parametrize("count", [80, 800, 1300])
def test_dots_have_their_period_and_area(count: int) -> None:
    plane = dot_array(count, 1500).numpy()[:, :, 0].astype(np.float64)
    period, pitch = 30.0 / count, side() / 1500
    dots = 2 * int(0.5 * side() / period) + 1
    if (dots // 2 + 0.25) * period > 0.5 * side():
        dots -= 2
    assert plane.sum() * pitch**2 == pytest.approx(dots**2 * (0.5 * period) ** 2, rel=1e-5)
    spectrum = np.abs(np.fft.rfft(plane[plane.sum(axis=1).argmax()] - plane.mean(), 2**16))
    frequency = np.fft.rfftfreq(2**16, pitch)
    if period > 2 * pitch:
        band = frequency > 0.5 / period
        assert frequency[band][spectrum[band].argmax()] == pytest.approx(1.0 / period, rel=0.01)


def test_coverage_is_exact() -> None:
    np.testing.assert_allclose(covered(4, 1.0, [-1.5], [0.25]), [0.5, 1.0, 0.25, 0.0])
    assert covered(7, 0.3, [-0.7, 0.1], [-0.6, 0.55]).sum() * 0.3 == pytest.approx(0.55)


def test_bars_double_every_group_and_keep_apart() -> None:
    bars = usaf_bars()
    assert [(b.group, b.element) for b in bars] == [(g, e) for g in (-2, -1, 0, 1) for e in range(1, 7)]
    ratios = [b.frequency / a.frequency for a, b in zip(bars, bars[1:], strict=False)]
    np.testing.assert_allclose(ratios, 2 ** (1 / 6))
    boxes = [box for b in bars for box in b.boxes()]
    assert len(boxes) == 144
    for k, (a, b, c, d) in enumerate(boxes):
        assert max(abs(v) for v in (a, b, c, d)) <= 0.5 * side()
        assert all(b <= p or q <= a or d <= r or s <= c for p, q, r, s in boxes[:k])
    plane = usaf(pixels=400)
    area = sum((b - a) * (d - c) for a, b, c, d in boxes)
    assert plane.volume / plane.grid.pitch == pytest.approx(area, rel=1e-5)


def test_wedges_have_their_grays() -> None:
    target = gray_wedges(6, 240)
    plane, place = target.numpy()[:, :, 0], target.grid.axes()[0]
    angles = 2 * np.pi * (np.arange(6) + 0.5) / 6
    read = [plane[np.abs(place - 5 * np.cos(a)).argmin(), np.abs(place - 5 * np.sin(a)).argmin()] for a in angles]
    np.testing.assert_allclose(read, np.arange(1, 7) / 6, atol=1e-6)
    radius = 0.45 * side()
    assert plane.sum(dtype=float) * target.grid.pitch**2 == pytest.approx(np.pi * radius**2 * 3.5 / 6, rel=1e-3)


@pytest.mark.parametrize("name", ["W1", "W3"])
def test_blocks_have_their_volume(name: str) -> None:
    block = BLOCKS[name]
    target = block.target(0.2)
    x, y, z = block.size
    a, b, c = ((n + 1) * block.strut for n in block.cells)
    assert target.volume == pytest.approx(a * b * z + b * c * x + a * c * y - 2 * a * b * c, rel=1e-4)
    assert target.radius <= target.grid.inscribed_radius
    assert block.cells == ((13, 13, 12) if name == "W1" else (5, 5, 6)) and block.void == 2 * block.strut


def test_a_block_is_hollow() -> None:
    block = Block((2, 2, 2), 0.4, 0.8)
    fraction = block.target(0.1).numpy()
    middle = tuple(n // 2 for n in fraction.shape)
    assert fraction[middle] == pytest.approx(1.0)  # where struts cross
    assert fraction[middle[0] - 6, middle[1] - 6, middle[2] - 6] == 0.0  # a compartment
    assert fraction[middle[0] - 6, middle[1], middle[2]] == pytest.approx(1.0)  # a strut along x


def disk(device: str) -> tuple[np.ndarray, float]:
    target = Target.from_mesh(exposure_disk(thickness=4 * 0.067), factor=1.0, pitch=0.067, device=device)
    return target.numpy()[:, :, 1], target.grid.pitch


def test_an_ideal_print_has_merit_seven(processor: str) -> None:
    plane, pitch = disk(processor)
    found = merit(plane >= 0.5, pitch)
    assert found.figure == 7 and found.least_spoke == 1 and found.least_gap == 2


def test_growth_closes_gaps_and_shrinkage_breaks_spokes(processor: str) -> None:
    from scipy.ndimage import distance_transform_edt

    plane, pitch = disk(processor)
    solid = plane >= 0.5
    outside, inside = (np.asarray(distance_transform_edt(which)) for which in (~solid, solid))
    grown, shrunk = merit(outside <= 2.1, pitch), merit(inside > 2.0, pitch)
    assert grown.spokes == (True,) * 7
    assert grown.gaps[:2] == (True, True) and not grown.gaps[-1] and 0 < grown.figure < 7
    assert shrunk.gaps == (False,) * 7
    assert shrunk.spokes[:3] == (False,) * 3 and shrunk.spokes[-1]
    assert merit(np.ones_like(solid), pitch).figure == 0


def test_a_half_disk_that_is_gone_is_not_connected(processor: str) -> None:
    plane, pitch = disk(processor)
    place = (np.arange(len(plane)) - 0.5 * (len(plane) - 1)) * pitch
    core = np.hypot(place[:, None], place[None, :]) < 6.0
    assert merit(core, pitch).figure == 0
    with pytest.raises(BadInput, match="middle of the disk"):
        merit(np.zeros_like(core), pitch)


def test_the_acceptable_range_is_where_the_mean_exceeds_two() -> None:
    figures = [[1, 2], [3, 3], [4, 2], [2, 2], [5, 5]]
    assert acceptable((1.0, 2.0, 3.0, 4.0, 5.0), figures) == (2.0, 3.0)
    assert acceptable((1.0, 2.0), [[0], [0]]) is None
    with pytest.raises(BadInput):
        acceptable((2.0, 1.0), [[0], [0]])


def test_bad_input() -> None:
    with pytest.raises(BadInput, match="duty"):
        dot_array(80, 100, duty=1.0)
    with pytest.raises(BadInput):
        dot_array(0)
    with pytest.raises(BadInput):
        usaf_bars(())
    with pytest.raises(BadInput):
        Block((1, 1, 0), 0.1, 0.1)
