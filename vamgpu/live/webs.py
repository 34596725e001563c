"""The frames of a web that are not committed yet, optimized for the light as measured."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, StorageError
from vamgpu.operators.compose import combine
from vamgpu.operators.web import WebProjection
from vamgpu.storage.manifest import plain
from vamgpu.web import WebGrid
from vamgpu.webs.drift import WebDrift, clouded, drifts_of, gains
from vamgpu.webs.frame_light import light_of
from vamgpu.webs.segment import Segment
from vamgpu.webs.solver import Start
from vamgpu.webs.store import RECORD, SegmentRecord, WebFolder
from vamgpu.webs.stream import Progress, Stream

PlanFolders = WebFolder | Sequence[WebFolder]
"""A web as shown: one folder, or several, each of which continues the previous one."""


class WebReplanner:
    """Optimizes the segments of a web beyond the commit horizon, for another lamp or another resin.

    Frames before the horizon do not change. Their dose in columns that later frames also light is an offset of the
    loss. Later frames start as planned, and no pixel is brighter than the lamp allows.

    Args:
        stream: The stream that planned the web; its tiles are read from the start.
        drifts: One or more measured changes of the light; the last one continues to apply.
        iterations: Iterations of each segment; the stream's by default.

    Raises:
        BadInput: A value is out of its range, or the absorption of this film cannot be changed.
    """

    drifts: tuple[WebDrift, ...]

    def __init__(self, stream: Stream, drifts: WebDrift | Sequence[WebDrift], *, iterations: int | None = None) -> None:
        self.drifts = (drifts,) if isinstance(drifts, WebDrift) else tuple(sorted(drifts, key=lambda d: d.since))
        if not self.drifts or not all(isinstance(each, WebDrift) for each in self.drifts):
            raise BadInput(f"got drifts {drifts!r}; expected a WebDrift, or several")
        count = stream.iterations if iterations is None else iterations
        self.stream: Stream = replace(stream, wrap=clouded(stream.wrap, self.drifts[-1].absorption), iterations=count)

    @property
    def gain(self) -> float:
        """Current light relative to the plan."""
        return self.drifts[-1].gain

    def open_window(self, horizon: int) -> tuple[int, int]:
        """Columns that both committed and later frames light.

        Args:
            horizon: Number of committed segments.

        Returns:
            The first column, and the one after the last.
        """
        layout = self.stream.layout
        start = int((horizon * layout.core - layout.lead) * layout.step)
        return start, start + self._columns

    @property
    def _columns(self) -> int:
        layout = self.stream.layout
        return max(ceil((layout.lead - 1) * layout.step) + layout.window - int(layout.lead * layout.step), 1)

    def delivered(self, plan: PlanFolders, horizon: int) -> np.ndarray:
        """Dose that the committed frames deliver to the open window.

        Args:
            plan: The web as planned; several folders if each continues the previous one.
            horizon: Number of committed segments.

        Returns:
            Dose [l, rho, z] of the columns `open_window`.

        Raises:
            StorageError: The folder is damaged.
        """
        stream, layout = self.stream, self.stream.layout
        grid = WebGrid((self._columns, *stream.grid.shape[1:]), stream.grid.pitch)
        operator = WebProjection.from_light(
            grid, stream.light, float(layout.step), stream.beam, stream.device, poses=layout.lead,
            start=-float(layout.lead * layout.step),
        )  # fmt: skip
        first = horizon * layout.core - layout.lead
        return np.asarray(operator.T(self._lit(_folders(plan), first, layout.lead, lambda _: self.drifts)))

    def _lit(
        self, folders: Sequence[WebFolder], first: int, poses: int,
        drifts: Callable[[WebFolder], Sequence[WebDrift]],
    ) -> DeviceArray:  # fmt: skip
        """Light [angle, r, z] of frames from ``first`` on, from the light that each folder's frames had."""
        light, begin = None, 0
        for folder in folders:
            gain = gains(drifts(folder), 0, folder.frames)
            gain[:begin] = 0.0
            part = light_of(folder, first, poses, gain, self.stream.solver.device)
            light = part if light is None else combine(1.0, light, 1.0, part, light)
            begin = max(begin, folder.frames)
        assert light is not None
        return light

    def segments(
        self, plan: PlanFolders, horizon: int, *, delivered: np.ndarray | None = None, first: int | None = None
    ) -> Iterator[Segment]:
        """Solve one segment after another, from the horizon on.

        Args:
            plan: The web as planned, or as replanned before; several folders if each continues where the previous one
                ends.
            horizon: Number of committed segments.
            delivered: Dose of the open window [l, rho, z]; by default that of the committed frames.
            first: Number of the first segment to solve; the horizon by default.

        Yields:
            The segments in order, each as soon as it is solved; ``scale`` is the current light of a full-on pixel.

        Raises:
            BadInput: The plan has fewer segments, or a dose is not a number.
            ShapeMismatch: The dose is that of another window.
            StorageError: The folder is damaged.
            TileError: The tiles differ from those of the plan.
        """
        stream, layout, first = self.stream, self.stream.layout, horizon if first is None else first
        folders, known = _folders(plan), _segments(plan, horizon)
        most, frames = self.gain * folders[0].details["frames"]["scale"], max(each.frames for each in folders)
        dose = self.delivered(plan, horizon) if delivered is None else np.asarray(delivered, float)
        grid = WebGrid((self._columns, *stream.grid.shape[1:]), stream.grid.pitch)
        if dose.shape != grid.shape or not np.isfinite(dose).all():
            raise BadInput(f"a delivered dose of shape {dose.shape}; expected finite numbers {grid.shape} [l, rho, z]")
        start, stop = self.open_window(horizon)

        def given(number: int) -> Start:
            begin, origin = number * layout.core - layout.overlap, layout.origin(number)
            poses = begin + np.arange(layout.poses)
            decided = int(np.clip(horizon * layout.core - begin, 0, layout.poses))
            offset = None
            if begin <= horizon * layout.core:
                offset = np.zeros((layout.columns, *grid.shape[1:]))
                low, high = max(start, origin), min(stop, origin + layout.columns)
                offset[: max(start - origin, 0)] = np.nan
                offset[low - origin : high - origin] = dose[low - start : high - start]
            light = self._lit(folders, begin, layout.poses, lambda folder: drifts_of(folder.details))
            return Start(light, (poses >= 0) & (poses < frames), most, decided, offset)

        before = None
        if 0 < first <= len(known):
            folder, record = known[first - 1]
            before = folder.read("target", *record.columns)
        yield from stream.segments(first, most, before, given)

    def write(
        self, path: str | Path, plan: PlanFolders, horizon: int, *, count: int | None = None,
        delivered: np.ndarray | None = None, overwrite: bool = False, progress: Progress | None = None,
    ) -> WebFolder:  # fmt: skip
        """Write a web: the committed frames, byte for byte, then the new frames.

        A killed run leaves a folder of whole segments; the same call continues it and gives the same bytes.

        Args:
            path: Path of the folder, not the plan's.
            plan: As for `segments`.
            horizon: Number of committed segments.
            count: Number of segments beyond the horizon; None for all. A later call adds further ones.
            delivered: As for `segments`, [l, rho, z].
            overwrite: Replace an existing folder.
            progress: Called after each segment.

        Returns:
            The folder; `vamgpu.webs.proof.prove_web` reads from it the light of its frames.

        Raises:
            BadInput, ShapeMismatch, TileError: As for `segments`.
            StorageError: The folder belongs to another web, or cannot be written.
        """
        place = Path(path)
        folders, known = _folders(plan), _segments(plan, horizon)
        if place.resolve() in [each.path.resolve() for each in folders]:
            raise StorageError(f"{str(path)!r} is the plan itself; expected another path: the plan is kept")
        folder = self._begun(place, folders[0], horizon, overwrite)
        for source, record in known[len(folder.segments) : horizon]:
            folder = folder.append(
                source.read("frames", *record.frames), source.read("target", *record.columns), record.loss,
                record.saturated, False,
            )  # fmt: skip
        first, stop = len(folder.segments), None if count is None else horizon + count
        if folder.complete or (stop is not None and first >= stop):
            return folder
        for segment in islice(self.segments(plan, horizon, delivered=delivered, first=first), stop and stop - first):
            folder = folder.append(segment.images, segment.target, segment.loss, segment.saturated, segment.last)
            if progress is not None:
                progress(len(folder.segments), self.stream.total)
        return folder

    def _begun(self, place: Path, plan: WebFolder, horizon: int, overwrite: bool) -> WebFolder:
        replanned = {"drifts": [asdict(each) for each in self.drifts], "horizon": horizon,
                     "iterations": self.stream.iterations}  # fmt: skip
        details: dict[str, Any] = {**plan.details, "replanned": replanned}
        if overwrite and place.is_dir():
            shutil.rmtree(place)
        if (place / RECORD).is_file():
            folder = WebFolder.open(place).swept()
            if folder.details != plain(details, "details"):
                raise StorageError(f"{str(place)!r} holds another web, or one replanned with other settings; choose "
                                   "another path, or allow overwriting it")  # fmt: skip
            return folder
        layout, beam = self.stream.layout, self.stream.beam
        section = self.stream.grid.shape[1], self.stream.grid.shape[2]
        return WebFolder.create(
            place, details, (beam.pixels[1], beam.pixels[0]), section, (layout.core, layout.columns_per_core)
        )


def _folders(plan: PlanFolders) -> tuple[WebFolder, ...]:
    return (plan,) if isinstance(plan, WebFolder) else tuple(plan)


def _segments(plan: PlanFolders, horizon: int) -> list[tuple[WebFolder, SegmentRecord]]:
    """Each segment, and the folder that contains it. Raises `BadInput` for a horizon beyond the last segment."""
    found: list[tuple[WebFolder, SegmentRecord]] = []
    for folder in _folders(plan):
        found += [(folder, record) for record in folder.segments[len(found) :]]
    if not found or not 0 <= horizon <= len(found):
        raise BadInput(f"a horizon of {horizon} segments; expected 0 to {len(found)}, those of the plan")
    return found
