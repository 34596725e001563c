"""A rehearsed calibration beside the truth of its emulated optics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vamgpu.hosts.calibrating.report import Found
from vamgpu.hosts.calibrating.stand import Stand

HIGHEST = 100.0
"""Frequency up to which the truth is looked at [1/mm]."""


def compared(found: Found, optics: Any, stand: Stand) -> Found:
    """The same with the emulated truth: a table ``emulated``, and lines. optics: of `vamgpu.hosts.emulators.optics`."""
    truth, lines = {"focus": _focus, "axis": _axis, "gray": _gray, "mtf": _mtf}[found.kind](found, optics, stand)
    return replace(found, lines=(*found.lines, *lines), tables={**found.tables, "emulated": truth})


def _focus(found: Found, optics: Any, stand: Stand) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    power = -optics.middle / optics.slope
    truth = {"slope_mm_dpt": optics.slope, "axis_dpt": power}
    return truth, [("emulated", f"{optics.slope:.3f} mm/dpt, {power:.4f} dpt at the middle")]


def _axis(found: Found, optics: Any, stand: Stand) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    truth = {"column": optics.axis, "radius_columns": optics.radius}
    return truth, [("emulated", f"column {optics.axis:.3f}, radius {optics.radius:.3f} columns")]


def _gray(found: Found, optics: Any, stand: Stand) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    lit = round(1e6 * stand.screens[0].period)
    curve = found.tables["gray"]
    light = np.array([optics.gray(level, lit) for level in curve["levels"]])
    off = float(np.abs(light / light[-1] - np.array(curve["intensity"])).max())
    truth = {"black": float(light[0] / light[-1]), "largest_error": off}
    return truth, [("emulated", f"black {100 * truth['black']:.3f} %, largest error of a level {100 * off:.2g} %")]


def _mtf(found: Found, optics: Any, stand: Stand) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    frequency = np.linspace(0.0, HIGHEST, 20001)
    places = found.numbers["positions_mm"]
    powers = found.numbers["powers_dpt"] or [0.0] * len(places)
    pixel = found.numbers["pixel_mm"]
    half = [
        float(frequency[np.argmax(optics.modulation(frequency, place, power, pixel) < 0.5)])
        for place, power in zip(places, powers, strict=True)
    ]
    return {"mtf50_per_mm": half}, [("emulated", ", ".join(f"{each:.3g}" for each in half) + " cycles/mm")]
