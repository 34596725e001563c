"""The server of Studio, in a thread of this process, and the thread that watches the workspace."""

from __future__ import annotations

import logging
import os
import signal
import threading
from pathlib import Path
from typing import Any, Self

import vamgpu
from vamgpu.errors import BadInput
from vamgpu.hosts.panel.server import PageServer
from vamgpu.studio.events import Events
from vamgpu.studio.presets import Presets
from vamgpu.studio.prints import Prints
from vamgpu.studio.results import Results
from vamgpu.studio.stacks import Stacks
from vamgpu.studio.tasks import Tasks
from vamgpu.studio.texts import Texts
from vamgpu.studio.workspace import Workspace

log: logging.Logger = logging.getLogger(__name__)
PERIOD = 0.5  # time between two polls of the tasks and the folder [s]
LOCAL = ("127.0.0.1", "::1", "localhost")


class Engine:
    """Everything behind the routes, for one workspace."""

    workspace: Workspace
    events: Events
    texts: Texts
    results: Results
    prints: Prints

    def __init__(self, workspace: Workspace) -> None:
        self.workspace, self.events = workspace, Events()
        self.tasks: Tasks = Tasks(workspace, self.events.publish)
        self.texts, self.results, self.prints = Texts(workspace), Results(workspace), Prints(workspace)
        self.stacks: Stacks = Stacks(workspace)
        self.presets: Presets = Presets(workspace.own / "presets.toml")
        self.revision: int = 0
        self._seen: frozenset[Any] = frozenset()
        self._devices: list[dict[str, str]] | None = None
        self._asked = threading.Lock()
        self._over = threading.Event()

    def listing(self) -> dict[str, Any]:
        return self.workspace.listing(self.tasks.busy()) | {"revision": self.revision}

    def devices(self) -> dict[str, Any]:
        """The devices of this machine; they are asked for in the background at the first call."""
        if self._devices is None and self._asked.acquire(blocking=False):
            threading.Thread(target=self._find, name="devices", daemon=True).start()
        return {"devices": self._devices or [], "ready": self._devices is not None}

    def _find(self) -> None:
        self._devices = [{"name": str(each), "description": ""} for each in vamgpu.devices()]
        self.events.publish("devices", {})

    def watch(self) -> None:
        """Poll until `close`; an error in one poll does not end the watch."""
        while not self._over.wait(PERIOD):
            try:
                self.look()
            except Exception as error:
                log.error("polling the workspace failed: %r", error)

    def look(self) -> None:
        """Poll the tasks, the folder and a print that began."""
        self.tasks.poll()
        seen = frozenset(self._changes())
        if seen != self._seen:
            self._seen, self.revision = seen, self.revision + 1
            self.events.publish("workspace", {"revision": self.revision})
        if self.prints.follow(self.tasks.printing()):
            self.events.publish("print", {})

    def _changes(self) -> Any:
        for entry in os.scandir(self.workspace.folder):
            if ".partial-" not in entry.name and not entry.name.startswith("."):
                found = entry.stat(follow_symlinks=False)
                yield entry.name, found.st_mtime_ns, found.st_ino

    def close(self) -> None:
        """End the watch; tasks and prints continue."""
        self._over.set()
        self.prints.close()


class Studio(PageServer):
    """A server of Studio for one workspace; a context manager; arguments and errors as `Workspace` and `PageServer`."""

    engine: Engine

    def __init__(self, given: str | Path, host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> None:
        if host not in LOCAL:
            raise BadInput(f"the host of Studio is {host!r}; expected {', '.join(LOCAL)}: it starts programs, so only "
                           "this machine may use it; forward its port with ssh -L")  # fmt: skip
        self.workspace: Workspace = Workspace(Path(given))
        try:
            self.engine = Engine(self.workspace)
            super().__init__(host, port, token)
        except BaseException:
            self.workspace.close()
            raise

    def app(self) -> Any:
        from vamgpu.studio.routes import app

        return app(self.engine)

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)  # tasks inherit it, and are stopped by it
        super().__enter__()
        self._watch = threading.Thread(target=self.engine.watch, name="studio", daemon=True)
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.engine.close()
        super().__exit__()
        self.workspace.close()
