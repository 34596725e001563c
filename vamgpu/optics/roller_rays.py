"""Rays through a film about a roller: from face to face, straight in between.

Faces are concentric circles in front of the roller's axis (y < 0), and planes |x| = const along the runs behind it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import RayError
from vamgpu.optics.inputs import Floats
from vamgpu.optics.interface import fresnel, left
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.optics.roller_march import FINISH, INNER, MIDDLE, NONE, OUTER, FilmMarcher

MOST_FACES = 2000  # number of faces after which a ray counts as one that never leaves

MOST_CHORDS = 1000  # number of chords of a clear roller along its back after which a ray counts as lost in it


class End(IntEnum):
    MISSED = 0  # it met no resin
    ROLLER = 1
    BATH = 2  # through a face of the film
    LEG = 3  # at the end of a straight run, where the window of light ends


@dataclass(frozen=True)
class Layers:
    """The faces and media that a ray can meet in a film on a roller."""

    # inner, outer: radii of the film [mm]. shell: outer radius of the substrate, or outer. leg: length of the straight
    # runs [mm]. resin, bath, sheet: refractive indices. reflectivity: of the roller. field: index of the resin if it
    # varies in space, in place of ``resin``. polarization: of the light. core: index of a clear roller, None for an
    # opaque one.

    inner: float
    outer: float
    shell: float
    leg: float
    resin: float
    bath: float
    sheet: float
    reflectivity: float
    field: FilmIndex | None = None
    polarization: str = "none"
    core: float | None = None

    def resin_at(self, x: Floats, y: Floats) -> Floats:
        """Index of the resin at wrapped positions."""
        return np.full(x.shape, self.resin) if self.field is None else self.field.at(x, y)


@dataclass(frozen=True)
class Segments:
    """Straight segments of rays in resin; all arrays (pieces,)."""

    ray: np.ndarray  # number of the ray
    x: Floats  # start [mm]
    y: Floats
    dx: Floats  # unit direction
    dy: Floats
    length: Floats  # [mm]
    before: Floats  # path in resin before the start [mm]
    power: Floats  # share of the ray's power after losses at faces and roller, before absorption
    side: np.ndarray  # −1 and 1 in the straight runs at negative and positive x, 0 on the roller

    def absorbed(self, absorption: float) -> Floats:
        """Fraction of a ray's power that each segment absorbs; without absorption, length times power."""
        if absorption == 0:
            return self.power * self.length
        return self.power * np.exp(-absorption * self.before) * -np.expm1(-absorption * self.length)


@dataclass(frozen=True)
class Traced:
    """Rays and how they ended; all arrays (rays,)."""

    segments: Segments
    transmittance: Floats  # share of each ray's power that first entered the resin
    length: Floats  # path in the resin [mm]
    end: np.ndarray  # `End` of each ray


def trace(layers: Layers, x: Floats, y: Floats, dx: Floats, dy: Floats, device: str | Device | None = None) -> Traced:
    """Follow rays that come through (x, y) [mm] along the unit directions (dx, dy), dy > 0, from the bath.

    Snell's law and Fresnel's transmittance of s and of p light at every face; total reflection is traced, partial
    reflection is ignored. A ray that meets the roller ends there, or continues with the roller's reflectivity. A field
    of the index is marched on ``device``, by default the best available one.

    Raises `RayError` if a ray meets more than `MOST_FACES` faces without an end.
    """
    field, marcher = layers.field, None
    if field is not None and field.medium is not None:
        field.check_reach(layers.outer, layers.leg)
        marcher = FilmMarcher(field.medium, layers.inner, layers.outer, layers.leg, field.stride, device)
    rays = _entered(layers, x, y, dx, dy)
    first = np.where(rays["film"], left(rays["shares"], layers.polarization), 0.0)
    share, length = np.zeros(x.size), np.zeros(x.size)
    end = np.full(x.size, int(End.MISSED), dtype=np.int8)
    share[rays["ray"]] = first
    pieces: list[dict[str, Any]] = []
    # more strides than a ray takes along four lengths of the window
    strides = 0 if layers.field is None else int(4.0 * (layers.leg + layers.shell) / layers.field.stride)
    for _ in range(MOST_FACES + strides):
        if not rays["ray"].size:
            break
        face = _advance(layers, rays, pieces) if marcher is None else _march(layers, marcher, rays, pieces)
        fate = _meet(layers, rays, face)
        entering = rays["film"] & (share[rays["ray"]] == 0)
        share[rays["ray"][entering]] = left(rays["shares"][entering], layers.polarization)
        length[rays["ray"]] = rays["path"]
        done = fate != _GOES_ON
        end[rays["ray"][done]] = np.where(share[rays["ray"][done]] > 0, fate[done], int(End.MISSED))
        rays = {name: value[~done] for name, value in rays.items()}
    else:
        raise RayError(
            f"{rays['ray'].size} rays still run in the film after {MOST_FACES} faces; expected rays that "
            f"leave: shorten the straight runs of {layers.leg:g} mm, or use a thicker film than "
            f"{layers.outer - layers.inner:g} mm"
        )
    return Traced(_joined(pieces), share, length, end)


