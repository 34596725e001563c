"""Patterns for a resin that scatters light, without and with correction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import vamgpu as vam
from profiling.common import gear
from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.printing.proof import Proof
from vamgpu.reports import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RADIUS, ABSORPTION, PITCH = 5.0, 0.06, 0.12
"""Of the resin [mm], [1/mm], and of voxels [mm]."""


def scattering(
    device: Device, quick: bool = False, turbid: float = 3.0, anisotropy: float = 0.9, evaluations: float = 400.0
) -> Picture:
    """``turbid``: scattering events per radius of the resin."""
    part, resin = gear(), vam.Scattering(turbid / RADIUS, anisotropy)
    vial = vam.Vial(RADIUS, 0.0, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=ABSORPTION)
    A = vam.Projection(
        vam.Grid(part.shape, PITCH), vam.Beam((64, 1), PITCH), vam.Turntable(120, lit_share=0.0), vial, device
    )
    S = vam.ScatteringRings(A, resin, photons=500_000 if quick else 30_000_000, tolerance=0.1 if quick else 0.01)
    method, count = vam.SurfaceRamp(width=0.5, outside=0.83, inside=0.85), 8 if quick else int(evaluations)
    lights = {
        name: vam.optimize(operator, part, method, evaluations=count, progress=False)
        for name, operator in (("ignored", vam.RingProjection.of(A)), ("corrected", S))
    }
    proofs = {name: vam.simulate(S, vam.pack(plan, bits=8), part) for name, plan in lights.items()}
    figure, axes = style.sheet([list("tab"), list("hcd")], 6.6)
    for (name, proof), (dose, print_) in zip(proofs.items(), ("ab", "cd"), strict=True):
        _drawn(axes[dose], axes[print_], name, proof, part)
    style.shown(axes["t"], part[:, :, 0], "Part", PITCH, cmap=style.SOLID)
    _counted(axes["h"], proofs, part)
    rows = tuple(
        (name, (proof.scores.windows.strict, proof.claimed.windows.strict, proof.scores.iou))
        for name, proof in proofs.items()
    )
    corrected = proofs["corrected"]
    facts = (
        Fact("strict window, scattering ignored", proofs["ignored"].scores.windows.strict, "", 3),
        Fact("strict window, corrected", corrected.scores.windows.strict, "", 3, 0.0, "prints", "≥"),
        Fact("the same, predicted with the photons of the solver", corrected.claimed.windows.strict, "", 3),
        Fact("overlap (IoU), corrected", corrected.scores.iou, "", 5, 1.0, "all voxels"),
    )
    table = Table(("scattering", "strict window", "predicted", "IoU"), ("+.4f", "+.4f", ".4f"), rows)
    caption = (
        f"A gear of 6.6 mm in resin that scatters light {turbid:g} times per radius, mostly forward (g = "
        f"{anisotropy:g}), the same at every height. Above, patterns of a solver that ignores scattering; below, "
        "patterns of a solver that includes it. The dose is exposed from 8-bit frames, with photons that the solver "
        "did not use. A threshold on the dose gives the print; orange marks voxels on its wrong side. Below left, the "
        "numbers of voxels by dose."
    )
    return Picture(figure, caption, facts, table)


def _drawn(dose_axis: Axes, print_axis: Axes, name: str, proof: Proof, part: np.ndarray) -> None:
    dose, threshold = _dose(proof), proof.scores.threshold / proof.scores.peak
    style.shown(dose_axis, dose, f"Dose, scattering {name}", PITCH, vmin=0, vmax=1)
    wrong = (dose >= threshold) != (part[:, :, 0] >= 0.5)
    style.shown(print_axis, (dose >= threshold).astype(float), f"Print: {int(wrong.sum())} voxels wrong", PITCH,
                cmap=style.SOLID)  # fmt: skip
    at = (np.argwhere(wrong) - 0.5 * (np.array(dose.shape) - 1)) * PITCH
    print_axis.plot(*at.T, "s", ms=2.4, color=style.ORANGE, mew=0)


def _dose(proof: Proof) -> np.ndarray:
    return proof.dose.numpy()[:, :, 0] / proof.scores.peak


def _counted(axis: Axes, proofs: dict[str, Proof], part: np.ndarray) -> None:
    edges, inside = np.linspace(0.0, 1.0, 61), part[:, :, 0] >= 0.5
    near = vam.Grid(part.shape, PITCH).cylinder()
    for (name, proof), color in zip(proofs.items(), (style.ORANGE, style.BLUE), strict=True):
        dose = _dose(proof)
        axis.hist(dose[inside], edges, histtype="step", color=color, label=f"part, {name}")
        axis.hist(dose[near & ~inside], edges, histtype="step", color=color, ls=(0, (3, 2)), label=f"resin, {name}")
    axis.set(yscale="log", xlabel="dose / greatest dose", ylabel="voxels", title="Doses")
    axis.legend(fontsize=7.5)
