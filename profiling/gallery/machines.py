"""Prints on emulated machines: their timing, the dose in the resin, and the time until dark after a fault."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.errors import VamError
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.sources import MirrorArray, VialFrames
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import RunFolder
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.operators.projection import Projection
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = 1000
POWERS = (-0.6, 0.0, 0.6)
SECOND = 1_000_000_000


def machines(
    device: Device, quick: bool = False, speed: float = 0.8, angles: int = 120, settle: float = 6e-3
) -> Picture:
    """A web at ``speed`` [mm/s] through three foci, a lens that settles in ``settle`` [s], a vial of ``angles``."""
    angles = 40 if quick else angles
    roll = _Stand(
        web(60, advance=0.0785, speed=speed, engines=_mirrors(64, 24), lens=LensTiming(settle=settle), focus=POWERS),
        _frames(180, 64, 24), POWERS,
    )  # fmt: skip
    roll.run()
    figure, axes = style.sheet("aa;bc", 6.4, height_ratios=[1.15, 1])
    _timeline(axes["a"], roll)
    errors = _errors(axes["b"], device, angles)
    dark = _darkness(axes["c"], speed)
    facts = (
        Fact("frames per second of the web", roll.schedule.rate, "1/s", 4, 30.6, "3 planes at 48 mm/min"),
        Fact(
            "light while the lens moved", roll.emulated.recorder.astray, "s", 2, 0.0, "no light before it has settled"
        ),
        Fact("error of the vial's dose, divided by its greatest", errors["as planned"], "", 2, 1e-4, bound="≤"),
        Fact("the same, with every frame one slot late", errors["one slot late"], "", 2),
        Fact("longest light after a fault", max(dark.values()), "ms", 3, 250.0, "one lease", bound="≤"),
    )
    caption = (
        "The drivers of a print use their real protocols with emulated machines. Emulated resin integrates the bit "
        "planes, the lens as it settles, the true position and the lamp. Above, two angles of a web: after each frame "
        "the lens gets its command and settles, and only then the light goes on; the order of planes reverses at every "
        "angle. Below, the dose of a vial compared with the library's own simulation of the same frames, also with "
        "deliberate errors that the comparison must reveal; and how long the emulated lamp stays on after a fault."
    )
    return Picture(figure, caption, facts, papers=(ROLL_TO_ROLL,))


class _Stand:
    """A print on an emulated rig of its own."""

    def __init__(self, schedule: Schedule, frames: Frames, powers: tuple[float, ...] = (), shift: int = 0) -> None:
        _, rows, columns = frames.shape
        self.schedule, self.frames = schedule, frames
        self.emulated = EmulatedMirrorRig(STEPS, ArrayModel(height=rows, width=columns), powers=powers)
        source: Any = VialFrames(frames, MirrorArray(rows, columns, columns // 8))
        self.player = TriggeredPlayer(
            schedule, self.emulated.machines(STEPS / float(schedule.advance)), [_Shifted(source, shift)]
        )
        self._place = tempfile.TemporaryDirectory()
        self.print = Print(self.player, RunFolder.begin(Path(self._place.name) / "run", {}, ""))

    def run(self) -> None:
        self.print.run()
        self.print.folder.close()
        self._place.cleanup()


@dataclass
class _Shifted:
    """Frames that come some slots late."""

    own: Any
    late: int
    bits: int = 8

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        return self.own.planes((np.asarray(numbers) - self.late) % self.own.count)

    def frame(self, number: int) -> np.ndarray:
        return self.own.frame(number)


def _mirrors(columns: int, rows: int) -> MirrorTiming:
    return MirrorTiming(pixels=(columns, rows), row_bytes=columns // 8, dark=1e-3)


def _frames(count: int, columns: int, rows: int) -> Frames:
    images = np.random.default_rng(6).integers(0, 256, (count, rows, columns), dtype=np.uint8)
    return Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=columns)


def _timeline(axis: Axes, roll: _Stand) -> None:
    """Power of the lens and light of the middle two poses."""
    intervals = [(start, end) for start, end, lit, _ in roll.emulated.controller.intervals if lit]
    first = 3 * 28
    begin = intervals[first][0] - 12_000_000
    times = begin + np.arange(0, 215_000_000, 200_000)
    assert roll.emulated.lens is not None
    axis.plot(1e-6 * (times - begin), [roll.emulated.lens.power(int(at)) for at in times], color=style.INK, lw=1.2)
    for number, (start, end) in enumerate(intervals[first : first + 6]):
        color = style.HUES[int(roll.schedule.plane[first + number])]
        axis.axvspan(1e-6 * (start - begin), 1e-6 * (end - begin), color=color, alpha=0.3, lw=0)
        slot = first + number
        axis.text(0.5e-6 * (start + end - 2 * begin), 0.82, f"angle {slot // 3}", ha="center", color=color, fontsize=8)
    axis.set(title="A web through three foci: power of the lens, and light", xlabel="time [ms]", ylabel="power [dpt]",
             ylim=(-0.75, 1.0), xlim=(0, 215))  # fmt: skip


def _errors(axis: Axes, device: Device, angles: int) -> dict[str, float]:
    """Dose of a vial's resin, compared with the library's simulation."""
    A = Projection(Grid((32, 32, 8), 0.5), Beam((32, 8), 0.5), Turntable(angles), device=device)
    frames = _frames(angles, 32, 8)
    wanted = A.T(A.device.upload(frames.irradiance().numpy().astype(np.float32))).numpy()
    schedule = turned(angles, speed=40, engines=_mirrors(32, 8))
    found = {}
    for name, shift, way in (("as planned", 0, 1), ("one slot late", 1, 1), ("turned backwards", 0, -1)):
        stand = _Stand(schedule, frames, shift=shift)
        stand.run()
        seconds = stand.emulated.recorder.seconds(0, angles, turn=angles)[0][way * np.arange(angles)]
        light = seconds[:, ::-1].transpose(0, 2, 1) / (1e-9 * schedule.on[0])
        dose = A.T(A.device.upload(np.ascontiguousarray(light, np.float32))).numpy()
        found[name] = float(np.abs(dose - wanted).max() / wanted.max())
    _bars(axis, found, "dose error, of its greatest", "Dose in the resin of a vial", 1e-4)
    return found


def _darkness(axis: Axes, speed: float) -> dict[str, float]:
    """Duration of light after a fault [ms], on the emulated lamp."""

    def hang(stand: _Stand) -> None:
        stand.emulated.clock.sleep(SECOND)

    def stop(stand: _Stand) -> None:
        stand.emulated.controller.web.run(stand.emulated.clock.now(), 0.0)

    faults: dict[str, Any] = {
        "host hangs or is killed": hang,
        "web stops": stop,
        "trigger lost": lambda stand: setattr(stand.emulated, "lose_triggers", 1),
        "port unplugged": lambda stand: stand.emulated.port.unplug(),
        "door opened": lambda stand: stand.emulated.controller.open_interlock(stand.emulated.clock.now()),
        "emergency stop": lambda stand: stand.print.stop(),
    }
    found = {name: _lasting(fault, speed) for name, fault in faults.items()}
    _bars(axis, found, "light after the fault [ms]", "Until it is dark", 250.0)
    return found


def _lasting(fault: Any, speed: float) -> float:
    schedule = web(90, advance=0.0785, speed=speed, engines=_mirrors(16, 2))
    stand = _Stand(schedule, _frames(90, 16, 2))
    with stand.print.guard:
        stand.print.begin(0)
        while stand.print.next < 30:
            stand.player.wait()
            stand.print.step()
        at = stand.emulated.clock.now()
        try:
            fault(stand)
            while stand.print.step():
                stand.player.wait()
        except VamError:
            pass
    stand.emulated.clock.sleep(SECOND)
    last = max(end for _, end, lit, _ in stand.emulated.controller.intervals if lit)
    return max(0.0, 1e-6 * (last - at))


def _bars(axis: Axes, values: dict[str, float], label: str, title: str, limit: float) -> None:
    names = list(values)[::-1]
    floor = 1e-3 * limit
    axis.barh(names, [max(values[name], floor) for name in names], color=style.BLUE, height=0.55)
    for place, name in enumerate(names):
        if values[name] < floor:
            axis.text(1.15 * floor, place, "at once", va="center", color=style.QUIET)
    axis.axvline(limit, color=style.RED, lw=1.0, ls="--")
    axis.set(xscale="log", xlabel=label, title=title, xlim=(floor, None))
