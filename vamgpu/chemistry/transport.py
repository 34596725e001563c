"""Diffusion and photochemistry of three species on a box of voxels with unequal edges."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.concentrations import NEVER, Concentrations
from vamgpu.chemistry.species import SPECIES, Rates, concentration
from vamgpu.errors import BadInput, ShapeMismatch, UnstableStep
from vamgpu.geometry import centers, counts, positive
from vamgpu.kernels.transport import transport
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, Positive


@dataclass(frozen=True)
class Reaction:
    """Rates of A (oxygen), B (lophyl) and C (o-Cl-HABI) per irradiance, eqs 5-7 of the paper. Raises `BadInput`."""

    k_a: NonNegative  # [mol/m³ per s and mW/mm²], as k_b and k_c
    k_b: NonNegative
    k_c: NonNegative  # at the initial [C] where order is 1
    k_2: NonNegative  # [m³/(mol·s)]
    initial: Positive = 1.0  # [C] before printing [mol/m³]
    order: int = 1  # of the splitting in [C]; 0 while C lasts
    cross: NonNegative = 0.0  # radicals that ultraviolet light starts, over those of as much visible light
    optical: Positive = 1.0  # T_opt: dose [mJ/mm²] of light whose radicals met no inhibitor
    mechanical: Positive = 2.0  # T_mec [mJ/mm²]

    def __post_init__(self) -> None:
        check(self)
        if self.order not in (0, 1):
            raise BadInput(f"Reaction order is {self.order!r}; expected 0 or 1")
        if self.mechanical < self.optical:
            raise BadInput(
                f"Reaction mechanical {self.mechanical:g} is below optical {self.optical:g}; expected it at or above"
            )

    @classmethod
    def of(cls, rates: Rates, cross: float = 0.0, optical: float = 1.0, mechanical: float = 2.0) -> Reaction:
        """The reaction of a resin's kinetics, C splitting as fast as ``rates`` says at its supply."""
        k, supply = (rates.k_a, rates.k_b, rates.k_c, rates.k_2), rates.supply or 1.0
        return cls(*k, supply, rates.order, cross, optical, mechanical)


FUSED, CACHE = 5, 2_500_000
"""Greatest number of steps that an item computes with a block of columns, and bytes for intermediate results."""
SPACING = 256
FACES = ("x low", "x high", "y low", "y high", "z low", "z high")


@dataclass(frozen=True)
class Boundary:
    """Concentration held at each of `FACES` of a box [mol/m³, or as the field]; None: no flux. Raises `BadInput`."""

    faces: tuple[NonNegative | None, ...] = (None,) * 6

    def __post_init__(self) -> None:
        if not isinstance(self.faces, (tuple, list)) or len(self.faces) != len(FACES):
            raise BadInput(f"faces are {self.faces!r}; expected six numbers or None: {', '.join(FACES)}")
        check(self)

    @classmethod
    def fixed(cls, value: float, *names: str) -> Boundary:
        """The faces of the given names (see `FACES`) fixed at a value; no flux elsewhere. Raises `BadInput`."""
        unknown = sorted(set(names) - set(FACES))
        if unknown:
            raise BadInput(f"no face is named {unknown[0]!r}; the faces are {', '.join(FACES)}")
        return cls(tuple(value if name in names else None for name in FACES))

    def ghosts(self) -> np.ndarray:
        """g0 and g1 of each face, shape (6, 2): the voxel beyond has g0 + g1·c, which fixes the value at the face."""
        return np.array([(0.0, 1.0) if face is None else (2.0 * face, -1.0) for face in self.faces])

    def holds(self, axis: int) -> int:
        """Number of fixed faces across an axis."""
        return sum(face is not None for face in self.faces[2 * axis : 2 * axis + 2])


