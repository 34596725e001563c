"""Runout of a vial's axis, from pictures of a pin's shadow over a turn: its mean place is the axis, its mean slope the
lean; their sines of one period are eccentricity and wobble, and the rest is the bearing's error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite, fitted, noise_of, read_result
from vamgpu.errors import BadInput, ShapeMismatch

LEAST_POSES = 8  # least number of angles per turn for a sine and its scatter
LEAST_CONTRAST = 8.0  # least depth of the shadow, relative to the noise of a pixel
SHARE = 0.2  # share of a lit line's peak that is subtracted before the mean gives its position
OUTLYING = 4.0
"""Distance of a lit line from its expected position, relative to the usual one, that shows a moved edge of the pin."""
ROWS = 4  # rows of the camera that are averaged before a pin is fitted


@dataclass(frozen=True)
class CameraMap:
    """Positions of mirrors in a camera's pictures."""

    column: float  # pixel of mirror column 0 in the camera's row 0
    pitch: float  # pixels per mirror column, below 0 if the camera mirrors
    lean: float  # pixels by which a mirror column moves from one row of the camera to the next
    row: float  # pixel of mirror row 0
    height: float  # pixels per mirror row
    error: float = 0.0
    lean_error: float = 0.0

    @classmethod
    def of(
        cls, columns: Sequence[tuple[float, ArrayLike]], rows: Sequence[tuple[float, ArrayLike]]
    ) -> CameraMap:  # fmt: skip
        """The map, from pictures [row, column] of single lit mirror columns and rows. Raises `BadInput`."""
        column, pitch, lean, error, lean_error = lit_lines("columns", columns)
        row, height, *_ = lit_lines("rows", [(number, np.asarray(each).T) for number, each in rows])
        return cls(column, pitch, lean, row, height, error, lean_error)

    def inside(self, mirrors: tuple[int, int], shape: tuple[int, ...]) -> tuple[slice, slice]:
        """The region of a picture of given shape that mirrors fill, without a border of two mirrors."""
        found = []
        for zero, step, count, length in (
            (self.row, self.height, mirrors[0], shape[0]), (self.column, self.pitch, mirrors[1], shape[1])
        ):  # fmt: skip
            low, high = sorted((zero + 2 * step, zero + (count - 3) * step))
            found.append(slice(max(int(np.ceil(low)), 0), min(int(high) + 1, length)))
        return found[0], found[1]

    def on_mirrors(self, pin: PinShadow, mirrors: tuple[int, int]) -> tuple[float, float]:
        """Column of a pin at the mirrors' middle row, and number of columns by which it moves from row to row."""
        middle = self.row + 0.5 * (mirrors[0] - 1) * self.height
        column = pin.column + pin.slope * middle
        return (column - self.column - self.lean * middle) / self.pitch, (
            (pin.slope - self.lean) * self.height / self.pitch
        )


def lit_lines(what: str, lines: Sequence[tuple[float, ArrayLike]]) -> tuple[float, float, float, float, float]:
    """Position of line 0 in row 0, pixels per line, pixels per row; standard errors of the first and the last."""
    pictures = [(number, np.asarray(each, np.float64)) for number, each in lines]
    peak = max((float(each.max()) for _, each in pictures), default=0.0)
    found: dict[float, tuple[np.ndarray, np.ndarray]] = {}
    hidden = [light.max() <= 0.5 * peak for _, light in pictures]
    for at, (number, light) in enumerate(pictures):
        lit = np.clip(light - SHARE * peak, 0.0, None)
        across, along = np.flatnonzero(lit.sum(axis=0)), lit.sum(axis=1)
        room = 0 if any(hidden[max(at - 1, 0) : at + 2]) else min(across[0], light.shape[1] - 1 - across[-1])
        if room < 2 + across.size:
            continue  # invisible, behind the pin, or close enough to it to be shaded on one side
        seen, place = np.flatnonzero(along > 0.5 * along.max()), np.arange(light.shape[1], dtype=float)
        center = (lit[seen] @ place) / along[seen]
        near = np.abs(place - center[:, None]) <= 2.0 + (lit[seen] > 0).sum(axis=1, keepdims=True)
        found[number] = seen, (light[seen] * near) @ place / (light[seen] * near).sum(axis=1)
    if len(found) < 2:
        raise BadInput(
            f"the camera sees {len(found)} of {len(pictures)} lit {what}; expected two or more: point it at the "
            "middle of the mirrors' image, expose longer"
        )
    middle = 0.5 * (pictures[0][1].shape[0] - 1)
    while True:
        rows = np.concatenate([seen for seen, _ in found.values()])
        number = np.concatenate([np.full(seen.size, n) for n, (seen, _) in found.items()])
        place = np.concatenate([center for _, center in found.values()])
        terms = np.stack([np.ones_like(place), number, rows], axis=1)
        (zero, pitch, lean), *_ = np.linalg.lstsq(terms, place, rcond=None)
        bends = {
            n: np.polynomial.Polynomial.fit(seen, center - zero - pitch * n - lean * seen, 1).convert().coef
            for n, (seen, center) in found.items()
        }
        off = {n: abs(bend[0] + bend[1] * middle) + abs(bend[1]) * middle for n, bend in bends.items()}
        worst = max(off, key=lambda n: off[n])
        if len(found) <= 3 or off[worst] <= OUTLYING * float(np.median(list(off.values()))):
            break
        del found[worst]
    share = np.sqrt(len(found))
    error = float(np.std([bend[0] + bend[1] * middle for bend in bends.values()])) / share
    return float(zero), float(pitch), float(lean), error, float(np.std([bend[1] for bend in bends.values()])) / share


