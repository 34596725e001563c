"""A proved web as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.methods.papers import BAND, RAMP, ROLL_TO_ROLL
from vamgpu.optics.roller import Roller
from vamgpu.printing import pictures, surface
from vamgpu.reports.line import Line
from vamgpu.reports.page import Card, Chart, Images, Legend, Page, Papers, Slices, SurfaceView, Table
from vamgpu.webs import views
from vamgpu.webs.describe import wrap_from

if TYPE_CHECKING:
    from vamgpu.webs.proof import WebPart, WebProof

SHOWN = 9.0  # length [mm] of the piece of web that is shown in three dimensions
SLICES_NOTE = "Slices of the same piece across the web; l runs to the right, the outer face is at the top."
WRAPPED_NOTE = "Light comes from below, refracts at the outer face, is absorbed in the film and ends at the roller."
CONTRAST_NOTE = (
    "ξ is the fraction of the resin's response that lies in the part, for the best dose of a random target and light "
    "within arcsin m of the normal. m is the index of the bath divided by that of the resin. For smaller m, fewer "
    "angles enter the film."
)


def page_of(proof: WebProof, title: str, contrast: Sequence[tuple[float, float]] = ()) -> Page:
    """The page of a proved web."""
    total = proof.counts.sum(axis=0).cumsum()
    peak = float(proof.edges[int(np.searchsorted(total, 0.999 * total[-1])) + 1])  # the brightest in pictures
    strips, shown = views.Strips(proof.segments[-1].columns[1], proof.threshold), None
    middle = len(proof.segments) // 2
    for k, piece in enumerate(proof.pieces()):
        strips.add(piece.columns[0], piece.dose, piece.target)
        if k == middle:
            shown = piece
    assert shown is not None
    data, note = _solid(proof, shown, peak)
    good, said = proof.verdict
    focus = " and the focus planes that show them" if proof.folder.details["frames"]["focus"] is not None else ""
    roller, frame = wrap_from(proof.folder.details["wrap"]), proof.folder.frame(proof.folder.frames // 2)
    assert isinstance(roller, Roller)
    lit = frame[frame.shape[0] // 2].astype(np.float64)
    wrapped = views.wrapped_chart(proof.light, proof.grid, roller, lit, np.ones(len(lit)))
    histogram = views.histogram_chart(proof.counts, proof.edges, proof.threshold, not contrast)
    segments = views.segments_chart(proof.segments, proof.grid.edges[0])
    return Page(
        "Web proof",
        title,
        said,
        good,
        _tiles(proof),
        [
            Card("Along the web", *(Images([strip], "strip") for strip in strips.pictures(peak)), Legend(), wide=True),
            Card("Printed film", SurfaceView(f"{1e3 * max(proof.grid.edges):.3g}"), note=note),
            Card("Layer by layer", Slices(), note=SLICES_NOTE),
            Card("Light about the roller", Chart(wrapped), note=WRAPPED_NOTE, wide=True),
            Card("Dose inside and outside the part", Chart(histogram), wide=not contrast),
            *([Card("Contrast against the index ratio", Chart(views.contrast_chart(contrast)), note=CONTRAST_NOTE)]
              if contrast else []),
            Card("Segment by segment", Chart(segments), note="One threshold for the whole web.", wide=True),
            Card(f"Frames{focus}", Images(views.frame_pictures(proof), "frames"), wide=True),
            Card("Set-up", Table(_setup(proof)), wide=True),
            Card("Sources", Papers((ROLL_TO_ROLL, BAND, RAMP)), wide=True),
        ],
        data=data,
    )  # fmt: skip


def _solid(proof: WebProof, piece: WebPart, peak: float) -> tuple[dict[str, Any], str]:
    """Surfaces and slices of a stretch in the middle of a piece, for the page's script."""
    edges = np.array(proof.grid.edges)
    count = min(len(piece.dose), round(SHOWN / edges[0]))
    first = (len(piece.dose) - count) // 2
    dose, target = (values[first : first + count].astype(np.float64) for values in (piece.dose, piece.target))
    verdict = pictures.verdicts(target, dose >= proof.threshold, np.ones(dose.shape[:2], bool))
    expected, printed = _surface(target, 0.5, edges), _surface(dose, proof.threshold, edges)
    sheet = pictures.sheet(dose, target, verdict, peak)
    heights = [float(z) for z in proof.grid.axes()[2][sheet["slices"]]]
    data = surface.viewer(expected, printed, float(edges.max())) | pictures.viewer(sheet, heights, len(heights) // 2)
    start = (piece.columns[0] + first) * edges[0]
    note = (
        f"The web from {start:.1f} to {start + count * edges[0]:.1f} mm where the dose reaches the threshold, colored "
        "by its distance from the target; the scale ends at one voxel. Drag to turn, scroll to zoom."
    )
    return data, note


def _surface(values: np.ndarray, level: float, edges: np.ndarray) -> surface.Surface:
    found = surface.iso_surface(values, level, 1.0)
    points = found.points * edges
    return replace(found, points=points, normals=surface.vertex_normals(points, found.faces))


def _tiles(proof: WebProof) -> list[Line]:
    length = proof.segments[-1].columns[1] * proof.grid.edges[0]
    worst = min(score.trimmed for score in proof.segments)
    values = (
        ("IoU", f"{proof.iou:.4f}"),
        ("narrowest 1 % window", f"{worst:+.3f}".replace("-", "−")),
        ("threshold", f"{proof.threshold:.3f}"),
        ("length", f"{length:.4g} mm"),
        ("frames", f"{proof.folder.frames:,}"),
        ("segments", str(len(proof.segments))),
    )
    return [Line(*each) for each in values]


def _setup(proof: WebProof) -> list[tuple[str, str]]:
    details = proof.folder.details
    layout, grid = details["layout"], details["grid"]
    film = details["wrap"].get("film", {})
    columns, rows = details["beam"]["pixels"]
    return [
        ("section", f"{grid['section'][0]} × {grid['section'][1]} voxels along ρ and z"),
        ("voxels", " × ".join(f"{1e3 * edge:.4g}" for edge in grid["pitch"]) + " µm along l, ρ and z"),
        ("beam", f"{columns} × {rows} pixels of {1e3 * details['beam']['pitch']:.4g} µm"),
        ("film", ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in film.items() if value is not None)),
        ("roller", f"radius {details['wrap'].get('radius')} mm, {layout['step']} columns per angle"),
        ("window of light", f"{layout['window']} columns, {layout['window'] * grid['pitch'][0]:.4g} mm"),
        ("segments", f"{layout['core']} frames each, solved with {layout['overlap']} more on either side"),
        ("method", ", ".join(f"{name} {value}" for name, value in details["method"].items())),
        ("device", proof.device.description),
    ]
