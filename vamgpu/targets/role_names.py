"""Roles of bodies in the names of objects, as forks of VAMToolbox write them: ``insert_rod``, ``[zero-dose] pore``."""

from __future__ import annotations

import re
from collections.abc import Iterable

WORDS = {
    "print": "print", "part": "print", "model": "print", "shell": "print", "lattice": "print", "insert": "insert",
    "occlusion": "insert", "zero dose": "keep out", "zerodose": "keep out", "no dose": "keep out",
    "nodose": "keep out", "keep out": "keep out", "keepout": "keep out", "don't care": "don't care",
    "dont care": "don't care", "dontcare": "don't care",
}  # fmt: skip
"""How a name begins → role."""
UNNAMED = {"part", "model", "stl", "obj", "step", "mf"}
"""Words of the names that programs give by themselves, such as "Part 1.stl": any other role comes before theirs."""
_WORD = re.compile(r"[a-z']+")
_LIKE = re.compile(r"\b(insert|occlu|gr[ae]y|support|zero ?dose|no ?dose|keep ?out|don'?t ?care)")


def role_in(names: Iterable[str]) -> str | None:
    """The role with which the first of some names begins that has one, in any case and with any signs between words."""
    last = None
    for name in names:
        words = _words(name)
        role = WORDS.get(" ".join(words[:2])) or WORDS.get("".join(words[:1]))
        if role is not None and not UNNAMED.issuperset(words):
            return role
        last = last or role
    return last


def resembles_role(names: Iterable[str]) -> bool:
    """Whether a name has a word of a role anywhere, or in another form: ``rod insert``, ``inserts``, ``gray half``."""
    return any(_LIKE.search(" ".join(_words(name))) for name in names)


def _words(name: str) -> list[str]:
    return _WORD.findall(name.lower().replace("\u2019", "'"))
