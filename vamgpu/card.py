"""Cards of objects in notebooks: a title, small pictures, and numbers with their units."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from html import escape
from io import BytesIO

import numpy as np

LARGEST = 2**25  # largest number of values of an array that is drawn as a picture; larger arrays are shown as numbers
SIDE = 220  # pixels along the longer side of a picture


def card(title: str, numbers: Mapping[str, object], pictures: Mapping[str, np.ndarray | None] | None = None) -> str:
    """Self-contained HTML of one object; all text is escaped."""
    # numbers: name → value, with its unit in brackets if it has one. pictures: caption → plane [horizontal, vertical],
    # drawn from dark (least value) to bright (greatest); None if too large.
    drawn = "".join(_figure(caption, plane) for caption, plane in (pictures or {}).items())
    aside = "text-align:left;vertical-align:top"
    rows = "".join(
        f"<tr><th style='{aside};padding-right:1em'>{escape(name)}</th>"
        f"<td style='{aside}'>{escape(str(value))}</td></tr>"
        for name, value in numbers.items()
    )
    side_by_side = "display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start"
    return f"<div><b>{escape(title)}</b><div style='{side_by_side}'>{drawn}<table>{rows}</table></div></div>"


def drawable(shape: tuple[int, ...]) -> bool:
    """Whether an array of a shape is small enough, up to `LARGEST` values, to be copied for a picture."""
    return int(np.prod(shape, dtype=np.int64)) <= LARGEST


def _figure(caption: str, plane: np.ndarray | None) -> str:
    seen = "<i>too large to be drawn here</i>" if plane is None else _image(caption, plane)
    return f"<figure style='margin:0'>{seen}<figcaption>{escape(caption)}</figcaption></figure>"


def _image(caption: str, plane: np.ndarray) -> str:
    from matplotlib import colormaps
    from PIL import Image

    values = np.nan_to_num(np.asarray(plane, dtype=np.float64).T[::-1])
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    levels = np.round(255 * (values - low) / ((high - low) or 1.0)).astype(np.uint8)
    colors = np.round(255 * colormaps["inferno"](np.arange(256))[:, :3]).astype(np.uint8)
    image = Image.fromarray(colors[levels])
    scale = SIDE / max(image.size)
    width, height = (max(1, round(side * scale)) for side in image.size)
    file = BytesIO()
    image.resize((width, height), Image.Resampling.NEAREST if scale > 1 else Image.Resampling.BOX).save(file, "PNG")
    data = b64encode(file.getvalue()).decode("ascii")
    return f"<img alt='{escape(caption, quote=True)}' width='{width}' src='data:image/png;base64,{data}'>"
