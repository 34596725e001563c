"""The light's power: how strongly a channel of the controller, or a supply of its own, drives LED or laser."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.controller import Controller


@runtime_checkable
class Dimmer(Protocol):
    """Takes a drive, 0..1 of full."""

    def drive(self, fraction: float) -> None:
        """Set the drive."""
        ...


class ControllerChannel:
    """A channel of the controller, whose gate opens and closes with the lease."""

    def __init__(self, controller: Controller, channel: int) -> None:
        if not 0 <= channel < controller.channels:
            raise BadInput(f"the controller has channels 0..{controller.channels - 1}, not {channel}")
        self._controller, self.channel = controller, channel

    def drive(self, fraction: float) -> None:
        """Set the drive of full."""
        self._controller.power(self.channel, fraction)


@dataclass(frozen=True)
class PowerCurve:
    """Optical power [mW] measured at some drives, both rising; between them it is a straight line."""

    drives: tuple[float, ...] = (0.0, 1.0)
    powers_mw: tuple[float, ...] = (0.0, 1.0)

    def __post_init__(self) -> None:
        rising = all(
            later > earlier
            for values in (self.drives, self.powers_mw)
            for earlier, later in zip(values, values[1:], strict=False)
        )
        if len(self.drives) != len(self.powers_mw) or len(self.drives) < 2 or not rising:
            raise BadInput("a power curve is two or more drives with powers, both rising; measure it again")

    def drive(self, power_mw: float) -> float:
        """The drive that makes a power [mW]; BadInput where the lamp cannot."""
        if not self.powers_mw[0] <= power_mw <= self.powers_mw[-1]:
            raise BadInput(f"{power_mw} mW is outside the lamp's {self.powers_mw[0]}..{self.powers_mw[-1]} mW")
        i = min(bisect_right(self.powers_mw, power_mw), len(self.powers_mw) - 1)
        low, high = self.powers_mw[i - 1], self.powers_mw[i]
        share = (power_mw - low) / (high - low)
        return self.drives[i - 1] + share * (self.drives[i] - self.drives[i - 1])


class Lamp:
    """A dimmer with its measured curve."""

    def __init__(self, dimmer: Dimmer, curve: PowerCurve = PowerCurve()) -> None:
        self._dimmer, self.curve = dimmer, curve

    def set_power(self, power_mw: float) -> None:
        """Set the optical power the lamp has while it is on [mW]."""
        self._dimmer.drive(self.curve.drive(power_mw))
