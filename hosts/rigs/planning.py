"""Jobs on a rig, before any machine is touched: which pictures when, on which mirrors, through which focus."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.hosts.exposure import Stop
from vamgpu.hosts.pictures.stream import Mirrors, Pictures
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.motor import steppable
from vamgpu.hosts.rigs.works import Kind, Work, work
from vamgpu.hosts.schedules.angles import closest, rising
from vamgpu.hosts.schedules.limits import HdmiTiming, LensTiming, MirrorTiming
from vamgpu.hosts.schedules.moving import sla, turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import DAY, SECOND, every, whole
from vamgpu.hosts.schedules.video import vial
from vamgpu.optics.lens import TunableLens
from vamgpu.quantity import parse

GUARD = 0.02
"""Share of a pose that stays dark at its end, so that no light falls into the next."""
BLOCK = 64
"""Columns that a device packs together: emulated mirrors are as wide as whole blocks."""
HOUR = 3600.0
UNITS: dict[Kind, str] = {"vial": "deg/s", "web": "mm/s", "slices": "mm/h"}
"""Of a speed that is a plain number."""
USUAL = 40.0
"""Speed of a vial [deg/s] unless told otherwise."""
SLOTS = 10**7
"""Most pictures of a print; more are a slip of the pen."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Works on a rig, one for each projector. focus: powers of the lens [dpt], one for each plane.  display: of a video
    cable; None for mirrors behind a trigger.  rehearsed: whether the machines are to be emulated.
    stop: by what the resin scatters, see `vamgpu.hosts.rigs.stopping`."""

    works: tuple[Work, ...]
    schedule: Schedule
    mirrors: tuple[Mirrors, ...]
    rig: RigConfig
    focus: tuple[float, ...] = ()
    display: HdmiTiming | None = None
    rehearsed: bool = False
    stop: Stop | None = None

    @property
    def kind(self) -> Kind:
        """How it moves."""
        return self.works[0].kind

    @property
    def bits(self) -> int:
        """Of the pictures."""
        return self.works[0].bits

    @property
    def timings(self) -> tuple[MirrorTiming, ...]:
        """The mirrors as a preflight judges them."""
        return tuple(
            MirrorTiming(pixels=(each.columns, each.rows), row_bytes=each.row_bytes) for each in self.mirrors
        )

    def pictures(self) -> tuple[Pictures, ...]:
        """Of each projector."""
        return tuple(each.pictures(mirrors) for each, mirrors in zip(self.works, self.mirrors, strict=True))

    def lines(self) -> tuple[tuple[str, str], ...]:
        """What is told before a print."""
        table, shape = self.schedule, self.works[0].shape
        planes = len(self.works[0].depths)
        focus = ", ".join(f"{power:.3f}" for power in self.focus) + " dpt"
        unit, speed = UNITS[self.kind], float(table.speed) * (HOUR if self.kind == "slices" else 1.0)
        rows = (
            ("pictures", f"{len(table)} of {shape[0]} × {shape[1]}, {self.bits} bits, {table.frames} different"),
            ("projectors", f"{len(self.works)} in step" if len(self.works) > 1 else ""),
            ("focus planes", f"{planes} at {focus}" if self.focus else ""),
            ("duration", f"{table.duration * 1e-9:.2f} s at {speed:.4g} {unit}"),
            ("rate", f"{table.rate:.4g} pictures/s, lit {100 * table.duty:.1f} % of the time"),
            ("light a picture", f"{int(table.on[0]) * 1e-6:.3f} ms"),
            ("memory", f"{self.bits * len(table)} bit planes in all" if self.display is None else ""),
            ("lease", f"{1e3 * self.rig.wanted.safety.lease:.0f} ms"),
            ("stop", "" if self.stop is None else f"at scatter density {self.stop.threshold:g}, or after its turns"),
        )
        return tuple(row for row in rows if row[1])


def plan(
    jobs: str | Path | Sequence[str | Path], rig: RigConfig, *, speed: float | Fraction | str | None = None,
    turns: int = 1, rehearsed: bool = False, device: str | Device | None = None,
) -> Plan:  # fmt: skip
    """Jobs on a rig, one for each projector.

    jobs: folders, all of vials, of webs or of slices.  speed: [deg/s] of vials, [mm/s] of webs, [mm/h] of slices, or
    with its unit; by default 40 deg/s, or what the job was made for.  turns: of a vial.  rehearsed: on emulated
    machines that are as large as the job, whatever the rig.  device: that makes pictures; by default the best one, and
    NumPy for a rehearsal. Raises `StorageError`, `SliceError`, `BadInput`, `WrongDevice`, and `TimingInfeasible` with
    what binds.
    """
    if not isinstance(rig, RigConfig):
        raise BadInput(f"rig is {rig!r}; wanted what read_rig gives, for instance read_rig(\"lab.toml\")")
    rehearsed = rehearsed or rig.wanted.emulated
    paths = (jobs,) if isinstance(jobs, (str, Path)) else every("jobs", jobs)
    if wrong := [path for path in paths if not isinstance(path, (str, Path))]:
        raise BadInput(f"a job is {wrong[0]!r}; wanted the path of its folder")
    works = tuple(work(path, device or ("numpy" if rehearsed else None)) for path in paths)
    if whole("turns", turns) * works[0].poses > SLOTS:
        raise BadInput(f"{turns} turns of {works[0].poses} pictures; wanted {SLOTS} pictures at most: take fewer turns")
    _alike(works, rig)
    going = _speed(works[0], speed)
    focus = _focus(works[0], rig)
    if rig.wanted.video:
        return _on_a_cable(works[0], rig, going, turns, rehearsed)
    mirrors = _mirrors(works, rig, rehearsed)
    schedule = _schedule(works[0], rig, going, turns, mirrors, focus)
    if not rehearsed:
        steppable(schedule, rig.wanted.controller.microsteps)
    return Plan(works, schedule, mirrors, rig, focus, rehearsed=rehearsed)


def _alike(works: tuple[Work, ...], rig: RigConfig) -> None:
    """Raise `BadInput` for works that the rig cannot print, or not together."""
    wanted = rig.wanted
    if not works:
        raise BadInput("no job was given; wanted a folder for each projector")
    if len(works) != len(wanted.projector) and not wanted.emulated:
        raise BadInput(
            f"got {len(works)} jobs for the {len(wanted.projector)} projectors of the rig {wanted.rig.name!r}; wanted "
            "one for each, in their order"
        )
    for each in works:
        if wanted.rig.machine not in ("any", each.kind):
            raise BadInput(
                f"the rig {wanted.rig.name!r} prints {_named(wanted.rig.machine)}, {each.path!r} is for "
                f"{_named(each.kind)}; choose another rig, or check the path"
            )
    first = works[0]
    for other in works[1:]:
        for what, one, two in (
            ("kind", first.kind, other.kind), ("number of poses", first.poses, other.poses),
            ("angles", first.motion, other.motion),
            ("bits", first.bits, other.bits), ("way from pose to pose [mm]", first.advance, other.advance),
            ("focus planes [mm]", first.depths, other.depths), ("speed [mm/s]", first.speed, other.speed),
        ):  # fmt: skip
            if one != two:
                raise BadInput(
                    f"jobs that are printed together share their {what}; {first.path!r} has {one}, {other.path!r} has "
                    f"{two}: solve them alike"
                )


def _named(kind: str) -> str:
    return {"vial": "vials", "web": "webs"}.get(kind, kind)


def _speed(first: Work, speed: float | Fraction | str | None) -> float:
    """In deg/s or mm/s."""
    unit = UNITS[first.kind]
    if speed is None:
        going = USUAL if first.kind == "vial" else first.speed
        if going is None:
            raise BadInput(f"{first.path!r} does not say how fast it moves; give its speed [{unit}]")
        return going
    if isinstance(speed, Fraction):
        speed = float(speed)
    if isinstance(speed, str) and first.kind != "vial" and not _number(speed):
        try:
            return parse(speed, "a speed")
        except ValueError as error:
            raise BadInput(f"speed {speed!r}: {error}, or a plain number of {unit}") from error
    text = str(speed).removesuffix("deg/s").strip()
    if not _number(text):
        raise BadInput(f"speed is {speed!r}; wanted a number of {unit} > 0")
    return float(text) / (HOUR if first.kind == "slices" else 1.0)


def _number(text: str) -> bool:
    try:
        return bool(0 < float(text) < np.inf)
    except ValueError:
        return False


def _focus(first: Work, rig: RigConfig) -> tuple[float, ...]:
    """Powers of the lens [dpt] that focus on a work's planes."""
    lens = rig.wanted.lens
    if not first.depths or (lens is None and len(first.depths) == 1):
        return ()
    if lens is None:
        raise BadInput(
            f"{first.path!r} changes its focus among {len(first.depths)} planes, and the rig {rig.wanted.rig.name!r} "
            "has no lens; add a table [lens], or solve the job with lens.bins = 1"
        )
    slope = lens.slope or TunableLens(focal=lens.focal, index=first.bath).slope
    powers = tuple(round(lens.axis + depth / slope, 6) for depth in first.depths)
    if not lens.lowest <= min(powers) <= max(powers) <= lens.highest:
        raise BadInput(
            f"the focus planes of {first.path!r} want powers from {min(powers):.4g} to {max(powers):.4g} dpt; the lens "
            f"has {lens.lowest:g} to {lens.highest:g} dpt: check axis, slope, lowest and highest in [lens]"
        )
    return powers


