"""Losses as objects: their values and slopes on every device, what they compose to, and runs that lower one's own."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, Cancelled
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.losses import Band, Logistic, Loss, VoxelLoss
from vamgpu.methods import Descent, Plan, optimize
from vamgpu.operators.compose import combine
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot

PAGE = Path(__file__).resolve().parents[2] / "docs" / "losses.md"
SHAPE, REACH = (20, 20, 6), 9.0


def leak(dose: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, dose - 0.7) ** 2


def lack(dose: np.ndarray) -> np.ndarray:
    return np.exp(-3.0 * dose)


OWN = VoxelLoss(leak, lack)


def fields() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Dose, target, weight, and which voxels count."""
    rng = np.random.default_rng(4)
    place = np.arange(SHAPE[0]) - 0.5 * (SHAPE[0] - 1)
    near = np.hypot(place[:, None], place)[:, :, None] <= REACH
    return 1.5 * rng.random(SHAPE), rng.random(SHAPE), rng.random(SHAPE) + 0.2, np.broadcast_to(near, SHAPE)


def found(loss: Loss, device: Device, *, apart: bool = False) -> tuple[float, np.ndarray]:
    dose, target, _, _ = fields()
    field = device.upload(dose)
    out = device.empty(SHAPE) if apart else field
    value = loss.on(device.upload).value_and_gradient(field, device.upload(target), out, REACH)
    if apart:
        assert np.array_equal(field.numpy(), device.upload(dose).numpy())
    return value, out.numpy()


# ---- values and slopes ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("binary", [False, True])
def test_a_loss_written_in_numpy_is_what_the_device_computes(device: Device, binary: bool) -> None:
    """Weighted, of a response, voxel by voxel; the slope to what lines between samples leave."""
    dose, target, weight, near = fields()
    f = np.where(target >= 0.5, 1.0, 0.0) if binary else target

    def printed(at: np.ndarray) -> np.ndarray:
        felt = 1.0 / (1.0 + np.exp(-6.0 * (at - 0.6)))
        return weight * near * ((1.0 - f) * leak(felt) + f * lack(felt))

    value, slope = found(VoxelLoss(leak, lack, Logistic(6.0, 0.6), binary, weight), device)
    assert value == pytest.approx(printed(dose).sum(), rel=1e-5)
    wanted = (printed(dose + 1e-6) - printed(dose - 1e-6)) / 2e-6
    assert np.abs(slope - wanted).max() <= 0.02 * np.abs(wanted).max()
    assert not slope[~near].any()


@pytest.mark.parametrize("apart", [False, True])
def test_losses_add_and_take_factors_and_powers(device: Device, apart: bool) -> None:
    band = Band.thresholds(0.5, 0.9)
    (first, one), (second, two) = found(band, device), found(OWN, device)
    value, slope = found((band + 0.25 * OWN + band) ** 0.5, device, apart=apart)
    total = 2.0 * first + 0.25 * second
    assert value == pytest.approx(total**0.5, rel=1e-5)
    wanted = (2.0 * one + 0.25 * two) * 0.5 * total**-0.5
    assert np.abs(slope - wanted).max() <= 1e-5 * np.abs(wanted).max()


def test_two_thresholds_by_samples_are_those_in_closed_form(device: Device) -> None:
    sampled = VoxelLoss(
        lambda dose: 0.5 * np.maximum(0.0, dose - 0.5) ** 2,
        lambda dose: 0.5 * (np.maximum(0.0, 0.9 - dose) + np.maximum(0.0, dose - 1.0)) ** 2,
        binary=True,
    )
    (value, slope), (wanted, slopes) = found(sampled, device), found(Band.thresholds(0.5, 0.9), device)
    assert value == pytest.approx(wanted, rel=1e-4)
    assert np.abs(slope - slopes).max() <= 3e-3  # as far as samples are apart
    assert sampled.curvature() == pytest.approx(Band.thresholds(0.5, 0.9).curvature(), rel=0.05)


def test_curvatures_are_second_derivatives() -> None:
    assert Band.thresholds(0.5, 0.9).curvature() == pytest.approx(1.0, rel=0.05)
    assert OWN.curvature() == pytest.approx(9.0, rel=0.1)
    assert (OWN + 0.5 * OWN).curvature() == pytest.approx(1.5 * OWN.curvature(), rel=1e-12)


# ---- runs -------------------------------------------------------------------------------------------------------
def part() -> np.ndarray:
    x, y, _ = np.meshgrid(*[np.arange(n) - 0.5 * (n - 1) for n in SHAPE], indexing="ij")
    radius = np.hypot(x, y)
    return np.where(((radius < 7) & (radius > 3) & ~((x > 0) & (abs(y) < 2))) | (radius < 1), 1.0, 0.0)


@cache
def operator(device: str | Device) -> Projection:
    return Projection(Grid(SHAPE, 0.2), Beam(SHAPE[1:], 0.2, spread=0.0), Turntable(24), device=device)


@cache
def readme() -> Plan:
    """What the lines of the readme make on the reference."""
    return shown(operator("numpy"), part())


