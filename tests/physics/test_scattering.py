"""Scattered light against laws that hold for every resin, and against integrals without photons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.kernels.photons import UNITS, WAYS, philox, photons
from vamgpu.methods.tolerances import Corner, at
from vamgpu.operators.photon_table import QUANTILES, PhotonCount

RADIUS = 5.0
ITEMS, RAYS = 512, 1 << 14


def test_random_numbers_are_those_of_the_published_generator() -> None:
    """The vector for a counter and a key of zeros in the authors' list of known answers."""
    found = philox(np.zeros(1, np.int64), 0, 0)[:, 0]
    assert [f"{number:08x}" for number in found] == ["5f6fb709", "0d893f64", "4f121f81", "4f730a48"]


def followed(rays: np.ndarray, scattering: float, absorption: float, anisotropy: float, index: float, each: int) -> Any:
    """Paths of photons of rays (1, rays, 8) in a cylinder without a wall; and those absorbed and escaped."""
    device = vam.open_device()
    extinction, way = scattering + absorption, 2.0 * np.pi * np.arange(WAYS) / WAYS
    tables = {
        "rays": rays, "faces": [[RADIUS, index, 1.0, 0.0]], "ways": np.stack([np.cos(way), np.sin(way)], axis=1),
        "cosines": vam.Scattering(scattering, anisotropy).cosines(QUANTILES),
    }  # fmt: skip
    given: dict[str, Any] = {name: device.table(np.array(table)) for name, table in tables.items()}
    given |= {"rings": device.table([[0, 1], [1, 1]], "int32"), "lags": device.table([0], "int32")}
    counts = {name: device.table(np.zeros(ITEMS), "uint32") for name in ("absorbed", "escaped")}
    tally = device.table(np.zeros((1, 2, 1, 2)), "uint32")
    device.launch(
        photons, **given, extinction=extinction, albedo=scattering / extinction, per_ring=1.0 / RADIUS, per_slice=0.0,
        first=0, each=each, most=100_000, seed=7, **counts, tally=tally,
    )  # fmt: skip
    path = tally.numpy().astype(np.float64)
    ended = [int(count.numpy().sum(dtype=np.int64)) for count in counts.values()]
    return (path[..., 0] + 2.0**32 * path[..., 1]).sum() / UNITS / (ITEMS * each), *ended


