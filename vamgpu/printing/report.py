"""A proof as one self-contained HTML page, mostly of pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from math import prod
from typing import Any

import numpy as np

from vamgpu.chemistry.oxygen import OxygenModel
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
from vamgpu.reports.chart import colored, picture
from vamgpu.reports.line import Line
from vamgpu.reports.page import (
    Card,
    Chart,
    Image,
    Images,
    Legend,
    Numbers,
    Page,
    Papers,
    Slices,
    SurfaceView,
    Table,
)
from vamgpu.storage.manifest import versions

BYTES_A_VOXEL = 1800  # memory of a report per voxel of the part; 1.75 kB was measured at 128³
PACKAGES = ("numpy", "pyopencl", "warp-lang", "scikit-image", "trimesh")
MEASURES = (CAL, OBJECT_SPACE, THRESHOLDS)
"""Sources of the scores: dose as a sum of projections; window, VER and IPDR; light efficiency."""


def report_bytes(proof: Proof) -> int:
    """Memory that drawing a report takes."""
    return BYTES_A_VOXEL * min(prod(proof.operator.grid.shape), WHOLE // 8)


def page_of(proof: Proof, plan: Any = None, judgement: Judgement | None = None) -> Page:
    """The page of a proof."""
    given = judgement
    judgement = proof.judgement if judgement is None else judgement
    grid, device, scores = proof.operator.grid, proof.operator.device, proof.scores
    dose, target = proof.dose.numpy(), proof.target.numpy()
    judged = dose if proof.limits is None else proof.parts.dose.numpy()
    printed = pictures.verdicts(target, judged >= scores.threshold, grid.cylinder())
    papers = [*map(str, getattr(plan, "papers", ())), *MEASURES, *([VIAL] if proof.operator.vessel else [])]
    made, asked = versions(PACKAGES), _asked(proof, target)
    data, deviation = _drawn(proof, dose, target, asked, printed)
    cards = [
        Card("Printed part", SurfaceView(f"{1e3 * deviation:.3g}"), note=_surface_note(proof)),
        Card("Slices", Slices(), Legend(),
             *(Images(cut, "trio upright") for cut in pictures.cuts(dose, asked, printed, scores.peak))),
        Card("Dose inside and outside", Chart(charts.histogram_chart(proof.histogram(), scores)), wide=True),
        *_oxygen(proof),
        *_slice_by_slice(proof, plan),
        *_light(proof),
        *_corners(proof, plan),
        *_pareto(plan),
        Card("Numbers", Numbers(proof.lines()), wide=True),
        Card("Set-up", Table(_setup(proof, plan))),
        Card("Made with", Table([("device", f"{device.description} ({device.name})"), *made.items()])),
        Card("Papers relied on", Papers(list(dict.fromkeys(papers))), wide=True),
    ]  # fmt: skip
    first = summary(proof, judgement)  # from here on, the page waits for the comparison of surfaces
    verdict = proof.verdict if given is None else verdict_of(proof, judgement)
    return Page(
        "Print proof" if proof.off is None else f"Print proof on a machine with errors: {proof.off}",
        proof.name,
        verdict.sentence,
        proof.independent and verdict.prints,
        _tiles(proof),
        cards,
        headline=headline(proof, judgement, verdict),
        summary=first,
        remedies=verdict.remedies,
        not_judged=verdict.not_judged,
        data=data,
    )


def _oxygen(proof: Proof) -> Iterator[Card]:
    """Oxygen that is left, curing, and when resin solidifies, in the slice with most of the part."""
    A: Any = proof.operator
    if not isinstance(A, OxygenModel):
        return
    light, at = proof.frames.irradiance(A.device), int(np.argmax(proof.slices.in_voxels))
    times, state = A.gel_times(light, proof.scores.threshold), A.state(light)
    left, cured = 1.0 - state.used.numpy()[:, :, at], state.cured.numpy()[:, :, at]
    gelled, seconds, most = times[:, :, at], A.oxygen.seconds, float(cured.max()) or 1.0
    shown = [
        (left, "viridis", "oxygen left, 0 to that of saturated resin"),
        (cured / most, "magma", f"cured: dose that found no oxygen, 0 to {most:.3g}"),
        (np.minimum(gelled / seconds, 1.0), "cividis", f"solid after 0 to {seconds:.4g} s, or never"),
    ]
    images = [Image(picture(colored(pictures.upright(values), name)), said) for values, name, said in shown]
    note = (
        f"After {A.turns:,} turns of {A.period:g} s, at z = {A.grid.axes()[2][at]:.3g} mm. "
        "Doses are relative to that which uses up the oxygen of saturated resin. The solver's model gives these maps."
    )
    yield Card("Oxygen", Images(images, "trio upright"), note=note, wide=True)


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
    yield Card("At its tolerances", Table(rows), note=f"{note}: {doses.statement()}. Doses are relative to the peak.")


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
    (angles, columns, rows), bits = proof.operator.range.shape, getattr(proof.frames, "bits", None)
    size = f"{columns} × {rows} pixels" + (f" of {counted(bits, 'bit')}" if bits else "")
    note = f"{counted(angles, 'frame')} of {size}; full-on is white, shown with a gamma of {GAMMA:g}."
    shown = Images(pictures.frames(light, full, np.degrees(motion.poses)), "frames")
    yield Card("Frames", shown, note=note)


def _drawn(
    proof: Proof, dose: np.ndarray, target: np.ndarray, asked: np.ndarray, verdict: np.ndarray
) -> tuple[dict[str, Any], float]:
    """Data for the page's script, and the deviation [mm] at the ends of its color scale."""
    pitch, cylinder = proof.operator.grid.pitch, proof.operator.grid.cylinder()
    expected = surface.iso_surface(target, 0.5, pitch)
    printed = surface.iso_surface(np.where(cylinder[:, :, None], dose, 0.0), proof.solid_from, pitch)
    sheet = pictures.sheet(dose, asked, verdict, proof.scores.peak)
    z = proof.operator.grid.axes()[2]
    heights = [float(z[k]) for k in sheet["slices"]]
    slices = pictures.viewer(sheet, heights, int(np.argmax(proof.slices.in_voxels[sheet["slices"]])))
    return surface.viewer(expected, printed, pitch, surface.stray(proof)) | slices, pitch


