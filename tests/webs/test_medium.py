"""Films of a varying index: rays against paths in closed form, and webs that prove from their folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.index_field import FormulaField, FunctionField, GridField, Region
from vamgpu.optics.roller import Roller
from vamgpu.optics.roller_index import FilmIndex
from vamgpu.optics.roller_rays import End
from vamgpu.web import WebGrid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.store import WebFolder
from vamgpu.webs.stream import Stream

FILM = Film(thickness=3.0, resin_index=1.49, bath_index=1.33, absorption=0.22)
WINDOW = Region.box((-10.6, -10.6), (10.6, 14.0))
SQUARE, FALL = 1.49**2 + 0.3, 0.004
"""n² on the axis, and its fall with the square of the way from it [1/mm²]."""
LEAN = 0.02
"""Slope of n² along x and y [1/mm]."""


def bowl(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sqrt(SQUARE - FALL * (x * x + y * y))


def tilted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sqrt(SQUARE + LEAN * (x - 0.5 * y))


MEDIA = {
    "formula": (bowl, FormulaField((1.0, 1.0, 0.0), (SQUARE, -FALL))),
    "grid": (tilted, FunctionField(tilted, WINDOW, samples=64).sampled),
    "function with a region": (tilted, FunctionField(tilted, WINDOW)),
}


def path(index, x: float, y: float, p: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Where a ray of optical direction p is after t = ∫ds/n: an ellipse in the bowl, a parabola in the slope of n²."""
    if index is bowl:
        w = np.sqrt(FALL)
        return x * np.cos(w * t) + p[0] / w * np.sin(w * t), y * np.cos(w * t) + p[1] / w * np.sin(w * t)
    return x + p[0] * t + 0.25 * LEAN * t**2, y + p[1] * t - 0.125 * LEAN * t**2


@pytest.mark.parametrize("kind", MEDIA)
def test_rays_run_along_paths_in_closed_form(kind: str, device: Device) -> None:
    """To the roller: Snell at the outer face by hand, then the path, whose length is summed over a million pieces."""
    index, medium = MEDIA[kind]
    u = np.array([-6.5, -3.0, 0.7, 2.9, 6.0])
    machine = Roller(7.5, FILM, 0.01, index=FilmIndex(medium))
    traced = machine.trace(u, device=device)
    assert (traced.end == End.ROLLER).all()
    s = traced.segments
    for ray, x in enumerate(u):
        y = -np.sqrt(10.5**2 - x * x)
        normal, n = np.array([x, y]) / 10.5, float(index(np.array(x), np.array(y)))
        along = np.array([0.0, 1.33])  # the part along the face is kept, the part across follows from n
        flat = along - (along @ normal) * normal
        p = flat - np.sqrt(n * n - flat @ flat) * normal
        t = np.linspace(0.0, 4.0, 1_000_001)
        px, py = path(index, x, y, p, t)
        stop = int(np.argmax(np.hypot(px, py) <= 7.5))
        length = np.hypot(np.diff(px[: stop + 1]), np.diff(py[: stop + 1])).sum()
        last = np.flatnonzero(s.ray == ray)[-1]
        met = s.x[last] + s.length[last] * s.dx[last], s.y[last] + s.length[last] * s.dy[last]
        assert np.hypot(met[0] - px[stop], met[1] - py[stop]) < 2e-5
        assert traced.length[ray] == pytest.approx(length, abs=2e-5)
        straight = Roller(7.5, FILM, 0.01, index=FilmIndex(FormulaField((0.0, 0.0, 0.0), (n * n,)))).trace(
            [x], device="numpy"
        )
        end = straight.segments
        away = np.hypot(
            met[0] - end.x[-1] - end.length[-1] * end.dx[-1], met[1] - end.y[-1] - end.length[-1] * end.dy[-1]
        )
        assert away > 1e-3  # the medium bends light by more than is allowed


def test_rays_along_the_legs_keep_their_index_along_a_face() -> None:
    """Where n² changes along x alone, the optical direction along y is that of the bath all the way."""
    medium = FunctionField(lambda x, y: np.sqrt(SQUARE + 0.02 * x + 0.0 * y), WINDOW, samples=64).sampled
    traced = Roller(7.5, FILM, 0.01, index=FilmIndex(medium)).trace([-9.2, 9.2], device="numpy")
    s = traced.segments
    legs = s.side != 0
    assert legs.any()
    for ray in range(2):
        own = np.flatnonzero(legs & (s.ray == ray))
        x, dy = s.x[own] + 0.5 * s.length[own] * s.dx[own], s.dy[own]
        along = np.sqrt(SQUARE + 0.02 * x) * dy
        assert np.ptp(along) < 1e-5
        assert np.ptp(dy) > 1e-5 or np.ptp(x) < 1e-2


