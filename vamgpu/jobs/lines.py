"""Line numbers of keys in a TOML file, which the standard parser does not report."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import Counter

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


def key_lines(text: str) -> dict[Path, int]:
    """Dotted key → its line, counted from 1, for tables and keys of a valid TOML text."""
    starts = [0, *(m.end() for m in re.finditer("\n", text))]
    found: dict[Path, int] = {}
    table: Path = ()
    words: list[str] = []
    depth, value, many = 0, False, False
    tables: Counter[Path] = Counter()
    for match in TOKEN.finditer(text):
        token, line = match[0], bisect_right(starts, match.start())
        if token == "\n":
            if not value and depth == 0 and words and words[0] == "[":
                table = _path(words[1:])
                found.setdefault(table, line)
                if many:
                    tables[table] += 1
                    table = (*table, str(tables[table] - 1))
                    found[table] = line
            if depth == 0:
                words, value, many = [], False, False
        elif token.startswith("#"):
            continue
        elif value:
            depth += (token in "[{") - (token in "]}")
        elif token == "=":
            found.setdefault(table + _path(words), line)
            value = True
        elif token == "[" and words:
            many = True
        elif token != "]":
            words.append(token)
    if words and words[0] == "[" and not value:
        found.setdefault(_path(words[1:]), len(starts))
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
