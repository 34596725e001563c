"""One look for all pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, QUIET, FAINT = "#1f2733", "#6b7787", "#d5dae1"
BLUE, ORANGE, RED, GREEN, GLASS, RESIN = "#2563a8", "#e8901a", "#d63a49", "#1d9a5b", "#cfe3f2", "#fdf3e1"
HUES = (BLUE, ORANGE, GREEN, RED, "#7a4fb5", "#12939a", "#a0652c", "#c2559d", "#4d5866", "#a8a01e", "#5b8c5a")
LIGHT, DOSE, GAP, SOLID = "inferno", "magma", "RdBu_r", "Greys"
"""Color maps of light, of dose, of signed differences, and of filled fractions."""

LARGEST = 140_000  # size of a full-color PNG above which it gets a palette [bytes]

WIDTH = 10.0
DPI = 110

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": FAINT,
    "axes.titlesize": 10.0, "axes.titlelocation": "left", "axes.titleweight": "bold", "axes.titlepad": 7.0,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#eef1f5", "xtick.color": QUIET, "ytick.color": QUIET, "xtick.labelcolor": INK,
    "ytick.labelcolor": INK, "legend.frameon": False, "legend.fontsize": 9.0, "lines.linewidth": 1.7,
    "figure.facecolor": "white", "savefig.dpi": DPI, "figure.dpi": DPI, "figure.constrained_layout.h_pad": 0.09,
    "figure.constrained_layout.w_pad": 0.09,
}  # fmt: skip


@contextmanager
def styled() -> Iterator[None]:
    """Draw and save inside this context: matplotlib reads parts of a style only when it needs them."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        yield


def sheet(mosaic: str | list[Any], height: float, **options: Any) -> tuple[Figure, dict[str, Axes]]:
    """An empty figure of the gallery's width [inch] and its panels by letter, in the form of `subplot_mosaic`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplot_mosaic(mosaic, **options)  # type: ignore[return-value]


def shown(axis: Axes, plane: np.ndarray, title: str, pitch: float | None = None, **options: Any) -> Any:
    """A plane [horizontal, vertical] as a picture; with a pitch [mm] its axes are in mm, without ticks otherwise."""
    extent = None
    if pitch is not None:
        half = [0.5 * n * pitch for n in plane.shape]
        extent = (-half[0], half[0], -half[1], half[1])
    options = {"cmap": DOSE, "interpolation": "nearest", **options}
    drawn = axis.imshow(plane.T, origin="lower", extent=extent, **options)
    axis.set_title(title)
    axis.grid(False)
    if pitch is None:
        bare(axis)
    return drawn


def bare(axis: Axes) -> None:
    """No ticks and no frame."""
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def bar(drawn: Any, axis: Axes | list[Axes], label: str, **options: Any) -> None:
    """A thin color bar next to one or more panels."""
    first = axis[0] if isinstance(axis, list) else axis
    made = first.figure.colorbar(drawn, ax=axis, label=label, **{"fraction": 0.045, "pad": 0.02, **options})
    made.outline.set_visible(False)


def png(figure: Figure) -> bytes:
    """The figure as a small PNG, the same bytes for the same picture; with a palette of 256 colors if necessary."""
    from PIL import Image

    drawn, small = BytesIO(), BytesIO()
    with styled():
        figure.savefig(drawn, format="png")
    with Image.open(drawn) as opened:
        full = opened.convert("RGB")
    full.save(small, "PNG", optimize=True)
    if small.tell() <= LARGEST:
        return small.getvalue()
    while True:
        few, small = full.quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=1, dither=Image.Dither.NONE), BytesIO()
        few.save(small, "PNG", optimize=True)
        if small.tell() <= LARGEST:
            return small.getvalue()
        full = full.resize((int(0.9 * full.width), int(0.9 * full.height)), Image.Resampling.LANCZOS)
