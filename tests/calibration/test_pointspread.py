"""What an edge of mirrors tells of the optics alone, and results of `vam calibrate mtf` that are read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from vamgpu.calibration.mtf import slanted_edge
from vamgpu.calibration.pointspread import PointSpread
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Beam

PIXEL, SAMPLES, MIRROR = 0.01, 4, 5
"""Of the camera [mm], samples within it along each axis, camera's pixels to a mirror."""
PITCH = MIRROR * PIXEL
ROWS = 57
"""Of mirrors: the edge crosses five columns, so that it falls on all fractions of a mirror alike."""


def seen(sigma: float, fill: float) -> np.ndarray:
    """Mirrors of 50 µm on one side of an edge slanted by 5°, through optics of this blur [mm], by the camera."""
    n = SAMPLES * MIRROR
    row, column = (np.arange(count) - 0.5 * (count - 1) for count in (ROWS, 40))
    on = column[None, :] > np.tan(np.radians(5.0)) * row[:, None]
    inside = np.abs((np.arange(n) + 0.5) / n - 0.5) < 0.5 * np.sqrt(fill)
    light: Any = np.kron(on, np.outer(inside, inside)).astype(float)
    blurred: Any = gaussian_filter(light, sigma / (PIXEL / SAMPLES), mode="reflect")
    shape = (blurred.shape[0] // SAMPLES, SAMPLES, blurred.shape[1] // SAMPLES, SAMPLES)
    return blurred.reshape(shape).mean(axis=(1, 3))


@pytest.mark.parametrize(("sigma", "fill"), [(0.5 * PITCH, 1.0), (1.0 * PITCH, 1.0), (0.7 * PITCH, 0.64)])
def test_an_edge_of_mirrors_gives_back_the_optics(sigma: float, fill: float) -> None:
    edge = slanted_edge(seen(sigma, fill), PIXEL)
    assert edge.width > 1.03 * sigma
    found = PointSpread.behind(edge.width, PITCH, fill, PIXEL)
    assert found.width == pytest.approx(sigma, rel=0.02)
    assert Beam((4, 4), PITCH, fill, found).sigma == pytest.approx(sigma / PITCH, rel=0.02)


def result(path: Path, text: str = "") -> Path:
    file = path / "result.toml"
    file.write_text(
        text or 'calibration = "mtf"\n[measured]\npositions_mm = [-6.0, 0.5, 6.0]\n'
        "blur_mm = [0.08, 0.05, 0.07]\npixel_mm = 0.01\n", encoding="utf-8")  # fmt: skip
    return file


def test_a_saved_result_is_read_at_the_place_of_the_axis(tmp_path: Path) -> None:
    file = result(tmp_path)
    for place in (file, tmp_path):
        wanted = (0.05**2 - (0.9 * 0.067**2 + 0.01**2) / 12) ** 0.5
        assert PointSpread.load(place, 0.067, 0.9).width == pytest.approx(wanted)
    assert PointSpread.load(tmp_path, 0.067, at=5.0).width > PointSpread.load(tmp_path, 0.067).width


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('calibration = "focus"\n', "calibration 'focus'; expected 'mtf'"),
        ("[measured]\n", "calibration 'none'; expected 'mtf'"),
        ('calibration = "mtf"\n[measured]\nblur_mm = [0.05]\n', "has malformed numbers: 'positions_mm'"),
        ('calibration = "mtf"\n[measured]\npositions_mm = [0.0, 1.0]\nblur_mm = [0.05]\npixel_mm = 0.01\n',
         "2 positions and 1 blurs"),
        ('calibration = "mtf"\n[measured]\npositions_mm = [0.0]\nblur_mm = [0.015]\npixel_mm = 0.01\n',
         "15 µm, but projector pixels of 67 µm.*alone blur it by 19.6 µm; expected .*correct the beam's pitch"),
        ('calibration = "mtf"\n[measured]\npositions_mm = [0.0]\nblur_mm = [nan]\npixel_mm = 0.01\n', "blur"),
        ("calibration = \n", "not valid TOML"),
    ],
)  # fmt: skip
def test_a_result_that_tells_no_spread_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        PointSpread.load(result(tmp_path, text), 0.067)
    with pytest.raises(StorageError, match="cannot read the calibration .*nowhere"):
        PointSpread.load(tmp_path / "nowhere", 0.067)
