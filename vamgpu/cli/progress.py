"""Progress on the terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from vamgpu.jobs.progress import RunEvents
from vamgpu.jobs.run import StageProgress
from vamgpu.methods.plan import Step

if TYPE_CHECKING:
    from vamgpu.hosts.records.state import Board

STAGES = {
    "patterns": "reading the patterns",
    "voxels": "voxelizing the part",
    "open": "opening the device",
    "rays": "tracing rays",
    "light": "optimizing the patterns",
    "frames": "packing the frames",
    "folder": "writing the job",
    "read": "reading the job",
    "contrast": "weighting the angles that enter the film",
    "proof": "proving the print from its frames",
    "verdict": "judging the patterns by the solver's dose",
    "bound": "bounding the window of any patterns",
    "report": "writing the report",
    "model": "modeling the print",
    "correct": "correcting the slices",
    "survey": "finding features and voids that cannot be printed",
    "columns": "solving whole columns",
    "orientations": "solving coarsely in several orientations",
    "plan": "planning the frames for the machine",
    "print": "printing",
}


class _Left(TimeRemainingColumn):
    """The time left, once a stage has reported progress."""

    def render(self, task: Task) -> Text:
        left = super().render(task)
        return left.append(" left") if left.plain and "-" not in left.plain else Text()


@contextmanager
def shown(console: Console, events: RunEvents | None = None) -> Iterator[StageProgress]:
    """A function that shows progress, and records it as ``events``; finished stages stay as lines with seconds."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), _Left())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        now = _Now(bar, console, events)
        yield now
        now.finish()


def recording_board(events: RunEvents, job: str) -> Board:
    """A board of a print that also records the share of the print that is done."""
    from vamgpu.hosts.records.state import Board

    class Recording(Board):
        def show(self, **fields: object) -> None:
            super().show(**fields)
            if self.now.slots and self.now.slot:
                events.share("print", STAGES["print"], min(1.0, (self.now.slot + 1) / self.now.slots))

    events.share("plan", STAGES["plan"], 0.0)
    return Recording(job=job)


class _Now:
    def __init__(self, bar: Progress, console: Console, events: RunEvents | None) -> None:
        self._bar, self._console, self._events = bar, console, events
        self.look = None if events is None else events.look
        self._stage, self._began, self._task = "", 0.0, None

    def __call__(self, stage: str, share: float) -> None:
        if stage != self._stage:
            self.finish()
            self._stage, self._began = stage, time.perf_counter()
            self._task = self._bar.add_task(STAGES.get(stage, stage), total=None)
        if self._task is not None and share > 0.0:  # a stage without a known share shows a pulse
            self._bar.update(self._task, total=1.0, completed=share)
        if self._events is not None:
            self._events.share(stage, STAGES.get(stage, stage), share)

    def step(self, step: Step) -> None:
        """Record a step of the optimization."""
        if self._events is not None:
            self._events.step(step)

    def tell(self, text: str) -> None:
        """Print a separate line."""
        self.finish()
        self._stage = ""
        self._console.print(f"[dim]{text}[/]", highlight=False)
        if self._events is not None:
            self._events.say("note", text=text)

    def finish(self) -> None:
        """Turn the running stage into a finished line."""
        if self._task is not None:
            self._bar.remove_task(self._task)
            seconds = time.perf_counter() - self._began
            self._console.print(f"[green]✓[/] {STAGES.get(self._stage, self._stage)} [dim]{seconds:.1f} s[/]")
            self._task = None