@dataclass(frozen=True)
class Box:
    """Voxels of resin centered on the axis; no flux passes the radius, if there is one. Raises `BadInput`."""

    shape: tuple[int, int, int]
    pitch: tuple[float, float, float]
    radius: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", counts("Box shape", self.shape, 3))
        if not isinstance(self.pitch, (tuple, list)) or len(self.pitch) != 3:
            raise BadInput(f"Box pitch is {self.pitch!r}; expected three edges [mm] along x, y, z")
        object.__setattr__(self, "pitch", tuple(positive("Box pitch [mm]", d) for d in self.pitch))
        if self.radius is not None:
            object.__setattr__(self, "radius", positive("Box radius [mm]", self.radius))

    def open(self) -> np.ndarray:
        """Boolean (nx, ny): columns of voxels that are resin."""
        if self.radius is None:
            return np.ones(self.shape[:2], bool)
        x, y = (centers(n, d) for n, d in zip(self.shape[:2], self.pitch, strict=False))
        return x[:, None] ** 2 + y[None, :] ** 2 <= self.radius**2


@dataclass(frozen=True)
class Transport:
    """An explicit step of diffusion, then of reaction, for three species.

    diffusivities [mm²/s] of A, B and C. boundaries: per species, no flux by default. reaction: None for diffusion only.
    Raises `BadInput` for diffusivities that are not positive. Source: paper eqs 5-7, 12-14.
    """

    box: Box
    diffusivities: tuple[float, float, float]
    reaction: Reaction | None = None
    boundaries: tuple[Boundary, Boundary, Boundary] = (Boundary(), Boundary(), Boundary())
    device: Device = field(default=None)  # type: ignore[assignment] - the default device

    def __post_init__(self) -> None:
        for name in ("diffusivities", "boundaries"):
            given = getattr(self, name)
            if not isinstance(given, (tuple, list, np.ndarray)) or len(given) != 3:
                raise BadInput(f"{name} are {given!r}; expected one for each of {', '.join(SPECIES)}")
        if not all(isinstance(boundary, Boundary) for boundary in self.boundaries):
            raise BadInput(f"boundaries are {self.boundaries!r}; expected a Boundary for each of {', '.join(SPECIES)}")
        for name, kind in (("box", Box), ("reaction", Reaction | None)):
            if not isinstance(getattr(self, name), kind):
                raise BadInput(f"{name} is {getattr(self, name)!r}; expected a {name.capitalize()}")
        named = zip(SPECIES, self.diffusivities, strict=True)
        checked = tuple(positive(f"diffusivity of {name} [mm²/s]", value) for name, value in named)
        object.__setattr__(self, "diffusivities", checked)
        if not isinstance(self.device, Device):
            object.__setattr__(self, "device", open_device(self.device))

    @cached_property
    def limit(self) -> float:
        """Longest step [s] that is stable and keeps concentrations from falling below zero by diffusion."""
        rates = []
        for diffusivity, boundary in zip(self.diffusivities, self.boundaries, strict=True):
            faces = [2 + boundary.holds(axis) for axis in range(3)]
            rates.append(diffusivity * sum(n / d**2 for n, d in zip(faces, self.box.pitch, strict=True)))
        return 1.0 / max(rates)

    def steps(self, seconds: float) -> int:
        """Least number of equal steps for a span of time."""
        return max(1, ceil(seconds / self.limit * (1 - 1e-12)))

    def start(self, a: Any = 0.0, b: Any = 0.0, c: Any = 0.0) -> Concentrations:
        """Fields from numbers or arrays [x, y, z]. Raises `BadInput` for negative values and `ShapeMismatch`."""
        fields = [self._field(name, value) for name, value in zip(SPECIES, (a, b, c), strict=True)]
        shape = self.box.shape
        never = [self.device.upload(np.full(shape, NEVER, np.float32)) for _ in range(2)]
        return Concentrations(*fields, self.device.upload(np.zeros(shape, np.float32)), *never)  # pyright: ignore[reportCallIssue]

    def _field(self, name: str, value: Any) -> DeviceArray:
        values = concentration(name, value)
        if values.shape not in ((), self.box.shape):
            raise ShapeMismatch(f"{name} has shape {values.shape}; expected a number or {self.box.shape}")
        return self.device.upload(np.broadcast_to(values, self.box.shape))

    def advance(
        self,
        state: Concentrations,
        seconds: float,
        steps: int | None = None,
        visible: DeviceArray | None = None,
        ultraviolet: DeviceArray | None = None,
    ) -> None:
        """Advance a state in place under constant light [mW/mm²], None for dark. Raises `UnstableStep`, `BadInput`."""
        if not isinstance(state, Concentrations):
            raise BadInput(f"state is {state!r}; expected Concentrations, as start() makes them")
        span = positive("seconds", seconds)
        count = self.steps(span) if steps is None else counts("steps", (steps,), 1)[0]
        step = span / count
        if step > self.limit * (1 + 1e-9):
            raise UnstableStep(
                f"a step of {step:g} s is not stable; the limit is {self.limit:g} s: "
                f"use {self.steps(span)} steps or more",
                self.limit,
            )
        tables, k, spare, done = self._tables(step), self.reaction, self._spare, 0
        visible, ultraviolet = (self._dark if shade is None else shade for shade in (visible, ultraviolet))
        while done < count:
            steps = min(self._fused, count - done)
            self.device.launch(
                transport, a=state.a, b=state.b, c=state.c, visible=visible, ultraviolet=ultraviolet, **self._borders,
                **tables, order=k.order if k else 0, reacting=int(k is not None), optical=k.optical if k else 1.0,
                mechanical=k.mechanical if k else 1.0, time=state.time + done * step, steps=steps,
                scratch=self._scratch, a_out=spare[0], b_out=spare[1], c_out=spare[2], dose=state.dose,
                optical_time=state.optical_time, mechanical_time=state.mechanical_time,
            )  # fmt: skip
            state.a, state.b, state.c, spare[:] = *spare, [state.a, state.b, state.c]
            done += steps
        state.time += span

    def _tables(self, step: float) -> dict[str, DeviceArray]:
        """Diffusion and reaction rates of a step, stored for the next one; C splits at the rate k_c at first."""
        if step not in self._kept:
            k = self.reaction or Reaction(0.0, 0.0, 0.0, 0.0)
            k_c = k.k_c / k.initial if k.order else k.k_c
            spread = [[d * step / p**2 for p in self.box.pitch] for d in self.diffusivities]
            rates = [k.k_a * step, k.k_b * step, k_c * step, k.k_2 * step, k.cross, step]
            self._kept.clear()
            self._kept[step] = {"spread": self.device.table(spread), "rates": self.device.table(rates)}
        return self._kept[step]

    @cached_property
    def _kept(self) -> dict[float, dict[str, DeviceArray]]:
        return {}

    @cached_property
    def _fused(self) -> int:
        """Number of steps per launch: several if an item owns a block of columns, else one."""
        columns = self.box.shape[0] * self.box.shape[1]
        items = self.device.items(transport, self.box.shape)
        if not self.device.lanes_for(1) or items * 16 > columns:
            return 1
        return 1 + max(1, min(FUSED - 1, CACHE // (4 * self._plane)))

    @cached_property
    def _plane(self) -> int:
        """Floats of scratch memory for an intermediate step: three planes of x of all species."""
        _, ny, nz = self.box.shape
        lanes = self.device.lanes_for(nz)
        return 9 * -(-nz // lanes) * (ny * lanes + SPACING)

    @cached_property
    def _scratch(self) -> DeviceArray:
        if self._fused == 1:
            return self.device.empty((1, 1), "float32" if self.device.lanes_for(1) else None, table=True)
        items = self.device.items(transport, self.box.shape)
        return self.device.empty((items, (self._fused - 1) * self._plane), "float32", table=True)

    @cached_property
    def _spare(self) -> list[DeviceArray]:
        return [self.device.empty(self.box.shape) for _ in range(3)]

    @cached_property
    def _dark(self) -> DeviceArray:
        return self.device.upload(np.zeros(self.box.shape, np.float32))

    @cached_property
    def _borders(self) -> dict[str, DeviceArray]:
        walls = np.stack([boundary.ghosts() for boundary in self.boundaries])
        return {"open": self.device.table(self.box.open(), "uint8"), "walls": self.device.table(walls)}
