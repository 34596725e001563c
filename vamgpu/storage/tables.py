"""Tables of numbers in text, as spreadsheets and instruments write them."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.quantity import RAISED
from vamgpu.storage.reading import read_bytes

MOST_BYTES = 64_000_000
NUMBER = re.compile(r"[-+]?[\d.,]+(?:e[-+]?\d+)?", re.IGNORECASE)
UNITS = {
    "height": {"mm": 1.0, "um": 1e-3, "cm": 10.0},
    "exposure": {"mJ/mm2": 1.0, "mJ/cm2": 1e-2, "J/cm2": 10.0, "J/m2": 1e-3},
    "irradiance": {"mW/mm2": 1.0, "mW/cm2": 1e-2, "uW/cm2": 1e-5, "W/cm2": 10.0, "W/m2": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
}
"""Kind of a column → units in its header, in mm, mJ/mm², mW/mm² and s; also in small letters, never in capitals."""
WORDS = {
    "height": ("height", "depth", "thick"), "exposure": ("exposure", "dose", "energy"),
    "irradiance": ("irradiance", "intensity", "power"), "time": ("time", "exposure", "duration"),
}  # fmt: skip
"""Kind → words in a header that distinguish it from other columns in the same unit."""
SPREADS = re.compile(r"std|\bsd\b|dev|err|uncert|±|_sd\b", re.IGNORECASE)
"""Headers of columns that hold the error of another column."""


@dataclass(frozen=True)
class Table:
    """Cells of a file by column; only columns that are asked for must hold numbers, so notes may stand beside."""

    name: str
    lines: tuple[int, ...]
    cells: dict[str, tuple[str, ...]]

    def numbers(self, column: str) -> np.ndarray:
        """The numbers of a column. Raises `BadInput`."""
        found = np.empty(len(self.lines))
        for row, (line, cell) in enumerate(zip(self.lines, self.cells[column], strict=True)):
            try:
                found[row] = float(cell)
            except ValueError as error:
                raise BadInput(f"{self.name}, line {line}: {error} in {column!r}; expected numbers below the "
                               "header: correct it, or leave the line out") from error  # fmt: skip
            if not np.isfinite(found[row]):
                raise BadInput(f"{self.name}, line {line} holds NaN or infinity; correct it, or leave the line out")
        return found

    def find(self, kind: str) -> np.ndarray | None:
        """The numbers of the column with a unit of a kind in its header, in the library's unit. Raises `BadInput`."""
        found = {name: factor for name in self.cells if (factor := _factor(name, UNITS[kind])) is not None}
        close = (name for name in self.cells if _factor(name, UNITS[kind], re.IGNORECASE) is not None)
        if not found and (name := next(close, None)) is not None:
            raise BadInput(f"{self.name} has the column {name!r}; expected a unit of {', '.join(UNITS[kind])}: write "
                           "it in these letters: capitals mean other units")  # fmt: skip
        for named in (lambda name: not SPREADS.search(name), lambda name: any(w in name.lower() for w in WORDS[kind])):
            kept = {name: factor for name, factor in found.items() if named(name)}
            found = kept if kept and len(found) > 1 else found
        if len(found) > 1:
            raise BadInput(f"{self.name} has the columns {', '.join(found)}; expected one {kind}: leave the others out")
        return next((self.numbers(name) * factor for name, factor in found.items()), None)

    def lacks(self, *expected: str) -> BadInput:
        """The error for a table without a column."""
        return BadInput(f"{self.name} has columns {', '.join(self.cells)}; expected {' or '.join(expected)}")


def read_table(path: str | Path) -> Table:
    """Read a table in UTF-8, UTF-16 or Latin-1: commas, semicolons, tabs, bars or blanks between cells, a header above.

    Lines that begin with # are left out. Decimals may have commas if no comma is between cells. Raises `StorageError`,
    and `BadInput` with the line that has another number of cells than the header.
    """
    file = Path(path)
    try:
        lines = _text(read_bytes(file, MOST_BYTES)).split("\n")
        first = next((k for k, line in enumerate(lines) if _counts(line)), 0)
        mark = _mark(lines, first)
        reader = csv.reader(StringIO("\n".join(lines)), delimiter=mark, skipinitialspace=mark == " ")
        rows = [(reader.line_num, row) for row in reader if _counts("".join(row))]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StorageError(f"cannot read {str(path)!r}: {error}; check the path") from error
    if len(rows) < 2:
        raise BadInput(f"{file.name} has {len(rows)} lines; expected a header and numbers below it")
    header = [cell.strip() for cell in rows[0][1]]
    while len(header) > 1 and not header[-1]:
        header.pop()
    if all(NUMBER.fullmatch(name) for name in header):
        raise BadInput(f"{file.name} begins with the numbers {', '.join(header)}; expected a header above them: name "
                       "each column, with its unit, such as time_s")  # fmt: skip
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise BadInput(f"{file.name} has the column {twice[0]!r} more than once; keep one of them")
    width = len(header)
    for number, row in rows[1:]:
        if any(cell.strip() for cell in row[width:]) or not any(cell.strip() for cell in row[:width]):
            raise BadInput(f"{file.name}, line {number} has {len(row)} values; expected {width}")
    clean = [[cell.strip() for cell in (*row, *[""] * width)[:width]] for _, row in rows[1:]]
    point = (lambda cell: cell) if mark == "," else (lambda cell: cell.replace(",", "."))
    columns = {name: tuple(point(row[k]) for row in clean) for k, name in enumerate(header)}
    return Table(file.name, tuple(number for number, _ in rows[1:]), columns)


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """The columns of a table that holds nothing but numbers, float64 [line]; arguments and errors as `read_table`."""
    table = read_table(path)
    return {name: table.numbers(name) for name in table.cells}


def _text(data: bytes) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    if "\0" in text:
        raise csv.Error("it is not text")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _counts(line: str) -> bool:
    """Whether a line has cells of the table: remarks, empty ones and the first line of Excel's files have none."""
    said = line.strip(" \t;,|\n")
    return bool(said) and not said.startswith("#") and not re.fullmatch(r"sep=.?", said)


def _mark(lines: list[str], header: int) -> str:
    """What is between the cells of a table."""
    line = lines[header]
    if found := next((mark for mark in "\t;,|" if mark in line), None):
        return found
    below = next((each for each in lines[header + 1 :] if _counts(each)), "")
    return " " if len(line.split()) == len(below.split()) > 1 else ","


def _factor(name: str, units: dict[str, float], flags: int = 0) -> float | None:
    """Size of the unit that ends a header; None if it is another. Minutes need brackets: min also means least."""
    plain = name.translate(RAISED).replace("µ", "u").replace("·", "*")
    for unit, factor in units.items():
        over, _, under = unit.partition("/")
        ending = f"{over}[ _/*]?(?:per )?{under[:-1]}-?2" if under else over
        before = r".*[\[(/]" if unit == "min" else r"(?:.*[\s_\[(/,])?"
        if re.fullmatch(rf"{before}(?:{ending}|{ending.lower()})\s*[\])]?", plain, flags):
            return factor
    return None
