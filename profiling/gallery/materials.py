"""Refractive indices and absorption of the bundled materials, and diffusion lengths of the inhibitors."""

from __future__ import annotations

from typing import Any

import numpy as np

from profiling.gallery.picture import Fact, Picture, Table
from vamgpu.backend.device import Device
from vamgpu.chemistry.materials import Dispersion, Glass, Inhibitor, Liquid, Resin
from vamgpu.chemistry.materials.resin import WILKE_CHANG, diffusion_length
from vamgpu.chemistry.species import PAPER
from vamgpu.reports import style
from vamgpu.units import nm


def materials(
    device: Device, quick: bool = False, wavelength_nm: float = 405.0, exposure: float = 100.0, lifetime: float = 30.0
) -> Picture:
    """The wavelength of the automatic exposure paper, and the two times of the photoinhibition paper."""
    resin = Resin.load("bisgma-tegdma-habi")
    oxygen, lophyl = resin.diffusivity("oxygen"), resin.diffusivity("lophyl")
    facts = (
        Fact("diffusivity of oxygen", oxygen, "mm²/s", 3, 3.27e-7, "paper, eq. 11"),
        Fact("diffusivity of lophyl", lophyl, "mm²/s", 3, 6.89e-8, "paper, eq. 11"),
        _length("oxygen", oxygen, exposure, 1.40e-2 if exposure == 100.0 else None),
        _length("lophyl", lophyl, lifetime, 3.52e-3 if lifetime == 30.0 else None),
        Fact("index of water at 442 nm", Liquid.load("water").index.at(442 * nm), "", 4, 1.33, "roll-to-roll paper"),
        Fact("index of N-BK7 at 587.6 nm", Glass.load("n-bk7").index.at(587.6 * nm), "", 5, 1.5168, "SCHOTT"),
    )  # fmt: skip
    known = [(kind.load(name).name, kind.load(name).index) for kind in (Glass, Liquid, Resin) for name in kind.names()]
    indices = [(name, index) for name, index in known if index is not None]
    figure = _drawn(indices, resin, 40 if quick else 300)
    place = wavelength_nm * nm
    rows = tuple((name, (index.at(place),)) for name, index in indices if index.range[0] <= place <= index.range[1])
    caption = (
        "Every number comes from a file that names its source. If a source gives the index at only one wavelength, the "
        "figure shows a dot; if it prints only a curve, nothing. Outside its data a material raises an error. "
        "Diffusivities are estimates after Wilke and Chang. The roll-to-roll paper uses 1.33 for water, its index in "
        "yellow light; at the wavelength of the print it is higher."
    )
    table = Table((f"at {wavelength_nm:g} nm", "refractive index"), (".5f",), rows)
    return Picture(figure, caption, facts, table, (PAPER, WILKE_CHANG))


def _length(name: str, diffusivity: float, seconds: float, expected: float | None) -> Fact:
    length = diffusion_length(diffusivity, seconds)
    return Fact(f"diffusion length of {name}, {seconds:g} s", length, "mm", 3, expected, "paper")


def _drawn(indices: list[tuple[str, Dispersion]], resin: Resin, points: int) -> Any:
    figure, axes = style.sheet("aab", 4.2)
    for hue, (name, index) in zip(style.HUES, indices, strict=False):
        low, high = max(index.range[0], 350 * nm), min(index.range[1], 700 * nm)
        waves = np.linspace(low, high, points if low < high else 1)
        look: dict[str, Any] = {"color": hue, "marker": "" if low < high else "o", "label": name}
        axes["a"].plot(waves / nm, [index.at(w) for w in waves], **look)
    axes["a"].set(title="Refractive index", xlabel="wavelength [nm]", xlim=(345, 705))
    axes["a"].legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 0.2))
    times = np.geomspace(1.0, 1000.0, points)
    for hue, name in zip(style.HUES, Inhibitor.names(), strict=False):
        lengths = [1e3 * diffusion_length(resin.diffusivity(name), t) for t in times]
        axes["b"].loglog(times, lengths, color=hue, label=Inhibitor.load(name).name)
    axes["b"].set(title="Diffusion length √(6Dt)", xlabel="time [s]", ylabel="µm")
    axes["b"].legend()
    return figure
