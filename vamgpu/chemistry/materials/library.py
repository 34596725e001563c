"""Finds, reads and checks the files of materials."""

from __future__ import annotations

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from vamgpu.errors import MaterialError

DATA = Path(__file__).parent / "data"
Wanted = TypeVar("Wanted", bound=BaseModel)


def bundled(kind: str) -> tuple[str, ...]:
    """Names of the materials of a kind ("resins", "inhibitors", "glasses", "liquids") that come with the library."""
    return tuple(sorted(path.stem for path in (DATA / kind).glob("*.toml")))


def load(model: type[Wanted], kind: str, name: str | Path) -> Wanted:
    """A bundled material by its name, or one from a path that ends in .toml. Raises `MaterialError`."""
    if isinstance(name, Path) or str(name).endswith(".toml"):
        return read(model, Path(name))
    if name not in bundled(kind):
        near = get_close_matches(str(name), bundled(kind), 1)
        guess = f"did you mean {near[0]!r}?" if near else "give the path of a .toml file for another one"
        raise MaterialError(f"no {name!r} among the {kind} {', '.join(bundled(kind))}; {guess}")
    return read(model, DATA / kind / f"{name}.toml")


def read(model: type[Wanted], path: Path) -> Wanted:
    """The material of a file. Raises `MaterialError` naming every wrong value."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MaterialError(f"cannot read {str(path)!r}: {reason}; wanted a TOML file: check the path") from error
    except tomllib.TOMLDecodeError as error:
        raise MaterialError(f"{path}: not valid TOML: {error}; correct that line") from error
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise MaterialError("\n".join(_complaint(path, entry) for entry in error.errors())) from error


def _complaint(path: Path, entry: object) -> str:
    where = ".".join(str(step) for step in entry["loc"]) or "the file"  # type: ignore[index]
    message = str(entry["msg"]).removeprefix("Value error, ")  # type: ignore[index]
    return f"{path}: {where}: {message}"
