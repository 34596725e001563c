"""Rays marched through a medium of varying index with a given tolerance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vamgpu.backend import DeviceArray, open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, RayError
from vamgpu.geometry import counts, positive
from vamgpu.kernels.eikonal import march as march_any
from vamgpu.kernels.eikonal import march_formula, march_plane, march_volume
from vamgpu.kernels.signature import Kernel
from vamgpu.optics.index_field import FormulaField, FunctionField, GridField, IndexField
from vamgpu.optics.inputs import Floats, as_offsets

ORDERS = {"sharma": 4, "leapfrog": 2, "yoshida": 4}
"""Steppers and their orders; the last two are symplectic. Their positions are their numbers in the kernels."""
FIRST = 32  # steps across the region at the start
TURNS = 64  # number of region sizes that a ray may travel before it counts as one that never leaves
HALVINGS = 10  # number of halvings of the first step before a ray counts as one that does not converge
NOISE = 4e-6  # share of the region's size below which float32 cannot distinguish two ends


@dataclass(frozen=True, eq=False)
class Marched:
    """Where rays end."""

    # place: [mm], (rays, 3). heading: optical direction, whose length is the index, (rays, 3). optical, length: optical
    # path and geometric length [mm]. time: ∫ds/n [mm]. left: whether the ray left the region. step: of ∫ds/n [mm], per
    # ray. error: of the place [mm], estimated by halving the step, per ray; NaN without a tolerance. path: (rays, rows,
    # 3) [mm].

    place: Floats
    heading: Floats
    optical: Floats
    length: Floats
    time: Floats
    left: NDArray[np.bool_]
    step: Floats
    error: Floats
    path: Floats

    @property
    def direction(self) -> Floats:
        """Unit vectors of travel, (rays, 3)."""
        return self.heading / np.linalg.norm(self.heading, axis=1, keepdims=True)


class Marcher:
    """A medium on a device, prepared to trace tables of rays repeatedly. Raises `BadInput`."""

    def __init__(self, field: IndexField, device: str | Device | None = None) -> None:
        if not isinstance(field, IndexField):
            raise BadInput(f"got {field!r} for a medium; expected a FormulaField, a GridField or a FunctionField")
        self.device: Device = open_device(device)
        self.field: IndexField = field
        self.kernel: Kernel | None = None
        self._tables: dict[str, DeviceArray] = {}
        known = field.sampled if isinstance(field, FunctionField) and self.device.name != "numpy" else field
        table = self.device.table
        if isinstance(known, FormulaField):
            self.kernel, self._tables = march_formula, {"formula": table(known.table)}
        elif isinstance(known, GridField):
            self.kernel = march_plane if known.coefficients.ndim == 2 else march_volume
            self._tables = {"coefficients": table(known.coefficients), "corner": table(known.place)}
        elif self.device.name != "numpy":
            raise BadInput(f"{type(field).__name__} marches on numpy only; make it a GridField for {self.device.name}")
        self._region = table(field.region.table)

    def starts(self, place: ArrayLike, direction: ArrayLike) -> Floats:
        """Positions and headings, (rays, 6), of rays at positions [mm] along directions of any length."""
        at, along = (_triples(name, value) for name, value in (("place", place), ("direction", direction)))
        if at.shape != along.shape:
            raise BadInput(f"{len(at)} places and {len(along)} directions; expected one direction per ray")
        size = np.linalg.norm(along, axis=1, keepdims=True)
        if not size.all():
            raise BadInput(f"{np.count_nonzero(size == 0)} directions are zero; expected vectors with a length")
        square = self.field.evaluate(at)[1][:, None]
        if (square <= 0).any():
            raise RayError(f"n² is {square.min():g} where a ray starts; expected a medium with n² > 0")
        return np.concatenate([at, along / size * np.sqrt(square)], axis=1)

    def run(self, starts: DeviceArray, step: float, steps: int, scheme: str = "sharma", rows: int = 1, every: int = 1,
            region: Floats | None = None) -> tuple[DeviceArray, DeviceArray, DeviceArray]:  # fmt: skip
        """Launch once: the tables ends, path and times of `march_formula`; ``region`` replaces the field's own."""
        if scheme not in ORDERS:
            raise BadInput(f"no stepper {scheme!r}; there are {', '.join(ORDERS)}")
        count, empty = starts.shape[0], self.device.empty
        real = self.device.real
        written = {"ends": empty((count, 8), real, table=True), "path": empty((count, rows, 3), real, table=True),
                   "times": empty((count,), real, table=True)}  # fmt: skip
        within = self._region if region is None else self.device.table(region)
        common: dict[str, Any] = {"starts": starts, "region": within, **written}
        numbers = {"step": step, "steps": steps, "scheme": list(ORDERS).index(scheme), "every": every}
        if self.kernel is None:
            march_any(self.field.evaluate, **{n: v.handle for n, v in common.items()}, **numbers)
        else:
            self.device.launch(self.kernel, **common, **numbers, **self._tables)
        return written["ends"], written["path"], written["times"]

    def trace(self, starts: Floats, step: float, steps: int, scheme: str = "sharma", rows: int = 1, every: int = 1
              ) -> Marched:  # fmt: skip
        """`run` with input and output in NumPy."""
        tables = self.run(self.device.table(starts), step, steps, scheme, rows, every)
        ends, path, times = (table.numpy().astype(np.float64) for table in tables)
        left = times >= 0
        time = np.where(left, times, step * steps)
        whole = np.full(len(ends), step)
        return Marched(ends[:, :3], ends[:, 3:6], ends[:, 6], ends[:, 7], time, left, whole, np.full(len(ends), np.nan),
                       path)  # fmt: skip


