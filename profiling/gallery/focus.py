"""A focus that follows a roller: planes, masks, divided frames, and the power of the lens in every slot."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians
from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.methods.papers import ROLL_TO_ROLL
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks, bins_needed, slots, split
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.reports import style
from vamgpu.web import WebGrid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SLOPES = {1.0: -40.0, 1.33: -53.2, 1.45: -58.0}
"""Index → mm/dpt, as the paper's table S3 has them."""
DEPTH_OF_FOCUS = 3.8
CELL = 3.0


def focus(
    device: Device,
    quick: bool = False,
    radius: float = 7.5,
    thickness: float = 3.0,
    bins: float = 3,
    pitch: float = 0.06,
    bath_index: float = 1.33,
    pose_ms: float = 98.2,
) -> Picture:
    """The focus scan of the roll-to-roll paper."""
    film = Film(thickness, 1.49, bath_index, 0.22)
    roller = Roller(radius, film, radians(0.5), rays=2 if quick else 6)
    beam = roller.beam(0.3 if quick else pitch, 80 if quick else 120)
    lens = TunableLens(index=bath_index, bins=int(bins))
    masks = FocusMasks.around(beam, radius, thickness, lens.bins)
    frame = _frame(roller, masks, beam, device)
    binned = split(frame, masks)
    total = np.sum([part.images.numpy().astype(int) for part in binned], axis=0)
    apart = float(np.abs(total - frame.images.numpy()).max())
    figure, axes = style.sheet("aab;cde;fff", 8.8, height_ratios=[1.25, 0.42, 0.6])
    _roller(axes["a"], roller, masks)
    _defocus(axes["b"], masks, beam, radius, thickness)
    shades = [part.gray_levels()[0] for part in binned]
    for letter, shade, plane in zip("cde", _shown(shades), masks.planes, strict=False):
        style.shown(axes[letter], shade[::-1].T, f"Bin at {plane:.1f} mm", cmap="gray", vmin=0, vmax=255)
    powers = lens.power(np.array(masks.planes))
    _drive(axes["f"], powers, 1e-3 * pose_ms, lens)
    rows = tuple((f"n = {n:g}", (replace(lens, index=n).slope, wanted)) for n, wanted in SLOPES.items())
    table = Table(("medium", "slope [mm/dpt]", "paper, table S3 [mm/dpt]"), ("+.2f", "+.1f"), rows)
    facts = (
        Fact("defocus of the worst column", float(masks.defocus.max()), "mm", 3, 0.5 * DEPTH_OF_FOCUS,
             "half the depth of focus", "≤"),
        Fact("focus planes needed", bins_needed(beam, radius, thickness, 0.5 * DEPTH_OF_FOCUS), "", 2, 3, "paper"),
        Fact("largest difference between the sum of the binned frames and the frame", apart, "levels", expected=0.0),
        Fact("share of the light in the bin next to the projector", 100 * float(shades[0].sum() / total.sum()), "%", 3),
        Fact("range of the lens's power over the planes", float(np.ptp(powers)), "dpt", 3),
    )  # fmt: skip
    caption = (
        "A film on a roller is curved, so at any one depth only the part that faces the light is in focus. The columns "
        "of every frame are therefore divided among the focus planes of a tunable lens, one sub-frame for each plane. "
        "A column goes to the plane nearest to the middle of its film; the planes lie where the worst column is as "
        "sharp as possible. The sub-frames add up exactly to the frame. The lens moves to the power of a plane and "
        "settles; then that sub-frame is shown. If the order of planes reverses at each angle, the lens need not move "
        "between angles. The frame shown is the projection of a gyroid film at one angle."
    )
    return Picture(figure, caption, facts, table, (ROLL_TO_ROLL,))


def _frame(roller: Roller, masks: FocusMasks, beam: Any, device: Device) -> Frames:
    """An 8-bit frame: the projection of a sheet gyroid at one angle."""
    from scipy.sparse import csr_matrix

    rows = beam.pixels[1]
    layers = max(4, round(roller.film.thickness / beam.pitch / 2))
    grid = WebGrid((1, layers, rows), (2 * beam.pitch, roller.film.thickness / layers, beam.pitch))
    light = roller.propagation(grid, beam)
    columns, _, length = light.shape
    window = WebGrid((length, layers, rows), grid.edges)
    l, rho, z = (2.0 * pi / CELL * axis for axis in window.axes())  # noqa: E741
    l, rho = l[None, :, None], rho[:, None, None]  # noqa: E741
    wave = np.sin(rho) * np.cos(l) + np.sin(l) * np.cos(z) + np.sin(z) * np.cos(rho)
    solid = (np.abs(wave) < 0.5).reshape(layers * length, rows).astype(np.float64)
    matrix = csr_matrix((light.weight, (light.r, light.rho * length + light.l)), (columns, layers * length))
    sent = matrix @ solid
    levels = np.round(255.0 * np.clip(sent / np.quantile(sent, 0.999), 0.0, 1.0)).astype(np.uint8)
    picture = np.ascontiguousarray(levels.T[None, ::-1])
    return Frames.from_bytes(picture, device, bits=8, gray=GrayCurve.linear(), scale=1.0, columns=columns)


