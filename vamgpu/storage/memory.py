"""The memory budget for the contents of a file, compared with the size it states before it is decoded."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.quantity import bytes_of

MEMORY = "VAMGPU_MEMORY"
"""Environment variable that replaces the budget: bytes, or a number with a unit, such as ``24 GB``."""
SHARE = 0.5  # default budget, as a share of this machine's memory; `MEMORY` overrides it
UNKNOWN = 8_000_000_000  # assumed memory [bytes] of a machine if the system does not report it
GROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Linux's file with the memory limit of a container."""


def budget() -> int:
    """Largest memory that the contents of one file may take."""
    said = os.environ.get(MEMORY, "").strip()
    if not said:
        return int(SHARE * installed())
    found = bytes_of(said)
    if found is None:
        raise BadInput(f"{MEMORY} is {said!r}; expected a size such as {MEMORY}=24GB: correct it, or unset it")
    return found


def afford(claim: float, subject: str, error: type[VamError] = StorageError) -> None:
    """Reject contents that take more memory than the budget, before they are decoded."""
    most = budget()
    if claim > most:
        raise error(
            f"{subject} takes {size(claim)} of memory; the budget is {size(most)}: check the file, or raise the budget "
            f"with the environment variable {MEMORY}={max(1, -(-int(claim) // 10**9))}GB"
        )


def size(count: float) -> str:
    """A number of bytes as readable text."""
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return f"{count:.0f} bytes"


@cache
def installed() -> int:
    """Memory of this machine [bytes], or of its container."""
    try:
        found = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # Windows
        found = UNKNOWN
    for file in GROUPS:
        try:
            found = min(found, int(Path(file).read_text(encoding="ascii")))
        except (OSError, ValueError):  # no container, or one without a limit
            continue
    return found if found > 0 else UNKNOWN
