"""A print that shares nothing with the library: its own rays, voxels, kinetics and camera, by NumPy and SciPy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, rotate, shift
from scipy.sparse import csr_matrix

FINE = 2  # voxels of the resin along an edge of the plan's
SAMPLES = 8  # samples of the light along a pixel
GROUPS = 6  # parts of a turn, in each of which the kinetics take four steps
STEP = 0.04  # step along the camera's rays, and of the rays' grid [mm]
REACH = 2.6  # half the length of the camera's rays [mm]
HALF = 3.6  # half the width of the rays' grid [mm]
RADIUS, WALL, ABSORPTION = 8.0, 0.5, 0.1  # of the vial [mm], and of its resin [1/mm]
TimeCourse = Callable[[float], float]  # of the time [turns]


def _steady(value: float) -> TimeCourse:
    return lambda time: value


@dataclass(frozen=True)
class Disturbance:
    """What is wrong with a print, as functions of the time [turns] where that makes sense.

    lamp: power relative to the plan.  across: position of the axis off the middle [pixels].  slip: angle by which the
    vial is ahead of its reported angle [deg].  sink: voxels by which cured resin has sunk.  index: of resin and vial.
    inhibitor: relative to fresh resin.  bubble: x, y, z, radius [mm] and its first turn.  gain: of the camera.  stray:
    light added to its images [gray levels].  lost: share of its images that are lost.  roll: angle of the camera
    [deg].  mirrored, inverted: its images are mirrored left-right, or upside down.  late: angles by which they are
    late.  blur: standard deviation of its blur [pixels].  vignetting: darkening at its left and right edges.  frozen:
    turn from which its images repeat.  dust: angle [deg], row and radius [pixels] of a speck on the vial, which turns
    with it.  gel: true gel point, relative to the assumed one.  turbidity: of cured resin, relative to the assumed one.
    """

    lamp: TimeCourse = _steady(1.0)
    across: TimeCourse = _steady(0.0)
    slip: TimeCourse = _steady(0.0)
    sink: TimeCourse = _steady(0.0)
    index: TimeCourse = _steady(1.5)
    inhibitor: float = 41.8 / 56.8
    bubble: tuple[float, float, float, float, float] | None = None
    gain: TimeCourse = _steady(1.0)
    stray: float = 0.0
    lost: float = 0.0
    roll: float = 0.0
    mirrored: bool = False
    inverted: bool = False
    late: int = 0
    blur: float = 0.5
    vignetting: TimeCourse = _steady(0.0)
    frozen: float = np.inf
    dust: tuple[float, float, float] | None = None
    gel: float = 1.0
    turbidity: float = 1.0

    @property
    def of_light(self) -> Disturbance:
        """What is wrong besides the camera."""
        names = "lamp", "across", "slip", "sink", "index", "inhibitor", "bubble", "gel"
        return Disturbance(**{name: getattr(self, name) for name in names})


class Rays:
    """Through each point beside the axis: offset of its column [mm], share of the light there, and depth [mm]."""

    def __init__(self, index: float) -> None:
        self.index = index
        axis = np.arange(-HALF, HALF + STEP / 2, STEP)
        x, y = np.meshgrid(axis, axis, indexing="ij")
        u = index * x
        for _ in range(60):  # Newton's method, for the ray through (x, y)
            turned, there = self._refracted(u)
            slope = 1 / np.sqrt(RADIUS**2 - u**2) - 1 / np.sqrt(index**2 * RADIUS**2 - u**2)
            gap = x * np.cos(turned) + y * np.sin(turned) - u / index
            rise = (-x * np.sin(turned) + y * np.cos(turned)) * slope - 1 / index
            u = np.clip(u - gap / rise, -0.97 * RADIUS, 0.97 * RADIUS)
        turned, there = self._refracted(u)
        outside, inside = np.cos(turned + there), np.cos(there)
        s = ((outside - index * inside) / (outside + index * inside)) ** 2
        p = ((inside - index * outside) / (inside + index * outside)) ** 2
        along = y * np.cos(turned) - x * np.sin(turned)
        passed = along + np.sqrt(np.maximum((RADIUS - WALL) ** 2 - (u / index) ** 2, 0))
        along_x, along_y = np.gradient(u, STEP)
        self._fields = u, np.hypot(along_x, along_y) * (1 - (s + p) / 2) * np.exp(-ABSORPTION * passed), along

    def _refracted(self, u: Any) -> tuple[np.ndarray, np.ndarray]:
        """Angle by which a ray turns at the vial, and its angle to the normal inside."""
        inside = np.arcsin(np.clip(u / (self.index * RADIUS), -1, 1))
        return np.arcsin(np.clip(u / RADIUS, -1, 1)) - inside, inside

    def at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
        places = [(x + HALF) / STEP, (y + HALF) / STEP]
        return tuple(map_coordinates(each, places, order=1) for each in self._fields)

    def points(self, u: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the ray of a column, at lengths along it."""
        turned, _ = self._refracted(u)
        off = u / self.index
        return off * np.cos(turned) - along * np.sin(turned), off * np.sin(turned) + along * np.cos(turned)


