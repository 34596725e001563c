"""Options that commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter, Token
from rich.console import Console

from vamgpu.errors import BadInput, Cancelled
from vamgpu.storage.atomic import named

Settings = Annotated[
    list[str] | None,
    Parameter(name="--set", negative="", help="replace a key, as key=value; key= removes it; repeat it for several"),
]
Overwrite = Annotated[bool, Parameter(name="--overwrite", negative="", help="overwrite existing files")]


def _whole(_: object, tokens: Sequence[Token]) -> int:
    """An argument that is a whole number; Cyclopts would round others. Raises `ValueError`."""
    if not tokens[0].value.removeprefix("-").isdecimal():
        raise ValueError(f"got {tokens[0].value}; expected a whole number")
    return int(tokens[0].value)


Whole = Annotated[int | None, Parameter(converter=_whole)]

Switch = Annotated[bool, Parameter(negative="")]


def console() -> Console:
    """Where commands write."""
    return Console(highlight=False, soft_wrap=True)


def solved_folder(job: Path, command: str) -> Path:
    """The folder of a job or a run, for a command. Raises `BadInput` for a job file or a mesh."""
    if job.suffix.lower() in (".stl", ".ply", ".obj", ".3mf", ".step", ".stp"):
        raise BadInput(f"{str(job)!r} is a mesh, which has no frames; expected the folder that `vam solve` writes for "
                       "a job file that names this mesh: vam init job.toml writes one")  # fmt: skip
    if job.suffix.lower() == ".toml":
        folder = job.with_suffix(".vam")
        raise BadInput(f"{str(job)!r} is a job file, which has no frames; expected the folder that `vam solve {job}` "
                       f"writes: vam {command} {folder}")  # fmt: skip
    return named(job)


@contextmanager
def continued(kept: Callable[[], bool], change: str = "") -> Iterator[None]:
    """On Ctrl-C, advise to run the same command, with ``change``, if it can continue from ``kept``."""
    try:
        yield
    except (Cancelled, KeyboardInterrupt) as error:
        if not kept():
            raise
        raise KeyboardInterrupt(f"Run the same command {change + ' ' if change else ''}to continue.") from error
