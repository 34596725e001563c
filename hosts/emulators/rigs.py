"""Whole emulated rigs on one virtual clock, with a recorder of the dose: triggered mirrors, or a video projector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lamp import TtlLamp
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.projector import THREE_OF_7, TWO_OF_8, HdmiProjector, SlotLayout
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.drivers.stepper import StepperStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.dose import DoseRecorder
from vamgpu.hosts.emulators.lens import EmulatedLens, LensInput
from vamgpu.hosts.emulators.line import Cable, Faults, VirtualPort
from vamgpu.hosts.emulators.screen import EmulatedScreen, LitSlot
from vamgpu.hosts.emulators.stage import EmulatedStage, EmulatedStepper
from vamgpu.hosts.player.machines import MirrorMachines, StageMachines, VideoMachines

LENS_BAUD = 38400
MICROSTEPS = 1000.0  # microsteps of the video rig's stage per degree
UNBOUND = 10**12  # limits of a stage without ends [microsteps]
LIFT = 10_000.0  # microsteps of a lift per millimeter
FINER = 100  # microsteps per millimeter / microsteps per degree


class _EmulatedRig:
    """A clock, the recorder of the dose, and machines on separate ports."""

    clock: VirtualClock
    recorder: DoseRecorder
    controller: EmulatedController | None
    stage: EmulatedStage
    lift: EmulatedStage

    def _plug_controller(self, microsteps_per_unit: float = 1.0, faults: Faults | None = None) -> Controller | None:
        if self.controller is None:
            return None
        self.port: VirtualPort = VirtualPort(self.controller, self.clock, 0.02, 0, faults)
        return Controller(Wire(self.port, "the controller"), microsteps_per_unit)

    def _plug_stage(self, microsteps: float, unit: str) -> ZaberStage:
        self.stage_port: VirtualPort = VirtualPort(self.stage, self.clock, 0.02)
        outputs = {"output": self.stage.wired, "gate": self.stage.joined}
        return ZaberStage(Wire(self.stage_port, "the stage"), microsteps, unit, pause=self._pause, **outputs)

    def _pause(self, seconds: float) -> None:
        self.clock.sleep(round(seconds * 1e9))

    def plug_lift(self) -> ZaberStage:
        """Add a stage that raises the vial, and open it."""
        self.lift = EmulatedStage(UNBOUND, rotary=True, acceleration=200_000.0)
        return ZaberStage(Wire(VirtualPort(self.lift, self.clock, 0.02), "the lift"), LIFT, "mm", pause=self._pause)


class _TriggeredRig(_EmulatedRig):
    """Mirrors of each engine, connected to the recorder. ``lose_triggers``: number of lost triggers."""

    def __init__(self, clock: VirtualClock | None, model: ArrayModel, engines: int) -> None:
        self.clock: VirtualClock = clock or VirtualClock()
        self.alps: list[EmulatedAlp] = [EmulatedAlp(self.clock, model) for _ in range(engines)]
        self.lose_triggers: int = 0
        self._size = (model.height, model.width)

    def _record(self, recorder: DoseRecorder) -> None:
        self.recorder: DoseRecorder = recorder
        for engine, alp in enumerate(self.alps):
            alp.on_shown = partial(recorder.shown, engine)

    def _trigger(self, now: int) -> None:
        if self.lose_triggers:
            self.lose_triggers -= 1
            return
        for alp in self.alps:
            alp.trigger(now)

    def _mirrors(self) -> list[Dmd]:
        return [Dmd(alp.library) for alp in self.alps]


class EmulatedMirrorRig(_TriggeredRig):
    """Mirrors that the controller triggers, every few microsteps, and a lens with focus planes [1/m]."""

    controller: EmulatedController

    def __init__(
        self, microsteps: float, model: ArrayModel = ArrayModel(), engines: int = 1, powers: Sequence[float] = (),
        clock: VirtualClock | None = None,
    ) -> None:  # fmt: skip
        super().__init__(clock, model, engines)
        self.microsteps: float = float(microsteps)
        self.controller = EmulatedController(channels=max(2, engines))
        self.lens: EmulatedLens | None = EmulatedLens(baud=LENS_BAUD) if len(powers) > 1 else None
        self.faults: Faults = Faults()
        self._record(DoseRecorder(
            lambda now: self.controller.web.position(now) / self.microsteps, self._size, engines,
            None if self.lens is None else self.lens.power, powers or (0.0,), drive=self.controller.drive,
        ))  # fmt: skip
        self.controller.on_trigger = self._trigger
        self.controller.on_light = self.recorder.lamp
        if self.lens is not None:
            cable = Cable(LensInput(self.lens), LENS_BAUD)
            self.clock.attach(cable)
            self.controller.on_lens = cable.send

    def machines(self, microsteps_per_unit: float) -> MirrorMachines:
        """The drivers, opened like those of real machines."""
        controller = self._plug_controller(microsteps_per_unit, self.faults)
        assert controller is not None
        lens = None
        if self.lens is not None:
            lens = LensDriver(Wire(VirtualPort(self.lens, self.clock, 0.25, LENS_BAUD), "the lens driver"))
            lens.focal_power_mode()
        return MirrorMachines(self.clock, controller, self._mirrors(), microsteps_per_unit, lens)


class EmulatedStageRig(_TriggeredRig):
    """Mirrors that a stage triggers, with a light that a controller or a line gates, or that is always on."""

    def __init__(
        self, microsteps: int, model: ArrayModel = ArrayModel(), engines: int = 1, unit: str = "deg",
        lamp: bool = True, controller: bool = False, clock: VirtualClock | None = None, power: float = 1.0,
        outputs: tuple[int, int | None] = (1, None),
    ) -> None:  # fmt: skip
        super().__init__(clock, model, engines)
        self.microsteps = microsteps
        self.unit = unit
        self.stage: EmulatedStage = EmulatedStage(
            UNBOUND, rotary=True, acceleration=200_000.0, wired=outputs[0], joined=outputs[1]
        )
        self.controller: EmulatedController | None = (
            EmulatedController(channels=max(2, engines)) if controller else None
        )
        self.line: EmulatedLine | None = EmulatedLine(self._enabled) if lamp and not controller else None
        self._record(DoseRecorder(
            lambda now: self.stage.true_position(now) / self.microsteps, self._size, engines,
            first=0.0, drive=(lambda engine: power) if self.controller is None else self.controller.drive,
        ))  # fmt: skip
        self.stage.on_trigger = self._trigger
        if self.controller is not None:
            self.controller.on_light = self.recorder.lamp
        elif self.line is None:
            self._enabled(True)

    def _enabled(self, high: bool) -> None:
        self.recorder.lamp((1 << len(self.alps)) - 1 if high else 0, self.clock.now())

    def turn(self, speed: float) -> None:
        """Something other than the host drives the stage [angles/s]."""
        self.stage.track.run(self.clock.now(), speed * self.microsteps)

    def machines(self, microsteps_per_unit: float) -> StageMachines:
        """The drivers, opened like those of real machines."""
        if self.unit == "deg" and not self.stage.settings["limit.cycle.dist"]:
            self.stage.settings["limit.cycle.dist"] = round(360 * microsteps_per_unit)
        stage, controller = self._plug_stage(microsteps_per_unit, self.unit), self._plug_controller()
        lamp = None if self.line is None else TtlLamp(self.line)
        return StageMachines(self.clock, stage, self._mirrors(), microsteps_per_unit, controller, lamp)


class EmulatedVideoRig(_EmulatedRig):
    """A video projector with a stage, or a stepper whose clock is faster by a rate [ppm]."""

    def __init__(
        self, images: int, size: tuple[int, int], *, bits: int = 8, latency: int = 1, share: float = 1.0,
        scale: float = 1.0, rate_hz: int = 60, clock: VirtualClock | None = None, stepper: float | None = None,
        indexed: bool = False, gated: bool = True, layout: SlotLayout | None = None,
        pose: float | None = None, unit: str = "deg", power: float = 1.0,
    ) -> None:  # fmt: skip
        self.clock: VirtualClock = clock or VirtualClock()
        self.stepper: EmulatedStepper | None = (
            None if stepper is None else EmulatedStepper(self.clock, 360.0 * MICROSTEPS, stepper)
        )
        self.gated = gated
        self._indexed = indexed
        self.stage: EmulatedStage = EmulatedStage(UNBOUND, rotary=True, acceleration=200_000.0, scale=scale)
        self.stage.settings["limit.cycle.dist"] = round(360 * MICROSTEPS) if unit == "deg" else 0
        self.controller: EmulatedController = EmulatedController()
        self._layout = layout or (TWO_OF_8 if bits == 8 else THREE_OF_7)
        order = "".join("RGB"[channel] for channel in self._layout.channels)
        self.screen: EmulatedScreen = EmulatedScreen(self.clock, size, rate_hz, order, bits, latency, share)
        self.faults: Faults = Faults()
        self._unit, self._microsteps = unit, MICROSTEPS if unit == "deg" else FINER * MICROSTEPS
        self._pose = self._microsteps * (pose or 360.0 / images)
        true = self.stage.true_position if self.stepper is None else self.stepper.position
        drive = self.controller.drive if gated else lambda engine: power
        self.recorder: DoseRecorder = DoseRecorder(lambda now: true(now) / self._pose, size, first=0.0, drive=drive)
        self.controller.on_light = self.recorder.lamp
        if not gated:
            self.recorder.lamp(1, self.clock.now())
        self.screen.on_slot = self._slot

    def _slot(self, slot: LitSlot) -> None:
        if slot.levels.any():
            self.recorder.lit(0, slot.levels / slot.top, slot.start, slot.end)

    def slip(self, degrees: float) -> None:
        """The vial's coupling slips: from now on the stage is elsewhere, and reports it."""
        now = self.clock.now()
        self.stage.track.set_position(now, self.stage.track.position(now) + degrees * MICROSTEPS)

    def turn(self, degrees_per_s: float) -> None:
        """Something other than the host drives the stage."""
        self.stage.track.run(self.clock.now(), degrees_per_s * MICROSTEPS)

    def machines(self, latency: int = 1) -> VideoMachines:
        """The drivers, opened like those of real machines, with a latency from cable to light [video frames]."""
        controller = self._plug_controller(faults=self.faults) if self.gated else None
        if self.stepper is not None:
            index = self.stepper if self._indexed else None
            stage = StepperStage(self.stepper, self.clock, MICROSTEPS, index=index)
        else:
            stage = self._plug_stage(self._microsteps, self._unit)
        projector = HdmiProjector(self.screen, self._layout, latency)
        return VideoMachines(self.clock, controller, stage, projector)


class EmulatedLine:
    """A serial port with only control lines. on_change: called with whether RTS is high."""

    def __init__(self, on_change: Callable[[bool], None]) -> None:
        self.unplugged: bool = False
        self._on_change, self._rts = on_change, False
        self.dtr = False

    @property
    def rts(self) -> bool:
        return self._rts

    @rts.setter
    def rts(self, high: bool) -> None:
        if self.unplugged:
            raise OSError("device disconnected")
        if high != self._rts:
            self._rts = high
            self._on_change(high)

    def close(self) -> None:
        if not self.unplugged:
            self.rts = False
