"""Vials in vials and vials in square baths, against rays traced here by matching what is tangential at every face."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, TargetTooLarge
from vamgpu.units import deg

DOUBLE = vam.DoubleWalledVial(
    radius=14.0, wall=1.2, wall_index=1.473, gap=2.0, liquid_index=1.36, inner_wall=0.8, inner_wall_index=1.52,
    wall_absorption=0.02, liquid_absorption=0.01, resin_index=1.49962, absorption=0.05,
)  # fmt: skip
AIR_GAP = replace(DOUBLE, liquid_index=1.0, bath_index=1.33, inner_wall_index=None, polarization="p")
VIAL = vam.Vial(radius=8.0, wall=0.7, resin_index=1.49, wall_index=1.473, bath_index=1.36, absorption=0.1)
WINDOW = {"width": 24.0, "wall": 1.5, "wall_index": 1.52, "wall_absorption": 0.03, "liquid_absorption": 0.02}
STRAIGHT = vam.SquareBath(VIAL, **WINDOW)
TILTED = vam.SquareBath(VIAL, **WINDOW, tilt=20 * deg)
OTHER_WAY = vam.SquareBath(replace(VIAL, polarization="s"), **WINDOW, front_index=1.2, tilt=-35 * deg)
JACKET = vam.SquareBath(replace(DOUBLE, radius=10.0, bath_index=1.4), **WINDOW, tilt=10 * deg)
VESSELS = {"double": DOUBLE, "air gap": AIR_GAP, "straight": STRAIGHT, "tilted": TILTED, "other way": OTHER_WAY,
           "double in a bath": JACKET}  # fmt: skip
Vessel = vam.DoubleWalledVial | vam.SquareBath


def traced(vessel: Vessel, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where columns enter the resin, their unit headings there, and their power: (rays, 2), (rays, 2), (rays,)."""
    vial = vessel.vessel if isinstance(vessel, vam.SquareBath) else vessel
    place = np.stack([u, np.full_like(u, -60.0)], axis=1)
    heading, shares = np.tile([0.0, 1.0], (u.size, 1)), np.ones((u.size, 2))
    index, losing = (vessel.front_index if isinstance(vessel, vam.SquareBath) else vial.bath_index), 0.0
    faces: list[tuple[str, float, float, float]] = []  # kind, distance or radius, index and absorption behind
    if isinstance(vessel, vam.SquareBath):
        half = 0.5 * vessel.width
        faces += [("plane", half + vessel.wall, vessel.wall_index, vessel.wall_absorption),
                  ("plane", half, vial.bath_index, vessel.liquid_absorption)]  # fmt: skip
    radius = vial.radius
    layers = [(vial.wall, vial.wall_index, 0.0)]
    if isinstance(vial, vam.DoubleWalledVial):
        layers = [(vial.wall, vial.wall_index, vial.wall_absorption),
                  (vial.gap, vial.liquid_index, vial.liquid_absorption),
                  (vial.inner_wall, vial.inner_wall_index or vial.wall_index, vial.wall_absorption)]  # fmt: skip
    for thickness, behind, absorbs in layers:
        faces.append(("circle", radius, behind, absorbs))
        radius -= thickness
    faces.append(("circle", radius, vial.resin_index, 0.0))
    for kind, size, behind, absorbs in faces:
        if kind == "plane":
            inward = np.tile([-math.sin(vessel.tilt), math.cos(vessel.tilt)], (u.size, 1))  # type: ignore[union-attr]
            way = (-size - (place * inward).sum(1)) / (heading * inward).sum(1)
        else:
            middle = (place * heading).sum(1)
            way = -middle - np.sqrt(middle**2 - (place**2).sum(1) + size**2)
        place = place + way[:, None] * heading
        if kind == "circle":
            inward = -place / size
        shares *= np.exp(-losing * way)[:, None]
        cosine = (heading * inward).sum(1)
        tangent = (heading - cosine[:, None] * inward) * (index / behind)
        after = np.sqrt(1.0 - (tangent**2).sum(1))
        s = (index * cosine - behind * after) / (index * cosine + behind * after)
        p = (behind * cosine - index * after) / (behind * cosine + index * after)
        shares *= 1.0 - np.stack([s, p], axis=1) ** 2
        heading, index, losing = tangent + after[:, None] * inward, behind, absorbs
    kept = {"none": [0.5, 0.5], "s": [1.0, 0.0], "p": [0.0, 1.0]}[vial.polarization]
    return place, heading, shares @ kept


