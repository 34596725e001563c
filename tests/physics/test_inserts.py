"""Dose beside and behind an insert against rays that are bent, reflected, absorbed and stopped one by one.

The insert is a circle off the axis whose surface is sharp; nothing of the library's medium or marching is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from raytracer import refract, trace

import vamgpu as vam
from vamgpu.backend.device import Device

CENTER, RADIUS, REACH = np.array([0.9, -0.5]), 0.6, 3.0
INDEX, ABSORPTION = 1.48, 0.12
N, POSES, FINE, HALF = 96, 45, 8, 2
PITCH = 2.0 * REACH / N
VIALS = {
    "air": vam.Vial(4.0, 0.4, INDEX, 1.5, 1.0, ABSORPTION),
    "index-matched": vam.Vial(4.0, 0.4, INDEX, INDEX, INDEX, ABSORPTION),
}
INSERTS: dict[str, tuple[float | None, float | None]] = {
    "opaque": (None, None),
    "absorbing": (None, 0.8),
    "clear": (None, 0.0),
    "denser": (1.53, 0.0),
    "glass that absorbs": (1.6, 0.3),
    "thinner": (1.4, 0.05),
}
PLACES = (0.0, 0.0), (-1.2, 0.4), (0.2, 1.3), (1.8, -0.2), (0.4, -1.4), (1.6, 0.6), (-0.3, -0.9), (0.9, 0.6)
INSIDE = (0.9, -0.5), (0.75, -0.3)


@dataclass
class Piece:
    """Straight pieces of rays [..., 2]: start, heading, length [mm], power at the start, absorption [1/mm]."""

    start: np.ndarray
    heading: np.ndarray
    length: np.ndarray
    power: np.ndarray
    absorption: float

    def end(self) -> tuple[np.ndarray, np.ndarray]:
        """Where they end, and the power that is left."""
        return self.start + self.length[..., None] * self.heading, self.power * np.exp(-self.absorption * self.length)

    def absorbed(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Power that each ray leaves in a box from low to high."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(low - self.start) / self.heading, (high - self.start) / self.heading])
        near = np.maximum(ends.min(0).max(-1), 0.0)
        far = np.minimum(ends.max(0).min(-1), self.length)
        meets = (far > near) & (self.power > 0.0)
        near, far = np.where(meets, near, 0.0), np.where(meets, far, 0.0)
        return self.power * (np.exp(-self.absorption * near) - np.exp(-self.absorption * far))


def ways(start: np.ndarray, heading: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """How far along a ray it enters and leaves a circle about 0; NaN where it misses."""
    along = np.sum(start * heading, axis=-1)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(along**2 - np.sum(start**2, axis=-1) + radius**2)
    return -along - half, -along + half


def crossed(
    start: np.ndarray, heading: np.ndarray, power: np.ndarray, normal: np.ndarray, before: float, after: float
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Heading and power of what passes a face, and of what it throws back."""
    with np.errstate(invalid="ignore"):
        bent, shares = refract(heading, normal, before, after)
    passed = np.nan_to_num(np.mean(shares, axis=-1))
    mirrored = heading - 2.0 * np.sum(heading * normal, axis=-1)[..., None] * normal
    return (np.where(passed[..., None] > 0.0, bent, heading), power * passed), (mirrored, power * (1.0 - passed))


def pieces(vial: vam.Vial, angle: np.ndarray, u: np.ndarray, index: float | None, absorption: float | None,
           radius: float = RADIUS) -> list[Piece]:  # fmt: skip
    """Rays of columns at u [mm] in the resin and in the insert, each reflected once at most."""
    rays = trace(vial, angle, u)
    first, _ = ways(rays.start - CENTER, rays.heading, radius)
    hits = np.isfinite(first) & (first > 0.0) & (rays.power > 0.0)
    come = Piece(rays.start, rays.heading, np.where(hits, first, rays.length), rays.power, vial.absorption)
    if index is None and absorption is None:
        return [come]
    start, power = come.end()
    start, power = np.where(hits[..., None], start, CENTER + [radius, 0.0]), np.where(hits, power, 0.0)
    inner = index or vial.resin_index

    def out(start: np.ndarray, way: tuple[np.ndarray, np.ndarray]) -> Piece:
        _, far = ways(start, way[0], vial.radius - vial.wall)
        return Piece(start, way[0], far, way[1], vial.absorption)

    through, back = crossed(start, rays.heading, power, (start - CENTER) / radius, vial.resin_index, inner)
    _, far = ways(start - CENTER, through[0], radius)
    within = Piece(start, through[0], np.nan_to_num(far), through[1], absorption or 0.0)
    end, power = within.end()
    gone, _ = crossed(end, within.heading, power, -(end - CENTER) / radius, inner, vial.resin_index)
    return [come, out(start, back), within, out(end, gone)]


