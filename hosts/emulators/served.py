"""An emulated controller on a pseudo terminal until its process ends, and a log of what it did.

The log has lines of JSON: ``light`` (channels that are lit from now on), ``trigger`` (how many there were), ``lease``
(until when light is allowed), or ``close`` (why the light was closed); ``due_ns`` when that was to happen and
``done_ns`` when it was done, all of the monotonic clock, which all processes of a computer share. A line is written
before the machine answers anything later.
"""

from __future__ import annotations

import itertools
import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from vamgpu.hosts.emulators.servers import PtyServer

if TYPE_CHECKING:
    from vamgpu.hosts.emulators.controller import EmulatedController


def serve(machine: EmulatedController, link: Path, log: Path) -> None:
    """Serve. link: becomes a link to the terminal.  log: is added to."""
    server, triggers = PtyServer(machine), itertools.count(1)
    with log.open("a", buffering=1, encoding="utf-8") as file:

        def note(kind: str, value: object, at: int) -> None:
            file.write(json.dumps({kind: value, "due_ns": at, "done_ns": time.monotonic_ns()}) + "\n")

        machine.on_light = lambda channels, at: note("light", channels, at)
        machine.on_trigger = lambda at: note("trigger", next(triggers), at)
        machine.on_lease = lambda until, at: note("lease", until, at)
        machine.on_close = lambda reason, at: note("close", reason, at)
        link.unlink(missing_ok=True)
        os.symlink(server.url, link)
        try:
            while True:
                server.step(1.0)
        finally:
            link.unlink(missing_ok=True)
