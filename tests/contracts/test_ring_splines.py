"""Splines on rings: their coefficients give back the samples that they are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.ring_splines import NEXT, OWN, shares
from vamgpu.operators.spectral import SpectralProjection

VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.5)
ASIDE = vam.Misaligned(VIAL, offset=0.07)


def beside(values: np.ndarray, axis: int) -> np.ndarray:
    """What coefficients, all that there are around, make of each sample along an axis."""
    return OWN * values + NEXT * (np.roll(values, 1, axis) + np.roll(values, -1, axis))


@pytest.mark.parametrize("vessel", [None, ASIDE], ids=["straight", "light that nothing mirrors"])
@pytest.mark.parametrize("columns", [2, 10], ids=["columns as wide as rings", "fine columns"])
@pytest.mark.parametrize("rings", [8, 32], ids=["one band", "several bands"])
def test_coefficients_make_the_samples(rings: int, columns: int, vessel: Any) -> None:
    grid = PolarGrid(rings, 2, 0.8 / rings, 38)
    beam = vam.Beam((20 + columns * rings, 2), 1.8 / (20 + columns * rings))
    samples, splines = (
        SpectralProjection(grid, beam, vessel, "numpy", square=1.2 * grid.pitch, splines=on) for on in (False, True)
    )
    light = np.random.default_rng(0).random(samples.range.shape)
    wanted, found = (np.asarray(each.T(light))[:, :, 0] for each in (samples, splines))
    assert splines.dot_test() <= 1e-7
    last = grid.bands[-1]  # beyond which the last coefficient goes on
    for band in grid.bands:
        own = slice(band.cell, band.cell + band.samples * band.rings)
        dose, here = (x[:, own].reshape(-1, band.rings) for x in (wanted, found))  # (angle, ring)
        along = beside(here, 0)
        made = beside(along, 1)
        if band.begin == 0:  # across the axis, half a turn on
            made[:, 0] += NEXT * (np.roll(along[:, 0], len(along) // 2) - along[:, -1])
        if band is last:
            made[:, -1] += NEXT * along[:, -1]
            made[:, -1] -= NEXT * along[:, 0]
        lit = (np.arange(band.begin, band.stop) + 1.5) * grid.pitch <= (np.inf if vessel is None else vessel.lit_radius)
        lit[:: band.rings - 1] &= (band.begin == 0, band is last)  # what is beside belongs to other bands
        assert np.abs(made - dose)[:, lit].max(initial=0.0) <= 3e-4 * wanted.max()


def test_shares_of_a_place_make_one_and_lines_of_lines() -> None:
    place = np.linspace(0.0, 1.0, 11)
    parts = np.array(shares(place))
    np.testing.assert_allclose(parts.sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(np.arange(-1, 3) @ parts, place, atol=1e-14)
    np.testing.assert_allclose(parts[:, 0], [NEXT, OWN, NEXT, 0.0], atol=1e-15)