def _tiles(proof: Proof) -> list[Line]:
    """Scores and the use of light, each with its meaning."""
    scores = proof.scores
    part = "of the light sent is absorbed in the part" if absorbs(proof.operator) else "mean path of light in the part"
    outside = f"{proof.outside_over_inside:.3f}"
    tiles = [
        ("IoU", f"{scores.iou:.4f}", "intersection over union at the threshold"),
        ("VER", f"{100 * scores.error_rate:.2g} %", "voxels on the wrong side of the threshold"),
        ("IPDR", f"{scores.dose_range:.3f}", "range of the dose in the part / greatest dose"),
        ("light efficiency", efficiency(proof), part),
        ("idle light", f"{100 * proof.idle_light:.2g} %", "of the light sent never meets the part"),
        ("mean brightness", f"{100 * proof.mean_brightness:.2g} %", "mean of all pixels / a full-on pixel"),
        ("dose outside over inside", outside, "mean dose outside the part / mean dose in it"),
    ]
    return [Line(*tile) for tile in tiles]


def _surface_note(proof: Proof) -> str:
    grid = proof.operator.grid
    width, depth, height = (n * grid.pitch for n in grid.shape)
    stray = "Orange: resin beyond the judged cylinder that also prints. " if proof.outer_share >= 1.0 else ""
    return (
        "Surface where the dose reaches the threshold, colored by its distance from the target; the scale ends at one "
        f"voxel. {stray}Field of {width:.3g} × {depth:.3g} × {height:.3g} mm. "
        "Drag to turn, scroll to zoom."
    )


def _asked(proof: Proof, target: np.ndarray) -> np.ndarray:
    """The target as shown [x, y, z]: gray bodies that need more dose are darker."""
    limits = proof.limits
    if limits is None:
        return target
    return np.where(limits.gray, np.maximum(target, 0.2 + 0.6 * np.clip(limits.dose, 0.0, 1.0)), target)


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
    if isinstance(value, str) or not is_dataclass(value):
        return str(value) if isinstance(value, str) else type(value).__name__
    parts = [f"{f.name.replace('_', ' ')} {getattr(value, f.name)!r}" for f in fields(value) if f.repr]
    return f"{type(value).__name__}: {', '.join(parts)}" if parts else type(value).__name__
