"""The light of a calibration: steady, held as that of a print is, and on only while something is read."""

from __future__ import annotations

from typing import Self

from vamgpu.errors import BadInput
from vamgpu.hosts.calibrating.stand import Stand
from vamgpu.hosts.safety.lamp import ControllerLamp
from vamgpu.hosts.safety.lease import Lease
from vamgpu.hosts.safety.light import LightGuard

STEPS = 8
"""Signs of work in a lease."""


class HeldLight:
    """The light of one projector; entered dark, left dark whatever happens.

    Nothing moves while it shines: whoever moves a stage turns it off before. A wait here renews the lease, and a
    controller that has closed the light ends the calibration with `InterlockOpen`.
    """

    def __init__(self, stand: Stand, projector: int = 0) -> None:
        safety = stand.rig.safety
        self.clock, self.controller, self._power = stand.clock, stand.controller, stand.rig.light.power
        self.lease = Lease(stand.clock, self._renew, round(safety.lease * 1e9))
        lamp = ControllerLamp(stand.controller, (stand.channels[projector],), steady=True)
        self.guard = LightGuard(lamp, self.lease, tolerance=1.0, others={"mirrors": stand.screen(projector)})
        camera = stand.rig.camera
        if camera is not None and camera.exposure > 0.5 * safety.lease:
            raise BadInput(
                f"the camera exposes {1e3 * camera.exposure:g} ms, and a lease of the light is "
                f"{1e3 * safety.lease:g} ms; wanted half of it at most: expose shorter"
            )

    def _renew(self, length: int) -> None:
        self.controller.lease(length // 1_000_000)

    def __enter__(self) -> Self:
        self.guard.__enter__()
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.guard.__exit__(kind, error, trace)

    def on(self) -> None:
        """Make light."""
        self.lease.beat()
        self.lease.keep(force=True)
        self.guard.look(armed=True, motion=0.0, shown=0, scheduled=0, fault=None)
        self.guard.on(self._power)

    def off(self) -> None:
        """Make it dark."""
        self.guard.off("between readings")

    def wait(self, seconds: float) -> None:
        """Let time pass, and see that the light still may be on. Raises `InterlockOpen`."""
        end, step = self.clock.now() + round(seconds * 1e9), self.lease.length // STEPS
        self.alive()
        while (now := self.clock.now()) < end:
            self.clock.sleep_until(min(end, now + step))
            self.alive()

    def alive(self) -> None:
        """A sign of work. Raises `InterlockOpen` where the controller has closed the light."""
        if self.guard.lit:
            status = self.controller.status()
            if status.state == "fault":
                self.guard.look(fault=f"the controller closed the light: {status.fault}")
        self.lease.beat()
        self.guard.check()
        self.lease.keep()
