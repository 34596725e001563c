"""Straight projection of ellipses against their analytic chords, averaged over each column."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device

ANGLES = 60
SUBLINES = 16
SIZES = (64, 128, 256)


@dataclass(frozen=True)
class Ellipse:
    """Semi-axes, center and tilt of a uniform ellipse; lengths in the width of the grid."""

    a: float
    b: float
    x: float
    y: float
    tilt: float

    def half_width(self, angle: np.ndarray) -> np.ndarray:
        """Half the width of its shadow at a pose, along (−sin, cos)."""
        along = angle + 0.5 * np.pi - self.tilt
        return np.hypot(self.a * np.cos(along), self.b * np.sin(along))

    def center(self, angle: np.ndarray) -> np.ndarray:
        """Where its middle falls at a pose: r = y cos − x sin."""
        return self.y * np.cos(angle) - self.x * np.sin(angle)

    def fractions(self, n: int) -> np.ndarray:
        """Part of each voxel it covers, [x, y]: exact along y on SUBLINES lines a voxel."""
        x = (np.arange(n * SUBLINES) + 0.5) / (n * SUBLINES) - 0.5 - self.x
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        # ((x c + y s) / a)² + ((y c − x s) / b)² = 1 as A y² + 2 B y + C = 0
        A = (s / self.a) ** 2 + (c / self.b) ** 2
        B = x * c * s * (1 / self.a**2 - 1 / self.b**2)
        C = x**2 * ((c / self.a) ** 2 + (s / self.b) ** 2) - 1
        half = np.sqrt(np.maximum(B**2 - A * C, 0.0)) / A
        low, high = ((self.y - B / A + side * half + 0.5) * n for side in (-1, 1))
        voxel = np.arange(n)
        inside = np.minimum(high[:, None], voxel + 1) - np.maximum(low[:, None], voxel)
        return np.clip(inside, 0.0, 1.0).reshape(n, SUBLINES, n).mean(axis=1)

    def chords(self, angle: np.ndarray, n: int) -> np.ndarray:
        """Mean length of chord over each of n columns, [angle, r]."""
        half = self.half_width(angle)[:, None]
        edges = np.arange(n + 1) / n - 0.5
        t = np.clip((edges - self.center(angle)[:, None]) / half, -1.0, 1.0)
        area = self.a * self.b * (t * np.sqrt(1 - t**2) + np.arcsin(t))
        return np.diff(area, axis=1) * n


def some_ellipses(count: int = 32) -> list[Ellipse]:
    rng = np.random.default_rng(20)
    axes = rng.uniform(0.12, 0.27, (count, 2))
    places = rng.uniform(-0.15, 0.15, (count, 2))
    return [
        Ellipse(a, b, x, y, tilt)
        for (a, b), (x, y), tilt in zip(axes, places, rng.uniform(0, np.pi, count), strict=True)
    ]


@cache
def pictures(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Volume [x, y, ellipse] and chords [angle, r, ellipse]: slices never mix."""
    angles = vam.Turntable(ANGLES, lit_share=0).poses
    ellipses = some_ellipses()
    volume = np.stack([e.fractions(n) for e in ellipses], axis=-1).astype(np.float32)
    return volume, np.stack([e.chords(angles, n) for e in ellipses], axis=-1)


def errors(device: Device, n: int) -> np.ndarray:
    """Relative L2 error of the sinogram of each ellipse."""
    volume, wanted = pictures(n)
    grid, beam = vam.Grid((n, n, volume.shape[2]), 1 / n), vam.Beam((n, volume.shape[2]), 1 / n, spread=0)
    A = vam.Projection(grid, beam, vam.Turntable(ANGLES, lit_share=0), None, device)
    return np.linalg.norm(A(volume) - wanted, axis=(0, 1)) / np.linalg.norm(wanted, axis=(0, 1))


def test_fractions_hold_the_area_and_the_center() -> None:
    for ellipse in some_ellipses():
        cover = ellipse.fractions(64)
        place = (np.arange(64) + 0.5) / 64 - 0.5
        assert cover.sum() / 64**2 == pytest.approx(np.pi * ellipse.a * ellipse.b, rel=1e-4)
        assert place @ cover.sum(axis=1) / cover.sum() == pytest.approx(ellipse.x, abs=3e-5)
        assert place @ cover.sum(axis=0) / cover.sum() == pytest.approx(ellipse.y, abs=3e-5)


def test_chords_of_ellipses_halve_their_error_with_each_doubling(fast_device: Device) -> None:
    by_size = np.array([errors(fast_device, n) for n in SIZES])
    assert by_size[-1].max() <= 0.004
    rms = np.sqrt(np.mean(by_size**2, axis=1))
    assert (rms[1:] <= 0.51 * rms[:-1]).all(), rms  # first order; where the edges fall moves a single step by a percent
    assert rms[-1] <= rms[0] / 3.95


def test_the_reference_agrees_with_the_chords() -> None:
    assert errors(vam.open_device("numpy"), 64).max() <= 0.016
