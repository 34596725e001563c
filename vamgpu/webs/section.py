"""What a machine and its light make of a web by default: voxels across it, and focus planes along it."""

from __future__ import annotations

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Beam, counts
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks
from vamgpu.web import WebGrid, Wrap


def one_column(
    wrap: Wrap,
    beam: Beam,
    section: tuple[int, int] | None = None,
    pitch: tuple[float, float, float] | None = None,
) -> WebGrid:
    """One column of the web.

    section: voxels along rho and z; None fills the film of ``wrap`` and the height of ``beam`` with as many as fit
    best, and then voxels are the film's thickness over their count along rho.  pitch: voxel edges [mm] along l, rho, z;
    None takes one pose along l and the beam's pitch.  Raises `BadInput` where no film tells the section.
    """
    edges = (wrap.advance, beam.pitch, beam.pitch) if pitch is None else pitch
    along, deep, across = WebGrid((1, 1, 1), edges).edges
    if section is not None:
        return WebGrid((1, *counts("section (voxels along rho and z)", section, 2)), (along, deep, across))  # type: ignore[arg-type]
    thickness = getattr(getattr(wrap, "film", None), "thickness", None)
    if thickness is None:
        raise BadInput("no section; expected voxels along rho and z, such as section=(38, 32)")
    layers, slices = max(1, round(thickness / deep)), max(1, round(beam.pixels[1] * beam.pitch / across))
    return WebGrid((1, layers, slices), (along, thickness / layers, across))


def focus_masks(lens: TunableLens | FocusMasks | None, wrap: Wrap, beam: Beam) -> FocusMasks | None:
    """The focus planes of a lens about the roller that carries the film, or those that are given.

    Raises `BadInput` for a lens that cannot reach its planes, for one beside a machine other than a `Roller`, and for
    anything else; `ShapeMismatch` for masks of another beam.
    """
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
            f"a lens follows the film about a Roller, and {type(wrap).__name__} is none; expected "
            "FocusMasks(columns, pitch, midline, planes) as lens"
        )
    masks = FocusMasks.around(beam, wrap.radius, wrap.film.thickness, lens.bins)
    lens.power(masks.planes)
    return masks
