"""Frames that follow a part: whole pixels by which each is moved, and the fraction that is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Turntable

MOVED = 0.5
"""Pixels by which a part that is aside may move while a frame is lit: it counts as being where it is in the middle."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Positions of the frames of every turn in the patterns of a part at rest."""

    # whole: int (turns, angles, 2), column and row of the pattern that column and row 0 of a frame shows. left: (turns,
    # angles, 2), columns and rows by which its light is too far on in the part. lit: whether a frame shows a row of the
    # pattern, (turns, angles, rows), or (turns, angles, 1) for all rows. size: columns and rows of a frame. repeats:
    # turns that show a row.

    whole: np.ndarray
    left: np.ndarray
    lit: np.ndarray
    size: tuple[int, int]
    repeats: int

    def in_steps(self, across: int, along: int) -> list[tuple[tuple[int, int], np.ndarray]]:
        """What is left in steps of a pixel, by cubic polynomials: each step, and shares (angles, rows) moved by it."""
        low = np.floor(self.left * (across, along))
        at, shares = self.left * (across, along) - low, self.lit / self.repeats
        a, b, c = at + 1.0, at - 1.0, at - 2.0  # from the samples at −1, 1 and 2; Lagrange's weights follow
        weights = -at * b * c / 6.0, a * b * c / 2.0, -a * at * c / 2.0, a * at * b / 6.0
        found = dict[tuple[int, int], np.ndarray]()
        for corner in np.ndindex(4, 4):
            weight = np.prod([weights[corner[axis]][..., axis] for axis in (0, 1)], axis=0)
            place = (low + corner - 1).astype(int)
            for step in {*map(tuple, place[weight != 0].tolist())}:
                own = np.where((place == step).all(axis=2), weight, 0.0)[..., None] * shares
                found[step] = found.get(step, 0.0) + own.sum(axis=0)
        return sorted(found.items(), key=lambda each: each[0])


def followed(motion: Turntable, beam: Beam) -> Followed | None:
    """How the frames of a beam follow the part on a turntable; None if it is at rest. Raises `BadInput`."""
    travel = motion.travel
    if travel is None:
        return None
    turn = motion.poses
    across = np.asarray(travel.y) * np.cos(turn) - np.asarray(travel.x) * np.sin(turn)
    away = np.stack(np.broadcast_arrays(across, np.array(travel.up), np.zeros_like(turn))[:2], axis=2) / beam.pitch
    pixels = np.array(beam.pixels)
    far = np.abs(away).max(axis=(0, 1))
    if (far >= np.where(pixels > 1, pixels, 1e-9))[: 1 if travel.rows else 2].any():
        (x, z), (wide, high) = far * beam.pitch, pixels * beam.pitch
        raise BadInput(f"the part travels by up to {x:.4g} mm across the light and {z:.4g} mm along z; expected less "
                       f"than the beam lights, {wide:.4g} and {high:.4g} mm: check the unit and the law")  # fmt: skip
    turned = float(np.hypot(travel.x, travel.y).max() * motion.arcs.max()) / beam.pitch
    if turned > MOVED:
        raise BadInput(f"the part is so far aside that it moves by {turned:.3g} pixels while a frame is lit; expected "
                       f"{MOVED:g} or less: use more angles, a smaller lit_share, or a wider grid")  # fmt: skip
    if (travel.rows or 0) > pixels[1]:
        raise BadInput(f"the path has an image of {travel.rows} rows, and the beam has {pixels[1]}; expected at most "
                       "these: the beam is as tall as the part, and the image is lower")  # fmt: skip
    size = pixels + 2 * np.rint(far).astype(int) * travel.follow
    size[1] = travel.rows or size[1]
    start = 0.5 * (pixels - size) - away
    whole = np.rint(start if travel.follow else np.zeros_like(away)).astype(int)
    every = np.ones((*away.shape[:2], 1), bool), len(away)
    lit, repeats = every if travel.rows is None else _shown(pixels[1], size[1], whole[..., 1], beam.pitch)
    return Followed(whole, start - whole, lit, (int(size[0]), int(size[1])), repeats)


def _shown(rows: int, image: int, first: np.ndarray, pitch: float) -> tuple[np.ndarray, int]:
    """Whether each row is shown, (turns, angles, rows), in equally many turns: those in which it is most central."""
    place = np.arange(rows) - first[..., None]
    off = np.where((place >= 0) & (place < image), np.abs(place - 0.5 * (image - 1)), np.inf)
    seen = np.isfinite(off).sum(axis=0)
    repeats = int(seen.min())
    if not repeats:
        row = int(np.argmin(seen.min(axis=0)))
        z = (row - 0.5 * (rows - 1)) * pitch
        raise BadInput(f"the row at z = {z:.4g} mm never passes the image of {image} rows; expected a path that shows "
                       "every row at every angle: more turns, or a smaller rise")  # fmt: skip
    return np.argsort(np.argsort(off, axis=0, kind="stable"), axis=0) < repeats, repeats
