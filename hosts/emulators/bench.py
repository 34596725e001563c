"""A whole emulated laboratory: every machine, wired as on a bench, on one virtual clock, before a chamber of resin."""

from __future__ import annotations

from collections.abc import Sequence

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import TunableLens
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.array import ArrayModel, Shown
from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.dmd import FakeAlp
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Cable, Faults
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.players.mirrors import Machines

LENS_BAUD = 38400


class Bench:
    """The machines behind the drivers.

    microsteps: of the motion, in a pose.  powers: of the focus planes [1/m].  clock: one that a program sets by
    default; a `PacedClock` goes with the machine's own.
    """

    def __init__(
        self, microsteps: float, model: ArrayModel = ArrayModel(), engines: int = 1, powers: Sequence[float] = (),
        clock: VirtualClock | None = None,
    ) -> None:  # fmt: skip
        self.clock, self.microsteps = clock or VirtualClock(), float(microsteps)
        self.controller = EmulatedController(channels=max(2, engines))
        self.alps = [FakeAlp(self.clock, model) for _ in range(engines)]
        self.lens = EmulatedLens(baud=LENS_BAUD) if len(powers) > 1 else None
        self.faults = Faults()
        self.lose_triggers = 0
        self.chamber = Chamber(
            lambda now: self.controller.web.position(now) / self.microsteps, (model.height, model.width), engines,
            None if self.lens is None else self.lens.power, powers or (0.0,),
        )  # fmt: skip
        self._wire()

    def _wire(self) -> None:
        self.controller.on_trigger = self._trigger
        self.controller.on_light = self.chamber.lamp
        for engine, alp in enumerate(self.alps):
            alp.on_shown = self._shower(engine)
        if self.lens is not None:
            cable = Cable(self.lens, LENS_BAUD)
            self.clock.attach(cable)
            self.controller.on_lens = cable.send

    def _shower(self, engine: int):  # noqa: ANN202
        def show(shown: Shown) -> None:
            self.chamber.shown(engine, shown)

        return show

    def _trigger(self, now: int) -> None:
        if self.lose_triggers:
            self.lose_triggers -= 1
            return
        for alp in self.alps:
            alp.trigger(now)

    def machines(self, microsteps_per_unit: float) -> Machines:
        """The drivers, opened as those of real machines are."""
        self.port = plug(self.controller, self.clock, 0.02, 0, self.faults)
        controller = Controller(Wire(self.port, "the controller"), microsteps_per_unit)
        lens = None
        if self.lens is not None:
            lens = TunableLens(Wire(plug(self.lens, self.clock, 0.25, LENS_BAUD), "the lens driver"))
            lens.focal_power_mode()
        mirrors = [Dmd(alp.library) for alp in self.alps]
        return Machines(self.clock, controller, mirrors, microsteps_per_unit, lens)
