"""Plans in job folders: light, operator, target, and everything that a run needs to continue."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from math import isfinite, prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OpticsWarning, OutOfMemory, StorageError
from vamgpu.geometry import Grid
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.plan import Plan, Step
from vamgpu.methods.tolerances import CornerDose, CornerDoses, Tolerances
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.schema import write
from vamgpu.schema.read import read
from vamgpu.storage.folder import Entry, Folder, Streamed, write_folder
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import malformed
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.targets.limits import BodyRequirement, Limits
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target

OPTICS: dict[str, Any] = {"fill": 1.0, "spread": 0.0}  # values assumed for beams in folders that do not state them
LIMITS = "dose", "weight", "body"  # arrays of a target's limits


@dataclass(frozen=True)
class PlanRecord:
    """A plan without its light, as plain records."""

    method: str
    history: tuple[Mapping[str, float], ...]
    papers: tuple[str, ...]  # citations
    seconds: float
    window: float  # strict
    bound: float | None = None
    corners: tuple[Mapping[str, Any], ...] = ()
    ran: str = ""  # operator and device that computed it
    pareto: tuple[Mapping[str, float], ...] = ()  # windows of shorter exposures, if requested
    notes: tuple[str, ...] = ()  # what was too coarse
    bound_on: str = ""  # voxels and motion for which the bound holds

    @classmethod
    def of(cls, plan: Any, window: float | None = None) -> PlanRecord:
        """The record of a `Plan`, or of another plan with its own window."""
        history = tuple(asdict(step) for step in plan.history)
        window = float(plan.window if window is None else window)
        bound = getattr(plan, "bound", None)
        doses = getattr(plan, "corners", None)
        corners = () if doses is None else tuple(asdict(corner) for corner in doses.corners)
        return cls(
            repr(plan.method), history, tuple(map(str, plan.papers)), float(plan.seconds), window,
            getattr(bound, "value", None), corners, str(getattr(plan, "ran", "")),
            notes=tuple(getattr(plan, "notes", ())), bound_on=getattr(bound, "on", ""),
        )  # fmt: skip

    @classmethod
    def read(cls, data: Any) -> PlanRecord:
        """From a manifest; raises `StorageError` for a malformed record."""
        with malformed("the manifest has a malformed plan", "write the job again"):
            return cls(
                str(data["method"]), tuple(data["history"]), tuple(data["papers"]), data["seconds"], data["window"],
                data.get("bound"), tuple(data.get("corners") or ()), str(data.get("ran", "")),
                notes=tuple(map(str, data.get("notes") or ())), bound_on=str(data.get("bound_on", "")),
            )  # fmt: skip


def describe(A: LinearOperator, arrays: dict[str, np.ndarray] | None = None) -> dict[str, Any]:
    """An operator in plain values, for a manifest."""
    if isinstance(A, Defocused) and A.direct is not A:
        return {**write(A.direct, arrays=arrays), "rings": True}
    if not isinstance(A, Projection | RingProjection):
        return write(A, arrays=arrays)
    on_rings = isinstance(A, RingProjection)
    return {
        "grid": write(A.grid),
        "beam": write(A.beam),
        "turntable": described(A.motion),
        "vessel": None if A.vessel is None else write(A.vessel, arrays=arrays),
        **({"operator": "rings"} if on_rings else {}),
    }


def entries_of(arrays: Mapping[str, np.ndarray]) -> dict[str, Entry]:
    """The arrays of a description, in the form that a job folder stores."""
    return {name: Entry(values, tuple("ijklm"[: values.ndim])) for name, values in arrays.items()}


def projection_from(
    description: Any, device: Device, arrays: Callable[[str], np.ndarray] | None = None, *, solved: bool = False
) -> Any:
    """The operator of `describe`: ``solved``, that which found the light, else its judge. Raises `StorageError`."""
    with malformed("the manifest has a malformed geometry", "write the job again"):
        table = dict(description)
        _weigh(table)
        if "kind" in table:
            on_rings = table.pop("rings", False)
            found = read("operator", _at_rest(table), units=False, device=device, arrays=arrays)
            if solved and on_rings:
                return Defocused(RingProjection.of(found.operator), found.defocus, found.tolerance)
            return found
        beam, vessel = _with_optics(table["beam"]), table["vessel"]
        beam.pop("footprint", None)  # of earlier folders; light is judged by exact footprints
        motion = turntable_from(table["turntable"])
        grid, light = (read(name, part, units=False) for name, part in (("grid", table["grid"]), ("beam", beam)))
        around = None if vessel is None else read("vessel", vessel, units=False, arrays=arrays)
        if solved and table.get("operator") == "rings":
            return RingProjection(grid, light, motion, around, device)
    return Projection(grid, light, motion, around, device)


def _at_rest(table: Any) -> Any:
    """A description in which motions without a lit share, from before it existed, have a share of 0."""
    if not isinstance(table, dict):
        return table
    found = {name: _at_rest(value) for name, value in table.items()}
    motion = found.get("motion")
    return found | {"motion": {"lit_share": 0.0} | motion} if isinstance(motion, dict) and "angles" in motion else found


def _weigh(description: Any) -> None:
    """Reject grids and beams with more voxels and pixels than fit into memory, before operators make tables."""
    for key, value in description.items() if isinstance(description, Mapping) else ():
        if key in ("shape", "pixels") and isinstance(value, list) and all(isinstance(n, (int, float)) for n in value):
            afford(np.dtype(np.float64).itemsize * prod(map(abs, value)), f"a manifest's geometry of {key} {value}")
        if key == "angles" and isinstance(value, (int, float)):
            afford(np.dtype(np.float64).itemsize * abs(value), f"a manifest's turntable of {value:g} angles")
        _weigh(value)


def _with_optics(beam: Mapping[str, Any]) -> dict[str, Any]:
    """A described beam with all its fields. Folders without optics were solved for a perfect lens."""
    if set(OPTICS) <= set(beam):
        return dict(beam)
    warnings.warn(
        "the folder does not state the beam's fill and point spread: it was solved for pixels lit all over and a "
        "perfect lens, and is read with these (fill 1, spread 0); solve it again for a real lens",
        OpticsWarning, stacklevel=3,
    )  # fmt: skip
    return OPTICS | dict(beam)


def light_of(sinogram: DeviceArray) -> Streamed:
    """A sinogram [angle, r, z] in a folder's form: [angle, row, column], row 0 the largest z, not rounded."""
    angles, columns, rows = sinogram.shape

    def part(first: int, last: int) -> np.ndarray:
        return sinogram.part(first, last).transpose(0, 2, 1)[:, ::-1]

    return Streamed((angles, rows, columns), sinogram.dtype, part)


