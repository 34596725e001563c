"""Folders of what is to be printed: README.md describes their files."""

from __future__ import annotations

import json
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from profiling.leaderboard import parts
from profiling.leaderboard.judge import SHAPES
from profiling.leaderboard.scores import inside, read_stl

PIXEL = 0.12
"""Width of a pixel in the resin at the axis [mm]."""
MARGIN = 3.0
"""Pixels beside the part that the projector can light."""
SPREAD = 0.5
"""Standard deviation of a pixel's blur [pixels]."""
SQUARE_COLUMNS = 1.5
"""Columns for a square vial over those for a round one: they reach all of the part through each face at 45°."""
AIR: dict[str, Any] = {
    "shape": "round", "radius": 7.0, "wall": 1.0, "resin_index": 1.5, "wall_index": 1.473, "bath_index": 1.0,
    "absorption": 0.08,
}  # fmt: skip
VIALS: dict[str, dict[str, Any]] = {
    "matched": AIR | dict.fromkeys(("resin_index", "wall_index", "bath_index"), 1.5),
    "air": AIR,
    "square": AIR | {"shape": "square"},
}
JUDGED = """part = "part.stl"

[vial]
{vial}

[projector]
pitch = {pitch:.9g}
spread = {spread:.9g}
lit_share = 1.0
irradiance = 0.65

[resin]
critical_dose = 0.05
"""


def make(folder: Path, part: str, vial: str, size: float, angles: int) -> Path:
    """Write a part of ``size`` pixels of radius in a vial, for a projector of so many angles a turn."""
    folder.mkdir(parents=True, exist_ok=True)
    values = dict(VIALS[vial])
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in values.items())
    shape = values.pop("shape")
    solid = parts.write(part, size, PIXEL, folder / "part.stl")
    pitch = PIXEL / SHAPES[shape](**values).magnification
    columns = 2 * ceil((size + MARGIN) * (SQUARE_COLUMNS if shape == "square" else 1.0))
    rows = 2 * ceil(0.5 * solid.height / pitch + 0.5 * MARGIN)
    (folder / "judge.toml").write_text(JUDGED.format(vial=lines, pitch=pitch, spread=SPREAD * pitch), encoding="utf-8")
    (folder / "frames.json").write_text(json.dumps({"angles": angles, "columns": columns, "rows": rows}) + "\n")
    x, z = ((np.arange(n) - 0.5 * (n - 1)) * width for n, width in ((columns, PIXEL), (rows, pitch)))
    np.save(folder / "voxels.npy", inside(read_stl(folder / "part.stl"), x, x, z))
    return folder