_GOES_ON = -1


def _advance(layers: Layers, rays: dict[str, Any], pieces: list[dict[str, Any]]) -> np.ndarray:
    """Go straight to the next face, or by one stride if the index varies; returns the faces that are met."""
    far, face = _next_face(layers, rays)
    strength, field = np.ones(far.size), layers.field
    if field is not None:
        far = np.where(rays["film"], np.minimum(far, field.stride), far)
        strength = field.kick(rays, 0.5 * far, layers.resin_at(rays["x"], rays["y"]))
        way, face = _next_face(layers, rays)
        # A path that ends slightly before a face ends at it.
        face = np.where(rays["film"] & (way > far * (1.0 + 1e-9) + 1e-12), NONE, face)
        far = np.where(face == NONE, far, way)
    pieces.append(_piece(rays, far, layers.polarization))
    _move(rays, far)
    rays["path"] = rays["path"] + np.where(rays["film"], far, 0.0)
    if field is not None:
        field.kick(rays, 0.5 * far, strength)
    return face


def _march(layers: Layers, marcher: FilmMarcher, rays: dict[str, Any], pieces: list[dict[str, Any]]) -> np.ndarray:
    """`_advance` on a device, from face to face; outside the film light travels straight."""
    far, face = _next_face(layers, rays)
    outside = ~rays["film"]
    _move(rays, np.where(outside, far, 0.0))
    powers, here = left(rays["shares"], layers.polarization), np.full(far.size, layers.resin)
    here[rays["film"]] = layers.resin_at(rays["x"][rays["film"]], rays["y"][rays["film"]])
    return np.where(outside, face, marcher.run(rays, here, powers, pieces))


def _entered(layers: Layers, x: Floats, y: Floats, dx: Floats, dy: Floats) -> dict[str, Any]:
    """Rays just behind the outermost face, without those that miss it or are totally reflected."""
    radius, along = layers.shell, x * dx + y * dy
    square = radius**2 - (x * dy - y * dx) ** 2
    to_circle = -along - np.sqrt(np.maximum(square, 0.0))
    front = (square >= 0) & (y + to_circle * dy <= 0)
    # Only rays inclined inwards meet a straight run from outside.
    side = -np.sign(dx)
    to_plane = np.divide(side * radius - x, dx, out=np.full(x.shape, np.inf), where=dx != 0)
    back = ~front & np.isfinite(to_plane) & (y + to_plane * dy > 0) & (y + to_plane * dy < layers.leg)
    far = np.where(front, to_circle, np.where(back, to_plane, 0.0))
    keep = np.flatnonzero(front | back)
    rays: dict[str, Any] = {
        "ray": keep, "x": (x + far * dx)[keep], "y": (y + far * dy)[keep], "dx": dx[keep], "dy": dy[keep],
        "shares": np.ones((keep.size, 2)), "path": np.zeros(keep.size),
        "side": np.where(front, 0, side)[keep].astype(np.int8),
        "film": np.full(keep.size, layers.shell == layers.outer),
    }  # fmt: skip
    inside = np.where(rays["film"], layers.resin_at(rays["x"], rays["y"]), layers.sheet)
    crossed = _refract(rays, np.full(keep.size, layers.bath), inside, np.ones(keep.size, dtype=bool))
    rays = {name: value[crossed] for name, value in rays.items()}
    grazing = (rays["side"] == 0) & (rays["y"] >= 0)
    rays["side"] = np.where(grazing, np.sign(rays["x"]), rays["side"]).astype(np.int8)
    return rays


