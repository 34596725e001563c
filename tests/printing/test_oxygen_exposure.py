"""Proofs of prints that oxygen inhibits: against Radau, against the solver on a wider grid, and with a wrong solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import solve_ivp

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.chemistry import turns
from vamgpu.chemistry.diffusion import Heat
from vamgpu.chemistry.oxygen import Oxygen, OxygenModel
from vamgpu.printing import oxygen_exposure
from vamgpu.printing.oxygen_exposure import OxygenExposure

PITCH, FLOOR = 0.1, 0.02
Shape = tuple[int, int, int]


def operator(shape: Shape, pixels: tuple[int, int], device: Device, pitch: float = PITCH, **vat: Any) -> Any:
    vessel = vam.Vat(6.0, absorption=0.05, **vat)
    beam, motion = vam.Beam(pixels, PITCH, spread=0.05), vam.Turntable(16)
    return vam.Projection(vam.Grid(shape, pitch), beam, motion, vessel, device)


def lit(A: Any, most: float) -> np.ndarray:
    light = np.random.default_rng(0).random(A.range.shape).astype(np.float32)
    return light * np.float32(most / np.asarray(A.T(light)).max())


def proved(model: OxygenModel, light: np.ndarray) -> np.ndarray:
    field = model.device.upload(light)
    return OxygenExposure(model).agreed(field).averaged(field)[0].numpy().astype(float)


def means(values: np.ndarray, f: int) -> np.ndarray:
    """Means over blocks of f voxels along each axis, or of all slices where there are fewer."""
    x, y, z = (n // f or 1 for n in values.shape)
    return values.reshape(x, -1, y, values.shape[1] // y, z, values.shape[2] // z).mean(axis=(1, 3, 5))


def by_radau(model: OxygenModel, light: np.ndarray, f: int) -> np.ndarray:
    """Effective dose of a slice within a wall, on voxels of 1 / f of the width, the light of each angle at its time."""
    A: Any = model.operator
    n, oxygen = f * A.grid.shape[0], model.oxygen
    B = vam.Projection(vam.Grid((n, n, 1), PITCH / f), A.beam, A.motion, A.vessel, A.device)
    x = B.grid.axes()[0]
    resin = np.hypot(x[:, None], x) <= A.vessel.radius
    number, flux = np.arange(n * n).reshape(n, n), sparse.csr_matrix((n * n, n * n))
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        at, to = number[one][resin[one] & resin[other]], number[other][resin[one] & resin[other]]
        step = sparse.csr_matrix((np.ones(at.size), (at, to)), (n * n, n * n))
        flux = flux + step + step.T
    flux = oxygen.diffusivity * (f / PITCH) ** 2 * (flux - sparse.diags(np.asarray(flux.sum(axis=1)).ravel()))
    used, count = np.kron(np.asarray(oxygen.used)[:, :, 0], np.ones((f, f))).ravel(), light.shape[0]
    state, seconds = np.concatenate([1.0 - used, np.zeros(n * n)]), oxygen.period / count
    for step in range(oxygen.turns * count):
        alone = np.where((np.arange(count) == step % count)[:, None, None], light, 0.0)
        rate = np.asarray(B.T(alone)).ravel() * f**3 / (oxygen.turns * seconds)

        def change(_: float, y: np.ndarray, rate: np.ndarray = rate) -> np.ndarray:
            share = rate / (y[: n * n] + FLOOR)
            return np.concatenate([flux @ y[: n * n] - share * y[: n * n], share * FLOOR])

        def slope(_: float, y: np.ndarray, rate: np.ndarray = rate) -> Any:
            by_a = sparse.diags(rate * FLOOR / (y[: n * n] + FLOOR) ** 2)
            return sparse.bmat([[flux - by_a, None], [-by_a, sparse.csr_matrix((n * n, n * n))]], format="csc")

        state = solve_ivp(change, (0.0, seconds), state, "Radau", rtol=1e-5, atol=1e-6, jac=slope).y[:, -1]
    return means((1.0 + state[n * n :] - state[: n * n]).reshape(n, n, 1), f)


def test_an_exposure_agrees_with_radau(fast_device: Device) -> None:
    """Uneven oxygen within a wall; so does the solver, whose wall is that of the resin, on voxels a pixel wide."""
    A = operator((12, 12, 1), (12, 1), fast_device, radius=0.55)
    used = np.broadcast_to(np.linspace(0.1, 0.5, 12)[:, None, None], (12, 12, 1))
    model, light = OxygenModel(A, Oxygen(2e-3, 1, 18.0, used, runs=16, floor=FLOOR)), lit(A, 1.6)
    exact, near = by_radau(model, light, 2), np.hypot(*np.meshgrid(*A.grid.axes()[:2])) < 0.4
    most = exact[near].max()
    assert np.abs(proved(model, light) - exact)[near].max() <= 0.003 * most
    assert np.abs(np.asarray(model.T(light)) - exact)[near].max() <= 0.005 * most
    assert np.abs(np.asarray(A.T(light)) + used - exact)[near].max() > 0.04 * most


def test_oxygen_comes_from_air_and_from_resin_beside_the_grid(fast_device: Device) -> None:
    """Against the solver on a wide grid, with voxels of half the width and shorter steps; the beam is narrow."""
    profile = np.linspace(0.4, 0.0, 5)
    narrow, wide = (operator(shape, (6, 5), fast_device, pitch) for shape, pitch in
                    (((6, 6, 5), PITCH), ((28, 28, 10), PITCH / 2)))  # fmt: skip
    oxygen = {"diffusivity": 1e-3, "turns": 2, "period": 9.0, "air": ("z high",), "runs": 16}
    model = OxygenModel(narrow, Oxygen(used=profile, **oxygen))  # type: ignore[arg-type]
    judge = OxygenModel(wide, Oxygen(used=np.repeat(profile, 2), steps=4, **oxygen))  # type: ignore[arg-type]
    light = lit(narrow, 1.6)
    exact = means(8.0 * np.asarray(wide.T(light)), 2)[4:10, 4:10]
    assert np.abs(exact - np.asarray(narrow.T(light))).max() <= 0.01
    exact = means(np.asarray(judge.T(8.0 * light)), 2)[4:10, 4:10]
    near = np.broadcast_to(narrow.grid.cylinder()[:, :, None], exact.shape)
    found, own = proved(model, light), np.asarray(model.T(light))
    assert np.abs(found - exact)[near].max() <= 0.01 * exact.max()
    assert np.abs(own - exact)[near].max() > 0.03 * exact.max()


def test_finer_voxels_have_the_dose_of_a_solver_on_them(fast_device: Device) -> None:
    """Voxel by voxel, in resin that reaches far above and below the grid."""
    narrow, wide = (operator(shape, (10, 4), fast_device, pitch, radius=0.7) for shape, pitch in
                    (((10, 10, 4), PITCH), ((29, 29, 33), PITCH / 2)))  # fmt: skip
    oxygen = Oxygen(1e-3, 2, 9.0, 0.2, runs=16)
    exposure, even = OxygenExposure(OxygenModel(narrow, oxygen)), np.ones(narrow.range.shape, np.float32)
    light = even * np.float32(1.6 / narrow.T(even).max())
    slabs = list(exposure.fine(fast_device.upload(light), 0.4))
    found, first = np.concatenate([slab.dose.numpy() for slab in slabs], axis=2), slabs[0]
    exact = np.asarray(OxygenModel(wide, oxygen).T(8.0 * light))
    (x, y, _), z = wide.grid.axes(), np.concatenate([slab.z for slab in slabs])
    near = np.hypot(*np.meshgrid(x, y)) < 0.4
    own = np.ix_(*(np.abs(at[:, None] - axis).argmin(axis=0) for at, axis in
                   zip((first.x, first.y, z), wide.grid.axes(), strict=True)))  # fmt: skip
    assert z.size == 9 and first.pitch == PITCH / 2
    gap = np.abs(found[own] - exact)[near] / exact.max()
    assert gap[:, 14:19].max() <= 0.012 and gap[:, 12:21].max() <= 0.04  # it is steep where the light ends
    plain = np.asarray(wide.T(8.0 * light)) + 0.2
    assert (np.abs(plain - exact)[near] / exact.max())[:, 12:21].max() > 0.1


def test_a_run_lasts_as_long_as_its_angles(fast_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 16 angles in ten runs, the last four are by themselves, as all are in 16 runs; only these are lit."""
    A = operator((12, 12, 1), (12, 1), fast_device, radius=0.55)
    oxygen = Oxygen(2e-3, 1, 18.0, np.random.default_rng(7).uniform(0.0, 0.5, (12, 12, 1)))
    light, found = lit(A, 1.6), list[np.ndarray]()
    light[:12] = 0.0
    for runs in (10, 16):
        monkeypatch.setattr(oxygen_exposure, "RUNS", runs)
        found.append(proved(OxygenModel(A, oxygen), light))
    assert np.abs(found[0] - found[1]).max() <= 1e-3 * found[1].max()


