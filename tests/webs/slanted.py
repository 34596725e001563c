"""A machine small enough to solve in a second: slanted rays through a thin film, a window of a dozen columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.geometry import Beam
from vamgpu.web import Propagation, WebGrid
from vamgpu.webs.stream import Stream

EDGE = 0.1
WINDOW = 24
SECTION = (6, 4)


@dataclass(frozen=True)
class Slanted:
    """Each column of the beam crosses the film at an angle of its own and meets it at a place of its own.

    Columns further from the middle arrive further along the window and more slanted, as about a roller. The outermost
    quarters of the window stay dark, as legs of a web do.
    """

    advance: float = EDGE
    window: int = WINDOW

    def propagation(self, grid: WebGrid, beam: Beam) -> Propagation:
        (columns, _), (_, layers, _) = beam.pixels, grid.shape
        side = np.linspace(-1.0, 1.0, columns)
        depth = (np.arange(layers) + 0.5) / layers
        place = 0.5 * self.window + 0.22 * self.window * side[:, None] + 1.5 * side[:, None] * (1.0 - depth)
        weight = grid.edges[1] * 0.3 * np.exp(-0.6 * (1.0 - depth)) * np.cos(0.9 * side[:, None])
        first = np.floor(place - 0.5).astype(int)
        share = place - 0.5 - first
        r, rho = np.meshgrid(np.arange(columns), np.arange(layers), indexing="ij")
        entries = [(first, weight * (1.0 - share)), (first + 1, weight * share)]
        l, w = (np.concatenate([entry[k].ravel() for entry in entries]) for k in (0, 1))  # noqa: E741
        both = np.tile(r.ravel(), 2), np.tile(rho.ravel(), 2)
        return Propagation.gathered((columns, layers, self.window), *both, l, w, 0.5 * self.window * grid.edges[0])


BEAM = Beam((14, SECTION[1]), EDGE)


def part(length: int, seed: int = 0) -> np.ndarray:
    """A target without a period, [l, rho, z] fractions of 0 and 1."""
    l, rho, z = np.meshgrid(np.arange(length), *(np.arange(n) for n in SECTION), indexing="ij")  # noqa: E741
    wave = np.sin(0.45 * l + 1.3 * np.sin(0.057 * l + seed)) + 0.5 * np.cos(0.9 * rho + 0.3 * z)
    return (wave > 0.1).astype(np.float32)


def stream(tiles: object, **options: object) -> Stream:
    """A stream on that machine."""
    known = {"section": SECTION, "pitch": (EDGE,) * 3, "device": "numpy", "iterations": 8} | options
    return Stream(tiles, Slanted(), BEAM, **known)  # type: ignore[arg-type]


def tiled(values: np.ndarray, along: int = 10) -> list[np.ndarray]:
    """An array cut along l."""
    return [values[k : k + along] for k in range(0, len(values), along)]
