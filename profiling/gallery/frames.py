"""Input of a projector: frames of 8 bits and of 1 bit, and the gray curve between levels and light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from profiling.gallery import scene
from profiling.gallery.picture import Fact, Picture, Table
from profiling.gallery.scale_bar import scale_bar
from vamgpu.backend.device import Device
from vamgpu.methods import optimize
from vamgpu.methods.surface import across
from vamgpu.metrics import mean_brightness, score
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import pack
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 0.125
"""Share of a turn at which frames are shown."""


def frames(
    device: Device,
    quick: bool = False,
    pitch: float = 0.12,
    angles: int = 360,
    gamma: float = 2.2,
    black: float = 0.002,
) -> Picture:
    """Patterns for the boat packed in four ways, for a projector with a gamma and a black level."""
    target = scene.boat(device, 0.6 if quick else pitch)
    A = scene.straight(target, 24 if quick else int(angles), device)
    plan = optimize(A, target, iterations=4 if quick else 40)
    curve = GrayCurve.gamma(gamma, black)
    packed = {
        "8 bits": pack(plan, gray=curve),
        "1 bit, error diffusion": pack(plan, bits=1, gray=GrayCurve.linear(black), dither="error-diffusion"),
        "1 bit, nearest": pack(plan, bits=1, gray=GrayCurve.linear(black), dither="round"),
        "1 bit, chosen by dose": pack(plan, bits=1, gray=GrayCurve.linear(black), dither="fit"),
    }
    light = plan.sinogram.numpy()
    depth, fractions = across(target, A.grid, A, 1.0).numpy(), target.on(device)
    rows = [("plan", (*_judged(plan.dose(), depth, fractions), 0.0, mean_brightness(plan.sinogram)))]
    for name, pictures in packed.items():
        shone = pictures.irradiance(device)
        rows.append((name, (*_judged(A.T(shone), depth, fractions), _error(shone.numpy(), light),
                            mean_brightness(shone, pictures.scale))))  # fmt: skip
    figure, axes = style.sheet("abc;ddd;efg", 8.8, height_ratios=[1, 0.7, 0.85])
    _faces(axes, light, packed, plan.operator)
    _curve(axes["e"], curve)
    _inverse(axes["f"], curve)
    _levels(axes["g"], packed["8 bits"])
    table = Table(("frames", "window 1 pixel from the surface", "IoU", "error of the light [%]",
                   "mean brightness"),
                  ("+.4f", ".5f", ".2f", ".4f"), tuple(rows))  # fmt: skip
    wanted = np.linspace(0.0, 1.0, 4001)
    gap = float(np.abs(curve(curve.inverse(wanted)) - np.maximum(wanted, black)).max())
    brightest = float(light.max())
    facts = (
        Fact("brightest pixel divided by a full-on one", brightest / packed["8 bits"].scale, "", 3),
        Fact("window lost by 8 bits", rows[0][1][0] - rows[1][1][0], "", 2),
        Fact("window lost by 1 bit, error diffusion", rows[0][1][0] - rows[2][1][0], "", 2),
        Fact("window lost by 1 bit, chosen by dose", rows[0][1][0] - rows[4][1][0], "", 2),
        Fact("largest difference between required light and nearest level, divided by full-on", 100 * gap, "%", 2),
        Fact("light of a mirror switched off, divided by full-on", 100 * curve.black, "%", 2),
    )
    caption = (
        "Patterns are converted to bytes. A full-on pixel corresponds to the brightest one that is not an outlier; "
        "each pixel gets the level whose measured light, black level included, is nearest. With 1 bit, each pixel "
        "passes its rounding error to the next angle. The dose sums over angles; most of the part therefore survives. "
        "Rounding to the nearest bit loses it. Bits chosen together by their dose keep more of the window than error "
        "diffusion, and get more voxels right. The table judges only the dose of the bytes, decoded as the mirrors "
        "show them; their black level adds light that is not in the plan. The window is that of points at least a "
        "pixel from the surface, across which the default method lets the dose rise. The error is the norm of the "
        "difference in light, divided by the norm of the light."
    )
    return Picture(figure, caption, facts, table, plan.papers)


def _judged(dose: Any, depth: np.ndarray, fractions: Any) -> tuple[float, float]:
    """Window at least a pixel from the surface, and the best IoU. depth: 1 a pixel deep in the part, 0 one outside."""
    values = dose.numpy()
    window = values[depth >= 1.0].min() - values[depth <= 0.0].max()
    return float(window / values.max()), score(dose, fractions).iou


def _error(shone: np.ndarray, light: np.ndarray) -> float:
    """Norm of the error over the norm of the light [%]."""
    return 100.0 * float(np.linalg.norm(shone - light) / np.linalg.norm(light))


def _faces(axes: dict[str, Axes], light: np.ndarray, packed: dict[str, Frames], A: Any) -> None:
    at = round(SHOWN * light.shape[0])
    full = packed["8 bits"].scale
    gray: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255}
    style.shown(axes["a"], np.minimum(light[at] / full, 1.0), f"Patterns, θ = {360 * SHOWN:g}°", cmap="gray",
                vmin=0, vmax=1)  # fmt: skip
    for letter, name in (("b", "8 bits"), ("c", "1 bit, error diffusion")):
        style.shown(axes[letter], packed[name].gray_levels()[at, ::-1].T, f"Frame of {name}", **gray)
    scale_bar(axes["a"], 2.0 / A.beam.pitch, "2 mm")
    middle = light.shape[2] // 4
    row = light.shape[2] - 1 - middle
    column = int(np.argmax(light[:, :, middle].mean(axis=0)))
    theta = np.arange(light.shape[0]) * 360.0 / light.shape[0]
    part = slice(0, max(2, light.shape[0] // 4))
    axis = axes["d"]
    bits = packed["1 bit, error diffusion"].levels()[part, row, column]
    axis.bar(theta[part], bits, width=theta[1], color=style.FAINT, label="1 bit, error diffusion")
    axis.plot(theta[part], light[part, column, middle] / full, color=style.BLUE, label="plan")
    level = packed["8 bits"].levels()[part, row, column]
    axis.plot(theta[part], packed["8 bits"].gray(level), ".", color=style.ORANGE, ms=5, label="8 bits")
    axis.set(title="One pixel over a quarter turn", xlabel="angle θ [°]", ylabel="light over full-on", ylim=(0, 1.05),
             xlim=(theta[part][0] - 0.5, theta[part][-1] + 0.5))  # fmt: skip
    axis.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)


def _curve(axis: Axes, curve: GrayCurve) -> None:
    level = np.arange(256)
    axis.plot(level, curve(level), color=style.BLUE)
    axis.annotate(f"black level {100 * curve.black:g} %", (0, curve.black), (10, 0.28), color=style.RED,
                  arrowprops={"arrowstyle": "-", "color": style.RED, "lw": 0.8})  # fmt: skip
    axis.set(title="Gray curve", xlabel="gray level", ylabel="light over full-on", xlim=(0, 255), ylim=(0, 1),
             xticks=[0, 64, 128, 192, 255])  # fmt: skip


def _inverse(axis: Axes, curve: GrayCurve) -> None:
    wanted = np.linspace(0.0, 1.0, 2001)
    axis.plot(wanted, curve.inverse(wanted), color=style.BLUE)
    axis.set(title="Its inverse", xlabel="required light, over full-on", ylabel="gray level", xlim=(0, 1),
             ylim=(0, 258), yticks=[0, 64, 128, 192, 255])  # fmt: skip


def _levels(axis: Axes, packed: Frames) -> None:
    counts = np.bincount(packed.levels().ravel(), minlength=256)
    axis.stairs(np.maximum(counts, 0.5), np.arange(257) - 0.5, baseline=0.5, fill=True, color=style.BLUE, alpha=0.7)
    axis.set(title="Levels used", xlabel="gray level", ylabel="pixels", yscale="log", xlim=(-1, 256), ylim=(0.7, None),
             xticks=[0, 64, 128, 192, 255])  # fmt: skip
