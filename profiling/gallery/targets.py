"""The bundled parts, drawn as solids."""

from __future__ import annotations

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.render import rendered
from vamgpu.backend.device import Device
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE
from vamgpu.reports import style
from vamgpu.targets.shapes import build, names
from vamgpu.targets.target import Target

FLAT = ("exposure_disk", "gears_0um", "gears_50um", "gears_100um", "crossing_channels")
"""Parts that are seen more from above."""
PRINTABLE = 8.27


def targets(
    device: Device, quick: bool = False, voxels: float = 128.0, azimuth: float = -55.0, elevation: float = 26.0
) -> Picture:
    """``voxels`` along the longest edge of each part for the volumes; the direction of view in degrees."""
    chosen = ("boat", "nut", "gear_base", "crossing_channels") if quick else names()
    figure, axes = style.sheet([chosen[k : k + 4] for k in range(0, len(chosen), 4)], 2.65 * ((len(chosen) + 3) // 4))
    rows = []
    for name in chosen:
        solid = build(name)
        up = elevation + 24.0 * (name in FLAT)
        axes[name].imshow(rendered(solid, 60 if quick else 270, azimuth, up), interpolation="nearest")
        axes[name].set_title(name)
        axes[name].grid(False)
        style.bare(axes[name])
        pitch = max(solid.height, 2.0 * solid.radius) / (24 if quick else voxels)
        target = Target.from_mesh(solid, factor=1.0, pitch=pitch, device=device)
        gap = 100.0 * (target.volume / solid.volume - 1.0)
        lit = 100.0 * float(np.mean(np.isin(target.numpy(), (0.0, 1.0), invert=True)))
        rows.append((name, (solid.height, solid.radius, solid.volume, float(len(solid.faces)), gap, lit)))
    table = Table(
        ("part", "height [mm]", "radius [mm]", "volume [mm³]", "triangles", "volume of voxels − mesh [%]",
         "voxels filled in part [%]"),
        (".2f", ".3f", ".2f", ",.0f", "+.4f", ".1f"), tuple(rows),
    )  # fmt: skip
    largest = max(row[1][1] for row in rows)
    facts = (
        Fact("largest radius of a part", largest, "mm", expected=PRINTABLE,
             source="printable radius in the paper's vial", bound="≤"),
        Fact("largest deviation of a volume", max(abs(row[1][4]) for row in rows), "%", 2,
             expected=0.1, bound="≤"),
    )  # fmt: skip
    caption = (
        "Test parts that the package generates from formulas: a boat with every feature that is hard to print, the "
        "disk that calibrates exposure, and the other prints of the automatic exposure paper: crossing channels of 300 "
        "µm, a ¼-20 screw and nut, gears with gaps of 0, 50 and 100 µm, a gyroid sphere, a cubic lattice, and a "
        f"pentamode whose cones touch over 0.13 mm. The table compares volumes of voxels, {voxels:g} along the longest "
        "edge, with those of the meshes."
    )
    return Picture(figure, caption, facts, table, (AUTOMATIC_EXPOSURE,))
