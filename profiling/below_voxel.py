"""Prints judged below the voxel while the vial turns: parts × methods × evaluations, by the proof and by a judge apart.

Eight bundled shapes and a bracket with a bore and raised letters, as large as they are, in the README's vial. --size
tells how many pixels of the resin make a part's radius; with 147 the boat's are those of the README. Every method gets
the same voxels, three quarters of a pixel, and the same projector evaluations; each keeps its own default thresholds.

The judge takes from a light its 8-bit frames and nothing else. Its voxels are half a pixel wide and reach from the axis
as far as every pose lights. It asks the vial which ray lights a point, at several places of the arc that a frame is lit
on, and knows the point spread in closed form. From there to the wall, where rays cross each other, it traces them.
Depths are distances from points drawn on the mesh; voxels of the mesh tell inside from outside. Three doses may be
those from which resin is solid: midway between part and void half a pixel from the surface, midway one pixel from it,
and that of the best overlap. The one with the fewest bodies and voids too many or too few counts, so that no method
suffers from a threshold that suits another.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import dataclass
from functools import cached_property
from math import ceil, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import vamgpu
from profiling.common import HERE, machine, write_record
from vamgpu.errors import Diverged, DivergenceWarning, OpticsWarning, SamplingWarning
from vamgpu.geometry import centers
from vamgpu.targets import shapes
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid
from vamgpu.units import mJ_cm3, mW_cm2

VIAL: dict[str, Any] = {
    "radius": 12.4, "wall": 1.0, "resin_index": 1.49962, "wall_index": 1.473, "bath_index": 1.0, "absorption": 0.05,
}  # fmt: skip
LAMP: dict[str, Any] = {"irradiance": 65 * mW_cm2, "critical_dose": 50 * mJ_cm3}
SHAPES = (
    "boat", "gyroid_sphere", "cubic_lattice", "crossing_channels", "gear_base", "screw", "pentamode", "nut", "bracket",
)  # fmt: skip
PARTS = (*SHAPES, "exposure_disk", "gears_0um", "gears_50um")
METHODS = ("ramp", "lbfgs")
BUDGETS = (40, 120, 400)
SIZE = 20
VOXEL = 0.75
"""Width of the part's voxels over that of a pixel in the resin."""
SPREAD = 0.5
"""Standard deviation of the light of a pixel [pixels]."""
DEPTHS = (0.5, 1.0, 2.0)
"""Pixels from the surface at which windows are told."""
FINE = 2
"""The judge's voxels along a pixel, and its cells beside the lit cylinder."""
TRACED = 16
"""Rays traced across such a cell, and steps along each."""
PLACES = 4
"""Fewest places of the arc of a frame; there are two for every pixel that the rim of the part turns."""
REACH = 3.0
"""Pixels from the surface beyond which all depths are alike."""
POINTS = 64
"""Drawn on the mesh for every pixel's area."""
OVERSAMPLED = 8
"""Samples of a column's light."""
LEVELS = 4000
"""Doses tried for the best overlap."""


# ---- parts ----------------------------------------------------------------------------------------------------------
def part(name: str) -> Solid:
    """A part by its name, centered on the axis [mm]."""
    return (bracket() if name == "bracket" else shapes.build(name)).centered()