def lambertian(extinction: float, index: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays into a cylinder from light that is equal in all directions outside; their lengths and transmittances."""
    at = np.arange(RAYS)
    square, turn = (at + 0.5) / RAYS, 2.0 * np.pi * np.modf(at * 0.6180339887498949)[0]
    sine = np.sqrt(square)  # outside, about the normal
    cosine, inside = np.sqrt(1.0 - square), np.sqrt(1.0 - square / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    passed = 1.0 - 0.5 * (s**2 + p**2)
    x, y, z = -inside, sine / index * np.cos(turn), sine / index * np.sin(turn)
    length = -2.0 * RADIUS * x / (x**2 + y**2)
    share = -np.expm1(-extinction * length)
    rays = np.stack([np.full(RAYS, RADIUS), 0 * x, x, y, z, share, passed * share, 0 * x], axis=1)[None]
    return rays, length, passed


@pytest.mark.parametrize(("scattering", "anisotropy"), [(0.1, 0.0), (0.4, 0.9), (1.0, 0.6)])
def test_the_mean_path_does_not_depend_on_the_scattering(scattering: float, anisotropy: float) -> None:
    """It is 4 · volume / surface = 2 · radius for light from all directions: S. Blanco, R. Fournier (2003)."""
    rays, length, _ = lambertian(scattering)
    path, absorbed, escaped = followed(rays, scattering, 0.0, anisotropy, 1.0, each=1500)
    direct = float((-np.expm1(-scattering * length) / scattering).mean())
    assert path + direct == pytest.approx(2.0 * RADIUS, rel=3e-3)
    assert path > 0.3 * direct
    assert (absorbed, escaped) == (0, ITEMS * 1500)


def test_faces_keep_light_as_long_as_equilibrium_needs() -> None:
    """A denser resin holds n² times the light of the air, whatever its face reflects: a mean path of n² · 2 · radius.

    A ray that a face reflects before any collision repeats its chord, turned about the axis.
    """
    index, scattering = 1.5, 0.4
    rays, length, passed = lambertian(scattering, index)
    again = 1.0 / (1.0 - (1.0 - passed) * np.exp(-scattering * length))
    rays[0, :, 6] *= again
    path, absorbed, escaped = followed(rays, scattering, 0.0, 0.0, index, each=800)
    direct = float((passed * again * -np.expm1(-scattering * length)).mean()) / scattering
    assert path + direct == pytest.approx(2.0 * RADIUS * index**2, rel=5e-3)
    assert (absorbed, escaped) == (0, ITEMS * 800)


def test_every_photon_is_absorbed_or_escapes() -> None:
    rays, *_ = lambertian(0.5)
    rays[..., 6] = 1.0
    path, absorbed, escaped = followed(rays, 0.4, 0.1, 0.7, 1.5, each=200)
    assert absorbed + escaped == ITEMS * 200
    assert path * 0.1 == pytest.approx(absorbed / (ITEMS * 200), rel=5e-3)


# ---- the operator ---------------------------------------------------------------------------------------------------
def scene(columns: int = 31, absorption: float = 0.06, **more: Any) -> vam.Projection:
    """Light that is the same at every height, in an index-matched cylinder."""
    same = {"wall": 0.0, "resin_index": 1.5, "wall_index": 1.5, "bath_index": 1.5, **more}
    vial = vam.Vial(radius=RADIUS, absorption=absorption, **same)
    pitch = 7.2 / 32
    beam = vam.Beam((columns, 1), pitch)
    return vam.Projection(vam.Grid((32, 32, 2), pitch), beam, vam.Turntable(60, lit_share=0.0), vial)


def test_a_resin_that_hardly_scatters_is_clear() -> None:
    A = scene()
    S = vam.ScatteringRings(A, vam.Scattering(1e-6), photons=50_000, tolerance=0.5)
    light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
    clear = vam.RingProjection.of(A).T(light)
    assert np.abs(S.T(light) - clear).max() < 3e-5 * clear.max()


def born(A: vam.Projection, lit: np.ndarray, scattering: float, size: int = 144) -> np.ndarray:
    """Fluence of scattered light [across, along] at the first angle: Φ = K ∗ μ_s(Φ₀ + Φ), K of isotropic scattering."""
    from scipy.integrate import quad
    from scipy.ndimage import map_coordinates

    assert A.vessel is not None
    h, pitch, loss = 2.02 * RADIUS / size, A.beam.pitch, scattering + A.vessel.absorption
    place = (np.arange(size) - 0.5 * (size - 1)) * h
    x, y = np.meshgrid(place, place, indexing="ij")
    inside = np.hypot(x, y) < RADIUS
    sigma, entered = A.beam.sigma * pitch, np.zeros(size)
    for part in (np.arange(8) - 3.5) / 8 * h:
        away = (place + part)[:, None] - A.beam.columns()
        entered += (ndtr((away + 0.5 * pitch) / sigma) - ndtr((away - 0.5 * pitch) / sigma)) @ lit / 8
    depth = y + np.sqrt(np.maximum(RADIUS**2 - x**2, 0.0))
    first = entered[:, None] * np.exp(-loss * depth) * inside
    apart = np.fft.fftfreq(2 * size, 1.0 / (2 * size)) * h
    away = np.hypot(apart[:, None], apart)
    far = np.linspace(0.0, away.max(), 300)
    bickley = [quad(lambda t, r=r: np.exp(-loss * r / np.cos(t)), 0.0, 0.5 * np.pi)[0] for r in far]
    kernel = np.interp(away, far, bickley) / (2.0 * np.pi * np.maximum(away, 1e-9)) * h**2
    kernel[0, 0] = 0.0
    kernel[0, 0] = 1.0 / loss - kernel.sum()  # over the whole plane, it is one mean free path
    spectrum, fluence = np.fft.rfft2(kernel), np.zeros_like(first)
    for _ in range(50):
        source = np.fft.rfft2(scattering * (first + fluence) * inside, kernel.shape)
        fluence = np.fft.irfft2(source * spectrum, kernel.shape)[:size, :size] * inside
    x, y, _ = A.grid.axes()
    across, along = np.meshgrid(y, -x)  # light of angle 0 travels towards −x, with its columns along y
    return map_coordinates(fluence, [across / h + 0.5 * (size - 1), along / h + 0.5 * (size - 1)], order=3)


def test_isotropic_scattering_solves_its_integral_equation() -> None:
    scattering, A = 0.6, scene()
    S = vam.ScatteringRings(A, vam.Scattering(scattering, 0.0), photons=3_000_000, tolerance=0.05)
    light = np.zeros(A.range.shape, np.float32)
    light[0, :, 0] = np.random.default_rng(0).integers(0, 2, A.range.shape[1])
    light[0, 15] = 1.0  # the column in the middle, which mirrors itself
    found = (S.T(light) - S.absorbed_share * S._direct.T(light))[:, :, 0]
    wanted = born(A, light[0, :, 0], scattering)
    wanted *= A.vessel.absorption * A.grid.pitch * S._direct.row_weights[0, 0]  # pyright: ignore[reportOptionalMemberAccess]
    lit = A.grid.cylinder().reshape(32, 32)
    assert np.sqrt(np.mean((found - wanted)[lit] ** 2)) < 5e-3 * wanted[lit].max()
    assert found[lit].sum() == pytest.approx(wanted[lit].sum(), rel=3e-3)


def test_photons_start_on_refracted_rays() -> None:
    """Points along the rays are lit by the columns from which these come; all light of a pixel has a ray."""
    vial = vam.Vial(radius=5.0, wall=0.5, resin_index=1.5, wall_index=1.473, absorption=0.06)
    grid, beam = vam.PolarGrid(8, 2, 0.5, 12), vam.Beam((20, 2), 0.3, fill=0.8)
    rays = PhotonCount(grid, beam, vial, vam.Scattering(0.5), 1)._rays
    x, y, ux, uy, uz, share, weight, _ = np.moveaxis(rays, -1, 0)
    assert np.hypot(x, y) == pytest.approx(np.full(x.shape, vial.inner_radius))
    assert not uz.any() and np.hypot(ux, uy) == pytest.approx(np.ones(x.shape))
    length = -np.log1p(-share) / 0.56
    columns = [vial.columns(y + t * length * uy, -(x + t * length * ux)) for t in (0.2, 0.5, 0.7)]
    lit = np.abs(columns[1]) < 0.6 * vial.aperture
    for each in columns:
        assert each[lit] == pytest.approx(columns[0][lit], abs=1e-6)
    u = np.where(lit, columns[0], np.nan)
    assert np.nanmean(u[0]) == pytest.approx(0.15, abs=1e-3)
    assert np.nanstd(u[0]) == pytest.approx(0.3 * np.sqrt(0.8 / 12.0 + beam.sigma**2), rel=0.02)
    assert weight[lit] == pytest.approx(vial.transmitted(u[lit]) * share[lit] * 0.5 / 0.56)


def test_few_terms_describe_light_along_z() -> None:
    vial = vam.Vial(radius=5.0, wall=0.5, resin_index=1.5, wall_index=1.473, absorption=0.06)
    pitch = 0.3
    A = vam.Projection(vam.Grid((16, 16, 16), pitch), vam.Beam((18, 14), 0.4), vam.Turntable(24), vial)
    few, more = (vam.ScatteringRings(A, vam.Scattering(0.5), tolerance=t, photons=600_000) for t in (0.1, 0.015))
    light = np.random.default_rng(0).integers(0, 2, A.range.shape).astype(np.float32)
    dose, better = few.T(light), more.T(light)
    assert few.terms < more.terms <= 6
    assert 1e-4 < np.sqrt(np.mean((dose - better) ** 2)) / better.max() < 0.02


@pytest.mark.parametrize("given", [{"anisotropy": 0.9}, {"anisotropy": -0.5}, {"anisotropy": "rayleigh"}])
def test_quantiles_have_the_moments_of_the_phase_function(given: dict[str, Any]) -> None:
    resin = vam.Scattering(1.0, **given)
    angle = np.linspace(0.0, np.pi, 721)
    rows = tuple(zip(angle.tolist(), resin.density(np.cos(angle)).tolist(), strict=True))
    mean, square = (given["anisotropy"],) * 2 if given["anisotropy"] != "rayleigh" else (0.0, 0.0)
    wanted = 0.4 if given["anisotropy"] == "rayleigh" else (1.0 + 2.0 * square**2) / 3.0
    for each in (resin, vam.Scattering(1.0, phase=rows)):
        cosines = each.cosines(QUANTILES)
        middle = 0.5 * (cosines[1:] + cosines[:-1])
        assert middle.mean() == pytest.approx(mean, abs=4e-4)
        assert np.mean(middle**2) == pytest.approx(wanted, abs=4e-4)
        assert (np.diff(cosines) >= 0.0).all()
        assert each.density(middle).mean() > 0.0


def test_a_tolerance_changes_the_resin_of_scattered_light_too() -> None:
    A, resin = scene(), vam.Scattering(0.6)
    darker = scene(absorption=1.1 * 0.06)
    S = vam.ScatteringRings(A, resin, tolerance=0.1, photons=400_000)
    assert at(S, Corner()) is S
    wanted = vam.ScatteringRings(darker, resin, tolerance=0.1, photons=400_000)
    light = A.device.upload(np.random.default_rng(5).random(A.range.shape, np.float32))
    got, nominal = at(S, Corner(absorption=0.1)).T(light).numpy(), S.T(light).numpy()
    assert np.array_equal(got, wanted.T(light).numpy()) and np.abs(got - nominal).max() > 0.01 * nominal.max()
    assert at(S, Corner(axis=0.05)).operator is S


def test_what_rings_or_photons_cannot_do_is_refused() -> None:
    A, resin = scene(), vam.Scattering(0.6)
    vial = vam.Vial(radius=RADIUS, wall=0.5, resin_index=1.5, wall_index=1.473)
    bath = vam.SquareBath(width=30.0, wall=3.0, wall_index=1.47, vessel=vial)
    measured = vam.Turntable(np.linspace(0.0, 3.0, 60))
    for other, why in (((A.motion, bath), "rings: got a SquareBath; expected a round vial"),
                       ((A.motion, None), "rings: got no vessel; expected a round vial"),
                       ((measured, A.vessel), "even over a full turn")):  # fmt: skip
        with pytest.raises(BadInput, match=why):
            vam.ScatteringRings(vam.Projection(A.grid, A.beam, *other), resin)
    with pytest.raises(BadInput, match="absorption and scattering: too much"):
        vam.ScatteringRings(A, vam.Scattering(1e4, 0.0), photons=100)
    with pytest.raises(BadInput, match="rays are not scattered"):
        vam.projector(A.grid, A.beam, A.motion, A.vessel, algorithm="rays", scattering=resin)
    with pytest.raises(BadInput, match=r"noise of 10 photons .*use photons=\d") as told:
        vam.ScatteringRings(A, resin, photons=10, tolerance=0.02)
    asked = int(str(told.value).rpartition("photons=")[2])
    assert vam.ScatteringRings(A, resin, photons=asked, tolerance=0.02).terms, "what the message asks for is enough"
    known: dict[str, Any] = {"coefficient": 1.0}
    wrong: list[dict[str, Any]] = [{"coefficient": 0.0}, {"anisotropy": 1.0}, {"anisotropy": "0.9"},
                                   {"phase": ((0.0, 1.0), (1.0, 0.5))},
                                   {"phase": ((0.0, 1.0), (1.5, -0.5), (np.pi, 0.1))}]  # fmt: skip
    for each in wrong:
        with pytest.raises(BadInput, match="Scattering"):
            vam.Scattering(**known | each)
    with pytest.raises(BadInput, match="tolerance is 2; expected below 1"):
        vam.ScatteringRings(A, resin, tolerance=2.0)


@pytest.mark.parametrize("seed", [-1, 2**31 - 1, 10**12])
def test_any_whole_number_selects_photons(seed: int) -> None:
    S = vam.ScatteringRings(scene(), vam.Scattering(0.6), photons=50_000, tolerance=0.5, seed=seed)
    assert S.T(np.ones(S.range.shape, np.float32)).min() >= 0.0