def sinogram_from(folder: Folder, device: Device) -> DeviceArray:
    """The light that `light_of` stored in a folder, on a device. Raises `StorageError` for invalid light."""
    stored = folder.record("frames")
    if len(stored.shape) != 3 or np.dtype(stored.dtype).kind != "f":
        raise StorageError(f"its frames are {stored.dtype} {stored.shape}, a projector's bytes; expected plain light, "
                           "floats [angle, row, column]: write the job again")  # fmt: skip
    angles, rows, columns = stored.shape
    parts = (light[:, ::-1].transpose(0, 2, 1) for light in folder.parts("frames"))
    return device.gather((angles, columns, rows), parts)


def inputs_of(plan: Any) -> tuple[dict[str, Any], dict[str, Entry]]:
    """The part of a plan that a folder stores beside its light, for proving it: inputs of its manifest, and arrays."""
    kept: dict[str, np.ndarray] = {}
    inputs: dict[str, Any] = {"job": {}, "geometry": describe(plan.operator, kept), "print": None}
    entries = entries_of(kept)
    target = target_of(plan)
    if target is not None:
        inputs["target"] = {key: getattr(target, key) for key in FACTS} | {"limits": limits_described(target)}
        entries["target"] = Entry(target.fraction, ("x", "y", "z"), spacing=target.grid.pitch)
        entries |= limits_entries(target)
        if target.solid is not None:
            inputs["target"]["solid"] = {"name": target.solid.name, "mended": list(target.solid.mended)}
            entries["vertices"] = Entry(target.solid.vertices[None], ("mesh", "vertex", "xyz"))  # one chunk
            entries["faces"] = Entry(target.solid.faces[None], ("mesh", "face", "corner"))
    tolerances = getattr(plan, "tolerances", None)
    if tolerances is not None:
        inputs["tolerances"] = write(tolerances)
    inputs["plan"] = asdict(PlanRecord.of(plan)) if hasattr(plan, "history") else None
    return inputs, entries


INTERRUPTED = "interrupted"  # key among the inputs of a folder: the run was stopped before its end
FACTS = ("name", "radius", "volume", "height")  # description of a target in a manifest, without its fractions


def pixel_pitch(plan: Any) -> float | None:
    """Pitch of a plan's pixels [mm]; None if unknown."""
    return getattr(getattr(getattr(plan, "operator", None), "beam", None), "pitch", None)


def target_of(plan: Any) -> Target | None:
    """The target of a plan, also from fractions only. None if unknown, or for a web."""
    target, grid = getattr(plan, "target", None), getattr(plan.operator, "grid", None)
    if target is None or isinstance(target, Target) or not isinstance(grid, Grid):
        return target if isinstance(target, Target) else None
    values = target.numpy() if isinstance(target, DeviceArray) else np.asarray(target)
    return Target.from_array(values, grid.pitch, getattr(plan, "target_name", "target"))


