"""Charts and pictures of reports: one set of colors, inline SVG, and data URLs."""

from __future__ import annotations

import base64
from collections.abc import Callable
from io import BytesIO, StringIO
from typing import Any

import numpy as np

from vamgpu.reports.style import BLUE, FAINT, INK, RED

PART, REST, EXTRA, WARN, GOOD = BLUE, "#9aa5b4", "#f09620", RED, "#1d9a5b"
"""Colors of: the part; the outside; excess resin; errors; the target."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 10.5, "axes.edgecolor": FAINT,
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK, "ytick.color": INK, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.color": "#eef1f5", "axes.axisbelow": True,
    "legend.frameon": False, "svg.hashsalt": "vamgpu",
}  # fmt: skip
QUICK: dict[str, Any] = {"method": 0, "quality": 20}
"""Settings of WebP: a slice has 140 kB, in a fifth of the time that 105 kB would take; as PNG it has 235 kB."""
LARGEST = 16383  # greatest number of rows or columns of an image in WebP
WIDE, NARROW = 11.6, 7.2  # widths [inch] of a chart in a card over both columns, and over one


def svg(draw: Callable[..., None], width: float, height: float, **layout: Any) -> str:
    """Draw a chart as inline SVG."""
    # width [inch]; height [inch]
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        draw(*figure.subplots(squeeze=False, **layout).ravel())
        stream = StringIO()
        figure.savefig(stream, format="svg", transparent=True, dpi=150, metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :].replace("sans-serif", "inherit")


def above(axis: Any, columns: int) -> None:
    """Put the legend above an axis."""
    axis.legend(ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def picture(pixels: np.ndarray) -> str:
    """Encode an image as a data URL."""
    # pixels [row, column] [row, column, channel]; lossless WebP takes 1/5 of the time of the smallest PNG, less room
    from PIL import Image

    stream = BytesIO()
    kind, how = ("WEBP", {"lossless": True, **QUICK}) if max(pixels.shape) <= LARGEST else ("PNG", {})
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, kind, **how)
    return f"data:image/{kind.lower()};base64,{base64.b64encode(stream.getvalue()).decode()}"


def colored(values: np.ndarray, name: str) -> np.ndarray:
    """Colors for values, from a matplotlib color map."""
    # values [row, column]; returns [row, column, channel]
    from matplotlib import colormaps

    return (colormaps[name](np.clip(values, 0, 1))[..., :3] * 255).round().astype(np.uint8)
