"""A print begins with a page to stop it at, or not at all."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest
import uvicorn

from vamgpu.errors import DeviceError
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.panel import server as panels
from vamgpu.hosts.records.state import Board


def refused(why: str) -> None:
    """A panel that does not start leaves no socket and no thread."""
    panel = Panel(Board(), page=False)
    with pytest.raises(DeviceError, match=why), panel:
        pytest.fail("the print begins without a stop page")
    assert panel._socket.fileno() < 0
    assert panel._thread is not None and not panel._thread.is_alive()


def test_a_server_that_is_up_answers_at_once() -> None:
    with Panel(Board(), page=False) as panel:
        assert panel._server is not None and panel._server.started


@pytest.mark.parametrize("error", [RuntimeError("no loop"), SystemExit(1), OSError("too many open files")])
def test_a_server_that_fails_is_told(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(uvicorn.Server, "run", fail)
    refused(type(error).__name__)


def test_a_server_that_ends_before_it_is_up_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    async def nothing(self: Any, sockets: Any = None) -> None:
        self.should_exit = True

    monkeypatch.setattr(uvicorn.Server, "startup", nothing)
    refused("stopped early")


def test_a_server_that_hangs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(self: Any, sockets: Any = None) -> None:
        while not self.should_exit:
            time.sleep(0.001)

    monkeypatch.setattr(uvicorn.Server, "run", hang)
    monkeypatch.setattr(panels, "STARTING", 0.05)
    refused("not up after 0.05 s")
    assert not [thread for thread in threading.enumerate() if thread.name == "panel"]
