"""Names of slices: their natural order, and gaps in their numbers."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

from vamgpu.errors import SliceError, SliceWarning

DIGITS = re.compile(r"(\d+)")
ENDINGS = (".png", ".tif", ".tiff")
SHOWN = 5


def natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """A sort key that puts 9 before 10."""
    return tuple((0, int(part)) if part.isdecimal() else (1, part.casefold()) for part in DIGITS.split(name) if part)


def is_slice(name: str) -> bool:
    """Whether a file is a picture; hidden files and files added by archivers are not."""
    path = PurePosixPath(name)
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in path.parts)
    return path.suffix.lower() in ENDINGS and not hidden


def ordered(names: Iterable[str], place: str) -> tuple[str, ...]:
    """Names of slices in natural order; the first number that varies must count them. Raises `SliceError`."""
    found = tuple(sorted(names, key=natural))
    if not found:
        raise SliceError(f"{place} holds no slices; expected pictures ending in {', '.join(ENDINGS)}")
    if len(found) == 1:
        return found
    numbers = _counted(found, place)
    low, high = min(numbers), max(numbers)
    twice = sorted(n for n, count in Counter(numbers).items() if count > 1)
    if twice:
        alike = ", ".join([name for name, n in zip(found, numbers, strict=True) if n == twice[0]][:3])
        raise SliceError(f"{place}: number {twice[0]} occurs more than once ({alike}); keep one of them")
    if high - low + 1 != len(numbers):
        there = set(numbers)
        missing = [n for n in range(low, high + 1) if n not in there] if high - low < 1 << 20 else [low + 1]
        more = f" and {len(missing) - SHOWN} more" if len(missing) > SHOWN else ""
        raise SliceError(
            f"{place} has {len(numbers)} slices numbered {low} to {high}: missing "
            f"{', '.join(map(str, missing[:SHOWN]))}{more}; export the slices again, or number them one by one"
        )
    if low > 1:
        warnings.warn(
            f"{place}: the first slice is number {low}; it is taken as the one at the platform. If slices before it "
            "are missing, export them again",
            SliceWarning,
            stacklevel=3,
        )
    return found


def _counted(names: Sequence[str], place: str) -> list[int]:
    """The first number that varies, name by name."""
    parts = [DIGITS.split(PurePosixPath(name).stem) for name in names]
    texts = [tuple(part[::2]) for part in parts]
    usual = Counter(texts).most_common(1)[0][0]
    for name, text in zip(names, texts, strict=True):
        if text != usual:
            example = names[texts.index(usual)]
            raise SliceError(f"{place}: {name!r} is not named like {example!r}; rename it, or move it elsewhere")
    for k in range(1, len(parts[0]), 2):
        numbers = [int(part[k]) for part in parts]
        if len(set(numbers)) > 1:
            return numbers
    same = ", ".join(names[:2])
    raise SliceError(f"{place}: names such as {same} have the same number; expected a different number in each")


def following(name: str, count: int, taken: Sequence[str]) -> tuple[str, ...]:
    """Names for ``count`` slices after ``name``, with continued numbers of as many digits. Raises `SliceError`."""
    path = PurePosixPath(name)
    parts = DIGITS.split(path.stem)
    first = DIGITS.split(PurePosixPath(taken[0]).stem)
    places = range(1, len(parts), 2)
    if not places and count:
        raise SliceError(f"{name!r} has no number from which to count {count} more slices; give it one")
    at = next((k for k in places if parts[k] != first[k]), places[-1] if places else 0)
    made = []
    for k in range(1, count + 1):
        counted = str(int(parts[at]) + k).zfill(len(parts[at]))
        made.append(str(path.with_name("".join([*parts[:at], counted, *parts[at + 1 :]]) + path.suffix)))
    return tuple(made)
