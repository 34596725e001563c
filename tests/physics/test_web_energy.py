"""Energy of a wrapped film: flat, wrapped and ray by ray, each counted by formulas written here."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.web import Propagation, WebGrid

ALPHA, INNER, THICK = 0.22, 7.5, 3.0
OUTER, NEUTRAL = INNER + THICK, INNER + 0.5 * THICK
PITCH = 0.1
CELLS_OF_ARC = 360
DL = np.pi * NEUTRAL / CELLS_OF_ARC
LEG = 170 * DL


def machine(bath: float, resin: float = 1.49, **options: object) -> Roller:
    return Roller(INNER, Film(THICK, resin, bath, ALPHA), np.radians(0.5), legs=LEG, rays=32, **options)  # type: ignore[arg-type]


def light(roller: Roller, columns: int = 210) -> Propagation:
    return roller.propagation(WebGrid((900, 40, 1), (DL, THICK / 40, 0.1)), Beam((columns, 1), PITCH))


def fresnel(incidence: np.ndarray, bath: float, resin: float) -> np.ndarray:
    """Power share that enters, by Fresnel's sine and tangent laws' equivalents in amplitudes."""
    c1 = np.cos(incidence)
    c2 = np.sqrt(1.0 - (bath / resin * np.sin(incidence)) ** 2)
    s = (bath * c1 - resin * c2) / (bath * c1 + resin * c2)
    p = (resin * c1 - bath * c2) / (resin * c1 + bath * c2)
    return 1.0 - 0.5 * (s * s + p * p)


def ray(u: np.ndarray, bath: float, resin: float) -> tuple[np.ndarray, np.ndarray]:
    """Transmittance and way in resin of columns in a bath no denser than the resin.

    A ray leans by h = i − t towards the axis and keeps its speed cos h along y in the legs, whose faces mirror it, so
    that its way to the window's end follows from y alone.
    """
    incidence = np.arcsin(np.abs(u) / OUTER)
    refraction = np.arcsin(bath / resin * np.sin(incidence))
    lean, impact = incidence - refraction, np.abs(u) * bath / resin
    hit = np.where(impact < INNER, lean + np.arcsin(np.minimum(impact / INNER, 1.0)), np.pi)
    down = np.sqrt(OUTER**2 - impact**2) - np.sqrt(np.maximum(INNER**2 - impact**2, 0.0))
    past = (OUTER * np.cos(incidence) + LEG) / np.cos(lean)
    return fresnel(incidence, bath, resin), np.where(hit < 0.5 * np.pi, down, past)


@pytest.mark.parametrize("bath", [1.0, 1.33, 1.42, 1.49])
def test_every_column_leaves_what_its_rays_lose(bath: float) -> None:
    roller = machine(bath)
    found = light(roller)
    u = Beam((210, 1), PITCH).columns()[:, None] + (np.arange(32) - 15.5) * PITCH / 32
    share, length = ray(u, bath, 1.49)
    lost = np.mean(share * -np.expm1(-ALPHA * length), axis=1)
    column = np.bincount(found.r, found.weight, found.shape[0])
    assert np.max(np.abs(column - lost)) < 1e-9
    assert found.weight.sum() == pytest.approx(lost.sum(), rel=1e-4)


@pytest.mark.parametrize("bath", [1.0, 1.33, 1.49])
def test_flat_energy_is_the_integral_of_the_wrapped_field(bath: float) -> None:
    """The curved film: the wrapped field, point by point and through no ray of the library, against the flat voxels."""
    found = light(machine(bath))
    curved = (found.l >= 170) & (found.l < 170 + CELLS_OF_ARC)
    flat = found.weight[curved].sum() * PITCH
    node, weight = np.polynomial.legendre.leggauss(160)
    # φ = 90°·sin(v): dense where the light grazes the film.
    v = 0.5 * np.pi * node
    phi, dphi = 0.5 * np.pi * np.sin(v), 0.25 * np.pi**2 * np.cos(v) * weight
    radius, dr = NEUTRAL + 0.5 * THICK * node, 0.5 * THICK * weight
    field = wrapped(radius[None, :], phi[:, None], bath, 1.49)
    assert flat == pytest.approx(float(dphi @ field @ (dr * radius)), rel=1e-4)


@pytest.mark.parametrize("bath", [1.33, 1.49])
def test_whole_window_holds_what_enters_and_does_not_leave(bath: float) -> None:
    """Legs and all: the integral over the light's width, by another quadrature, is the sum over the flat window."""
    count = 400_000
    angle = np.pi * ((np.arange(count) + 0.5) / count - 0.5)
    share, length = ray(OUTER * np.sin(angle), bath, 1.49)
    whole = np.sum(share * -np.expm1(-ALPHA * length) * OUTER * np.cos(angle)) * np.pi / count
    assert light(machine(bath)).weight.sum() * PITCH == pytest.approx(float(whole), rel=1e-4)


