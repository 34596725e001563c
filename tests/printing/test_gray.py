"""Gray curves: what they accept, what their levels are worth, and the nearest level to a light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vamgpu.errors import BadInput, StorageError
from vamgpu.printing.gray import GrayCurve

MEASURED = """
[projector]
name = "bench"

[gray]
levels = [0, 32, 64, 128, 192, 255]
intensity = [0.9, 1.1, 4.0, 20.0, 61.0, 90.0]   # mW/cm², photodiode
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "projector.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_measured_curve_is_read_and_made_relative(tmp_path: Path) -> None:
    curve = GrayCurve.load(write(tmp_path, MEASURED))
    assert curve.black == pytest.approx(0.01)
    assert curve(255) == 1.0
    assert curve(160) == pytest.approx((20.0 + 61.0) / 2 / 90.0)
    assert GrayCurve.parse(curve.describe()) == curve


def test_linear_and_gamma() -> None:
    assert np.allclose(GrayCurve.linear().table(8), np.arange(256) / 255)
    assert np.allclose(GrayCurve.linear(black=0.02)([0, 255]), [0.02, 1.0])
    curve = GrayCurve.gamma(2.2, black=0.01)
    assert curve(128) == pytest.approx(0.01 + 0.99 * (128 / 255) ** 2.2)
    assert np.array_equal(curve.table(1), [0.01, 1.0])


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
    st.lists(st.floats(-0.2, 1.3), min_size=1, max_size=20),
)
def test_the_inverse_is_the_nearest_level(steps: list[float], wanted: list[float]) -> None:
    curve = GrayCurve((0, 40, 99, 200, 255), tuple(np.cumsum([0.05, *steps[:3], steps[3] + 0.1])))
    light = curve.table(8)
    for aim, level in zip(wanted, curve.inverse(wanted), strict=True):
        assert abs(light[level] - aim) <= np.abs(light - aim).min() + 1e-12


def test_every_level_of_a_strict_curve_comes_back() -> None:
    curve = GrayCurve.gamma(1.8, black=0.03)
    assert np.array_equal(curve.inverse(curve.table(8)), np.arange(256))
    assert curve.inverse(0.0) == 0 and curve.inverse(7.0) == 255


@pytest.mark.parametrize(
    ("levels", "intensity", "says"),
    [
        ((0, 255), (0.0, 0.5, 1.0), "one intensity per level"),
        ((0,), (1.0,), "at least two"),
        ((0, 128), (0.0, 1.0), "from 0 to 255"),
        ((1, 255), (0.0, 1.0), "from 0 to 255"),
        ((0, 128, 128, 255), (0, 1, 2, 3), "rising"),
        ((0, 12.5, 255), (0, 1, 2), "whole numbers"),
        ((0, 128, 255), (0.0, 0.6, 0.5), "falls from 0.6 at level 128"),
        ((0, 255), (-0.1, 1.0), "black"),
        ((0, 255), (1.0, 1.0), "black < full-on"),
        ((0, 255), (0.0, float("nan")), "finite"),
        ((0, 255), (0.0, "bright"), "list of numbers"),
    ],
)
def test_bad_curves_are_refused_with_a_reason(levels: tuple, intensity: tuple, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        GrayCurve(levels, intensity)


def test_bad_parameters_are_refused() -> None:
    with pytest.raises(BadInput, match="exponent"):
        GrayCurve.gamma(0.0)
    with pytest.raises(BadInput, match="black"):
        GrayCurve.linear(black=1.0)
    with pytest.raises(BadInput, match="1 or 8"):
        GrayCurve.linear().table(4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[gray]\nlevels = 0, 255\n", "line 2"),
        ("[lens]\npower = 1\n", r"no table \[gray\]"),
        ("[gray]\nlevels = [0, 255]\n", "expected levels and intensity"),
        ("[gray]\nlevels = [0, 255]\nintensity = [2.0, 1.0]\n", r"projector.toml, \[gray\]: intensity falls"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        GrayCurve.load(write(tmp_path, text))


def test_a_missing_file_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="check the path"):
        GrayCurve.load(tmp_path / "nowhere.toml")
