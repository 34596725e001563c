"""Operators are matrices to NumPy, SciPy and PyLops, and anybody's operator and light are enough for a run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse.linalg as sl
from needs import missing

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, NoLight, ShapeMismatch


def projection(device: Device | str, shape: tuple[int, int, int] = (8, 8, 3)) -> vam.Projection:
    beam = vam.Beam((shape[0] + 4, shape[2]), 0.1)
    return vam.Projection(vam.Grid(shape, 0.1), beam, vam.Turntable(10), device=device)


def close(found: Any, wanted: Any) -> bool:
    found, wanted = np.asarray(found, float), np.asarray(wanted, float)
    return found.shape == wanted.shape and bool(np.abs(found - wanted).max() <= 1e-5 * np.abs(wanted).max())


def test_the_algebra_of_operators(device: Device) -> None:
    A = projection(device)
    x, y = (np.random.default_rng(0).random(shape) for shape in (A.domain.shape, A.range.shape))
    matrix = A.dense()
    assert A.shape == matrix.shape and A.T.shape == matrix.T.shape
    assert close(A @ x, A(x)) and close(A.T @ y, A.T(y))
    assert close(A @ x.ravel(), matrix @ x.ravel()) and close(A.rmatvec(y.reshape(-1, 1)), matrix.T @ y.reshape(-1, 1))
    combined: Any = np.float64(2) * A - A / 2 + A * 3 + -A
    assert close(combined @ x, 3.5 * A(x)) and close(combined.T @ y, 3.5 * A.T(y))
    assert combined.grid is A.grid
    assert close((A.T @ A) @ x, A.T(A(x)))
    value, pulled = A.vjp(x)
    assert close(value, A(x)) and close(pulled(y), A.T(y))
    with pytest.raises(ShapeMismatch):
        _ = A @ A
    with pytest.raises(TypeError):
        _ = A + 1  # pyright: ignore[reportOperatorIssue]


def test_scipy_and_pylops_take_an_operator() -> None:
    A = projection("numpy")
    truth = np.random.default_rng(0).random(A.shape[1])
    theirs = sl.aslinearoperator(A)
    assert close(theirs.rmatvec(A @ truth), A.rmatvec(A @ truth))
    found = sl.lsqr(theirs, A @ truth, iter_lim=200)[0]
    assert np.abs(A @ found - A @ truth).max() < 1e-3 * (A @ truth).max()
    try:
        import pylops
    except ImportError:
        missing("PyLops is missing: pip install pylops")
    wrapped = pylops.aslinearoperator(theirs)
    assert close((wrapped.H @ wrapped) @ truth, A.rmatvec(A @ truth))


class Foreign:
    """An operator that is no heir of ours."""

    def __init__(self, A: vam.Projection, forth: Any = None, back: Any = None) -> None:
        self.device, self.grid, self.beam, self.motion = A.device, A.grid, A.beam, A.motion
        back = back or A.T
        self.domain, self.range, self.forth = back.range, back.domain, forth or A
        self.T = self.forth.T if forth is None else back

    def __call__(self, x: Any, out: Any = None) -> Any:
        return self.forth(x, out=out)


def part(shape: tuple[int, int, int] = (8, 8, 3)) -> np.ndarray:
    x, y = (np.arange(n) - 0.5 * (n - 1) for n in shape[:2])
    return np.where(np.hypot(x[:, None], y) < 0.3 * shape[0], 1.0, 0.0)[:, :, None] * np.ones(shape)


def test_any_object_with_the_protocol_is_optimized_and_judged() -> None:
    A, target = projection("numpy"), part()
    ramp = vam.optimize(Foreign(A), target, iterations=3)
    assert ramp.history and ramp.window > -1.0
    for method in ("osmo", "bclp", "lbfgs"):
        found, wanted = (vam.optimize(one, target, method, 3) for one in (Foreign(A), A))
        assert np.array_equal(found.sinogram.numpy(), wanted.sinogram.numpy()), method
    proof = vam.simulate(Foreign(A), vam.pack(found), target)  # pyright: ignore[reportArgumentType]
    assert not proof.independent and proof.scores.window == proof.claimed.window
    with pytest.raises(BadInput, match="motion"):
        half: Any = SimpleNamespace(grid=A.grid, beam=A.beam)
        vam.optimize(half, target)


@pytest.mark.parametrize("method", ["bclp", "penalty", "cal", "lbfgs", "ramp"])
def test_a_run_begins_with_the_light_it_is_given(method: str, device: Device) -> None:
    A, target = projection(device), part()
    first = vam.optimize(A, target, method, 12)
    begun = vam.optimize(A, target, method, 2, start=first)
    fresh = vam.optimize(A, target, method, 2)
    assert np.abs(begun.sinogram.numpy() - fresh.sinogram.numpy()).max() > 1e-3
    assert begun.history[0].loss < fresh.history[0].loss
    bright = vam.optimize(A, target, method, 2, start=50.0 * first.sinogram.numpy())  # brought to the part's dose
    assert bright.window == pytest.approx(begun.window, abs=0.1)


def test_light_that_cannot_begin_is_refused() -> None:
    A, target = projection("numpy"), part()
    light = np.ones(A.range.shape)
    plan = vam.optimize(A, target, "bclp", 2, start=light)
    for given, error in ((-light, BadInput), (0 * light, NoLight), (light[1:], ShapeMismatch)):
        with pytest.raises(error, match="initial light"):
            vam.optimize(A, target, "bclp", 2, start=given)
    with pytest.raises(BadInput, match="begins with the target"):
        vam.optimize(A, target, "osmo", 2, start=light)
    with pytest.raises(BadInput, match="resume"):
        vam.optimize(A, target, "bclp", 4, start=light, resume=plan)
    assert np.array_equal(light, np.ones(A.range.shape))
    straight, again = vam.optimize(A, target, "bclp", 5, start=light), vam.optimize(A, target, "bclp", 5, resume=plan)
    assert np.array_equal(straight.sinogram.numpy(), again.sinogram.numpy())
