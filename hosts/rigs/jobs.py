"""Jobs of a rig: the frames of a vial, a web, or slices, with their motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.curethrough.names import is_slice
from vamgpu.curethrough.output import RECORD
from vamgpu.curethrough.stack import ZipStack, layer_height, open_stack
from vamgpu.errors import BadInput, SliceError, StorageError
from vamgpu.geometry import Turntable
from vamgpu.hosts.drivers.cleanup import closed_on_error
from vamgpu.hosts.frames.sources import FrameSource, MirrorArray, VialFrames, WebFrames
from vamgpu.hosts.rigs.calibrations import MachineCalibration
from vamgpu.jobs.run import is_interrupted
from vamgpu.jobs.web import is_web_folder
from vamgpu.methods.plan_folder import operator_from
from vamgpu.printing.folder import load_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.quantity import counted
from vamgpu.storage.folder import MANIFEST, Folder
from vamgpu.storage.reading import malformed, parse_json, read_text
from vamgpu.travel import Travel
from vamgpu.webs.describe import wrap_from
from vamgpu.webs.store import WebFolder

Kind = Literal["vial", "web", "slices"]


@dataclass(frozen=True, eq=False)
class PrintJob:
    kind: Kind
    path: str
    shape: tuple[int, int]  # rows and columns of its frames
    poses: int  # motion of a whole turn, web or platform
    source: Callable[[MirrorArray], FrameSource]  # makes the frames for an array of mirrors
    bits: int = 8
    advance: float | None = None  # travel from pose to pose [mm]; None for vials
    speed: float | None = None  # speed that it was made for [mm/s]; None if it is not given
    depths: tuple[float, ...] = ()  # depths of its focus planes [mm]; none for one focus
    bath: float = 1.0  # refractive index of the bath
    frames: Frames | None = None  # frames of a vial, of all turns if its part moves
    travel: Travel | None = None  # path of a part that moves
    row: float = 0.0  # height of a row of its beam [mm]
    stretch: Callable[[int, int], Frames] | None = None  # frames of a web per pose
    masks: np.ndarray | None = None  # focus plane of each column
    segment: int = 0  # poses of a segment; its frames may be replaced before it begins

    @property
    def motion(self) -> Turntable | None:
        """Angles of a vial's frames; None for a folder of an earlier version, with equally spaced angles."""
        return None if self.frames is None else self.frames.motion

    @property
    def turn(self) -> int | Turntable:
        """The motion of a vial, or its number of equally spaced angles."""
        return self.motion or self.poses


def print_job(
    path: str | Path, device: str | Device | None = None, machine: MachineCalibration = MachineCalibration(),
    projector: int = 0,
) -> PrintJob:  # fmt: skip
    """Read a job's folder; ``machine`` corrects the frames of vials and webs for a projector, not slices."""
    place = Path(path)
    if is_web_folder(place):
        again = partial(machine.frames, projector=projector, vial=False) if machine else None
        return _web(place, open_device(device), again)
    bare = place.is_dir() and not (place / MANIFEST).exists()
    if place.is_file() or (bare and any(is_slice(file.name) for file in place.iterdir())):
        return _slices(place, open_device(device))
    try:
        frames = replace(machine.frames(load_frames(place, device), projector), packed=None)
    except StorageError as error:
        if (place / MANIFEST).exists():
            raise
        raise StorageError(
            f"{str(path)!r} is not a job: expected the folder of a vial or a web from `vam solve`, or one of "
            "slices from `vam curethrough correct`; check the path"
        ) from error
    if is_interrupted(place):
        raise BadInput(f"{str(path)!r} is an interrupted plan; finish it with `vam solve` before printing")
    count, travel = frames.shape[0], None if frames.motion is None else frames.motion.travel
    row = 0.0
    if travel is not None:
        beam = operator_from(Folder.open(place), frames.device).beam
        frames, row = frames.followed(beam), beam.pitch
    return PrintJob(
        "vial", str(path), frames.shape[1:], count, partial(VialFrames, frames), frames.bits, frames=frames,
        travel=travel, row=row,
    )  # fmt: skip


