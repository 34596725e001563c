"""Answers of the API of Studio, as examples: a part, its dose, tasks, the schema, presets and rigs."""

from __future__ import annotations

import io
import time
from functools import cache
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

TEXT = """\
# Boat for the catalog
[target]
mesh = "benchy.stl"
height = "11.5 mm"     # without a pitch, voxels are as wide as a pixel in the resin

[vial]
radius = "12.4 mm"     # measured with a caliper
wall = "1 mm"
resin_index = 1.49962
wall_index = 1.473
absorption = "0.05 /mm"

[beam]
pixels = [360, 300]
pitch = "67 um"
fill = 0.92
spread = "25 um"

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""
PITCH = 0.15  # mm
VERDICT = {
    "prints": True,
    "proved": True,
    "opening": "Prints",
    "remedies": [],
    "latitude": [0.964, 1.089],
    "not_judged": [],
    "sentence": "Prints: 1 body and 8 holes as in the part, 95 % of the surface within 19.8 µm; the dose may be 3.6 % "
    "lower or 8.9 % higher; 22.7 s.",
}
NOT = VERDICT | {
    "prints": False,
    "opening": "Does not print",
    "latitude": None,
    "sentence": "Does not print: 2 of 8 holes are closed; stray resin prints 1.2 mm above the part.",
    "remedies": ["180 angles instead of 60", "120 evaluations instead of 20: the window still grew by 0.004 in each"],
}


@cache
def volumes() -> tuple[np.ndarray, np.ndarray]:
    """A ring on a plate, with a peg at +x, +y [x, y, z], and a dose that prints them."""
    x, y, z = np.meshgrid(*(PITCH * (np.arange(n) - n / 2 + 0.5) for n in (96, 96, 64)), indexing="ij")
    ring = (np.abs(np.hypot(x, z) - 2.6) < 0.9) & (np.abs(y) < 1.2)
    plate = (np.abs(z + 3.3) < 0.7) & (np.hypot(x, y) < 4.8)
    peg = (np.abs(x - 3.6) < 0.6) & (np.abs(y - 2.4) < 0.6) & (np.abs(z + 2) < 1.2)
    part = (ring | plate | peg).astype(np.float32)
    soft = gaussian_filter(part, 1.2)
    glow = 0.35 + 0.2 * gaussian_filter(part, 9) + 0.02 * np.sin(3 * x) * np.cos(2 * y)
    return part, np.clip(glow + 0.92 * soft, 0, 1.5).astype(np.float32)


@cache
def surface(of: str) -> dict[str, np.ndarray]:
    """Surface of the target or the print [mm], with a deviation at each vertex."""
    part, dose = volumes()
    field, level = (part, 0.5) if of == "target" else (dose, 1.0)
    points, faces, normals, _ = marching_cubes(gaussian_filter(field, 0.6), level, spacing=(PITCH,) * 3)
    points = points - PITCH * (np.array(field.shape) - 1) / 2
    deviation = 0.1 * np.sin(1.3 * points[:, 0]) * np.cos(1.7 * points[:, 2])
    arrays = {"positions": points, "normals": normals, "deviation": deviation}
    return {k: v.astype(np.float32) for k, v in arrays.items()} | {"indices": faces.astype(np.uint32)}


def png(image: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image.astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


def task(kind: str = "solve", state: str = "running", **changed: Any) -> dict[str, Any]:
    """A task of the queue."""
    now = time.time()
    progress = {
        "stage": "light",
        "said": "optimizing the patterns",
        "share": 0.31,
        "left": 42.0,
        "iteration": 37,
        "evaluations": 37.0,
        "loss": 0.0123,
        "window": 0.083,
        "warnings": [],
        "wall": now,
        "slices": 3,
        "stages": [
            {"stage": "voxels", "said": "voxelizing the part", "seconds": 1.2},
            {"stage": "rays", "said": "tracing rays through the vial", "seconds": 3.4},
        ],
        "notes": ["about 1.2 GB of memory, 120 evaluations of 0.3 s: about 40 s in all"],
    }
    made = {
        "id": f"20261127-19150{len(kind)}-{kind}",
        "kind": kind,
        "job": "boat.toml",
        "result": "boat.vam",
        "rig": None,
        "run": None,
        "device": None,
        "state": state,
        "added": now - 20,
        "began": now - 18,
        "ended": None,
        "status": None,
        "message": "",
        "resumable": False,
        "made": [],
        "request": {},
        "progress": progress,
    }
    return made | changed


def _key(name: str, kind: str, doc: str, default: str = "", **more: Any) -> dict[str, Any]:
    """A key of a table; one with a unit is a quantity above 0."""
    unit = more.get("unit", "")
    what = f"a value > 0 {unit}" if unit else {"count": "a whole number ≥ 1", "number": "a number"}.get(kind, "text")
    made = {
        "name": name,
        "type": "quantity" if unit else kind,
        "what": what,
        "unit": unit,
        "units": [unit],
        "least": None,
        "above": 0.0,
        "most": None,
        "below": None,
        "choices": [],
        "required": False,
        "default": default,
        "doc": doc,
    }
    return made | more


def schema() -> dict[str, Any]:
    """Some tables of job files."""

    def table(name: str, doc: str, *keys: dict[str, Any], optional: bool = True, **more: Any) -> dict[str, Any]:
        made = {
            "name": name,
            "doc": doc,
            "optional": optional,
            "many": False,
            "component": "",
            "kinds": [],
            "word": "kind",
        }
        return made | {"keys": list(keys)} | more

    tolerant = _key("tolerance", "number", "share of the first loss at which to stop", "0")
    return {
        "tables": [
            table(
                "target",
                "The part: a mesh file or a bundled shape, its size and its voxels.",
                _key("mesh", "file", "file of the part (STL, PLY, OBJ, 3MF, STEP)"),
                _key("height", "length", "height of the part along z", unit="mm"),
                _key("pitch", "length", "edge of a voxel; by default the width of a pixel in the resin", unit="mm"),
                _key("orientation", "list", "3 × 3 matrix that rotates the part first"),
                optional=False,
            ),
            table(
                "vial",
                "A round vial in air or in a bath of liquid.",
                _key("radius", "length", "outer radius", unit="mm", required=True),
                _key("wall", "length", "thickness of the wall", unit="mm", required=True),
                _key("resin_index", "number", "refractive index of the resin", required=True),
                _key("wall_index", "number", "refractive index of the wall", required=True),
                _key("bath_index", "number", "refractive index of what surrounds the vial", "1"),
                _key("absorption", "absorption", "absorption of the resin", '"0 1/mm"', unit="1/mm"),
            ),
            table(
                "beam",
                "The projector's light.",
                _key("pitch", "length", "edge of a pixel in air", unit="mm", required=True),
                _key("pixels", "list", "columns and rows; by default as many as the part needs"),
                _key("fill", "number", "share of a pixel's area that is lit", "1"),
                _key("spread", "any", "standard deviation of the point spread; by default half a pixel"),
                optional=False,
            ),
            table(
                "print",
                "Lamp and resin, for predicting print times.",
                _key("irradiance", "irradiance", "irradiance of a full-on pixel in air", unit="mW/mm2", required=True),
                _key("critical_dose", "dose", "dose at which the resin solidifies", unit="J/cm3", required=True),
            ),
            table(
                "solve",
                "Settings of the optimization.",
                _key("iterations", "count", "total number of iterations"),
                tolerant,
            ),
            table("method", "How the patterns are found.", kinds=["method.bclp", "method.osmo"]),
            table("body", "One of several bodies.", many=True),
        ],
        "components": {
            "method.bclp": {"doc": "Band-constrained Lp norm.", "keys": [tolerant]},
            "method.osmo": {"doc": "OSMO.", "keys": []},
        },
    }


def result(verdict: dict[str, Any] | None = VERDICT) -> dict[str, Any]:
    """A result, proved if it has a verdict."""
    steps = list(range(1, 41))
    lines = [
        ("process window, strict", "+0.0712", "least dose in the part minus the greatest outside, in thresholds"),
        ("voxels missing", "0", "of the part, that stay liquid"),
        ("voxels in excess", "3", "beside the part, that solidify"),
        ("mean brightness", "3.4 %", "of the frames, relative to a full-on pixel"),
    ]
    row = {"name": "as designed", "change": "", "window": 0.071, "wrong": 0, "note": ""}
    shifted = [("axis of rotation", f"{k * 20} µm", 0.071 - 0.02 * k, 3 * k) for k in (1, 2)]
    rows = [row, *({"name": n, "change": c, "window": w, "wrong": k, "note": ""} for n, c, w, k in shifted)]
    first = [{"name": "axis of rotation", "amount": 0.05, "text": "first wrong voxel at 52 µm"}]
    return {
        "id": "boat.vam",
        "kind": "vial",
        "state": "proved" if verdict else "solved",
        "job": "boat.toml",
        "modified": time.time(),
        "verdict": verdict,
        "lines": [dict(zip(("name", "value", "meaning"), each, strict=True)) for each in lines],
        "scores": {
            "window": 0.0712,
            "iou": 0.9991,
            "threshold": 0.81,
            "peak": 1.32,
            "missing": 0,
            "excess": 3,
            "in_voxels": 1,
            "out_voxels": 2,
        }
        if verdict
        else None,
        "seconds": 22.7 if verdict else None,
        "pitch": PITCH,
        "shape": [96, 96, 64],
        "radius": 5.7,
        "outer": {"share": 0.42, "place": [0, 0, 4]} if verdict else None,
        "tolerances": {"nominal": row, "rows": rows, "first": first} if verdict else None,
        "frames": {"count": 36, "rows": 64, "columns": 96, "bits": 8, "scale": 1.1},
        "history": {
            "iteration": steps,
            "evaluations": steps,
            "loss": [0.1 / k for k in steps],
            "window": [0.09 - 0.3 / k for k in steps],
        },
        "exposed": [{"off": "axis-20um-dose-minus5", "proof": "boat@axis-20um.proof"}] if verdict else [],
        "report": "/api/v1/results/boat.vam/report" if verdict else None,
    }


def scene() -> dict[str, Any]:
    return {
        "vessel": {"table": "vial", "kind": "vial", "shape": "cylinder", "radius": 12.4, "inner": 11.4, "lit": 9.8},
        "part": {
            "triangles": 225706,
            "low": [-5, -4.8, -4],
            "high": [5, 4.8, 3.5],
            "extents": [9.6, 9.6, 7.5],
            "radius": 4.9,
        },
        "grid": {"shape": [256, 256, 178], "pitch": 0.045, "radius": 9.8},
        "problems": [],
        "doubts": [],
        "memory": 2.1e9,
        "beam": {"pixels": [360, 300], "pitch": 0.067, "width": 21.0, "height": 12.1, "reach": 8.9},
    }


def presets() -> dict[str, Any]:
    def one(name: str, source: str, **values: Any) -> dict[str, Any]:
        return {"id": name.lower().replace(" ", "-"), "name": name, "source": source, "own": not source, "set": values}

    vial = {"vial.radius": "12.4 mm", "vial.wall": "1 mm"}
    return {
        "vials": [
            one("Vial of 25 mm", "D. Loterie et al., 2020", **vial),
            one("our small vial", "", **{"vial.radius": "8 mm"}),
        ],
        "projectors": [
            one("360 × 300 pixels of 67 µm", "the README", **{"beam.pitch": "67 um", "beam.pixels": [360, 300]})
        ],
        "resins": [one("dudma-pegda", "J. Smith et al., 2022", **{"resin.material": "dudma-pegda"})],
    }


def rig() -> dict[str, Any]:
    claims = [
        ("light", "guaranteed", "the controller switches the light off 1 s after its host falls silent", None),
        ("motion", "watched", "an encoder reports the angle; a stall holds the print", None),
        ("dose", "believed", "no sensor sees the lamp", "calibrate it with vam calibrate power"),
    ]
    rows = [
        {"about": a, "kind": k, "why": w, "remedy": r, "sensor": "", "holds": k != "believed"} for a, k, w, r in claims
    ]
    return {"id": "emulated", "machine": "vial", "parts": {}, "guarantees": rows, "refused": "", "emulated": True}


def runs() -> dict[str, Any]:
    done = {"name": "boat.run", "job": "boat.vam", "state": "complete", "message": "", "began": time.time() - 4000}
    held = {
        "name": "boat-2.run",
        "job": "boat.vam",
        "state": "error",
        "message": "the motor stalled at 212.8 deg; look at its cable",
        "began": time.time() - 90000,
    }
    more: dict[str, Any] = {"seconds": 214.0, "doubt": 0, "running": False, "reports": ["report.html"]}
    return {"runs": [done | more, held | more | {"seconds": 61.0, "reports": []}]}


def compared() -> dict[str, Any]:
    rows = [
        {"name": "window", "meaning": "strict", "a": "+0.0712", "b": "+0.0211"},
        {"name": "exposure", "meaning": "", "a": "22.7 s", "b": "31.0 s"},
    ]
    return {"rows": rows, "keys": [{"key": "turntable.angles", "a": "360", "b": "60"}]}
