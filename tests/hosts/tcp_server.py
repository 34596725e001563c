"""Emulated machines in real time, on sockets."""

from __future__ import annotations

import socket

from servers import Server

from vamgpu.hosts.emulators.line import Faults, LineDevice


class TcpServer(Server):
    """A machine on a socket of this computer; ``url`` is what a driver opens. One caller at a time."""

    def __init__(self, machine: LineDevice, faults: Faults | None = None) -> None:
        super().__init__(machine, faults)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._caller: socket.socket | None = None
        self.url: str = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def _descriptors(self) -> list[int]:
        return [(self._caller or self._listener).fileno()]

    def _read(self) -> bytes:
        if self._caller is None:
            self._caller = self._listener.accept()[0]
            self._caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        try:
            data = self._caller.recv(4096)
        except ConnectionError:
            data = b""
        if not data:
            self._caller.close()
            self._caller = None
        return data

    def _write(self, data: bytes) -> None:
        if self._caller is not None:
            try:
                self._caller.sendall(data)
            except ConnectionError:
                self._caller.close()
                self._caller = None

    def close(self) -> None:
        """Stop serving, and hang up."""
        super().close()
        if self._caller is not None:
            self._caller.close()
        self._listener.close()
