"""Orientations of a part that print well, by coarse solutions."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.build import SPARE, covering, light_of, projection_of, source_of, target_of
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import StageProgress, quiet
from vamgpu.methods import optimize
from vamgpu.printing.pack import pack
from vamgpu.printing.simulate import simulate
from vamgpu.targets.mesh import Solid, load_mesh

COARSER = 2.5  # ratio of the voxels and pixels of the search to those of the job
ITERATIONS = 20
BEST = 5
GOLDEN = np.pi * (3.0 - 5.0**0.5)


def orientations(
    job: Job, count: int = 20, device: str | None = None, progress: StageProgress = quiet
) -> list[dict[str, Any]]:
    """The orientations with the widest windows, best first; the job's own is among those tried."""
    section = job.file.target
    if job.file.body or job.file.colors is not None:
        raise BadInput("orientations are searched for a single part in one color; leave out [[body]] and [colors]")
    place = open_device(device or job.file.solve.device)
    source = source_of("target.shape", section, job.folder)
    solid = source if isinstance(source, Solid) else load_mesh(source)
    usual = np.eye(3) if section.orientation is None else np.asarray(section.orientation)
    high = solid.rotated(usual).height
    factor = section.factor or float(section.height or high) / high
    found: list[dict[str, Any]] = []
    for number, matrix in enumerate(_turned(usual, count)):
        progress("orientations", number / count)
        one = _tried(job, solid, matrix, factor, place)
        found += [] if one is None else [one]
    if not found:
        raise BadInput("the part fits the light in no orientation; expected a smaller part, or a larger vial")
    best = sorted(found, key=lambda one: (-one["window"], -one["iou"]))[:BEST]
    return [{"rank": rank + 1, **one} for rank, one in enumerate(best)]


def _turned(usual: np.ndarray, count: int) -> Iterator[np.ndarray]:
    """The job's orientation, and even ones over a hemisphere: a part prints the same upside down."""
    yield usual
    for k in range(1, count):
        z = 1.0 - k / count
        turn, flat = GOLDEN * k, (1.0 - z * z) ** 0.5
        up = np.array([flat * np.cos(turn), flat * np.sin(turn), z])
        across = np.array([-np.sin(turn), np.cos(turn), 0.0])
        yield np.stack([np.cross(across, up), across, up]) @ usual


def _tried(job: Job, solid: Solid, matrix: np.ndarray, factor: float, device: Any) -> dict[str, Any] | None:
    """The coarse solution of one orientation; None if the part does not fit."""
    file = job.file
    target = file.target.model_copy(update={"orientation": tuple(map(tuple, matrix.tolist())), "factor": factor,
                                            "height": None})  # fmt: skip
    file = file.model_copy(update={"target": target})
    edge = COARSER * (file.target.pitch or file.beam.pitch)
    beam = file.beam.model_copy(update={"pitch": COARSER * file.beam.pitch, "pixels": None, "spread": None})
    target = target.model_copy(update={"pitch": edge})
    coarse = replace(job, file=file.model_copy(update={"target": target, "beam": beam}))
    placed: Any = solid.placed(rotation=matrix, factor=factor)
    tilt = float(np.degrees(np.arccos(np.clip(matrix[2, 2], -1.0, 1.0))))
    facts = {
        "matrix": matrix.tolist(), "tilt": tilt, "azimuth": float(np.degrees(np.arctan2(matrix[2, 1], matrix[2, 0]))),
        "height": placed.height, "radius": placed.radius, "fits": True, "remove": ["target.height"],
        "set": {"target.orientation": matrix.round(9).tolist(), "target.factor": factor},
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # coarse voxels are meant
        try:
            needed = covering(placed, light_of(file), file.beam.pitch, None)
            if any(have + 2 * SPARE < need for have, need in zip(file.beam.pixels or needed, needed, strict=True)):
                return None
            part = target_of(coarse, device)
            A = projection_of(coarse.file, part, device, job.folder)
        except JobError:
            raise
        except BadInput:
            return None
        plan = optimize(A, part, iterations=ITERATIONS, progress=False)
        lamp = {} if file.print is None else file.print.model_dump()
        proof = simulate(A, pack(plan), part, coarse=True, **lamp)
    return facts | {"window": proof.scores.window, "iou": proof.scores.iou, "seconds": proof.seconds}
