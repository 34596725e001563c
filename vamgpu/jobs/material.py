"""Fill in index, absorption and critical dose of a material in a job file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vamgpu.chemistry.diffusion import Diffusion
from vamgpu.chemistry.materials.resin import Resin
from vamgpu.errors import BadInput, MaterialError, OutsideData
from vamgpu.quantity import parse
from vamgpu.schema.noun import fields_of
from vamgpu.schema.registry import find
from vamgpu.schema.section import Misplaced

TABLES = ("vial", "vat", "vessel", "light")


def with_material(data: Any, folder: Path | None) -> Any:
    """The tables of a file; missing index, absorption and critical dose are filled in from its [resin]."""
    table = data.get("resin") if isinstance(data, dict) else None
    if not isinstance(table, dict) or not isinstance(table.get("material"), str):
        return data
    resin = load_resin(table["material"], folder)
    written, data = data, dict(data)
    vessels = [name for name in TABLES if isinstance(data.get(name), dict)]
    for name in vessels:
        kind = data[name].get("kind", name)
        data[name] = _filled(data[name], "light" if name == "light" else "vessel", kind, resin, table, (name,))
    if isinstance(data.get("print"), dict) and resin.critical_dose is not None:
        data["print"] = {"critical_dose": f"{resin.critical_dose.value!r} mJ/mm3", **data["print"]}
    if data == written and "inhibitor" not in table:
        has = f"[{vessels[0]}] has its own index and absorption" if vessels else "there is no vessel such as [vial]"
        remedy = "leave them out there" if vessels else "add [vial]"
        said = f"got {table['material']!r}, which is not used: {has}; expected keys that it can fill in"
        raise Misplaced(f"{said}: {remedy}, or remove it", "resin", "material")
    return data


def load_resin(material: str, folder: Path | None) -> Resin:
    """A bundled resin, or one from a file beside the job file. Raises `Misplaced`."""
    try:
        return Resin.load((folder or Path()) / material if material.endswith(".toml") else material)
    except MaterialError as error:
        raise Misplaced(str(error), "resin", "material") from error


def diffusion_of(section: Any, folder: Path | None) -> Diffusion | None:
    """Diffusion of a job's [resin]. Raises `BadInput`."""
    if section.inhibitor is None:
        return section.diffusion
    resin = load_resin(section.material, folder)
    return Diffusion(resin.diffusivity(section.inhibitor, temperature=section.temperature), section.exposure)


def _filled(
    given: dict[str, Any], family: str, kind: Any, resin: Resin, table: dict[str, Any], where: tuple[str, ...]
) -> dict[str, Any]:
    """A vessel's table with the values of a resin, also in nested vessels."""
    try:
        fields = {field.name: field for field in fields_of(find(family, kind))}
    except BadInput:
        return given  # the reader reports the error
    found = dict(given)
    if isinstance(given.get("vessel"), dict):
        inner = given["vessel"]
        found["vessel"] = _filled(inner, "vessel", inner.get("kind"), resin, table, (*where, "vessel"))
    if "resin_index" in fields and fields["resin_index"].required and "resin_index" not in given:
        found["resin_index"] = _at(resin.refraction, table, (*where, "resin_index"))
    if "absorption" in fields and "absorption" not in given:
        found["absorption"] = f"{_at(resin.absorption, table, (*where, 'absorption'))!r} 1/mm"
    return found


def _at(ask: Any, table: dict[str, Any], where: tuple[str, ...]) -> float:
    """Property of a resin at the wavelength of a job."""
    try:
        return ask(parse(table.get("wavelength"), "a wavelength"))
    except OutsideData as error:
        raise Misplaced(f"{error}; or write {where[-1]} = … into [{'.'.join(where[:-1])}]", *where) from error
    except ValueError as error:
        raise Misplaced(f"got {table.get('wavelength')!r}; {error}", "resin", "wavelength") from error
