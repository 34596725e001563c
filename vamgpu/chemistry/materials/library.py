"""Finds, reads and checks the files of materials."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Self

from pydantic import ValidationError

from vamgpu.chemistry.materials.extinction import Extinction
from vamgpu.errors import MaterialError, OutsideData
from vamgpu.schema.registry import nearest_of
from vamgpu.schema.section import Section
from vamgpu.storage.reading import load_toml

DATA = Path(__file__).parent / "data"


class Material(Section):
    """A table of a file of its own; ``folder`` is the bundled folder for its kind."""

    folder: ClassVar[str]
    name: str

    @classmethod
    def load(cls, name: str | Path) -> Self:
        """Read a bundled material by its name, or a file whose path ends in .toml. Raises `MaterialError`."""
        if isinstance(name, Path) or str(name).endswith(".toml"):
            return cls._read(Path(name))
        if name not in cls.names():
            near = nearest_of(str(name), cls.names())
            guess = f"did you mean {near!r}?" if near else "give the path of a .toml file for another one"
            raise MaterialError(f"no {name!r} among the {cls.folder} {', '.join(cls.names())}; {guess}")
        return cls._read(DATA / cls.folder / f"{name}.toml")

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of the bundled ones."""
        return tuple(sorted(path.stem for path in (DATA / cls.folder).glob("*.toml")))

    @classmethod
    def _read(cls, path: Path) -> Self:
        data = load_toml(path, "the material", missing=MaterialError, wrong=MaterialError)
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            said = ((".".join(map(str, each["loc"])) or "the file", each["msg"]) for each in error.errors())
            wrong = (f"{path}: {where}: {message.removeprefix('Value error, ')}" for where, message in said)
            raise MaterialError("\n".join(wrong)) from error


class Absorbing(Material):
    """A material that light passes."""

    extinction: Extinction | None = None

    def absorption(self, wavelength: float) -> float:
        """Absorption [1/mm], natural logarithm, at a wavelength in vacuum [mm]. Raises `OutsideData`."""
        if self.extinction is None:
            raise OutsideData(
                f"no source gives the absorption of {self.name}; add an [extinction] table in a file of your own"
            )
        return self.extinction.at(wavelength)
