"""Cameras of Micro-Manager's device adapters, through the ``pymmcore-plus`` package."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from vamgpu.errors import DeviceError, DeviceLost, DeviceNotFound, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.cleanup import Closing, closed_on_error, extra

log: logging.Logger = logging.getLogger(__name__)


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


class MicroManagerCamera(Closing):
    """A camera of Micro-Manager, by its label; ``owned`` unloads the core's devices at the end."""

    def __init__(self, core: Any, label: str, owned: bool = False) -> None:
        self.label = label
        self._core, self._owned = core, owned
        labels = list(core.getLoadedDevices())
        with closed_on_error(self):
            if label not in labels:
                raise DeviceNotFound(f"there is no device {label!r} among {', '.join(labels)}; correct its label")
            if (found := core.getDeviceType(label).name) != "CameraDevice":
                raise WrongDevice(f"the device {label!r} is of the kind {found}, expected a camera; correct its label")
            self._call("setCameraDevice", label)

    def _call(self, name: str, *arguments: Any, lost: type[DeviceError] = DeviceRefused) -> Any:
        try:
            return getattr(self._core, name)(*arguments)
        except Exception as error:
            raise lost(f"{self.label} failed in {name} ({error}); check its plug, its power and the value") from error

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
        owned, self._owned = self._owned, False
        if owned:
            self._core.unloadAllDevices()
