"""The package around a 3MF mesh: what it holds is weighed before it is unpacked."""

from __future__ import annotations

from graphlib import TopologicalSorter
from io import BytesIO
from typing import Any
from xml.parsers import expat
from zipfile import ZipFile

from vamgpu.errors import MeshError
from vamgpu.storage.memory import afford, size
from vamgpu.storage.zipped import open_zip, unpacked

WORK = 12
"""Bytes of memory that reading takes, by byte of a model's text."""
DENSEST, SMALL = 200, 1 << 24
"""Meshes as text pack ten times smaller; beyond `SMALL` bytes a model that packs so much smaller is none."""
MOST_INSTANCES, MOST_LEVELS = 10_000, 16
"""Parts of parts, counted wherever they are built, and how deep they lie in one another."""
DOCTYPES = (b"<!DOCTYPE", "<!DOCTYPE".encode("utf-16-le")[:-1])
"""What a 3MF file must not have (3MF core, 2.3): entities that multiply, and names of other files."""

COMPONENT = b"component"


def models(data: bytes, name: str) -> BytesIO:
    """The models of a 3MF file in a package that is no longer compressed. Raises `MeshError`."""
    plain = BytesIO()
    try:
        with open_zip(BytesIO(data)) as package, ZipFile(plain, "w") as out:
            members = [member for member in package.infolist() if member.filename.lower().endswith(".model")]
            afford(WORK * sum(member.file_size for member in members), f"the mesh {name!r}", MeshError)
            for member in members:
                if member.file_size > max(SMALL, DENSEST * member.compress_size):
                    raise MeshError(
                        f"{name!r} holds {member.filename!r}, which unpacks from {size(member.compress_size)} to "
                        f"{size(member.file_size)}; no mesh does: export the part again"
                    )
                text = unpacked(package, member)
                if any(mark in text for mark in DOCTYPES):
                    raise MeshError(f"{name!r} declares a DOCTYPE, which no 3MF may: export the part again")
                if COMPONENT in text.replace(b"\0", b""):
                    _check_components(text, name)
                out.writestr(member.filename, text)
    except MeshError:
        raise
    except Exception as error:  # noqa: BLE001 - zipfile and its codecs raise whatever they stumble over
        raise MeshError(
            f"cannot read {name!r} as 3MF ({type(error).__name__}: {error}); "
            "the file is damaged or of another format: export the part again"
        ) from error
    return plain


def _check_components(text: bytes, name: str) -> None:
    """Refuse parts of parts that double from level to level, or that are parts of themselves."""
    parts: dict[str, list[str]] = {"": []}  # a build has no number
    at = ""

    def begin(tag: str, attributes: dict[str, Any]) -> None:
        nonlocal at
        tag = tag.rpartition(" ")[2]
        if tag == "object":
            at = attributes["id"]
            parts.setdefault(at, [])
        elif tag in ("component", "item"):
            parts["" if tag == "item" else at].append(attributes["objectid"])

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler = begin
    parser.Parse(text, True)
    instances, levels = {}, {}
    for each in TopologicalSorter(parts).static_order():  # raises for a part of itself
        inner = parts.get(each, [])
        instances[each] = sum(instances[other] for other in inner) or 1
        levels[each] = 1 + max((levels[other] for other in inner), default=0)
        if instances[each] > MOST_INSTANCES or levels[each] > MOST_LEVELS:
            raise MeshError(
                f"{name!r} has {instances[each]} parts on {levels[each]} levels of components; expected at most "
                f"{MOST_INSTANCES} and {MOST_LEVELS}: join the parts and export them again"
            )