def test_light_of_a_pose_is_that_of_rays_in_small_straight_pieces(device: Device) -> None:
    """The same film as a plain function, traced without the marching kernels and in a fifth of the pieces' length."""
    kind = "grid"
    index, medium = MEDIA[kind]
    plain, marched = (Roller(7.5, FILM, 0.01, rays=4, index=FilmIndex(one, stride)) for one, stride in
                      ((index, 0.01), (medium, 0.05)))  # fmt: skip
    grid, beam = WebGrid((400, 12, 4), (0.1, 0.25, 0.25)), Beam((60, 4), 0.3)
    one = plain.propagation(grid, beam).dense()
    other = marched.propagation(grid, beam, device).dense()
    assert np.abs(other - one).sum() < 2e-4 * one.sum()
    assert np.abs(Roller(7.5, FILM, 0.01, rays=4).propagation(grid, beam).dense() - one).sum() > 0.01 * one.sum()


def web(index: FilmIndex | None) -> Stream:
    roller = Roller(2.0, Film(1.0, 1.49, 1.33, 0.6), 0.1, legs=1.0, rays=4, index=index)
    rng = np.random.default_rng(3)
    tile = (rng.random((60, 4, 4)) > 0.5).astype(np.float32)
    return Stream(iter([tile]), roller, Beam((18, 4), 0.25), section=(4, 4), length=40 * roller.advance,
                  pitch=(roller.advance, 0.25, 0.25), iterations=2, device="numpy")  # fmt: skip


SMALL = Region.box((-3.2, -3.2), (3.2, 1.2))
KEPT = {
    "none": None,
    "formula": FilmIndex(FormulaField((1.0, 1.0, 0.0), (SQUARE, -0.03)), 0.1),
    "formula with a denominator": FilmIndex(FormulaField((1.0, 0.0, 0.0), (SQUARE,), (1.0, 0.01)), 0.1),
    "grid": FilmIndex(FunctionField(tilted, SMALL, samples=24).sampled, 0.1),
}


@pytest.mark.parametrize("kind", KEPT)
def test_a_web_proves_from_its_folder_whatever_its_medium(kind: str, tmp_path: Path) -> None:
    job = web(KEPT[kind])
    folder = job.write(tmp_path / "web.vam")
    proof = prove_web(folder.path, "numpy")
    given = prove_web(folder.path, "numpy", wrap=job.wrap)
    assert proof.light.shape == job.light.shape
    for name in ("r", "rho", "l", "weight"):
        assert np.array_equal(getattr(proof.light, name), getattr(job.light, name))
    assert np.array_equal(proof.counts, given.counts)
    assert web(KEPT[kind]).write(tmp_path / "web.vam").complete  # the same stream goes on with it
    if kind != "none":
        assert not np.array_equal(job.light.weight, web(None).light.weight)
        with pytest.raises(StorageError, match="another web, with other wrap"):
            web(None).write(tmp_path / "web.vam")


@pytest.mark.parametrize("index", [tilted, FunctionField(tilted, SMALL)])
def test_a_medium_that_no_folder_keeps_is_refused_when_it_is_written(index: object, tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    with pytest.raises(BadInput, match=r"(tilted|FunctionField), a function, which a folder cannot keep.*GridField"):
        web(FilmIndex(index)).write(place)  # type: ignore[arg-type]
    assert not place.exists()


def test_a_malformed_medium_is_refused(tmp_path: Path) -> None:
    folder = web(KEPT["grid"]).write(tmp_path / "web.vam")
    arrays = folder.details["wrap"]["arrays"]
    for entry in arrays.values():
        entry["shape"][0] += 1
    with pytest.raises(StorageError, match="description of a Roller is malformed"):
        prove_web(WebFolder(folder.path, folder.details, folder.segments, True), "numpy")


def test_media_that_a_film_cannot_have_are_told() -> None:
    with pytest.raises(BadInput, match="depends on z"):
        FilmIndex(FormulaField((1.0, 1.0, 1.0), (2.2,)))
    with pytest.raises(BadInput, match="depends on z"):
        FilmIndex(GridField.from_array(np.full((5, 5, 5), 1.5), 1.0))
    small = FilmIndex(GridField.from_array(np.full((9, 9), 1.5), 1.0))
    with pytest.raises(BadInput, match=r"GridField of the film covers -4 to 4.*expected -10.5 to 10.5"):
        Roller(7.5, FILM, 0.01, index=small).trace([1.0], device="numpy")