def test_flat_dose_carries_the_jacobian() -> None:
    bath = 1.33
    found = light(machine(bath))
    dose = np.bincount(found.rho * found.shape[2] + found.l, found.weight, 40 * found.shape[2])
    dose = dose.reshape(40, -1) * PITCH / (DL * THICK / 40)
    rho = (np.arange(40) + 0.5) * THICK / 40
    phi = ((np.arange(170, 530) + 0.5) * DL - found.middle) / NEUTRAL
    density = wrapped((INNER + rho)[None, :], phi[:, None], bath, 1.49)
    wanted = (density * (INNER + rho) / NEUTRAL).T
    # Twelve voxels together: near φ = 0 light runs along their walls, and each holds a whole number of rays.
    together = [np.sum(d.reshape(40, 30, 12), axis=2)[:, 2:-2] for d in (dose[:, 170:530], wanted)]
    assert np.max(np.abs(together[0] / together[1] - 1)) < 5e-3
    assert np.ptp((INNER + rho) / NEUTRAL) > 0.3  # what the ratio would miss without the Jacobian


def wrapped(radius: np.ndarray, phi: np.ndarray, bath: float, resin: float) -> np.ndarray:
    """Power per volume at (r, φ) in front of the axis for unit irradiance; the column is found by bisection."""
    radius, phi = np.broadcast_arrays(radius, phi)
    sign, phi = np.where(phi < 0, -1.0, 1.0), np.abs(phi)
    low, high = np.zeros(phi.shape), np.full(phi.shape, 0.5 * np.pi)
    for _ in range(60):
        incidence = 0.5 * (low + high)
        short = place(incidence, radius, bath / resin)[0] < phi
        low, high = np.where(short, incidence, low), np.where(short, high, incidence)
    incidence = 0.5 * (low + high)
    _, lean, impact = place(incidence, radius, bath / resin)
    cosine = np.cos(incidence)
    bend = (1.0 / cosine - bath / resin / np.sqrt(1.0 - (impact / OUTER) ** 2)) / OUTER
    spread = bath / resin + radius * np.cos(phi - lean) * bend
    way = np.sqrt(OUTER**2 - impact**2) - np.sqrt(np.maximum(radius**2 - impact**2, 0.0))
    assert np.all(sign * phi <= 0.5 * np.pi)
    return fresnel(incidence, bath, resin) * ALPHA * np.exp(-ALPHA * way) / spread


def place(incidence: np.ndarray, radius: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """φ at which the ray of an angle of incidence comes down to a radius, its lean and its distance from the axis."""
    refraction = np.arcsin(ratio * np.sin(incidence))
    lean, impact = incidence - refraction, OUTER * ratio * np.sin(incidence)
    # Past its lowest point a ray is beyond 90°, so that the clip only steers the bisection.
    return lean + np.arcsin(np.minimum(impact / radius, 1.0)), lean, impact
