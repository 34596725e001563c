"""Machines come to rest and are let go of, whatever fails on the way."""

from __future__ import annotations

import logging
from collections.abc import Callable

import pytest

from vamgpu.hosts.drivers.cleanup import ClosedOnce


class Machine(ClosedOnce):
    called = "a machine"

    def __init__(self, *errors: BaseException) -> None:
        self.did, self.errors = [], list(errors)

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self._stop, lambda: self.did.append("released")

    def _stop(self) -> None:
        self.did.append("stopped")
        if self.errors:
            raise self.errors.pop(0)


def test_what_fails_is_logged_and_the_rest_is_done_once(caplog: pytest.LogCaptureFixture) -> None:
    machine = Machine(OSError("the cable is out"))
    with caplog.at_level(logging.WARNING):
        machine.close()
        machine.close()
    assert machine.did == ["stopped", "released"] and caplog.messages == ["closing a machine: the cable is out"]


def test_what_a_key_interrupts_is_done_again_and_the_key_is_heard(caplog: pytest.LogCaptureFixture) -> None:
    machine = Machine(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt), caplog.at_level(logging.WARNING):
        machine.close()
    assert machine.did == ["stopped", "stopped", "released"]
    assert caplog.messages == ["closing a machine: KeyboardInterrupt"]