def _next_face(layers: Layers, rays: dict[str, Any]) -> tuple[Floats, np.ndarray]:
    """Distance [mm] to the next face, and which face it is; the end of the curved film is a face without effect."""
    film, side, dx, dy = rays["film"], rays["side"], rays["dx"], rays["dy"]
    low, high = np.where(film, layers.inner, layers.outer), np.where(film, layers.outer, layers.shell)
    curved = side == 0
    along = rays["x"] * dx + rays["y"] * dy
    square = (rays["x"] * dy - rays["y"] * dx) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        sink = np.where((along < 0) & (square < low**2), -along - np.sqrt(np.maximum(low**2 - square, 0.0)), np.inf)
        rise = -along + np.sqrt(np.maximum(high**2 - square, 0.0))
        across, lean = rays["x"] * side, dx * side
        inner = np.where(curved, sink, np.where(lean < 0, (low - across) / lean, np.inf))
        outer = np.where(curved, rise, np.where(lean > 0, (high - across) / lean, np.inf))
        back_to = np.where(curved, dy > 0, dy < 0)
        middle = np.where(back_to, -rays["y"] / dy, np.inf)
        finish = np.where(~curved & (dy > 0), (layers.leg - rays["y"]) / dy, np.inf)
    ways = np.maximum(np.stack([inner, outer, middle, finish]), 0.0)
    face = np.argmin(ways, axis=0)
    return np.take_along_axis(ways, face[None], axis=0)[0], face


def _meet(layers: Layers, rays: dict[str, Any], face: np.ndarray) -> np.ndarray:
    """Change the rays at the faces that they have reached; returns how each ends, or `_GOES_ON`."""
    film, curved = rays["film"], rays["side"] == 0
    fate = np.full(face.size, _GOES_ON, dtype=np.int8)
    fate[face == FINISH] = End.LEG
    swap = face == MIDDLE
    rays["side"] = np.where(swap, np.where(curved, np.sign(rays["x"]), 0), rays["side"]).astype(np.int8)
    roller = (face == INNER) & film & curved
    within = ((face == OUTER) & film & (layers.shell > layers.outer)) | ((face == INNER) & ~film)
    bath = ((face == INNER) | (face == OUTER)) & ~roller & ~within
    resin = layers.resin_at(rays["x"], rays["y"])
    here = np.where(film, resin, layers.sheet)
    there = np.where(within, np.where(film, layers.sheet, resin), layers.bath)
    crossed = _refract(rays, here, there, within | bath)
    rays["film"] = film ^ (crossed & within)
    fate[crossed & bath] = End.BATH
    _reflect(rays, (roller & (layers.core is None)) | ((within | bath) & ~crossed))
    if layers.core is not None:
        fate[_through(layers, rays, roller)] = End.ROLLER
        return fate
    if layers.reflectivity == 0:
        fate[roller] = End.ROLLER
    rays["shares"] = np.where(roller[:, None], rays["shares"] * (layers.reflectivity or 1.0), rays["shares"])
    return fate


