"""A line to a machine: bytes out, bytes in, and errors with a remedy.

Ports open by pyserial (``/dev/ttyUSB0``, ``socket://host:port``), instruments by ``usbtmc:/dev/usbtmc0`` or PyVISA.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from vamgpu.errors import BadInput, DeviceBusy, DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.cleanup import Closing, extra

log: logging.Logger = logging.getLogger(__name__)
MOST = 200  # most lines of text before an answer


class Port(Protocol):
    """An open port, such as pyserial's."""

    def write(self, data: bytes, /) -> Any: ...  # send
    # receive ``size`` bytes, or fewer within the port's timeout
    def read(self, size: int = 1, /) -> bytes: ...
    def reset_input_buffer(self) -> None: ...  # discard received bytes
    def close(self) -> None: ...  # release the port
    @property
    def in_waiting(self) -> int: ...  # number of received bytes


class _MessagePort:
    """A port of whole messages; the unread rest of a message is kept."""

    _pending = b""

    def _message(self) -> bytes:
        """The next message; empty if it does not come in time."""
        raise NotImplementedError

    def read(self, size: int = 1, /) -> bytes:
        if not self._pending:
            self._pending = self._message()
        taken, self._pending = self._pending[:size], self._pending[size:]
        return taken

    def reset_input_buffer(self) -> None:
        self._pending = b""

    @property
    def in_waiting(self) -> int:
        return len(self._pending)


class UsbtmcPort(_MessagePort):
    """The kernel's character device of an instrument on USB, locked to one program: one message per read."""

    def __init__(self, path: str) -> None:
        import fcntl

        self._file = os.open(path, os.O_RDWR)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise

    def write(self, data: bytes, /) -> int:
        return os.write(self._file, data)

    def _message(self) -> bytes:
        return os.read(self._file, 4096)

    def close(self) -> None:
        os.close(self._file)


class VisaPort(_MessagePort):
    """A message-based resource of PyVISA; one message per read."""

    def __init__(self, resource: Any, timeout_s: float) -> None:
        self._resource = resource
        resource.timeout = round(timeout_s * 1000)

    def write(self, data: bytes, /) -> int:
        try:
            return self._resource.write_raw(data)
        except _visa().errors.Error as error:
            raise OSError(errno.EIO, str(error)) from error

    def _message(self) -> bytes:
        visa = _visa()
        try:
            return self._resource.read_raw()
        except visa.errors.Error as error:
            if getattr(error, "error_code", None) == visa.constants.StatusCode.error_timeout:
                return b""
            raise OSError(errno.EIO, str(error)) from error

    def close(self) -> None:
        self._resource.close()


def _visa() -> Any:
    with extra("visa", "VISA addresses need PyVISA"):
        import pyvisa
    return pyvisa


def _visa_port(url: str, name: str, timeout_s: float) -> VisaPort:
    """The resource of a VISA address; with the maker's library if it is installed, else pyvisa-py."""
    visa = _visa()
    try:
        return VisaPort(visa.ResourceManager().open_resource(url), timeout_s)
    except visa.errors.VisaIOError as error:
        if error.error_code in (
            visa.constants.StatusCode.error_resource_busy,
            visa.constants.StatusCode.error_resource_locked,
        ):
            raise DeviceBusy(f"{name} at {url} is used by another program ({error}); close that program") from error
        raise DeviceNotFound(f"{name} is not at {url} ({error}); check the address, the plug and the power") from error
    except (visa.errors.Error, ValueError, OSError) as error:
        raise DeviceNotFound(
            f"{name} cannot be opened at {url} ({error}); check the address, and that a VISA library is installed: "
            'pip install "vamgpu[visa]"'
        ) from error


