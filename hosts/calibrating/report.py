"""What a calibration found, on the disk: numbers that are read back, all readings, and a figure."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.storage.atomic import replacing
from vamgpu.storage.reading import parse_toml, read_text

Line = tuple[str, str]
MEASURED = "measured"  # table of a result that holds its numbers


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration's outcome.

    kind: focus, axis, gray, flat, mtf or runout.  numbers: plain values by name.  readings: all that was read, by
    name.  lines: name and value, for people.  draw: draws a figure on axes of matplotlib.  tables: further tables of
    plain values.
    """

    kind: str
    numbers: Mapping[str, Any]
    readings: Mapping[str, np.ndarray]
    lines: tuple[Line, ...]
    draw: Callable[[Any], None]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def save(
    found: CalibrationResult, folder: str | Path, rig: str, *, overwrite: bool = False, taken: datetime | None = None
) -> Path:
    """Write ``result.toml``, ``readings.npz``, ``figure.png`` and the rig's file into a new folder.

    Raises `StorageError`; nothing half-written is left.
    """
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


def read(folder: str | Path, kind: str | None = None) -> dict[str, Any]:
    """The tables of a result. Raises `StorageError` for none, `BadInput` for a calibration of another kind."""
    file = Path(folder) / "result.toml" if Path(folder).is_dir() else Path(folder)
    try:
        data = parse_toml(read_text(file))
    except (OSError, UnicodeDecodeError) as error:
        raise StorageError(f"cannot read the calibration {str(folder)!r}: {error}; check the path") from error
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{str(file)!r} is no valid TOML: {error}") from error
    if "calibration" not in data or (kind is not None and data["calibration"] != kind):
        raise BadInput(
            f"{str(file)!r} holds {data.get('calibration', 'no calibration')}; expected one of {kind or 'any'}"
        )
    return data


def free(folder: str | Path, overwrite: bool) -> None:
    """Raises `StorageError` where a result may not be written; better told before anything is measured."""
    if Path(folder).exists() and not overwrite:
        raise StorageError(f"{str(folder)!r} exists; choose another path, or allow overwriting it")


def focused_at(folder: str | Path, positions: Sequence[float]) -> tuple[float, ...]:
    """Lens powers [dpt] that focus at positions [mm], by a calibration of the focus. Raises as `read` does."""
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
    raise BadInput(f"{value!r} is no plain value; expected numbers, text, or lists of them")


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
