"""An emulated vial before a video projector: every machine on one virtual clock, before resin that sees what was lit.

The resin knows the lamp, the slots that the screen lit and the stage's true angle; pose 0 is at the stage's zero.
"""

from __future__ import annotations

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.projector import HdmiProjector
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.drivers.zaber import ZaberStage
from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import Faults
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.emulators.screen import EmulatedScreen, Slot
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.players.cable import VideoMachines
from vamgpu.hosts.protocols.slots import THREE_OF_7, TWO_OF_8

MICROSTEPS = 1000.0
"""Of the stage in a degree."""


class Booth:
    """The machines behind the drivers. images: a turn.  size: rows and columns of the projector.  bits: 8 or 7.

    latency: video frames from cable to light, in truth.  share: of each slot in which there is light.  scale: true
    degrees a degree of the stage; below 0 it turns the other way.
    """

    def __init__(
        self, images: int, size: tuple[int, int], *, bits: int = 8, latency: int = 1, share: float = 1.0,
        scale: float = 1.0, rate_hz: int = 60, clock: VirtualClock | None = None,
    ) -> None:  # fmt: skip
        self.clock = clock or VirtualClock()
        self.stage = EmulatedStage(rotary=True, acceleration=200_000.0, scale=scale)
        self.controller = EmulatedController()
        self.screen = EmulatedScreen(self.clock, size, rate_hz, "GR" if bits == 8 else "GRB", bits, latency, share)
        self.faults = Faults()
        self._pose = MICROSTEPS * 360.0 / images
        self.chamber = Chamber(lambda now: self.stage.true_position(now) / self._pose, size, first=0.0)
        self.controller.on_light = self.chamber.lamp
        self.screen.on_slot = self._slot

    def _slot(self, slot: Slot) -> None:
        if slot.levels.any():
            self.chamber.lit(0, slot.levels / slot.top, slot.start, slot.end)

    def _pause(self, seconds: float) -> None:
        self.clock.sleep(round(seconds * 1e9))

    def slip(self, degrees: float) -> None:
        """The vial's coupling gives: from now on the stage is elsewhere, and says so."""
        now = self.clock.now()
        self.stage.track.set_position(now, self.stage.track.position(now) + degrees * MICROSTEPS)

    def turn(self, degrees_per_s: float) -> None:
        """Something other than the host drives the stage."""
        self.stage.track.run(self.clock.now(), degrees_per_s * MICROSTEPS)

    def machines(self, latency: int = 1) -> VideoMachines:
        """The drivers, opened as those of real machines are. latency: video frames from cable to light, as told."""
        self.port = plug(self.controller, self.clock, 0.02, 0, self.faults)
        self.stage_port = plug(self.stage, self.clock, 0.02)
        controller = Controller(Wire(self.port, "the controller"))
        stage = ZaberStage(Wire(self.stage_port, "the stage"), MICROSTEPS, pause=self._pause)
        projector = HdmiProjector(self.screen, TWO_OF_8 if self.screen.bits == 8 else THREE_OF_7, latency)
        return VideoMachines(self.clock, controller, stage, projector)