def target_from(folder: Folder, grid: Grid, device: Device | None = None) -> Target | None:
    """The target that a job folder stores, and its mesh; None if it stores none. Raises `StorageError`."""
    if "target" not in folder.manifest.arrays:
        return None
    with malformed(f"{str(folder.path)!r} lacks its target, or has a malformed one", "write it again"):
        said = folder.manifest.inputs["target"]
        name, (radius, volume, height) = str(said["name"]), (float(said[key]) for key in FACTS[1:])
        mesh, surface = said.get("solid"), None
        if tuple(grid.shape) != folder.record("target").shape:
            raise ValueError(f"a grid of {grid.shape} for a target of {folder.record('target').shape}")
        if mesh is not None:
            mended = tuple(map(str, mesh["mended"]))
            surface = Solid(folder.array("vertices")[0], folder.array("faces")[0], str(mesh["name"]), mended)
    limits = limits_from(said.get("limits"), folder.array, tuple(grid.shape))
    kept = folder.array("target") if device is None else device.gather(grid.shape, folder.parts("target"))
    return Target(grid, name, kept, radius, volume, height, surface, limits=limits)


def limits_entries(target: Target) -> dict[str, Entry]:
    """Limits of single voxels for a job folder; empty for a single part."""
    if target.limits is None:
        return {}
    fields = {name: getattr(target.limits, name) for name in LIMITS}
    return {
        f"target_{name}": Entry(values, ("x", "y", "z"), spacing=target.grid.pitch) for name, values in fields.items()
    }


def limits_described(target: Target) -> dict[str, Any] | None:
    """The bodies of a target, for a manifest."""
    if target.limits is None:
        return None
    return {"void": target.limits.void, "bodies": [asdict(body) for body in target.limits.bodies]}


def limits_from(described: Any, array: Callable[[str], np.ndarray], shape: tuple[int, ...]) -> Limits | None:
    """The limits that `limits_described` described; array: returns arrays by name. Raises `StorageError`."""
    if described is None:
        return None
    with malformed("the manifest has malformed bodies", "write the job again"):
        bodies = tuple(BodyRequirement(**body) for body in described["bodies"])
        fields = {name: array(f"target_{name}") for name in LIMITS}
        found = Limits(**fields, bodies=bodies, void=float(described["void"]))
        if found.dose.shape != shape:
            raise ValueError(f"limits of {found.dose.shape} voxels for a target of {shape}")
        return found


def operator_from(folder: Folder, device: Device, *, solved: bool = False) -> Any:
    """The operator that a job folder describes; ``solved`` as for `projection_from`. Raises `StorageError`."""
    inputs = folder.manifest.inputs
    if "geometry" not in inputs:
        why = inputs.get("undescribed", "it was written without the plan that its frames show")
        raise StorageError(f"{str(folder.path)!r} has no geometry to simulate: {why}; save the plan, or write the job "
                           "with `vam solve`")  # fmt: skip
    try:
        return projection_from(inputs["geometry"], device, folder.array, solved=solved)
    except MemoryError as error:
        raise OutOfMemory(f"the light of {str(folder.path)!r} takes more memory than there is: {error}; check its "
                          "manifest, or use a larger machine") from error  # fmt: skip


def save_plan(
    plan: Plan, path: str | Path, *, state: bool = True, overwrite: bool = False,
    inputs: Mapping[str, Any] | None = None,
) -> Path:  # fmt: skip
    """Write a plan, see `Plan.save`; ``inputs`` are further ones of its manifest."""
    own, entries = inputs_of(plan)
    motion = getattr(plan.operator, "motion", None)
    record, kept = plan_described(plan)
    record["state"] = _packed(plan.state, kept, {}) if state else None
    details = {"saved": "plan", "frames": {} if motion is None else {"turntable": described(motion)}, "plan": record}
    light = Entry(light_of(plan.sinogram), ("angle", "row", "column"), spacing=pixel_pitch(plan))
    every, said = {"frames": light, **entries, **kept}, {**own, **(inputs or {})}
    device = plan.sinogram.device
    ran = f"{device.name} ({device.description})"
    return write_folder(path, every, inputs=said, details=details, device=ran, overwrite=overwrite).path


def plan_described(plan: Plan) -> tuple[dict[str, Any], dict[str, Entry]]:
    """A plan for the details of a manifest, and arrays of its method, which is None if it is a user's own."""
    arrays: dict[str, np.ndarray] = {}
    try:
        method = {**write(plan.method, arrays=arrays)}
    except BadInput:
        method, arrays = None, {}
    facts = ("evaluations", "best_iteration", "target_name")
    record = {"method": method, **{name: getattr(plan, name) for name in facts}}
    return record, {f"method_{name}": entry for name, entry in entries_of(arrays).items()}


