"""The sinogram of a tilted ellipse compared with its chords by formula, and the error against the size of the grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from profiling.gallery.picture import Fact, Picture
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable, centers
from vamgpu.operators.projection import Projection
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LIMIT = 0.4
"""Greatest relative error [%] of a sharp lens on a grid of 256²."""


@dataclass(frozen=True)
class Ellipse:
    """Semi-axes a, b, center and tilt [rad]; lengths relative to the edge of the grid."""

    a: float
    b: float
    x: float
    y: float
    tilt: float

    def fractions(self, n: int, rows: int = 32) -> np.ndarray:
        """Filled part of each of n² cells: exact along x, ``rows`` lines along y; (n, n)."""
        y = (np.arange(n * rows) + 0.5) / (n * rows) - 0.5 - self.y
        c, s = np.cos(self.tilt), np.sin(self.tilt)
        # (x c + y s)²/a² + (y c − x s)²/b² ≤ 1 is a quadratic in x
        A = c**2 / self.a**2 + s**2 / self.b**2
        B = c * s * (1.0 / self.a**2 - 1.0 / self.b**2) * y
        C = (s**2 / self.a**2 + c**2 / self.b**2) * y**2 - 1.0
        half = np.sqrt(np.maximum(B**2 - A * C, 0.0)) / A
        low, high = self.x - B / A - half, self.x - B / A + half
        edges = (np.arange(n + 1) / n - 0.5)[:, None]
        inside = np.diff(np.clip(edges, low, high), axis=0) * n
        return inside.reshape(n, n, rows).mean(axis=2)

    def chords(self, r: np.ndarray, width: float, theta: np.ndarray) -> np.ndarray:
        """Lengths of rays at offsets r, averaged over bins of ``width``; (angles, bins)."""
        t = theta[:, None]
        offset = r[None, :] - (self.y * np.cos(t) - self.x * np.sin(t))
        reach = np.hypot(self.b * np.cos(t - self.tilt), self.a * np.sin(t - self.tilt))
        integral = self._integral(offset + 0.5 * width, reach) - self._integral(offset - 0.5 * width, reach)
        return integral / width

    def _integral(self, s: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """∫ of the chord length over its offset from the center."""
        s = np.clip(s, -reach, reach)
        return self.a * self.b * (s * np.sqrt(reach**2 - s**2) / reach**2 + np.arcsin(s / reach))


def projection(
    device: Device,
    quick: bool = False,
    a: float = 0.27,
    b: float = 0.14,
    x: float = 0.093,
    y: float = -0.061,
    tilt: float = 0.5,
    angles: int = 360,
) -> Picture:
    """An ellipse; lengths relative to the edge of the grid, tilt in rad."""
    body, sizes = Ellipse(a, b, x, y, tilt), (16, 32, 64) if quick else (64, 128, 256, 512)
    found = {n: _both(body, n, Turntable(24 if quick else angles, lit_share=0.0), device) for n in sizes}
    errors = [_error(got, want) for got, want in found.values()]
    figure, axes = style.sheet("abc;dde", 6.9, width_ratios=[0.8, 1, 1])
    at = sizes[-2]
    got, want = found[at]
    style.shown(axes["a"], 1.0 - body.fractions(at), f"Ellipse on {at}² voxels", cmap="bone", vmin=-0.3, vmax=1)
    extent = (0.0, 360.0, -0.5, 0.5)
    for letter, field, title, options in (
        ("b", got, "Projected", {"cmap": style.LIGHT, "vmin": 0}),
        ("c", got - want, "Projected − formula", {"cmap": style.GAP, "vmin": -0.01, "vmax": 0.01}),
    ):
        drawn = axes[letter].imshow(field.T, origin="lower", extent=extent, aspect="auto", **options)
        axes[letter].set(title=title, xlabel="angle θ [°]", ylabel="r over the grid's edge", xticks=range(0, 361, 90))
        axes[letter].grid(False)
        style.bar(drawn, axes[letter], "length over the grid's edge", extend="both" if letter == "c" else "neither")
    _profiles(axes["d"], found, at)
    _errors(axes["e"], sizes, errors)
    ratios = [before / after for before, after in zip(errors, errors[1:], strict=False)]
    facts = [Fact(f"relative error on {n}²", e, "%", 3) for n, e in zip(sizes, errors, strict=True)]
    if not quick:
        sharp = _error(*_both(body, sizes[2], Turntable(angles, lit_share=0.0), device, spread=0.0))
        facts.append(Fact(f"relative error on {sizes[2]}² without lens blur", sharp, "%", 3, LIMIT, bound="≤"))
    mean = float(np.prod(ratios)) ** (1.0 / len(ratios))
    facts.append(Fact("fall of the error with each doubling, mean", mean, "", 3, 2.0, "halving"))
    facts.append(Fact("fall of the error with each doubling, least", min(ratios), "", 3, 2.0, "halving"))
    caption = (
        "A tilted ellipse off the axis, with partly filled voxels, projected with a lens in focus, compared with the "
        "lengths of its chords by formula, averaged over each bin. An ellipse with unequal axes distinguishes the "
        "handedness r = y·cosθ − x·sinθ from its mirror image. The error is the norm of the difference divided by the "
        "norm of the chords; it falls by about one half with each doubling of the grid. The formula has no lens blur, "
        "so the error of a sharp lens is smaller."
    )
    return Picture(figure, caption, tuple(facts))


def _error(got: np.ndarray, want: np.ndarray) -> float:
    """Norm of a difference, relative [%]."""
    return 100 * float(np.linalg.norm(got - want) / np.linalg.norm(want))


def _both(
    body: Ellipse, n: int, motion: Turntable, device: Device, spread: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The sinogram of the projector and that of the formula, lengths over the edge of the grid."""
    grid, beam = Grid((n, n, 1), 1.0 / n), Beam((n, 1), 1.0 / n, spread=spread)
    got = Projection(grid, beam, motion, device=device)(body.fractions(n)[:, :, None])[..., 0]
    return np.asarray(got, np.float64), body.chords(centers(n, 1.0 / n), 1.0 / n, motion.poses)


def _profiles(axis: Axes, found: dict[int, tuple[np.ndarray, np.ndarray]], at: int) -> None:
    got, want = found[at]
    r = centers(at, 1.0 / at)
    for share, color in ((0.0, style.BLUE), (1 / 8, style.GREEN), (3 / 8, style.ORANGE)):
        pose = round(share * len(got))
        axis.plot(r, want[pose], color=color, lw=4.5, alpha=0.3)
        axis.plot(r, got[pose], color=color, lw=1.3, label=f"θ = {360 * share:g}°")
    axis.plot([], [], color=style.QUIET, lw=4.5, alpha=0.3, label="formula")
    axis.set(title=f"Profiles on {at}²", xlabel="r over the grid's edge", ylabel="length over the grid's edge",
             xlim=(-0.5, 0.5), ylim=(0, None))  # fmt: skip
    axis.legend()


def _errors(axis: Axes, sizes: tuple[int, ...], errors: list[float]) -> None:
    n = np.array(sizes, float)
    axis.loglog(n, errors[0] * n[0] / n, color=style.QUIET, lw=1, ls=(0, (4, 3)), label="halving")
    axis.loglog(n, errors, "o-", color=style.BLUE, label="measured")
    axis.set(title="Error over the size", xlabel="voxels along an edge", ylabel="relative error [%]")
    axis.set_xticks(n, [f"{s}" for s in sizes])
    axis.set_yticks(errors, [f"{error:.2f}" for error in errors])
    axis.minorticks_off()
    axis.legend()
