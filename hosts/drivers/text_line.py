"""Queries and answers in lines of text, by patterns."""

from __future__ import annotations

import re

from vamgpu.errors import DeviceLost, DeviceRefused
from vamgpu.hosts.drivers.wire import Wire

MOST = 200  # most lines before an answer


def exchange(wire: Wire, text: str, pattern: str, refused: str) -> re.Match[str]:
    """Send a text; the first line that matches the pattern. DeviceRefused at a line that matches ``refused``."""
    with wire.lock:
        wire.drain()
        wire.send(text.encode("latin-1"))
        for _ in range(MOST):
            if not (raw := wire.line()):
                break
            line = raw.decode("ascii", "replace").strip()
            if error := re.search(refused, line):
                raise DeviceRefused(f"{wire.name} refused {text.strip()!r}: {line}", error[0])
            if found := re.search(pattern, line):
                return found
    raise DeviceLost(f"{wire.name} does not answer {text.strip()!r}; check its power and its plug")