BEAMS = {name: vam.Beam((2 * int(vial.aperture / PITCH) + 2, 1), PITCH) for name, vial in VIALS.items()}
TURN = vam.Turntable(POSES, lit_share=0)
AXIS = (np.arange(N) - 0.5 * (N - 1)) * PITCH


def light_of(beam: vam.Beam) -> np.ndarray:
    """Uneven light [angle, r]."""
    return 1.6 + np.cos(np.asarray(TURN.poses)[:, None] + 0.3) + 0.5 * np.sin(1.5 * beam.columns() + 0.2)


def boxes(insert: str) -> list[tuple[int, int]]:
    """Middle voxels of what is compared."""
    places = (*PLACES, *(INSIDE if INSERTS[insert][1] else ()))
    return [(int(np.argmin(np.abs(AXIS - x))), int(np.argmin(np.abs(AXIS - y)))) for x, y in places]


@cache
def expected(vial: str, insert: str) -> np.ndarray:
    """Mean dose of each box."""
    beam = BEAMS[vial]
    columns = FINE * beam.pixels[0]
    fine = (np.arange(columns) - 0.5 * (columns - 1)) * PITCH / FINE
    light = np.repeat(light_of(beam), FINE, axis=1) / (FINE * (2 * HALF + 1) ** 2)
    way = pieces(VIALS[vial], np.asarray(TURN.poses)[:, None], fine[None, :], *INSERTS[insert])
    found = []
    for place in boxes(insert):
        low, high = (np.array([AXIS[k + side * HALF] + side * 0.5 * PITCH for k in place]) for side in (-1, 1))
        found.append(sum(float(np.sum(light * piece.absorbed(low, high))) for piece in way))
    return np.array(found)


@pytest.mark.parametrize(("vial", "insert"), [
    pytest.param(vial, insert, marks=[pytest.mark.slow] * (insert != "denser" and (vial, insert) != ("air", "opaque")))
    for vial in ("air", "index-matched") for insert in INSERTS
])  # fmt: skip
def test_dose_around_and_in_an_insert(fast_device: Device, vial: str, insert: str) -> None:
    index, absorption = INSERTS[insert]
    stands = vam.Body(lambda x, y, z: np.hypot(x - CENTER[0], y - CENTER[1]) - RADIUS + 0 * z, "insert", index=index,
                      absorption=absorption)  # fmt: skip
    scene = vam.Scene([vam.Body(lambda x, y, z: np.hypot(x, y) - 2.0 + 0 * z), stands])
    target = scene.target(pitch=PITCH, shape=(N, N, 1), device="numpy")
    A = scene.operator(target, BEAMS[vial], TURN, VIALS[vial], device=fast_device)
    dose = A.T(light_of(A.beam)[:, :, None].astype(np.float32))[:, :, 0]
    means = [dose[i - HALF : i + HALF + 1, j - HALF : j + HALF + 1].mean() for i, j in boxes(insert)]
    assert means == pytest.approx(expected(vial, insert), rel=0.008)


def test_dose_past_a_ball_of_another_height(fast_device: Device) -> None:
    """Light of each slice past its own circle of an opaque ball, marched in three dimensions."""
    n, slices, pitch, radius = 48, 9, 0.125, 1.0
    scene = vam.Scene([
        vam.Body(lambda x, y, z: np.hypot(x, y) - 2.0 + 0 * z),
        vam.Body(lambda x, y, z: np.sqrt((x - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2 + z**2) - radius, "insert"),
    ])  # fmt: skip
    target = scene.target(pitch=pitch, shape=(n, n, slices), device="numpy")
    vial = VIALS["air"]
    beam = vam.Beam((2 * int(vial.aperture / pitch) + 2, slices), pitch)
    A = scene.operator(target, beam, TURN, vial, device=fast_device)
    assert not A.entries  # type: ignore[union-attr]
    dose = A.T(np.ones(A.range.shape, np.float32))
    fine = (np.arange(32 * beam.pixels[0]) - 0.5 * (32 * beam.pixels[0] - 1)) * pitch / 32
    axis, _, heights = A.grid.axes()
    for k in (1, 4, 6):
        (come,) = pieces(vial, np.asarray(TURN.poses)[:, None], fine[None, :], None, None,
                         float(np.sqrt(radius**2 - heights[k] ** 2)))  # fmt: skip
        for place in ((-1.2, 0.4), (0.3, 1.5), (-0.9, -0.9)):
            i, j = (int(np.argmin(np.abs(axis - at))) for at in place)
            low, high = (np.array([axis[i + s], axis[j + s]]) + s * 0.5 * pitch for s in (-1, 1))
            wanted = come.absorbed(low, high).sum() / (32 * 9)
            assert dose[i - 1 : i + 2, j - 1 : j + 2, k].mean() == pytest.approx(wanted, rel=0.01)
