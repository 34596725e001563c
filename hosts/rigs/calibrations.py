"""The calibrations of a rig: folders beside the rig's file, of which the newest of each kind is applied."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.calibration.runout import Runout
from vamgpu.errors import BadInput, JobError
from vamgpu.geometry import Turntable
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.hosts.rigs.guarantees import driver_of
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import repack
from vamgpu.storage.numpy_files import read_npz
from vamgpu.storage.reading import load_toml, malformed

KINDS = ("gray", "flat", "axis", "focus", "mtf", "runout", "turn", "live")
OWN_STEPS = ("zaber", "grbl")  # motions whose device states its microsteps
SURE = 4.0  # standard errors by which a turn must differ before the motion is corrected
SUFFIX = ".calibration"  # name of the folder beside the rig's file
STAMP = "%Y-%m-%dT%H%M%S"
NAME = re.compile(rf"({'|'.join(KINDS)})-(\d{{4}}-\d\d-\d\dT\d{{6}})(?:-\d+)?")
DAY = 86400.0
MEASURED = "measured"  # table of a result with its numbers
NONE = "none"  # in [calibration]: do not apply this kind


def read(folder: str | Path, kind: str | None = None) -> dict[str, Any]:
    """The tables of a result. Raises `StorageError` if it cannot be read, `BadInput` for another kind."""
    file = Path(folder) / "result.toml" if Path(folder).is_dir() else Path(folder)
    data = load_toml(file, "the calibration")
    if "calibration" not in data or (kind is not None and data["calibration"] != kind):
        raise BadInput(
            f"{str(file)!r} holds {data.get('calibration', 'no calibration')}; expected one of {kind or 'any'}"
        )
    return data


@dataclass(frozen=True)
class Calibration:
    """One measurement of a rig. kind: one of `KINDS`.  taken: local time.  path: its folder."""

    kind: str
    taken: datetime
    path: Path

    @property
    def name(self) -> str:
        """Name of its folder, which a rig's file may choose."""
        return self.path.name

    def days(self, now: datetime | None = None) -> float:
        """Age [days]."""
        return ((now or datetime.now()) - self.taken).total_seconds() / DAY

    def tables(self) -> dict[str, Any]:
        """Its results. Raises `StorageError`, `BadInput` if its file is damaged."""
        return read(self.path, self.kind)


def folder_of(rig: RigConfig) -> Path | None:
    """Folder of a rig's calibrations; None for a rig without a file."""
    return Path(rig.source).with_suffix(SUFFIX) if Path(rig.source).suffix == ".toml" else None


def place_of(rig: RigConfig) -> Path:
    """Folder of a rig's calibrations. Raises `BadInput` for a rig without a file."""
    if (place := folder_of(rig)) is None:
        raise BadInput(
            f"the rig {rig.source!r} is not a file ending in .toml and therefore has no folder of calibrations; give "
            "such a file, or --out for a separate result"
        )
    return place


def taken_of(rig: RigConfig) -> tuple[Calibration, ...]:
    """All calibrations of a rig, the newest first; other names in their folder are ignored."""
    place = folder_of(rig)
    if place is None or not place.is_dir():
        return ()
    found = [
        Calibration(match[1], datetime.strptime(match[2], STAMP), entry)
        for entry in place.iterdir()
        if (match := NAME.fullmatch(entry.name)) and (entry / "result.toml").is_file()
    ]
    return tuple(sorted(found, key=lambda each: (each.taken, each.name), reverse=True))


def in_force(rig: RigConfig) -> dict[str, Calibration]:
    """Kind → the applied calibration: the newest, or the one that ``[calibration]`` names."""
    chosen: dict[str, Calibration] = {}
    taken, section = taken_of(rig), rig.setup.calibration
    for kind in KINDS:
        own = [each for each in taken if each.kind == kind]
        wish = getattr(section, kind)
        if wish is not None and wish != NONE:
            own = [each for each in own if each.name.removeprefix(f"{kind}-").startswith(wish)]
            if not own:
                raise JobError(
                    f'calibration.{kind} is "{wish}", and {str(folder_of(rig))!r} has none of that date; expected a '
                    f'date that `vam calibrate list` shows, or "{NONE}"'
                )
        if own and wish != NONE:
            chosen[kind] = own[0]
    return chosen


def measured(rig: RigConfig, kind: str) -> Calibration:
    """The applied calibration of a kind. Raises `JobError` if there is none."""
    found = in_force(rig).get(kind)
    if found is None:
        raise JobError(f"the rig {rig.setup.rig.name!r} has no calibration of {kind}; run vam calibrate {kind} --rig "
                       f"{rig.source}")  # fmt: skip
    return found


