"""Lamps: what the one holder of the light switches."""

from __future__ import annotations

from collections.abc import Sequence

from vamgpu.errors import DeviceError, ProtocolError
from vamgpu.hosts.drivers.controller import Controller


class ControllerLamp:
    """The light behind a controller's gate. ``on`` allows it; with ``steady`` it shines at once, else row by row.

    shares: of the power, for each channel.
    """

    def __init__(
        self, controller: Controller, channels: Sequence[int] = (0,), steady: bool = False,
        shares: Sequence[float] | None = None,
    ) -> None:  # fmt: skip
        self._controller, self._channels, self._steady = controller, tuple(channels), steady
        self._shares = (1.0,) * len(channels) if shares is None else tuple(shares)

    def on(self, power: float) -> None:
        """Drive the channels at a share of full, and allow the light."""
        for channel, share in zip(self._channels, self._shares, strict=True):
            self._controller.power(channel, power * share)
        self._controller.arm()
        if self._steady:
            self._controller.light(sum(1 << channel for channel in self._channels))

    def off(self) -> None:
        """Light off and not allowed; where that fails, everything stops."""
        try:
            self._controller.disarm()
        except (DeviceError, ProtocolError):
            self._controller.stop()


class Renewal:
    """Renews a controller's lease of a length [ns]."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def __call__(self, length: int) -> None:
        self._controller.lease(length // 1_000_000)
