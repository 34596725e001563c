"""Refraction and reflection at one face."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.optics.interface import impact_after, refract, transmittance


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
    assert transmittance(one, one, 1.0, 1.5)[0] == pytest.approx(0.96)
    # At Brewster's angle the polarization in the plane passes whole.
    brewster = np.arctan(1.5)
    cos_in, cos_out = np.cos(brewster), np.sin(brewster)
    across = ((cos_in - 1.5 * cos_out) / (cos_in + 1.5 * cos_out)) ** 2
    assert transmittance(cos_in * one, cos_out * one, 1.0, 1.5)[0] == pytest.approx(1 - 0.5 * across)
    assert transmittance(np.zeros(1), one, 1.0, 1.5)[0] == 0.0
