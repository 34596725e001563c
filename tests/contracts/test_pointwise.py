"""Kernels that are written for all devices from their definition; the contracts of kernels compare them with it."""

from __future__ import annotations

import linecache
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from vamgpu.backend.device import Device
from vamgpu.errors import KernelError
from vamgpu.kernels import catalog, inhibition
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.kernels.loss import band_loss
from vamgpu.kernels.pointwise import Parts, add_up, cyclic, look_up, near_axis, opencl, pointwise, warp
from vamgpu.kernels.reduce import partial_dot, partial_sum
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Field, Kernel, Real, Table
from vamgpu.kernels.update import apply_penalty

Row = Annotated[np.ndarray, Table("float32", ("j",))]
Plane = Annotated[np.ndarray, Table("float32", ("j", "z"))]
Samples = Annotated[np.ndarray, Table("float32", ("sample",))]
Counts = Annotated[np.ndarray, Table("int32", ("i",))]
Levels = Annotated[np.ndarray, Table("int32", ("z",))]
Bytes = Annotated[np.ndarray, Table("uint8", ("i",))]
Other = Annotated[np.ndarray, Field(("angle", "r", "z"))]
TURNS = 3


def inner(x: np.ndarray, out: np.ndarray) -> np.ndarray:
    """A function that changes what it is given."""
    x = x + 1.0
    out[...] = x
    return x


def twice(x: np.ndarray, factor: float = 2.0) -> np.ndarray:
    """A function with a default."""
    return factor * x


