"""Losses written in NumPy as functions of a voxel's dose: sampled once, looked up on the device."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.kernels.loss import look_up, sampled_loss
from vamgpu.kernels.signature import Kernel
from vamgpu.losses.loss import KernelLoss, steepest
from vamgpu.losses.response import REACH, SAMPLES, Curve, Linear, Response

Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class VoxelLoss(KernelLoss):
    """Σ w·((1 − f)·void(M) + f·part(M)) with M = response(dose) and the target's fraction f.

    ``void`` and ``part`` are functions of NumPy arrays. Both are sampled at 1024 doses from 0 to 3 times the part's,
    continue straight beyond, and run on every device: you need not write a kernel.

    Args:
        void: Loss of a voxel out of the part.
        part: Loss of a voxel in the part.
        response: M(d), the response to a dose.
        binary: A voxel belongs to the part if at least half of it is filled; no voxel counts partly.
        weight: Weight w of each voxel [x, y, z], NumPy or on the device; None for 1.

    Raises:
        BadInput: A function does not return a finite number for every dose.
    """

    void: Function = field(compare=False)
    part: Function = field(compare=False)
    response: Response = Linear()
    binary: bool = False
    weight: Any = field(default=None, compare=False, repr=False)
    digest: str = field(init=False, repr=False)
    """Samples by which losses are compared; they identify equal losses also in another run of a script."""

    def __post_init__(self) -> None:
        for name in ("void", "part"):
            if not callable(getattr(self, name)):
                raise BadInput(f"{name} of a VoxelLoss is {getattr(self, name)!r}; expected a function of doses")
        for name, curve in zip(("void", "part"), self.curves, strict=True):
            if curve.values.shape != (SAMPLES,) or not np.isfinite(curve.values).all():
                raise BadInput(
                    f"{name} of a VoxelLoss gave {curve.values.shape} values for {SAMPLES} doses from 0 to {REACH:g}, "
                    "or some that are not finite; expected a number for each dose"
                )
        samples = np.concatenate([curve.values for curve in self.curves])
        object.__setattr__(self, "digest", hashlib.sha256(samples.data).hexdigest())

    @cached_property
    def curves(self) -> tuple[Curve, Curve]:
        """Samples of both losses by dose."""
        doses = np.linspace(0.0, REACH, SAMPLES)
        felt = self.response.curve()
        value, _ = look_up(doses, np.asarray(felt.values), felt.start, felt.density)
        outer, inner = (
            Curve(np.asarray(loss(value), float), 0.0, (SAMPLES - 1) / REACH) for loss in (self.void, self.part)
        )
        return outer, inner

    def launched(self, device: Device) -> tuple[Kernel, dict[str, Any]]:
        outer, inner = self.curves
        return sampled_loss, {
            "outer": device.table(outer.values), "inner": device.table(inner.values), "start": outer.start,
            "density": outer.density, "binary": int(self.binary),
        }  # fmt: skip

    def curvature(self) -> float:
        return max(steepest(lambda dose, c=c: look_up(dose, c.values, c.start, c.density)[0]) for c in self.curves)


def cross_entropy(response: Response) -> VoxelLoss:
    """Σ (1 − f)·P(d) + f·(P(d) − d − c), P = ∫₀ M, c = min(P(d) − d). Its derivative is M(d) − f.

    For a logistic M of steepness s and a target of 0 and 1 this is the cross entropy of M(d) and f divided by s, minus
    that of darkness outside the part. It is convex where M rises, and never negative. For M(d) = d it is half the
    square error. P is interpolated between its samples, so M has steps; they are 0.4 % for a logistic of steepness 10.

    Args:
        response: M; beyond the sampled doses it keeps its last value.

    Returns:
        The loss.
    """
    doses, curve = np.linspace(0.0, REACH, SAMPLES), response.curve()
    values, _ = look_up(doses, np.asarray(curve.values), curve.start, curve.density)
    primitive = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * doses[1])])
    least = (primitive - doses).min()
    return VoxelLoss(
        lambda dose: np.interp(dose, doses, primitive), lambda dose: np.interp(dose, doses, primitive) - dose - least
    )