def bracket(text: float = 0.6) -> Solid:
    """A plate and a wall at right angles, a bore through the wall and raised letters on the plate.

    Args:
        text: Width of the letters' strokes, and how far they stand out [mm].

    Returns:
        The bracket.
    """
    strokes = {
        (0.0, 2.4): [((0.0, 1.0), (0.5, 0.0)), ((0.5, 0.0), (1.0, 1.0))],
        (3.1, 2.4): [((0.0, 0.0), (0.5, 1.0)), ((0.5, 1.0), (1.0, 0.0)), ((0.22, 0.4), (0.78, 0.4))],
        (6.2, 2.6): [((0.0, 0.0), (0.0, 1.0)), ((0.0, 1.0), (0.5, 0.2)), ((0.5, 0.2), (1.0, 1.0)),
                     ((1.0, 1.0), (1.0, 0.0))],
    }  # fmt: skip
    plate = csg.box((-5.0, -3.5, 0.0), (5.0, 3.5, 1.5)) + csg.box((-5.0, 2.0, 0.0), (5.0, 3.5, 7.0))
    bore = csg.rod((0.0, 0.0, 4.4), (0.0, 5.0, 4.4), 1.6)
    letters = []
    for (left, width), lines in strokes.items():
        for line in lines:
            a, b = (np.array((left + width * x - 4.4, 3.4 * y - 2.7)) for x, y in line)
            along = (b - a) / np.hypot(*(b - a)) * 0.5 * text
            across = np.array((-along[1], along[0]))
            corners = [a - along - across, b + along - across, b + along + across, a - along + across]
            letters.append(csg.polygon(corners).extrude(text + 0.5).translate((0.0, 0.0, 1.0)))
    return csg.to_solid(plate - bore + csg.union(letters), "bracket")


@dataclass(frozen=True, eq=False)
class Posed:
    """A part, the projector that finds its light, and the width of a pixel in the resin [mm]."""

    solid: Solid
    target: vamgpu.Target
    A: vamgpu.Projection
    pixel: float


def posed(
    solid: Solid, size: float, device: Any, angles: int = 0, voxel: float = VOXEL, lit_share: float = 1.0
) -> Posed:
    """A part in the vial.

    Args:
        solid: The part, centered.
        size: Pixels of the resin that make its radius.
        device: Where it is.
        angles: Of a turn; 0 takes `vamgpu.enough_angles`.
        voxel: Width of voxels over that of a pixel in the resin.
        lit_share: Of the turntable.

    Returns:
        What there is to print.
    """
    vial = vamgpu.Vial(**VIAL)
    pitch = solid.radius / size * vial.resin_index
    columns = 2 * ceil(solid.radius * vial.resin_index / pitch + 3.0)
    beam = vamgpu.Beam((columns, 2 * ceil(0.5 * solid.height / pitch + 1.5)), pitch, spread=SPREAD * pitch)
    pixel = vamgpu.resin_pixel(beam, vial)[0]
    target = vamgpu.Target.from_mesh(solid, factor=1.0, pitch=voxel * pixel, device=device)
    motion = vamgpu.Turntable(angles or vamgpu.enough_angles(beam, vial, solid.radius), lit_share=lit_share)
    return Posed(solid, target, vamgpu.Projection(target.grid, beam, motion, vial, device), pixel)


# ---- the judge ------------------------------------------------------------------------------------------------------
@wp.kernel
def _shine(
    table: wp.array2d(dtype=float),  # type: ignore[valid-type]
    low: wp.array(dtype=int),  # type: ignore[valid-type]
    share: wp.array(dtype=float),  # type: ignore[valid-type]
    weight: wp.array(dtype=float),  # type: ignore[valid-type]
    dose: wp.array2d(dtype=float),  # type: ignore[valid-type]
):
    point, z = wp.tid()
    i, t = low[point], share[point]
    dose[point, z] += weight[point] * ((1.0 - t) * table[i, z] + t * table[i + 1, z])


