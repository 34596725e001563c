"""The doses of one light in several scenarios, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.kernels.resample import resample
from vamgpu.kernels.stack import put_slices
from vamgpu.operators.compose import Derived, combine, inherit, same_device
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.reductions import extent
from vamgpu.operators.space import VolumeSpace


@final
class Scenarios(Derived):
    """Doses of the same light in every scenario: volumes are stacked, [x, y, scenario · z]."""

    # Dose s is Σ_t mix[s, t] times the dose of operator t; the first is nominal. An operator is not evaluated if the
    # volumes of all its scenarios are zero. Raises `BadInput`, `ShapeMismatch`, `DeviceError`.

    def __init__(self, operators: Sequence[LinearOperator], mix: np.ndarray | None = None) -> None:
        if not operators or not isinstance(getattr(operators[0], "grid", None), Grid):
            raise BadInput(f"scenarios got {operators!r}; expected projectors of a volume that turns, at least one")
        nominal: Any = operators[0]
        for each in operators[1:]:
            same_device(nominal, each)
            if each.domain.shape != nominal.domain.shape or each.range.shape != nominal.range.shape:
                raise ShapeMismatch(f"{each!r} maps {each.domain.shape} to {each.range.shape}, but {nominal!r} maps "
                                    f"{nominal.domain.shape} to {nominal.range.shape}; make them equal")  # fmt: skip
        self.operators: tuple[LinearOperator, ...] = tuple(operators)
        self.mix: np.ndarray = np.eye(len(operators)) if mix is None else np.array(mix, np.float64)
        if self.mix.ndim != 2 or self.mix.shape[1] != len(operators) or not np.isfinite(self.mix).all():
            raise BadInput(f"shares have shape {self.mix.shape}; expected finite ones (scenarios, {len(operators)})")
        inherit(self, nominal)
        self.each: Grid = nominal.grid
        wide, deep, high = self.each.shape
        self.grid: Grid = replace(self.each, shape=(wide, deep, high * len(self.mix)))
        self._set_spaces(VolumeSpace(self.grid), nominal.range, nominal.device)
        self.projections: float = 0.0
        """Number of projections and doses computed so far, half an evaluation each."""
        self._ones = self.device.table(np.ones((high, 1)))
        self._firsts = [
            self.device.upload(np.arange(high, dtype=np.int32) + high * s, np.dtype(np.int32), table=True)
            for s in range(len(self.mix))
        ]

    def __repr__(self) -> str:
        return f"Scenarios({len(self.mix)} of {self.operators[0]!r}, …)"

    def __len__(self) -> int:
        return len(self.mix)

    @property
    def cost(self) -> float:
        """Number of projector evaluations that one evaluation of the scenarios takes."""
        return float(sum(bool(self._shares(number)) for number in range(len(self.operators))))

    def stacked(self, fields: Sequence[DeviceArray]) -> DeviceArray:
        """Stack the volumes [x, y, z] of all scenarios, [x, y, scenario · z]."""
        out = self.device.upload(np.zeros(self.domain.shape, np.float32))
        for scenario, field in enumerate(fields):
            self._put(field, scenario, 1.0, False, out)
        return out

    def taken(self, stack: DeviceArray, scenario: int, out: DeviceArray | None = None) -> DeviceArray:
        """The volume [x, y, z] of one scenario of a stack."""
        out = self.device.empty(self.each.shape) if out is None else out
        first = self._firsts[scenario]
        self.device.launch(resample, source=stack, first=first, weights=self._ones, lanes=stack, target=out)
        return out

    def _put(self, source: DeviceArray, scenario: int, factor: float, keep: bool, out: DeviceArray) -> None:
        self.device.launch(
            put_slices, source=source, first=scenario * self.each.shape[2], factor=factor, keep=int(keep),
            lanes=source, stack=out,
        )  # fmt: skip

    def _shares(self, operator: int) -> list[int]:
        """Scenarios to which an operator contributes."""
        return [s for s, share in enumerate(self.mix[:, operator]) if share]

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        pulls: dict[int, DeviceArray] = {}
        for scenario in range(len(self)):
            volume = self.taken(x, scenario)
            if extent(volume) != (0.0, 0.0):
                pulls[scenario] = volume
        added = False
        for number, operator in enumerate(self.operators):
            shares = [s for s in self._shares(number) if s in pulls]
            if not shares:
                continue
            volume = self._sum(shares, number, pulls)
            image = self.device.empty(self.range.shape) if added else out
            operator.forward(volume, image)
            self.projections += 0.5
            if added:
                combine(1.0, out, 1.0, image, out)
            added = True
        if not added:
            self.operators[0].forward(self.device.upload(np.zeros(self.each.shape, np.float32)), out)

    def _sum(self, shares: list[int], operator: int, pulls: dict[int, DeviceArray]) -> DeviceArray:
        """Σ share · volume."""
        first, factor = pulls[shares[0]], float(self.mix[shares[0], operator])
        if len(shares) == 1 and factor == 1.0:
            return first
        out = combine(factor, first, 0.0, first, self.device.empty(first.shape))
        for scenario in shares[1:]:
            combine(1.0, out, float(self.mix[scenario, operator]), pulls[scenario], out)
        return out

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        begun: set[int] = set()
        dose = self.device.empty(self.each.shape)
        for number, operator in enumerate(self.operators):
            shares = self._shares(number)
            if shares:
                operator.transposed(y, dose)
                self.projections += 0.5
            for scenario in shares:
                self._put(dose, scenario, float(self.mix[scenario, number]), scenario in begun, out)
                begun.add(scenario)
