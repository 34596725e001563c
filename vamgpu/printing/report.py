"""A proof as one self-contained HTML page, mostly of pictures."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib import metadata
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

import vamgpu
from vamgpu.methods.papers import CAL, OBJECT_SPACE, THRESHOLDS, VIAL
from vamgpu.methods.tolerances import CornerDose, CornerDoses
from vamgpu.operators.dose_unit import absorbs
from vamgpu.printing import charts, pictures, surface
from vamgpu.printing.judgement import WHOLE, Judgement
from vamgpu.printing.pictures import GAMMA
from vamgpu.printing.proof import Proof, efficiency
from vamgpu.printing.summary import headline, summary
from vamgpu.printing.verdict import verdict_of
from vamgpu.quantity import counted
from vamgpu.reports.page import Card, Chart, Figure, Images, Legend, Numbers, Page, Papers, Slices, SurfaceView, Table

BYTES_A_VOXEL = 1800
"""Memory of a report per voxel of the part; 1.75 kB was measured at 128³."""
PACKAGES = ("numpy", "pyopencl", "warp-lang", "scikit-image", "trimesh")
MEASURES = (CAL, OBJECT_SPACE, THRESHOLDS)
"""Sources of the scores: dose as a sum of projections; window, VER and IPDR; light efficiency."""

JOSEPH = "P. M. Joseph, An improved algorithm for reprojecting rays through pixel images, IEEE TMI 1 (1982) 192"


def report_bytes(proof: Proof) -> int:
    """Memory that drawing a report takes."""
    return BYTES_A_VOXEL * min(prod(proof.operator.grid.shape), WHOLE // 8)


def write_report(proof: Proof, path: str | Path, plan: Any = None, judgement: Judgement | None = None) -> Path:
    """Write the page of a proof; arguments as for `page_of`. Raises `StorageError`."""
    return page_of(proof, plan, judgement).write(path)


def page_of(proof: Proof, plan: Any = None, judgement: Judgement | None = None) -> Page:
    """The page of a proof."""
    verdict = proof.verdict if judgement is None else verdict_of(proof, judgement)
    judgement = proof.judgement if judgement is None else judgement
    grid, scores = proof.operator.grid, proof.scores
    dose, target = proof.dose.numpy(), proof.target.numpy()
    judged = dose if proof.limits is None else proof.parts.dose.numpy()
    printed = pictures.verdicts(target, judged >= scores.threshold, grid.cylinder())
    asked = _asked(proof, target)
    data, deviation = _drawn(proof, dose, target, asked, printed)
    return Page(
        "Print proof",
        proof.name,
        verdict.sentence,
        proof.independent and verdict.prints,
        _tiles(proof),
        [
            Card("Printed part", SurfaceView(f"{1e3 * deviation:.3g}"), note=_surface_note(proof)),
            Card("Slices", Slices(), Legend(),
                 *(Images(cut, "trio upright") for cut in pictures.cuts(dose, asked, printed, scores.peak))),
            Card("Dose inside and outside", Chart(charts.histogram_chart(proof.histogram(), scores)), wide=True),
            *_slice_by_slice(proof, plan),
            *_light(proof),
            *_corners(proof, plan),
            *_pareto(plan),
            Card("Numbers", Numbers(proof.lines()), wide=True),
            Card("Set-up", Table(_setup(proof, plan))),
            Card("Made with", Table(_versions(proof))),
            Card("Papers relied on", Papers(_papers(proof, plan)), wide=True),
        ],
        headline=headline(proof, judgement, verdict),
        summary=summary(proof, judgement),
        remedies=verdict.remedies,
        data=data,
    )  # fmt: skip


def _slice_by_slice(proof: Proof, plan: Any) -> Iterator[Card]:
    convergence = charts.convergence_chart(plan.history) if plan is not None and plan.history else None
    wide = convergence is None
    slices = Chart(charts.slices_chart(proof.slices, proof.operator.grid.axes()[2], wide=wide))
    yield Card("Slice by slice", slices, note="One scale and one threshold for the whole volume.", wide=wide)
    if convergence is not None:
        yield Card("Convergence", Chart(convergence))


def _corners(proof: Proof, plan: Any) -> Iterator[Card]:
    """The window at every corner of tolerances: proved if known, otherwise planned."""
    doses, kept = proof.corners, getattr(plan, "corners", None)
    note = "Proved from the frames"
    if doses is None and kept:
        doses = kept if isinstance(kept, CornerDoses) else CornerDoses(tuple(CornerDose(**dict(one)) for one in kept))
        note = "Computed by the solver, before packing"
    if doses is None:
        return
    rows = [("all corners, one threshold", f"{doses.window:+.4f}")]
    rows += [
        (corner.name, f"{corner.window:+.4f}; part ≥ {corner.least / top:.3f}, outside ≤ {corner.leak / top:.3f}")
        for top in (max(max(corner.greatest for corner in doses.corners), 1e-30),)
        for corner in doses.corners
    ]
    yield Card("At its tolerances", Table(rows), note=f"{note}: {doses.statement()}. Doses are shares of the maximum.")


def _pareto(plan: Any) -> Iterator[Card]:
    """The windows of shorter exposures."""
    points = getattr(plan, "pareto", ())
    if len(points) > 1:
        note = "The widest window for each exposure limit, before packing; the longest exposure is this job's."
        yield Card("Window against time", Chart(charts.pareto_chart(points)), note=note)


def _light(proof: Proof) -> Iterator[Card]:
    light, full = proof.frames.irradiance(proof.operator.device).numpy(), float(proof.frames.scale)
    motion = proof.operator.motion
    note = f"Patterns of the middle row: pixels across, angles downwards, {motion}. Shown with a gamma of {GAMMA:g}."
    yield Card("Sinogram", Images([pictures.sinogram(light, full)], "sinogram"), note=note)
    shown = Images(pictures.frames(light, full, np.degrees(motion.poses)), "frames")
    yield Card("Frames", shown, note=_frames_note(proof))


def _drawn(
    proof: Proof, dose: np.ndarray, target: np.ndarray, asked: np.ndarray, verdict: np.ndarray
) -> tuple[dict[str, Any], float]:
    """Data for the page's script, and the deviation [mm] at the ends of its color scale."""
    pitch, cylinder = proof.operator.grid.pitch, proof.operator.grid.cylinder()
    expected = surface.iso_surface(target, 0.5, pitch)
    printed = surface.iso_surface(np.where(cylinder[:, :, None], dose, 0.0), proof.solid_from, pitch)
    outer = surface.NOTHING
    if proof.outer is not None and proof.outer_share >= 1.0:
        slabs, radius = proof.fine() if proof.independent else (), proof.operator.grid.inscribed_radius
        outer = surface.stray(slabs, proof.solid_from, radius, proof.outer.place, 2.0 * proof.outer.width)
    sheet = pictures.sheet(dose, asked, verdict, proof.scores.peak)
    z = proof.operator.grid.axes()[2]
    heights = [float(z[k]) for k in sheet["slices"]]
    slices = pictures.viewer(sheet, heights, int(np.argmax(proof.slices.in_voxels[sheet["slices"]])))
    return surface.viewer(expected, printed, pitch, outer) | slices, pitch


