"""What a run leaves that is killed while it writes, and what the next one makes of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from vamgpu.storage import atomic
from vamgpu.storage.atomic import clear, replacing

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="folders have no locks there, and all stay")


def in_child(act: Callable[[], object]) -> int:
    """Run in a process of its own, which may end at once; returns how it ended."""
    child = os.fork()
    if child == 0:
        try:
            act()
        finally:
            os._exit(0)
    return os.waitpid(child, 0)[1]


def killed(place: Path, words: str = "half") -> None:
    """Write a folder, and be killed before it is whole."""
    with replacing(place, overwrite=True) as draft:
        draft.mkdir()
        (draft / "a").write_text(words)
        os._exit(9)


def write(place: Path, words: str) -> None:
    with replacing(place, overwrite=True) as draft:
        draft.mkdir()
        (draft / "a").write_text(words)


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_next_run_clears_what_a_killed_one_left(tmp_path: Path) -> None:
    for name in ("job.vam", "other.vam", "job.vam"):
        assert in_child(lambda name=name: killed(tmp_path / name))
    assert len(left(tmp_path)) == 2, "the second run of the job has cleared what the first one left"
    write(tmp_path / "job.vam", "whole")
    (kept,) = [name for name in left(tmp_path) if name != "job.vam"]
    assert kept.startswith(".other.vam.partial-"), "what stands beside is another's"
    assert (tmp_path / "job.vam" / "a").read_text() == "whole"


def test_a_run_that_still_writes_is_left_alone(tmp_path: Path) -> None:
    place = tmp_path / "job.vam"
    with replacing(place) as draft:
        draft.mkdir()
        assert in_child(lambda: clear(place)) == 0 and draft.is_dir()
        assert in_child(lambda: write(place, "faster")) == 0 and draft.is_dir()
        clear(place)
        assert draft.is_dir()
        assert (place / "a").read_text() == "faster"
        (draft / "a").write_text("slower")
    assert left(tmp_path) == ["job.vam"] and (place / "a").read_text() == "slower"


@pytest.mark.parametrize("moves", [1, 2])
def test_a_run_killed_between_two_moves_loses_neither(tmp_path: Path, moves: int) -> None:
    """What stood there stepped aside, and its successor was whole."""
    place = tmp_path / "job.vam"
    write(place, "old")

    def stopped() -> None:
        move, done = os.replace, []

        def replace(source: object, target: object) -> None:
            move(source, target)  # type: ignore[arg-type]
            done.append(target)
            if len(done) == moves:
                os._exit(9)

        atomic.os.replace = replace  # type: ignore[assignment]
        write(place, "new")

    assert in_child(stopped) and place.exists() == (moves == 2)
    clear(place)
    assert left(tmp_path) == ["job.vam"] and (place / "a").read_text() == "new"


def test_a_place_that_was_lost_returns(tmp_path: Path) -> None:
    """The successor is gone, what stepped aside is still there."""
    workshop = tmp_path / ".job.vam.partial-x"
    (workshop / "job.vam.replaced").mkdir(parents=True)
    (workshop / "job.vam.replaced" / "a").write_text("old")
    clear(tmp_path / "job.vam")
    assert left(tmp_path) == ["job.vam"] and (tmp_path / "job.vam" / "a").read_text() == "old"


def test_no_place_is_too_odd_to_clear(tmp_path: Path) -> None:
    (tmp_path / ".a.partial-link").symlink_to(tmp_path)
    (tmp_path / ".a.partial-file").write_text("no folder of ours")
    for place in (
        tmp_path / "a",
        tmp_path / "none" / "a",
        tmp_path / "a\0b",
        tmp_path / ("n" * 5000),
        Path(""),
        Path("/"),
    ):
        clear(place)
    assert left(tmp_path) == [".a.partial-file", ".a.partial-link"]
