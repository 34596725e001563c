"""Curing that oxygen inhibits: what light uses up during a print, and what diffuses meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, Literal, NamedTuple, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.diffusion import Heat
from vamgpu.chemistry.transport import FACES
from vamgpu.chemistry.turns import Fields, Turns, copy_all
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.kernels.inhibition import oxygen_adjoint, oxygen_step
from vamgpu.operators.compose import Derived, combine, inherit
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.space import require
from vamgpu.schema import check
from vamgpu.schema.quantities import Count, ExposureTime, Quantity

Spreads = Annotated[float, Quantity("a diffusivity", least=0.0)]
Face = Literal["x low", "x high", "y low", "y high", "z low", "z high"]
Floor = Annotated[float, Quantity(above=0.0, most=0.5, hint="above 0, at most 0.5: beyond it, oxygen hardly inhibits")]


@dataclass(frozen=True, eq=False)
class Oxygen:
    """Oxygen in a resin during a print of several turns.

    Light first uses up oxygen. The monomer cures with the light that finds none. Light is divided among oxygen, a share
    a of that in air-saturated resin, and the monomer, a share ε: ∂a/∂t = D∇²a − I·a/(a + ε), ∂X/∂t = I·ε/(a + ε),
    where I·dt is the dose, relative to the dose that uses up all oxygen of saturated resin.

    Args:
        diffusivity: D [mm²/s]; 0 for oxygen that stays in place.
        turns: Number of turns of the print, all with the same patterns.
        period: Time of a turn [s].
        used: Share of the oxygen of air-saturated resin that is used up before the print, 0..1: a number, a profile
            along z, or a volume [x, y, z].
        air: Faces of the grid that touch air and stay saturated, such as "z high"; no flux passes other faces.
        runs: Number of runs of angles per turn; the light of a run arrives at once.
        floor: ε, relative to the oxygen of air-saturated resin.
        steps: Substeps within a run; more of them follow oxygen that diffuses farther than a voxel during a run.

    Raises:
        BadInput: A value is out of its range.
    """

    diffusivity: Spreads
    turns: Count
    period: ExposureTime
    used: np.ndarray | float = 0.0
    air: tuple[Face, ...] = ()
    runs: Count = 12
    floor: Floor = 0.02
    steps: Count = 1

    def __post_init__(self) -> None:
        check(self)
        if not isinstance(self.air, tuple | list) or any(face not in FACES for face in self.air):
            raise BadInput(f'Oxygen air is {self.air!r}; expected some of {", ".join(FACES)}, as in air=("z high",)')
        used = np.asarray(self.used)
        if used.dtype.kind not in "iuf" or used.ndim not in (0, 1, 3):
            raise BadInput(f"Oxygen used is {used.dtype} {used.shape}; expected a number, [z] or [x, y, z]")
        if not (used.size and used.min() >= 0.0 and used.max() <= 1.0):
            raise BadInput(f"Oxygen used reaches from {used.min(initial=1):g} to {used.max(initial=0):g}; expected "
                           "shares, 0 to 1")  # fmt: skip
        object.__setattr__(self, "air", tuple(self.air))
        object.__setattr__(self, "used", used if used.ndim else float(used))

    @property
    def seconds(self) -> float:
        """Exposure [s]."""
        return self.turns * self.period

    @property
    def reach(self) -> float:
        """Distance [mm] from which oxygen comes during the exposure: 3·√(2·D·exposure)."""
        return 3.0 * sqrt(2.0 * self.diffusivity * self.seconds)


class OxygenFields(NamedTuple):
    """The state of every voxel, relative to the oxygen of air-saturated resin, or to the dose that uses it all up."""

    used: DeviceArray  # oxygen that is missing, [x, y, z]
    cured: DeviceArray  # X, the dose that found no oxygen, [x, y, z]

    @property
    def effective_dose(self) -> DeviceArray:
        """X plus the used oxygen [x, y, z]: 1 at the end of the induction."""
        return combine(1.0, self.used, 1.0, self.cured, self.used.device.empty(self.used.shape))


@final
class OxygenModel(Turns, Derived):
    """A projector in a resin whose oxygen inhibits curing, in place of a projector for `vamgpu.optimize`.

    ``model.T(patterns)`` is the effective dose after the last turn: 1 where oxygen has just been used up, above it
    where resin has cured. Without diffusion, it is the dose of the projector. The patterns are those of the whole
    exposure, of which every turn gives an equal part. It is not linear: ``model(slope)`` turns derivatives by the
    effective dose into those by the patterns that were exposed last, exact to rounding.

    Args:
        operator: Any projector on a turntable. Rings are replaced by rays, whose turn can be cut into runs.
        oxygen: The oxygen, and the turns of the print.

    Raises:
        BadInput: An argument is of another type, or angles are lit for unequal times.
        ShapeMismatch: The oxygen that is used up is of another grid.
    """

    def __init__(self, operator: LinearOperator, oxygen: Oxygen) -> None:
        A: Any = operator.direct if isinstance(operator, RingProjection) else operator
        if not isinstance(oxygen, Oxygen):
            raise BadInput(f"OxygenModel got {oxygen!r}; expected Oxygen(diffusivity=…, turns=…, period=…)")
        super().__init__((A,), oxygen.turns, oxygen.period, oxygen.runs, oxygen.steps, (oxygen.diffusivity,),
                         oxygen.air)  # fmt: skip
        self.operator: LinearOperator = A
        self.oxygen: Oxygen = oxygen
        self._set_spaces(A.domain, A.range, A.device)
        inherit(self, A)
        shape = self.domain.shape
        if np.ndim(oxygen.used) and np.shape(oxygen.used) != (shape if np.ndim(oxygen.used) == 3 else shape[2:]):
            raise ShapeMismatch(f"the oxygen that is used up has shape {np.shape(oxygen.used)}; expected {shape} = "
                                f"[x, y, z], or {shape[2:]}")  # fmt: skip
        self._exposed, heat, edge = False, self._heats[0], A.grid.pitch
        kinds = () if heat is None else tuple((side * edge**2 / 24.0, air) for side in (-1, 1) for air in (True, False))
        self._centers: list[Heat] = [heat.of(*kind) for kind in kinds if heat is not None]
        self._inward = self._centers[1] if kinds else None

    def __repr__(self) -> str:
        return f"OxygenModel({self.operator!r}, {self.oxygen!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        if not self._exposed:
            self.operator.forward(x, out)
            return
        slope, last = slopes = self._volumes(2)
        copy_all((x, x), slopes)
        self._average(slopes, back=True)
        copy_all(self._back((slope,), last), (out,))

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        used, cured = self._through((y,))
        self._exposed = True
        self._average((used, cured))
        combine(1.0, used, 1.0, cured, out)

    def _average(self, fields: Fields, back: bool = False) -> None:
        """Means over voxels of used oxygen and X at their centers; ``back``: the transpose."""
        for field, heat in zip(fields, self._centers[2:], strict=False):
            heat.spread(field, back)

    def forget(self) -> None:
        """Forget exposed patterns: derivatives are those of the plain dose until others are exposed."""
        self._exposed = False

    def state(self, light: Any, each: Callable[[float, OxygenFields], None] | None = None) -> OxygenFields:
        """Compute the oxygen and the curing after the last turn.

        Args:
            light: Patterns [angle, r, z] of the whole exposure.
            each: Gets the time [s] and the fields after every run of angles, at the centers of voxels; they change
                afterwards.

        Returns:
            The fields.
        """
        require(self.range, light, "the patterns")
        seconds, late = self.period / self._substeps, 0.5 if self._halved else 1.0

        def told(number: int, fields: Fields) -> None:
            assert each is not None
            each(min((number + late) * seconds, self.oxygen.seconds), OxygenFields(*fields))

        fields = OxygenFields(*self._through((self.device.field(light),), told if each else None))
        self._average(fields)
        return fields._replace(used=self.device.upload(np.clip(fields.used.numpy(), 0.0, 1.0)))

    def gel_times(self, light: Any, threshold: float = 1.0) -> np.ndarray:
        """Compute when the resin of every voxel solidifies.

        Args:
            light: Patterns [angle, r, z] of the whole exposure.
            threshold: Effective dose from which resin is solid.

        Returns:
            Time [s] at which the effective dose first reaches the threshold, [x, y, z]; infinite if it never does.
        """
        before = np.asarray(self._start()[0].numpy(), np.float64)
        found, last = np.where(before >= threshold, 0.0, np.inf), 0.0

        def look(time: float, fields: OxygenFields) -> None:
            nonlocal last
            dose = fields.effective_dose.numpy().astype(np.float64)
            now = np.isinf(found) & (dose >= threshold)
            found[now] = time - (time - last) * (dose[now] - threshold) / (dose[now] - before[now])
            before[...], last = dose, time

        self.state(light, look)
        return found

    def _start(self) -> Fields:
        used = self.device.upload(np.broadcast_to(np.asarray(self.oxygen.used, np.float64), self._shape))
        for heat in self._centers[:1]:
            heat.spread(used)
        return used, self.device.upload(np.zeros(self._shape, np.float32))

    def _react(self, dose: Fields, share: float, before: Fields, after: Fields) -> None:
        given = {"dose": dose[0], "gain": share / (self.turns * self.steps), "floor": self.oxygen.floor}
        self.device.launch(oxygen_step, **given, used=before[0], x=before[1], used_end=after[0], x_end=after[1])

    def _react_back(
        self, dose: Fields, share: float, species: Fields, slopes: Fields, x_slope: DeviceArray, by_dose: Fields
    ) -> None:  # fmt: skip
        given = {"dose": dose[0], "gain": share / (self.turns * self.steps), "floor": self.oxygen.floor}
        self.device.launch(oxygen_adjoint, **given, used=species[0], x_slope=x_slope, used_slope=slopes[0],
                           dose_slope=by_dose[0])  # fmt: skip
