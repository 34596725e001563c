"""The package around a 3MF mesh; its contents are measured before they are unpacked."""

from __future__ import annotations

from collections.abc import Collection
from io import BytesIO
from zipfile import ZipInfo

from vamgpu.errors import MeshError
from vamgpu.storage.memory import afford, size
from vamgpu.storage.zips import open_zip, unpacked

WORK = 12
"""Bytes of memory that reading takes, per byte of a model's text."""
DENSEST, SMALL = 200, 1 << 24
"""Mesh text compresses about tenfold; a member beyond `SMALL` bytes that compresses more is not a model."""
DOCTYPES = (b"<!DOCTYPE", "<!DOCTYPE".encode("utf-16-le")[:-1])
"""Text that a 3MF file must not contain (3MF core, 2.3): entities that multiply, and names of other files."""


def members_of(data: bytes, name: str, beside: Collection[str] = ()) -> dict[str, bytes]:
    """Texts of the models of a 3MF file, and of members ``beside`` them, by path. Raises `MeshError`."""
    found: dict[str, bytes] = {}
    try:
        with open_zip(BytesIO(data)) as package:
            members = [each for each in package.infolist() if _path(each).lower().endswith(".model")]
            members += [each for each in package.infolist() if _path(each) in beside]
            afford(WORK * sum(member.file_size for member in members), f"the mesh {name!r}", MeshError)
            for member in members:
                if member.file_size > max(SMALL, DENSEST * member.compress_size):
                    raise MeshError(
                        f"{name!r} holds {member.filename!r}, which unpacks from {size(member.compress_size)} to "
                        f"{size(member.file_size)}; a mesh does not: export the part again"
                    )
                text = unpacked(package, member)
                if any(mark in text for mark in DOCTYPES):
                    raise MeshError(f"{name!r} has a DOCTYPE, which 3MF forbids: export the part again")
                found[_path(member)] = text
    except MeshError:
        raise
    except Exception as error:  # noqa: BLE001 - zipfile and its codecs raise whatever they stumble over
        raise MeshError(
            f"cannot read {name!r} as 3MF ({type(error).__name__}: {error}); "
            "the file is damaged or of another format: export the part again"
        ) from error
    return found


def _path(member: ZipInfo) -> str:
    return member.filename.lstrip("/")
