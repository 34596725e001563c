"""Position of the roller's axis: columns of mirrors are lit one after another, and a photodiode detects the shadow."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.calibration.axis import RollerAxis, find_axis
from vamgpu.errors import BadInput
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import CalibrationMachines, Progress, over_patterns, silent
from vamgpu.hosts.calibrate.report import CalibrationResult

TABLES = ("photodiode",)  # tables of a rig's file that it needs
DARK = 8  # readings without light


def axis(
    machines: CalibrationMachines, *, first: int = 0, stop: int | None = None, every: int = 1, repeats: int = 4,
    radius: float | None = None, flip_r: bool = False, projector: int = 0,
    progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Find the roller's axis and radius [columns]; BadInput if the scan finds no edge of its shadow."""
    screen = machines.screen(projector)
    last = screen.shape[1] if stop is None else stop
    if every < 1 or repeats < 1 or not 0 <= first < last <= screen.shape[1]:
        raise BadInput(
            f"a scan of columns {first} to {last}, every {every}, {repeats} readings each; expected columns within 0 "
            f"to {screen.shape[1]}, and at least 1 for the other two"
        )
    columns = np.arange(first, last, every)
    lit = (patterns.line(screen.shape, int(column)) for column in columns)
    dark, read = over_patterns(machines, projector, lit, columns.size, machines.read, repeats, progress, darks=DARK)
    found = find_axis(read.mean(axis=1), columns, radius=radius)
    shift = found.shift(screen.shape[1], flip_r=flip_r)
    numbers = {
        "column": found.column, "error_columns": found.error, "radius_columns": found.radius, "shift_columns": shift,
        "edges": [edge.column for edge in found.edges], "edge_errors": [edge.error for edge in found.edges],
        "edge_widths": [edge.width for edge in found.edges],
    }  # fmt: skip
    lines = (
        ("axis", f"column {found.column:.3f} ± {found.error:.2g}"),
        ("radius", f"{found.radius:.3f} columns"),
        ("edges", ", ".join(f"{edge.column:.3f}" for edge in found.edges)),
        ("for the job", f"[frames] shift = [{shift:.3f}, 0.0]"),
    )
    readings = {"columns": columns, "readings": read, "dark": dark}
    return CalibrationResult("axis", numbers, readings, lines, lambda axes: _draw(axes, found, columns, read))


def _draw(axes: Any, found: RollerAxis, columns: np.ndarray, read: np.ndarray) -> None:
    axes.plot(columns, read.mean(axis=1), ".", color="#2563a8", ms=3)
    for place in (*(edge.column for edge in found.edges), found.column):
        axes.axvline(place, color="#1f2733", lw=0.8, ls=":" if place != found.column else "-")
    axes.set(title=f"Axis at column {found.column:.2f}", xlabel="lit column", ylabel="photodiode [mW]")
