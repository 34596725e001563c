"""Pictures and charts of a web's report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.optics.roller import Roller
from vamgpu.printing.pictures import COLORS, upright, verdicts
from vamgpu.reports.chart import NARROW, PART, REST, WARN, WIDE, above, colored, picture, svg
from vamgpu.reports.page import Image
from vamgpu.reports.style import FAINT, INK
from vamgpu.web import Propagation, WebGrid

if TYPE_CHECKING:
    from vamgpu.webs.proof import PieceScore, WebProof

PIXELS = 2400  # greatest number of pixels of a strip along the web


class Strips:
    """The middle layer of a web, [l, rho], gathered piece by piece and thinned along l."""

    step: int
    threshold: float

    def __init__(self, columns: int, threshold: float) -> None:
        self.step, self.threshold = max(1, -(-columns // PIXELS)), threshold
        self._parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, start: int, dose: np.ndarray, target: np.ndarray) -> None:
        """A piece [l, rho, z] that begins at column ``start``."""
        chosen = slice(-start % self.step, None, self.step)
        middle = dose.shape[2] // 2
        given, expected = dose[chosen, :, middle], target[chosen, :, middle].astype(np.float64)
        verdict = verdicts(expected[:, :, None], given[:, :, None] >= self.threshold, np.ones(given.shape, bool))
        self._parts.append((expected, given, verdict[:, :, 0]))

    def pictures(self, peak: float) -> list[Image]:
        """Target, dose and verdict; the outer face of the film is up."""
        expected, given, verdict = (upright(np.concatenate(part)) for part in zip(*self._parts, strict=True))
        return [
            Image(picture(247 - (expected * 191).astype(np.uint8)), "target of the whole web, outer face up"),
            Image(picture(colored(given / peak, "magma")), "dose"),
            Image(picture(COLORS[verdict]), "printed"),
        ]


def wrapped_chart(light: Propagation, grid: WebGrid, roller: Roller, frame: np.ndarray, whole: np.ndarray) -> str:
    """Power absorbed about the roller: by a full-on beam, and by one frame (columns,)."""
    map_ = roller.map(grid)
    n_rho, n_l = light.shape[1:]
    l, rho = np.arange(n_l + 1) * grid.edges[0], np.arange(n_rho + 1) * grid.edges[1]  # noqa: E741 - the web's axis
    x, y = map_.wrapped(l[:, None], rho[None, :])
    flat = light.rho.astype(np.int64) * n_l + light.l

    def draw(*axes: Any) -> None:
        drawn: Any = None
        for axis, shown, name in zip(axes, (whole, frame), ("every column on", "one frame"), strict=True):
            total = np.bincount(flat, light.weight * shown[light.r], n_rho * n_l).reshape(n_rho, n_l).T
            drawn = axis.pcolormesh(x, y, total / max(float(total.max()), 1e-30), cmap="inferno", rasterized=True)
            turn = np.linspace(0, 2 * np.pi, 200)
            axis.plot(roller.radius * np.cos(turn), roller.radius * np.sin(turn), color=FAINT, lw=1)
            axis.set(aspect="equal", title=name, xlabel="x [mm]", ylabel="y [mm]")
            axis.grid(False)
        axes[0].figure.colorbar(drawn, ax=list(axes), label="absorbed / greatest", shrink=0.8)

    return svg(draw, WIDE, 4.6, ncols=2)


def histogram_chart(counts: np.ndarray, edges: np.ndarray, threshold: float, wide: bool = False) -> str:
    """Voxels inside and outside the part against dose."""
    merged = counts.reshape(2, -1, 8).sum(axis=2)
    last = edges[::8][min(merged.shape[1], int(np.flatnonzero(merged.sum(axis=0))[-1]) + 1)]

    def draw(axis: Any) -> None:
        for values, color, name in ((merged[0], REST, "outside"), (merged[1], PART, "in the part")):
            shown = np.maximum(values, 0.5)
            axis.stairs(shown, edges[::8], baseline=0.5, fill=True, color=color, alpha=0.3)
            axis.stairs(shown, edges[::8], color=color, lw=1.4, label=name)
        axis.axvline(threshold, color=INK, lw=1.2, ls=(0, (4, 3)), label="threshold")
        axis.set(yscale="log", xlim=(0, last), ylim=(0.5, None), xlabel="dose, 1 is what the part should get",
                 ylabel="voxels")  # fmt: skip
        above(axis, 3)

    return svg(draw, WIDE if wide else NARROW, 3.6)


def segments_chart(scores: Sequence[PieceScore], edge: float) -> str:
    """IoU and process windows of every segment against its position [mm]."""
    ends = np.array([score.columns[0] for score in scores] + [scores[-1].columns[1]]) * edge

    def draw(over: Any, under: Any) -> None:
        over.stairs([score.iou for score in scores], ends, color=PART, lw=1.8, baseline=None)
        over.set(ylabel="IoU", ylim=(0, 1))
        under.axhline(0, color=INK, lw=0.8)
        under.stairs([score.window for score in scores], ends, color=WARN, lw=1.6, baseline=None, label="strict window")
        under.stairs([score.trimmed for score in scores], ends, color=PART, lw=1.6, baseline=None, label="1 % window")
        under.set(ylabel="process window", xlabel="along the web [mm]", xlim=(0, ends[-1]))
        under.legend(ncols=2, loc="lower right")

    return svg(draw, WIDE, 4.0, nrows=2, sharex=True)


def contrast_chart(found: Sequence[tuple[float, float]]) -> str:
    """ξ over the index ratio m."""
    ratio, share = zip(*found, strict=True)

    def draw(axis: Any) -> None:
        axis.plot(ratio, share, color=PART, lw=1.8, marker="o", ms=5)
        axis.set(xlabel="index ratio m", ylabel="contrast ξ")
        axis.invert_xaxis()

    return svg(draw, NARROW, 3.6)


def frame_pictures(proof: WebProof, count: int = 3) -> list[Image]:
    """Frames along the web; with focus planes, also each plane's part of the middle frame."""
    folder = proof.folder
    numbers = [round((k + 1) * folder.frames / (count + 1)) for k in range(count)]
    found = [Image(picture(colored(folder.frame(n) / 255.0, "inferno")), f"frame {n}") for n in numbers]
    focus = folder.details["frames"]["focus"]
    if focus is not None:
        middle, chosen = folder.frame(numbers[count // 2]), np.array(focus["bin"])
        for number, plane in enumerate(focus["planes"]):
            image = picture(colored(np.where(chosen == number, middle, 0) / 255.0, "inferno"))
            found.append(Image(image, f"frame {numbers[count // 2]}, focused at {plane:.2f} mm".replace("-", "−")))
    return found
