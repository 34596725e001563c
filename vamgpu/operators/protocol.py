"""The attributes of an operator that methods and proofs need."""

from __future__ import annotations

from typing import Any, Protocol

from vamgpu.backend.device import Device

ATTRIBUTES = ("domain", "range", "device", "grid", "beam", "motion", "T")
"""Attributes of every operator for which light is optimized."""


class Operator(Protocol):
    """A linear map from volumes to light, with its exact transpose and its geometry.

    Every `LinearOperator` with a geometry is one. One in a vessel also has the attribute ``vessel``.

    Attributes:
        domain: Space of volumes; its ``shape`` is that of the grid, [x, y, z].
        range: Space of light; its ``shape`` is [angle, r, z].
        device: The device of its arrays.
        grid: The `Grid` or `WebGrid` of the volume.
        beam: The `Beam`, whose pixels are [r, z].
        motion: The `Turntable` or the web's motion, whose poses are the angles.
    """

    @property
    def domain(self) -> Any: ...

    @property
    def range(self) -> Any: ...

    @property
    def device(self) -> Device: ...

    @property
    def grid(self) -> Any: ...

    @property
    def beam(self) -> Any: ...

    @property
    def motion(self) -> Any: ...

    @property
    def T(self) -> Any:  # noqa: N802 - the mathematician's name
        """The transpose, which is called in the same way."""
        ...

    def __call__(self, x: Any, out: Any = None) -> Any:
        """A x [range.shape] of a field on the device, which does not change; in ``out``, or in a new field."""
        ...
