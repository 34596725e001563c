"""Connections with requests that never become complete are closed: they would use up the server."""

from __future__ import annotations

from typing import Any

PATIENCE = (
    10.0  # longest time from the first byte of a request to the end of its headers, or of a silent connection [s]
)


def protocol() -> Any:
    """Uvicorn's protocol of HTTP, which closes connections that are half open."""
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

    usual: Any = AutoHTTPProtocol

    class Closing(usual):
        """One connection; its timer runs whenever no request is being answered, and more bytes do not delay it."""

        _timer: Any = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._watch()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._watch()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop()
            super().connection_lost(exc)

        def _watch(self) -> None:
            if self._answering:
                self._stop()
            elif self._timer is None:
                self._timer = self.loop.call_later(PATIENCE, self._expired)

        def _stop(self) -> None:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None

        @property
        def _answering(self) -> bool:
            return self.cycle is not None and not self.cycle.response_complete

        def _expired(self) -> None:
            self._timer = None
            if not self._answering and not self.transport.is_closing():
                self.transport.close()

    return Closing
