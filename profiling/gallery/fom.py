"""The calibration disk printed at five stop doses, four noisy prints each."""

from __future__ import annotations

import numpy as np

from profiling.gallery import scene
from profiling.gallery.dualcolor import verdict
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.methods import optimize
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE
from vamgpu.metrics.merit import Merit, acceptable, merit
from vamgpu.reports import style
from vamgpu.targets.shapes import exposure_disk
from vamgpu.targets.shapes.calibration import GAPS_PX, SPOKES_PX
from vamgpu.targets.target import Target

STOPS = (1.0, 1.06, 1.12, 1.18, 1.24)
"""Stop doses relative to the dose at which the mean of the part gels."""
REPLICATES = 4


def fom(device: Device, quick: bool = False, pixel: float = 0.067, angles: int = 360, blur: float = 0.05,
        noise: float = 0.03) -> Picture:  # fmt: skip
    """The disk by the recipe of automatic exposure. ``blur`` [mm] is the standard deviation of oxygen diffusion;
    ``noise`` is that of the resin's local sensitivity, and of the stop of each print."""
    pitch, turn = pixel, 60 if quick else int(angles)
    target = Target.from_mesh(exposure_disk(thickness=4 * pitch), factor=1.0, pitch=pitch, device=device)
    plan = optimize(scene.straight(target, turn, device), target, "recipe")
    dose = plan.dose().numpy()[:, :, 1].astype(np.float64)
    design = target.numpy()[:, :, 1] >= 0.5
    dose = _blurred(dose, blur / pitch)
    dose /= dose[design].mean()
    rng = np.random.default_rng(3)
    prints = [[_printed(dose, stop, noise, 0.2 / pitch, rng) for _ in range(REPLICATES)] for stop in STOPS]
    merits = [[_judged(each, pitch) for each in row] for row in prints]
    figures = np.array([[m.figure for m in row] for row in merits], float)
    found = acceptable(STOPS, figures)
    figure, axes = style.sheet("abcde;fffff", 5.6, height_ratios=(1.0, 1.25))
    for name, row, stop, values in zip("abcde", prints, STOPS, figures, strict=True):
        axes[name].imshow(verdict(row[0], design).transpose(1, 0, 2), origin="lower", interpolation="nearest")
        axes[name].set_title(f"stop {stop:g}, FOM {values[0]:.0f}")
        axes[name].grid(False)
        style.bare(axes[name])
    _curve(axes["f"], figures, found)
    rows = tuple((f"{stop:g}", (*row, row.mean(), row.std(ddof=1), *_least(each)))
                 for stop, row, each in zip(STOPS, figures, merits, strict=True))  # fmt: skip
    header = ("stop dose", *(f"FOM, print {k + 1}" for k in range(REPLICATES)), "mean", "deviation",
              "thinnest spoke held [px], 8 for none",
              "narrowest gap open [px], 9 for none")  # fmt: skip
    ends = () if found is None else (Fact("lowest acceptable stop dose", found[0], "", 3),
                                     Fact("highest acceptable stop dose", found[1], "", 3))  # fmt: skip
    facts = (
        Fact("FOM of the design itself", float(merit(design, pitch, pixel=pixel).figure), "", 2, 7.0, "eq. 2"),
        Fact("greatest mean FOM", float(figures.mean(axis=1).max()), "", 3, 7.0, "ideal", "≤"),
        *ends,
    )
    caption = (
        "Simulated prints of a disk: half disks hang on two spokes of 1–7 pixels or lie behind gaps of 2–8 pixels; a "
        f"pixel is {1e3 * pixel:g} µm. The patterns are those of the recipe, with {turn} angles and a blur of "
        f"{1e3 * blur:g} µm. Noise of {100 * noise:g} % is added to the resin's sensitivity (correlated over 0.2 "
        "mm) and to each stop. Stop doses are relative to the mean dose of the part at gelation. FOM = spoked half "
        "disks connected − gapped half disks connected, by connected components; the acceptable range is where its "
        "mean over four prints exceeds 2. Black is correct, blue missing, red excess. The paper stops on scattered "
        "light per voxel, of which 0.15 to 0.35 is acceptable; that is a different scale."
    )
    table = Table(header, (*[".0f"] * REPLICATES, ".2f", ".2f", ".1f", ".1f"), rows)
    return Picture(figure, caption, facts, table, (AUTOMATIC_EXPOSURE,))


def _blurred(dose: np.ndarray, sigma: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(dose, sigma))


def _printed(dose: np.ndarray, stop: float, noise: float, length: float, rng: np.random.Generator) -> np.ndarray:
    """Gelled resin: the dose at the stop, multiplied by the local sensitivity, reaches 1."""
    rough = _blurred(rng.standard_normal(dose.shape), length)
    local = 1.0 + noise * rough / rough.std()
    return dose * stop * (1.0 + noise * rng.standard_normal()) * local >= 1.0


def _judged(printed: np.ndarray, pitch: float) -> Merit:
    try:
        return merit(printed, pitch, pixel=pitch)
    except BadInput:  # nothing in the middle gelled: no disk, nothing connected to it
        return Merit((False,) * 7, (False,) * 7)


def _least(merits: list[Merit]) -> tuple[float, float]:
    """Means of the thinnest spoke that holds and of the narrowest open gap; without one, the widest plus one."""
    spokes = [max(SPOKES_PX) + 1 if m.least_spoke is None else m.least_spoke for m in merits]
    gaps = [max(GAPS_PX) + 1 if m.least_gap is None else m.least_gap for m in merits]
    return float(np.mean(spokes)), float(np.mean(gaps))


def _curve(axis, figures: np.ndarray, found: tuple[float, float] | None) -> None:  # noqa: ANN001
    mean, spread = figures.mean(axis=1), figures.std(axis=1, ddof=1)
    if found:
        half = 0.5 * (STOPS[1] - STOPS[0])
        axis.axvspan(found[0] - half, found[1] + half, color=style.RED, alpha=0.1, label="acceptable")
    axis.errorbar(STOPS, mean, spread, fmt="o-", color=style.BLUE, capsize=4, label="mean and deviation of four prints")
    for column in figures.T:
        axis.plot(STOPS, column, ".", color=style.QUIET, ms=5)
    axis.axhline(2, color=style.INK, lw=0.8, ls=(0, (3, 2)))
    axis.set(xlabel="stop dose over the mean dose of gelation", ylabel="figure of merit", ylim=(-0.5, 7.5))
    axis.legend(loc="upper right")
