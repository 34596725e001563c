"""Zips whose members are unpacked only up to their stated size, with a limit on the number of members."""

from __future__ import annotations

import re
from os import SEEK_END
from typing import BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from vamgpu.storage.memory import size

MOST_DIRECTORY = 20_000_000
"""Size limit of a zip's list of members [bytes]; each takes about a hundred there, and a thousand in memory."""
TAIL = 22 + 20 + 56 + (1 << 16)  # bytes at the end of a zip that contain the description of its list
DESCRIPTIONS = (re.compile(rb"(?s)PK\x05\x06.{8}(.{4})"), re.compile(rb"(?s)PK\x06\x06.{36}(.{8})"))
"""The description of the list, also for zips of more than 4 GB, and the size of the list in bytes."""

LOCKED = 0x61  # flags of members that are encrypted, or patches of others


def open_zip(file: BinaryIO) -> ZipFile:
    """Open a zip for reading."""
    file.seek(max(0, file.seek(0, SEEK_END) - TAIL))
    tail = file.read(TAIL)
    claims = [int.from_bytes(found, "little") for kind in DESCRIPTIONS for found in kind.findall(tail)]
    if any(MOST_DIRECTORY < claim != 2**32 - 1 for claim in claims):
        raise BadZipFile(f"its list of members takes {size(max(claims))}, expected {size(MOST_DIRECTORY)} at most")
    try:
        archive = ZipFile(file)
    except NotImplementedError as error:  # a version of the format that nobody has written
        raise BadZipFile(f"its list of members is damaged ({error})") from error
    try:
        for member in archive.infolist():
            if not member.filename:
                raise BadZipFile("it has a member without a name")
            if member.compress_type not in (ZIP_STORED, ZIP_DEFLATED) or member.flag_bits & LOCKED:
                how = "is encrypted" if member.flag_bits & LOCKED else f"is packed in way {member.compress_type}"
                raise BadZipFile(f"{member.filename!r} {how}, expected stored or deflated members")
    except BaseException:
        archive.close()
        raise
    return archive


def unpacked(archive: ZipFile, member: str | ZipInfo, most: int | None = None) -> bytes:
    """A member of a zip, or its first bytes."""
    info = archive.getinfo(member) if isinstance(member, str) else member
    with archive.open(info) as file:
        return file.read(info.file_size if most is None else min(most, info.file_size))
