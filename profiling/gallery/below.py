"""One part with four sets of patterns, each judged on finer voxels while the vial turns."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

import vamgpu
from profiling.below_voxel import SHAPES, Judge, found, part, posed
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, SamplingWarning
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Places = tuple[np.ndarray, np.ndarray]
"""Centers of a picture's voxels along x and z [mm]."""
COARSE = 2.0
"""Ratio of the width of coarse voxels to that of a pixel in the resin."""
LIGHTS = (
    ("L-BFGS, voxels of 2 pixels", "lbfgs", COARSE, 1.0),
    ("L-BFGS, voxels of ¾ pixel", "lbfgs", 0.75, 1.0),
    ("as b, optimized for rest", "lbfgs", 0.75, 0.0),
    ("default", "ramp", 0.75, 1.0),
)
"""Title, method, width of voxels relative to a pixel, and lit share used to find the patterns."""
MISSING, EXCESS, RIGHT, VOID = style.BLUE, style.RED, "#8d97a5", "#ffffff"
BRIGHTEST = 1.25
"""Dose, relative to the threshold, at the end of the color scale."""


def below(
    device: Device, quick: bool = False, shape: str = "boat", size: float = 32.0, angles: int = 60,
    evaluations: int = 120,
) -> Picture:  # fmt: skip
    """A part with a radius of ``size`` pixels; patterns from coarse voxels, fine ones, rest, and the default method."""
    if shape not in SHAPES:
        raise BadInput(f"shape is {shape!r}; expected one of {', '.join(SHAPES)}")
    size, most, turn = (8.0, 8, 24) if quick else (float(size), int(evaluations), int(angles))
    solid = part(shape)
    job = posed(solid, size, device, turn)
    judge, rows, doses = Judge.of(job), [], []
    for title, method, voxel, lit_share in LIGHTS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # coarse voxels cause a justified warning
            plan = found(posed(solid, size, device, turn, voxel, lit_share), method, most)
        light = vamgpu.pack(plan).irradiance(device).numpy()
        numbers, dose = judge.judge(light, job.A.motion)
        rows.append((title, numbers | {"claimed": plan.window, "peak": float(light.max() / light.mean())}))
        doses.append(dose)
    figure, axes = style.sheet("abcd;efgh;iijj", 5.9, height_ratios=(1.0, 1.0, 0.05))
    middle, (x, z) = judge.axes[0].size // 2, judge.axes
    high = np.abs(z) <= 0.5 * solid.height + 2.0 * job.pixel
    wide = np.abs(x) <= solid.radius + 2.0 * job.pixel
    at = x[wide], z[high]
    inside = judge.filled[wide, middle][:, high]
    for k, ((title, numbers), dose) in enumerate(zip(rows, doses, strict=True)):
        plane = dose[wide, middle][:, high]
        drawn = _dose(axes["abcd"[k]], plane, inside, at, f"({'abcd'[k]}) {title}")
        _printed(axes["efgh"[k]], plane >= 1.0, inside, at, _under(numbers))
    bar = figure.colorbar(drawn, cax=axes["i"], orientation="horizontal", label="dose over threshold")
    bar.outline.set_visible(False)
    kinds = ((RIGHT, "right"), (EXCESS, "excess"), (MISSING, "missing"))
    axes["j"].legend(handles=[_patch(*kind) for kind in kinds], loc="center", ncols=3, handlelength=0.9)
    axes["j"].set_axis_off()
    letters = "abcd"
    facts = (
        Fact("width of a pixel in the resin", 1e3 * job.pixel, "µm", 3),
        Fact("angles of a turn", job.A.motion.angles, "", 3),
        *(Fact(f"{each} of the mesh", rows[0][1][f"{each} of the mesh"], "", 3) for each in ("bodies", "voids")),
    )
    keys = ("claimed", "W0.5", "W1", "bodies", "voids", "rms", "p95", "peak")
    table = Table(
        ("patterns", "claimed", "W ½ pixel", "W 1 pixel", "bodies", "voids", "RMS [µm]", "95 % [µm]", "peak ÷ mean"),
        ("+.3f", "+.3f", "+.3f", ".0f", ".0f", ".0f", ".0f", ".0f"),
        tuple((f"{letter}, {title}", tuple(numbers[key] for key in keys))
              for letter, (title, numbers) in zip(letters, rows, strict=True)),
    )  # fmt: skip
    return Picture(figure, _caption(most), facts, table)


def _caption(evaluations: int) -> str:
    return (
        f"Four sets of patterns for one part, with the same pixels, angles and {evaluations} projector evaluations. An "
        "independent judge exposes them on voxels of half a pixel while the vial turns. Above, the dose in the plane y "
        "= 0 with the outline of the mesh. Below, the print: correct in gray, excess in red, missing in blue. W at a "
        "distance is the least dose at least that deep in the part minus the greatest at least that far outside, "
        "divided by the peak.\n\n"
        "The claimed window uses the mean doses of the voxels on which the patterns were optimized. Voxels of two "
        "pixels hide how the dose varies inside them. The default makes the dose rise from one pixel outside the "
        "surface to one inside."
    )


def _dose(axis: Axes, plane: np.ndarray, inside: np.ndarray, at: Places, title: str) -> Any:
    drawn = _shown(axis, plane, at, cmap=style.DOSE, vmin=0.0, vmax=BRIGHTEST)
    axis.set_title(title, fontsize=8.0)
    axis.contour(*at, inside.T, levels=[0.5], colors="#7ef0e2", linewidths=0.8)
    return drawn


def _printed(axis: Axes, solid: np.ndarray, filled: np.ndarray, at: Places, under: str) -> None:
    from matplotlib.colors import ListedColormap

    inside = filled >= 0.5
    kinds = np.where(solid, np.where(inside, 1, 2), np.where(inside, 3, 0))
    _shown(axis, kinds, at, cmap=ListedColormap([VOID, RIGHT, EXCESS, MISSING]), vmin=0, vmax=3)
    axis.contour(*at, filled.T, levels=[0.5], colors=style.INK, linewidths=0.5)
    axis.set_xlabel(under, fontsize=8.0, loc="left")


def _patch(color: str, name: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=color, label=name)


def _shown(axis: Axes, plane: np.ndarray, at: Places, **options: Any) -> Any:
    half = 0.5 * (at[0][1] - at[0][0])
    extent = tuple(float(end) for axis_ in at for end in (axis_[0] - half, axis_[-1] + half))
    drawn = axis.imshow(plane.T, origin="lower", extent=extent, interpolation="nearest", **options)
    axis.grid(False)
    style.bare(axis)
    return drawn


def _under(numbers: dict[str, float]) -> str:
    return (
        f"W(½ pixel) {numbers['W0.5']:+.3f}, W(1) {numbers['W1']:+.3f}\n"
        f"bodies {numbers['bodies']:.0f} of {numbers['bodies of the mesh']:.0f}, "
        f"voids {numbers['voids']:.0f} of {numbers['voids of the mesh']:.0f}\n"
        f"surface RMS {numbers['rms']:.0f} µm, 95 % {numbers['p95']:.0f} µm"
    )
