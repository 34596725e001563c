"""Cameras: GenICam devices through the harvesters package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from vamgpu.errors import DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.cleanup import ClosedOnce, closed_on_error, extra


@runtime_checkable
class CameraDriver(Protocol):
    """Takes images ``[row, column]`` of whole numbers, row 0 at the top."""

    def expose(self, exposure_us: float) -> None: ...  # set the exposure time [us]
    def grab(self) -> np.ndarray: ...  # take an image
    def close(self) -> None: ...  # release the camera


@runtime_checkable
class Buffered(Protocol):
    """A camera that runs on its own and keeps images until they are taken."""

    def flush(self) -> None: ...  # drop these; the next image begins after now


class GenicamCamera(ClosedOnce):
    """A camera behind a maker's GenTL producer (a ``.cti`` file), driven by the harvesters package."""

    called = "the camera"
    exposure_us: float | None = None  # as read back from the camera
    gain: float | None = None

    def __init__(
        self, harvester: Any, serial: str | None = None, timeout_s: float = 2.0, exposure_us: float | None = None,
        gain: float | None = None, pixels: str | None = None, trigger: str | None = None, binning: int = 1,
        crop: Sequence[int] | None = None,
    ) -> None:  # fmt: skip
        self._harvester, self._timeout = harvester, timeout_s
        self._acquirer: Any = None
        with closed_on_error(self):
            harvester.update()
            found = [str(info.serial_number) for info in harvester.device_info_list]
            if not found or (serial is not None and serial not in found):
                raise DeviceNotFound(
                    f"camera {serial or ''} is not among those found ({', '.join(found) or 'none'}); "
                    "check cable, power and the maker's producer file"
                )
            self._acquirer = harvester.create({"serial_number": serial or found[0]})
            self._frame(binning, crop)
            self._settle(exposure_us, gain, pixels, trigger)
            self._acquirer.start()

    @classmethod
    def open(cls, producer: str | Path, serial: str | None = None, **settings: Any) -> Self:
        """Open a camera through the producer file of its maker; each setting is read back."""
        with extra("camera", "GenICam cameras need harvesters"):
            from harvesters.core import Harvester  # type: ignore[import-not-found]
        if not Path(producer).is_file():
            raise DeviceNotFound(f"there is no producer file {producer}; install the camera maker's package")
        harvester = Harvester()
        harvester.add_file(str(producer))
        return cls(harvester, serial, **settings)

    def _set(self, name: str, value: float | str) -> float | str:
        """Set a feature and return its value, read back."""
        try:
            node = getattr(self._acquirer.remote_device.node_map, name)
            node.value = value
            return node.value
        except Exception as error:
            raise DeviceRefused(
                f"the camera does not take {value!r} for its {name} ({error}); check its maker's viewer", name
            ) from error

    def _choose(self, name: str, value: str | int) -> None:
        found = self._set(name, value)
        if found != value:
            raise DeviceRefused(f"the camera's {name} is {found!r} after {value!r} was set; give a value that its "
                                "maker's viewer accepts", name)  # fmt: skip

    def _number(self, name: str, value: float) -> float:
        """Set a number; cameras round it to their own steps, DeviceRefused beyond 2 %."""
        found = float(self._set(name, float(value)))
        if abs(found - value) > 0.02 * max(abs(value), 1.0):
            raise DeviceRefused(f"the camera's {name} is {found:g} after {value:g} was set; give another value", name)
        return found

    def expose(self, exposure_us: float) -> None:
        """Set the exposure time [us]; DeviceRefused if the camera's differs by more than 2 %."""
        self.exposure_us = self._number("ExposureTime", exposure_us)

    def _frame(self, binning: int, crop: Sequence[int] | None) -> None:
        """Set binning and crop: offsets are 0 while the size is set, which cameras limit by them."""
        wanted = [] if binning == 1 else [("BinningHorizontal", binning), ("BinningVertical", binning)]
        if crop is not None:
            left, top, columns, rows = crop
            wanted += [("OffsetX", 0), ("OffsetY", 0), ("Width", columns), ("Height", rows)]
            wanted += [("OffsetX", left), ("OffsetY", top)]
        for name, value in wanted:
            self._choose(name, value)

    def _settle(self, exposure_us: float | None, gain: float | None, pixels: str | None, trigger: str | None) -> None:
        """Apply the settings in the order that cameras accept: automatics are off before values are set."""
        if pixels is not None:
            self._choose("PixelFormat", pixels)
        if exposure_us is not None:
            self._turn_off("ExposureAuto")
            self.expose(exposure_us)
        if gain is not None:
            self._turn_off("GainAuto")
            self.gain = self._number("Gain", gain)
        if trigger is not None:
            self._choose("TriggerSelector", "FrameStart")
            if trigger:
                self._choose("TriggerSource", trigger)
            self._choose("TriggerMode", "On" if trigger else "Off")

    def _turn_off(self, name: str) -> None:
        """Turn an automatic off, if the camera has it."""
        if hasattr(self._acquirer.remote_device.node_map, name):
            self._choose(name, "Off")

    def grab(self) -> np.ndarray:
        try:
            with self._acquirer.fetch(timeout=self._timeout) as buffer:
                part = buffer.payload.components[0]
                return np.array(part.data, copy=True).reshape(part.height, part.width)
        except Exception as error:
            raise DeviceLost(f"the camera gave no image in {self._timeout} s ({error}); check its cable") from error

    def flush(self) -> None:
        """Start again, without the images taken so far. Raises `DeviceLost`."""
        try:
            self._acquirer.stop()
            self._acquirer.start()
        except Exception as error:
            raise DeviceLost(f"the camera does not start again ({error}); check its cable") from error

    def endings(self) -> tuple[Callable[[], object], ...]:
        acquirer = () if self._acquirer is None else (self._acquirer.stop, self._acquirer.destroy)
        return *acquirer, self._harvester.reset