def two(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two values."""
    return x, x


NAMES: dict[str, Any] = {
    "np": np, "TURNS": TURNS, "Array": Array, "ArrayOut": ArrayOut, "Real": Real, "Parts": Parts, "Row": Row,
    "Plane": Plane, "Samples": Samples, "Levels": Levels, "Bytes": Bytes, "Other": Other, "add_up": add_up,
    "cyclic": cyclic, "look_up": look_up, "near_axis": near_axis, "pointwise": pointwise, "inner": inner,
    "twice": twice, "two": two, "__name__": __name__,
}  # fmt: skip
REFUSED = {
    "neighbor": ("while x.size: out[...] = x", "while x.size"),
    "rolled": ("out[...] = np.roll(x, 1, axis=0)", "np.roll(x, 1, axis=0)"),
    "turned around": ("out[...] = x[::-1]", "x[::-1]"),
    "one sample of a field": ("out[...] = x[0]", "x[0]"),
    "an axis more": ("out[...] = x[:, None]", "x[:, None]"),
    "one sample is written": ("out[0] = x", "out[0]"),
    "one slice is added to": ("out[...] = x; out[:, 0] += x", "out[:, 0] += x"),
    "a field gets another name": ("out = x", "out"),
    "what a name stands for is changed": ("y = x; y += 1.0; out[...] = y", "y += 1.0"),
    "a name is written to": ("y = x; y[...] = 1.0; out[...] = y", "y[...]"),
    "nothing is written": ("y = x", "out without a value"),
    "a table along another axis": ("out[...] = x * row", "row"),
    "a table at another place": ("out[...] = x * row[:, None, None]", "row[:, None, None]"),
    "a table from its end": ("out[...] = x * row[::-1, None]", "row[::-1, None]"),
    "a table along two axes": ("out[...] = x * plane", "plane"),
    "another axis's table": ("out[...] = x * samples", "samples"),
    "integers along z": ("out[...] = x * levels", "levels"),
    "another radius": ("out[...] = np.where(near_axis(x, 0.5 * reach), x, 0.0)", "near_axis(x, 0.5 * reach)"),
    "another argument as radius": ("out[...] = np.where(near_axis(x, a), x, 0.0)", "near_axis(x, a)"),
    "any": ("for _ in range(3):\n if np.any(x > 0): break\nout[...] = x", "if np.any(x > 0):\n    break"),
    "numbers": ("for _ in range(3):\n if np.all(x): break\nout[...] = x", "if np.all(x):\n    break"),
    "otherwise": (
        "y = x\nfor _ in range(3):\n if np.all(x > 0): break\n else: y = 2.0 * x\nout[...] = y",
        "if np.all(x > 0):\n    break\nelse:\n    y = 2.0 * x",
    ),
    "a loop's otherwise": ("for _ in range(3): y = x\nelse: y = a\nout[...] = x", "y = x\nelse:\n    y = a"),
    "a loop's number": ("for n in range(3): y = n * x\nout[...] = x", "for n in range(3)"),
    "a loop of a computed length": ("for _ in range(TURNS + 1): y = x\nout[...] = x", "TURNS + 1"),
    "a loop from one": ("for _ in range(1, 3): y = x\nout[...] = x", "for _ in range(1, 3)"),
    "what a loop names": ("for _ in range(3): late = x\nout[...] = late", "late"),
    "a loop that changes a number": ("for _ in range(3): a = 2.0 * a\nout[...] = a * x", "a"),
    "a loop that turns numbers into conditions": ("y = x\nfor _ in range(3): y = y > 0\nout[...] = x", "y"),
    "a loop of sums": ("out[...] = x\nfor _ in range(3): add_up(parts, x)", "add_up(parts, x)"),
    "a sum twice": ("out[...] = x; add_up(parts, x); add_up(parts, x)", "add_up(parts, x)"),
    "a sum of conditions": ("out[...] = x; add_up(parts, x > 0)", "x > 0"),
    "a sum to a field": ("out[...] = x; add_up(out, x)", "add_up(out, x)"),
    "keywords": ("out[...] = np.maximum(x, 0.0, where=y)", "np.maximum(x, 0.0, where=y)"),
    "a third argument": ("out[...] = np.maximum(x, 0.0, x)", "np.maximum(x, 0.0, x)"),
    "keywords of functions": ("out[...] = twice(x, factor=3.0)", "twice(x, factor=3.0)"),
    "defaults": ("out[...] = twice(x)", "twice(x)"),
    "a function of the table": ("out[...] = np.real(x)", "np.real(x)"),
    "another table's function": ("out[...] = np.add(x, x)", "np.add(x, x)"),
    "a method": ("out[...] = x.clip(0.0, 1.0, 2.0)", "x.clip(0.0, 1.0, 2.0)"),
    "another infinity": ("out[...] = x * a.inf", "a.inf"),
    "an unknown name": ("out[...] = x * unknown", "unknown"),
    "an unknown function": ("out[...] = unknown(x)", "unknown(x)"),
    "a built-in function": ("out[...] = abs(x)", "abs(x)"),
    "a called field": ("out[...] = x(a)", "x(a)"),
    "outputs of functions": ("out[...] = inner(x, x)", "out[...]"),
    "two values for one": ("out[...] = two(x)", "out[...]"),
    "two values in a sum": ("out[...] = 1.0 + two(x)", "two(x)"),
    "a table as an argument": ("out[...] = twice(samples, 2.0)", "samples"),
    "another start": ("y, z = look_up(x, samples, 2.0 * a, a); out[...] = y", "look_up(x, samples, 2.0 * a, a)"),
    "a list": ("out[...] = x * cyclic([1.0, 2.0], x)", "cyclic([1.0, 2.0], x)"),
    "a condition as a number": ("out[...] = x > 0", "out[...]"),
    "a condition that is multiplied": ("out[...] = x * (x > 0)", "x > 0"),
    "a number as a condition": ("out[...] = np.where(x, x, 0.0)", "np.where(x, x, 0.0)"),
    "bits": ("out[...] = np.where(x & 1, x, 0.0)", "x & 1"),
    "a chain": ("out[...] = np.where(0 < x < 1, x, 0.0)", "0 < x < 1"),
    "a varying power": ("out[...] = np.power(a, x)", "np.power(a, x)"),
    "truth": ("out[...] = x * True", "True"),
}  # fmt: skip
"""Statements, and what is refused of them."""
ARGUMENTS = {
    **{name: f"{name}: Array, out: ArrayOut" for name in ("v", "at", "slab", "part", "k", "x_four", "x_1", "LANES")},
    **{name: f"x: Array, {name}: Real, out: ArrayOut" for name in ("i", "tile", "n_z", "exp", "end")},
    "table": "x: Array, table: Bytes, out: ArrayOut",
    "field": "x: Array, field: Other, out: ArrayOut",
}
"""Arguments that are refused, by the one that is the reason."""


def defined(folder: Path, arguments: str, statements: str) -> Kernel:
    """A kernel, from a file because its text is read."""
    body = "".join(f"    {line}\n" for part in statements.split("; ") for line in part.split("\n"))
    path = folder / "written.py"
    path.write_text(f"@pointwise(over='out')\ndef kernel({arguments}) -> None:\n{body}", encoding="utf-8")
    names = dict(NAMES)
    exec(compile(path.read_text(encoding="utf-8"), path, "exec"), names)  # noqa: S102
    linecache.checkcache(str(path))
    return names["kernel"]


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_is_refused(case: str, tmp_path: Path) -> None:
    statements, what = REFUSED[case]
    arguments = "x: Array, y: Array, row: Row, plane: Plane, samples: Samples, levels: Levels, a: Real, reach: Real"
    kernel = defined(tmp_path, f"{arguments}{', parts: Parts' * ('parts' in statements)}, out: ArrayOut", statements)
    for write in (opencl, warp):
        with pytest.raises(
            KernelError, match=r"cannot have .*or declare it with @kernel and write \w+.cl and "
        ) as error:
            write(kernel)
        assert repr(what)[1:-1] in str(error.value)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_arguments_that_versions_cannot_have_are_refused(name: str, tmp_path: Path) -> None:
    for write in (opencl, warp):
        with pytest.raises(KernelError, match=f"cannot have 'the argument {name}'"):
            write(defined(tmp_path, ARGUMENTS[name], "out[...] = 1.0"))


def test_near_takes_the_argument_reach(tmp_path: Path) -> None:
    statements = "out[...] = np.where(near_axis(x, radius), x, 0.0)"
    with pytest.raises(KernelError, match=r"cannot have 'near_axis\(x, radius\)'"):
        opencl(defined(tmp_path, "x: Array, radius: Real, out: ArrayOut", statements))


@pointwise(over="x")
def swap_in_a_loop(x: ArrayInOut, y: ArrayInOut, counts: Counts, first: Array, turns: ArrayOut) -> None:
    """Numbers that change places, and the turns until all steps are small or NaN."""
    few = first / first
    done, step = 0.0 * x, few
    for _ in range(TURNS):
        x[...], y[...] = y + 1.0, x + 0.0
    for _ in range(6):
        done, step = done + 1.0, 0.5 * step
        if np.all(~(np.abs(step) > 0.2)):
            break
    turns[...] = np.where(few == few, done, -1.0) * counts[:, None, None]


@pytest.fixture
def beside_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of this file find the files that versions include."""
    monkeypatch.setattr(Kernel, "source", property(lambda self: catalog.FOLDER / f"{self.concept}.cl"))
    monkeypatch.setitem(sys.modules, f"vamgpu.kernels.{swap_in_a_loop.concept}", sys.modules[__name__])


@pytest.mark.usefixtures("beside_the_others")
def test_devices_swap_and_stop_as_the_definition_says(device: Device) -> None:
    shape = (2, 3, 16)
    x, y = np.full(shape, 10.0, np.float32), np.full(shape, 20.0, np.float32)
    first = np.ones(shape, np.float32)
    first[0, 1, 3] = 0.0
    counts = np.array([1, 7], np.int32)
    given = {name: device.upload(value) for name, value in (("x", x), ("y", y), ("first", first))}
    turns = device.upload(np.zeros(shape, np.float32))
    with np.errstate(invalid="ignore"):
        device.launch(swap_in_a_loop, **given, counts=device.table(counts, "int32"), turns=turns)
    a, b, steps = 10.0, 20.0, 0
    for _ in range(TURNS):
        a, b = b + 1.0, a
    assert np.all(given["x"].numpy() == a) and np.all(given["y"].numpy() == b) and a != b
    while 0.5**steps > 0.2:
        steps += 1
    expected = np.where(first == 0.0, -1.0, steps) * counts[:, None, None]
    assert np.array_equal(turns.numpy(), expected)


def test_a_voxel_without_a_number_does_not_keep_the_others_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    a, v = np.array([0.5, np.nan, 0.3]), np.array([0.2, 0.2, 0.9])
    exp, calls = np.exp, []
    monkeypatch.setattr(np, "exp", lambda x: (calls.append(1), exp(x))[1])
    h = inhibition.depletion_substep(a, 0.4 * a, v, 1.5, 0.05)
    assert len(calls) <= 2 * 12 < 2 * inhibition.MOST  # Newton's method doubles the digits with every step
    for k in (0, 2):
        arrived = a[k] * (1 - exp(-h[k])) + 0.4 * a[k] * (1 - exp(-1.5 * h[k])) / 1.5 + 0.05 * h[k]
        assert arrived == pytest.approx(v[k], rel=1e-6)
    assert "(~(fabs" in opencl(inhibition.inhibition_step) and "(not (wp.abs" in warp(inhibition.inhibition_step)


def launched(device: Device, kernel: Kernel, fields: dict[str, Any], **numbers: Any) -> dict[str, Any]:
    """What a kernel leaves in its arrays."""
    arrays = {name: (device.upload if value.ndim == 3 else device.table)(value) for name, value in fields.items()}
    major, minor, z = arrays[kernel.over].shape
    arrays["parts"] = device.table(np.zeros(device.items(kernel, (major, minor, z))))
    device.launch(kernel, **arrays, **numbers)
    return {name: array.numpy() for name, array in arrays.items()}


def test_losses_of_weight_0_are_0_whatever_the_dose_is(device: Device) -> None:
    dose, weight = np.full((2, 2, 8), 0.2), np.ones((2, 2, 8))
    dose[0, 1, 2], weight[0, 1, 2] = 1e30, 0.0
    numbers = {
        "weighted": 1,
        "start": 0.0,
        "density": 1.0,
        "low": 0.5,
        "high": 1.0,
        "slack_low": 0.1,
        "slack_high": 0.1,
    }
    numbers |= {"gain_low": 1.0, "gain_high": 1.0, "power": 3.0, "ridge": 0.0, "binary": 0, "reach": 9.0}
    fields = {"dose": dose, "target": np.zeros(dose.shape), "weight": weight, "response": np.array([0.0, 1.0])}
    found = launched(device, band_loss, fields, **numbers)
    assert found["dose"][0, 1, 2] == 0.0
    assert found["parts"].sum() == pytest.approx(31 * 0.2**3, rel=1e-5)  # 0.2 is 0.3 below the band's middle
    assert found["dose"][1, 1, 1] == pytest.approx(-3 * 0.2**2, rel=1e-5)


def test_a_penalty_of_weight_0_is_none_whatever_the_light_is(device: Device) -> None:
    light, gradient = np.full((2, 2, 8), 0.5), np.full((2, 2, 8), 0.25)
    light[1, 0, 3] = 1e30
    fields = {"light": light, "gradient": gradient}
    found = launched(device, apply_penalty, fields, weight=0.0, power=3.0, hold=0, most=1.0)
    assert np.all(found["gradient"] == 0.25) and found["parts"].sum() == 0.0


@pytest.mark.parametrize("version", ["opencl", "warp"])
def test_a_record_holds_for_the_text_that_it_measured(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [{"kernel": one.name, "text": catalog.text_hash(one), "error": 1e-6} for one in (partial_sum, partial_dot)]
    assert catalog.text_hash(put_poses) != catalog.text_hash(take_poses)  # of one file
    assert catalog.on_gpu(rows) == {catalog.text_hash(partial_sum), catalog.text_hash(partial_dot)}
    assert catalog.text_hash(partial_dot) not in catalog.on_gpu([*rows, rows[1] | {"error": np.nan}])
    assert catalog.text_hash(partial_sum) not in catalog.on_gpu([{"kernel": "partial_sum", "error": 1e-6}])
    monkeypatch.setattr(catalog, version, lambda kernel: "another text")
    assert catalog.text_hash(partial_sum) not in catalog.on_gpu(rows)
    assert catalog.text_hash(partial_sum) != catalog.text_hash(partial_dot)
