"""Tunable lenses on Optotune's ICC-1C, ICC-4C or ECC-1C, through the maker's package ``optoICC``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, Self

from vamgpu.errors import BadInput, DeviceError, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.cleanup import Closing, closed_on_error
from vamgpu.hosts.drivers.lens import Lens

log: logging.Logger = logging.getLogger(__name__)


def _number(found: Any) -> float:
    """A number of the package, which some of its releases return in a list."""
    return float(found[0] if isinstance(found, Sequence) and not isinstance(found, str) else found)


class IccLens(Closing, Lens):
    """A lens on one channel, in focal power mode; ``least`` and ``greatest`` are its powers [1/m]."""

    same: float = 0.01

    def __init__(self, connect: Callable[[], Any], channel: int = 0) -> None:
        self._connect, self._number = connect, channel
        self._start()
        log.info("ICC: lens of %.3g to %.3g dpt on channel %d", self.least, self.greatest, channel)

    def _start(self) -> None:
        """Connect, and choose the lens and its input."""
        self._board = self._connect()
        with closed_on_error(self):
            if self._missing():
                raise DeviceNotFound(
                    f"channel {self._number} of the ICC has no lens; check its plug and channel in [lens]"
                )
            self._channel = self._call(lambda: self._board.channel[self._number], "the channel")
            self._call(self._channel.StaticInput.SetAsInput, "the choice of its input")
            limits = self._channel.LensCompensation
            self.least: float = _number(self._call(limits.GetMinDiopter, "the least power"))
            self.greatest: float = _number(self._call(limits.GetMaxDiopter, "the greatest power"))

    @classmethod
    def open(cls, port: str, channel: int = 0) -> Self:
        try:
            import optoICC  # type: ignore[import-not-found]
        except ImportError as error:
            raise DeviceNotFound(
                "lenses on an ICC need optoICC, which the maker gives away: install the wheels optoICC and "
                "optoKummenberg of Optotune's SDK with pip"
            ) from error

        def connect() -> Any:
            try:
                return optoICC.connect(port=port)
            except Exception as error:  # it raises errors of several packages
                raise DeviceNotFound(f"there is no ICC at {port} ({error}); check port, plug and power") from error

        return cls(connect, channel)

    def _call(self, act: Any, what: str, *arguments: Any) -> Any:
        try:
            return act(*arguments)
        except Exception as error:
            raise DeviceError(f"the ICC failed in {what} ({error}); check its plug and power") from error

    def _missing(self) -> bool:
        """Whether the channel reports no device."""
        return not self._call(self._board.MiscFeatures.GetDeviceType, "the type of its device", self._number)

    def set_power(self, diopters: float) -> None:
        if not self.least <= diopters <= self.greatest:
            raise BadInput(f"a focal power of {diopters:g} dpt; the lens has {self.least:g} to {self.greatest:g} dpt")
        self._call(self._channel.StaticInput.SetFocalPower, "a focal power", float(diopters))
        self._set = diopters

    def power(self) -> float:
        return _number(self._call(self._channel.StaticInput.GetFocalPower, "the focal power"))

    def temperature(self) -> float:
        found = self._call(self._channel.TemperatureManager.GetDeviceTemperature, "the temperature")
        if found is None:
            raise DeviceRefused("the lens has no temperature sensor; check that a lens is plugged in", "sensor")
        return _number(found)

    def status(self) -> tuple[str, ...]:
        return ("lens or sensor missing",) if self._missing() else ()

    def revive(self) -> None:
        """Connect again, and choose its input and its last power."""
        self.close()
        self._start()
        if self._set is not None:
            self.set_power(self._set)
        self.inspect()

    def close(self) -> None:
        """Release the controller; the lens keeps its last setting."""
        try:
            self._board.disconnect()
        except Exception as error:
            log.warning("closing the ICC: %s", error)
