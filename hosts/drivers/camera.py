"""Cameras: GenICam devices through the harvesters package, and files in their place."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceNotFound

log = logging.getLogger(__name__)


@runtime_checkable
class Camera(Protocol):
    """Takes pictures ``[row, column]`` of whole numbers, row 0 at the top."""

    def expose(self, exposure_us: float) -> None:
        """Set the time of exposure [us]."""
        ...

    def grab(self) -> np.ndarray:
        """Take a picture."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


class GenicamCamera:
    """A camera behind a maker's GenTL producer (a ``.cti`` file), driven by the harvesters package."""

    def __init__(self, harvester: Any, serial: str | None = None, timeout_s: float = 2.0) -> None:
        self._harvester, self._timeout = harvester, timeout_s
        self._acquirer: Any = None
        try:
            harvester.update()
            found = [str(info.serial_number) for info in harvester.device_info_list]
            if not found or (serial is not None and serial not in found):
                raise DeviceNotFound(
                    f"camera {serial or ''} is not among those found ({', '.join(found) or 'none'}); "
                    "check cable, power and the maker's producer file"
                )
            self._acquirer = harvester.create({"serial_number": serial or found[0]})
            self._acquirer.start()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, producer: str | Path, serial: str | None = None, timeout_s: float = 2.0) -> Self:
        """Open the camera with a serial number (None: the first) through the producer file of its maker."""
        try:
            from harvesters.core import Harvester  # type: ignore[import-not-found]
        except ImportError as error:
            raise DeviceNotFound('GenICam cameras need harvesters: pip install "vamgpu[camera]"') from error
        if not Path(producer).is_file():
            raise DeviceNotFound(f"there is no producer file {producer}; install the camera maker's package")
        harvester = Harvester()
        harvester.add_file(str(producer))
        return cls(harvester, serial, timeout_s)

    def expose(self, exposure_us: float) -> None:
        """Set the time of exposure [us]."""
        try:
            self._acquirer.remote_device.node_map.ExposureTime.value = float(exposure_us)
        except Exception as error:
            raise DeviceError(f"the camera does not take an exposure of {exposure_us} us ({error})") from error

    def grab(self) -> np.ndarray:
        """Take a picture."""
        try:
            with self._acquirer.fetch(timeout=self._timeout) as buffer:
                part = buffer.payload.components[0]
                return np.array(part.data, copy=True).reshape(part.height, part.width)
        except Exception as error:
            raise DeviceLost(f"the camera gave no picture in {self._timeout} s ({error}); check its cable") from error

    def close(self) -> None:
        """Let go of the camera; more than once does no harm."""
        acquirer, self._acquirer = self._acquirer, None
        harvester, self._harvester = self._harvester, None
        for part, name in ((acquirer, "stop"), (acquirer, "destroy"), (harvester, "reset")):
            if part is not None:
                try:
                    getattr(part, name)()
                except Exception as error:  # a camera that is gone must not keep the rest from closing
                    log.warning("closing the camera: %s", error)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _natural(path: Path) -> list[tuple[int, int | str]]:
    """A key that puts 2 before 10."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", path.name) if part]


class FilePlayer:
    """Pictures of a folder, in the order of the numbers in their names, one for each ``grab``.

    It is a camera by configuration, for records to be looked at again; after the last picture it raises DeviceError,
    or begins again if ``loop``.
    """

    def __init__(self, folder: str | Path, pattern: str = "*", loop: bool = False) -> None:
        kinds = {".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg"}
        try:
            names = [path for path in Path(folder).glob(pattern) if path.suffix.lower() in kinds]
        except OSError as error:
            raise BadInput(f"{folder} cannot be read ({error})") from error
        self.paths = sorted(names, key=_natural)
        if not self.paths:
            raise DeviceNotFound(f"there are no pictures {pattern} in {folder}; check the folder")
        self._loop = loop
        self._next = self._play()

    def _play(self) -> Iterator[Path]:
        while True:
            yield from self.paths
            if not self._loop:
                return

    def expose(self, exposure_us: float) -> None:
        """Pictures of the past keep their exposure."""

    def grab(self) -> np.ndarray:
        """Read the next picture as gray levels."""
        from PIL import Image

        path = next(self._next, None)
        if path is None:
            raise DeviceError(f"all {len(self.paths)} pictures have been played")
        try:
            with Image.open(path) as image:
                return np.asarray(image if image.mode in ("L", "I;16", "I", "F") else image.convert("L"))
        except OSError as error:
            raise BadInput(f"{path} is no picture that can be read ({error})") from error

    def close(self) -> None:
        """Nothing is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
