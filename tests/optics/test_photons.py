"""The light of a roller against photons that run through its film one by one and at random, and share none of its code.

A photon is parallel to y, somewhere in its column, of s or p light by a coin. At a face it passes or is reflected by a
coin as fair as Fresnel says; in resin it ends after a way drawn from exp(−α·s). The film is the half ring
inner ≤ r ≤ outer at y ≤ 0 and, at y > 0, the two strips inner ≤ |x| ≤ outer as far as y = leg.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.web import WebGrid

BATH, SHEET, RESIN, CORE = range(4)
GONE, ABSORBED = -1, -2
HAIR = 1e-9
"""Way [mm] beyond a face at which a photon's medium is asked for."""


@dataclass(frozen=True)
class Scene:
    """inner, outer, leg: of the film [mm].  sheet: thickness of a substrate.  indices: bath, sheet, resin and roller.

    absorption: [1/mm].  mirror: share that the roller reflects; the rest it swallows, unless it is ``clear`` and light
    goes on in it.  echoes: whether what a face reflects in part goes on, instead of being forgotten.
    """

    inner: float
    outer: float
    leg: float
    absorption: float
    indices: tuple[float, float, float, float]
    sheet: float = 0.0
    mirror: float = 0.0
    clear: bool = False
    echoes: bool = False

    def medium(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What fills a place."""
        far = np.where(y <= 0, np.hypot(x, y), np.abs(x))
        core = (far < self.inner) & ((y <= 0) | (np.hypot(x, y) < self.inner))
        films = np.where(far <= self.outer, RESIN, np.where(far <= self.outer + self.sheet, SHEET, BATH))
        return np.where(core, CORE, np.where((far < self.inner) | (y > self.leg), BATH, films))

    def way(self, x: np.ndarray, y: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Way to the nearest face ahead, and its normal's angle; infinite where there is none."""
        best, angle = np.full(x.shape, np.inf), np.zeros(x.shape)

        def offer(way: np.ndarray, holds: np.ndarray, normal: np.ndarray) -> None:
            nearer = holds & (way > HAIR) & (way < best)
            best[nearer], angle[nearer] = way[nearer], normal[nearer]

        with np.errstate(invalid="ignore", divide="ignore"):
            half = x * dx + y * dy
            for radius in {self.inner, self.outer, self.outer + self.sheet}:
                root = np.sqrt(half**2 - (x * x + y * y - radius**2))
                for way in (-half - root, -half + root):
                    at = x + way * dx, y + way * dy
                    whole = radius == self.inner  # the roller is round at its back, too
                    offer(way, np.isfinite(way) & (whole | (at[1] <= 0)), np.arctan2(at[1], at[0]))
                for side in (-radius, radius):
                    way = (side - x) / dx
                    at_y = y + way * dy
                    offer(way, (at_y > 0) & (at_y < self.leg), np.zeros(x.shape))
            way = (self.leg - y) / dy
            offer(way, np.isfinite(way), np.full(x.shape, 0.5 * np.pi))
        return best, angle


def absorbed(scene: Scene, x: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which photons that set out at offsets x [mm] were absorbed in resin, and where: (which, x, y)."""
    n = np.array(scene.indices)
    y, dx, dy = np.full(x.shape, -2.0 * (scene.outer + scene.sheet)), np.zeros(x.shape), np.ones(x.shape)
    x = x.copy()
    s_light, at = rng.random(x.size) < 0.5, np.full(x.size, BATH)
    left = rng.exponential(1.0 / scene.absorption, x.size)
    live = np.arange(x.size)
    for _ in range(2000):
        if not live.size:
            break
        px, py, vx, vy = x[live], y[live], dx[live], dy[live]
        way, angle = scene.way(px, py, vx, vy)
        short = (at[live] == RESIN) & (left[live] < way)
        step = np.where(short, left[live], way)
        lost = ~np.isfinite(step)
        step = np.where(lost, 0.0, step)
        left[live] -= np.where(at[live] == RESIN, step, 0.0)
        x[live], y[live] = px + step * vx, py + step * vy
        nx, ny = np.cos(angle), np.sin(angle)
        before = at[live]
        after = scene.medium(x[live] + 2.0 * HAIR * vx, y[live] + 2.0 * HAIR * vy)
        cos_i = np.abs(vx * nx + vy * ny)
        ratio = n[before] / n[after]
        sin2 = ratio**2 * (1.0 - cos_i**2)
        total = sin2 > 1.0
        cos_t = np.sqrt(np.maximum(1.0 - sin2, 0.0))
        a, b = np.where(s_light[live], n[before], n[after]), np.where(s_light[live], n[after], n[before])
        back = rng.random(live.size) < np.where(total, 1.0, ((a * cos_i - b * cos_t) / (a * cos_i + b * cos_t)) ** 2)
        stops = (after == CORE) & (before != CORE) & (not scene.clear)
        back = np.where(stops, rng.random(live.size) < scene.mirror, back & (before != after))
        sign = np.where(vx * nx + vy * ny < 0, -1.0, 1.0)
        bend = sign * (cos_t - ratio * cos_i)
        through_x, through_y = ratio * vx + bend * nx, ratio * vy + bend * ny
        twice = 2.0 * (vx * nx + vy * ny)
        dx[live] = np.where(back, vx - twice * nx, through_x)
        dy[live] = np.where(back, vy - twice * ny, through_y)
        at[live] = np.where(back, before, after)
        forgotten = back & ~total & ~stops & (not scene.echoes)
        ended = (y[live] >= scene.leg - HAIR) & (before != CORE)
        fate = np.where(short, ABSORBED, np.where(lost | (stops & ~back) | forgotten | ended, GONE, at[live]))
        at[live] = fate
        live = live[fate >= 0]
    which = np.flatnonzero(at == ABSORBED)
    return which, x[which], y[which]


# ---- the library's light against them ----------------------------------------------------------------------------
INNER, THICK, ABSORPTION, LAYERS, COLUMNS, PHOTONS = 7.6, 3.0, 0.22, 15, 22, 40_000
PITCH = 2.0 * (INNER + THICK) / COLUMNS * 0.999
NEUTRAL = INNER + 0.5 * THICK


def machine(film: Film | None = None, **options: Any) -> Roller:
    return Roller(INNER, film or Film(THICK, 1.49, 1.33, ABSORPTION), 0.05, **options)


def web(roller: Roller) -> WebGrid:
    return WebGrid((1, LAYERS, 1), (roller.advance, THICK / LAYERS, PITCH))


def scene(roller: Roller, **options: Any) -> Scene:
    """The same machine for photons; its legs are those of the map, whole voxels long."""
    film, core = roller.film, roller.core
    thick, sheet = film.substrate or (0.0, film.resin_index)
    indices = (film.bath_index, sheet, film.resin_index, core or 1.0)
    leg = roller.map(web(roller)).leg
    return Scene(
        INNER, INNER + THICK, leg, ABSORPTION, indices, thick, roller.reflectivity, core is not None, **options
    )  # type: ignore[arg-type]


def counted(roller: Roller, column: int, rng: np.random.Generator, **options: Any) -> np.ndarray:
    """Photons of a column by voxel (rho, l) of the flat film."""
    start = (column - 0.5 * (COLUMNS - 1) + rng.random(PHOTONS) - 0.5) * PITCH
    _, x, y = absorbed(scene(roller, **options), start, rng)
    bent = y <= 0
    depth = np.where(bent, np.hypot(x, y), np.abs(x)) - INNER
    along = np.where(bent, NEUTRAL * np.arctan2(x, -y), np.sign(x) * (0.5 * np.pi * NEUTRAL + y))
    length = 2.0 * scene(roller).leg + np.pi * NEUTRAL
    bins = (LAYERS, round(length / roller.advance))
    return np.histogram2d(depth, along + 0.5 * length, bins, ((0.0, THICK), (0.0, bins[1] * roller.advance)))[0]


MACHINES = {
    "the paper's": machine(),
    "a roller that reflects": machine(reflectivity=0.6),
    "a substrate": machine(Film(THICK, 1.49, 1.33, ABSORPTION, substrate=(0.075, 1.65))),
    "in air": machine(Film(THICK, 1.49, 1.0, ABSORPTION)),
    "a denser bath": machine(Film(THICK, 1.40, 1.43, ABSORPTION)),
    "a clear roller of the resin's index": machine(core=1.49),
    "a clear roller of the bath's index": machine(core=1.33),
    "a hollow roller": machine(core=1.0),
}
# a column along the rim of a roller of its own index runs round its back in a few rays
FEW = ("a clear roller of the resin's index",)


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.slow] * (number not in (1, 2, 5, 7))) for number, name in enumerate(MACHINES)
])  # fmt: skip
def test_every_column_leaves_what_photons_leave(name: str) -> None:
    """Over depth within five standard deviations of the counts, and voxel by voxel as far apart as counts are."""
    roller, rng = MACHINES[name], np.random.default_rng(7)
    light = roller.propagation(web(roller), Beam((COLUMNS, 1), PITCH)).dense() * PHOTONS
    spread = []
    for column, expected in enumerate(light):
        found = counted(roller, column, rng)
        layers = expected.sum(axis=1)
        assert (np.abs(found.sum(axis=1) - layers) < 5.0 * np.sqrt(layers + 1.0)).all(), column
        many = expected > 25.0
        spread.append(np.mean((found - expected)[many] ** 2 / expected[many]))
    assert 0.7 < np.median(spread) < 1.3
    assert max(spread) < (8.0 if name in FEW else 2.5)


def test_what_faces_reflect_in_part_is_little() -> None:
    """Forgotten by the library: less than half a percent of what is absorbed."""
    roller, rng = machine(), np.random.default_rng(3)
    for column in (1, 4, 10):
        plain, all_light = (counted(roller, column, rng, echoes=echoes).sum() for echoes in (False, True))
        assert abs(all_light / plain - 1.0) < 0.005 + 3.0 * np.sqrt(2.0 / plain)


def test_a_clear_roller_of_the_resins_index_gives_light_back_to_its_rim_alone() -> None:
    """Nine of a hundred columns, whose rays graze it, change; all others are those of a black one."""
    black, clear = machine(), machine(core=1.49)
    beam = Beam((106, 1), PITCH * COLUMNS / 106)
    one, two = (roller.propagation(web(roller), beam).dense().sum(axis=(1, 2)) for roller in (black, clear))
    changed = np.abs(two / one - 1.0) > 1e-9
    assert 4 <= changed.sum() <= 12
    grazing = INNER * 1.49 / 1.33
    assert (np.abs(np.abs(beam.columns()[changed]) - grazing + 0.4) < 0.5).all()
    assert (two >= one * (1.0 - 1e-12)).all()


def test_energy_is_counted_per_flat_or_per_bent_volume() -> None:
    flat, bent = (machine(volume=volume).propagation(web(machine()), Beam((8, 1), 0.5)) for volume in ("flat", "bent"))
    radius = INNER + (np.arange(LAYERS) + 0.5) * THICK / LAYERS
    assert bent.weight == pytest.approx(flat.weight * (NEUTRAL / radius)[flat.rho], rel=1e-12)
    wrongs: list[tuple[dict[str, Any], str]] = [({"volume": "round"}, "expected 'flat' or 'bent'"),
                        ({"core": 1.49, "reflectivity": 0.3}, "expected one of core and reflectivity")]  # fmt: skip
    for wrong, said in wrongs:
        with pytest.raises(BadInput, match=said):
            machine(**wrong)