def test_oxygen_is_followed_once_for_the_same_light(fast_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Judgement, report and folder ask for fine voxels of the same frames."""
    seen, follow = list[float](), OxygenExposure._more
    monkeypatch.setattr(OxygenExposure, "_more", lambda self, *given: seen.append(most) or follow(self, *given))
    A = operator((6, 6, 1), (6, 1), fast_device)
    model = OxygenModel(A, Oxygen(1e-3, 1, 9.0))
    for most in (1.6, 1.6, 1.2):
        light = fast_device.upload(lit(A, most))
        OxygenExposure(model).averaged(light)
        next(OxygenExposure(model).fine(light))
    assert seen == [1.6, 1.2]


def wrong_diffusion(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(turns, "Heat", lambda grid, variance, *rest: Heat(grid, 1.5 * variance, *rest))


def wrong_rate(patch: pytest.MonkeyPatch) -> None:
    step = OxygenModel._react
    patch.setattr(OxygenModel, "_react", lambda self, dose, share, *rest: step(self, dose, 0.97 * share, *rest))


@pytest.mark.parametrize("mutate", [None, wrong_diffusion, wrong_rate])
def test_a_wrong_solver_is_found(fast_device: Device, monkeypatch: pytest.MonkeyPatch, mutate: Any) -> None:
    """Its predicted dose differs from the proved one by more than a hundredth of the greatest."""
    if mutate is not None:
        mutate(monkeypatch)
    A = operator((18, 18, 1), (18, 1), fast_device)
    model, light = OxygenModel(A, Oxygen(1e-3, 2, 9.0, 0.2, runs=16)), lit(A, 1.6)
    light[:, :5] = light[:, 13:] = 0.0  # the faces of the grid stay dark
    part = np.hypot(*np.meshgrid(*A.grid.axes()[:2]))[:, :, None] < 0.3
    frames = vam.pack(model, light, bits=8, dither="round")
    proof = vam.simulate(model, frames, part.astype(float))
    assert proof.independent and proof.width is not None and proof.width < PITCH
    lines = {line.name: line for line in proof.lines()}
    gap = float(lines["dose by the solver"].value)
    assert gap == pytest.approx(proof.difference, rel=0.01)
    assert gap > 0.01 if mutate else gap <= 0.0055
