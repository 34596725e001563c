"""Modulation along the light, from images of a slanted edge at several positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vamgpu.calibration.mtf import EdgeResponse, slanted_edge
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.calibrate import patterns
from vamgpu.hosts.calibrate.machines import (
    CalibrationLight,
    CalibrationMachines,
    Progress,
    need,
    over_positions,
    silent,
)
from vamgpu.hosts.calibrate.report import CalibrationResult

TABLES = ("camera", "camera_stage")  # tables of a rig's file that it needs, with [lens] if its power is set
POSITIONS = (-15.0, -6.0, 0.0, 6.0, 15.0)  # positions along the light [mm], from the middle of the camera's stage


def mtf(
    machines: CalibrationMachines, positions: Sequence[float] = POSITIONS, *, powers: Sequence[float] | None = None,
    angle: float = 5.0, repeats: int = 4, projector: int = 0, progress: Progress = silent,
) -> CalibrationResult:  # fmt: skip
    """Measure the modulation at camera positions [mm] and lens powers [dpt] with an edge slanted by an angle [deg]."""
    pixel = need(machines.rig.camera, "camera").pixel
    if pixel is None:
        raise JobError(
            'the camera in [[feedback]] has no pixel; expected pixel = "3.45 um", in the plane that the camera sees'
        )
    if repeats < 1 or (powers is not None and len(powers) != len(positions)):
        raise BadInput(f"{repeats} images and {powers!r} for {len(positions)} positions; expected one power for each")
    ahead = iter(powers or ())

    def averaged(light: CalibrationLight, place: float) -> tuple[float, list[float], np.ndarray]:
        true = [] if powers is None else [machines.focus(next(ahead), light)]
        return place, true, np.mean([machines.image(light) for _ in range(repeats)], axis=0)

    edge = patterns.slanted(machines.screen(projector).shape, angle)
    seen = over_positions(machines, projector, positions, edge, averaged, progress)
    places, images = [place for place, _, _ in seen], [image for _, _, image in seen]
    return _found(places, [power for _, true, _ in seen for power in true], images, pixel)


def _found(places: list[float], powers: list[float], images: list[np.ndarray], pixel: float) -> CalibrationResult:
    edges: list[EdgeResponse] = []
    for place, image in zip(places, images, strict=True):
        try:
            edges.append(slanted_edge(image, pixel))
        except BadInput as error:
            raise BadInput(f"position {place:g} mm: {error}") from error
    numbers = {
        "positions_mm": places, "powers_dpt": powers, "mtf50_per_mm": [edge.half for edge in edges],
        "blur_mm": [edge.width for edge in edges], "blur_error_mm": [edge.width_error for edge in edges],
        "contrast": [edge.contrast for edge in edges],
        "angle_deg": [edge.angle for edge in edges], "pixel_mm": pixel,
    }  # fmt: skip
    lines = tuple(
        (
            f"MTF50 at {place:+g} mm",
            f"{edge.half:.3g} cycles/mm, blur {1e3 * edge.width:.4g} ± {1e3 * edge.width_error:.2g} µm",
        )
        for place, edge in zip(places, edges, strict=True)
    )
    readings = {"positions": np.array(places), "images": np.stack(images), "frequency": edges[0].frequency}
    readings["modulation"] = np.stack([edge.modulation for edge in edges])
    return CalibrationResult("mtf", numbers, readings, lines, lambda axes: _draw(axes, places, edges))


def _draw(axes: Any, places: list[float], edges: list[EdgeResponse]) -> None:
    for place, edge in zip(places, edges, strict=True):
        axes.plot(edge.frequency, edge.modulation, lw=1.2, label=f"{place:+g} mm")
    axes.axhline(0.5, color="#9aa5b4", lw=0.8, ls=":")
    axes.legend(frameon=False)
    axes.set(title="Modulation", xlabel="cycles/mm", ylabel="modulation", ylim=(0, 1.05))
    axes.set_xlim(0, max(4.0 * max(edge.half for edge in edges), 1.0))
