"""The report of a live print: estimates, decisions and result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from vamgpu.live.maps import cuts
from vamgpu.live.printer import Truth
from vamgpu.live.record import LiveRecord, LiveSetup, budget
from vamgpu.reports import chart
from vamgpu.reports.page import Card, Chart, Figure, Image, Images, Page, Table

SHOWN = ("sensitivity", "absorption", "across", "height", "along_z", "along_r", "inhibitor")
"""Estimates that have a curve."""
TRUE = {"sensitivity": "lamp", "absorption": "absorption", "across": "across", "along_z": "along_z",
        "inhibitor": "inhibitor"}  # fmt: skip
"""The attribute of `Truth` for each estimate."""


def page(
    record: LiveRecord, truth: Truth | None = None, overlaps: tuple[float, float] | None = None,
    conversion: np.ndarray | None = None,
) -> Page:  # fmt: skip
    """The report of a recorded print. truth, overlaps (unwatched, watched), conversion: of an emulated print."""
    told, setup = record.decided(), record.setup()
    found = [each for each in told if each["parameters"]]
    swaps = sum(each["action"] == "swap" for each in told)
    last = told[-1]
    doubted = next((each for each in told if each.get("doubt")), None)
    good = bool(found) and last["iou"] > 0.9 and not doubted
    headline = [] if overlaps is None else [
        Figure(f"{overlaps[1]:.4f}", "overlap, live", "of the print with the part, from independent rays"),
        Figure(f"{overlaps[0]:.4f}", "overlap, not live", "of the same resin, lit as planned"),
    ]  # fmt: skip
    expected = "unknown" if doubted else f"{last['iou']:.4f}"
    tiles = [
        Figure(str(len(told)), "decisions", "one after each turn with images"),
        Figure(str(swaps), "swaps", "replacements of the remaining light"),
        Figure(f"{last['turn'] + 1 + last['turns']}", "turns", f"until the light ended; {setup.planned} were planned"),
        Figure(expected, "overlap expected", "with the part, at least, from the last estimate"),
    ]
    cards = [
        Card("Decisions",
             Table(_rows(told), ("after turn", "", "light", "shown from turn", "turns left", "why")), wide=True),
        Card("Time per decision", Table(_times(told, setup), ("", "median [s]", "most [s]", "decisions")),
             note="Sensing is the share of the turn whose images are used."),
    ]  # fmt: skip
    if found:
        cards.insert(
            0,
            Card(
                "Estimates",
                Chart(_curves(found, _true(truth, setup))),
                wide=True,
                note="Bars are standard deviations; a dashed line is the true value at the start of an emulated print.",
            ),
        )
    if conversion is not None:
        part = record.part()
        picture = Image(chart.picture(cuts(conversion, part, 1.0, "viridis")), "across and along the axis")
        cards.insert(1, Card("Final conversion", Images([picture], "panels", 1), note="The part is outlined."))
    verdict = (f"The camera measured {len(told)} turns; the remaining light was replaced {swaps} times." if found
               else "The camera measured nothing that could change the light; the print ran as planned.")  # fmt: skip
    if doubted:
        verdict = (
            f"From turn {doubted['turn']}, images did not decide; the planned light continued: {doubted['doubt']}."
        )
    return Page("live print", record.folder.resolve().parent.stem, verdict, good, tiles, cards, headline)


def _rows(told: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    return [
        [str(each["turn"]), each["action"], str(each["version"]),
         "never" if each.get("effective", 0) is None else str(each.get("effective", "")), str(each["turns"]),
         each["reason"]]
        for each in told
    ]  # fmt: skip


def _times(told: Sequence[Mapping[str, Any]], setup: LiveSetup) -> list[list[str]]:
    return [[stage, f"{median:.3f}", f"{most:.3f}", str(count)] for stage, median, most, count in budget(told)]


def _true(truth: Truth | None, setup: LiveSetup) -> dict[str, float]:
    if truth is None:
        return {}
    values = asdict(truth)
    known = {name: float(values[key]) for name, key in TRUE.items()}
    return known | {"absorption": 1.0 + truth.absorption, "across": truth.across * setup.pixel, "height": 0.0}


def _curves(found: Sequence[Mapping[str, Any]], true: Mapping[str, float]) -> str:
    turns = [each["turn"] for each in found]

    def draw(*axes: Any) -> None:
        for axis, name in zip(axes, SHOWN, strict=False):
            pairs = [each["parameters"].get(name, (each.get(name, np.nan), 0.0)) for each in found]
            values, errors = np.transpose(np.asarray(pairs, float))
            axis.errorbar(turns, values, errors, marker="o", markersize=4, linewidth=1.4, capsize=2.5, color=chart.PART)
            if name in true:
                axis.axhline(true[name], linestyle="--", linewidth=1.0, color=chart.REST)
            axis.set_title(name.replace("_", " ") + (" [mm]" if name in ("across", "height") else ""), fontsize=10.5)
            axis.set_xlabel("turn")
            axis.xaxis.get_major_locator().set_params(integer=True)
        for axis in axes[len(SHOWN) :]:
            axis.set_visible(False)

    return chart.svg(draw, chart.WIDE, 4.6, nrows=2, ncols=4)
