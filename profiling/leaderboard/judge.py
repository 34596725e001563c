"""A judge that belongs to no program: it exposes 8-bit frames in a turning vial, by NumPy and SciPy alone.

It imports no projector. Rays follow Snell's law at both faces of the wall in closed form, lose light by Fresnel's
formulas (mean of both polarizations), and are absorbed by Beer-Lambert. A pixel is a square, blurred by a Gaussian.
The vial turns while a frame is lit. The dose is that at the centers of voxels half as wide as a pixel in the resin.

Conventions: light travels along +Y, X is the direction of the columns. At the angle θ of the vial, the point (x, y)
of the part is at X = y·cos θ − x·sin θ, Y = −(x·cos θ + y·sin θ). README.md describes the files.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from math import ceil, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.sparse import csr_array
from scipy.special import erf

FINE = 2
"""Voxels along a pixel in the resin."""
PLACES_A_PIXEL = 2.0
"""Places of the vial during a frame, for each pixel in the resin by which its outermost voxel moves."""
SAMPLES = 32
"""Samples of the light along a pixel; between them it is linear."""
STEPS, SOLVED = 60, 1e-11
"""Most Newton steps for the ray through a point, and the distance [mm] at which it counts as found."""
TAIL = 5.0
"""Standard deviations after which a blurred pixel is dark."""


# ---- vials ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Vial:
    """A vial with a clear wall, full of resin. Lengths in mm, absorption (natural logarithm) in 1/mm."""

    radius: float  # of the outer face; half the outer width of a square
    wall: float
    resin_index: float
    wall_index: float
    bath_index: float
    absorption: float

    @property
    def inner(self) -> float:
        return self.radius - self.wall

    @property
    def magnification(self) -> float:
        """Width of a column in the resin at the axis, relative to its width in front of the vial."""
        return self.bath_index / self.resin_index

    def rays(self, x: np.ndarray, y: np.ndarray, theta: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Rays through points of the part at one angle [rad].

        Args:
            x, y: Points, [...] [mm].
            theta: Angle of the vial.

        Returns:
            For each ray that may reach a point: its offset in front of the vial [mm], and the light absorbed per mm³
            for each mW/mm² there, [...]; 0 where no such ray reaches the point.
        """
        raise NotImplementedError


