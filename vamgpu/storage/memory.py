"""How much memory the contents of a file may take: one number, compared with what it claims before it is decoded."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.quantity import bytes_of

MEMORY = "VAMGPU_MEMORY"
"""Environment variable that replaces the budget: bytes, or a number with a unit, such as ``24 GB``."""
SHARE = 0.5
"""Part of this machine's memory that is the budget unless `MEMORY` says otherwise."""
UNKNOWN = 8_000_000_000
"""Memory [bytes] that a machine is taken to have where the system does not tell."""
GROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""Where Linux says how much a container may take."""


def budget() -> int:
    """The most memory that the contents of one file may take.

    Returns:
        Bytes: half of this machine's memory, or what the environment variable ``VAMGPU_MEMORY`` says.

    Raises:
        BadInput: The variable holds no size.
    """
    said = os.environ.get(MEMORY, "").strip()
    if not said:
        return int(SHARE * _installed())
    found = bytes_of(said)
    if found is None:
        raise BadInput(f"{MEMORY} is {said!r}; expected a size such as {MEMORY}=24GB: set it anew, or unset it")
    return found


def afford(claim: float, subject: str, error: type[VamError] = StorageError) -> None:
    """Refuse what takes more memory than the budget, before it is decoded.

    Args:
        claim: What the contents of a file take in memory [bytes], by what the file says of itself.
        subject: The file, as messages name it.
        error: What to raise.

    Raises:
        VamError: ``error``, with the claim, the budget and how to raise it.
        BadInput: As `budget`.
    """
    most = budget()
    if claim > most:
        raise error(
            f"{subject} takes {size(claim)} of memory; the budget is {size(most)}: check the file, or raise the budget "
            f"with the environment variable {MEMORY}={max(1, -(-int(claim) // 10**9))}GB"
        )


def size(count: float) -> str:
    """Bytes as people read them.

    Args:
        count: How many [bytes].

    Returns:
        A number with its unit.
    """
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return f"{count:.0f} bytes"


@cache
def _installed() -> int:
    """Memory of this machine [bytes], or of the container this runs in."""
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
