"""Defaults that follow from a machine and its light: voxels across a web, and focus planes along it."""

from __future__ import annotations

from dataclasses import replace

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, counts
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks
from vamgpu.web import WebGrid, Wrap


def one_column(
    wrap: Wrap, beam: Beam, section: tuple[int, int] | None = None, pitch: tuple[float, float, float] | None = None
) -> WebGrid:
    """One column of the web; values that are not given follow from film and beam. Raises `BadInput` without a film."""
    edges = (wrap.advance, beam.pitch, beam.pitch) if pitch is None else pitch
    along, deep, across = WebGrid((1, 1, 1), edges).edges
    if section is not None:
        return WebGrid((1, *counts("section (voxels along rho and z)", section, 2)), (along, deep, across))  # type: ignore[arg-type]
    thickness = getattr(getattr(wrap, "film", None), "thickness", None)
    if thickness is None:
        raise BadInput("no section; expected voxels along rho and z, such as section=(38, 32)")
    layers, slices = max(1, round(thickness / deep)), max(1, round(beam.pixels[1] * beam.pitch / across))
    return WebGrid((1, layers, slices), (along, thickness / layers, across))


def lit_by(wrap: Wrap, planes: int) -> Wrap:
    """The machine with the focus planes of a lens: each is shown for an equal part of the lit share of a step."""
    return replace(wrap, lit_share=wrap.lit_share / planes) if isinstance(wrap, Roller) else wrap


def focus_masks(lens: TunableLens | FocusMasks | None, wrap: Wrap, beam: Beam) -> FocusMasks | None:
    """Focus planes of a lens about the roller, or the given ones. Raises `BadInput`, `ShapeMismatch`."""
    if lens is None:
        return None
    if isinstance(lens, FocusMasks):
        if lens.columns != beam.pixels[0]:
            raise ShapeMismatch(
                f"the focus masks are for {lens.columns} columns; expected {beam.pixels[0]}, the beam's"
            )
        return lens
    if not isinstance(lens, TunableLens):
        raise BadInput(f"got {lens!r} as lens; expected a TunableLens, FocusMasks, or None for one focus")
    if not isinstance(wrap, Roller):
        raise BadInput(
            f"a lens follows the film of a Roller, but {type(wrap).__name__} is not one; expected FocusMasks(columns, "
            "pitch, midline, planes) as lens"
        )
    masks = FocusMasks.around(beam, wrap.radius, wrap.film.thickness, lens.bins)
    lens.power(masks.planes)
    return masks
