"""Rays traced for proofs: against the chords of the vessels, against each other, and where they fold."""

from __future__ import annotations

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.geometry import resin_radius
from vamgpu.optics.beams import Fan, Misaligned
from vamgpu.optics.graded_vial import GradedVial
from vamgpu.optics.index_field import FunctionField, Region
from vamgpu.optics.occluder import Occluded
from vamgpu.optics.traced_pose import trace_pose
from vamgpu.optics.traced_rays import trace_vial, traced_rays

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
DOUBLE = vam.DoubleWalledVial(
    radius=12.4, wall=1.0, gap=1.5, inner_wall=0.5, liquid_index=1.36, wall_index=1.473, resin_index=1.5,
    absorption=0.05, liquid_absorption=0.02,
)  # fmt: skip
BATH = vam.SquareBath(vam.Vial(9.0, 0.5, 1.5, 1.473, 1.36, 0.05), 20.0, 1.0, 1.52, tilt=0.3, liquid_absorption=0.02)
THIN = vam.Vial(radius=4.0, wall=0.0, resin_index=1.4, wall_index=1.4, bath_index=1.5, absorption=0.1)


@pytest.mark.parametrize("vial", [VIAL, THIN])
def test_snells_law_in_vectors_gives_the_chords(vial: vam.Vial) -> None:
    u = 0.999 * vial.aperture * np.linspace(-1, 1, 101)
    place, heading = trace_vial(vial, u)
    chords = vial.chords(u)
    assert np.allclose(np.hypot(*place.T), vial.inner_radius) and np.allclose(np.hypot(*heading.T), 1.0)
    assert np.allclose(-heading[:, 0], np.sin(chords.angle), atol=1e-9)
    assert np.allclose(place[:, 0] * heading[:, 1] - place[:, 1] * heading[:, 0], chords.p, atol=1e-9)
    assert np.allclose(-2.0 * np.sum(place * heading, axis=1), chords.length, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("vessel", [None, VIAL, THIN, vam.Vat(width=10.0, absorption=0.03), Fan(VIAL, throw=80.0),
                                    Misaligned(THIN, offset=0.2, tilt=0.1), DOUBLE, BATH])  # fmt: skip
def test_a_ray_through_a_point_is_the_one_that_lights_it(vessel: vam.Vial | None) -> None:
    """Where one ray meets a point, its column, density and share are those of the inverse map, to its own accuracy."""
    traced = trace_pose(traced_rays(vessel, 13.0), 0.02, 3.0, 0.02)
    place = np.arange(-(traced.table.shape[1] // 2), traced.table.shape[1] // 2 + 1) * traced.spacing
    x, y = np.meshgrid(place, place, indexing="ij")
    near = np.hypot(x, y) < 2.5
    low, high, share, _ = np.moveaxis(traced.table[0], -1, 0)
    assert traced.single >= 2.5
    if vessel is None:
        assert np.allclose(0.5 * (low + high)[near], x[near]) and np.allclose((high - low)[near], 0.02)
        return
    u, weight = vessel.illuminate(x, y)
    power = vessel.chords(u).transmittance
    assert np.abs(0.5 * (low + high) - u)[near].max() < 1e-4
    found = share * power * (high - low) / 0.02
    assert np.abs(found[near] / weight[near] - 1.0).max() < 3e-3


def test_caustics_fold_the_light_of_a_vial_into_three_branches() -> None:
    """Beyond 8.27 mm rays cross; along each row the branches share the columns between them, none twice, none lost."""
    traced = trace_pose(traced_rays(VIAL, 13.0), 0.1, 11.4, 0.1)
    assert len(traced.table) == 3 and 8.0 < traced.single <= VIAL.printable_radius
    low, high = traced.table[..., 0], traced.table[..., 1]
    assert (high >= low).all()
    folded = np.any(high[1:] > low[1:], axis=(0, 1))
    assert not folded[: folded.size // 3].any() and folded[-20:].all()
    first, last = (np.where(high > low, low, np.inf).min(axis=1), np.where(high > low, high, -np.inf).max(axis=1))
    rows = slice(-40, -10)  # [branch, along]: through the axis, at larger columns, at smaller ones
    assert np.allclose(last[0, rows], first[1, rows]) and np.allclose(first[0, rows], last[2, rows])
    assert np.allclose(last[1, rows], VIAL.aperture) and np.allclose(first[2, rows], -VIAL.aperture)


def test_bent_rays_are_those_of_the_plain_vial_where_nothing_bends_them() -> None:
    field = FunctionField(lambda x, y: 1.45 + 0.0 * x, Region.cylinder(5.0))
    graded = GradedVial(5.0, 0.3, field, wall_index=1.47, bath_index=1.4, absorption=0.1)
    plain = vam.Vial(5.0, 0.3, 1.45, 1.47, 1.4, 0.1)
    found, wanted = (trace_pose(traced_rays(v, 6.0), 0.05, 3.0, 0.05).table[0] for v in (graded, plain))
    assert np.abs(found[..., :2] - wanted[..., :2]).max() < 2e-4
    assert np.abs(found[..., 2] / wanted[..., 2] - 1.0).max() < 1e-3


def test_light_beside_the_resin_reaches_none_of_it() -> None:
    assert np.abs(traced_rays(VIAL, 5.0).u).max() == pytest.approx(5.0)
    assert np.abs(traced_rays(VIAL, 20.0).u).max() == pytest.approx(VIAL.aperture, abs=1e-9)
    with pytest.raises(BadInput, match="no column"):
        traced_rays(Misaligned(vam.Vat(width=2.0, radius=1.0), offset=50.0), 3.0)


def test_resin_ends_at_the_inner_wall() -> None:
    assert resin_radius(VIAL) == 11.4 and resin_radius(None) == np.inf
    assert resin_radius(Occluded(Fan(VIAL, throw=90.0), 1.0, 1.0, 0.2)) == 11.4
    assert resin_radius(vam.Vat(width=9.0)) == 4.5 and resin_radius(Misaligned(None)) == np.inf
