"""A film of a recorded print: for each turn, the camera image and what was estimated from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.geometry import positive
from vamgpu.live.loop import Decision
from vamgpu.live.maps import BRIGHT, cuts
from vamgpu.live.record import LiveRecord
from vamgpu.quantity import counted
from vamgpu.reports import style
from vamgpu.storage.films import write_film

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES = {"sensitivity": style.BLUE, "absorption": style.ORANGE, "inhibitor": style.GREEN}
"""Estimates that are drawn against the turns; all are 1 if nothing deviates."""


def film(record: LiveRecord, path: str | Path, rate: float = 1.0) -> Path:
    """Write a video (.mp4) of a recorded print; every turn is computed again. rate: images per second, one per turn."""
    return write_film(path, pictures(record), positive("rate [turns/s]", rate))


def pictures(record: LiveRecord) -> Iterator[np.ndarray]:
    """One picture per turn, uint8 [row, column, color], all of one size."""
    part, open_field, count = record.part(), record.setup().open_field, len(record.decided())
    before: list[Decision] = []
    for _, frames, decision in record.again():
        before.append(decision)
        yield _pixels(drawn(part, frames, before, open_field, count))
        before[-1] = replace(decision, dose=None, conversion=None)  # fields of all turns would fill a device


def drawn(part: np.ndarray, frames: np.ndarray, decisions: Sequence[Decision], open_field: float, count: int) -> Figure:
    """A figure of one turn: its frames, and the decisions so far and the next one. count: turns of the whole print."""
    now = decisions[-1]
    with style.styled():
        figure, axes = style.sheet("cdv;ppp", 4.8, height_ratios=(1.4, 1.0), width_ratios=(1.0, 1.5, 1.5))
        image = next((each for each in frames if np.isfinite(each).all()), np.zeros(frames.shape[1:]))
        style.shown(axes["c"], image.T, "camera", cmap="gray", vmin=0.6 * open_field, vmax=1.05 * open_field)
        for panel, title, values, most, colors in (
            ("d", "dose, as estimated", now.dose, BRIGHT, style.DOSE),
            ("v", "conversion, as seen", now.conversion, 1.0, "viridis"),
        ):
            axes[panel].imshow(cuts(np.zeros(part.shape) if values is None else values, part, most, colors))
            axes[panel].set_title(title)
            axes[panel].grid(False)
            style.bare(axes[panel])
        _curves(axes["p"], decisions, count)
        figure.suptitle(f"after turn {now.turn}: {now.action}, light {now.version}, {counted(now.turns, 'turn')} to go",
                        x=0.01, ha="left", fontweight="bold")  # fmt: skip
    return figure


def _pixels(figure: Figure) -> np.ndarray:
    with style.styled():
        canvas: Any = figure.canvas
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _curves(axis: Any, before: Sequence[Decision], count: int) -> None:
    found = [each for each in before if each.parameters]
    for name, color in CURVES.items():
        pairs = np.array([each.parameters.get(name, (each.inhibitor, 0.0)) for each in found]).reshape(-1, 2)
        turns = [each.turn for each in found]
        axis.errorbar(turns, pairs[:, 0], pairs[:, 1], marker="o", markersize=4, capsize=2.5, color=color, label=name)
    axis.axhline(1.0, color=style.FAINT, lw=1.0)
    axis.set(xlim=(0.5, count + 0.5), ylim=(0.3, 1.5), xlabel="turn", title="over planned")
    axis.legend(loc="upper left", ncols=len(CURVES))
