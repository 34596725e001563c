"""Emulated machines in real time, on pseudo terminals, and a controller that logs what it did.

``python servers.py --link PATH --log FILE`` serves a controller until it is ended. PATH becomes a link to the terminal;
what it did is written to FILE.
"""

from __future__ import annotations

import argparse
import itertools
import json
import logging
import os
import select
import threading
import time
import tty
from pathlib import Path
from typing import Self

from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import SECOND, Faults, LineDevice

log: logging.Logger = logging.getLogger(__name__)


class Server:
    """A thread that carries bytes between a file descriptor and a machine, in real time."""

    def __init__(self, machine: LineDevice, faults: Faults | None = None) -> None:
        self.machine = machine
        self.faults: Faults = faults or Faults()
        self.lock: threading.RLock = threading.RLock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _read(self) -> bytes:
        raise NotImplementedError

    def _write(self, data: bytes) -> None:
        raise NotImplementedError

    def _descriptors(self) -> list[int]:
        raise NotImplementedError

    def step(self, longest_s: float) -> None:
        """Wait for bytes or for the machine, and act."""
        with self.lock:
            times = [at for at in (self.machine.due(), self.machine.ready()) if at is not None]
        wait = min([longest_s, *(max(at - time.monotonic_ns(), 0) / SECOND for at in times)])
        readable = select.select(self._descriptors(), [], [], wait)[0]
        with self.lock:
            now = time.monotonic_ns()
            self.machine.advance(now)
            if readable and (data := self._read()):
                self.machine.receive(self.faults.spoiled(data, "in"), now)
            out = self.faults.spoiled(self.machine.take(time.monotonic_ns()), "out")
        if out:
            self._write(out)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.step(0.02)
            except OSError as error:
                if not self._stop.is_set():
                    log.warning("emulated line: %s", error)
                break

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)


class PtyServer(Server):
    """A machine on a pseudo terminal; ``url`` is what a driver opens."""

    def __init__(self, machine: LineDevice, faults: Faults | None = None) -> None:
        super().__init__(machine, faults)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url: str = os.ttyname(self._slave)

    def _descriptors(self) -> list[int]:
        return [self._master]

    def _read(self) -> bytes:
        return os.read(self._master, 4096)

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            log.warning("nobody reads %s: %d bytes lost", self.url, len(data))

    def close(self) -> None:
        """Stop serving, and hang up."""
        super().close()
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1


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


def main() -> None:
    """Read the command line and serve."""
    parser = argparse.ArgumentParser(description="An emulated controller on a pseudo terminal.")
    parser.add_argument("--link", type=Path, required=True, help="becomes a link to the terminal")
    parser.add_argument("--log", type=Path, required=True, help="takes what it did")
    given = parser.parse_args()
    serve(EmulatedController(), given.link, given.log)


if __name__ == "__main__":
    main()
