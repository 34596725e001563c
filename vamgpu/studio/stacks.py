"""Stacks of slices of stereolithography: before and after their correction, and the reports on what they cure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.curethrough.stack import open_stack
from vamgpu.jobs.curethrough import CurethroughJob
from vamgpu.storage.reading import read_bytes
from vamgpu.studio.volumes import png
from vamgpu.studio.workspace import JOB, Refused, Workspace


class Stacks:
    """The stacks of a workspace, by the names of their jobs."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace

    def _job(self, name: str) -> CurethroughJob:
        return CurethroughJob.read(self._workspace.existing(name, JOB))

    def _place(self, job: CurethroughJob, of: str) -> Path | None:
        """The slices "before" or "after" their correction, if they are files of this workspace."""
        if of == "after":
            return self._workspace.corrected(job)
        path = job.file.slices.path
        try:
            return None if path is None else self._workspace.existing(path)
        except Refused:
            return None

    def _page(self, name: str, of: str) -> tuple[Path, Path]:
        """The report of a model or a correction, and what it reports on."""
        job = self._workspace.existing(name, JOB)
        if of == "model":
            place = self._place(self._job(name), "before")
            return job.with_name(f"{job.stem}-model.html"), job if place is None else place
        made = self._workspace.corrected(self._job(name))
        if made is None:
            raise Refused(404, f"{name} has no corrected slices; correct them first")
        return made.with_name(f"{made.stem}.html"), made

    def described(self, name: str) -> dict[str, Any]:
        """The slices of a job, and what its reports found."""
        job, found = self._job(name), dict[str, Any]()
        for of in ("before", "after"):
            found[of] = None
            if (place := self._place(job, of)) is not None:
                with open_stack(place) as stack:
                    found[of] = {"name": place.name, "shape": list(stack.shape)}
        for of in ("model", "correct"):
            try:
                page, made = self._page(name, of)
            except Refused:
                found[of] = None
            else:
                _, verdict = self._workspace.reported(page, made)
                verdict = None if self._workspace.differs(page, job) else verdict
                found[of] = {"verdict": verdict, "report": page.is_file()}
        printer = job.file.printer
        return {"id": name, **found, "height": printer.slice_height, "absorption_height": printer.absorption_height,
                "layered": printer.exposure is not None}  # fmt: skip

    def slice(self, name: str, of: str, index: int) -> bytes:
        """A slice as PNG. Raises `Refused`."""
        place = self._place(self._job(name), of)
        if place is None:
            raise Refused(404, f"{name} has no slices {of} a correction in this workspace")
        with open_stack(place) as stack:
            if index >= len(stack):
                raise Refused(400, f"got slice {index}; expected 0 to {len(stack) - 1}")
            return png(np.array(stack[index : index + 1][0]))

    def report(self, name: str, of: str) -> bytes:
        """The report of a model or a correction. Raises `Refused`."""
        page, _ = self._page(name, of)
        if not page.is_file() or page.is_symlink():
            raise Refused(404, f"{name} has no such report; model or correct its slices first")
        return read_bytes(page)