def columns(vessel: Vessel, count: int) -> np.ndarray:
    """Some that reach the resin."""
    u = np.linspace(-16.0, 16.0, 4001)
    lit = u[vessel.chords(u).transmittance > 0]
    return np.linspace(0.98 * lit[0], 0.98 * lit[-1], count)


@pytest.mark.parametrize("name", VESSELS)
def test_chords_are_the_traced_rays(name: str) -> None:
    vessel = VESSELS[name]
    u = columns(vessel, 41)
    place, heading, power = traced(vessel, u)
    chords = vessel.chords(u)
    assert np.allclose(np.sin(chords.angle), -heading[:, 0], rtol=0.0, atol=1e-12)
    assert np.allclose(chords.p, place[:, 0] * heading[:, 1] - place[:, 1] * heading[:, 0], rtol=0.0, atol=1e-12)
    assert np.allclose(chords.transmittance, power, rtol=1e-11)
    assert np.allclose(chords.length, -2.0 * (place * heading).sum(1), rtol=1e-11)
    h = 1e-5
    slope = (vessel.chords(u + h).angle - vessel.chords(u - h).angle) / (2 * h)
    assert np.allclose(chords.spread, slope, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("name", VESSELS)
def test_absorbed_dose_is_the_traced_dose(name: str) -> None:
    vessel, rng = VESSELS[name], np.random.default_rng(3)
    radius, around = 0.95 * vessel.lit_radius * np.sqrt(rng.random(30)), 2 * np.pi * rng.random(30)
    x, y = radius * np.cos(around), radius * np.sin(around)
    u, weight = vessel.illuminate(x, y)
    place, heading, power = traced(vessel, u)
    off = (x - place[:, 0]) * heading[:, 1] - (y - place[:, 1]) * heading[:, 0]
    assert np.abs(off).max() < 1e-9
    h = 1e-4

    def missed(u: np.ndarray) -> np.ndarray:
        place, heading, _ = traced(vessel, u)
        return (x - place[:, 0]) * heading[:, 1] - (y - place[:, 1]) * heading[:, 0]

    tube = np.abs(missed(u + h) - missed(u - h)) / (2 * h)
    path = np.hypot(x - place[:, 0], y - place[:, 1])
    assert np.allclose(weight, power * vessel.absorption * np.exp(-vessel.absorption * path) / tube, rtol=1e-6)


@pytest.mark.parametrize("name", ["double", "tilted"])
def test_dose_of_a_turn(name: str, device: Device) -> None:
    """Even light of eleven poses, voxel by voxel; the transpose holds."""
    vessel = VESSELS[name]
    pitch = 0.25 * vessel.lit_radius / 12
    A = vam.Projection(
        vam.Grid((24, 24, 1), pitch),
        vam.Beam((160, 1), 0.2, spread=0.0),
        vam.Turntable(11, lit_share=0),
        vessel,
        device,
    )
    dose = np.asarray(A.T(np.ones(A.range.shape)), float)[:, :, 0]
    x, y = np.meshgrid(*A.grid.axes()[:2], indexing="ij")
    wanted = np.zeros_like(x)
    for pose in A.motion.poses:
        across, along = y * np.cos(pose) - x * np.sin(pose), -(x * np.cos(pose) + y * np.sin(pose))
        u, _ = vessel.illuminate(across, along)
        h = 1e-4
        ends = [traced(vessel, (u + k).ravel()) for k in (-h, 0.0, h)]
        place, heading, power = ends[1]
        miss = [(across.ravel() - a[:, 0]) * b[:, 1] - (along.ravel() - a[:, 1]) * b[:, 0] for a, b, _ in ends]
        tube = np.abs(miss[2] - miss[0]) / (2 * h)
        path = np.hypot(across.ravel() - place[:, 0], along.ravel() - place[:, 1])
        share = power * vessel.absorption * np.exp(-vessel.absorption * path) / tube
        wanted += share.reshape(x.shape) * pitch**3 / 0.2**2
    inside = A.grid.cylinder()
    assert np.abs(dose / wanted - 1.0)[inside].max() < 2e-3
    volume, light = (np.random.default_rng(k).random(s.shape) for k, s in enumerate((A.domain, A.range)))
    assert np.vdot(A(volume), light) == pytest.approx(np.vdot(volume, A.T(light)), rel=1e-5)


def test_layers_that_are_not_there() -> None:
    """Exactly the vial: a second wall of no thickness, and equal indices in front of and behind a window."""
    u, (x, y) = np.linspace(-9.0, 9.0, 101), np.random.default_rng(0).uniform(-4.0, 4.0, (2, 50))
    shape: dict[str, Any] = {
        name: getattr(VIAL, name) for name in ("radius", "wall", "resin_index", "wall_index", "bath_index")
    }
    double = vam.DoubleWalledVial(**shape, absorption=0.1, gap=0.0, liquid_index=1.7, inner_wall=0.0)
    bath = vam.SquareBath(VIAL, 20.0, 1.5, wall_index=1.36, front_index=1.36)
    for other in (double, bath, replace(double, wall=0.3, inner_wall=0.2, gap=0.2, liquid_index=1.473)):
        exact = 0.0 if other is double else 1e-13
        for name in ("p", "angle", "spread", "transmittance", "length"):
            found, wanted = getattr(other.chords(u), name), getattr(VIAL.chords(u), name)
            assert np.allclose(found, wanted, rtol=exact, atol=1e3 * exact)
        for found, wanted in zip(other.illuminate(x, y), VIAL.illuminate(x, y), strict=True):
            assert np.allclose(found, wanted, rtol=1e3 * exact, atol=1e3 * exact)
        assert other.lit_radius == pytest.approx(VIAL.lit_radius, rel=1e-15)


def test_no_layer_at_all() -> None:
    indices: dict[str, Any] = {"resin_index": 1.49, "wall_index": 1.473, "bath_index": 1.36}
    double = vam.DoubleWalledVial(radius=8.0, wall=0.0, gap=0.0, liquid_index=1.7, inner_wall=0.0, **indices)
    u = np.linspace(-9.0, 9.0, 101)
    found, expected = (one.chords(u).transmittance for one in (double, vam.Vial(radius=8.0, wall=0.0, **indices)))
    assert np.array_equal(found, expected) and found.max() > 0.9


def test_all_indices_equal_are_no_vessel() -> None:
    one: dict[str, Any] = {"resin_index": 1.5, "wall_index": 1.5, "bath_index": 1.5}
    double = vam.DoubleWalledVial(radius=9.0, wall=1.0, gap=1.0, liquid_index=1.5, inner_wall=1.0, **one)
    bath = vam.SquareBath(double, 30.0, 1.0, wall_index=1.5, front_index=1.5, tilt=0.4)
    for vessel in (double, bath):
        u = np.linspace(-5.9, 5.9, 101)
        chords = vessel.chords(u)
        assert np.allclose(chords.p, u, atol=1e-14) and np.allclose(chords.angle, 0.0, atol=1e-15)
        assert np.allclose(chords.transmittance, 1.0, atol=1e-14) and vessel.lit_radius == 6.0


def test_a_narrow_window_keeps_light_out() -> None:
    """Tilted far, the edge of the window cuts into the vial's light: what lies there is not lit, and is refused."""
    vessel = vam.SquareBath(replace(VIAL, radius=9.9), 20.0, 3.0, wall_index=1.52, tilt=55 * deg)
    assert vessel.lit_radius < 0.9 * vessel.vessel.lit_radius
    with pytest.raises(TargetTooLarge, match="use a wider bath, or tilt it less"):
        vessel.check_fits(0.5 * (vessel.lit_radius + vessel.vessel.lit_radius))
    around = np.linspace(0.0, 2.0 * np.pi, 720)
    for share, lit in ((0.999, True), (1.001, False)):
        radius = share * vessel.lit_radius
        _, weight = vessel.illuminate(radius * np.cos(around), radius * np.sin(around))
        assert (weight > 0).all() == lit


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(BadInput, match="14.8 mm thick in a vial of outer radius 14 mm"):
        replace(DOUBLE, gap=12.8)
    with pytest.raises(BadInput, match="at most 7 mm; correct the radius or the width"):
        replace(STRAIGHT, width=14.0)
    with pytest.raises(BadInput, match="expected a Vial or a DoubleWalledVial"):
        vam.SquareBath(vam.Vat(width=5.0), 20.0, 1.0, 1.5)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="tilted by 60° in front of an index of 1.36; expected less than 51.83°"):
        replace(STRAIGHT, front_index=1.73, tilt=60 * deg)
    with pytest.raises(BadInput, match="expected a vessel that is round"):
        vam.Fan(STRAIGHT, throw=200.0)
    with pytest.raises(TargetTooLarge, match=r"wall or liquid of index 1 keeps .* use a wall or liquid of higher"):
        replace(DOUBLE, liquid_index=1.0, bath_index=1.33, resin_index=1.34).check_fits(9.9)
    with pytest.warns(OpticsWarning, match="window and liquid transmit 0.7"):
        replace(STRAIGHT, liquid_absorption=0.06).check_fits(2.0)
