"""A modeled or corrected stack as one self-contained HTML page."""

from __future__ import annotations

from typing import Any

import vamgpu
from vamgpu.curethrough import pictures
from vamgpu.curethrough.feasibility import fastest
from vamgpu.curethrough.job import LACKING, Outcome
from vamgpu.curethrough.printer import Printer
from vamgpu.curethrough.score import Group, grouped
from vamgpu.reports.line import Line, length
from vamgpu.reports.page import Card, Chart, Images, Legend, Page, Papers, Table
from vamgpu.units import hour, mJ_cm3, mW_cm2

PAPER = (
    "Z. D. Pritchard, M. P. de Beer, R. J. Whelan, T. F. Scott, M. A. Burns, Modeling and correcting cure-through in "
    "continuous stereolithographic 3D printing, Adv. Mater. Technol. (2019), doi:10.1002/admt.201900700"
)
ROWS = 24
COLUMNS_NOTE = (
    "Dose against height in single columns of pixels, in critical doses; shaded parts should be solid. Dose above 1 "
    "cures."
)


def page_of(outcome: Outcome, title: str) -> Page:
    """The page of a stack.

    Args:
        outcome: A modeled stack, and its correction if there is one.
        title: The title.

    Returns:
        The page, for `Page.write`.
    """
    after = outcome.after
    lacking = LACKING * outcome.machine.slice_height
    groups = grouped(outcome.before.features, after.features if after is not None else None, lacking)
    maps, most = pictures.maps(outcome)
    across = 4 if after is not None else 2
    sections = [Images(row, "panels", across) for row in pictures.sections(outcome)]
    frequent = sorted(groups[:ROWS], key=lambda group: (group.front, group.back))
    header = ("error corrected", "ratio", "lacking", "fastest") if after is not None else ("lacking",)
    header = ("from", "to", "height", "void behind", "columns", "error uncorrected", *header)
    features = Table([_row(group, outcome) for group in frequent], header)
    row, column = outcome.sample.rows[outcome.sample.across][0], outcome.sample.columns[outcome.sample.along][0]
    good, said = outcome.verdict
    return Page(
        "Cure-through",
        title,
        said,
        good,
        [Line(name, value) for name, value, _ in lines(outcome)][:7],
        [
            Card("Columns", Chart(pictures.columns_chart(outcome)), note=COLUMNS_NOTE, wide=True),
            Card("Cross-sections", *sections, Legend(f"{pictures.MOST_DOSE:g} critical doses"),
                 note=f"Along row {row} and along column {column} of the pictures; the platform is below, and pixels "
                      "are stretched to fit.", wide=True),
            Card("Height errors seen from above", Images(maps, "panels", across),
                 note=f"From 0 to {length(most)}, the same scale for all.", wide=True),
            Card("Features", features, note=_table_note(outcome, groups), wide=True),
            Card("Set-up", Table(_setup(outcome)), wide=True),
            Card("Sources", Papers((PAPER,)), wide=True),
        ],
    )  # fmt: skip


def lines(outcome: Outcome) -> tuple[tuple[str, str, str], ...]:
    """The most important numbers.

    Args:
        outcome: A modeled stack, and its correction if there is one.

    Returns:
        Name, value and meaning of each.
    """
    found = []
    pixels = max(1, int((outcome.before.heights.over + outcome.before.heights.under > 0).sum()))
    for name, shown in (("uncorrected", outcome.before), ("corrected", outcome.after)):
        if shown is not None:
            over, under = (float(getattr(shown.heights, key).sum(dtype=float)) / pixels for key in ("over", "under"))
            found.append((f"excess height, {name}", length(over), "cured void, mean over the pixels that print "
                          "incorrectly without correction"))  # fmt: skip
            found.append((f"missing height, {name}", length(under), "uncured part, mean over the same pixels"))
    if outcome.ratio is not None:
        found.append(("error ratio", f"{outcome.ratio:.3g}", "all height errors, corrected / uncorrected"))
    single = outcome.feature_ratio
    if single is not None:
        found.append(("median error ratio", f"{single[1]:.3g}", "of single features, corrected / uncorrected"))
    if outcome.missed is not None and outcome.closed is not None:
        found.append(("features out of reach", f"{int(outcome.missed.sum()):,}", "get too little dose at their back"))
        found.append(("voids out of reach", f"{int(outcome.closed.sum()):,}", "too short to stay below critical dose"))
    return tuple(found)


def _row(group: Group, outcome: Outcome) -> tuple[str, ...]:
    height = outcome.machine.slice_height
    place = (f"{group.front * height:.4g} mm", f"{group.back * height:.4g} mm")
    size = (length((group.back - group.front) * height), length(group.behind * height), f"{group.columns:,}")
    if group.after is None:
        return (*place, *size, length(group.before), f"{group.missed:,}")
    share = "–" if group.ratio is None else f"{group.ratio:.2g}"
    after = (length(group.before), length(group.after), share, f"{group.missed:,}", _fastest(group, outcome))
    return (*place, *size, *after)


def _fastest(group: Group, outcome: Outcome) -> str:
    """The highest speed at which a feature gets its dose and the void behind it stays open, with the same light."""
    machine, correction = outcome.machine, outcome.correction
    if correction is None or not isinstance(machine, Printer):
        return "–"
    speed = fastest(machine, group, outcome.shape[0] + correction.added, correction.open_dose)
    return f"{speed * hour:.4g} mm/h" if speed > 0 else "none"


def _table_note(outcome: Outcome, groups: tuple[Group, ...]) -> str:
    more = f"; {len(groups) - ROWS:,} rarer ones are left out" if len(groups) > ROWS else ""
    return (
        f"Runs of solid slices in {len(outcome.sample.rows):,} columns of pixels{more}. The error is the cured height "
        'of the void before a feature plus the uncured height within it, a mean over its columns. "Lacking" counts '
        f"columns where more than {LACKING:g} of a slice height within the feature stays uncured."
        + (
            ' "Fastest" is the highest speed at which a feature gets its dose and the void behind it stays open, with '
            "the same light."
            if outcome.after is not None
            else ""
        )
    )


def _setup(outcome: Outcome) -> list[tuple[str, str]]:
    machine: Any = outcome.machine
    slices, ny, nx = outcome.shape
    rows = [
        ("slices", f"{slices:,} of {nx} × {ny} pixels, {length(machine.slice_height)} high"),
        ("resin", f"absorption height {length(machine.absorption_height)}, critical dose "
                  f"{machine.critical_dose / mJ_cm3:.4g} mJ/cm³"),
        ("light", f"{machine.light[0] / mW_cm2:.3g} to {machine.light[-1] / mW_cm2:.4g} mW/cm²"),
        ("print", f"{machine.exposure:.4g} s per slice" if machine.layered else
                  f"{machine.speed:.4g} mm/s, {3600 * machine.speed:.4g} mm/h"),
        ("solid", f"gray level {outcome.threshold} or more"),
    ]  # fmt: skip
    if outcome.correction is not None:
        rows.append(("correction", f"{outcome.correction.profile}, {outcome.correction.added} slices added"
                                   f"{', dithered' if outcome.correction.dither else ''}"))  # fmt: skip
    return [*rows, ("vamgpu", vamgpu.__version__)]
