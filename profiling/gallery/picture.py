"""The return value of a gallery entry: a figure and the numbers in its caption."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Fact:
    """One number measured in the run.

    expected: the true value; ``source`` names its origin. bound: "≤" or "≥" if expected is a limit. digits: number of
    significant digits shown.
    """

    name: str
    value: float
    unit: str = ""
    digits: int = 4
    expected: float | None = None
    source: str = ""
    bound: str = ""

    @property
    def shown(self) -> str:
        """Value and unit."""
        return _with_unit(_written(self.value, self.digits), self.unit)

    @property
    def wanted(self) -> str:
        """The expected value, its unit and its source; empty where there is none."""
        if self.expected is None:
            return ""
        number = f"{self.bound} {_with_unit(_written(self.expected, self.digits), self.unit)}".strip()
        return f"{number} ({self.source})" if self.source else number

    @property
    def difference(self) -> str:
        """Difference between the value and the expected one, in its unit and in percent."""
        if self.expected is None or self.bound:
            return ""
        gap = self.value - self.expected
        share = f" ({100 * gap / self.expected:+.2g} %)" if self.expected else ""
        return _with_unit(f"{gap:+.2g}", self.unit) + share


@dataclass(frozen=True)
class Table:
    """Numbers that belong together: a row starts with its name. formats: one for every number of a row."""

    header: tuple[str, ...]
    formats: tuple[str, ...]
    rows: tuple[tuple[str, tuple[float, ...]], ...]

    def cells(self) -> tuple[tuple[str, ...], ...]:
        """The rows as text."""
        return tuple((name, *(format(v, f) for v, f in zip(row, self.formats, strict=True))) for name, row in self.rows)


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure, its caption, the numbers measured while it was made, and the papers on which it relies."""

    figure: Figure
    caption: str
    facts: tuple[Fact, ...]
    table: Table | None = None
    papers: tuple[str, ...] = ()

    def numbers(self) -> dict[str, float]:
        """Every number the page prints, by name."""
        found = {fact.name: fact.value for fact in self.facts}
        for name, row in self.table.rows if self.table else ():
            found |= {f"{name}, {title}": value for title, value in zip(self._columns(), row, strict=True)}
        return found

    def _columns(self) -> tuple[str, ...]:
        return self.table.header[1:] if self.table else ()


def _written(value: Any, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{value:,.0f}" if "e+" in text else text


def _with_unit(number: str, unit: str) -> str:
    return f"{number} {unit}".strip()
