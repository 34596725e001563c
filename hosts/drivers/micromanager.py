"""Stages and cameras of Micro-Manager's device adapters, through the ``pymmcore-plus`` package."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from vamgpu.errors import DeviceError, DeviceLost, DeviceNotFound, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.cleanup import Closing, extra
from vamgpu.hosts.drivers.stages import PolledStage

log: logging.Logger = logging.getLogger(__name__)
UM_IN_MM = 1000.0


def open_core(configuration: str | Path) -> Any:
    """Open a core with the devices of a configuration file, as Micro-Manager's wizard writes it."""
    with extra("micromanager", "Micro-Manager devices need pymmcore-plus"):
        from pymmcore_plus import CMMCorePlus
    if not Path(configuration).is_file():
        raise DeviceNotFound(f"there is no configuration {configuration}; write one with Micro-Manager's wizard")
    core = CMMCorePlus()
    try:
        core.loadSystemConfiguration(str(configuration))
    except Exception as error:
        raise DeviceNotFound(
            f"the devices of {configuration} do not start ({error}); check plugs and power, and that the adapters "
            "are installed: mmcore install"
        ) from error
    return core


class _Device(Closing):
    """One device of a core, by its label; ``owned`` unloads the core's devices at the end."""

    label: str

    def __init__(self, core: Any, label: str, kind: str, owned: bool) -> None:
        self._core, self.label, self._owned = core, label, owned
        labels = list(core.getLoadedDevices())
        if label not in labels:
            self.release()
            raise DeviceNotFound(f"there is no device {label!r} among {', '.join(labels)}; correct its label")
        if (found := core.getDeviceType(label).name) != kind:
            self.release()
            raise WrongDevice(f"the device {label!r} is of the kind {found}, expected {kind}; correct its label")

    def _call(self, name: str, *arguments: Any, lost: type[DeviceError] = DeviceRefused) -> Any:
        try:
            return getattr(self._core, name)(*arguments)
        except Exception as error:
            raise lost(f"{self.label} failed in {name} ({error}); check its plug, its power and the value") from error

    def release(self) -> None:
        owned, self._owned = self._owned, False
        if owned:
            self._core.unloadAllDevices()


class MicroManagerStage(_Device, PolledStage):
    """A linear stage of one axis; it moves to positions and cannot run at a speed."""

    def __init__(
        self, core: Any, label: str, speed_property: str | None = None, owned: bool = False, **options: Any
    ) -> None:
        _Device.__init__(self, core, label, "StageDevice", owned)
        PolledStage.__init__(self, self, label, 1.0, "mm", **options)
        self._speed_property = speed_property

    @classmethod
    def open(cls, configuration: str | Path, label: str, speed_property: str | None = None) -> Self:
        """Open the device of a label in a ``.cfg`` file."""
        return cls(open_core(configuration), label, speed_property, owned=True)

    def position(self) -> float:
        return self._call("getPosition", self.label, lost=DeviceLost) / UM_IN_MM

    def _move(self, position: float, speed: float) -> None:
        if self._speed_property is not None:
            self._call("setProperty", self.label, self._speed_property, speed)
        self._call("setPosition", self.label, position * UM_IN_MM)

    def run(self, speed: float) -> None:
        """Stop at speed 0; any other speed is rejected."""
        if speed != 0:
            raise DeviceRefused(
                f"{self.label} cannot run at {speed} mm/s: Micro-Manager only moves to positions; use the driver of "
                "the stage's maker for motion at a speed",
                "run",
            )
        self.stop()

    def busy(self) -> bool:
        return self._call("deviceBusy", self.label, lost=DeviceLost)

    def stop(self) -> None:
        self._call("stop", self.label)


class MicroManagerCamera(_Device):
    """A camera of Micro-Manager."""

    def __init__(self, core: Any, label: str, owned: bool = False) -> None:
        super().__init__(core, label, "CameraDevice", owned)
        try:
            self._call("setCameraDevice", label)
        except BaseException:
            self.release()
            raise

    @classmethod
    def open(cls, configuration: str | Path, label: str) -> Self:
        """Open the device of a label in a ``.cfg`` file."""
        return cls(open_core(configuration), label, owned=True)

    def expose(self, exposure_us: float) -> None:
        """Set the exposure time [us]; DeviceRefused if the camera's differs by more than 2 %."""
        self._call("setExposure", self.label, exposure_us / 1000)
        found = self._call("getExposure", self.label) * 1000
        if abs(found - exposure_us) > 0.02 * exposure_us:
            raise DeviceRefused(f"{self.label} exposes {found:g} us after {exposure_us:g} us were set", "exposure")

    def frame(self, binning: int, crop: Sequence[int] | None) -> None:
        """Set the binning, and the crop: left, top, columns and rows."""
        if binning != 1:
            self._call("setProperty", self.label, "Binning", binning)
        if crop is not None:
            self._call("setROI", *crop)

    def grab(self) -> np.ndarray:
        self._call("snapImage", lost=DeviceLost)
        image = np.array(self._call("getImage", lost=DeviceLost))
        if image.ndim != 2:
            raise DeviceRefused(f"{self.label} gives images of shape {list(image.shape)}; set it to gray", "pixels")
        return image

    def close(self) -> None:
        self.release()