def _tiles(proof: Proof) -> list[Figure]:
    """Scores and the use of light, each with its meaning."""
    scores = proof.scores
    part = "of the light sent is absorbed in the part" if absorbs(proof.operator) else "mean path of light in the part"
    outside = f"{proof.outside_over_inside:.3f}"
    tiles = [
        ("IoU", f"{scores.iou:.4f}", "intersection over union at the threshold"),
        ("VER", _power(scores.error_rate), "voxels on the wrong side of the threshold"),
        ("IPDR", f"{scores.dose_range:.3f}", "range of the dose in the part / greatest dose"),
        ("light efficiency", efficiency(proof), part),
        ("idle light", f"{100 * proof.idle_light:.2g} %", "of the light sent never meets the part"),
        ("mean brightness", f"{100 * proof.mean_brightness:.2g} %", "mean of all pixels / a full-on pixel"),
        ("dose outside over inside", outside, "mean dose outside the part / mean dose in it"),
    ]
    return [Figure(value, name, meaning) for name, value, meaning in tiles]


def _power(value: float) -> str:
    """A share in percent, with two digits."""
    return "0" if value == 0 else f"{100 * value:.2g} %"


def _surface_note(proof: Proof) -> str:
    grid = proof.operator.grid
    width, depth, height = (n * grid.pitch for n in grid.shape)
    return (
        "Surface where the dose reaches the threshold, colored by its distance from the target; the scale ends at one "
        f"voxel. {_stray_note(proof)}Field of {width:.3g} × {depth:.3g} × {height:.3g} mm. "
        "Drag to turn, scroll to zoom."
    )