def _shown(shades: list[np.ndarray]) -> list[np.ndarray]:
    """At most three pictures: the first, the middle and the last."""
    return [shades[round(i * (len(shades) - 1) / 2)] for i in range(3)] if len(shades) > 3 else shades


def _roller(axis: Axes, roller: Roller, masks: FocusMasks) -> None:
    from matplotlib.patches import Circle, Wedge

    outer = roller.outer
    axis.add_patch(Wedge((0, 0), outer, 180, 360, width=roller.film.thickness, fc=style.RESIN, ec="none"))
    axis.add_patch(Circle((0, 0), roller.radius, fc=style.FAINT, ec="none"))
    x = masks.x
    bins = masks.bin(x)
    for n, plane in enumerate(masks.planes):
        hue = style.HUES[n % len(style.HUES)]
        own = np.where(bins == n, masks.depth(x), np.nan)
        axis.plot(x, own, color=hue, lw=3.2)
        mine = np.flatnonzero(bins == n)
        for run in np.split(mine, np.flatnonzero(np.diff(mine) > 1) + 1):
            left, right = float(x[run[0]]), float(x[run[-1]])
            axis.plot([left, right], [plane, plane], color=hue, lw=1.6, ls=(0, (4, 2)))
            axis.axvspan(left, right, 0.0, 0.05, color=hue, lw=0)
    axis.annotate("light", (0, -outer - 0.4), (0, -outer - 2.1), ha="center", color=style.ORANGE,
                  arrowprops={"arrowstyle": "->", "color": style.ORANGE})  # fmt: skip
    axis.set(title="Middle of the film (solid), and the planes of focus (dashed)",
             xlabel="across the light [mm]", ylabel="depth from the axis [mm]", xlim=(-outer - 0.5, outer + 0.5),
             ylim=(-outer - 3.4, 1.5), aspect="equal")  # fmt: skip


def _defocus(axis: Axes, masks: FocusMasks, beam: Any, radius: float, thickness: float) -> None:
    counts = np.arange(1, 8)
    worst = [FocusMasks.around(beam, radius, thickness, int(n)).defocus.max() for n in counts]
    axis.bar(counts, worst, color=[style.RED if n == masks.bins else style.BLUE for n in counts], width=0.6)
    axis.axhline(0.5 * DEPTH_OF_FOCUS, color=style.INK, ls=(0, (4, 3)), lw=1.2)
    axis.text(7.4, 0.5 * DEPTH_OF_FOCUS, "half the depth of focus", ha="right", va="bottom", fontsize=8.5)
    axis.set(title="Defocus of the worst column", xlabel="focus planes", ylabel="[mm]", xticks=counts)
    axis.grid(False, axis="x")


def _drive(axis: Axes, powers: np.ndarray, pose: float, lens: TunableLens) -> None:
    poses = 4
    order = slots(poses, powers.size).ravel()
    slot = pose / powers.size
    time, rise = np.arange(0, poses * pose, 0.02 * slot), lens.settle / 3.0
    at = np.minimum((time / slot).astype(int), order.size - 1)
    wanted = powers[order][at]
    before = powers[order][np.maximum(at - 1, 0)]
    settled = wanted + (before - wanted) * np.exp(-(time - at * slot) / rise)
    for n in range(powers.size):
        lit = np.where((order[at] == n) & ((time - at * slot >= lens.settle) | (before == wanted)), settled, np.nan)
        axis.plot(1e3 * time, lit, color=style.HUES[n % len(style.HUES)], lw=3.2)
    axis.plot(1e3 * time, settled, color=style.INK, lw=0.8)
    for n in range(poses + 1):
        axis.axvline(1e3 * n * pose, color=style.FAINT, lw=1.2)
    axis.set(title="Power of the lens over four angles, in turning order; thick while a frame is shown",
             xlabel="time [ms]", ylabel="power [dpt]", xlim=(0, 1e3 * poses * pose))  # fmt: skip