@dataclass(frozen=True, eq=False)
class Judge:
    """Exposes the frames of a part on voxels narrower than a pixel, and compares them with its mesh.

    Args:
        solid: The part, centered.
        beam: Pixels.
        vial: What light goes through.
        radius, height: Of the cylinder that is judged [mm].
        pixel: Width in the resin [mm].
        on: Warp's device.
        fine: Voxels along a pixel.
    """

    solid: Solid
    beam: Any
    vial: Any
    radius: float
    height: float
    pixel: float
    on: str = "cpu"
    fine: int = FINE

    @classmethod
    def of(cls, posed: Posed, fine: int = FINE) -> Judge:
        """That of a part in the vial."""
        A = posed.A
        on = "cuda:0" if wp.is_cuda_available() else "cpu"
        height = A.grid.shape[2] * A.grid.pitch
        return cls(posed.solid, A.beam, A.vessel, A.grid.inscribed_radius, height, posed.pixel, on, fine)

    @property
    def pitch(self) -> float:
        """Width of a voxel [mm]."""
        return self.pixel / self.fine

    @cached_property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Centers of voxels along x and y, and along z [mm]: as far as every pose lights, and a row above light."""
        far, high = self.vial.lit_radius, 0.5 * (self.beam.pixels[1] + 2) * self.beam.pitch
        n, nz = (2 * ceil(length / self.pitch) for length in (far, high))
        return (np.arange(n) - 0.5 * (n - 1)) * self.pitch, (np.arange(nz) - 0.5 * (nz - 1)) * self.pitch

    @cached_property
    def away(self) -> np.ndarray:
        """Distance of columns of voxels from the axis [mm], [x, y]."""
        x, _ = self.axes
        return np.hypot(x[:, None], x[None, :])

    @cached_property
    def cylinder(self) -> np.ndarray:
        """Voxels that are judged, [x, y, z]."""
        high = np.abs(self.axes[1]) <= 0.5 * self.height
        return (self.away <= self.radius)[:, :, None] & high

    @cached_property
    def beyond(self) -> np.ndarray:
        """Voxels of all other resin that every pose lights, a pixel or more from the part, [x, y, z]."""
        return (self.away <= self.vial.lit_radius)[:, :, None] & ~self.cylinder & (self.depth <= -1.0)

    @cached_property
    def filled(self) -> np.ndarray:
        """Share of voxels that the part fills, [x, y, z]."""
        x, z = self.axes
        grid = vamgpu.Grid((x.size, x.size, z.size), self.pitch)
        return vamgpu.Target.from_mesh(self.solid, factor=1.0, grid=grid).numpy()

    @cached_property
    def depth(self) -> np.ndarray:
        """Distance below the surface of the mesh [pixels], < 0 outside, at most `REACH`, [x, y, z].

        A voxel that the surface cuts has it (f − ½) of its width from its center. Others have the nearest of many
        points that are drawn on the surface.
        """
        from scipy.ndimage import distance_transform_edt as distance

        filled, (x, z), (tree, _) = self.filled, self.axes, self._drawn
        solid = filled >= 0.5
        depth = np.where(solid, REACH, -REACH).astype(np.float32)
        for side in (solid, ~solid):
            band = side & (distance(side) <= self.fine * (REACH + 1.0))
            i, j, k = np.nonzero(band & (np.abs(filled - 0.5) > 0.49))
            away = tree.query(np.stack([x[i], x[j], z[k]], axis=1), workers=-1)[0] / self.pixel
            depth[i, j, k] = np.minimum(away, REACH) * np.sign(depth[i, j, k])
        cut = np.abs(filled - 0.5) <= 0.49
        depth[cut] = (filled[cut] - 0.5) / self.fine
        return depth

    @cached_property
    def bodies(self) -> np.ndarray:
        """Numbers of the bodies of the mesh in the cylinder, 0 in the void, [x, y, z]; voxels break thin ones."""
        from scipy.ndimage import label

        (x, z), (tree, body) = self.axes, self._drawn
        pieces, count = label((self.depth > 0.0) & self.cylinder)  # type: ignore[misc]
        i, j, k = np.nonzero(pieces)
        nearest = body[tree.query(np.stack([x[i], x[j], z[k]], axis=1), workers=-1)[1]]
        votes = np.zeros((count + 1, body.max() + 2), int)
        np.add.at(votes, (pieces[i, j, k], nearest + 1), 1)
        return votes.argmax(axis=1)[pieces]

    @cached_property
    def _drawn(self) -> tuple[Any, np.ndarray]:
        """Points drawn on the mesh, in a tree, and the body of the mesh that each is on."""
        import trimesh
        from scipy.spatial import cKDTree

        mesh = trimesh.Trimesh(self.solid.vertices, self.solid.faces, process=False)
        drawn = max(ceil(POINTS * mesh.area / self.pixel**2), 1000)
        points, face = trimesh.sample.sample_surface(mesh, drawn, seed=1)
        body = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
        return cKDTree(points), body[face]

    def dose(self, light: np.ndarray, motion: Any) -> np.ndarray:
        """Of light [angle, r, z] on the judge's voxels [x, y, z], 0 where it is not known."""
        (x, z), (columns, rows) = self.axes, self.beam.pixels
        i, j = np.nonzero(self.away <= self.vial.lit_radius)
        at_x, at_y = x[i], x[j]
        samples = centers((columns + 8) * OVERSAMPLED, 1.0 / OVERSAMPLED)
        across, up = _profile(samples, columns), _profile(z / self.beam.pitch, rows)
        out = wp.zeros((at_x.size, z.size), dtype=float, device=self.on)
        offset, weight, first, step = self._rays()
        for frame, theta, arc, lasts in zip(light, motion.poses, motion.arcs, motion.times, strict=True):
            table = wp.array((across @ (frame @ up.T)).astype(np.float32), dtype=float, device=self.on)
            places = self._places(arc)
            for place in range(places):
                turn = theta + ((place + 0.5) / places - 0.5) * arc
                # across and along the light, as the vial asks for points
                right = at_y * np.cos(turn) - at_x * np.sin(turn)
                far = -(at_x * np.cos(turn) + at_y * np.sin(turn))
                u, w = _between((offset, weight), (right - first) / step, (far - first) / step)
                sample = np.clip(
                    (u / self.beam.pitch + 0.5 * (columns + 8)) * OVERSAMPLED - 0.5, 0, len(samples) - 1.001
                )
                low = sample.astype(np.int32)
                given = [low, (sample - low).astype(np.float32), (w * (lasts / places)).astype(np.float32)]
                arrays = [wp.array(each, dtype=kind, device=self.on)
                          for each, kind in zip(given, (int, float, float), strict=True)]  # fmt: skip
                wp.launch(_shine, dim=out.shape, inputs=[table, *arrays, out], device=self.on)
        dose = np.zeros((x.size, x.size, z.size), np.float32)
        dose[i, j] = out.numpy()
        return dose

    def beside(self, dose: np.ndarray, light: np.ndarray, motion: Any) -> float:
        """The greatest dose that is not judged, a pixel or more from the part: of voxels, and of cells to the wall."""
        lit = max(self.vial.lit_radius, self.solid.radius + self.pixel)
        return max(float(each.max(initial=0.0)) for each in (dose[self.beyond], self.traced(light, motion, lit)))

    def traced(self, light: np.ndarray, motion: Any, first: float) -> np.ndarray:
        """Dose from a radius [mm] to the wall in cells of half a pixel [ring, angle, z], of all rays in them."""
        (columns, rows), cell, wall = self.beam.pixels, self.pixel / FINE, self.vial.inner_radius
        rings, turns = ceil((wall - first) / cell), ceil(2.0 * np.pi * wall / cell)
        count = (columns + 8) * FINE * TRACED
        u = centers(count, (columns + 8) / count)
        pose = _traced(self.vial, u * self.beam.pitch, np.linspace(first, wall, rings + 1), turns)
        pose = (pose @ _profile(u, columns)).reshape(rings, turns, columns)
        # each frame turns the light of one pose to its angle, and smears it along its arc
        wave = np.arange(turns // 2 + 1)[:, None]
        turned = motion.times * np.exp(-1j * wave * motion.poses) * np.sinc(wave * motion.arcs / (2.0 * np.pi))
        shown = np.tensordot(turned, light @ _profile(self.axes[1] / self.beam.pitch, rows).T, 1)
        return np.fft.irfft(np.einsum("rwc,wcz->rwz", np.fft.rfft(pose, axis=1), shown, optimize=True), turns, axis=1)

    def _places(self, arc: float) -> int:
        """Of the arc of a frame."""
        return max(PLACES, ceil(2.0 * arc * self.solid.radius / self.pixel)) if arc else 1

    def _rays(self) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Offsets of columns [mm] and weights on a lattice of points; its first place and its step [mm]."""
        reach = min(self.vial.lit_radius + 2.0 * self.pitch, self.vial.inner_radius - 1e-6)
        lattice = np.linspace(-reach, reach, 2 * ceil(reach / self.pitch) + 1)
        u, w = self.vial.illuminate(lattice[:, None], lattice[None, :])
        return u, w, float(lattice[0]), float(lattice[1] - lattice[0])

    def judge(self, light: np.ndarray, motion: Any) -> tuple[dict[str, float], np.ndarray]:
        """What a light prints: numbers by name, and the dose over that from which it is solid."""
        dose, inner = self.dose(light, motion), self.cylinder
        values, depth = dose[inner], self.depth[inner]
        windows, middles = {}, []
        for away in DEPTHS:
            least, most = (_end(values[depth >= away], np.min), _end(values[depth <= -away], np.max))
            windows[away] = (least - most) / float(values.max())
            middles += [0.5 * (least + most)] if isfinite(least + most) and away < 2.0 else []
        wanted = _pieces(self.depth > 0.0, inner)
        tries = []
        for at in (*middles, _best_overlap(values, depth > 0.0)):
            have = _pieces(dose >= at, inner)
            tries.append((sum(abs(a - b) for a, b in zip(have, wanted, strict=True)), len(tries), at, have))
        _, _, at, (bodies, voids) = min(tries)
        off = 1e3 * self.pixel * np.abs(self._off(dose, at))
        wrong = np.abs(depth[(values >= at) != (depth > 0.0)])
        area = self.beam.pitch**2
        sent = float((light.sum(axis=(1, 2)) * motion.times).sum()) * area
        numbers = {
            **{f"W{away:g}": windows[away] for away in DEPTHS},
            "bodies": bodies, "bodies of the mesh": wanted[0], "voids": voids, "voids of the mesh": wanted[1],
            "rms": float(np.sqrt(np.mean(off**2))) if off.size else nan,
            "p95": float(np.quantile(off, 0.95)) if off.size else nan,
            "deepest": float(wrong.max()) if wrong.size else 0.0,
            "beside": self.beside(dose, light, motion) / at,
            "efficiency": float((dose * self.filled)[inner].sum(dtype=np.float64)) * self.pitch**3 / sent,
        }  # fmt: skip
        return numbers, dose / at

    def _off(self, dose: np.ndarray, at: float) -> np.ndarray:
        """Depth [pixels] of the places between neighbors where the dose crosses ``at``."""
        found = []
        for axis in range(3):
            n = dose.shape[axis]
            before, after = (tuple(slice(*cut) if k == axis else slice(None) for k in range(3))
                             for cut in ((0, n - 1), (1, n)))  # fmt: skip
            met = ((dose[before] >= at) != (dose[after] >= at)) & self.cylinder[before] & self.cylinder[after]
            a, b = dose[before][met], dose[after][met]
            deep, next_ = self.depth[before][met], self.depth[after][met]
            found.append(deep + (next_ - deep) * ((at - a) / (b - a)))
        return np.concatenate(found)


def _profile(at: np.ndarray, count: int) -> np.ndarray:
    """Light of so many full pixels in a row, blurred by the point spread, at places [pixels] about its middle."""
    from scipy.special import erf

    pixels, width = at[:, None] - centers(count, 1.0), np.sqrt(2.0) * SPREAD
    return 0.5 * (erf((pixels + 0.5) / width) - erf((pixels - 0.5) / width))


def _between(maps: tuple[np.ndarray, ...], i: np.ndarray, j: np.ndarray) -> list[np.ndarray]:
    """Values of maps at places between their samples, linear along both axes."""
    n = maps[0].shape[0]
    a, b = (np.clip(place.astype(int), 0, n - 2) for place in (i, j))
    p, q = i - a, j - b
    return [
        (m[a, b] * (1 - p) + m[a + 1, b] * p) * (1 - q) + (m[a, b + 1] * (1 - p) + m[a + 1, b + 1] * p) * q
        for m in maps
    ]


def _traced(vial: Any, u: np.ndarray, edges: np.ndarray, turns: int) -> Any:
    """Light [1/mm] in cells (rings × angles) of one pose per light of rays even offsets u [mm] apart, sparse."""
    from scipy.sparse import csr_array

    absorption, wall = vial.absorption, vial.inner_radius
    passed, turn = np.ones((2, u.size)), np.zeros(u.size)
    entering = np.abs(u) < vial.aperture
    for radius, before, after in ((vial.radius, vial.bath_index, vial.wall_index),
                                  (wall, vial.wall_index, vial.resin_index)):  # fmt: skip
        i, t = (np.arcsin(np.clip(u * vial.bath_index / (index * radius), -1.0, 1.0)) for index in (before, after))
        a, b = (np.array([[before], [after]]) * np.cos(i), np.array([[after], [before]]) * np.cos(t))  # s, then p
        passed, turn = passed * (1.0 - ((a - b) / (a + b)) ** 2), turn + i - t
    p, steps = u * vial.bath_index / vial.resin_index, ceil(2.0 * wall / (edges[1] - edges[0]) * TRACED)
    half = np.sqrt(np.maximum(wall**2 - p**2, 0.0))
    along = half * centers(steps, 2.0 / steps)[:, None]
    across, away = p * np.cos(turn) - along * np.sin(turn), p * np.sin(turn) + along * np.cos(turn)
    light = entering * passed.mean(axis=0) * absorption * np.exp(-absorption * (along + half)) * 2.0 * half / steps
    ring = np.searchsorted(edges, np.hypot(across, away), side="right") - 1
    step, ray = np.nonzero((ring >= 0) & (ring < len(edges) - 1))
    ring = ring[step, ray]
    angle = np.floor(np.arctan2(across[step, ray], -away[step, ray]) / (2.0 * np.pi) * turns).astype(int) % turns
    area = np.pi * np.diff(edges**2)[ring] / turns
    shape = ((len(edges) - 1) * turns, u.size)
    return csr_array((light[step, ray] * (u[1] - u[0]) / area, (ring * turns + angle, ray)), shape)


def _end(values: np.ndarray, which: Any) -> float:
    return float(which(values)) if values.size else nan


def _pieces(solid: np.ndarray, judged: np.ndarray) -> tuple[int, int]:
    """Bodies and voids of a print in the judged cylinder."""
    from scipy.ndimage import label

    return tuple(int(label(each & judged)[1]) for each in (solid, ~solid))  # type: ignore[return-value, index]


def _best_overlap(values: np.ndarray, solid: np.ndarray) -> float:
    """The dose from which what is solid overlaps the part best."""
    edges = np.linspace(0.0, float(values.max()), LEVELS + 1)
    inside, outside = (np.histogram(values[of], edges)[0][::-1].cumsum()[::-1] for of in (solid, ~solid))
    return float(edges[np.argmax(inside / (solid.sum() + outside))])


# ---- the record -----------------------------------------------------------------------------------------------------
def found(job: Posed, method: str, evaluations: int) -> Any:
    """The plan of a method with its default thresholds; the light of before, where it diverges."""
    try:
        return vamgpu.optimize(job.A, job.target, method, evaluations=evaluations, progress=False)
    except Diverged as error:
        if error.plan is None:
            raise
        return error.plan


def proved(job: Posed, frames: Any, below: bool = True) -> dict[str, float]:
    """What the proof says of frames; with its windows and surface below the voxel, which take most of the time."""
    proof = vamgpu.simulate(job.A, frames, job.target, **LAMP)
    assert proof.independent and proof.seconds is not None
    numbers = {
        "voxels": proof.scores.window, "seconds": proof.seconds, "efficiency": proof.light_efficiency,
        "idle": proof.idle_light, "beside": proof.outer_share,
    }  # fmt: skip
    if not below:
        return numbers
    surface = proof.judgement.surface
    changes = surface.changes
    return numbers | {
        **_windows(job, proof),
        "rms": 1e3 * surface.rms,
        "p95": 1e3 * surface.p95,
        "bodies changed": changes.bodies_lost + changes.bodies_merged + changes.bodies_broken + changes.bodies_extra,
        "holes changed": changes.holes_closed + changes.holes_opened,
        "cavities changed": changes.cavities_filled + changes.cavities_extra,
    }


def claimed(job: Posed, frames: Any) -> dict[str, float]:
    """Windows by the solver's own projector, as the coarse verdict of `vam solve` has them."""
    return _windows(job, vamgpu.simulate(job.A, frames, job.target, coarse=True, **LAMP))


def _windows(job: Posed, proof: Any) -> dict[str, float]:
    """Of a proof, by the distance from the surface; nan where the part is thinner."""
    told = proof.judgement.over_tolerance
    known = float(told.distance[-1]) * (1.0 + 1e-9)
    return {f"W{away:g}": told.at(away * job.pixel) if away * job.pixel <= known else nan for away in DEPTHS}


def measure(job: Posed, methods: list[str], budgets: list[int], below: bool = True) -> dict[str, Any]:
    """Every method at every budget."""
    judge, out = Judge.of(job), {}
    for method in methods:
        out[method] = {}
        for budget in sorted(budgets):
            began = time.perf_counter()
            plan = found(job, method, budget)
            solved = time.perf_counter() - began
            frames = vamgpu.pack(plan)
            light = frames.irradiance(job.A.device).numpy()
            numbers, _ = judge.judge(light, job.A.motion)
            entry = {
                "claimed": plan.window, "evaluations": plan.evaluations, "solved_s": solved,
                "peak over mean": float(light.max() / light.mean()), "judged": numbers,
                "proved": proved(job, frames, below), "claimed below": claimed(job, frames) if below else {},
            }  # fmt: skip
            out[method][str(budget)] = _rounded(entry)
        print(method, json.dumps(out[method]), flush=True)
    return {
        "voxels": list(job.A.grid.shape), "pixels": list(job.A.beam.pixels), "pixel_mm": round(job.pixel, 5),
        "angles": job.A.motion.angles, "judge_voxels": [judge.axes[0].size] * 2 + [judge.axes[1].size], "methods": out,
    }  # fmt: skip


def _rounded(value: Any) -> Any:
    """Numbers of five digits; None in place of those that are none."""
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, float):
        return float(f"{value:.5g}") if isfinite(value) else None
    return value


