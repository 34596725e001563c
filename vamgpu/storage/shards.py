"""Files of many chunks, as Zarr's sharding codec lays them out, written and read by as many threads as there are cores.

Chunks, each compressed by Zstandard with a checksum, then the start and length of each, then the CRC-32C of these.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from vamgpu.backend.cores import threads
from vamgpu.storage.reading import is_file, open_file

LEVEL = -1
"""Level of Zstandard. Below 1, literals are not entropy-coded: grainy frames take 7 % more space than at level 3, but
are packed six times and unpacked three times as fast, and disks are faster than that."""
ZSTANDARD = b"\x28\xb5\x2f\xfd"
HEAD = 18  # bytes of a Zstandard frame that always contain its header
ABSENT = np.uint64(2**64 - 1)  # the index value of a missing entry


def write_files(
    place: Callable[[int], Path], count: int, each: int, part: Callable[[int, int], np.ndarray],
    seen: Callable[[np.ndarray], object],
) -> None:  # fmt: skip
    """Write entries to files, and flush each file to the disk."""
    # While a file is compressed, the previous one is written and the next one's entries are fetched; memory therefore
    # holds the entries of two files.
    from numcodecs.zstd import Zstd

    codec = Zstd(LEVEL, checksum=True)
    with ThreadPoolExecutor(threads() + 1) as pool:
        written: Future[None] | None = None
        entries = part(0, min(each, count))
        for number in range(-(-count // each)):
            packed = [pool.submit(codec.encode, entry) for entry in entries.reshape(len(entries), -1).view(np.uint8)]
            seen(entries)
            first = (number + 1) * each
            following = part(first, min(first + each, count)) if first < count else entries[:0]
            chunks = [one.result() for one in packed]
            if written is not None:
                written.result()
            written, entries = pool.submit(_save, place(number), chunks, each), following
        if written is not None:
            written.result()


def _save(path: Path, chunks: list[bytes], each: int) -> None:
    from google_crc32c import value

    index = np.full((each, 2), ABSENT, "<u8")
    lengths = np.array([len(chunk) for chunk in chunks], np.uint64)
    index[: len(chunks), 0], index[: len(chunks), 1] = np.cumsum(lengths) - lengths, lengths
    tail = index.tobytes()
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb", buffering=0) as file:
        for piece in (*chunks, tail, value(tail).to_bytes(4, "little")):
            view = memoryview(piece)
            while view:
                view = view[file.write(view) :]
        os.fsync(file.fileno())


def decode(path: Path, each: int, entries: range, out: np.ndarray, *, whole: bool) -> None:
    """Unpack some entries of a file into an array."""
    # Sizes and positions in the file are checked against each other and against the array before anything is unpacked,
    # because malicious files state wrong ones.
    from google_crc32c import value
    from numcodecs.zstd import decompress

    if not is_file(path):  # Zarr would read zeros
        raise FileNotFoundError(f"{path.name} is missing, or no file")
    with open_file(path) as file:
        begin = file.seek(0, os.SEEK_END) - 16 * each - 4
        if begin < 0:
            raise ValueError(f"a file has {begin + 16 * each + 4} bytes, too few for {each} entries")
        file.seek(begin)
        tail = file.read(16 * each + 4)
        if value(tail[:-4]).to_bytes(4, "little") != tail[-4:]:
            raise ValueError("the index of a file does not match its checksum")
        index = np.frombuffer(tail[:-4], "<u8").reshape(-1, 2)[entries.start : entries.stop]
        there = (index != ABSENT).any(axis=1)
        if whole and not there.all():
            raise ValueError(f"a file lacks {np.count_nonzero(~there)} of {len(there)} entries")
        places = index[there]
        if len(places) and (int(places.max()) > begin or int(places.sum(axis=1).max()) > begin):
            raise ValueError("a file has entries beyond its end")
        first = int(places[:, 0].min()) if len(places) else 0
        file.seek(first)
        data = memoryview(file.read(int(places.sum(axis=1).max()) - first if len(places) else 0))
    rows = out.reshape(len(entries), -1).view(np.uint8)
    rows[~there] = 0
    for (offset, length), number in zip(places.tolist(), np.flatnonzero(there), strict=True):
        chunk, row = data[offset - first : offset - first + length], rows[number]
        if (found := unpacked(bytes(chunk[:HEAD]))) != row.size:
            raise ValueError(f"an entry of a file unpacks to {found} bytes; expected {row.size}")
        decompress(chunk, row)


def unpacked(head: bytes) -> int | None:
    """Unpacked size that a Zstandard frame states (RFC 8878, 3.1.1.1); None if it states none."""
    if len(head) < 6 or head[:4] != ZSTANDARD:
        return None
    single, length = head[4] >> 5 & 1, (0, 2, 4, 8)[head[4] >> 6]
    length = length or single
    start = 6 - single + (0, 1, 2, 4)[head[4] & 3]
    return int.from_bytes(head[start : start + length], "little") + (256 if length == 2 else 0) if length else None