class IndependentPrint:
    """A print, turn by turn. scale: dose of the plan in units of the resin's, by `scale_of`. noise: of the camera."""

    def __init__(
        self, shape: tuple[int, int, int], pitch: float, columns: int, angles: int, off: Disturbance, resin: Any,
        turbidity: float, open_field: float, noise: Any, seed: int = 0, scale: float = 1.0,
    ) -> None:  # fmt: skip
        self.shape, self.pitch, self.columns, self.angles = shape, pitch, columns, angles
        self.off, self.resin, self.scale = off, resin, scale
        self._full, self._open, self._noise = turbidity * off.turbidity, open_field, noise
        self._random, self.turns = np.random.default_rng(seed), 0
        self._fine = tuple(FINE * n for n in shape)
        self._edge = pitch / FINE
        across, height = ((np.arange(n) - (n - 1) / 2) * self._edge for n in self._fine[1:])
        self._x, self._y = (each.ravel() for each in np.meshgrid(across, across, indexing="ij"))
        self._z = height
        self._theta = 2 * np.pi * np.arange(angles) / angles
        self._rays: dict[float, Rays] = {}
        self._paths: dict[tuple[Any, ...], Any] = {}
        self._held: np.ndarray | None = None
        self._state = np.zeros((3, across.size**2, height.size))
        self._state[0] = off.inhibitor * resin.induction

    def _rays_of(self, index: float) -> Rays:
        key = round(index, 6)
        if key not in self._rays:
            self._rays[key] = Rays(key)
        return self._rays[key]

    def exposed(self, light: np.ndarray, angle: int, time: float) -> np.ndarray:
        """Dose [xy, z] of one angle of light [angle, r, z]."""
        theta = self._theta[angle] + np.deg2rad(self.off.slip(time))
        x = self._y * np.cos(theta) - self._x * np.sin(theta)
        y = -(self._x * np.cos(theta) + self._y * np.sin(theta))
        u, share, along = self._rays_of(self.off.index(time)).at(x, y)
        place = (u / self.pitch + self.off.across(time) + self.columns / 2) * SAMPLES - 0.5
        low = np.clip(np.floor(place).astype(int), 0, self.columns * SAMPLES - 2)
        part = (place - low)[:, None]
        fine = gaussian_filter(np.repeat(light[angle], SAMPLES, axis=0), (0.5 * SAMPLES, 0.0), mode="constant")
        beam = gaussian_filter(np.repeat(fine, FINE, axis=1), (0.0, 0.5 * FINE), mode="constant")
        dose = (beam[low] * (1 - part) + beam[low + 1] * part) * share[:, None]
        if self.off.bubble is not None and time >= self.off.bubble[4]:
            bx, by, bz, radius, _ = self.off.bubble
            middle = (
                np.array([by * np.cos(theta) - bx * np.sin(theta)]),
                -np.array([bx * np.cos(theta) + by * np.sin(theta)]),
            )
            there, _, depth = self._rays_of(self.off.index(time)).at(*middle)
            behind = (np.abs(u - there) < 1.5 * radius) & (along > depth - radius)
            dose[np.ix_(behind, np.abs(self._z - bz) < radius)] *= 0.05
        return dose

    def turn(self, light: np.ndarray) -> None:
        """One turn: inhibitor, radicals and conversion, step by step in time."""
        count = self.angles // GROUPS
        for group in range(GROUPS):
            dose = np.zeros(self._state.shape[1:])
            for angle in range(group * count, (group + 1) * count):
                time = self.turns + (angle + 0.5) / self.angles
                dose += self.off.lamp(time) * self.exposed(light, angle, time)
            self._react(np.maximum(self.scale * dose, 0.0))
        self.turns += 1
        if sunk := self.off.sink(self.turns) - self.off.sink(self.turns - 1):
            self._state = np.stack([shift(each, (0, -sunk * FINE), order=1, mode="nearest") for each in self._state])

    def _react(self, dose: np.ndarray) -> None:
        """A part of a turn in four steps."""
        inhibitor, radicals, conversion = self._state
        life, step = self.resin.dark, 1 / (4 * GROUPS)
        kept = np.exp(-step / life)
        for _ in range(4):
            used = np.minimum(dose / 4, inhibitor)
            made = dose / 4 - used
            before, radicals = radicals, radicals * kept + made * life / step * (1 - kept)
            inhibitor = inhibitor - used
            conversion = 1 - (1 - conversion) * np.exp(-self.resin.rate * (before + made - radicals))
        self._state = np.stack([inhibitor, radicals, conversion])

    def _lengths(self) -> Any:
        """Lengths of the camera's rays in fine voxels, sparse [angle · column, xy]."""
        off, time = self.off, self.turns
        slips = tuple(round(off.slip(time - 1 + (angle + 0.5) / self.angles), 4) for angle in range(self.angles))
        key = slips, round(off.across(time), 3), round(off.index(time), 6)
        if key in self._paths:
            return self._paths[key]
        rays, columns = self._rays_of(key[2]), np.arange(self.columns) - (self.columns - 1) / 2
        along, half, found = np.arange(-REACH, REACH, STEP), (self._fine[0] - 1) / 2, []
        for angle, theta in enumerate(self._theta + np.deg2rad(slips)):
            for part in (-0.25, 0.25):
                u = (columns + part - key[1]) * self.pitch
                inside = np.abs(u) < RADIUS - WALL
                x, y = rays.points(np.where(inside, u, 0.0)[:, None], along)
                i = (-x * np.sin(theta) - y * np.cos(theta)) / self._edge + half
                j = (x * np.cos(theta) - y * np.sin(theta)) / self._edge + half
                row = np.broadcast_to((angle * self.columns + np.arange(self.columns))[:, None], i.shape)
                found += _bilinear(i, j, row, inside[:, None], self._fine[0])
        rows, cells, weights = (np.concatenate(each) for each in zip(*found, strict=True))
        shape = self.angles * self.columns, self._x.size
        self._paths = {key: csr_matrix((weights * STEP / 2, (rows, cells)), shape=shape)}
        return self._paths[key]

    def images(self) -> np.ndarray:
        """Gray levels of one turn, as this camera gives them, [angle, row, column]; lost images are NaN."""
        off, time = self.off, float(self.turns)
        if self._held is not None and time >= off.frozen:
            return self._held
        field = self._full * self._state[2]
        if off.bubble is not None and time >= off.bubble[4]:
            bx, by, bz, radius, _ = off.bubble
            field[np.ix_(np.hypot(self._x - bx, self._y - by) < radius, np.abs(self._z - bz) < radius)] += 8.0
        depth = (self._lengths() @ field).reshape(self.angles, self.columns, self.shape[2], FINE)
        passed = np.exp(-depth).mean(-1).swapaxes(1, 2)
        if off.dust is not None:
            passed = passed * self._dusty(*off.dust)
        passed = np.stack([gaussian_filter(each, off.blur, mode="nearest") for each in passed])
        gains = np.array([off.gain(time + angle / self.angles) for angle in range(self.angles)])
        edge = np.linspace(-1.0, 1.0, self.columns) ** 2
        levels = passed * self._open * gains[:, None, None] * (1.0 - off.vignetting(time) * edge) + off.stray
        self._held = self._read(self._oriented(levels))
        return self._held

    def _dusty(self, angle: float, row: float, radius: float) -> np.ndarray:
        """Light that passes a speck on the vial's wall, before or behind the resin, [angle, row, column]."""
        row_, column = np.meshgrid(np.arange(self.shape[2]), np.arange(self.columns), indexing="ij")
        seen = RADIUS * np.sin(np.deg2rad(angle) + self._theta) / self.pitch + (self.columns - 1) / 2
        return np.where(np.hypot(column - seen[:, None, None], row_ - row) < radius, 0.7, 1.0)

    def _oriented(self, levels: np.ndarray) -> np.ndarray:
        off = self.off
        if off.roll:
            levels = np.stack([rotate(each, off.roll, reshape=False, order=1, mode="nearest") for each in levels])
        levels = levels[:, :, ::-1] if off.mirrored else levels
        levels = levels[:, ::-1] if off.inverted else levels
        return np.roll(levels, off.late, axis=0)

    def _read(self, levels: np.ndarray) -> np.ndarray:
        noise, random = self._noise, self._random
        shot = noise.gain * random.poisson(np.maximum(levels, 0) / noise.gain)
        read = np.clip(np.rint(shot + random.normal(0, noise.read, levels.shape)), 0, noise.brightest)
        read[random.random(self.angles) < self.off.lost] = np.nan
        return read.astype(np.float32)

    def printed(self) -> np.ndarray:
        """Conversion on the plan's voxels once all radicals have reacted, [x, y, z]."""
        conversion = 1 - (1 - self._state[2]) * np.exp(-self.resin.rate * self._state[1])
        x, y, z = self.shape
        return conversion.reshape(x, FINE, y, FINE, z, FINE).mean((1, 3, 5))

    def overlap(self, part: np.ndarray, level: float | None = None) -> float:
        """Overlap of the print with its part, of a conversion that is solid; by default the true gel point."""
        solid, expected = self.printed() >= (self.off.gel * self.resin.gel if level is None else level), part > 0.5
        return float((solid & expected).sum() / (solid | expected).sum())