HEADER = (
    "part", "evaluations", "method", "W(½)", "W(1)", "W(2)", "bodies", "voids", "RMS [µm]", "95 % [µm]",
    "exposure [s]", "light efficiency [%]", "idle light [%]", "beside ÷ threshold", "claimed − W(½)",
)  # fmt: skip


def table(record: dict[str, Any]) -> str:
    """In Markdown, a row for a part, a budget and a method: the judge's numbers, and the proof's for light and time.

    Bodies and voids are those of the print, of those of the mesh on the same voxels, on which thin walls may fall
    apart. Resin beside is all that lies beyond the judged cylinder, a pixel or more from the part. What a method claims
    is the strict window of its voxels' mean doses.
    """
    lines = ["| " + " | ".join(HEADER) + " |", "|---|--:|---" + "|--:" * (len(HEADER) - 3) + "|"]
    for name, part in record["parts"].items():
        for budget in record["budgets"]:
            for method in record["methods"]:
                entry = part["methods"][method][str(budget)]
                lines.append(f"| {name} | {budget} | {method} | {' | '.join(_cells(entry))} |")
    return "\n".join(lines)


def _cells(entry: dict[str, Any]) -> list[str]:
    judged, proof = entry["judged"], entry["proved"]
    windows = [judged[f"W{away:g}"] for away in DEPTHS]
    return [
        *("–" if w is None else f"{w:+.3f}" for w in windows),
        *(f"{judged[each]} of {judged[f'{each} of the mesh']}" for each in ("bodies", "voids")),
        *("–" if judged[each] is None else f"{judged[each]:.0f}" for each in ("rms", "p95")),
        f"{proof['seconds']:.3g}", f"{100 * proof['efficiency']:.1f}", f"{100 * proof['idle']:.2f}",
        f"{judged['beside']:.2f}",
        f"{entry['claimed'] - judged['W0.5']:+.3f}",
    ]  # fmt: skip


