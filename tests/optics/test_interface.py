"""Refraction and reflection at one face."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.optics.interface import fresnel, impact_after, refract, transmittance


def test_refraction_keeps_index_times_sine_and_unit_length() -> None:
    angle = np.linspace(-1.4, 1.4, 29)
    direction = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    normal = np.broadcast_to([0.0, -1.0], direction.shape)
    bent = refract(direction, normal, 1.0, 1.5)
    np.testing.assert_allclose(1.5 * bent[:, 0], np.sin(angle), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(bent, axis=-1), 1.0, atol=1e-14)
    assert np.all(bent[:, 1] > 0)


def test_total_reflection_is_refused_with_both_angles() -> None:
    with pytest.raises(BadInput, match=r"60\.00 degrees.*41\.81 degrees"):
        refract(np.array([np.sin(np.pi / 3), np.cos(np.pi / 3)]), np.array([0.0, 1.0]), 1.5, 1.0)


def test_impact_follows_the_invariant() -> None:
    assert impact_after(np.array(3.0), 1.0, 1.5) == pytest.approx(2.0)


def test_transmittance_at_known_angles() -> None:
    one = np.ones(1)
    assert transmittance([(one, one, 1.0, 1.5)])[0] == pytest.approx(0.96)
    # At Brewster's angle p light, whose field lies in the plane of incidence, passes whole.
    brewster = np.arctan(1.5)
    face = (np.cos(brewster) * one, np.sin(brewster) * one, 1.0, 1.5)
    s_reflected = ((1.5**2 - 1.0) / (1.5**2 + 1.0)) ** 2
    assert transmittance([face], "p")[0] == pytest.approx(1.0, abs=1e-15)
    assert transmittance([face], "s")[0] == pytest.approx(1.0 - s_reflected)
    assert transmittance([face])[0] == pytest.approx(1.0 - 0.5 * s_reflected)
    assert transmittance([(np.zeros(1), one, 1.0, 1.5)])[0] == 0.0


@pytest.mark.parametrize(("before", "after"), [(1.0, 1.5), (1.333, 1.473), (1.52, 1.48), (1.5, 1.0)])
def test_what_crosses_and_what_is_reflected_is_all(before: float, after: float) -> None:
    """Amplitudes t and r from the fields' boundary conditions: T = n₂cos₂/(n₁cos₁)·t², and T + r² = 1."""
    incidence = np.linspace(0.0, 0.999 * np.arcsin(min(1.0, after / before)), 200)
    c1 = np.cos(incidence)
    c2 = np.cos(np.arcsin(before / after * np.sin(incidence)))
    t_s, r_s = 2 * before * c1 / (before * c1 + after * c2), (before * c1 - after * c2) / (before * c1 + after * c2)
    t_p, r_p = 2 * before * c1 / (after * c1 + before * c2), (after * c1 - before * c2) / (after * c1 + before * c2)
    share = fresnel(c1, c2, before, after)
    assert share.shape == (200, 2)
    for column, t, r in ((0, t_s, r_s), (1, t_p, r_p)):
        np.testing.assert_allclose(share[:, column], after * c2 / (before * c1) * t**2, rtol=1e-12)
        np.testing.assert_allclose(share[:, column] + r**2, 1.0, atol=1e-12)


def test_unpolarized_light_is_the_mean_of_the_two_products() -> None:
    """Two faces at Brewster's angle: p passes both, s loses twice; the product of the means would be too low."""
    one = np.ones(1)
    cosine, sine = np.cos(np.arctan(1.5)) * one, np.sin(np.arctan(1.5)) * one
    glass = [(cosine, sine, 1.0, 1.5), (sine, cosine, 1.5, 1.0)]
    kept = 1.0 - ((1.5**2 - 1.0) / (1.5**2 + 1.0)) ** 2
    assert transmittance(glass)[0] == pytest.approx(0.5 * (1.0 + kept**2), rel=1e-14)
    assert transmittance(glass)[0] > (0.5 * (1.0 + kept)) ** 2 + 5e-3
    # Stokes: light that comes back the same way crosses a face as well as it came.
    np.testing.assert_allclose(fresnel(*glass[0]), fresnel(*glass[1]), rtol=1e-14)
