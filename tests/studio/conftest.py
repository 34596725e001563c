"""A Studio on a real port, and a client."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from studio_client import BOAT, Client

from vamgpu.errors import VamError
from vamgpu.hosts.panel import server as panels
from vamgpu.studio.server import Studio


@pytest.fixture(autouse=True)
def a_busy_machine_may_start_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(panels, "STARTING", 200.0)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "boat.toml").write_text(BOAT, encoding="utf-8")
    with Studio(tmp_path / "lab" / "boat.toml") as studio:
        yield Client(studio)
        for task in studio.engine.tasks.listed():
            with suppress(VamError):  # it has ended
                studio.engine.tasks.cancel(task["id"])
