"""Operators, the proof's dose and kinetics are differentiable in PyTorch and JAX."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from needs import missing, optional

import vamgpu as vam
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.interop import ProofDose, function_of
from vamgpu.methods.joint import KineticModel, LinearModel, TwoColorResin

TORCH = "install PyTorch: pip install vamgpu[torch]; not asked for everywhere since with CUDA it is gigabytes"
RESIN = TwoColorResin(0.3, 0.2, 2.0, 5.0, floor=0.2)


def projection(device: Device | str, **options: Any) -> vam.Projection:
    return vam.Projection(vam.Grid((4, 4, 2), 0.1), vam.Beam((6, 2), 0.1), vam.Turntable(5), device=device, **options)


def vessel() -> vam.Vial:
    return vam.Vial(radius=0.6, wall=0.1, resin_index=1.5, wall_index=1.47, absorption=0.4)


@cache
def functions(device: Device | str) -> dict[str, Any]:
    A = projection(device)
    return {
        "A": A,
        "A.T": A.T,
        "proof": ProofDose(projection(device, vessel=vessel())),
        "kinetics": KineticModel(A, A, RESIN, 2, runs=3),
        "linear": LinearModel(A, A, RESIN),
    }


NAMES = ("A", "A.T", "proof", "kinetics", "linear")


def inputs_of(what: Any, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [0.3 + rng.random(space.shape) for space in function_of(what).spaces]


# ---- what is shared ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("vial", [False, True])
def test_the_proofs_dose_is_what_proofs_judge_and_has_an_exact_transpose(device: Device, vial: bool) -> None:
    A = projection(device, vessel=vessel() if vial else None)
    P = ProofDose(A)
    light = np.random.default_rng(0).random(P.domain.shape)
    wanted, _ = P._exposure.averaged(device.upload(light))
    assert np.array_equal(P(light), wanted.numpy())
    assert P.dot_test() < (1e-12 if device.name == "numpy" else 1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_slopes_are_those_of_finite_differences(device: Device, name: str) -> None:
    function = function_of(functions(device)[name])
    given = inputs_of(functions(device)[name])
    steps = inputs_of(functions(device)[name], 1)
    weights = np.random.default_rng(2).standard_normal(function.space.shape)

    def number(share: float) -> float:
        moved = [device.upload(x + share * dx) for x, dx in zip(given, steps, strict=True)]
        return float((function.value(*moved).numpy() * weights).sum())

    slope = device.upload(weights)
    function.value(*(device.upload(0.2 * x) for x in given))  # the slopes asked for are elsewhere
    found = function.slopes([device.upload(x) for x in given], slope)
    assert np.array_equal(slope.numpy(), weights.astype(device.real))
    directional = sum(float((g.numpy() * dx).sum()) for g, dx in zip(found, steps, strict=True))
    size = 1e-5 if device.name == "numpy" else 0.02
    wanted = (number(size) - number(-size)) / (2.0 * size)
    assert directional == pytest.approx(wanted, rel=1e-6 if device.name == "numpy" else 5e-3)


def test_what_is_not_differentiable_is_refused() -> None:
    with pytest.raises(BadInput, match="Differentiable"):
        function_of(np.ones(3))
    with pytest.raises(BadInput, match="Projection"):
        ProofDose(projection("numpy").T)  # pyright: ignore[reportArgumentType]


# ---- PyTorch ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", NAMES)
def test_torch_checks_the_gradients_of_the_reference(name: str) -> None:
    torch = optional("torch", TORCH)
    from vamgpu.interop.torch import differentiable

    what = functions("numpy")[name]
    apply = differentiable(what)
    given = [torch.tensor(x, requires_grad=True) for x in inputs_of(what)]
    assert torch.autograd.gradcheck(apply, given, fast_mode=name == "proof")
    if name in ("A", "A.T"):
        assert torch.autograd.gradgradcheck(lambda x: apply(x) ** 2, given, fast_mode=True)


def test_torch_tensors_keep_their_type_and_gradients_reach_them(device: Device) -> None:
    torch = optional("torch", TORCH)
    from vamgpu.interop.torch import differentiable

    A = functions(device)["A"]
    x = torch.tensor(inputs_of(A)[0], dtype=torch.float32, requires_grad=True)
    y = differentiable(A)(x)
    assert y.dtype == torch.float32 and np.allclose(y.detach().numpy(), A(x.detach().numpy()), rtol=1e-5)
    (y**2).sum().backward()
    assert np.allclose(x.grad.numpy(), 2.0 * A.T(y.detach().numpy()), rtol=1e-4)
    with pytest.raises(ShapeMismatch):
        differentiable(A)(x[1:])
    with pytest.raises(BadInput, match="expected 1"):
        differentiable(A)(x, x)
    assert isinstance(A(x.detach()), DeviceArray)


def test_a_loss_written_in_torch_is_lowered(device: Device) -> None:
    torch = optional("torch", TORCH)
    from vamgpu.interop.torch import TensorLoss

    A = vam.Projection(vam.Grid((10, 10, 2), 0.1), vam.Beam((14, 2), 0.1), vam.Turntable(8), device=device)
    target = np.zeros(A.domain.shape)
    target[2:8, 2:8] = 1.0
    target[4:6, 4:8] = 0.0
    loss = TensorLoss(lambda dose, wanted: torch.nn.functional.huber_loss(dose, wanted, reduction="sum"))
    losses = [step.loss for step in vam.optimize(A, target, loss, 12).history]
    assert losses == sorted(losses, reverse=True) and losses[-1] < 0.7 * losses[0]


# ---- JAX --------------------------------------------------------------------------------------------------------
@cache
def jaxes() -> tuple[Any, Callable[[Any], Any]]:
    """JAX in float64, and what makes functions for it."""
    try:
        import jax
    except ImportError:
        missing("install JAX: pip install vamgpu[jax]")
    from vamgpu.interop.jax import differentiable

    jax.config.update("jax_enable_x64", True)
    return jax, differentiable


@pytest.mark.parametrize("name", NAMES)
def test_jax_checks_the_gradients_of_the_reference(name: str) -> None:
    jax, differentiable = jaxes()
    from jax.test_util import check_grads

    what = functions("numpy")[name]
    apply, given = differentiable(what), inputs_of(what)
    check_grads(apply, given, 2 if name in ("A", "A.T") else 1, modes=["rev"], rtol=1e-5)
    found = jax.jit(apply)(*given)
    assert np.allclose(found, function_of(what).value(*map(function_of(what).device.upload, given)).numpy())


def test_jax_arrays_go_through_devices(device: Device) -> None:
    jax, differentiable = jaxes()
    A = functions(device)["A"]
    x = inputs_of(A)[0].astype(np.float32)
    slope = jax.jit(jax.grad(lambda x: (differentiable(A)(x) ** 2).sum()))(x)
    assert slope.dtype == np.float32 and np.allclose(slope, 2.0 * A.T(A(x)), rtol=1e-4)
    both = jax.vmap(differentiable(A))(np.stack([x, 2.0 * x]))
    assert np.allclose(both[1], 2.0 * both[0], rtol=1e-5)
    with pytest.raises(ShapeMismatch):
        differentiable(A)(x[1:])
