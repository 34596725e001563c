"""The opening of a report: the proved windows, what the print bears, and how its surface lies."""

from __future__ import annotations

from itertools import groupby
from math import isfinite
from typing import Any

from vamgpu.printing import charts
from vamgpu.printing.judgement import Judgement
from vamgpu.printing.proof import Proof
from vamgpu.printing.tolerances import FirstWrong, ToleranceRow, ToleranceTable
from vamgpu.reports.page import Card, Chart, Figure, Numbers, Tolerances

WORDS = {
    "point spread": "Point spread: σ wider by, in columns and rows",
    "axis of rotation": "Axis of rotation: off the middle of the columns by",
    "absorption": "Absorption of the resin: other than expected by",
    "dose": "Exposure: longer or shorter by",
}
"""What a scenario changes, in plain words."""


def opening(proof: Proof, judgement: Judgement) -> list[Card]:
    """The first cards: window over tolerance, what the print bears, and its surface."""
    chart = Chart(charts.tolerance_chart(judgement.over_tolerance))
    bears = Tolerances(table(judgement.table))
    lines = judgement.surface.lines()
    surface = [Card("Surface of the print against the mesh", Numbers(lines), wide=True)] if lines else []
    return [
        Card("Window over tolerance", chart, note=_chart_note(proof)),
        Card("What the print bears", bears, note=_table_note(judgement.table)),
        *surface,
    ]


def headline(proof: Proof, judgement: Judgement) -> list[Figure]:
    """Proved window, W at half a voxel, and the proved window over the claimed one."""
    found = judgement.over_tolerance
    half = 0.5 * found.voxel
    share = f"judges {100 * found.judged_at(half):.0f} % of the part, all that lies at least so far from its surface"
    if found.half_voxel < 0.0 and proof.scores.missing + proof.scores.excess == 0:
        share += (
            ". It is below 0 although all voxels print right: a voxel is judged by its mean dose, which evens out the "
            "eight voxels half as wide in it, while this window takes the worst of these"
        )
    window = "least dose in the part − greatest dose outside, over the greatest, on the part's own voxels"
    proved = Figure(signed(proof.scores.window), "proved process window", f"{window}; by rays traced for the proof")
    own = Figure(signed(proof.scores.window), "process window, not proved", f"{window}; by the operator that solved")
    at_half = Figure(signed(found.half_voxel), f"window at half a voxel, {1e3 * half:.3g} µm", share)
    return [*([proved, at_half, _against_claim(proof)] if proof.independent else [own, at_half]), *_beyond(proof)]


def _against_claim(proof: Proof) -> Figure:
    claim = proof.claimed.window
    said = f"the operator that solved claims {signed(claim)}"
    if not isfinite(proof.ratio):
        return Figure("–", "proved over claimed", f"{said}: no window to compare with")
    return Figure(f"{proof.ratio:.2f}".replace("-", "−"), "proved over claimed", said)


def _beyond(proof: Proof) -> list[Figure]:
    """What the resin beside, above and below the judged cylinder gets; empty where there is none."""
    if proof.outer is None:
        return []
    meaning = f"greatest dose beside, above and below the judged cylinder: {proof.outer.where}; from 1 on it prints"
    return [Figure(f"{proof.outer_share:.2f}", "of the threshold, beyond the cylinder", meaning)]


def _chart_note(proof: Proof) -> str:
    voxels = "voxels half as wide as the part's" if proof.independent else "the part's own voxels"
    return (
        "W(δ) = (least dose at least δ deep in the part − greatest dose at least δ outside of it) / greatest dose, on "
        f"{voxels}. Where W is above 0, one exposure prints everything right but a skin of thickness δ on either side "
        "of the surface. Below: how much of the part lies that deep."
    )


def table(found: ToleranceTable) -> list[dict[str, Any]]:
    """Scenarios of one kind together, the nominal print first."""
    groups = [{"name": "As it should be", "first": "", "rows": [_cells(found.nominal)], "note": ""}]
    for name, rows in groupby(found.rows, key=lambda row: row.name):
        some = list(rows)
        notes = "; ".join(dict.fromkeys(row.note for row in some if row.note))
        groups.append(
            {
                "name": WORDS.get(name, name),
                "first": _first(found.limits(name)),
                "rows": [] if all(row.note for row in some) else [_cells(row) for row in some],
                "note": f"not exposed: {notes}" if notes else "",
            }
        )
    return groups


def _cells(row: ToleranceRow) -> dict[str, str]:
    """A row of the table, with dashes where there are no numbers."""
    if row.wrong is None:
        return {"change": row.change, "half": "–", "window": "–", "wrong": "–", "bad": ""}
    return {
        "change": row.change or "–",
        "half": signed(row.half_voxel),
        "window": signed(row.window),
        "wrong": f"{row.wrong:,}",
        "bad": "bad" if row.wrong else "",
    }


def _first(limits: tuple[FirstWrong, ...]) -> str:
    """The limits below and above, once where they say the same."""
    return " and ".join(dict.fromkeys(limit.text for limit in limits))


def _table_note(found: ToleranceTable) -> str:
    return (
        "The same frames, as long and as bright, through a machine that is off in one thing. By how much the dose of a "
        "voxel changes is the solver's operator's to say; the change is added to the proved dose. Wrong voxels are "
        "counted at one threshold, that of the proof. Pixels are the projector's. This table took "
        f"{found.exposures} back projections, half a projector evaluation each."
    )


def signed(value: float) -> str:
    """A window with its sign, or that there is none."""
    return f"{value:+.3f}".replace("-", "−") if isfinite(value) else "none"
