"""Arrays that are read in pieces by several threads: the values, their order and their hash."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from vamgpu.backend import cores
from vamgpu.errors import StorageError
from vamgpu.storage import arrays
from vamgpu.storage.folder import Entry, Folder, digest, write_folder


@pytest.fixture(autouse=True)
def many_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "PIECE", 100)
    monkeypatch.setattr(arrays, "SHARD_CHUNKS", 13)
    monkeypatch.setattr(cores, "threads", lambda: 3)


def folder(place: Path, values: np.ndarray) -> Folder:
    entry = Entry(values, ("k", "i"))
    return write_folder(place / "job.vam", {"values": entry}, inputs={}, details={}, device="numpy")


@pytest.mark.parametrize("count", [1, 13, 14, 60])
def test_pieces_come_in_order_across_files(count: int, tmp_path: Path) -> None:
    values = np.arange(count * 24, dtype=np.uint16).reshape(count, 24)
    made = folder(tmp_path, values)
    parts = list(made.parts("values"))
    assert max(map(len, parts)) <= 2  # of 48 bytes an entry
    assert np.array_equal(np.concatenate(parts), values)
    assert np.array_equal(made.array("values"), values)
    assert made.record("values").sha256 == digest(values)
    layout = arrays.Layout.of(made.path / "values")
    for span in (range(0, count), range(count // 3, count), range(count // 2, count // 2)):
        assert np.array_equal(layout.entries(span), values[span.start : span.stop])


def test_pieces_of_a_file_that_was_exchanged_are_told(tmp_path: Path) -> None:
    made = folder(tmp_path, np.arange(60 * 24, dtype=np.uint16).reshape(60, 24))
    files = [made.path / "values" / "c" / str(k) / "0" for k in (0, 1)]
    first, second = (file.read_bytes() for file in files)
    files[0].write_bytes(second)
    files[1].write_bytes(first)
    with pytest.raises(StorageError, match="has SHA-256"):
        made.verify()
    with pytest.raises(StorageError, match="has SHA-256"):
        made.array("values")
    files[1].unlink()
    with pytest.raises(StorageError, match="4 of 5 files"):
        made.verify()


def test_results_keep_the_order_of_their_items_and_few_are_ahead() -> None:
    begun: list[int] = []

    def work(k: int) -> int:
        time.sleep(0.002 * (k % 3))
        return k * k

    def items():  # type: ignore[no-untyped-def]
        for k in range(20):
            begun.append(k)
            yield k

    for k, found in enumerate(cores.ahead(work, items())):
        assert found == k * k
        assert len(begun) <= k + 5  # those that threads work on, and the next


def test_an_error_in_a_thread_is_raised_where_results_are_taken() -> None:
    with pytest.raises(ZeroDivisionError):
        list(cores.ahead(lambda k: 1 // k, [2, 1, 0, 3]))