def overview(record: dict[str, Any]) -> str:
    """In Markdown, a row for a part and a budget: windows half a pixel and one from the surface, and 95 % in µm.

    A star stands where the print has other bodies or voids than the mesh on the same voxels.
    """
    methods = record["methods"]
    lines = [f"| part | evaluations | {' | '.join(methods)} |", "|---|--:|" + "--:|" * len(methods)]
    for name, part in record["parts"].items():
        for budget in record["budgets"]:
            cells = (_overview(part["methods"][method][str(budget)]["judged"]) for method in methods)
            lines.append(f"| {name} | {budget} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _overview(judged: dict[str, Any]) -> str:
    windows = ("–" if judged[key] is None else f"{judged[key]:+.3f}".replace("-", "−") for key in ("W0.5", "W1"))
    other = any(judged[each] != judged[f"{each} of the mesh"] for each in ("bodies", "voids"))
    far = "–" if judged["p95"] is None else f"{judged['p95']:.0f}"
    return f"{', '.join(windows)}, {far}{'*' * other}"


def apart(record: dict[str, Any], key: str = "W1", by: str = "proved") -> float:
    """The greatest difference of a window between the judge and the proof; 0 where no proof was asked for it."""
    entries = [
        entry for part in record["parts"].values() for each in part["methods"].values() for entry in each.values()
    ]
    pairs = [(entry["judged"][key], entry[by].get(key)) for entry in entries]
    return max((abs(a - b) for a, b in pairs if a is not None and b is not None), default=0.0)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        "python -m profiling.below_voxel", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(SHAPES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--budgets", nargs="+", type=int, default=list(BUDGETS), help="projector evaluations")
    parser.add_argument("--size", type=float, default=SIZE, help="pixels in the resin that make a part's radius")
    parser.add_argument("--angles", type=int, default=0, help="of a turn; as many as are enough by default")
    parser.add_argument("--quick", action="store_true", help="leave out windows and surfaces of the proof's own")
    parser.add_argument("--device", default=None)
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="cpu", help="of the machine, part of the record's name")
    args = parser.parse_args(arguments)
    for kind in (DivergenceWarning, SamplingWarning, OpticsWarning):
        warnings.simplefilter("ignore", kind)
    device = vamgpu.open_device(args.device)
    budgets = sorted(args.budgets)
    record: dict[str, Any] = {
        "size": args.size, "vial": VIAL, "methods": args.methods, "budgets": budgets, "machine": machine(device),
        "parts": {},
    }  # fmt: skip
    for name in args.parts:
        job = posed(part(name), args.size, device, args.angles)
        record["parts"][name] = measure(job, args.methods, budgets, not args.quick)
        path = write_record(args.records, f"below-voxel-{args.label}", record)
        print(name, "done", flush=True)
    print(table(record))
    if not args.quick:
        for by in ("proved", "claimed below"):
            print(f"windows one pixel from the surface differ by {apart(record, by=by):.3f} at most: judged and {by}")
    print(path)


if __name__ == "__main__":
    main()
