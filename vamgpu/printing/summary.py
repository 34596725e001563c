"""Summary of a report: window over tolerance, sensitivity to errors, surface, and headline numbers."""

from __future__ import annotations

from itertools import groupby
from math import isfinite, isnan
from typing import Any

from vamgpu.metrics.surface_judgement import SurfaceJudgement
from vamgpu.printing import charts
from vamgpu.printing.judgement import DEEP, Judgement
from vamgpu.printing.proof import Proof
from vamgpu.printing.tolerances import ToleranceRow, ToleranceTable
from vamgpu.printing.verdict import Verdict
from vamgpu.quantity import counted
from vamgpu.reports.line import Line, length
from vamgpu.reports.page import Card, Chart, Numbers, Tolerances

WORDS = {
    "point spread": "Point spread: increase of σ, in columns and rows",
    "axis of rotation": "Axis of rotation: distance from the middle of the columns",
    "absorption": "Absorption of the resin: deviation from the planned value",
    "dose": "Exposure: change of the time",
}
"""Scenarios in plain words."""


def summary(proof: Proof, judgement: Judgement) -> list[Card]:
    """The first cards: window over tolerance, sensitivity to errors, and surface."""
    chart = Chart(charts.tolerance_chart(judgement.over_tolerance, judgement.pixel))
    sensitivity = Tolerances(table(judgement.table))
    lines = judgement.surface.lines()
    surface = [Card("Surface of the print against the mesh", Numbers(lines), wide=True)] if lines else []
    return [
        Card("Window over tolerance", chart, note=_chart_note(proof)),
        Card("Sensitivity to errors", sensitivity, note=_table_note(judgement.table)),
        *surface,
    ]


def headline(proof: Proof, judgement: Judgement, verdict: Verdict) -> list[Line]:
    """Dose latitude, window a pixel from the surface, stray resin, surface, and the time it takes."""
    deep, found = length(judgement.deep), judgement.over_tolerance
    low, high = verdict.latitude
    meaning = (
        f"{proof.dose_name}, relative to the proved one, at which everything farther than {deep} from the surface is "
        "correct, and bodies, holes and narrow walls stay as they are"
    )
    said = " … ".join(f"{100 * (end - 1):+.{int(abs(end - 1) < 0.1)}f} %" for end in (low, high)).replace("-", "−")
    figures = [Line(f"{proof.dose_name} latitude", said if low < high else "none", meaning)]
    for number, name in ((1.0, "a pixel"), (DEEP, "two pixels")):
        distance = min(number * judgement.pixel, float(found.distance[-1]))
        judged = f"for the {100 * found.judged_at(distance):.0f} % of the part that is that deep"
        share = f"(least dose in the part − greatest outside) / greatest dose; {judged}"
        where = f"window {name} from the surface, {length(distance)}"
        figures.append(Line(where, signed(found.at(distance)), share))
    if (dose := proof.given) is not None:
        turns = f"{counted(dose.turns, 'turn')} in {dose.seconds:.1f} s"
        figures.insert(0, Line("dose given over proved", f"×{dose.share:.3f}", f"{turns}; {dose.verdict}"))
    if proof.outer is not None:
        meaning = f"greatest dose around the judged cylinder: {proof.outer.where}; at 1 or more, resin there prints"
        figures.append(Line("of the threshold, beyond the cylinder", f"{proof.outer_share:.2f}", meaning))
    figures += _surface(judgement.surface)
    if proof.exposure is not None:
        note = f"{proof.exposure.turning}; until resin at the threshold is solid"
        figures.append(Line("exposure", f"{proof.exposure.seconds:.3g} s", note))
    return figures


def _surface(found: SurfaceJudgement) -> list[Line]:
    """Distance of the surface from the part's, and whether bodies, holes and cavities are the same."""
    if isnan(found.mean):
        return []
    made = (
        "Bodies, holes and cavities match the part"
        if found.changes.none
        else "Bodies, holes or cavities do not match the part"
    )
    far = f"at most {length(found.greatest_excess)} too thick and {length(found.greatest_lack)} too thin"
    return [Line("distance from the part's surface, RMS", length(found.rms), f"{far}. {made}")]


def _chart_note(proof: Proof) -> str:
    voxels = "voxels at most half as wide as a pixel in the resin" if proof.independent else "the part's own voxels"
    return (
        "W(δ) = (least dose at least δ deep in the part − greatest dose at least δ outside of it) / greatest dose, on "
        f"{voxels}. If W is above 0, one exposure prints everything correctly except a skin of thickness δ on either "
        "side of the surface. Below: fraction of the part at that depth or deeper."
    )


def table(found: ToleranceTable) -> list[dict[str, Any]]:
    """Scenarios of one kind in one group, the nominal print first."""
    groups = [{"name": "Nominal", "first": "", "rows": [_cells(found.nominal)], "note": ""}]
    for name, rows in groupby(found.rows, key=lambda row: row.name):
        some = list(rows)
        notes = "; ".join(dict.fromkeys(row.note for row in some if row.note))
        groups.append(
            {
                "name": WORDS.get(name, name),
                "first": " and ".join(dict.fromkeys(limit.text for limit in found.limits(name))),
                "rows": [] if all(row.note for row in some) else [_cells(row) for row in some],
                "note": f"not exposed: {notes}" if notes else "",
            }
        )
    return groups


def _cells(row: ToleranceRow) -> dict[str, str]:
    """A row of the table, with dashes where there are no numbers."""
    if row.wrong is None:
        return {"change": row.change, "window": "–", "wrong": "–", "bad": ""}
    return {
        "change": row.change or "–",
        "window": signed(row.window),
        "wrong": f"{row.wrong:,}",
        "bad": "bad" if row.wrong else "",
    }


def _table_note(found: ToleranceTable) -> str:
    return (
        "The same frames, exposure time and brightness, on a machine with one error at a time. The change in dose is "
        "computed with the solver's operator and added to the proved dose. Only voxels two pixels or more from the "
        "surface count, at the threshold of the proof. Pixels are the projector's. This table took "
        f"{found.exposures} back projections, each half a projector evaluation."
    )


def signed(value: float) -> str:
    """A window with its sign, or "none"."""
    return f"{value:+.3f}".replace("-", "−") if isfinite(value) else "none"
