"""VAMToolbox (Berkeley): sinograms and targets, pickled or saved as arrays.

A sinogram is [r, angle, z] in degrees, a target [y, x, z]. r grows along x·cos a − y·sin a and light travels along
x·sin a + y·cos a; in this library that is the angle θ = −(a + 90°). Lengths are in cm. Code in a pickle never runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import pitch_of
from vamgpu.jobs.foreign.patterns import STEPPED, ForeignPatterns
from vamgpu.jobs.model import JobFile
from vamgpu.storage.numpy_files import map_npy
from vamgpu.storage.pickles import Bag, read_pickle
from vamgpu.targets.target import Target
from vamgpu.units import cm, deg

PACKAGES = ("vamtoolbox",)
ENDINGS = (".sino", ".npy", ".pkl", ".pickle")


def read_vamtoolbox(path: Path, target: Path | None = None) -> ForeignPatterns:
    """Patterns of a sinogram. Raises `StorageError`, `BadInput`."""
    array, geometry = _volume(path, "a sinogram [r, angle, z]")
    said = geometry.get("angles") if geometry is not None else None
    even = np.arange(array.shape[1]) * 360.0 / array.shape[1]
    theirs = np.asarray(even if said is None else said, np.float64).ravel()
    if theirs.shape != (array.shape[1],) or not np.isfinite(theirs).all():
        raise BadInput(f"{str(path)!r} has {array.shape[1]} angles and names {theirs.size}; expected the same number")
    poses = np.mod(-(theirs + 90.0), 360.0)
    order = np.argsort(poses, kind="stable")  # the same patterns in the order of our turntable
    tables: dict[str, Any] = {"turntable": {"angles": int(array.shape[1]), "lit_share": 0.0}}
    notes = ["a sinogram has no vessel: the light counts as straight unless the job has one"]
    if geometry is not None:
        pixel, absorption = (_number(geometry.get(name)) for name in ("projector_pixel_size", "absorption_coeff"))
        radius = _number(geometry.get("container_radius"))
        if pixel is not None:
            tables["beam"] = {"pitch": f"{pixel * cm!r} mm"}
            tables["target"] = {"pitch": f"{pixel * cm!r} mm"}
        if radius is not None and absorption is not None:
            tables["vat"] = {"width": f"{2 * radius * cm!r} mm", "radius": f"{radius * cm!r} mm",
                             "absorption": f"{absorption / cm!r} 1/mm"}  # fmt: skip
            notes.clear()
        odd = [name for name in ("index_model", "occlusion", "attenuation_field", "inclination_angle")
               if geometry.get(name) is not None]  # fmt: skip
        if odd:
            notes.append(f"its {' and '.join(odd)} are left out; state them in a job")
    if target is not None:
        tables["target"] = {**tables.get("target", {}), "mesh": str(target.resolve()), "factor": 1.0}
    least, most = float(array.min()), float(array.max())
    if least < 0.0:
        if most <= 0.0:
            raise BadInput(f"the sinogram {str(path)!r} reaches from {least:g} to {most:g}; expected patterns, "
                           "which are 0 or more: change the sign, or import the images made from it")  # fmt: skip
        notes.append(f"it reaches down to {least:g}: values below 0 count as dark")
    light = np.ascontiguousarray(np.maximum(array, 0.0)[:, order].transpose(1, 0, 2))
    part = None if target is None else _Part(*_volume(target, "a target [y, x, z]")[:1], target.stem)
    motion = Turntable(poses[order] * deg, lit_share=0)
    return ForeignPatterns("VAMToolbox", light, motion, tables, part, notes=(STEPPED, *notes))


class _Part:
    """The target voxels of VAMToolbox."""

    def __init__(self, values: np.ndarray, name: str) -> None:
        self.values, self.name = values, name

    def __call__(self, file: JobFile, device: Device) -> Target:
        shares = np.clip(np.asarray(self.values, np.float64), 0.0, 1.0).transpose(1, 0, 2)
        return Target.from_array(np.ascontiguousarray(shares), pitch_of(file), self.name)


def _volume(path: Path, what: str) -> tuple[np.ndarray, Bag | None]:
    """An array of three axes, and the geometry for which it was made. Raises `StorageError`, `BadInput`."""
    held = map_npy(path) if path.suffix.lower() == ".npy" else read_pickle(path, PACKAGES)
    array = held.get("array") if isinstance(held, Bag) else held
    geometry = held.get("proj_geo") if isinstance(held, Bag) else None
    if isinstance(array, np.ndarray) and array.ndim == 2:
        array = array[:, :, None]
    if not isinstance(array, np.ndarray) or array.ndim != 3 or array.dtype.kind not in "biuf" or not array.size:
        got = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise BadInput(f"{str(path)!r} holds {got}; expected {what}")
    if not np.isfinite(array).all():
        raise BadInput(f"{str(path)!r} holds numbers that are not finite; expected {what}")
    return array, geometry if isinstance(geometry, Bag) else None


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0 else None
