"""Cross-sections, maps and charts of a report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.curethrough.dose import column_doses
from vamgpu.curethrough.printer import Machine
from vamgpu.curethrough.score import cured
from vamgpu.reports.chart import PART, WIDE, above, colored, picture, svg
from vamgpu.reports.page import Image
from vamgpu.reports.style import GLASS, INK, ORANGE

if TYPE_CHECKING:
    from vamgpu.curethrough.job import Outcome

VOID, PRINTED, MISSING, EXCESS = (255, 255, 255), (176, 190, 208), (214, 58, 73), (240, 150, 32)
MOST_PIXELS = 480  # greatest number of pixels along a side of a picture; larger ones are thinned
MOST_DOSE = 3.0  # dose, in critical doses, that is drawn brightest
CHARTED = 4


def thinned(plane: np.ndarray) -> np.ndarray:
    """A plane with at most `MOST_PIXELS` along its first two axes."""
    steps = [max(1, -(-n // MOST_PIXELS)) for n in plane.shape[:2]]
    return plane[:: steps[0], :: steps[1]]


def verdict(machine: Machine, shown: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Colors of right, missing and excess voxels in columns [slice, column], the platform below; uint8 [.., 3]."""
    done = cured(machine, shown) >= 0.5
    target = np.zeros(shown.shape, bool)
    target[: len(solid)] = solid
    colors = np.array([VOID, EXCESS, MISSING, PRINTED], np.uint8)
    return thinned(colors[2 * target + done][::-1])


def doses(machine: Machine, shown: np.ndarray) -> np.ndarray:
    """Dose of columns [slice, column], the platform below; uint8 [.., 3]."""
    return colored(thinned(column_doses(machine, shown)[:-1][::-1]) / MOST_DOSE, "magma")


def sections(outcome: Outcome) -> list[list[Image]]:
    """Verdict and dose before and after, along a row and along a column of pixels."""
    found = []
    for which in (outcome.sample.across, outcome.sample.along):
        row = []
        for name, shown in (("uncorrected", outcome.before), ("corrected", outcome.after)):
            if shown is None:
                continue
            levels, solid = shown.levels[:, which], outcome.solid[:, which]
            row.append(Image(picture(verdict(outcome.machine, levels, solid)), f"print, {name}"))
            row.append(Image(picture(doses(outcome.machine, levels)), f"dose, {name}"))
        found.append(row)
    return found


def maps(outcome: Outcome) -> tuple[list[Image], float]:
    """Excess and missing heights from above, and the height [mm] drawn brightest, the same for all."""
    shown = [("uncorrected", outcome.before), *([("corrected", outcome.after)] if outcome.after else [])]
    kinds = [(kind, name, getattr(one.heights, key)) for name, one in shown
             for kind, key in (("excess", "over"), ("missing", "under"))]  # fmt: skip
    most = max(float(values.max()) for _, _, values in kinds) or 1.0
    drawn = [Image(picture(colored(thinned(values) / most, "magma")), f"{kind}, {name}")
             for kind, name, values in kinds]  # fmt: skip
    return drawn, most


def charted(outcome: Outcome) -> list[int]:
    """Columns for charts: with different numbers of features, those that print worst without correction."""
    found = outcome.before.features
    count = len(outcome.sample.rows)
    number = np.bincount(found.column, minlength=count)
    error = np.bincount(found.column, found.error, minlength=count)
    chosen: list[int] = []
    for features in sorted(set(number[number > 0].tolist()), reverse=True):
        chosen.append(int(np.argmax(np.where(number == features, error, -1.0))))
    for k in np.argsort(-error, kind="stable"):
        alike = any((outcome.solid[:, k] == outcome.solid[:, other]).all() for other in chosen)
        if len(chosen) < CHARTED and number[k] and not alike:
            chosen.append(int(k))
    return sorted(chosen[:CHARTED])


def columns_chart(outcome: Outcome) -> str:
    """Dose over height of a few columns before and after, as inline SVG."""
    chosen = charted(outcome) or [0]

    def draw(*axes: Any) -> None:
        for axis, k in zip(axes, chosen, strict=True):
            _column(axis, outcome, k)
        above(axes[0], 4)
        axes[-1].set_xlabel("height above the platform [mm]")

    return svg(draw, WIDE, 1.0 + 1.7 * len(chosen), nrows=len(chosen), sharex=True)


def _column(axis: Any, outcome: Outcome, k: int) -> None:
    height = outcome.machine.slice_height
    change = np.diff(outcome.solid[:, k].astype(int), prepend=0, append=0)
    label = "part"
    for front, back in zip(np.flatnonzero(change > 0), np.flatnonzero(change < 0), strict=True):
        axis.axvspan(front * height, back * height, color=GLASS, alpha=0.6, lw=0, label=label)
        label = ""
    top = 1.5
    for shown, color, name in ((outcome.before, ORANGE, "uncorrected"), (outcome.after, PART, "corrected")):
        if shown is not None:
            dose = column_doses(outcome.machine, shown.levels[:, k])
            axis.plot(height * np.arange(len(dose)), dose, color=color, lw=1.5, label=name)
            top = max(top, 1.1 * float(dose.max()))
    axis.axhline(1.0, color=INK, lw=1.0, ls=(0, (4, 3)), label="critical dose")
    row, column = outcome.sample.rows[k], outcome.sample.columns[k]
    axis.set(ylim=(0, top), ylabel="Ω")
    axis.set_title(f"row {row}, column {column}", loc="right", fontsize=9.5)