def shown(A: Projection, target: Any) -> Plan:
    code = next(c for c in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S) if "VoxelLoss(" in c)
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    names: dict[str, Any] = {"vam": vam, "A": A, "target": target}
    exec(code, names)  # noqa: S102 - our own page
    return names["plan"]


def test_the_ten_lines_of_the_page_run_on_the_device(fast_device: Device) -> None:
    A = operator(fast_device)
    target = A.device.upload(part())
    with A.device.no_transfers():
        plan = shown(A, target)
    losses = [step.loss for step in plan.history]
    assert losses[-1] < 0.3 * losses[0] and losses == sorted(losses, reverse=True)
    assert plan.window > 0.0
    assert losses[:10] == pytest.approx([step.loss for step in readme().history[:10]], rel=1e-3)


@pytest.mark.parametrize("method", [Descent(OWN, momentum=0.5), Descent(OWN, history=4)], ids=["steps", "directions"])
def test_a_run_goes_on_bit_by_bit_and_stops_when_asked(method: Descent) -> None:
    A, seen = operator("numpy"), []
    whole = optimize(A, part(), method, 8)
    with pytest.raises(Cancelled) as caught:
        optimize(A, part(), method, 8, progress=seen.append, cancel=lambda: len(seen) == 3)
    plan = caught.value.plan
    assert isinstance(plan, Plan) and len(plan.history) == 3
    again = replace(method, loss=VoxelLoss(lambda dose: leak(dose), lambda dose: lack(dose)))  # as in another process
    resumed = optimize(A, part(), again, 8, resume=plan)
    assert resumed.history == whole.history
    assert np.array_equal(resumed.sinogram.numpy(), whole.sinogram.numpy())


def test_quasi_newton_directions_go_lower() -> None:
    loss = Band.thresholds(0.75, 0.95)
    plain, quick = (optimize(operator("numpy"), part(), Descent(loss, history=k), evaluations=30) for k in (0, 5))
    assert quick.history[-1].loss < plain.history[-1].loss and quick.evaluations <= 30


@dataclass(frozen=True)
class Even(Loss):
    """Square of what the mean dose of the part misses: of all voxels together, by operations on the device."""

    wanted: float = 1.0

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = 1e18
    ) -> float:
        count = dot(target, target)
        missing = dot(dose, target) / count - self.wanted
        combine(2.0 * missing / count, target, 0.0, target, out)
        return missing**2


def test_a_loss_of_all_voxels_together_is_lowered_too(device: Device) -> None:
    plan = optimize(operator(device), part(), Even(0.5) + 1e-9 * OWN, 25)
    inside = part() >= 0.5
    assert plan.dose().numpy()[inside].mean() == pytest.approx(0.5, abs=0.02)
    assert Even().coupling and not OWN.coupling and not (OWN + Band.thresholds(0.5, 0.9)).coupling
    assert "voxels" in (OWN**2.0).coupling and "Even" in (OWN + Even()).coupling


class OwnTrouble(Exception):
    """Raised by losses of one's own."""


@dataclass(frozen=True)
class Failing(Even):
    """Raises what it is told, at the third look."""

    error: Exception = field(default_factory=OwnTrouble)
    looks: list[DeviceArray] = field(default_factory=list)

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = 1e18
    ) -> float:
        self.looks.append(dose)
        if len(self.looks) == 3:
            raise self.error
        return super().value_and_gradient(dose, target, out, reach)


@pytest.mark.parametrize("kind", [OwnTrouble, ValueError, KeyError, MemoryError])
@pytest.mark.parametrize("tolerances", [None, vam.Tolerances(axis=0.05)])
def test_a_loss_that_raises_shows_its_own_error(kind: type[Exception], tolerances: Any) -> None:
    """The very error, from a look in the middle of a run as from the samples of a function."""
    A, error = operator("numpy"), kind("my own trouble")
    with pytest.raises(kind, match="my own trouble") as caught:
        optimize(A, part(), Failing(0.5, error) + OWN, iterations=9, tolerances=tolerances, progress=False)
    assert caught.value is error

    def troubled(dose: np.ndarray) -> np.ndarray:
        raise error

    with pytest.raises(kind) as caught:
        optimize(A, part(), VoxelLoss(troubled, lack), iterations=2, progress=False)
    assert caught.value is error


def test_what_is_no_loss_is_refused() -> None:
    with pytest.raises(BadInput, match="part of a VoxelLoss gave"):
        VoxelLoss(leak, lambda dose: 1.0 / (dose - dose))
    with pytest.raises(BadInput, match=r"void of a VoxelLoss gave \(\) values"):
        VoxelLoss(lambda dose: dose.sum(), lack)
    for factor in (-1.0, np.nan, np.inf):
        with pytest.raises(BadInput, match="a factor ≥ 0"):
            _ = factor * OWN
    with pytest.raises(BadInput, match="expected a Loss"):
        Descent(leak)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="history is -1"):
        Descent(OWN, history=-1)
    with pytest.raises(BadInput, match="has no curvature"):
        Even().curvature()
