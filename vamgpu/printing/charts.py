"""Charts of a report as inline SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from numbers import Real
from typing import Any

import numpy as np

from vamgpu.metrics import Scores, SliceScores
from vamgpu.metrics.histogram import Histogram
from vamgpu.metrics.parts import IN, OUT
from vamgpu.metrics.tolerance import ToleranceWindow
from vamgpu.reports.chart import EXTRA, GOOD, PART, REST, WARN, WIDE, above, svg
from vamgpu.reports.style import INK

HALF = 5.6  # width [inch] of a chart in a card beside another

ABSCISSA = {"evaluations": "projector evaluations", "iteration": "iteration"}
"""Fields of a history that can be the horizontal axis, best first, and their labels."""
ORDINATE = {"loss": "loss", "window": "strict window"}


def histogram_chart(found: Histogram, scores: Scores) -> str:
    """Voxels in and out of the part against dose, with the threshold and the window or overlap."""
    peak = scores.peak or 1.0
    edges = found.edges / peak

    def draw(axis: Any) -> None:
        for which, color, name in ((OUT, REST, "outside"), (IN, PART, "in the part")):
            axis.stairs(np.maximum(found.counts[0, which], 0.5), edges, baseline=0.5, fill=True, color=color, alpha=0.3)
            axis.stairs(np.maximum(found.counts[0, which], 0.5), edges, color=color, lw=1.4, label=name)
        low, high = sorted((scores.greatest_out / peak, scores.least_in / peak))
        good = scores.window > 0
        name = "process window" if good else "overlap"
        axis.axvspan(low, high, color=GOOD if good else WARN, alpha=0.12, lw=0, label=name)
        axis.axvline(scores.threshold / peak, color=INK, lw=1.2, ls=(0, (4, 3)), label="threshold")
        axis.set(yscale="log", xlim=(0, 1), ylim=(0.5, None), xlabel="dose / greatest dose", ylabel="voxels")
        above(axis, 4)

    return svg(draw, WIDE, 3.4)


def slices_chart(slices: SliceScores, z: np.ndarray, *, wide: bool = False) -> str:
    """Windows and wrong voxels of every slice against its height [mm], on one scale."""

    def draw(*axes: Any) -> None:
        axes[0].axhline(0, color=INK, lw=0.8)
        axes[0].plot(z, slices.window, color=PART, lw=1.6, marker="." if len(z) < 3 else None, label="strict window")
        axes[0].plot(z, slices.trimmed, color=REST, lw=1.4, label="1 % window")
        axes[0].set_ylabel("process window")
        above(axes[0], 2)
        axes[1].fill_between(z, slices.missing, color=WARN, alpha=0.7, lw=0, step="mid", label="missing")
        axes[1].fill_between(z, -slices.excess, color=EXTRA, alpha=0.8, lw=0, step="mid", label="excess")
        most = max(1, int(slices.missing.max()), int(slices.excess.max()))
        axes[1].set(ylabel="wrong voxels", xlabel="height z [mm]", ylim=(-1.15 * most, 1.15 * most))
        axes[1].yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
        axes[1].legend(ncols=2, loc="upper right")

    return svg(draw, WIDE if wide else HALF, 4.0, nrows=2, sharex=True)


def tolerance_chart(found: ToleranceWindow, pixel: float) -> str:
    """The window against the tolerance [µm], with a pixel [mm] marked, and the share of the part that it judges."""
    distance, window, marked = 1e3 * found.distance, found.window, 1e3 * pixel
    at_pixel = found.at(pixel) if marked <= distance[-1] else np.nan

    def draw(*axes: Any) -> None:
        axes[0].axhline(0, color=INK, lw=0.8)
        axes[0].plot(distance, window, color=PART, lw=2.0)
        for axis in axes:
            axis.axvline(marked, color=INK, lw=1.0, ls=(0, (4, 3)))
        if np.isfinite(at_pixel):
            axes[0].plot([marked], [at_pixel], "o", color=PART, ms=6)
        at, value = f"1 pixel = {marked:.3g} µm", f"{at_pixel:+.3f}".replace("-", "−")
        axes[0].annotate(f"{at}: {value}" if np.isfinite(at_pixel) else at, (marked, 1.0), (5, -3),
                         xycoords=("data", "axes fraction"), textcoords="offset points", va="top")  # fmt: skip
        axes[0].set(ylabel="process window W(δ)", xlim=(0, distance[-1]))
        axes[1].fill_between(distance, 100 * found.judged, color=REST, alpha=0.4, lw=0)
        axes[1].set(ylabel="judged [%]", ylim=(0, 100), xlabel="tolerance δ on either side of the surface [µm]")
        axes[0].margins(y=0.15)

    return svg(draw, HALF, 6.0, nrows=2, sharex=True, height_ratios=(3.4, 1))


def convergence_chart(history: Sequence[Any]) -> str | None:
    """Loss, and the process window if recorded, against projector evaluations; None without a history."""
    table = columns(history)
    over = next((name for name in ABSCISSA if name in table), None)
    shown = [name for name in ORDINATE if name in table and np.isfinite(table[name]).any()]
    if not shown or len(history) < 2:
        return None
    x = table[over] if over else np.arange(len(history))

    def draw(*axes: Any) -> None:
        for axis, name in zip(axes, shown, strict=True):
            usable = np.isfinite(table[name])
            axis.plot(x[usable], table[name][usable], color=PART, lw=1.6, marker=".", ms=4)
            positive = bool((table[name][usable] > 0).all())
            axis.set(ylabel=ORDINATE[name], yscale="log" if name == "loss" and positive else "linear")
        axes[-1].set_xlabel(ABSCISSA[over] if over else "record")

    return svg(draw, HALF, 4.0, nrows=len(shown), sharex=True)


def pareto_chart(points: Sequence[Any]) -> str:
    """Window, and ratio of mean dose outside to that inside, against the exposure time [s]."""
    table = columns(points)

    def draw(*axes: Any) -> None:
        for axis, name, label, color in (
            (axes[0], "window", "window", PART), (axes[1], "outside", "dose outside / inside", REST),
        ):  # fmt: skip
            axis.plot(table["seconds"], table[name], color=color, lw=1.6, marker="o", ms=4)
            axis.set(ylabel=label)
        axes[-1].set_xlabel("exposure [s]")

    return svg(draw, HALF, 4.0, nrows=2, sharex=True)


def columns(history: Sequence[Any]) -> dict[str, np.ndarray]:
    """Numeric fields of a history's records, by name; NaN if a record lacks one."""
    rows = [_fields(record) for record in history]
    names = dict.fromkeys(name for row in rows for name, value in row.items() if isinstance(value, Real))
    return {name: np.array([float(row[name]) if isinstance(row.get(name), Real) else np.nan for row in rows])
            for name in names}  # fmt: skip


def _fields(record: Any) -> dict[str, Any]:
    if is_dataclass(record):
        return {field.name: getattr(record, field.name) for field in fields(record)}
    return dict(record._asdict()) if hasattr(record, "_asdict") else dict(record)