def march(
    field: IndexField, place: ArrayLike, direction: ArrayLike, *, step: float | None = None,
    tolerance: float | None = None, until: float | None = None, scheme: str = "sharma", rows: int = 1,
    device: str | Device | None = None,
) -> Marched:  # fmt: skip
    """Rays from positions along directions until they leave the field's region, or until ∫ds/n reaches ``until``.

    Give either a step or a tolerance. With a tolerance, every ray is marched with steps h and h/2. The difference
    divided by 2^order − 1 is the error of the finer result; steps are halved for the rays whose error is too large.

    Args:
        place, direction: (rays, 2 or 3) [mm]; directions of any length.
        step: of ∫ds/n [mm].
        tolerance: largest error of an end [mm].
        until: ∫ds/n [mm] at which rays stop; without it they must leave the region.
        scheme: "sharma" (fourth order), "leapfrog" (second, symplectic) or "yoshida" (fourth, symplectic).
        rows: number of points of each ray's path, equally spaced in ∫ds/n; 1 is only the start.

    Raises:
        BadInput: a value cannot be used.
        RayError: a ray never leaves, meets n² ≤ 0, or does not reach the tolerance.
    """
    marcher, span = Marcher(field, device), _span(field, until)
    counts("rows", (rows,), 1)
    starts = marcher.starts(place, direction)
    if (step is None) == (tolerance is None):
        raise BadInput(f"step is {step!r} and tolerance is {tolerance!r}; give one of them")
    if tolerance is None:
        size = positive("step [mm]", step or 0.0)
        return _checked(field, until, _traced(marcher, starts, size, span, until, scheme, rows))
    return _refined(marcher, starts, positive("tolerance [mm]", tolerance), span, until, scheme, rows)


def _span(field: IndexField, until: float | None) -> float:
    if until is not None:
        return positive("until [mm]", until)
    if not field.region.size:
        raise BadInput("the medium has no border; give `until`, the ∫ds/n [mm] at which rays stop, or a region")
    return TURNS * field.region.size


def _traced(
    marcher: Marcher, starts: Floats, step: float, span: float, until: float | None, scheme: str, rows: int
) -> Marched:
    steps = max(1, int(np.ceil(span / step - 1e-9)))
    step = span / steps if until is not None else step
    if rows == 1:
        return marcher.trace(starts, step, steps, scheme)
    if until is None:  # the length of the longest ray determines the distance of the rows of its path
        longest = marcher.trace(starts, step, steps, scheme)
        steps = int(np.ceil(longest.time.max() / step)) + 1 if longest.left.all() else steps
    return marcher.trace(starts, step, steps, scheme, rows, max(1, -(-steps // (rows - 1))))


def _refined(
    marcher: Marcher, starts: Floats, tolerance: float, span: float, until: float | None, scheme: str, rows: int
) -> Marched:
    field, order = marcher.field, ORDERS.get(scheme, 1)
    noise = NOISE * (field.region.size or span) if marcher.device.real.itemsize < 8 else 0.0
    if tolerance < noise:
        raise RayError(f"a tolerance of {tolerance:g} mm is below what {marcher.device.name} resolves, {noise:.2g} "
                       "mm; use a larger tolerance, or march on numpy")  # fmt: skip
    step = (min(span, field.region.size) if field.region.size else span) / FIRST
    best = _checked(field, until, _traced(marcher, starts, step, span, until, scheme, rows))
    todo = np.arange(len(starts))
    for _ in range(HALVINGS):
        step *= 0.5
        finer = _checked(field, until, _traced(marcher, starts[todo], step, span, until, scheme, rows))
        apart = np.linalg.norm(finer.place - best.place[todo], axis=1) / (2.0**order - 1.0)
        best = _with(best, todo, replace(finer, error=apart))
        todo = todo[apart > tolerance]
        if not todo.size:
            return best
    worst = todo[np.argmax(best.error[todo])]
    raise RayError(f"after {HALVINGS} halvings, at steps of {step:.3g} mm, {todo.size} of {len(starts)} rays are off "
                   f"by more than {tolerance:g} mm (ray {worst} by {best.error[worst]:.3g} mm); smooth the medium or "
                   "use a larger tolerance")  # fmt: skip


def _with(all_rays: Marched, index: NDArray[np.intp], few: Marched) -> Marched:
    values = {}
    for name in ("place", "heading", "optical", "length", "time", "left", "step", "error", "path"):
        values[name] = np.array(getattr(all_rays, name))
        values[name][index] = getattr(few, name)
    return Marched(**values)


def _checked(field: IndexField, until: float | None, rays: Marched) -> Marched:
    if until is None and not rays.left.all():
        stuck = int(np.argmin(rays.left))
        raise RayError(f"{np.count_nonzero(~rays.left)} of {len(rays.left)} rays never leave: ray {stuck} is still "
                       f"inside, at {np.round(rays.place[stuck], 3)} mm, after {rays.length[stuck]:.4g} mm in a region "
                       f"{field.region.size:g} mm wide; widen the region's opening or give `until`")  # fmt: skip
    lost = ~np.isfinite(rays.place).all(axis=1) | ~np.isfinite(rays.optical)
    if lost.any():
        raise RayError(f"{np.count_nonzero(lost)} of {len(lost)} rays (the first is {np.argmax(lost)}) meet n² ≤ 0; "
                       "expected a medium with an index above 0 throughout")  # fmt: skip
    return rays


def _triples(name: str, value: ArrayLike) -> Floats:
    array = np.atleast_2d(as_offsets(name, value))
    if array.ndim != 2 or array.shape[1] not in (2, 3) or not len(array):
        raise BadInput(f"{name} has the shape {array.shape}; expected (rays, 2) or (rays, 3)")
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1])))
