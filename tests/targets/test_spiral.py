"""The spiral: its lengths, its map both ways, and a part cut into film and wound again."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.targets.implicit import voxelize
from vamgpu.targets.lattices import CubicLattice
from vamgpu.targets.spiral import Spiral
from vamgpu.targets.stream import stream
from vamgpu.web import WebGrid

SPIRAL = Spiral(inner=1.5, thickness=1.2, turns=3.5)


class Branches:
    """A ring with four slanted arms and a ball, thicker than a film layer."""

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        ring = np.hypot(np.hypot(x, y) - 3.6, z) - 0.7
        ball = np.sqrt((x - 2.6) ** 2 + (y + 2.8) ** 2 + (z - 0.6) ** 2) - 1.1
        arms = np.minimum(np.hypot(x - z, 1.2 * (y - 0.3 * z)), np.hypot(y + z, 1.2 * (x - 0.3 * z))) - 0.8
        return np.minimum(np.minimum(ring, ball), arms)

    def bound(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return 0.5 * self(x, y, z)  # arms are slanted, so that their value rises by up to 1.7 per mm


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a >= 0.5, b >= 0.5
    return float((a & b).sum() / (a | b).sum())


@pytest.mark.parametrize("neutral", [0.0, 0.5, 1.0])
def test_arc_length_is_the_integral(neutral: float) -> None:
    spiral = Spiral(1.5, 1.2, 3.5, substrate=0.1, neutral=neutral)
    k = (1.2 + 0.1) / (2 * np.pi)
    node, weight = np.polynomial.legendre.leggauss(80)
    psi = 0.5 * spiral.end * (node + 1.0)
    length = 0.5 * spiral.end * float(weight @ np.hypot(1.5 + neutral * 1.2 + k * psi, k))
    assert spiral.length == pytest.approx(length, rel=1e-12)
    assert spiral.end == 7.0 * np.pi and spiral.rise == pytest.approx(k)
    angle = np.linspace(-0.5, spiral.end + 0.5, 50)
    assert spiral.angle(spiral.arc(angle)) == pytest.approx(angle, abs=1e-11)


def test_the_map_and_its_inverse() -> None:
    random = np.random.default_rng(2)
    along, depth = random.uniform(0, SPIRAL.length, 2000), random.uniform(0, SPIRAL.thickness, 2000) * 0.999999
    l, rho, held = SPIRAL.flat(*SPIRAL.wound(along, depth))  # noqa: E741
    assert held.all() and l == pytest.approx(along, abs=1e-9) and rho == pytest.approx(depth, abs=1e-9)


def test_layers_lie_on_each_other_without_gap_or_overlap() -> None:
    x, y = np.random.default_rng(4).uniform(-SPIRAL.outer, SPIRAL.outer, (2, 20_000))
    _, depth, held = SPIRAL.flat(x, y)
    r = np.hypot(x, y)
    between = (r > SPIRAL.inner + 2 * np.pi * SPIRAL.rise) & (r < SPIRAL.inner + SPIRAL.rise * (SPIRAL.end - 2 * np.pi))
    assert held[between].all() and not held[r < SPIRAL.inner].any() and not held[r > SPIRAL.outer].any()
    assert depth[held].min() >= 0 and depth[held].max() <= SPIRAL.thickness
    # Area of the wound film: per angle, half the difference of the squared radii of its faces.
    psi = np.linspace(0, SPIRAL.end, 4001)
    face = SPIRAL.inner + SPIRAL.rise * psi
    area = np.trapezoid(0.5 * ((face + SPIRAL.thickness) ** 2 - face**2), psi)
    assert held.mean() * 4 * SPIRAL.outer**2 == pytest.approx(area, rel=0.02)


def test_substrate_stays_empty() -> None:
    spiral = Spiral(1.5, 1.0, 3.0, substrate=0.5)
    line = np.linspace(1.5, spiral.outer - 1e-9, 5000)
    held = spiral.flat(line, np.zeros_like(line))[2]
    assert held.mean() == pytest.approx(4 * 1.0 / (spiral.outer - 1.5), abs=2e-3)


def test_neutral_line_keeps_its_length() -> None:
    along = np.linspace(0.0, SPIRAL.length, 20_001)
    for share, sign in ((0.5, 0.0), (1.0, 1.0), (0.0, -1.0)):
        x, y = SPIRAL.wound(along, np.full_like(along, share * SPIRAL.thickness))
        way = float(np.hypot(np.diff(x), np.diff(y)).sum())
        if sign:
            assert sign * (way - SPIRAL.length) > 0.1 * SPIRAL.length * 0.5
        else:
            assert way == pytest.approx(SPIRAL.length, rel=1e-6)


@pytest.mark.slow
def test_a_part_cut_on_the_spiral_and_wound_again_matches_itself() -> None:
    part = Branches()
    grid, web = Grid((168, 168, 52), 0.08), SPIRAL.web(0.08, 4.16)
    x, y, z = grid.axes()
    held = SPIRAL.flat(x[:, None], y[None, :])[2]
    solid = voxelize(part, grid, samples=5)
    film = voxelize(SPIRAL.film(part), web, samples=5)
    again = SPIRAL.wind(film, web, grid)
    assert film.shape == web.shape and web.shape[0] == int(np.ceil(SPIRAL.length / 0.08))
    assert overlap(solid * held[..., None], again * held[..., None]) > 0.99
    assert not again[~held & (np.hypot(x[:, None], y[None, :]) < SPIRAL.inner - 0.1)].any()


def test_a_bounded_shape_gives_the_same_film() -> None:
    spiral, lattice = Spiral(1.0, 0.8, 2.0), CubicLattice(1.5, 0.4)
    web = spiral.web((0.1, 0.08, 0.1), 1.5)
    plain = voxelize(spiral.film(lambda x, y, z: lattice(x, y, z)), web)
    assert np.array_equal(voxelize(spiral.film(lattice), web), plain) and 0.05 < plain.mean() < 0.5
    tiles = list(stream(spiral.film(lattice), web.shape[1:], web.pitch, web.size[0], 40))
    assert np.array_equal(np.concatenate(tiles), plain)


@pytest.mark.parametrize(
    ("values", "number"),
    [((0.0, 1.0, 1.0), "0.0"), ((1.0, -1.0, 1.0), "-1.0"), ((1.0, 1.0, float("nan")), "nan"),
     ((1.0, 1.0, 1.0, -0.1), "-0.1"), ((1.0, 1.0, 1.0, 0.0, 1.5), "1.5")],
)  # fmt: skip
def test_bad_spirals(values: tuple[float, ...], number: str) -> None:
    with pytest.raises(BadInput, match=number):
        Spiral(*values)


def test_wrong_arrays() -> None:
    grid, web = Grid((20, 20, 4), 0.1), WebGrid((50, 8, 4), 0.1)
    with pytest.raises(ShapeMismatch, match="50, 8, 4"):
        SPIRAL.wind(np.zeros((50, 8, 3)), web, grid)
