"""The tunable lens: the paper's table, its matrix, and depths turned into powers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.optics.lens import TunableLens

AIR = TunableLens()


@pytest.mark.parametrize(("index", "slope"), [(1.0, -40.0), (1.33, -53.2), (1.45, -58.0)])
def test_slopes_of_table_s3(index: float, slope: float) -> None:
    lens = replace(AIR, index=index)
    assert lens.slope == pytest.approx(slope, rel=1e-12)
    ends = lens.focus(np.array(lens.powers))
    assert np.diff(ends)[0] / 5.0 == pytest.approx(slope, rel=1e-12)


@pytest.mark.parametrize("power", [5.0, 6.3, 10.0])
def test_matrix_is_the_papers(power: float) -> None:
    lens = TunableLens(focal=(140.0, 160.0, 130.0, 210.0))
    f1, f2, f3, f4 = lens.focal
    bent = power / 1000 + 1 / lens.offset
    paper = [
        [f2 * f4 / (f1 * f3), f1 * f2 * f4 / f3 * bent - f1 * f3 / f2 - f2 * f4 / f3],
        [0.0, f1 * f3 / (f2 * f4)],
    ]
    np.testing.assert_allclose(lens.matrix(power), paper, rtol=1e-12, atol=1e-12)
    assert np.linalg.det(lens.matrix(power)) == pytest.approx(1.0, abs=1e-12)
    assert lens.magnification == pytest.approx(paper[0][0])


@pytest.mark.parametrize("air", [0.0, 60.0])
def test_rays_from_a_mirror_cross_where_focus_says(air: float) -> None:
    lens = TunableLens(focal=(140.0, 160.0, 130.0, 210.0), index=1.33, air=air)
    for power in (5.0, 7.0, 9.5):
        depth = float(lens.focus(power))
        height, angle = lens.matrix(power) @ np.array([[1.0, lens.focal[0]], [0.0, 1.0]]) @ np.array([0.0, 1e-4])
        assert height + angle * air + angle / lens.index * depth == pytest.approx(0.0, abs=1e-12)


def test_shift_is_measured_from_the_lowest_power() -> None:
    lens = replace(AIR, index=1.33)
    powers = np.linspace(5.0, 10.0, 11)
    np.testing.assert_allclose(lens.shift(powers), lens.focus(powers) - lens.focus(5.0), atol=1e-10)
    assert lens.shift(powers).max() == 0.0


def test_powers_of_depths_reach_before_the_axis() -> None:
    lens = replace(AIR, index=1.33)
    depth = np.array([-1.5, -4.5, -7.5])
    power = lens.power(depth, axis=5.2)
    assert (np.diff(power) > 0).all()
    np.testing.assert_allclose(lens.focus(power) - lens.focus(5.2), depth, atol=1e-10)
    coarse = replace(lens, quantum=0.005).power(depth, axis=5.2)
    assert np.abs(coarse - power).max() <= 0.0025 + 1e-12
    np.testing.assert_allclose(coarse / 0.005, np.round(coarse / 0.005), atol=1e-9)


def test_what_cannot_be_focused_is_refused_with_numbers() -> None:
    with pytest.raises(BadInput, match=r"4\.9.*5 to 10 dpt.*-200 mm"):
        AIR.power(4.0)
    with pytest.raises(BadInput, match="11"):
        AIR.focus(11.0)
    with pytest.raises(BadInput, match="bins is"):
        TunableLens(bins=0)
    with pytest.raises(BadInput, match="lowest first"):
        TunableLens(powers=(10.0, 5.0))
    with pytest.raises(BadInput, match="offset is 0"):
        TunableLens(offset=0.0)
    with pytest.raises(BadInput, match="at least 1"):
        TunableLens(index=0.9)
    with pytest.raises(BadInput, match="L1, L2, L3 and L4"):
        TunableLens(focal=(1.0, 2.0))  # type: ignore[arg-type]