def _through(layers: Layers, rays: dict[str, Any], roller: np.ndarray) -> np.ndarray:
    """Take rays through a clear roller, and the bath behind it, back into the film; returns those that never return."""
    chosen = np.flatnonzero(roller)
    inside = {name: value[chosen].copy() for name, value in rays.items()}
    core, bath = (np.full(chosen.size, index) for index in (layers.core, layers.bath))
    live = _refract(inside, layers.resin_at(inside["x"], inside["y"]), core, np.ones(chosen.size, bool))
    _reflect(inside, ~live)
    lost = np.zeros(chosen.size, bool)
    for _ in range(MOST_CHORDS):
        if not live.any():
            break
        _move(inside, np.where(live, -2.0 * (inside["x"] * inside["dx"] + inside["y"] * inside["dy"]), 0.0))
        resin = layers.resin_at(inside["x"], inside["y"])
        back = live & (inside["y"] > 0)
        out = _refract(inside, core, np.where(back, bath, resin), live)
        _reflect(inside, live & ~out)
        live, back = live & ~out, back & out
        side = np.sign(inside["dx"])
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (side * layers.inner - inside["x"]) / inside["dx"]
            height = inside["y"] + far * inside["dy"]
        meets = back & (side != 0) & (height > 0) & (height < layers.leg)
        _move(inside, np.where(meets, far, 0.0))
        inside["side"] = np.where(meets, side, inside["side"]).astype(np.int8)
        lost |= back & ~(meets & _refract(inside, bath, layers.resin_at(inside["x"], inside["y"]), meets))
    for name, value in inside.items():
        rays[name][chosen] = value
    return np.isin(np.arange(roller.size), chosen[lost | live])


def _move(rays: dict[str, Any], far: Floats) -> None:
    rays["x"], rays["y"] = rays["x"] + far * rays["dx"], rays["y"] + far * rays["dy"]


_KEPT = ("ray", "x", "y", "dx", "dy", "side")


def _piece(rays: dict[str, Any], far: Floats, polarization: str) -> dict[str, Any]:
    power = left(rays["shares"], polarization)
    keep = rays["film"] & (far > 0) & (power > 0)
    kept = {name: rays[name][keep] for name in _KEPT}
    return {**kept, "length": far[keep], "before": rays["path"][keep], "power": power[keep]}


def _joined(pieces: list[dict[str, Any]]) -> Segments:
    names = (*_KEPT, "length", "before", "power")
    return Segments(**{name: np.concatenate([piece[name] for piece in pieces] or [np.zeros(0)]) for name in names})


def _normals(rays: dict[str, Any]) -> tuple[Floats, Floats]:
    radius = np.hypot(rays["x"], rays["y"])
    curved = rays["side"] == 0
    return np.where(curved, rays["x"] / radius, rays["side"]), np.where(curved, rays["y"] / radius, 0.0)


def _reflect(rays: dict[str, Any], where: np.ndarray) -> None:
    nx, ny = _normals(rays)
    back = np.where(where, 2.0 * (rays["dx"] * nx + rays["dy"] * ny), 0.0)
    rays["dx"], rays["dy"] = rays["dx"] - back * nx, rays["dy"] - back * ny


def _refract(rays: dict[str, Any], before: Floats, after: Floats, where: np.ndarray) -> np.ndarray:
    """Cross a face with Snell's law and Fresnel's loss; without the totally reflected rays."""
    nx, ny = _normals(rays)
    facing = rays["dx"] * nx + rays["dy"] * ny
    ratio, cosine = before / after, np.minimum(np.abs(facing), 1.0)
    square = 1.0 - ratio**2 * (1.0 - cosine) * (1.0 + cosine)
    crossed = where & (square >= 0)
    beyond = np.sqrt(np.maximum(square, 0.0))
    bend = np.where(facing < 0, -1.0, 1.0) * (beyond - ratio * cosine)
    same = before == after
    crossing = np.where(same[:, None], 1.0, fresnel(cosine, beyond, before, after))
    change = crossed & ~same
    rays["dx"] = np.where(change, ratio * rays["dx"] + bend * nx, rays["dx"])
    rays["dy"] = np.where(change, ratio * rays["dy"] + bend * ny, rays["dy"])
    rays["shares"] = np.where(crossed[:, None], rays["shares"] * crossing, rays["shares"])
    return crossed
