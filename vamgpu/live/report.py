"""The report of a live print: estimates, decisions and result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from math import floor, log10
from typing import Any

import numpy as np

from vamgpu.live.maps import cuts
from vamgpu.live.printer import Truth
from vamgpu.live.record import LiveRecord, LiveSetup, budget
from vamgpu.quantity import counted
from vamgpu.reports import chart
from vamgpu.reports.line import Line
from vamgpu.reports.page import Card, Chart, Image, Images, Page, Table

SHOWN = ("sensitivity", "absorption", "across", "height", "along_z", "along_r", "inhibitor", "turbidity",
         "sinking")  # fmt: skip
"""Estimates that are drawn as a curve."""
TRUE = {"sensitivity": "lamp", "absorption": "absorption", "across": "across", "along_z": "along_z",
        "inhibitor": "inhibitor"}  # fmt: skip
"""The attribute of `Truth` for each estimate."""
HEADER = "after turn", "", "light", "shown from turn", "turns left", "misfit", "why"  # of the decisions
CHECKS = {"images": ("misfit of the images", "o"), "conversion": ("conversion that the light does not explain", "s")}
"""Name and marker of what `Decision.checks` compare."""


def page(
    record: LiveRecord, truth: Truth | None = None, overlaps: tuple[float, float] | None = None,
    conversion: np.ndarray | None = None,
) -> Page:  # fmt: skip
    """The report of a recorded print. truth, overlaps (unwatched, watched), conversion: of an emulated print."""
    decisions, setup = record.decided(), record.setup()
    found = [each for each in decisions if each["parameters"]]
    swaps = sum(each["action"] == "swap" for each in decisions)
    last = decisions[-1]
    doubted = next((each for each in decisions if each.get("doubt")), None)
    good = bool(found) and last["iou"] > 0.9 and not doubted
    headline = [] if overlaps is None else [
        Line("overlap, live", f"{overlaps[1]:.4f}", "of the print with the part, from independent rays"),
        Line("overlap, not live", f"{overlaps[0]:.4f}", "of the same resin, lit as planned"),
    ]  # fmt: skip
    expected = "unknown" if doubted else f"{last['iou']:.4f}"
    tiles = [
        Line("decisions", str(len(decisions)), "one after each turn with images"),
        Line("swaps", str(swaps), "replacements of the remaining light"),
        Line("turns", f"{last['turn'] + 1 + last['turns']}", f"until the light ended; {setup.planned} were planned"),
        Line("overlap expected", expected, "with the part, at least, from the last estimate"),
    ]
    times = [(stage, f"{median:.3f}", f"{most:.3f}", str(count)) for stage, median, most, count in budget(decisions)]
    cards = [
        Card("Decisions", Table(_rows(decisions), HEADER), wide=True),
        Card("Time per decision", Table(times, ("", "median [s]", "most [s]", "decisions")),
             note="Sensing is the share of the turn whose images are used."),
    ]  # fmt: skip
    if found:
        true = _true(truth, setup)
        note = "Bars are standard deviations; a dashed line is the true value at the start of an emulated print."
        cards.insert(0, Card("Estimates", Chart(_curves(found, true, setup)), wide=True, note=note))
        header = ("", "value", "σ", "true at the start") if true else ("", "value", "σ")
        cards.append(Card("Last estimates", Table(_estimates(found[-1], true, setup), header)))
    if any(each.get("checks") for each in decisions):
        note = "Relative to the limits. Beyond a limit, the line is red; the images of the red turns are not used."
        cards.insert(0, Card("Images compared with the light shown", Chart(_checked(decisions)), wide=True, note=note))
    if conversion is not None:
        part = record.part()
        picture = Image(chart.picture(cuts(conversion, part, 1.0, "viridis")), "across and along the axis")
        cards.insert(1, Card("Final conversion", Images([picture], "panels", 1), note="The part is outlined."))
    verdict = (f"The camera measured {counted(len(decisions), 'turn')}; the remaining light was "
               f"replaced {counted(swaps, 'time')}." if found
               else "The camera measured nothing that could change the light; the print ran as planned.")  # fmt: skip
    if doubted:
        verdict = (
            f"From turn {doubted['turn']}, the images were not used; the planned light continued: {doubted['doubt']}."
        )
    return Page("live print", record.folder.resolve().parent.stem, verdict, good, tiles, cards, headline)


def _rows(decisions: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    return [
        [str(each["turn"]), each["action"], str(each["version"]),
         "never" if each.get("effective", 0) is None else str(each.get("effective", "")), str(each["turns"]),
         "{:.3g} (at most {:.3g})".format(*each["checks"]["images"]) if each.get("checks") else "", each["reason"]]
        for each in decisions
    ]  # fmt: skip


def _true(truth: Truth | None, setup: LiveSetup) -> dict[str, float]:
    if truth is None:
        return {}
    values = asdict(truth)
    known = {name: float(values[key]) for name, key in TRUE.items()}
    return known | {"absorption": 1.0 + truth.absorption, "across": truth.across * setup.pixel, "height": 0.0}


def _found(each: Mapping[str, Any], setup: LiveSetup) -> dict[str, tuple[float, float]]:
    """Value and deviation of each estimate after a turn."""
    deviation = each["parameters"]["initial_dose"][1] / setup.resin.induction
    return each["parameters"] | {"inhibitor": (each["inhibitor"], deviation)}


def _named(name: str) -> str:
    unit = {"across": " [mm]", "height": " [mm]", "sinking": " [mm per turn]"}.get(name, "")
    return name.replace("_", " ") + unit


def _estimates(last: Mapping[str, Any], true: Mapping[str, float], setup: LiveSetup) -> Iterator[list[str]]:
    """Rows of the estimates, with the digits that their deviations leave."""
    for name, (value, error) in _found(last, setup).items():
        digits = max(0, 1 - floor(log10(error))) if error > 0 else 4
        row = [_named(name), f"{round(value, digits) + 0.0:.{digits}f}", f"{error:.{digits}f}"]
        yield row + ([f"{true[name]:.{digits}f}" if name in true else ""] if true else [])


def _checked(decisions: Sequence[Mapping[str, Any]]) -> str:
    """Each check over its limit, turn by turn."""
    doubted = next((each["turn"] for each in decisions if each.get("doubt")), None)

    def draw(axis: Any) -> None:
        for (name, (title, marker)), color in zip(CHECKS.items(), (chart.PART, chart.EXTRA), strict=True):
            rows = [(each["turn"], *each["checks"][name]) for each in decisions if name in each.get("checks", {})]
            turns, values, limits = np.transpose(np.asarray(rows, float).reshape(-1, 3))
            axis.plot(turns, values / limits, color=color, marker=marker, markersize=4, linewidth=1.4, label=title)
            for k in np.flatnonzero(values > limits):
                piece = slice(max(k - 1, 0), k + 1)
                axis.plot(turns[piece], values[piece] / limits[piece], color=chart.WARN, linewidth=2.2)
                axis.plot(turns[k], values[k] / limits[k], color=chart.WARN, marker=marker)
        axis.axhline(1.0, linestyle="--", linewidth=1.2, color=chart.INK, label="limit")
        if doubted is not None:
            axis.axvspan(doubted - 0.5, decisions[-1]["turn"] + 0.5, color=chart.WARN, alpha=0.12, linewidth=0)
        axis.set_xlim(0.5, decisions[-1]["turn"] + 0.5)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("turn")
        axis.xaxis.get_major_locator().set_params(integer=True)
        chart.above(axis, 3)

    return chart.svg(draw, chart.WIDE, 2.8)


def _curves(found: Sequence[Mapping[str, Any]], true: Mapping[str, float], setup: LiveSetup) -> str:
    turns = [each["turn"] for each in found]

    def draw(*axes: Any) -> None:
        for axis, name in zip(axes, SHOWN, strict=False):
            pairs = [_found(each, setup).get(name, (np.nan, 0.0)) for each in found]
            values, errors = np.transpose(np.asarray(pairs, float))
            axis.errorbar(turns, values, errors, marker="o", markersize=4, linewidth=1.4, capsize=2.5, color=chart.PART)
            if name in true:
                axis.axhline(true[name], linestyle="--", linewidth=1.0, color=chart.REST)
            axis.set_title(_named(name), fontsize=10.5)
            axis.set_xlabel("turn")
            axis.xaxis.get_major_locator().set_params(integer=True)
        for axis in axes[len(SHOWN) :]:
            axis.set_visible(False)

    return chart.svg(draw, chart.WIDE, 6.6, nrows=3, ncols=3)
