"""What commands have in common."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

Settings = Annotated[list[str] | None, Parameter(name="--set", negative="", help="key=value that replaces the file's")]
Overwrite = Annotated[bool, Parameter(name="--overwrite", negative="", help="replace what stands there")]

Switch = Annotated[bool, Parameter(negative="")]


def console() -> Console:
    """Where commands write."""
    return Console(highlight=False, soft_wrap=True)
