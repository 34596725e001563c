"""Whole emulated rigs, each on one virtual clock before a chamber of resin: triggered mirrors, or a video projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.projector import ONE_GRAY, THREE_OF_7, TWO_OF_8, HdmiProjector
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.drivers.stepper import StepperStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Cable, Faults, VirtualPort, plug
from vamgpu.hosts.emulators.pulses import EmulatedStepper
from vamgpu.hosts.emulators.screen import EmulatedScreen, LitSlot
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.players.machines import MirrorMachines, StageMachines, VideoMachines

LENS_BAUD = 38400


class _TriggeredMirrors:
    """Mirrors of each engine before a chamber. ``lose_triggers``: so many do not reach them."""

    def __init__(self, clock: VirtualClock | None, model: ArrayModel, engines: int) -> None:
        self.clock: VirtualClock = clock or VirtualClock()
        self.alps: list[EmulatedAlp] = [EmulatedAlp(self.clock, model) for _ in range(engines)]
        self.lose_triggers: int = 0

    def _show_in(self, chamber: Chamber) -> None:
        for engine, alp in enumerate(self.alps):
            alp.on_shown = partial(chamber.shown, engine)

    def _trigger(self, now: int) -> None:
        if self.lose_triggers:
            self.lose_triggers -= 1
            return
        for alp in self.alps:
            alp.trigger(now)


class EmulatedMirrorRig(_TriggeredMirrors):
    """The machines behind the drivers.

    microsteps: of the motion, in a pose.  powers: of the focus planes [1/m].  clock: one that a program sets by
    default; a `PacedClock` goes with the machine's own.
    """

    def __init__(
        self, microsteps: float, model: ArrayModel = ArrayModel(), engines: int = 1, powers: Sequence[float] = (),
        clock: VirtualClock | None = None,
    ) -> None:  # fmt: skip
        super().__init__(clock, model, engines)
        self.microsteps: float = float(microsteps)
        self.controller: EmulatedController = EmulatedController(channels=max(2, engines))
        self.lens: EmulatedLens | None = EmulatedLens(baud=LENS_BAUD) if len(powers) > 1 else None
        self.faults: Faults = Faults()
        self.chamber: Chamber = Chamber(
            lambda now: self.controller.web.position(now) / self.microsteps, (model.height, model.width), engines,
            None if self.lens is None else self.lens.power, powers or (0.0,),
        )  # fmt: skip
        self._show_in(self.chamber)
        self.controller.on_trigger = self._trigger
        self.controller.on_light = self.chamber.lamp
        if self.lens is not None:
            cable = Cable(self.lens, LENS_BAUD)
            self.clock.attach(cable)
            self.controller.on_lens = cable.send

    def machines(self, microsteps_per_unit: float) -> MirrorMachines:
        """The drivers, opened as those of real machines are."""
        self.port: VirtualPort = plug(self.controller, self.clock, 0.02, 0, self.faults)
        controller = Controller(Wire(self.port, "the controller"), microsteps_per_unit)
        lens = None
        if self.lens is not None:
            lens = LensDriver(Wire(plug(self.lens, self.clock, 0.25, LENS_BAUD), "the lens driver"))
            lens.focal_power_mode()
        mirrors = [Dmd(alp.library) for alp in self.alps]
        return MirrorMachines(self.clock, controller, mirrors, microsteps_per_unit, lens)


MICROSTEPS = 1000.0  # of the stage in a degree
FINER = 100  # times as many in a millimeter


class EmulatedVideoRig:
    """The machines behind the drivers. images: a turn.  size: rows and columns of the projector.  bits: 8 or 7.

    latency: video frames from cable to light, in truth.  share: of each slot in which there is light.  scale: true
    degrees a degree of the stage; below 0 it turns the other way.  stepper: in place of the stage, with a clock that is
    so much quicker than the host's [ppm].  indexed: whether the stepper's turns are seen.  gated: whether a controller
    gates the light.  slots: 1 for a projector that shows all colors at once.  pose: of a web [mm], with its unit.
    """

    def __init__(
        self, images: int, size: tuple[int, int], *, bits: int = 8, latency: int = 1, share: float = 1.0,
        scale: float = 1.0, rate_hz: int = 60, clock: VirtualClock | None = None, stepper: float | None = None,
        indexed: bool = False, gated: bool = True, slots: int | None = None,
        pose: float | None = None, unit: str = "deg",
    ) -> None:  # fmt: skip
        self.clock: VirtualClock = clock or VirtualClock()
        self.stepper: EmulatedStepper | None = (
            None if stepper is None else EmulatedStepper(self.clock, 360.0 * MICROSTEPS, stepper)
        )
        self._indexed = indexed
        self.stage: EmulatedStage = EmulatedStage(rotary=True, acceleration=200_000.0, scale=scale)
        self.controller: EmulatedController = EmulatedController()
        self.gated = gated
        order = "G" if slots == 1 else "GR" if bits == 8 else "GRB"
        self.screen: EmulatedScreen = EmulatedScreen(self.clock, size, rate_hz, order, bits, latency, share)
        self.faults: Faults = Faults()
        self._unit, self._microsteps = unit, MICROSTEPS if unit == "deg" else FINER * MICROSTEPS
        self._pose = self._microsteps * (pose or 360.0 / images)
        true = self.stage.true_position if self.stepper is None else self.stepper.position
        self.chamber: Chamber = Chamber(lambda now: true(now) / self._pose, size, first=0.0)
        self.controller.on_light = self.chamber.lamp
        if not gated:
            self.chamber.lamp(1, self.clock.now())
        self.screen.on_slot = self._slot

    def _slot(self, slot: LitSlot) -> None:
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
        controller, stage = None, None
        if self.gated:
            self.port: VirtualPort = plug(self.controller, self.clock, 0.02, 0, self.faults)
            controller = Controller(Wire(self.port, "the controller"))
        if self.stepper is not None:
            index = self.stepper if self._indexed else None
            stage = StepperStage(self.stepper, self.clock, MICROSTEPS, index=index)
        else:
            self.stage_port: VirtualPort = plug(self.stage, self.clock, 0.02)
            wire = Wire(self.stage_port, "the stage")
            stage = ZaberStage(wire, self._microsteps, self._unit, pause=self._pause)
        layouts = {"G": ONE_GRAY, "GR": TWO_OF_8, "GRB": THREE_OF_7}
        projector = HdmiProjector(self.screen, layouts[self.screen.order], latency)
        return VideoMachines(self.clock, controller, stage, projector)


class EmulatedStageRig(_TriggeredMirrors):
    """Mirrors that a stage triggers, before a light that shines while the host's line is high.

    microsteps: of the motion, in a pose.  model: of the mirrors.  unit: of the stage.  lamp: whether the host has a
    line to the light; else it always shines, and mirrors at rest are the dark.
    """

    def __init__(
        self, microsteps: int, model: ArrayModel = ArrayModel(), engines: int = 1, unit: str = "deg",
        lamp: bool = True, controller: bool = False, clock: VirtualClock | None = None,
    ) -> None:  # fmt: skip
        super().__init__(clock, model, engines)
        self.microsteps = microsteps
        self.unit = unit
        self.stage: EmulatedStage = EmulatedStage(rotary=True, acceleration=200_000.0)
        self.controller: EmulatedController | None = (
            EmulatedController(channels=max(2, engines)) if controller else None
        )
        self.line: EmulatedLine | None = EmulatedLine(self._enabled) if lamp and not controller else None
        self.chamber: Chamber = Chamber(
            lambda now: self.stage.true_position(now) / self.microsteps, (model.height, model.width), engines,
            first=0.0,
        )  # fmt: skip
        self._channels = (1 << engines) - 1
        self._show_in(self.chamber)
        self.stage.on_trigger = self._trigger
        if self.controller is not None:
            self.controller.on_light = self.chamber.lamp
        elif self.line is None:
            self._enabled(True)

    def _enabled(self, high: bool) -> None:
        self.chamber.lamp(self._channels if high else 0, self.clock.now())

    def turn(self, speed: float) -> None:
        """Something other than the host drives the stage [poses/s]."""
        self.stage.track.run(self.clock.now(), speed * self.microsteps)

    def machines(self, microsteps_per_unit: float) -> StageMachines:
        """The drivers, opened as those of real machines are."""
        self.stage_port: VirtualPort = plug(self.stage, self.clock, 0.02)
        wire = Wire(self.stage_port, "the stage")
        pause = lambda seconds: self.clock.sleep(round(seconds * 1e9))  # noqa: E731
        stage = ZaberStage(wire, microsteps_per_unit, self.unit, pause=pause)
        controller = None
        if self.controller is not None:
            self.port: VirtualPort = plug(self.controller, self.clock, 0.02)
            controller = Controller(Wire(self.port, "the controller"))
        lamp = None if self.line is None else TtlLamp(self.line)
        mirrors = [Dmd(alp.library) for alp in self.alps]
        return StageMachines(self.clock, stage, mirrors, microsteps_per_unit, controller, lamp)


class EmulatedLine:
    """A serial port of which only the control lines matter. hears: whether RTS is high."""

    unplugged: bool

    def __init__(self, hears: Callable[[bool], None]) -> None:
        self._hears, self._rts, self.unplugged = hears, False, False
        self.dtr = False

    @property
    def rts(self) -> bool:
        """The line."""
        return self._rts

    @rts.setter
    def rts(self, high: bool) -> None:
        if self.unplugged:
            raise OSError("device disconnected")
        if high != self._rts:
            self._rts = high
            self._hears(high)

    def close(self) -> None:
        """Low."""
        if not self.unplugged:
            self.rts = False
