"""Proofs in job folders: the dose beside the frames, and the numbers computed from it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid
from vamgpu.methods.plan_folder import inputs_of, operator_from, target_from
from vamgpu.methods.tolerances import Corner
from vamgpu.metrics import Scores, SliceScores
from vamgpu.metrics.window import Windows
from vamgpu.printing.beyond_cylinder import Outer
from vamgpu.printing.exposure import ExposureTimes
from vamgpu.printing.folder import frames_of, save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.given_dose import GivenDose, ProvedDose
from vamgpu.printing.pack import Solved
from vamgpu.printing.proof import Proof
from vamgpu.printing.surface import NOTHING, stray
from vamgpu.storage.folder import Entry, Folder
from vamgpu.storage.reading import malformed
from vamgpu.targets.target import Target

RECORDS: dict[str, type[Any]] = {
    one.__name__: one
    for one in (Scores, SliceScores, Windows, Outer, ExposureTimes, GivenDose, ProvedDose, Corner)
}  # fmt: skip
"""Records that hold the numbers of a proof."""
FIELDS = ("scores", "slices", "light_efficiency", "mean_brightness", "claimed", "outer", "independent", "exposure",
          "width", "agrees", "given", "off")  # fmt: skip
"""Records of a proof that its manifest must hold."""
LATER = ("width", "agrees", "given", "off")  # records that manifests of 0.3 may lack


def save_proof(proof: Proof, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a proof, see `Proof.save`."""
    if not isinstance(proof.frames, Frames):
        raise BadInput(f"the proof judges {type(proof.frames).__name__}; expected Frames: the folder of a run keeps "
                       "what it showed, and `vam prove` takes that folder")  # fmt: skip
    target = Target.from_array(proof.target.numpy(), proof.operator.grid.pitch, proof.name)
    inputs, arrays = inputs_of(
        Solved(proof.dose, proof.operator, replace(target, solid=proof.solid, limits=proof.limits))
    )
    if hasattr(proof.frames.plan, "history"):
        inputs["plan"] = inputs_of(proof.frames.plan)[0]["plan"]
    arrays["dose"] = Entry(proof.dose, ("x", "y", "z"), spacing=proof.operator.grid.pitch)
    details = {"saved": "proof", "proof": {name: _written(getattr(proof, name)) for name in FIELDS}}
    if "judgement" in proof.__dict__:
        details["judged"] = _judged(proof)
        if proof.independent and (found := stray(proof)) is not NOTHING:
            arrays["stray_points"] = Entry(found.points.astype(np.float32), ("point", "axis"), "mm")
            arrays["stray_faces"] = Entry(found.faces.astype(np.uint32), ("face", "corner"))
    return save_frames(path, proof.frames, inputs=inputs, arrays=arrays, details=details, overwrite=overwrite).path


def _judged(proof: Proof) -> dict[str, Any]:
    """Results that take long to compute: verdict, lines of numbers and sensitivity to errors, as plain values."""
    verdict, table = proof.verdict, proof.judgement.table
    said = {name: getattr(verdict, name) for name in ("prints", "proved", "opening", "sentence", "remedies",
                                                      "latitude", "not_judged")}  # fmt: skip
    rows = [{"name": row.name, "change": row.change, "window": row.window, "wrong": row.wrong, "note": row.note}
            for row in (table.nominal, *table.rows)]  # fmt: skip
    first = [{"name": one.name, "amount": one.amount, "text": one.text} for one in table.first_wrong]
    lines = [line._asdict() for line in (*proof.lines(), *proof.judgement.lines())]
    return _plain({"verdict": said, "lines": lines, "tolerances": {"nominal": rows[0], "rows": rows[1:],
                                                                   "first": first}})  # fmt: skip


def _plain(value: Any) -> Any:
    """Plain values, with None for numbers that JSON lacks."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(part) for part in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not isfinite(value) else value


def load_proof(path: str | Path, device: str | Device | None = None) -> Proof:
    """The proof as `Proof.save` wrote it; nothing is simulated again."""
    folder, place = Folder.open(path), open_device(device)
    A = operator_from(folder, place)
    target = target_from(folder, A.grid, place) if isinstance(getattr(A, "grid", None), Grid) else None
    with malformed(f"the proof in {str(path)!r} is incomplete or malformed", "prove the job again"):
        said = folder.manifest.details["proof"]
        if "part_share" in said:  # its name before 0.3, when the mean brightness was called light efficiency
            said = said | {"light_efficiency": said["part_share"], "mean_brightness": said["light_efficiency"]}
        numbers: dict[str, Any] = {name: _read(said[name]) for name in FIELDS if name in said or name not in LATER}
        if target is None or not isinstance(numbers["scores"], Scores):
            raise ValueError("its target or its scores")
        dose = folder.record("dose")
        if dose.shape != A.grid.shape:
            raise ValueError(f"a dose of {dose.shape} on a grid of {A.grid.shape}")
    frames = frames_of(folder, place)
    return Proof(
        A,
        frames,
        target.name,
        target.on(place),
        place.gather(dose.shape, folder.parts("dose")),
        solid=target.solid,
        limits=target.limits,
        **numbers,
    )


def _written(value: Any) -> Any:
    """A record as plain values; numbers that JSON lacks become text."""
    if is_dataclass(value):
        return {"of": type(value).__name__} | {one.name: _written(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, np.ndarray):
        return {"list": [_written(part) for part in value.tolist()], "dtype": value.dtype.name}
    if isinstance(value, (tuple, list)):
        return [_written(part) for part in value]
    return repr(float(value)) if isinstance(value, float) and not isfinite(value) else value


def _read(value: Any) -> Any:
    """The value that `_written` wrote. Raises `KeyError`, `TypeError`, `ValueError` for malformed values."""
    if isinstance(value, list):
        return tuple(map(_read, value))
    if isinstance(value, str):
        return float(value)
    if not isinstance(value, dict):
        return value
    if "list" in value:
        return np.array([_read(part) for part in value["list"]], np.dtype(value["dtype"]))
    return RECORDS[value["of"]](**{name: _read(part) for name, part in value.items() if name != "of"})