def load_plan(path: str | Path, device: str | Device | None = None) -> Plan:
    """The plan that `Plan.save`, or ``vam solve``, wrote to a folder."""
    folder, place = Folder.open(path), open_device(device)
    operator = operator_from(folder, place, solved=True)
    details = folder.manifest.details.get("plan") or {}
    record = PlanRecord.read(folder.manifest.inputs.get("plan") or IMPORTED)
    grid = getattr(operator, "grid", None)
    target = target_from(folder, grid, place) if isinstance(grid, Grid) else None
    with malformed(f"{str(path)!r} lacks its plan, or has a malformed one", "write it again"):
        history = tuple(Step(**dict(step)) for step in record.history)  # type: ignore[arg-type]
        spent = history[-1].evaluations if history else 0.0
        return Plan(
            sinogram_from(folder, place),
            operator,
            _method_from(details.get("method"), record, folder),
            history,
            float(record.window),
            float(details.get("evaluations", spent)),
            tuple(map(str, record.papers)),
            float(record.seconds),
            str(details.get("target_name", target.name if target else "target")),
            _unpacked(details.get("state") or {}, folder, place),
            int(details.get("best_iteration", 0)),
            target=target,
            tolerances=tolerances_from(folder),
            corners=CornerDoses(tuple(CornerDose(**dict(one)) for one in record.corners)) if record.corners else None,
            notes=record.notes,
        )


def tolerances_from(folder: Folder) -> Tolerances | None:
    """The tolerances for which a job folder's light was optimized; None without any. Raises `StorageError`."""
    said = folder.manifest.inputs.get("tolerances")
    if said is None:
        return None
    with malformed(f"{str(folder.path)!r} has malformed tolerances", "write it again"):
        return read("tolerances", dict(said), units=False)


IMPORTED: dict[str, Any] = {
    "method": "not by this library",
    "history": [],
    "papers": [],
    "seconds": 0.0,
    "window": -1.0,
}
"""Known facts about patterns from other software."""


@dataclass(frozen=True)
class RecordedMethod(Method):
    """A method of which only its text is known; it cannot be resumed."""

    text: str
    iterations: ClassVar[int] = 0
    criterion: ClassVar[Criterion] = "window"

    @property
    def name(self) -> str:
        """The criterion of the original class."""
        return self.text.partition("(")[0]

    def steps(self, state: Any) -> Steps:
        """Refuse to resume."""
        raise BadInput(f"the plan is by {self.text}, of which its folder stores only the name; give a method, and the "
                       "plan's light as its start")  # fmt: skip


def _method_from(noun: Any, record: PlanRecord, folder: Folder) -> Any:
    if noun is None:
        return RecordedMethod(record.method)
    try:
        return read("method", noun, units=False, arrays=lambda name: folder.array(f"method_{name}"))
    except BadInput:  # of a package that is not installed
        return RecordedMethod(record.method)


def _packed(value: Any, kept: dict[str, Entry], seen: dict[int, str]) -> Any:
    """A run's memory as plain values; its arrays go to ``kept``, and an array that occurs twice is stored once."""
    if isinstance(value, (DeviceArray, np.ndarray)):
        name = seen.get(id(value))
        if name is None:
            name = seen[id(value)] = f"state_{len(seen)}"
            kept[name] = Entry(value, tuple("ijklm"[: len(value.shape)]))
        return {"array": name, "host": isinstance(value, np.ndarray)}
    if isinstance(value, Mapping):
        return {"table": [[key, _packed(part, kept, seen)] for key, part in value.items()]}
    if isinstance(value, (list, tuple)):
        return {"tuple" if isinstance(value, tuple) else "list": [_packed(part, kept, seen) for part in value]}
    if isinstance(value, (float, np.floating)) and not isfinite(value):
        return {"number": repr(float(value))}
    return value


def _unpacked(value: Any, folder: Folder, device: Device) -> Any:
    """The memory that `_packed` packed. Raises `KeyError`, `TypeError`, `ValueError`, `StorageError` if malformed."""
    if not isinstance(value, Mapping):
        return value
    if "array" in value:
        name = str(value["array"])
        return folder.array(name) if value.get("host") else device.gather(folder.record(name).shape, folder.parts(name))
    if "number" in value:
        return float(value["number"])
    ((kind, parts),) = value.items() or (("table", []),)
    if kind == "table":
        return {str(key): _unpacked(part, folder, device) for key, part in parts}
    return {"tuple": tuple, "list": list}[kind](_unpacked(part, folder, device) for part in parts)
