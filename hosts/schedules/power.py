"""How bright the light of projectors in step is."""

from __future__ import annotations

from collections.abc import Sequence

from vamgpu.errors import BadInput
from vamgpu.hosts.schedules.timing import every, exact, numeric


def powers(power: float | Sequence[float], engines: int | None = None) -> tuple[float, ...]:
    """Of each engine's light, 0 to 1; one number is that of all. engines: how many; None for as many as are given.

    Raises `BadInput`.
    """
    given = (power,) * (engines or 1) if numeric(power) else every("power", power)
    found = tuple(float(exact("power", value, zero=True)) for value in given)
    if engines is not None and len(found) != engines:
        raise BadInput(f"got {engines} engines and {len(found)} powers; wanted as many of both")
    if not found or max(found) > 1:
        raise BadInput(f"power is {power!r}; wanted 0 to 1 of each engine")
    return found
