"""An emulated Zaber device of one axis: ASCII messages with check sums, and motion that takes time."""

from __future__ import annotations

from vamgpu.hosts.emulators.line import Outbox
from vamgpu.hosts.emulators.track import Track

SPEED = 1.6384


class EmulatedStage:
    """One axis in microsteps; ``track`` tells where it truly is, ``rotary`` has no end.

    ``scale`` and ``offset`` make the true position differ from the one reported, as a slipping belt does.
    """

    def __init__(
        self,
        limit: int = 10_000_000,
        rotary: bool = False,
        acceleration: float = 2_000_000.0,
        device: int = 1,
        latency_us: float = 90.0,
        scale: float = 1.0,
    ) -> None:
        self.track = Track(acceleration)
        self.limit, self.rotary, self.device, self.scale = limit, rotary, device, scale
        self.settings = {"maxspeed": 153600, "resolution": 64, "limit.max": limit}
        self.settings |= {"deviceid": 50081, "system.serial": 42}
        self.homed = False
        self.fault = ""
        self.rejected: list[str] = []
        self._buffer = bytearray()
        self._out = Outbox(0, round(latency_us * 1000))

    def true_position(self, now: int) -> float:
        """Where the axis is [microsteps]."""
        return self.track.position(now) * self.scale

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self._buffer += data
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).rstrip(b"\r")
            del self._buffer[: end + 1]
            if line.startswith(b"/"):
                self._command(line[1:], now)

    def take(self, now: int) -> bytes:
        """Give bytes that have left."""
        return self._out.take(now)

    def ready(self) -> int | None:
        """When the next bytes leave."""
        return self._out.ready()

    def due(self) -> int | None:
        """The axis says nothing by itself."""
        return None

    def advance(self, now: int) -> None:
        """Positions are computed when they are asked for."""

    def _command(self, body: bytes, now: int) -> None:
        checked = body[-3:-2] == b":"
        if checked:
            total = 0
            for byte in body[:-3]:
                total = (total + byte) % 256
            if (total + int(body[-2:], 16)) % 256:
                return
            body = body[:-3]
        words = body.decode("ascii").split()
        numbers = []
        while words and words[0].isdigit() and len(numbers) < 3:
            numbers.append(words.pop(0))
        device = int(numbers[0]) if numbers else 0
        if device not in (0, self.device):
            return
        number = numbers[2] if len(numbers) > 2 else None
        good, data = self._act(words, now)
        if not good:
            self.rejected.append(data)
        state = "BUSY" if self.track.moving(now) else "IDLE"
        warning = self.fault or ("--" if self.homed or self.rotary else "WR")
        fields = [f"{self.device:02d}", "1" if len(numbers) > 1 and numbers[1] != "0" else "0"]
        fields += [number] if number else []
        text = " ".join([*fields, "OK" if good else "RJ", state, warning, data])
        if checked:
            text += f":{256 - sum(text.encode()) % 256 & 255:02X}"
        self._out.put(f"@{text}\r\n".encode("ascii"), now)

    def _act(self, words: list[str], now: int) -> tuple[bool, str]:
        try:
            match words:
                case []:
                    return True, "0"
                case ["get", "pos"]:
                    return True, str(round(self.track.position(now)))
                case ["get", name] if name in self.settings:
                    return True, str(self.settings[name])
                case ["set", "pos", value]:
                    self.track.set_position(now, int(value))
                    return True, "0"
                case ["set", name, value] if name in self.settings:
                    self.settings[name] = int(value)
                    return True, "0"
                case ["home"]:
                    self.homed = True
                    return self._go(0.0, now)
                case ["stop"] | ["estop"]:
                    self.track.run(now, 0.0)
                    return True, "0"
                case ["move", "abs", value]:
                    return self._go(float(int(value)), now)
                case ["move", "rel", value]:
                    return self._go(self.track.position(now) + int(value), now)
                case ["move", "vel", value]:
                    self.track.run(now, int(value) / SPEED)
                    return True, "0"
        except ValueError:
            return False, "BADDATA"
        return False, "BADCOMMAND"

    def _go(self, target: float, now: int) -> tuple[bool, str]:
        if not self.rotary and not 0 <= target <= self.limit:
            return False, "BADDATA"
        self.track.go(now, target, self.settings["maxspeed"] / SPEED)
        return True, "0"