def _stray_note(proof: Proof) -> str:
    """The meaning of orange."""
    return "Orange: resin beyond the judged cylinder that also prints. " if proof.outer_share >= 1.0 else ""


def _asked(proof: Proof, target: np.ndarray) -> np.ndarray:
    """The target as shown [x, y, z]: gray bodies that need more dose are darker."""
    limits = proof.limits
    if limits is None:
        return target
    return np.where(limits.gray, np.maximum(target, 0.2 + 0.6 * np.clip(limits.dose, 0.0, 1.0)), target)


def _frames_note(proof: Proof) -> str:
    angles, columns, rows = proof.operator.range.shape
    bits = getattr(proof.frames, "bits", None)
    depth = f" of {counted(bits, 'bit')}" if bits else ""
    frames = f"{counted(angles, 'frame')} of {columns} × {rows} pixels{depth}"
    return f"{frames}; full-on is white, shown with a gamma of {GAMMA:g}."


def _setup(proof: Proof, plan: Any) -> list[tuple[str, str]]:
    A = proof.operator
    rows = [
        ("grid", str(A.grid)),
        ("beam", f"{' × '.join(map(str, A.beam.pixels))} pixels of {1e3 * A.beam.pitch:.4g} µm"),
        ("angles", str(A.motion)),
        ("vessel", _described(A.vessel) if A.vessel else "none: straight light, nothing absorbed"),
    ]
    if plan is not None:
        method = getattr(plan, "method", None)
        rows += [("method", _described(method))] if method else []
        seconds = getattr(plan, "seconds", None)
        ran = getattr(plan, "ran", "")
        rows += [("optimized in", f"{seconds:.3g} s{' by ' if ran else ''}{ran}")] if seconds else []
        window = getattr(plan, "window", None)
        known = window is not None and getattr(plan, "history", True)  # unknown for patterns from elsewhere
        rows += [("window before packing", f"{window:+.4f}")] if known else []
        bound = getattr(plan, "bound", None)
        on = getattr(bound, "on", getattr(plan, "bound_on", ""))
        bound = getattr(bound, "value", bound)
        where = f" on {on}" if on else ""
        rows += [("upper bound of the window", f"{bound:+.4f}{where}, from the solver")] if bound is not None else []
        rows += [("note", note) for note in getattr(plan, "notes", ())]
    return rows


def _described(value: Any) -> str:
    """Name and numbers of a frozen description."""
    from dataclasses import fields, is_dataclass

    if isinstance(value, str) or not is_dataclass(value):
        return str(value) if isinstance(value, str) else type(value).__name__
    parts = [f"{f.name.replace('_', ' ')} {getattr(value, f.name)!r}" for f in fields(value) if f.repr]
    return f"{type(value).__name__}: {', '.join(parts)}" if parts else type(value).__name__


def _versions(proof: Proof) -> list[tuple[str, str]]:
    device = proof.operator.device
    rows = [("device", f"{device.description} ({device.name})"), ("vamgpu", vamgpu.__version__)]
    rows.append(("Python", platform.python_version()))
    for package in PACKAGES:
        try:
            rows.append((package, metadata.version(package)))
        except metadata.PackageNotFoundError:
            continue
    return rows


def _papers(proof: Proof, plan: Any) -> list[str]:
    own = (*MEASURES, VIAL if proof.operator.vessel else JOSEPH)
    return list(dict.fromkeys([*(str(paper) for paper in getattr(plan, "papers", ())), *own]))
