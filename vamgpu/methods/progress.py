"""Where the steps of a run are reported."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from vamgpu.methods.plan import Step

Progress = Callable[[Step], None]


def watched() -> bool:
    """Whether a person can see the output: at a terminal or in a notebook; False for output to a file or a pipe."""
    shell = sys.modules.get("IPython")
    if shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell":
        return find_spec("ipywidgets") is not None  # the package that draws bars there
    return bool(getattr(sys.stdout, "isatty", bool)())


@contextmanager
def reporting(progress: bool | Progress | None, limit: int) -> Iterator[Progress]:
    """Report steps nowhere, to a function, or to a bar on the terminal or in a notebook."""
    if callable(progress):
        yield progress
    elif progress or (progress is None and watched()):
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        left = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("left"))
        with Bars(TextColumn("{task.description}"), *left, transient=progress is None) as bars:
            task = bars.add_task("optimizing", total=limit)
            bars.refresh()  # a run may end before the bar's own clock ticks
            yield lambda step: bars.update(
                task, completed=step.iteration, description=f"loss {step.loss:.3g}, window {step.window:+.3f}"
            )
    else:
        yield lambda step: None
