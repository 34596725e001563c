"""Line numbers of keys in a TOML file, which the standard parser does not report."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, replace

TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"""'
    r"|'''.*?'''"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|#[^\n]*"
    r"|[\[\]{}=\n]"
    r"|[^\s\[\]{}=#\"']+",
    re.DOTALL,
)

Path = tuple[str, ...]


@dataclass(frozen=True)
class KeyPlace:
    """Where a table or a key stands in a text. table: the table whose header precedes it."""

    line: int  # from 1
    start: int  # of the header or of the key, in characters
    end: int  # of the header, or of the value
    value: int | None  # start of the value; None for a table
    table: Path


def key_lines(text: str) -> dict[Path, int]:
    """Dotted key → its line, counted from 1, for tables and keys of a valid TOML text."""
    return {path: place.line for path, place in key_places(text).items()}


def key_places(text: str) -> dict[Path, KeyPlace]:
    """Dotted key → its place, for tables and keys of a valid TOML text."""
    starts = [0, *(m.end() for m in re.finditer("\n", text))]
    found: dict[Path, KeyPlace] = {}
    table: Path = ()
    words: list[str] = []
    key: Path | None = None
    depth, start, many = 0, 0, False
    tables: Counter[Path] = Counter()
    for match in TOKEN.finditer(text + "\n"):
        token, line = match[0], bisect_right(starts, match.start())
        if token == "\n":
            if key is None and words and words[0] == "[":
                table = _path(words[1:])
                header = KeyPlace(line, start, match.start(), None, table)
                found.setdefault(table, header)
                if many:
                    tables[table] += 1
                    table = (*table, str(tables[table] - 1))
                    found[table] = header
            if depth == 0:
                words, key, many = [], None, False
        elif token.startswith("#"):
            continue
        elif key is not None:
            depth += (token in "[{") - (token in "]}")
            at = found[key]
            found[key] = replace(at, end=match.end(), value=match.start() if at.value is None else at.value)
        elif token == "=":
            key = table + _path(words)
            found.setdefault(key, KeyPlace(line, start, match.end(), None, table))
        elif token == "[" and words:
            many = True
        elif token != "]":
            start = start if words else match.start()
            words.append(token)
    return found


def _path(words: list[str]) -> Path:
    """The parts of a key as written, without quotes."""
    parts: list[str] = []
    for word in words:
        parts += [word[1:-1]] if word[0] in "\"'" else [part for part in word.split(".") if part]
    return tuple(parts)


def line_of(lines: dict[Path, int], key: Path) -> int | None:
    """Line of a key, or of the nearest table around it; None if the file has neither."""
    while key:
        if key in lines:
            return lines[key]
        key = key[:-1]
    return None