@dataclass(frozen=True)
class MeasuredRunout:
    """A vial's runout, with the projector and its number of columns in the measurement."""

    found: Runout
    projector: int
    columns: int

    def shift(self, frames: Frames) -> float:
        """Columns along r by which frames move to put their axis on that of the turntable."""
        off = self.found.axis - 0.5 * (self.columns - 1)
        return -off if frames.settings.flip_r else off

    def moves(self, frames: Frames, turning: bool) -> np.ndarray:
        """Columns [frame, row] by which rows also move."""
        count, rows, _ = frames.shape
        angles = Turntable(count).poses if frames.motion is None else frames.motion.poses
        return self.found.columns(np.tile(angles, count // angles.size), rows, turning=turning)


@dataclass(frozen=True, eq=False)
class MachineCalibration:
    """A rig's calibrations, as applied to prints."""

    gray: tuple[GrayCurve | None, ...] = ()  # for each projector; None if it was not measured
    flat: tuple[np.ndarray | None, ...] = ()
    shift: float | None = None  # position of the axis [columns]
    lens: tuple[float, float] | None = None  # power that focuses on the axis [dpt], focus shift per power [mm/dpt]
    runout: MeasuredRunout | None = None
    turn: float = 1.0  # degrees of the vial in one that the motion reports
    turning: bool = False  # whether prints have the turntable's angle
    used: Mapping[str, str] = field(default_factory=dict)  # kind → name of the applied calibration
    notes: tuple[str, ...] = ()  # warnings for the user

    def __bool__(self) -> bool:
        return bool(self.used)

    def motion(self, rig: RigConfig) -> RigConfig:
        """A rig whose microsteps are those of the vial."""
        if self.turn == 1.0 or driver_of(rig.setup.motion) in OWN_STEPS:
            return rig
        motion = rig.setup.motion
        right = motion.model_copy(update={"microsteps": motion.microsteps / self.turn})
        return replace(rig, setup=rig.setup.model_copy(update={"motion": right}))

    def frames(self, frames: Frames, projector: int = 0, *, vial: bool = True) -> Frames:
        """A job's frames corrected for a projector of this machine. Raises `BadInput`, `ShapeMismatch`."""
        seen = self.runout if vial and self.runout is not None and self.runout.projector == projector else None
        gray = self.gray[projector] if projector < len(self.gray) else None
        flat = self.flat[projector] if projector < len(self.flat) else None
        across = self.shift if self.shift is not None or seen is None else seen.shift(frames)
        if gray is None and flat is None and across is None:
            return frames
        shift = None if across is None else (across, frames.settings.shift[1])
        moves = None if seen is None else seen.moves(frames, self.turning)
        flat = None if flat is None else _middle(flat, frames)
        return repack(frames, gray=gray, flat_field=flat, shift=shift, moves=moves)


def calibration_of(rig: RigConfig, now: datetime | None = None) -> MachineCalibration:
    """The calibration of every job on a rig. Raises `JobError`, `StorageError`, `BadInput` for damaged results."""
    chosen = in_force(rig)
    tables = {kind: each.tables() for kind, each in chosen.items()}
    count, limit = len(rig.setup.display), rig.setup.calibration.warn_after / DAY
    notes = [
        f"the calibration {each.name} is {each.days(now):.0f} days old; expected at most {limit:.0f}: measure again, "
        "or raise warn_after in [calibration]"
        for each in chosen.values() if each.days(now) > limit
    ]  # fmt: skip
    gray: list[GrayCurve | None] = [None] * count
    flat: list[np.ndarray | None] = [None] * count
    for projector in range(count):
        if table := tables.get("gray", {}).get("gray" if projector == 0 else f"gray_{projector}"):
            gray[projector] = GrayCurve.parse(table)
        if "flat" in chosen:
            flat[projector] = _flat(chosen["flat"], projector)
    measured = {kind: each[MEASURED] for kind, each in tables.items()}
    lens = (measured["focus"]["axis_dpt"], measured["focus"]["slope_mm_dpt"]) if "focus" in measured else None
    shift = measured["axis"]["shift_columns"] if "axis" in measured else None
    used = {kind: each.name for kind, each in chosen.items()}
    turning = driver_of(rig.setup.clock) == "stage"
    runout = _runout(chosen["runout"], measured["runout"]) if "runout" in measured else None
    if runout is not None and not turning:
        notes.append(
            f"the runout {chosen['runout'].name} is applied except for its dependence on the angle; prints on this "
            "clock do not have the turntable's angle, so the pin's eccentricity of "
            f'{runout.found.eccentricity:.2g} columns stays: center the vial, or use [clock] driver = "stage"'
        )
    turn = _turn(chosen["turn"], measured["turn"]) if "turn" in measured else 1.0
    if turn != 1.0 and (driver := driver_of(rig.setup.motion)) in OWN_STEPS:
        notes.append(
            f"the vial turns {turn:.5g} deg for each that its {driver} reports ({chosen['turn'].name}); the device "
            "states its own microsteps: check coupling and belt"
        )
    return MachineCalibration(tuple(gray), tuple(flat), shift, lens, runout, turn, turning, used, tuple(notes))


def _turn(found: Calibration, numbers: Mapping[str, Any]) -> float:
    with malformed(f"{str(found.path)!r} has malformed numbers", "measure the turn again"):
        ratio, error = float(numbers["ratio"]), float(numbers["error"])
    return ratio if abs(ratio - 1.0) > SURE * error else 1.0


def _runout(found: Calibration, numbers: Mapping[str, Any]) -> MeasuredRunout:
    with malformed(f"{str(found.path)!r} has malformed numbers", "measure the runout again"):
        return MeasuredRunout(Runout.read(numbers), int(numbers["projector"]), int(numbers["columns"]))


def _flat(found: Calibration, projector: int) -> np.ndarray | None:
    """The flat field [row, column] of a projector's mirrors; None if it was not measured."""
    field = read_npz(found.path / "readings.npz").get(f"flat_{projector}")
    return None if field is None else np.asarray(field, np.float64)


def _middle(flat: np.ndarray, frames: Frames) -> np.ndarray:
    """The part of a projector's flat field under frames in its middle."""
    rows, columns = frames.shape[1:]
    top, left = (flat.shape[0] - rows) // 2, (flat.shape[1] - columns) // 2
    if top < 0 or left < 0:
        raise BadInput(
            f"the flat field has {flat.shape[0]} × {flat.shape[1]} mirrors, the job's frames {rows} × {columns}; "
            "measure it on this projector again"
        )
    return flat[top : top + rows, left : left + columns]
