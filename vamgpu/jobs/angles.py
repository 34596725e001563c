"""The angles of a job: so many over a range, or those of a file that somebody measured."""

from __future__ import annotations

from pathlib import Path

from vamgpu.curethrough.resin import read_columns
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.geometry import FULL_TURN, Turntable
from vamgpu.jobs.model import TurntableSection
from vamgpu.units import deg, rad

ANGLES = {"angle_deg": deg, "angle_rad": rad}
"""Columns that angles may stand in, and their units."""


def motion_of(section: TurntableSection, folder: Path) -> Turntable:
    """The turntable of a job whose paths begin at ``folder``. Raises `JobError`."""
    if isinstance(section.angles, str):
        return read_angles(folder / section.angles)
    return Turntable.arc(section.angles, FULL_TURN if section.range is None else min(section.range, FULL_TURN))


def read_angles(path: Path) -> Turntable:
    """Measured angles of a CSV file, a row each in the order they are shown, with their times if it has them.

    Args:
        path: of a table with a header: angle_deg or angle_rad, and dwell where poses are lit for unequal times.

    Raises:
        JobError: other columns, a line that holds no numbers, or angles that `Turntable` refuses.
    """
    try:
        table = read_columns(path)
        unit = next((name for name in ANGLES if name in table), None)
        if unit is None or set(table) - {unit, "dwell"}:
            raise BadInput(
                f"{path.name} has columns {', '.join(table)}; wanted angle_deg or angle_rad, and dwell where poses are "
                "lit for unequal times"
            )
        return Turntable(table[unit] * ANGLES[unit], table.get("dwell"))
    except (BadInput, StorageError) as error:
        raise JobError(f"turntable.angles: {error}") from error
