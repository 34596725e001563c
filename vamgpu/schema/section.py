"""Tables of files in the form that pydantic reads: no unknown keys, and no silent conversion."""

from __future__ import annotations

from os.path import isfile
from pathlib import Path
from typing import Any, ClassVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationInfo


class Section(BaseModel):
    """A table: no unknown keys, and no silent conversion."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Misplaced(ValueError):
    """An error that concerns several tables of a file; ``key`` is the key to correct."""

    def __init__(self, message: str, *key: str) -> None:
        super().__init__(message)
        self.key = key


def _is_there(value: Any, info: ValidationInfo) -> Any:
    context = info.context or {}
    if context.get("files") and isinstance(value, str):
        path = Path(context["folder"]) / value
        if not isfile(path):  # works for any name
            raise ValueError(f"there is no file {str(path)!r}; expected a path relative to the job file: correct it")
    return value


Named: AfterValidator = AfterValidator(_is_there)
"""The type of a key that may name a file: an error if the file is missing and must be read."""


def tupled(value: Any) -> Any:
    """Lists as tuples, at all levels."""
    return tuple(tupled(entry) for entry in value) if isinstance(value, list) else value


Listed: BeforeValidator = BeforeValidator(tupled)
