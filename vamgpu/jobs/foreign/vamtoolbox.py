"""VAMToolbox (Berkeley): sinograms and targets, pickled or saved as arrays, and presets (`PrintConfig`) in JSON.

A sinogram is [r, angle, z] in degrees, a target [y, x, z], lengths are in cm; their angle a is our θ = −(a + 90°).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, log
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import pitch_of
from vamgpu.jobs.foreign.containers import Body, check_keys, file_of, index, mm, number
from vamgpu.jobs.foreign.patterns import STEPPED, ForeignPatterns
from vamgpu.jobs.model import JobFile
from vamgpu.storage.numpy_files import map_npy
from vamgpu.storage.pickles import Bag, read_pickle
from vamgpu.targets.mesh import load_mesh
from vamgpu.targets.target import Target
from vamgpu.units import cm, deg

PACKAGES = ("vamtoolbox",)
PRESET: dict[str, Any] = {
    "stl_path": None, "part_height_mm": 25.4, "voxel_pitch_um": 80.0, "n_angles": 360, "vial_radius_mm": 48.8,
    "absorption": True, "absorption_coeff_cm": None, "pi_extinction": 36.0, "pi_concentration_mm": 4.0,
    "resin_ri": 1.51, "diffusion": False, "diffusion_coeff": 1e-4, "print_time_s": 10.0, "proj_u_px": 1080,
    "proj_v_px": 1920, "mm_per_pix": 76.0 / 1080, "throw_ratio": inf,
}  # fmt: skip
"""Keys of a preset that describe a print, and their defaults in version 3."""
OTHERS = ("resolution_scale", "method", "n_iterations", "d_high", "d_low", "learning_rate", "eps", "weight",
          "diffusion_iters", "diffusion_optical", "rotation_deg_s", "use_cuda", "slab", "low_memory", "rebin_jobs",
          "verbose", "save_img_path", "vial_print_height_mm")  # fmt: skip
"""Its other keys: of the method, of the computer, and of the film."""
ENDINGS = (".sino", ".npy", ".pkl", ".pickle")


def read_vamtoolbox(path: Path, target: Path | None = None) -> ForeignPatterns:
    """Patterns of a sinogram. Raises `StorageError`, `BadInput`."""
    array, held = _volume(path, "a sinogram [r, angle, z]")
    geometry = held.get("proj_geo") if isinstance(held.get("proj_geo"), Bag) else None
    part = None if target is None else _Part(*_volume(target, "a target [y, x, z]"), target.stem)
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
            tables["beam"] = {"pitch": mm(pixel * cm)}
            tables["target"] = {"pitch": mm(pixel * cm)}
        if radius is not None and absorption is not None:
            wall = round(radius * cm, 9)
            tables["vat"] = {"width": mm(2 * wall), "radius": mm(wall), "absorption": f"{absorption / cm:.12g} 1/mm"}
            notes.clear()
        odd = [name for name in ("index_model", "occlusion", "attenuation_field", "inclination_angle")
               if geometry.get(name) is not None]  # fmt: skip
        if odd:
            notes.append(f"its {' and '.join(odd)} are left out; state them in a job")
    lost = [] if part is None else part.roles
    if lost:
        notes.append(f"the {' and '.join(lost)} voxels of its target are left out; describe them as [[body]] in a job")
    if target is not None:
        tables["target"] = {**tables.get("target", {}), "mesh": str(target.resolve()), "factor": 1.0}
    least, most = float(array.min()), float(array.max())
    if least < 0.0:
        if most <= 0.0:
            raise BadInput(f"the sinogram {str(path)!r} reaches from {least:g} to {most:g}; expected patterns, "
                           "which are 0 or more: change the sign, or import the images made from it")  # fmt: skip
        notes.append(f"it reaches down to {least:g}: values below 0 count as dark")
    light = np.ascontiguousarray(np.maximum(array, 0.0)[:, order].transpose(1, 0, 2))
    motion = Turntable(poses[order] * deg, lit_share=0)
    return ForeignPatterns("VAMToolbox", light, motion, tables, part, notes=(STEPPED, *notes))


class _Part:
    """The target voxels of VAMToolbox."""

    def __init__(self, values: np.ndarray, held: Bag, name: str) -> None:
        self.values, self.name = values, name
        self.roles = [role for role in ("insert", "zero_dose") if np.any(held.get(role))]

    def __call__(self, file: JobFile, device: Device) -> Target:
        shares = np.clip(np.asarray(self.values, np.float64), 0.0, 1.0).transpose(1, 0, 2)
        return Target.from_array(np.ascontiguousarray(shares), pitch_of(file), self.name)


def _volume(path: Path, what: str) -> tuple[np.ndarray, Bag]:
    """An array of three axes, and what stands beside it. Raises `StorageError`, `BadInput`."""
    held = map_npy(path) if path.suffix.lower() == ".npy" else read_pickle(path, PACKAGES)
    beside = held if isinstance(held, Bag) else Bag()
    array = held.get("array") if isinstance(held, Bag) else held
    if isinstance(array, np.ndarray) and array.ndim == 2:
        array = array[:, :, None]
    if not isinstance(array, np.ndarray) or array.ndim != 3 or array.dtype.kind not in "biuf" or not array.size:
        got = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise BadInput(f"{str(path)!r} holds {got}; expected {what}")
    if not np.isfinite(array).all():
        raise BadInput(f"{str(path)!r} holds numbers that are not finite; expected {what}")
    return array, beside


def is_preset(said: Any) -> bool:
    """Whether a JSON file is a preset of VAMToolbox."""
    return isinstance(said, dict) and "vial" not in said and bool(said.keys() & {"stl_path", "part_height_mm"})


def read_preset(folder: Path, said: dict[str, Any]) -> tuple[dict[str, Any], list[Body], tuple[str, ...]]:
    """Job of a preset, and its part. Raises `BadInput`, `MeshError`, `ValueError`, `TypeError`."""
    check_keys(said, (*PRESET, *OTHERS), "")
    given = {**PRESET, **said}
    if not given["stl_path"]:
        raise BadInput("it has no stl_path; expected the path of a mesh: add it")
    pitch, pixels = number(given, "mm_per_pix"), [int(number(given, f"proj_{axis}_px")) for axis in "uv"]
    radius, resin = number(given, "vial_radius_mm"), index(given, "resin_ri")
    vial = {"radius": mm(radius), "wall": "0 mm", "resin_index": resin, "wall_index": resin, "bath_index": 1.0,
            "absorption": f"{_absorption(given) / cm:.12g} 1/mm"}  # fmt: skip
    tables: dict[str, Any] = {
        "target": {"pitch": mm(1e-3 * number(given, "voxel_pitch_um")), "origin": [0.0, 0.0, 0.0]},
        "beam": {"pitch": mm(pitch), "pixels": pixels}, "turntable": {"angles": int(number(given, "n_angles"))},
        "vial": vial,
    }  # fmt: skip
    if given["throw_ratio"] != inf:  # over the width of the image
        throw = number(given, "throw_ratio") * pixels[0] * pitch
        tables["vessel"] = {"kind": "fan", "throw": mm(throw), "vessel": {"kind": "vial", **vial}}
        del tables["vial"]
    if given["diffusion"]:
        rate, seconds = number(given, "diffusion_coeff"), number(given, "print_time_s")
        tables["resin"] = {"diffusion": {"diffusivity": f"{rate!r} mm2/s", "seconds": f"{seconds!r} s"}}
    left_out = [name for name in OTHERS if name in said]
    notes = (f"its {', '.join(left_out)} left out: `vam solve` has methods of its own",) if left_out else ()
    return tables, [({}, load_mesh(file_of(folder, given["stl_path"]), height=number(given, "part_height_mm")))], notes


def _absorption(said: Mapping[str, Any]) -> float:
    """Absorption of a preset's resin [1/cm], natural logarithm; of its photoinitiator if it is not given."""
    if not said["absorption"]:
        return 0.0
    if said["absorption_coeff_cm"] is not None:
        return number(said, "absorption_coeff_cm", zero=True)
    return number(said, "pi_extinction", zero=True) * 1e-3 * number(said, "pi_concentration_mm", zero=True) * log(10.0)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and value > 0 else None
