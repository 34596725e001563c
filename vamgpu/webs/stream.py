"""An endless print: tiles in, frames out, segment by segment, in constant memory."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError, TileError
from vamgpu.geometry import Beam, positive
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.losses.loss import Loss
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.choice import chosen
from vamgpu.methods.method import Method
from vamgpu.methods.pdhg import PDHG
from vamgpu.optics.lens import TunableLens
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames, flat_table
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import Solved, pack, ranked
from vamgpu.printing.placement import Placement
from vamgpu.storage.manifest import plain
from vamgpu.web import Propagation, WebGrid, Wrap, light_of_pose
from vamgpu.webs.describe import described, described_focus, described_target, described_wrap
from vamgpu.webs.layout import SegmentLayout
from vamgpu.webs.section import focus_masks, lit_by, one_column
from vamgpu.webs.segment import Segment
from vamgpu.webs.solver import SegmentLosses, Solver, Start
from vamgpu.webs.store import RECORD, WebFolder
from vamgpu.webs.tiles import Columns
from vamgpu.webs.window_solver import FixedFrames, WindowSolver

QUANTILE = 0.9999  # share of the first segment's lit pixels that a full-on mirror reaches

Progress = Callable[[int, int | None], None]
"""Called after each segment with the segments done and their total (None if it is unknown)."""

SegmentSource = Callable[[range, float | None], Iterable[Segment]]
"""Segments of a range of numbers in order, with a known scale; without one, the first segment sets it."""


@dataclass(frozen=True, eq=False)
class Past:
    """State of earlier segments for the next one."""

    frames: np.ndarray  # the last ones, at most those of an overlap, uint8 [angle, row, column]
    levels: tuple[float, float] | None = None  # least dose of the part and greatest outside, from the first segment


@dataclass(eq=False)
class Stream:
    """Frames for a web of any length, solved segment by segment.

    Args:
        tiles: An iterator of arrays [l, rho, z] of fractions, of any thickness along l; a function of (l, rho, z) [mm]
            that is negative in the solid; or `Repeated`, a mesh tiled along l.
        wrap: The machine, for example a `Roller`.
        beam: The beam of its projector.
        lens: A `TunableLens`, whose planes follow a roller's film, or the `FocusMasks` themselves. ``masks`` holds
            them, and the folder records the plane of each column.
        method: A method whose loss is a sum over voxels (`BCLP`, CAL, penalty minimization, two thresholds), its name,
            or such a loss. The `Solver` sets the length of steps and their momentum. For a norm with q ≠ p, the first
            segment is solved twice; it gives the number by which all segments depend on each other. Alternatively
            "best" for the widest window, which takes more memory and time per segment.
        section: Voxels along rho and z; by default one slice per row, and the number of layers that fill the film of
            ``wrap`` with a pitch nearest to the beam's.
        pitch: Voxel edges along l, rho, z [mm]; by default one step along l and the beam's pitch.
        length: Length of the web [mm]; None if the tiles themselves end.
        iterations: Iterations of each segment, the method's own by default.
        core: Length of a segment relative to the window of light.
        overlap: Length solved on either side of a segment relative to the window of light.
        gray: Gray curve of the projector; None for a linear one.
        scale: Irradiance of a full-on pixel relative to the light's unit; by default that of the first segment. It is
            the same for all frames, because a projector's lamp cannot change from frame to frame.
        speed: Speed at which the web is to be printed [mm/s]; stored in its folder.
        device: A name or a device; the best available one by default.

    Raises:
        BadInput: An argument is of another type or out of its range.
        ShapeMismatch: The light was made for another geometry.
        DeviceError: There is no such device.
    """

    tiles: Any
    wrap: Wrap
    beam: Beam
    lens: TunableLens | FocusMasks | None = None
    method: str | Method | Loss = field(default_factory=BCLP.paper_002)
    section: tuple[int, int] | None = None
    pitch: tuple[float, float, float] | None = None
    length: float | None = None
    iterations: int | None = None
    core: float = 2.0
    overlap: float = 1.25
    gray: GrayCurve | None = None
    scale: float | None = None
    device: str | Device | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.wrap, Wrap):
            raise BadInput(f"got {self.wrap!r} as wrap; expected a Roller, or anything that carries a web past light")
        if not isinstance(self.beam, Beam):
            raise BadInput(f"got {self.beam!r} as beam; expected a Beam")
        if self.scale is not None:
            self.scale = positive("scale", self.scale)
        if self.speed is not None:
            self.speed = positive("speed [mm/s]", self.speed)
        self.method = PDHG() if isinstance(self.method, str) and self.method.lower() == "best" else chosen(self.method)
        count = self.method.iterations if self.iterations is None else self.iterations
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise BadInput(f"iterations is {count!r}; expected a whole number ≥ 1")
        self.iterations = count
        self.gray = GrayCurve.linear() if self.gray is None else self.gray
        if not isinstance(self.gray, GrayCurve):
            raise BadInput(f"got {self.gray!r} as gray; expected a GrayCurve, such as GrayCurve.load(path), or None")
        self.device = open_device(self.device)
        self.grid: WebGrid = one_column(self.wrap, self.beam, self.section, self.pitch)
        self.masks: FocusMasks | None = focus_masks(self.lens, self.wrap, self.beam)
        wrap = lit_by(self.wrap, 1 if self.masks is None else len(self.masks.planes))
        self.light: Propagation = light_of_pose(wrap, self.grid, self.beam, self.device)
        step = self.wrap.advance / self.grid.edges[0]
        self.layout: SegmentLayout = SegmentLayout.of(self.light.shape[2], step, self.core, self.overlap)
        solver: Any = WindowSolver if isinstance(self.method, PDHG) else Solver
        given = (self.layout, self.grid, self.beam, self.light, self.method, self.device)
        self.solver: Solver | WindowSolver = solver(*given)
        self._reader: tuple[Columns, int] | None = None

    def __iter__(self) -> Iterator[Segment]:
        """Segments in order, from the first."""
        return self.segments()

    @property
    def total(self) -> int | None:
        """Segments of the web; None if its length is unknown."""
        return None if self.length is None else self.layout.segments(Columns((), self.grid, self.length).end or 0)

    def segments(
        self, first: int = 0, scale: float | None = None, before: np.ndarray | None = None,
        given: Callable[[int], Start] | None = None, past: Past | None = None,
    ) -> Iterator[Segment]:  # fmt: skip
        """Solve one segment after another; segments yielded before an error stay valid.

        Args:
            first: Number of the first segment; tiles are still read from the start.
            scale: Scale of the previous segments, relative to the light's unit; by default the stream's.
            before: Target of the segment before the first, uint8 [l, rho, z]; the tiles must reproduce it.
            given: Start of each segment, by its number; None starts each from the filtered target.
            past: State of the segments before ``first``, for a method that maximizes the window.

        Returns:
            The segments in order.

        Raises:
            TileError: The tiles end early, do not fit, or differ from ``before``.
        """
        columns, scale = self._settled(), scale or self.scale
        number, past = first, past or self._nothing
        if given is not None and isinstance(self.solver, WindowSolver):
            raise BadInput(f"a web by {self.method!r} cannot be replanned; expected a loss that is a sum over voxels")
        if before is not None:
            self._check_same(columns, first, before)
        while True:
            segment, past = self._next(columns, number, scale, past, given)
            if segment is None:
                return
            yield segment
            if segment.last:
                return
            number, scale = number + 1, segment.scale

    def alone(self, number: int, scale: float | None = None) -> Segment:
        """Solve one segment without the previous ones, if it does not depend on them.

        Segments may come in any order, but going back to an earlier segment reads the tiles again from the start.

        Args:
            number: Number of the segment.
            scale: Scale of segment 0, relative to the light's unit; by default the stream's, or that of segment 0.

        Returns:
            The segment.

        Raises:
            BadInput: The web ends before it, its tiles can be read only once, or the method maximizes the window, which
                makes segments depend on previous ones.
            TileError: As for `segments`.
        """
        if reason := self.unsupported_alone():
            raise BadInput(f"segments cannot be solved alone: {reason}")
        if self._reader is None or self._reader[1] > number:
            self._reader = self._settled(), number
        columns = self._reader[0]
        self._reader = columns, number
        segment, _ = self._next(columns, number, scale or self.scale, self._nothing, None)
        if segment is None:
            raise BadInput(f"got segment {number}; expected one below {self.total}")
        return segment

    def unsupported_alone(self) -> str:
        """Reason why segments cannot be solved separately; empty if they can."""
        if isinstance(self.solver, WindowSolver):
            return (f"{self.method!r} maximizes the window, and each segment continues the one before; expected a loss "
                    "that is a sum over voxels, such as the method bclp")  # fmt: skip
        if self.total is None or isinstance(self.tiles, Iterator):
            return "the web has no length, or its tiles can be read only once"
        return ""

    def _settled(self) -> Columns:
        """Columns from the beginning, if the first segment sets a number for all segments."""
        columns, solver, layout = Columns(self.tiles, self.grid, self.length), self.solver, self.layout
        if isinstance(solver, Solver) and solver.norm is not None:
            first = layout.origin(0)
            fractions = columns.take(first, first + layout.columns)
            stop = min(first + layout.columns, columns.end or first + layout.columns)
            solver.settle(fractions, stop - max(first, 0), self.iterations or 1)
        return columns

    @property
    def _nothing(self) -> Past:
        return Past(np.zeros((0, *self.beam.pixels[::-1]), np.uint8))

    def _next(
        self, columns: Columns, number: int, scale: float | None, past: Past, given: Callable[[int], Start] | None
    ) -> tuple[Segment | None, Past]:  # fmt: skip
        """A segment, and its state for the next one; None beyond the end."""
        began = time.perf_counter()
        origin = self.layout.origin(number)
        fractions = columns.take(origin, origin + self.layout.columns)
        start, stop = self.layout.owned(number, columns.end)
        if stop <= start:
            return None, past
        light, outcome, past = self._solve(fractions, number, columns.end, scale, past, given)
        here = slice(self.layout.overlap, self.layout.overlap + stop - start)
        scale = scale or self._first_scale(light, here)
        packed = pack(Solved(light, self.solver.operator), gray=self.gray, scale=scale).images
        images = packed.part(here.start, here.stop)
        past = Past(np.concatenate([past.frames, images])[-self.layout.overlap :], past.levels)
        low, high = (edge - origin for edge in self.layout.printed(number, columns.end))
        last = columns.end is not None and stop == self.layout.frames(columns.end)
        assert self.gray is not None
        return Segment(
            number, start, images, _bytes(fractions[low:high]), scale, (outcome.first, outcome.last),
            int(np.count_nonzero(images == 255)), time.perf_counter() - began, last, self.gray, past.levels,
        ), past  # fmt: skip

    def _check_same(self, columns: Columns, number: int, before: np.ndarray) -> None:
        """Reject tiles that differ from those of the segment before ``number``."""
        low, _ = self.layout.printed(number - 1, None)
        start = min(low, self.layout.origin(number))
        again = columns.take(start, low + len(before))[low - start :]
        if not np.array_equal(_bytes(again), before):
            raise TileError(
                f"columns {low} to {low + len(before) - 1} of the tiles differ from those with which the web began; "
                "resume it with the same tiles from the start, or start a new one"
            )

    def _solve(
        self, fractions: np.ndarray, number: int, end: int | None, scale: float | None, past: Past,
        given: Callable[[int], Start] | None,
    ) -> tuple[DeviceArray, SegmentLosses, Past]:  # fmt: skip
        """Light of a segment, its losses, and the state for the segments after it."""
        count, solver, layout = self.iterations or 1, self.solver, self.layout
        if isinstance(solver, Solver):
            return *solver.solve(fractions, count, None if given is None else given(number)), past
        light = np.zeros((layout.overlap, *solver.operator.range.shape[1:]), np.float32)
        if len(past.frames) and scale:
            shown = Frames.from_bytes(
                past.frames, solver.device, bits=8, gray=self.gray, scale=scale, columns=self.beam.pixels[0]
            )
            light[-len(past.frames) :] = shown.irradiance().numpy()
        origin = layout.origin(number)
        span = max(0, -origin), len(fractions) if end is None else max(0, min(len(fractions), end - origin))
        found, losses, levels = solver.solve(fractions, count, FixedFrames(light, span, past.levels))
        return found, losses, Past(past.frames, past.levels or levels)

    def _first_scale(self, light: DeviceArray, here: slice) -> float:
        """Light that all but a few lit pixels of the first segment's own frames do not exceed."""
        own = np.zeros(light.shape[0], np.float32)
        own[here] = 1.0
        solver = self.solver
        shown = solver.spare() if isinstance(solver, Solver) else light.device.empty(light.shape)
        light.device.launch(weigh_poses, light=light, times=light.device.table(own), weighted=shown)
        shared = {"sinogram": shown, "flat": flat_table(light.device, None), **Placement().arguments()}
        scale = ranked(shared, lambda counts: min(int(counts.sum()), int(QUANTILE * counts.sum()) + 1))
        if not scale:
            raise TileError(
                f"the first {self.layout.core} frames have nothing to print, so that the brightness of a full-on "
                "pixel is unknown; begin with the part, or give scale="
            )
        return scale

    def write(
        self, path: str | Path, *, resume: bool = True, overwrite: bool = False, progress: Progress | None = None,
        spread: SegmentSource | None = None,
    ) -> WebFolder:  # fmt: skip
        """Write every segment to a folder as soon as it is solved. A killed run leaves only whole segments.

        Args:
            path: Path of the folder.
            resume: Continue an interrupted run of the same stream; tiles are read again from the start.
            overwrite: Replace an existing folder.
            progress: Called after each segment.
            spread: Solves segments on other workers, each as `alone` does; see `SegmentSource`. None solves them here.

        Returns:
            The folder.

        Raises:
            StorageError: The folder belongs to another stream, or cannot be written.
            TileError: As for `segments`.
        """
        folder = self._begun(Path(path), resume, overwrite)
        if folder.complete:
            return folder
        known, before, past = None, None, None
        if folder.segments:
            known = folder.details["frames"]["scale"]
            before = folder.read("target", *folder.segments[-1].columns)
            levels = folder.details["frames"].get("levels")
            frames = folder.read("frames", max(0, folder.frames - self.layout.overlap), folder.frames)
            past = Past(frames, None if levels is None else (float(levels[0]), float(levels[1])))
        first = len(folder.segments)
        if spread is not None and (reason := self.unsupported_alone()):
            raise BadInput(f"segments cannot be spread over workers: {reason}")
        if spread is None:
            found = self.segments(first, known, before, past=past)
        else:
            if before is not None:
                self._check_same(Columns(self.tiles, self.grid, self.length), first, before)
            found = spread(range(first, self.total or first), known or self.scale)
        for segment in found:
            if not folder.segments:
                folder.details["frames"]["scale"] = segment.scale
                if segment.levels is not None:
                    folder.details["frames"]["levels"] = list(segment.levels)
            folder = folder.append(segment.images, segment.target, segment.loss, segment.saturated, segment.last)
            if progress is not None:
                progress(len(folder.segments), self.total)
        return folder

    def _begun(self, place: Path, resume: bool, overwrite: bool) -> WebFolder:
        details = self.details()
        if (place / RECORD).is_file() and (overwrite or (resume and not WebFolder.open(place).segments)):
            shutil.rmtree(place)  # nothing is lost if the web has no complete segment
        if resume and (place / RECORD).is_file():
            folder = WebFolder.open(place).swept()
            frames = {key: value for key, value in folder.details["frames"].items() if key != "levels"}
            known = {"speed": self.speed, **folder.details, "frames": {**frames, "scale": self.scale}}
            if known != plain(details, "details"):
                different = [key for key in details if known.get(key) != plain(details[key], key)]
                raise StorageError(
                    f"{str(place)!r} holds another web, with other {', '.join(different) or 'details'}; resume it "
                    "with the stream that began it, choose another path, or allow overwriting it"
                )
            return folder
        rows, columns = self.beam.pixels[1], self.beam.pixels[0]
        lengths = self.layout.core, self.layout.columns_per_core
        section = self.grid.shape[1], self.grid.shape[2]
        return WebFolder.create(place, details, (rows, columns), section, lengths)

    def details(self) -> dict[str, Any]:
        """Describe the stream for readers and resumed runs.

        Returns:
            Plain values by subject.
        """
        assert self.gray is not None
        layout = self.layout
        return {
            "grid": {"section": list(self.grid.shape[1:]), "pitch": list(self.grid.edges)},
            "beam": {"pixels": list(self.beam.pixels), "pitch": self.beam.pitch},
            "wrap": described_wrap(self.wrap),
            "layout": {
                "window": layout.window, "step": str(layout.step), "core": layout.core, "overlap": layout.overlap,
                "lead": layout.lead,
            },
            "method": {**described(self.method), "iterations": self.iterations, "step": self.solver.step},
            "frames": {
                "bits": 8, "gray": self.gray.describe(), "scale": self.scale, "focus": described_focus(self.masks),
            },
            "length": self.length,
            "speed": self.speed,
            "target": described_target(self.tiles),
        }  # fmt: skip


def _bytes(fractions: np.ndarray) -> np.ndarray:
    return np.round(255.0 * fractions).astype(np.uint8)
