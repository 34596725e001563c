"""Results of calibrations on disk: numbers for prints, all readings, and a figure."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.rigs.calibrations import MEASURED, STAMP, Calibration, place_of, read
from vamgpu.hosts.rigs.config import RigConfig
from vamgpu.storage.atomic import replacing

Line = tuple[str, str]


@dataclass(frozen=True)
class CalibrationResult:
    kind: str  # focus, axis, gray, flat, mtf, runout or turn
    numbers: Mapping[str, Any]  # plain values by name
    readings: Mapping[str, np.ndarray]
    lines: tuple[Line, ...]  # names and values to show
    draw: Callable[[Any], None]  # draws a figure on matplotlib axes
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # further plain values


def save(
    found: CalibrationResult, folder: str | Path, rig: str, *, overwrite: bool = False, taken: datetime | None = None
) -> Path:
    """Write ``result.toml``, ``readings.npz``, ``figure.png`` and the rig's file into a new folder, atomically."""
    tables = {MEASURED: found.numbers, **found.tables}
    text = f'calibration = "{found.kind}"\ntaken = {(taken or datetime.now()).isoformat(timespec="seconds")}\n'
    for name, table in tables.items():
        text += f"\n[{name}]\n" + "".join(f"{key} = {_plain(value)}\n" for key, value in table.items())
    with replacing(folder, overwrite=overwrite) as draft:
        draft.mkdir()
        (draft / "result.toml").write_text(text, encoding="utf-8")
        (draft / "rig.toml").write_text(rig, encoding="utf-8")
        arrays: dict[str, Any] = {name: np.asarray(each) for name, each in found.readings.items()}
        np.savez_compressed(draft / "readings.npz", **arrays)
        _figure(found, draft / "figure.png")
    return Path(folder)


def keep(found: CalibrationResult, rig: RigConfig, now: datetime | None = None) -> Calibration:
    """Add a measurement to those of a rig, without replacing any. Raises `BadInput` for a rig without a file."""
    place = place_of(rig)
    taken = (now or datetime.now()).replace(microsecond=0)
    name, again = f"{found.kind}-{taken.strftime(STAMP)}", 1
    while (place / name).exists():
        again += 1
        name = f"{found.kind}-{taken.strftime(STAMP)}-{again}"
    place.mkdir(parents=True, exist_ok=True)
    return Calibration(found.kind, taken, save(found, place / name, rig.text, taken=taken))


def free(folder: str | Path, overwrite: bool) -> None:
    """Raises `StorageError` if a result may not be written, before the measurement."""
    if Path(folder).exists() and not overwrite:
        raise StorageError(f"{str(folder)!r} exists; choose another path, or allow overwriting it (--overwrite)")


def focused_at(folder: str | Path, positions: Sequence[float]) -> tuple[float, ...]:
    """Lens powers [dpt] that focus at positions [mm], from a calibration of the focus. Raises as `read` does."""
    found = read(folder, "focus")[MEASURED]
    return tuple((position - found["intercept_mm"]) / found["slope_mm_dpt"] for position in positions)


def _plain(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_plain(each) for each in value) + "]"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int | float):
        return repr(value)
    raise BadInput(f"{value!r} is not a plain value; expected numbers, text, or lists of them")


def _figure(found: CalibrationResult, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.2), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#eef1f5")
    axes.set_axisbelow(True)
    found.draw(axes)
    figure.savefig(path)