def _bilinear(i: np.ndarray, j: np.ndarray, row: np.ndarray, inside: np.ndarray, size: int) -> list[tuple[Any, ...]]:
    """Rows, voxels and weights of the four voxels around each point."""
    found, a, b = [], np.floor(i).astype(int), np.floor(j).astype(int)
    for k, along in ((a, 1 - i + a), (a + 1, i - a)):
        for m, across in ((b, 1 - j + b), (b + 1, j - b)):
            good = (k >= 0) & (m >= 0) & (k < size) & (m < size) & inside
            found.append((row[good], (k * size + m)[good], (along * across)[good]))
    return found


def _steps(first: float, each: float) -> Any:
    """0 until a turn, then rising by a step each turn."""
    return lambda time: each * max(time - first, 0.0)


DISTURBED = {
    "nothing": Disturbance(),
    "camera mirrored": Disturbance(mirrored=True),
    "camera upside down": Disturbance(inverted=True),
    "camera frozen": Disturbance(frozen=6.0),
    "open field +19 %": Disturbance(gain=lambda time: 1.19),
    "bubble of 0.5 mm": Disturbance(bubble=(0.8, 0.5, 0.2, 0.25, 5.0)),
    "camera rolled by 4°": Disturbance(roll=4.0),
    "gain +10 %": Disturbance(gain=lambda time: 1.1),
    "stray light 5 %": Disturbance(stray=40.0),
    "images three angles late": Disturbance(late=3),
    "lamp 60 %": Disturbance(lamp=lambda time: 0.6),
    "lamp +25 %": Disturbance(lamp=lambda time: 1.25),
    "lamp and camera flicker": Disturbance(
        lamp=lambda time: 1.0 + 0.2 * np.sin(2 * np.pi * 7.3 * time),
        gain=lambda time: 1.0 + 0.02 * np.sin(2 * np.pi * 11.7 * time),
    ),
    "gel point +10 %": Disturbance(gel=1.1),
    "gel point -10 %": Disturbance(gel=0.9),
    "index +1e-3": Disturbance(index=lambda time: 1.501),
    "60 % of images lost": Disturbance(lost=0.6),
    "part sinks": Disturbance(sink=_steps(6.0, 0.15)),
    "turbidity -20 %": Disturbance(turbidity=0.8),
    "axis off by half a pixel": Disturbance(across=lambda time: 0.5),
    "dust on the vial": Disturbance(dust=(40.0, 7.0, 3.0)),
    "camera blurred": Disturbance(blur=1.5),
    "vignetting drifts": Disturbance(vignetting=_steps(0.0, 0.01)),
    "rotation 1 % slow": Disturbance(slip=lambda time: -3.6 * time),
}
"""What no part of a live loop models, in used resin."""