class Wire(Closing):
    """An open port with a name, safe for several threads, one exchange at a time."""

    def __init__(self, port: Port, name: str) -> None:
        self.port = port
        self.name = name
        self.lock: threading.RLock = threading.RLock()
        self._ahead = bytearray()

    @contextmanager
    def _used(self) -> Iterator[None]:
        """Raise `DeviceLost` if the port fails."""
        try:
            yield
        except OSError as error:
            raise DeviceLost(
                f"{self.name} is lost ({error}); check its plug and its power, then start again"
            ) from error

    def send(self, data: bytes) -> None:
        with self._used():
            self.port.write(data)

    def receive(self, size: int) -> bytes:
        """Receive ``size`` bytes, or fewer if they do not come in time."""
        with self._used():
            while len(self._ahead) < size:
                more = self.port.read(size - len(self._ahead))
                if not more:
                    break
                self._ahead += more
        return self._take(size)

    def line(self, longest: int = 256) -> bytes:
        """Receive up to and with a line feed; fewer bytes, or none, if it does not come in time."""
        end = -1
        with self._used():
            while (end := self._ahead.find(b"\n", 0, longest)) < 0 and len(self._ahead) < longest:
                more = self.port.read(max(self.port.in_waiting, 1))
                if not more:
                    break
                self._ahead += more
        return self._take(end + 1 if end >= 0 else longest)

    def exchange(self, text: str, pattern: str, refused: str) -> re.Match[str]:
        """Send a text; returns the first line that matches. `DeviceRefused` at a line that matches ``refused``."""
        with self.lock:
            self.drain()
            self.send(text.encode("latin-1"))
            for _ in range(MOST):
                if not (raw := self.line()):
                    break
                line = raw.decode("ascii", "replace").strip()
                if error := re.search(refused, line):
                    raise DeviceRefused(f"{self.name} refused {text.strip()!r}: {line}", error[0])
                if found := re.search(pattern, line):
                    return found
        raise DeviceLost(f"{self.name} does not answer {text.strip()!r}; check its power and its plug")

    def _take(self, size: int) -> bytes:
        taken = bytes(self._ahead[:size])
        del self._ahead[:size]
        return taken

    def waiting(self) -> int:
        """Received bytes that are not read."""
        with self._used():
            return len(self._ahead) + self.port.in_waiting

    def drain(self) -> None:
        self._ahead.clear()
        with self._used():
            self.port.reset_input_buffer()

    def reopen(self) -> None:
        """Open the port of an unplugged machine again. Raises DeviceLost if it is not back."""
        self.close()
        self._ahead.clear()
        with self._used():
            if not hasattr(self.port, "open"):
                raise OSError("it cannot be opened again")
            self.port.open()  # type: ignore[attr-defined]

    def close(self) -> None:
        """Release the port; may be called more than once."""
        try:
            self.port.close()
        except OSError as error:
            log.warning("closing %s: %s", self.name, error)


def open_wire(
    url: str, name: str, baud: int = 115200, timeout_s: float = 0.25, lines_low: bool = False, rtscts: bool = False
) -> Wire:
    """Open a machine's port; reads wait for ``timeout_s``. DeviceNotFound, or DeviceBusy if another program uses it."""
    if "::" in url:
        return Wire(_visa_port(url, name, timeout_s), f"{name} at {url}")
    if url.startswith("usbtmc:"):
        try:
            return Wire(UsbtmcPort(url.removeprefix("usbtmc:")), f"{name} at {url}")
        except OSError as error:
            raise _unopened(url, name, error) from error
    with extra("hardware", "ports need pyserial"):
        import serial
    try:
        port = serial.serial_for_url(
            url, do_not_open=True, baudrate=baud, timeout=timeout_s, write_timeout=2.0, exclusive=True, rtscts=rtscts
        )
        if lines_low:
            port.rts = port.dtr = False
        port.open()
    except ValueError as error:
        raise BadInput(f"{url!r} is not the address of a port for {name}: {error}") from error
    except OSError as error:
        raise _unopened(url, name, error) from error
    return Wire(port, f"{name} at {url}")


def _unopened(url: str, name: str, error: OSError) -> DeviceNotFound | DeviceBusy:
    text = str(error)
    if error.errno in (errno.EAGAIN, errno.EBUSY) or "Access is denied" in text:
        return DeviceBusy(f"{name} at {url} is used by another program ({text}); close that program")
    return DeviceNotFound(f"{name} is not at {url} ({text}); check the address, the plug, the power and permissions")