class RoundVial(Vial):
    """A cylinder about the axis. Its index · distance from the axis is the same along a whole ray."""

    @property
    def aperture(self) -> float:
        """Offset beyond which no ray reaches the resin."""
        return min(self.radius, *(r * n / self.bath_index for r, *sides in self._faces for n in sides))

    @property
    def lit_radius(self) -> float:
        """Radius inside which every angle lights every point, by one ray."""
        return self.aperture * self.magnification

    def rays(self, x: np.ndarray, y: np.ndarray, theta: float) -> list[tuple[np.ndarray, np.ndarray]]:
        return [self.through(*_turned(x, y, theta))]

    def through(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ray through points of the fixed frame, by Newton's method for across·cos d + along·sin d = p."""
        most = self.aperture * (1.0 - 1e-9)
        u = np.clip(across / self.magnification, -most, most)
        for _ in range(STEPS):
            gap, slope = self._gap(u, across, along)
            u = np.clip(u - gap / slope, -most, most)
            if np.abs(gap).max(initial=0.0) < SOLVED:
                break
        gap, slope = self._gap(u, across, along)
        bend, _ = self._bend(u)
        depth = along * np.cos(bend) - across * np.sin(bend)
        half = np.sqrt(np.maximum(self.inner**2 - (u * self.magnification) ** 2, 0.0))
        light = self.absorption * np.exp(-self.absorption * (depth + half)) * self._passed(u) / np.abs(slope)
        found = (np.abs(gap) < 1e3 * SOLVED) & (np.hypot(across, along) <= self.inner)
        return u, np.where(found, light, 0.0)

    def _gap(self, u: np.ndarray, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of the ray at offset u from points, and its derivative: the width of a tube of rays."""
        bend, slope = self._bend(u)
        cos, sin = np.cos(bend), np.sin(bend)
        gap = across * cos + along * sin - u * self.magnification
        return gap, (along * cos - across * sin) * slope - self.magnification

    @property
    def _faces(self) -> tuple[tuple[float, float, float], ...]:
        """Radius and index before and after each face."""
        outer, inner = (self.radius, self.bath_index, self.wall_index), (self.inner, self.wall_index, self.resin_index)
        return outer, inner

    def _bend(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle by which a ray is turned at both faces, and its derivative [rad/mm]."""
        bend, slope = np.zeros_like(u), np.zeros_like(u)
        for radius, before, after in self._faces:
            for index, sign in ((before, 1.0), (after, -1.0)):
                reach = radius * index / self.bath_index
                bend += sign * np.arcsin(np.clip(u / reach, -1.0, 1.0))
                slope += sign / np.sqrt(np.maximum(reach**2 - u**2, 1e-30))
        return bend, slope

    def _passed(self, u: np.ndarray) -> np.ndarray:
        """Share of the light that passes both faces."""
        faces = []
        for radius, before, after in self._faces:
            sines = (np.clip(u * self.bath_index / (index * radius), -1.0, 1.0) for index in (before, after))
            faces.append((before, after, *(np.sqrt(1.0 - s**2) for s in sines)))
        return fresnel(faces)


class SquareVial(Vial):
    """A square cuvette that turns with the part; parallel light stays parallel behind each of the faces it meets."""

    @property
    def magnification(self) -> float:
        """1: a flat face that light meets straight on leaves columns as wide as they are."""
        return 1.0

    @property
    def lit_radius(self) -> float:
        """Radius of the largest circle in the resin."""
        return self.inner

    def rays(self, x: np.ndarray, y: np.ndarray, theta: float) -> list[tuple[np.ndarray, np.ndarray]]:
        light = np.array([-np.cos(theta), -np.sin(theta)])  # direction of the light, in the frame of the part
        columns = np.array([-np.sin(theta), np.cos(theta)])
        found = []
        for k in range(4):
            normal = np.round([np.cos(k * pi / 2), np.sin(k * pi / 2)])
            side = np.array([-normal[1], normal[0]])
            steep, slant = float(-light @ normal), float(light @ side)
            if steep > 1e-12:
                found.append(self._behind(x, y, steep, slant, normal, side, columns))
        return found

    def _behind(
        self, x: np.ndarray, y: np.ndarray, steep: float, slant: float, normal: np.ndarray, side: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Rays behind one face; cosine and sine of the angle of incidence, and the face's directions."""
        sines = (slant * self.bath_index / index for index in (self.bath_index, self.wall_index, self.resin_index))
        (sb, cb), (sw, cw), (sr, cr) = ((s, sqrt(1.0 - s**2)) for s in sines)
        depth = self.inner - (normal[0] * x + normal[1] * y)
        at_inner = side[0] * x + side[1] * y - depth * sr / cr
        at_outer = at_inner - self.wall * sw / cw
        u = self.radius * (normal @ columns) + at_outer * (side @ columns)
        passed = fresnel([(self.bath_index, self.wall_index, cb, cw), (self.wall_index, self.resin_index, cw, cr)])
        light = self.absorption * np.exp(-self.absorption * depth / cr) * passed * steep / cr
        inside = (np.maximum(np.abs(x), np.abs(y)) <= self.inner) & (np.abs(at_inner) <= self.inner)
        return u, np.where(inside & (np.abs(at_outer) <= self.radius), light, 0.0)


SHAPES: dict[str, type[RoundVial] | type[SquareVial]] = {"round": RoundVial, "square": SquareVial}


def fresnel(faces: list[tuple[Any, Any, Any, Any]]) -> Any:
    """Share of unpolarized light that passes faces, each (index before, index after, cosine before, cosine after)."""
    s = p = 1.0
    for before, after, cos_before, cos_after in faces:
        s = s * (1.0 - ((before * cos_before - after * cos_after) / (before * cos_before + after * cos_after)) ** 2)
        p = p * (1.0 - ((after * cos_before - before * cos_after) / (after * cos_before + before * cos_after)) ** 2)
    return 0.5 * (s + p)


def _turned(x: np.ndarray, y: np.ndarray, theta: float) -> tuple[np.ndarray, np.ndarray]:
    return y * np.cos(theta) - x * np.sin(theta), -(x * np.cos(theta) + y * np.sin(theta))


# ---- what is judged -------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setup:
    """A projector and a vial that turns, as in the file judge.toml."""

    vial: RoundVial | SquareVial
    pitch: float  # of the pixels, in front of the vial [mm]
    spread: float  # standard deviation of the Gaussian that blurs a pixel [mm]
    lit_share: float  # part of a frame's time in which it is lit, in the middle
    irradiance: float  # of a full-on pixel in front of the vial [mW/mm²]
    critical_dose: float  # from which resin is solid [mJ/mm³]
    part: Path  # STL, in mm, about the axis z

    @classmethod
    def load(cls, path: Path) -> Setup:
        """Read judge.toml."""
        said = tomllib.loads(path.read_text(encoding="utf-8"))
        vial = dict(said["vial"])
        shape = vial.pop("shape")
        if shape not in SHAPES:
            raise ValueError(f"{path}: vial.shape is {shape!r}; expected one of {', '.join(SHAPES)}")
        if not vial["absorption"] > 0.0:
            raise ValueError(f"{path}: vial.absorption is {vial['absorption']}; expected > 0: clear resin gets no dose")
        return cls(SHAPES[shape](**vial), part=path.parent / said["part"], **said["projector"], **said["resin"])

    @property
    def pixel(self) -> float:
        """Width of a column in the resin at the axis [mm]."""
        return self.pitch * self.vial.magnification


def read_frames(folder: Path) -> np.ndarray:
    """Frames of a folder in the order of their names, as light [angle, column, row], 1 for a full-on pixel.

    Images are 8-bit gray. Their top row is the largest z, their left column the smallest X.
    """
    files = sorted(folder.glob("*.png"))
    if not files:
        raise ValueError(f"{folder} has no *.png; expected an image for each angle")
    frames = []
    for file in files:
        with Image.open(file) as image:
            if image.mode != "L":
                raise ValueError(f"{file} is of mode {image.mode}; expected 8-bit gray (L)")
            frames.append(np.asarray(image, np.uint8))
    return np.stack(frames)[:, ::-1].swapaxes(1, 2) / 255.0


def write_frames(folder: Path, light: np.ndarray) -> None:
    """Write light [angle, column, row], relative to its brightest pixel, as frames of `read_frames`."""
    folder.mkdir(parents=True, exist_ok=True)
    levels = np.rint(255.0 * np.clip(light / light.max(), 0.0, 1.0)).astype(np.uint8)
    for k, frame in enumerate(levels.swapaxes(1, 2)[:, ::-1]):
        Image.fromarray(np.ascontiguousarray(frame)).save(folder / f"{k:05d}.png")


class Exposure:
    """Dose of frames on the voxels of a cylinder.

    Args:
        setup: Projector and vial.
        shape: Angles of a turn, columns and rows of the frames.
        radius: Of the cylinder [mm]; all that the columns light at every angle, if left out.
        fine: Voxels along a pixel in the resin.
    """

    def __init__(
        self, setup: Setup, shape: tuple[int, int, int], radius: float | None = None, fine: int = FINE
    ) -> None:
        self.setup, self.shape = setup, shape
        lit = 0.5 * shape[1] * setup.pixel
        self.radius = min(lit if radius is None else radius, 0.97 * setup.vial.lit_radius)
        self.voxel = setup.pixel / fine
        across, high = ceil(self.radius / self.voxel), ceil(0.5 * (shape[2] + 2) * setup.pitch / self.voxel)
        self.x, self.z = ((np.arange(2 * n) - n + 0.5) * self.voxel for n in (across, high))
        self.inside = np.hypot(self.x[:, None], self.x[None, :]) <= self.radius

    @cached_property
    def places(self) -> np.ndarray:
        """Angles of the vial during frame 0 [rad]."""
        arc = 2.0 * pi / self.shape[0] * self.setup.lit_share
        count = max(1, ceil(PLACES_A_PIXEL * arc * self.radius / self.setup.pixel))
        return ((np.arange(count) + 0.5) / count - 0.5) * arc

    @cached_property
    def _rays(self) -> list[list[tuple[np.ndarray, np.ndarray]]]:
        """Offsets and light of all rays through the voxels, for every angle."""
        x, y = (each[self.inside] for each in np.meshgrid(self.x, self.x, indexing="ij"))
        return [
            [(u.astype(np.float32), light.astype(np.float32))
             for place in self.places for u, light in self.setup.vial.rays(x, y, theta + place)]
            for theta in 2.0 * pi * np.arange(self.shape[0]) / self.shape[0]
        ]  # fmt: skip

    def dose_rate(self, light: np.ndarray) -> np.ndarray:
        """Mean over a turn [mJ/mm³ each second] of light [angle, column, row], on voxels [x, y, z]."""
        angles, columns, rows = self.shape
        if light.shape != self.shape:
            raise ValueError(f"frames are {light.shape}; expected [angle, column, row] of {self.shape}")
        pitch, spread = self.setup.pitch, self.setup.spread
        margin = ceil(TAIL * spread / pitch) + 1
        samples = (np.arange((columns + 2 * margin) * SAMPLES + 1) / SAMPLES - 0.5 * columns - margin) * pitch
        across, total = blurred(samples, columns, pitch, spread), np.zeros((int(self.inside.sum()), rows))
        for frame, rays in zip(light, self._rays, strict=True):
            total += _chosen(rays, samples) @ (across @ frame)
        scale = self.setup.irradiance * self.setup.lit_share / (angles * len(self.places))
        dose = np.zeros((self.x.size, self.x.size, self.z.size))
        dose[self.inside] = scale * total @ blurred(self.z, rows, pitch, spread).T
        return dose


def blurred(at: np.ndarray, count: int, pitch: float, spread: float) -> np.ndarray:
    """Light of each of ``count`` pixels, centered about 0, at places [mm], [place, pixel]."""
    edges = (np.arange(count + 1) - 0.5 * count) * pitch
    if spread == 0.0:
        passed = (at[:, None] >= edges).astype(float)
    else:
        passed = 0.5 * (1.0 + erf((at[:, None] - edges) / (sqrt(2.0) * spread)))
    return passed[:, :-1] - passed[:, 1:]


def _chosen(rays: list[tuple[np.ndarray, np.ndarray]], samples: np.ndarray) -> csr_array:
    """The matrix from samples of the light across to voxels, for one frame: linear between two samples."""
    rows = rays[0][0].size
    place = np.stack([u for u, _ in rays], axis=1).astype(np.float64)
    light = np.stack([each for _, each in rays], axis=1).astype(np.float64)
    place = (place - samples[0]) / (samples[1] - samples[0])
    light[(place < 0.0) | (place > samples.size - 1)] = 0.0
    low = np.clip(np.floor(place), 0, samples.size - 2).astype(np.int32)
    part = np.clip(place - low, 0.0, 1.0)
    columns = np.stack([low, low + 1], axis=2).reshape(rows, -1)
    weights = np.stack([light * (1.0 - part), light * part], axis=2).reshape(rows, -1)
    starts = np.arange(rows + 1) * columns.shape[1]
    return csr_array((weights.ravel(), columns.ravel(), starts), shape=(rows, samples.size))
