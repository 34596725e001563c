"""A scale bar in a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vamgpu.reports.style import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def scale_bar(axis: Axes, length: float, label: str, *, below: bool = False) -> None:
    """A scale bar of a length in the units of the picture's axes, white in its lower left corner or dark below it."""
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    x, y = left + 0.05 * (right - left), low + (-0.03 if below else 0.06) * (high - low)
    color = INK if below else "white"
    axis.plot([x, x + length], [y, y], color=color, lw=2.5, solid_capstyle="butt", clip_on=False)
    axis.text(x, y + (-0.02 if below else 0.025) * (high - low), label, color=color, fontsize=8.5,
              va="top" if below else "bottom")  # fmt: skip
    axis.set(xlim=(left, right), ylim=(low, high))