def _web(place: Path, device: Device, again: Callable[[Frames], Frames] | None) -> PrintJob:
    """again: corrects frames for another machine; None leaves them as they are."""
    folder = WebFolder.open(place)
    if not folder.complete:
        frames = counted(folder.frames, "frame")
        raise BadInput(f"{str(place)!r} has {frames} and is not complete; finish it with `vam solve` before printing")
    with malformed(f"{str(place)!r} has malformed details", "write the web again"):
        focus, (columns, rows) = folder.details["frames"]["focus"], folder.details["beam"]["pixels"]
        depths = () if focus is None else tuple(map(float, focus["planes"]))
        chosen = np.zeros(columns, np.int64) if focus is None else np.array(focus["bin"], np.int64)
        worth = folder.details["frames"]
        gray, scale = GrayCurve.parse(worth["gray"]), float(worth["scale"])
        if chosen.shape != (columns,) or not 0 <= chosen.min() <= chosen.max() < max(len(depths), 1):
            raise ValueError(f"{chosen.size} columns choose among {len(depths)} focus planes")
    wrap: Any = wrap_from(folder.details["wrap"])
    shown = chosen == np.arange(max(len(depths), 1))[:, None]

    def stretch(low: int, high: int) -> Frames:
        levels = folder.read("frames", low, high)
        frames = Frames.from_bytes(levels, device, bits=8, gray=gray, scale=scale, columns=columns)
        return frames if again is None else again(frames)

    def read(low: int, high: int) -> np.ndarray:
        return folder.read("frames", low, high) if again is None else stretch(low, high).levels()

    return PrintJob(
        "web", str(place), (rows, columns), folder.frames, lambda mirrors: WebFrames(
            read, folder.frames, mirrors, shown, device
        ), advance=float(wrap.advance),
        speed=folder.details.get("speed"), depths=depths, bath=wrap.film.bath_index,
        stretch=stretch, masks=shown, segment=folder.segments[0].frames[1],
    )  # fmt: skip


def _slices(place: Path, device: Device) -> PrintJob:
    stack = open_stack(place)
    with closed_on_error(stack):
        machine = _record(place, stack).get("machine", {})
        if "exposure" in machine:
            raise SliceError(
                f"{str(place)!r} was corrected for a printer that stops at every layer; correct it for a moving "
                "platform: printer.speed in place of printer.exposure"
            )
        height = machine.get("slice_height") or layer_height(stack)
        if height is None:
            raise SliceError(
                f"{str(place)!r} does not give the height of its slices; expected a folder from `vam "
                "curethrough correct`"
            )
        count, *shape = stack.shape
        return PrintJob(
            "slices", str(place), (shape[0], shape[1]), count, lambda mirrors: WebFrames(
                partial(_one_by_one, stack), count, mirrors, None, device
            ), advance=float(height), speed=machine.get("speed"),
        )  # fmt: skip


def _one_by_one(stack: Any, low: int, high: int) -> np.ndarray:
    """Slices: a request for several at once also prepares those before them, which are read next."""
    return np.concatenate([stack[number : number + 1] for number in range(low, high)])


def _record(place: Path, stack: Any) -> dict[str, Any]:
    """The record of slices; empty if there is none."""
    try:
        if isinstance(stack, ZipStack):
            held = any(info.filename == RECORD for info in stack.others)
            text = stack.entry(RECORD).decode("utf-8", "replace") if held else "{}"
        else:
            text = read_text(place / RECORD) if (place / RECORD).is_file() else "{}"
        return dict(parse_json(text))
    except (OSError, TypeError, ValueError) as error:
        raise StorageError(f"{str(place / RECORD)!r} is not a record: {error}; write the slices again") from error
