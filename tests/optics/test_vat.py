"""The index-matched vat: straight rays, absorption by the path through its resin."""

from __future__ import annotations

import math

import numpy as np
import pytest

from profiling.deposit import deposit
from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.optics.vat import Vat
from vamgpu.optics.vial import Vial

SQUARE = Vat(width=20.0, absorption=0.1)
ROUND = Vat(width=30.0, radius=9.0, absorption=0.1)


def test_square_vat_absorbs_from_its_window_on() -> None:
    x, y = np.array([0.0, 9.0, -3.0, 10.5]), np.array([-10.0 + 1e-12, 4.0, 9.0, 0.0])
    u, weight = SQUARE.illuminate(x, y)
    np.testing.assert_array_equal(u, x)
    np.testing.assert_allclose(weight, [0.1, 0.1 * math.exp(-1.4), 0.1 * math.exp(-1.9), 0.0], rtol=1e-10)
    chords = SQUARE.chords([0.0, 9.9, 10.1])
    np.testing.assert_allclose(chords.length, [20.0, 20.0, 0.0])
    np.testing.assert_array_equal(chords.angle, 0.0)


def test_round_vat_is_the_vial_whose_indices_all_match() -> None:
    vial = Vial(radius=10.0, wall=1.0, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=0.1)
    axis = np.linspace(-8.0, 8.0, 41)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    inside = np.hypot(x, y) < 8.99
    np.testing.assert_allclose(ROUND.illuminate(x, y)[1][inside], vial.illuminate(x, y)[1][inside], rtol=1e-10)
    for name in ("p", "angle", "spread", "transmittance", "length"):
        np.testing.assert_allclose(getattr(ROUND.chords(axis), name), getattr(vial.chords(axis), name), atol=1e-10)
    assert ROUND.printable_radius == vial.printable_radius == 9.0


def test_window_loses_what_two_faces_reflect() -> None:
    vat = Vat(width=20.0, resin_index=1.48, wall_index=1.52, bath_index=1.0)
    expected = (1 - (0.52 / 2.52) ** 2) * (1 - (0.04 / 3.0) ** 2)
    np.testing.assert_allclose(vat.chords([0.0, 5.0]).transmittance, expected, rtol=1e-12)
    assert vat.illuminate(1.0, 2.0)[1] == pytest.approx(expected, rel=1e-12)


def test_no_energy_is_lost_on_the_grid() -> None:
    columns, pitch = (np.arange(180) - 89.5) * 0.11, 0.25
    power = np.random.default_rng(4).random((3, 180))
    dose = deposit(ROUND, columns, power, [0.0, 1.0, 4.0], (80, 80), pitch)
    length = 2 * np.sqrt(np.maximum(81.0 - columns**2, 0.0))
    assert dose.sum() * pitch**3 == pytest.approx(np.sum(power * (1 - np.exp(-0.1 * length))), rel=1e-3)


def test_radii_and_errors() -> None:
    assert Vat(width=20.0, depth=12.0).printable_radius == 6.0
    with pytest.raises(TargetTooLarge, match=r"7 mm.*6 mm"):
        Vat(width=20.0, depth=12.0).check_fits(7.0)
    with pytest.raises(BadInput, match="11"):
        Vat(width=20.0, radius=11.0)
    with pytest.raises(BadInput, match="nan"):
        Vat(width=math.nan)
    with pytest.warns(OpticsWarning, match="window transmits"):
        Vat(width=20.0, resin_index=1.5, wall_index=2.9).check_fits(5.0)