@dataclass(frozen=True)
class PinShadow:
    """The shadow of a straight pin in a picture."""

    column: float  # of its middle in row 0 [pixels]
    slope: float  # pixels a row
    width: float  # of the pin [pixels]


def find_pin(picture: ArrayLike, corner: tuple[int, int] = (0, 0)) -> PinShadow:
    """The shadow of an upright pin, a band between two blurred edges, fitted by least squares. Raises `BadInput`."""
    light = np.asarray(picture, np.float64)
    if light.ndim != 2 or min(light.shape) < 16 or not np.isfinite(light).all():
        raise BadInput(f"the picture has shape {light.shape}; expected finite [row, column] of 16 × 16 pixels or more")
    noise = noise_of(light)
    binned = light[: light.shape[0] // ROWS * ROWS].reshape(-1, ROWS, light.shape[1]).mean(axis=1)
    profile = binned.mean(axis=0)
    bright = float(np.quantile(profile, 0.9))
    shade = np.clip(bright - profile, 0.0, None)
    deep = shade > 0.5 * shade.max()
    if not shade.max() > LEAST_CONTRAST * max(noise, 1e-12) or deep[0] or deep[-1]:
        raise BadInput(
            f"the picture goes from {profile.min():.4g} to {bright:.4g} with a noise of {noise:.2g}; expected the "
            "shadow of one pin, light on both sides of it: put a pin on the turntable, light it, center the camera"
        )
    row, column = np.meshgrid(
        np.arange(len(binned)) * ROWS + 0.5 * (ROWS - 1), np.arange(light.shape[1], dtype=float), indexing="ij"
    )
    middle = 0.5 * (light.shape[0] - 1)
    start = (
        float((shade * deep) @ np.arange(light.shape[1]) / (shade * deep).sum()), 0.0, max(0.5 * deep.sum(), 1.0), 1.5,
        bright, 0.0, 0.0, min(shade.max() / bright, 0.99),
    )  # fmt: skip
    found, _ = fitted(
        _band, np.stack([column.ravel(), row.ravel() - middle]), binned.ravel(), start, "no pin fits the picture",
        "show one straight pin before even light", evaluations=600,
    )  # fmt: skip
    place, slope, half = float(found[0]), float(found[1]), abs(float(found[2]))
    if not half < place < light.shape[1] - 1 - half:
        raise BadInput(f"the pin lies at column {place:.1f} of {light.shape[1]}; expected it inside: center the camera")
    return PinShadow(place - slope * (middle + corner[0]) + corner[1], slope, 2.0 * half)


def _band(
    at: np.ndarray, column: float, slope: float, half: float, blur: float, light: float, across: float, along: float,
    depth: float,
) -> np.ndarray:  # fmt: skip
    """Tilted light with a blurred dark band; ``at`` holds columns and rows, counted from the middle row."""
    from scipy.special import ndtr

    distance = (at[0] - column - slope * at[1]) / np.hypot(1.0, slope)
    shade = ndtr((distance + half) / blur) - ndtr((distance - half) / blur)
    return (light + across * distance + along * at[1]) * (1.0 - depth * shade)


@dataclass(frozen=True)
class Runout:
    """The axis over a turn and the pin on the turntable, in columns of the mirrors.

    Args:
        axis: Column of the axis at the middle row.
        lean: Columns by which the axis moves from row to row.
        across: Cosine and sine amplitudes of the pin's position over the angle [columns], which are its eccentricity.
        tilt: The same for its slope [columns per row], which are its wobble.
        axis_error: Standard error of the axis [columns].
        lean_error: Standard error of the lean [columns a row].
        across_error: Standard error of cosine and sine each [columns].
        tilt_error: Standard error of cosine and sine each [columns a row].
        left: Standard deviation of the pin's position about the sine [columns], from bearing and noise.
    """

    axis: float
    lean: float
    across: tuple[float, float]
    tilt: tuple[float, float]
    axis_error: float = 0.0
    lean_error: float = 0.0
    across_error: float = 0.0
    tilt_error: float = 0.0
    left: float = 0.0

    @classmethod
    def read(cls, numbers: Mapping[str, Any]) -> Runout:
        """Read the numbers that a calibration stored.

        Args:
            numbers: By name.

        Returns:
            The runout.

        Raises:
            KeyError, TypeError, ValueError: The numbers are malformed.
        """
        (a, b), (c, d) = numbers["across"], numbers["tilt"]
        names = ("error_columns", "lean_error", "across_error", "tilt_error", "left")
        errors = (float(numbers[name]) for name in names)
        return cls(
            float(numbers["column"]), float(numbers["lean"]), (float(a), float(b)), (float(c), float(d)), *errors
        )

    @classmethod
    def load(cls, path: str | Path) -> Runout:
        """Read the result of ``vam calibrate runout``.

        Args:
            path: The folder of the result, or its ``result.toml``.

        Returns:
            The runout.

        Raises:
            StorageError: The file cannot be read.
            BadInput: It holds no calibration of this kind.
        """
        return read_result(path, "runout", cls.read)[0]

    @property
    def eccentricity(self) -> float:
        """Distance of the pin from the axis [columns]."""
        return float(np.hypot(*self.across))

    @property
    def wobble(self) -> float:
        """Slope of the pin against the axis [columns a row]."""
        return float(np.hypot(*self.tilt))

    def columns(self, angles: ArrayLike, rows: int, *, turning: bool = True) -> np.ndarray:
        """Columns by which a frame's rows move to follow the vial, after the axis has been centered.

        Args:
            angles: Angles of the frames [rad], (frames,).
            rows: Number of rows of a frame, whose middle is on the mirrors' middle.
            turning: Whether the angle is known; otherwise only the lean counts, which is the same at every angle.

        Returns:
            Columns [frame, row].
        """
        theta, down = np.asarray(angles, np.float64)[:, None], np.arange(rows) - 0.5 * (rows - 1)
        moved = np.broadcast_to(self.lean * down, (theta.size, rows))
        if not turning:
            return moved.copy()
        waves = np.cos(theta), np.sin(theta)
        across, tilt = (sum(part * wave for part, wave in zip(each, waves, strict=True)) for each in
                        (self.across, self.tilt))  # fmt: skip
        return moved + across + tilt * down


def fit_runout(
    angles: ArrayLike, columns: ArrayLike, slopes: ArrayLike, place: CameraMap | None = None
) -> Runout:  # fmt: skip
    """The axis and a sine of one period per turn, by least squares. Raises `BadInput`, `ShapeMismatch`."""
    theta, column, slope = (np.asarray(each, np.float64) for each in (angles, columns, slopes))
    if theta.ndim != 1 or column.shape != theta.shape or slope.shape != theta.shape:
        raise ShapeMismatch(
            f"there are angles of shape {theta.shape}, columns {column.shape}, slopes {slope.shape}; expected one shape"
        )
    check_finite("angles, columns or slopes", theta, column, slope)
    round_ = np.sort(theta % (2.0 * np.pi))
    gap = float(np.diff(np.append(round_, round_[:1] + 2.0 * np.pi)).max(initial=0.0))
    if theta.size < LEAST_POSES or gap > np.pi / 2.0:
        raise BadInput(
            f"{theta.size} angles with a gap of {np.degrees(gap):.0f}°; expected {LEAST_POSES} or more all around a "
            "turn, 90° apart at most"
        )
    terms = np.stack([np.ones_like(theta), np.cos(theta), np.sin(theta)], axis=1)
    spread = np.linalg.inv(terms.T @ terms)
    fits = []
    for values in (column, slope):
        found = spread @ terms.T @ values
        off = values - terms @ found
        scatter = float(np.sqrt(off @ off / (theta.size - 3)))
        wave = float(np.sqrt(0.5 * (spread[1, 1] + spread[2, 2])))
        fits.append((found.tolist(), scatter * float(np.sqrt(spread[0, 0])), scatter * wave, scatter))
    (axis, *across), axis_error, across_error, left = fits[0]
    (lean, *tilt), lean_error, tilt_error, _ = fits[1]
    if place is not None:
        axis_error = float(np.hypot(axis_error, place.error / place.pitch))
        lean_error = float(np.hypot(lean_error, place.lean_error * place.height / place.pitch))
    return Runout(
        axis, lean, (across[0], across[1]), (tilt[0], tilt[1]), axis_error, lean_error, across_error, tilt_error, left
    )
