"""Gray bodies by prices, against the optimum that linear programming finds with both limits of a gray dose."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.methods import bound

SIZE, PITCH = 20, 0.2


def operator(device: Device | str = "numpy") -> vam.Projection:
    return vam.Projection(vam.Grid((SIZE, SIZE, 1), PITCH), vam.Beam((30, 1), PITCH), vam.Turntable(30), device=device)


def rod(radius: float, x: float) -> Any:
    return lambda a, b, c: np.hypot(a - x, b) - radius + 0.0 * c


SQUARE = vam.Body(lambda x, y, z: np.maximum(np.abs(x), np.abs(y)) - 1.1 + 0 * z)
SCENES = {
    "tight": [vam.Body(rod(0.7, -0.8)), vam.Body(rod(0.6, 0.8), "gray", dose=0.85, tolerance=0.05)],
    "loose": [vam.Body(rod(0.7, -0.8)), vam.Body(rod(0.6, 0.8), "gray", dose=0.85, tolerance=0.6)],
    "inside": [SQUARE, vam.Body(rod(0.55, 0.3), "gray", dose=0.85, tolerance=0.1)],
    "two": [
        vam.Body(rod(0.6, -1.0)),
        vam.Body(rod(0.4, 0.2), "gray", dose=0.9, tolerance=0.07),
        vam.Body(rod(0.4, 1.2), "gray", dose=0.85, tolerance=0.15),
    ],
}


@cache
def target(name: str) -> vam.Target:
    return vam.Scene(SCENES[name]).target(pitch=PITCH, shape=(SIZE, SIZE, 1), device="numpy")


@cache
def entries() -> Any:
    """Dose of every voxel by light of every pixel, read off the operator voxel by voxel."""
    A, unit, rows = operator(), np.zeros((SIZE, SIZE, 1), np.float32), []
    for voxel in range(SIZE**2):
        unit[:] = 0.0
        unit.flat[voxel] = 1.0
        rows.append(sparse.csr_matrix(np.asarray(A(unit), np.float64).reshape(1, -1)))
    return sparse.vstack(rows).tocsr()


def asked(name: str) -> tuple[Any, np.ndarray, np.ndarray, dict[float, np.ndarray]]:
    """Doses over limits by light; which voxels are of the part, void, and gray, by tolerance."""
    given = target(name)
    limits, part = given.limits, (given.numpy() >= 0.5).ravel()
    assert limits is not None
    near = np.broadcast_to(operator().grid.cylinder()[:, :, None], limits.dose.shape).ravel()
    scaled = sparse.diags(1.0 / limits.dose.ravel()) @ entries()
    gray = {body.tolerance: (limits.body.ravel() == k) & part & near for k, body in enumerate(limits.bodies) if k}
    return scaled / scaled.max(), part & near, ~part & near, gray


def rows_of(doses: Any, a: float | np.ndarray, b: float | np.ndarray) -> Any:
    """doses·light + a·least + b·leak."""
    return sparse.hstack([doses, np.full((doses.shape[0], 1), a), np.full((doses.shape[0], 1), b)])


@cache
def optimum(name: str) -> float:
    """Greatest a − b of all light: doses of the part in [a, 1], voids ≤ b, gray ones both limits too."""
    doses, part, void, gray = asked(name)
    limits = [rows_of(-doses[part], 1, 0), rows_of(doses[void], 0, -1), rows_of(doses[part], 0, 0)]
    values = [np.zeros(part.sum() + void.sum()), np.ones(part.sum())]
    for t, where in gray.items():
        limits += [rows_of(-doses[where], 0.5 * (2 - t), -0.5), rows_of(doses[where], -0.5 * t, -0.5)]
        values += [np.full(where.sum(), -0.5 * (1 - t)), np.full(where.sum(), 0.5 * (1 + t))]
    cost = np.zeros(doses.shape[1] + 2)
    cost[-2:] = -1.0, 1.0
    found = linprog(cost, sparse.vstack(limits), np.concatenate(values), method="highs").fun
    assert found is not None
    return -found


def reached(name: str, light: np.ndarray) -> float:
    """Greatest a − b of this light."""
    doses, part, void, gray = asked(name)
    dose = doses @ light.ravel().astype(np.float64)
    dose = dose / dose[part | void].max()
    limits, values = [[1.0, 0.0], [0.0, -1.0]], [dose[part].min(), -dose[void].max()]
    for t, where in gray.items():
        limits += [[0.5 * (2 - t), -0.5], [-0.5 * t, -0.5]]
        values += [dose[where].min() - 0.5 * (1 - t), 0.5 * (1 + t) - dose[where].max()]
    found = linprog([-1.0, 1.0], limits, values, method="highs").fun
    return -1.0 if found is None else -found


@pytest.mark.parametrize("name", SCENES)
def test_gray_bodies_come_near_the_optimum_and_the_bound_is_above_it(fast_device: Device, name: str) -> None:
    A, top = operator(fast_device), optimum(name)
    plan = vam.optimize(A, target(name), "widest", evaluations=400)
    found = reached(name, plan.sinogram.numpy())
    assert plan.window == pytest.approx(found, abs=2e-5)
    assert 0.95 * top < found <= top + 2e-5, found / top
    assert top - 1e-5 <= bound(A, target(name), evaluations=1000).value <= 1.04 * top


def test_a_gray_body_costs_window_and_thresholds_reach_less() -> None:
    plan = vam.optimize(operator(), target("tight"), "window", evaluations=400)
    assert optimum("tight") < optimum("loose") - 0.02
    assert reached("tight", plan.sinogram.numpy()) < 0.9 * optimum("tight")


def test_every_device_takes_the_same_way(device: Device) -> None:
    windows = [
        [step.window for step in vam.optimize(operator(where), target("two"), "widest", 12).history]
        for where in (device, "numpy")
    ]
    assert windows[0] == pytest.approx(windows[1], abs=2e-4)
