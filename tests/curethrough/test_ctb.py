"""Slices in .ctb files, against a file written here from the layout alone, with its key applied word by word."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from vamgpu.curethrough.output import writing
from vamgpu.curethrough.stack import PackedStack, layer_height, open_stack
from vamgpu.errors import SliceError, StorageError

KEY = 0x1234ABCD
ROWS, COLUMNS = 10, 30
MIXED = bytes([0x80 | 50, 5, 127, 0x80, 60, 0x80 | 127, 0x80, 224, 3, 0x80 | 64, 9])
"""Levels of 7 bits: 5 of 50, 1 of 127, 60 of 0, 224 of 127 in two bytes, 1 of 3, 9 of 64."""
LEVELS = np.repeat(np.array([101, 255, 0, 255, 7, 129], np.uint8), [5, 1, 60, 224, 1, 9]).reshape(ROWS, COLUMNS)
BLACK = bytes([0x80, 0x81, 300 - 256])


def keyed(data: bytes, number: int, key: int) -> bytes:
    """Each byte against one of a word, of which the next four bytes get the next."""
    if not key:
        return data
    step = (key * 0x2D83CDAC + 0xD8A83423) & 0xFFFFFFFF
    word, out = (number * 0x1E1530CD + 0xEC3D47CD) * step & 0xFFFFFFFF, bytearray()
    for k, byte in enumerate(data):
        if k and k % 4 == 0:
            word = word + step & 0xFFFFFFFF
        out.append(byte ^ (word >> 8 * (k % 4)) & 0xFF)
    return bytes(out)


def ctb(*layers: bytes, version: int = 4, key: int = KEY, magic: int = 0x12FD0106) -> bytes:
    """Header, settings of the slicer and of version 4, table, and layers with their settings before them."""
    beside = 84 if version >= 3 else 0
    slicer, fourth = 112, 112 + 76
    table = fourth + 80 if version >= 4 else 112 + 76
    head = bytearray(table)
    struct.pack_into("<II", head, 0, magic, version)
    struct.pack_into("<ffff", head, 28, 0.05 * len(layers), 0.05, 2.5, 30.0)
    struct.pack_into("<II", head, 52, COLUMNS, ROWS)
    struct.pack_into("<II", head, 64, table, len(layers))
    struct.pack_into("<III", head, 100, key, slicer, 76)
    if version >= 4:
        struct.pack_into("<I", head, slicer + 64, fourth)
        struct.pack_into("<I", head, fourth + 52, max(0, len(layers) - 1))
    rows, body, at = b"", b"", table + 36 * len(layers)
    for number, packed in enumerate(layers):
        row = struct.pack(
            "<3f6I", 0.05 * (number + 1), 2.5 + number, 1.0, at + beside, len(packed), 0, 36 + beside, 0, 0
        )
        rows += row
        total = struct.pack("<I", beside + len(packed))
        body += (row + total + bytes([number + 1]) * 44 if beside else b"") + keyed(packed, number, key)
        at += beside + len(packed)
    return bytes(head) + rows + body


@pytest.mark.parametrize(("version", "key"), [(2, KEY), (3, 0), (4, KEY), (5, 7)])
def test_slices_are_read(version: int, key: int, tmp_path: Path) -> None:
    (tmp_path / "a.ctb").write_bytes(ctb(BLACK, MIXED, version=version, key=key))
    with open_stack(tmp_path / "a.ctb") as stack:
        assert stack.shape == (2, ROWS, COLUMNS) and layer_height(stack) == pytest.approx(0.05)
        levels = stack[0:2]
        assert not levels[0].any() and np.array_equal(levels[1], LEVELS)


@pytest.mark.parametrize("version", [2, 4])
def test_slices_are_written_with_the_settings_of_their_file(version: int, tmp_path: Path) -> None:
    """In blocks, the last first, as a correction writes them; two more than there were."""
    (tmp_path / "a.ctb").write_bytes(ctb(MIXED, BLACK, version=version))
    new = np.random.default_rng(0).integers(0, 2, (4, ROWS, COLUMNS), np.uint8) * np.uint8(255)
    new[1] = LEVELS
    with open_stack(tmp_path / "a.ctb") as stack, writing(tmp_path / "b.ctb", tuple("abcd"), source=stack) as writer:
        writer.write(2, new[2:])
        writer.write(0, new[:2])
    with open_stack(tmp_path / "b.ctb") as stack:
        assert stack.shape == (4, ROWS, COLUMNS) and np.array_equal(stack[0:4], new)
    data = (tmp_path / "b.ctb").read_bytes()
    table = struct.unpack_from("<I", data, 64)[0]
    rows = [struct.unpack_from("<3f6I", data, table + 36 * k) for k in range(4)]
    assert [row[:3] for row in rows] == [
        pytest.approx((0.05 * (k + 1), (2.5, 3.5, 3.5, 3.5)[k], 1.0)) for k in range(4)
    ]
    assert struct.unpack_from("<f", data, 28)[0] == pytest.approx(0.2)
    if version == 4:
        assert struct.unpack_from("<I", data, 112 + 76 + 52)[0] == 3
        assert [data[row[3] - 1] for row in rows] == [1, 2, 2, 2]  # settings before the pixels
        assert data[rows[2][3] - 84 :][:36] == data[table + 72 :][:36]
        totals = [struct.unpack_from("<I", data, row[3] - 48)[0] for row in rows]
        assert totals == [84 + row[4] for row in rows] and len(set(totals)) > 1


def test_a_level_keeps_seven_of_eight_bits(tmp_path: Path) -> None:
    (tmp_path / "a.ctb").write_bytes(ctb(MIXED))
    ramp = np.resize(np.arange(256), (1, ROWS, COLUMNS)).astype(np.uint8)
    with open_stack(tmp_path / "a.ctb") as stack, writing(tmp_path / "b.ctb", ("1",), source=stack) as writer:
        writer.write(0, ramp)
    with open_stack(tmp_path / "b.ctb") as stack:
        found = stack[0:1].astype(int)
    assert np.abs(found - ramp).max() == 1 and found.ravel()[[0, 255]].tolist() == [0, 255]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (ctb(MIXED)[:-4], "ends or is damaged at layer 0 of 1"),
        (ctb(MIXED)[:300], "ends within its table of 1 layers|ends or is damaged"),
        (ctb(MIXED)[:200], "ends within its table of 1 layers"),
        (ctb(MIXED[:-2]), "layer 0 has 291 pixels; expected 300"),
        (ctb(MIXED[:-1]), "layer 0 has 0 pixels; expected 300"),
        (ctb(MIXED[:-2] + b"\xff\xf8"), "layer 0 has 0 pixels"),
        (ctb(), "has 0 layers"),
        (ctb(MIXED, magic=0x12FD0107), "is an encrypted .ctb file.*expected a plain one.*as .goo or as pictures"),
        (ctb(MIXED, magic=0x12FD0019), "older kind .cbddlp or .photon; expected a .ctb file"),
        (bytes(300), "is not a .ctb file"),
    ],
)
def test_files_that_cannot_be_read_are_refused_with_the_cause(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.ctb").write_bytes(data)
    with pytest.raises(SliceError, match=said), open_stack(tmp_path / "a.ctb") as stack:
        _ = stack[0:1]


def test_settings_of_another_format_are_not_invented(tmp_path: Path) -> None:
    (tmp_path / "a.ctb").write_bytes(ctb(MIXED))
    with (
        open_stack(tmp_path / "a.ctb") as stack,
        pytest.raises(StorageError, match=r"would lack the printer settings of a \.goo file"),
        writing(tmp_path / "b.goo", ("1",), source=stack),
    ):
        assert isinstance(stack, PackedStack)
    late = bytearray(ctb(MIXED))
    struct.pack_into("<I", late, 84, len(late) - 4)
    (tmp_path / "late.ctb").write_bytes(bytes(late))
    with (
        open_stack(tmp_path / "late.ctb") as stack,
        pytest.raises(SliceError, match="has settings behind its layers"),
        writing(tmp_path / "c.ctb", ("1",), source=stack) as writer,
    ):
        writer.write(0, LEVELS[None])
    assert not (tmp_path / "c.ctb").exists()
