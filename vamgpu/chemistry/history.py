"""History of a vial of resin, and the time of its next print."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from math import exp, pi
from pathlib import Path
from typing import Annotated, Any, Literal

from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, NonNegative, Quantity, Share, measured
from vamgpu.storage.atomic import explained, replacing
from vamgpu.storage.reading import malformed, parse_json, read_text

FORMAT = "vamgpu resin history"
VERSION = 1
Lost = Annotated[float, Quantity(least=0.0, below=1.0, hint="a share of the resin, 0 ≤ share < 1")]


@dataclass(frozen=True)
class Event:
    """An event in the life of a vial."""

    kind: Literal["print", "stir", "rest"]
    oxygen: float  # after it
    depth: float  # after it
    dose: float = 0.0  # dose that the liquid resin got [mJ/mm³]
    seconds: float = 0.0  # duration
    note: str = ""  # free text


@dataclass(frozen=True)
class ResinHistory:
    """The state of a vial; every method returns the next state. Raises `BadInput`."""

    resin: str  # name
    depth: Length  # of the liquid under its free surface [mm]
    oxygen: Share = 1.0  # mean, normalized to air-saturated resin
    dose: NonNegative = 0.0  # mean over the liquid of all light so far [mJ/mm³]
    events: tuple[Event, ...] = field(default=())  # events, in order

    def __post_init__(self) -> None:
        check(self)

    @property
    def prints(self) -> int:
        """Prints so far; the next one is of generation prints + 1."""
        return sum(event.kind == "print" for event in self.events)

    def printed(
        self, *, spent: float, lost: float, dose: float = 0.0, seconds: float = 0.0, note: str = ""
    ) -> ResinHistory:
        """The state after a print that used a share of the oxygen and took a share of the resin. Raises `BadInput`."""
        positive("seconds", seconds, zero=True)
        spent, lost = measured("spent", spent, Share), measured("lost", lost, Lost)
        oxygen, depth = self.oxygen * (1.0 - spent), self.depth * (1.0 - lost)
        return self._next("print", oxygen, depth, dose=positive("dose [mJ/mm³]", dose, zero=True), seconds=seconds,
                          note=note)  # fmt: skip

    def stirred(self, air: float = 0.0, note: str = "") -> ResinHistory:
        """The state after stirring, which replaces the share ``air`` of the missing oxygen. Raises `BadInput`."""
        gained = measured("air", air, Share)
        return self._next("stir", self.oxygen + gained * (1.0 - self.oxygen), self.depth, note=note)

    def rested(self, seconds: float, diffusivity: float, note: str = "") -> ResinHistory:
        """The state after a pause under air; oxygen diffuses in from the surface [mm²/s]. Raises `BadInput`."""
        gained = recovery(diffusivity, seconds, self.depth)
        return self._next("rest", self.oxygen + gained * (1.0 - self.oxygen), self.depth, seconds=seconds, note=note)

    def seconds(self, fresh: float) -> float:
        """Time of the next print [s] if fresh resin takes ``fresh``: light must first use up the oxygen."""
        return positive("time in fresh resin [s]", fresh) * self.oxygen

    def _next(self, kind: Literal["print", "stir", "rest"], oxygen: float, depth: float, **values: Any) -> ResinHistory:
        event = Event(kind, oxygen, depth, **values)
        return replace(self, oxygen=oxygen, depth=depth, dose=self.dose + event.dose, events=(*self.events, event))

    def save(self, path: str | Path) -> None:
        """Write the state as JSON, whole or not at all, replacing an earlier one. Raises `StorageError`."""
        data = {"format": FORMAT, "version": VERSION, "units": {"depth": "mm", "dose": "mJ/mm³", "seconds": "s"}}
        with replacing(path, overwrite=True) as draft:
            draft.write_text(json.dumps(data | asdict(self), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> ResinHistory:
        """Read a state. Raises `StorageError` for a file that cannot be read or is malformed."""
        try:
            data = parse_json(read_text(path))
        except OSError as error:
            raise explained("read", Path(path), error) from error
        except ValueError as error:
            raise StorageError(f"{str(path)!r} is not JSON: {error}; expected a file that save() wrote") from error
        with malformed(f"{str(path)!r} is not a {FORMAT}", "expected a file from save()"):
            if data["format"] != FORMAT or data["version"] > VERSION:
                raise BadInput(f"got {data['format']!r}, version {data['version']}; expected version {VERSION}")
            values: dict[str, Any] = {f.name: data[f.name] for f in fields(cls)}
            values["events"] = tuple(Event(**event) for event in values["events"])
            return cls(**values)


def recovery(diffusivity: float, seconds: float, depth: float) -> float:
    """Share of missing oxygen that diffuses into a layer through one face, 0..1 (Crank 1975, section 4.3)."""
    number = positive("diffusivity [mm²/s]", diffusivity) * positive("seconds", seconds, zero=True)
    number /= positive("depth [mm]", depth) ** 2
    if number < 1e-3:
        return 2.0 * (number / pi) ** 0.5
    odd = [(k + 0.5) * pi for k in range(64)]
    return 1.0 - sum(2.0 / a**2 * exp(-(a**2) * number) for a in odd)