def _mirrors(works: tuple[Work, ...], rig: RigConfig, rehearsed: bool) -> tuple[Mirrors, ...]:
    """The arrays that pictures are for; emulated ones are as large as the largest of them."""
    if rehearsed:
        rows = max(each.shape[0] for each in works)
        columns = BLOCK * max(-(-each.shape[1] // BLOCK) for each in works)
        found = [Mirrors(rows, columns, _row_bytes(columns))] * len(works)
    else:
        sizes = (section.array for section in rig.wanted.projector)
        found = [Mirrors(rows, columns, _row_bytes(columns)) for rows, columns in sizes]
    for each, mirrors in zip(works, found, strict=True):
        mirrors.place(*each.shape)
    return tuple(found)


def _row_bytes(columns: int) -> int:
    """Of a packed row in the mirrors' memory."""
    return 256 if columns == 1920 else -(-columns // 8)


def _schedule(
    first: Work, rig: RigConfig, speed: float, turns: int, mirrors: tuple[Mirrors, ...], focus: tuple[float, ...]
) -> Schedule:
    wanted, planes = rig.wanted, max(len(first.depths), 1)
    pose = (_nearest(first) if first.advance is None else first.advance) / speed
    if pose * SECOND > DAY:
        raise BadInput(f"at that speed a picture lasts {pose:.3g} s; wanted a day at most: move faster")
    sections = wanted.projector * len(mirrors) if wanted.emulated else wanted.projector
    engines = tuple(
        MirrorTiming(
            picture={8: section.picture, 1: 1e-4}, pixels=(each.columns, each.rows), row_bytes=each.row_bytes,
            dark=round(GUARD * pose / planes, 6),
        )
        for each, section in zip(mirrors, sections[: len(mirrors)], strict=True)
    )  # fmt: skip
    common: dict[str, Any] = {"speed": speed, "engines": engines, "bits": first.bits, "power": wanted.light.power}
    if first.advance is None:
        return turned(first.turn, turns=turns, **common)
    if turns != 1:
        raise BadInput(f"turns is {turns}; wanted 1, as only vials come round again")
    if first.kind == "slices":
        return sla(first.poses, pitch=first.advance, **common)
    lens = wanted.lens
    timing = None if lens is None or not focus else LensTiming(lens.settle, baud=lens.baud, latency=lens.latency)
    return web(first.poses, advance=first.advance, lens=timing, focus=focus, **common)


def _nearest(first: Work) -> float:
    """Degrees between the nearest two poses of a vial."""
    motion = first.motion
    return 360.0 / first.poses if motion is None or motion.is_even else float(closest(rising(motion)))


def _on_a_cable(first: Work, rig: RigConfig, speed: float, turns: int, rehearsed: bool) -> Plan:
    """A vial before a video projector."""
    section = rig.wanted.projector[0]
    rows, columns = first.shape if rehearsed else section.array
    screen = Mirrors(rows, columns, columns)
    screen.place(*first.shape)
    display = HdmiTiming(
        refresh=section.refresh, bits=section.bits, latency=section.latency, pixels=(columns, rows),
    )  # fmt: skip
    schedule = vial(first.turn, speed=speed, display=display, turns=turns, power=rig.wanted.light.power)
    return Plan((first,), schedule, (screen,), rig, display=display, rehearsed=rehearsed)
