"""Two colors of light from a projector, through resin that bleaches while its inhibitor is used up."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, cos, sin

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.transport import Box
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Turntable, positive
from vamgpu.kernels.attenuate import column_density, expose
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, NonNegative
from vamgpu.travel import at_rest


@dataclass(frozen=True)
class ColorExtinction:
    """Extinction μ + ε·[C] of a color, natural logarithm. Raises `BadInput` for negative values."""

    constant: Absorption = 0.0
    per_c: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, eq=False)
class ColorExposure:
    """Sinograms of both colors, [angle, r, z] in mW/mm² at the resin's entrance; all angles last equally long."""

    box: Box  # of the resin, with its radius; its slices are the rows of the light
    visible: np.ndarray | None
    ultraviolet: np.ndarray | None
    extinction: tuple[ColorExtinction, ColorExtinction] = (ColorExtinction(), ColorExtinction())
    pitch: float | None = None  # between columns of light [mm], by default the box's along x
    device: Device = field(default=None)  # type: ignore[assignment] - must be the transport's
    motion: Turntable | None = None  # the angles, by default evenly spaced over a turn.  Either color may be None

    def __post_init__(self) -> None:
        given = [light for light in (self.visible, self.ultraviolet) if light is not None]
        if not given or not isinstance(self.device, Device):
            raise BadInput("an exposure got no light or no device; expected light of a color, and a device")
        if self.box.radius is None:
            raise BadInput("light enters a cylinder of resin; give the box its radius")
        object.__setattr__(self, "pitch", positive("pitch of the light [mm]", self.pitch or self.box.pitch[0]))
        for light in given:
            if np.ndim(light) != 3 or light.shape != given[0].shape or light.shape[2] != self.box.shape[2]:
                raise ShapeMismatch(
                    f"light has shape {np.shape(light)}; expected [angle, r, {self.box.shape[2]}] for both colors"
                )
            if not np.isfinite(light).all() or np.min(light) < 0:
                raise BadInput(f"light holds {np.min(light):g} mW/mm²; expected finite numbers ≥ 0")

        motion = Turntable(given[0].shape[0]) if self.motion is None else self.motion
        object.__setattr__(self, "motion", motion)
        at_rest("an exposure", motion)
        if motion.angles != given[0].shape[0] or motion.dwell is not None:
            raise BadInput(f"the light has {given[0].shape[0]} angles, its motion is {motion}; expected as many "
                f"angles, lit for equal times: solve with a Turntable without dwell")  # fmt: skip

    @property
    def shape(self) -> tuple[int, int, int]:
        """Angles, columns and rows of the light."""
        light = self.ultraviolet if self.visible is None else self.visible
        return tuple(light.shape)  # type: ignore[union-attr, return-value]

    @property
    def angles(self) -> int:
        """Angles of a turn."""
        return self.shape[0]

    def irradiance(self, inhibitor: DeviceArray, angle: int) -> tuple[DeviceArray, DeviceArray]:
        """Irradiance [mW/mm²] of both colors in every voxel, attenuated by C [mol/m³]; overwritten by the next call."""
        angle, (path, visible, ultraviolet) = angle % self.angles, self._fields
        self.device.launch(column_density, species=inhibitor, open=self._open, pose=self._poses[angle], path=path)
        self.device.launch(expose, path=path, **self._lights, angle=angle, pose=self._poses[angle],
                           visible=visible, ultraviolet=ultraviolet)  # fmt: skip
        return visible, ultraviolet

    @property
    def step(self) -> float:
        """Step along a ray [mm]."""
        return min(self.box.pitch[:2])

    @cached_property
    def _poses(self) -> list[DeviceArray]:
        sizes = (*self.box.pitch[:2], self.pitch, self.step, self.box.radius, 0.0)
        turns = self.motion.poses.tolist()  # type: ignore[union-attr]
        return [self.device.table([cos(turn), sin(turn), *sizes]) for turn in turns]

    @cached_property
    def _fields(self) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        steps = ceil(2.0 * (self.box.radius or 0.0) / self.step) + 2
        path = self.device.empty((self.shape[1], steps, self.shape[2]))
        return path, self.device.empty(self.box.shape), self.device.empty(self.box.shape)

    @cached_property
    def _lights(self) -> dict[str, DeviceArray]:
        dark = np.zeros(self.shape, np.float32)
        first, second = (self.device.upload(dark if light is None else light)
                         for light in (self.visible, self.ultraviolet))  # fmt: skip
        extinction = self.device.table([[color.constant, color.per_c] for color in self.extinction])
        return {"visible_light": first, "ultraviolet_light": second, "extinction": extinction}

    @cached_property
    def _open(self) -> DeviceArray:
        return self.device.table(self.box.open(), "uint8")
