"""The surface of a print against one whose place is known: a cube whose dose falls towards its faces."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.live.border import FARTHEST, Border


def cube(half: float) -> np.ndarray:
    """Dose that falls by 0.05 per voxel and is 0.8 at the faces of a cube of an edge of twice ``half`` [voxels]."""
    places = np.meshgrid(*3 * [np.arange(32) - 15.5], indexing="ij")
    return 0.8 + 0.05 * (half - np.abs(places).max(axis=0))


BORDER = Border((cube(10.0) >= 0.8).astype(np.float32), 0.8)


def test_a_surface_that_is_off_is_told_to_the_voxel() -> None:
    for farther in (-1.0, -0.3, 0.0, 0.6, 1.2):
        assert BORDER.off(cube(10.0 + farther)) == pytest.approx(abs(farther), abs=1e-6)
    assert BORDER.off(0.0 * cube(10.0)) == FARTHEST


def test_the_share_that_brings_the_surface_home_is_found() -> None:
    assert BORDER.share(0.5 * cube(10.0), cube(10.0)) == pytest.approx(0.5, abs=0.003)
    assert BORDER.share(cube(10.0), cube(10.0)) == pytest.approx(0.0, abs=0.003)


def test_a_part_without_a_surface_never_has_one() -> None:
    border = Border(np.ones((4, 4, 4)), 0.8)
    assert border.off(np.zeros((4, 4, 4))) == FARTHEST
