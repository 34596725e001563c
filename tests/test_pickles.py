"""Nouns that go to another process, or are copied: the same light and dose there, to the last bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.backend.opencl_platforms import context_of
from vamgpu.errors import DeviceError
from vamgpu.operators.linear import LinearOperator
from vamgpu.optics.outer_resin import outer_resin

GRID, BEAM, MOTION = vam.Grid((16, 16, 8), 0.25), vam.Beam((20, 8), 0.25), vam.Turntable(12)
UNEVEN = vam.Turntable([0.0, 1.0, 2.5], [1.0, 2.0, 3.0])
VIAL = vam.Vial(radius=4.0, wall=0.5, resin_index=1.5, wall_index=1.47, bath_index=1.33, absorption=0.05)


def pickled(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


both = pytest.mark.parametrize("copied", [pickled, copy.deepcopy])
Copied = Callable[[Any], Any]


class Dimmed(LinearOperator):
    """An operator of somebody else, which keeps what it was given in another shape."""

    def __init__(self, A: Any, shares: np.ndarray) -> None:
        self.A, self.domain, self.range, self.device = A, A.domain, A.range, A.device
        self.shares = shares[None, :, None]

    def forward(self, x: Any, out: Any) -> None:
        self.device.put(self.A(x).numpy() * self.shares, out)

    def transposed(self, y: Any, out: Any) -> None:
        self.A.T(self.device.field(y.numpy() * self.shares), out=out)


def turned(device: Device) -> vam.Projection:
    return vam.Projection(GRID, BEAM, MOTION, VIAL, device).of_poses([1, 4, 7])


OPERATORS: dict[str, Callable[[Device], LinearOperator]] = {
    "vial": lambda device: vam.Projection(GRID, BEAM, MOTION, VIAL, device),
    "measured": lambda device: vam.Projection(GRID, BEAM, UNEVEN, VIAL, device),
    "straight": lambda device: vam.Projection(GRID, BEAM, MOTION, None, device),
    "chosen angles": turned,
    "shorter arcs": lambda device: OPERATORS["vial"](device).turned(vam.Turntable(12, lit_share=0.1)),  # type: ignore[attr-defined]
    "rings": lambda device: vam.RingProjection(GRID, BEAM, MOTION, VIAL, device),
    "raised": lambda device: vam.RingProjection(GRID, BEAM, MOTION, VIAL, device).raised(0.1),
    "spectral": lambda device: vam.SpectralProjection(vam.PolarGrid(8, 8, 0.25, 12), BEAM, VIAL, device),
    "outer resin": lambda device: outer_resin(vam.Projection(GRID, BEAM, MOTION, VIAL, device))[0],
    "traced": lambda device: vam.TracedProjection(GRID, BEAM, MOTION, device=device),
    "tiles": lambda device: vam.Tiles(vam.Projection(GRID, BEAM, MOTION, VIAL, device), 5),
    "product": lambda device: turned(device).T @ turned(device),
    "another's": lambda device: Dimmed(vam.Projection(GRID, BEAM, MOTION, VIAL, device), np.linspace(0.5, 1.0, 20)),
}  # fmt: skip


@both
@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_makes_the_same_light_and_dose(device: Device, name: str, copied: Copied) -> None:
    A = OPERATORS[name](device)
    B, transpose = copied((A, A.T))
    assert B is not A and B.T is transpose and B.device is device
    x, y = (np.random.default_rng(0).random(space.shape) for space in (A.domain, A.range))
    assert np.array_equal(A(x), B(x)) and np.array_equal(A.T(y), transpose(y))


def test_a_copy_shares_tables_and_has_a_transpose_of_its_own(device: Device) -> None:
    A = OPERATORS["vial"](device)
    B = copy.copy(A) if A.T else A
    assert vars(B)["_light"] is vars(A)["_light"] and B.T is not A.T and B.T.T is B


@both
def test_an_array_keeps_its_values_and_its_device(device: Device, copied: Copied) -> None:
    field = device.field(np.random.default_rng(1).random((5, 4, 19)))
    for array in (field, device.upload(np.arange(6, dtype=np.uint8).reshape(2, 3), table=True)):
        other = copied(array)
        assert (other.device, other.dtype, other.lanes) == (device, array.dtype, array.lanes)
        assert np.array_equal(other.numpy(), array.numpy())
    other = copied(field)
    device.put(np.zeros(field.shape), field)
    assert other.numpy().min() > 0.0  # in memory of its own


def test_values_that_none_may_upload_come_through(device: Device) -> None:
    wild = device.restored(np.array([np.nan, np.inf, 1e-40], device.real), table=True)
    assert np.array_equal(pickled(wild).numpy(), wild.numpy(), equal_nan=True)


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """What a print is made of, and the objects of a run."""
    target = vam.Target.from_array(np.pad(np.ones((6, 6, 4)), ((5, 5), (5, 5), (2, 2))), 0.25, "block")
    A = vam.Projection(GRID, BEAM, MOTION, VIAL)
    plan = vam.optimize(A, target, "lbfgs", 3)
    frames = vam.pack(plan, bits=1)
    proof = vam.simulate(A, frames, target)
    scene = vam.Scene([vam.Body(target.numpy(), pitch=0.25)])
    return {"plan": plan, "frames": frames, "proof": proof, "scene": scene, "target": target}


@both
def test_a_run_goes_on_from_copies(made: dict[str, Any], copied: Copied) -> None:
    twin = SimpleNamespace(**copied(made))
    plan, frames, proof = made["plan"], made["frames"], made["proof"]
    assert np.array_equal(twin.plan.sinogram.numpy(), plan.sinogram.numpy()) and twin.plan.history == plan.history
    assert np.array_equal(twin.plan.dose().numpy(), plan.dose().numpy())
    assert twin.frames.plan.window == frames.plan.window and np.array_equal(
        twin.frames.images.numpy(), frames.images.numpy()
    )
    assert twin.proof.scores == proof.scores and np.array_equal(twin.proof.dose.numpy(), proof.dose.numpy())
    one, other = (vam.optimize(p.operator, p.target, "lbfgs", 5, resume=p).sinogram for p in (plan, twin.plan))
    assert np.array_equal(one.numpy(), other.numpy())
    one, other = (scene.target(pitch=0.25, device="numpy") for scene in (made["scene"], twin.scene))
    assert np.array_equal(one.numpy(), other.numpy())


def test_a_target_leaves_its_copies_behind(opencl_device: Device) -> None:
    target = vam.Target.from_array(np.ones((16, 16, 8)), 0.25)
    alone = len(pickle.dumps(target))
    target.on(opencl_device)
    assert len(pickle.dumps(target)) == alone
    assert np.array_equal(pickled(target).on(opencl_device).numpy(), target.numpy())


@pytest.mark.parametrize(
    "noun", [GRID, BEAM, MOTION, VIAL, vam.Turntable.arc(8, 3.0)], ids=lambda noun: type(noun).__name__
)
@both
def test_a_noun_is_equal_to_its_copy(noun: Any, copied: Copied) -> None:
    assert copied(noun) == noun


def test_a_device_is_opened_by_its_name(device: Device, opencl_processor: str) -> None:
    limited = vam.open_device(f"{opencl_processor}@1GB")
    assert pickled(device) is copy.deepcopy(device) is device and pickled(limited) is limited


def test_a_device_without_a_name_of_its_own_says_so(opencl_name: str) -> None:
    own = OpenclDevice(opencl_name, context_of(opencl_name))
    assert copy.deepcopy(own) is own
    for value in (own, own.upload(np.ones((2, 2, 2)))):
        with pytest.raises(DeviceError, match=r"to pickle.*expected a device of vamgpu\.open_device"):
            pickle.dumps(value)


def _dose(A: vam.Projection, light: Any) -> Any:
    return A.T(light)


def test_another_process_computes_the_same(opencl_name: str) -> None:
    light = np.random.default_rng(2).random((12, 20, 8), dtype=np.float32)
    jobs = [
        (A := vam.Projection(GRID, BEAM, MOTION, VIAL, name), A.device.field(light)) for name in ("numpy", opencl_name)
    ]
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:  # a child that dies is an error, not a wait
        there = list(pool.map(_dose, *zip(*jobs, strict=True)))
    for (A, y), dose in zip(jobs, there, strict=True):
        assert dose.device is A.device and np.array_equal(dose.numpy(), A.T(y).numpy())
    joblib = pytest.importorskip("joblib")
    for (A, y), dose in zip(jobs, joblib.Parallel(n_jobs=2)(joblib.delayed(_dose)(*job) for job in jobs), strict=True):
        assert np.array_equal(dose.numpy(), A.T(y).numpy())
