"""Slices as slicers of resin printers pack them: .goo files, and zips and SL1 files with previews."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vamgpu.curethrough.output import writing
from vamgpu.curethrough.stack import layer_height, open_stack
from vamgpu.errors import SliceError, StorageError


def goo(*layers: bytes, rows: int = 10, columns: int = 30) -> bytes:
    head = bytearray(195_477)
    head[:12] = b"V3.0\x07\0\0\0DLP\0"
    struct.pack_into(">IHH", head, 195_310, len(layers), columns, rows)
    struct.pack_into(">f", head, 195_332, 0.05)
    made = bytes(head)
    for number, packed in enumerate(layers):
        definition = struct.pack(">H15fH", 0, 100.0, 0.05 * (number + 1), 2.5 + number, *[0.0] * 12, 255)
        body = b"\x55" + packed + bytes([~sum(packed) & 0xFF])
        made += definition + b"\r\n" + struct.pack(">I", len(body)) + body + b"\r\n"
    return made + b"\0\0\0\x07\0\0\0DLP\0"


BLACK = bytes([0x1C, 300 >> 4])  # 12 + 18 · 16
MIXED = bytes([0x05, 0x41, 100, 0x93, 4, 0xA1, 0x1C, 3, 0xD0, 14, 0x45, 7])
"""5 black, 1 of 100, 4 of 103 (a step up), 1 of 102 (a step down), 60 black, 224 white, 5 of 7."""
LEVELS = np.repeat(np.array([0, 100, 103, 102, 0, 255, 7], np.uint8), [5, 1, 4, 1, 60, 224, 5]).reshape(10, 30)


def test_goo_slices_are_read_and_written_with_their_settings(tmp_path: Path) -> None:
    (tmp_path / "a.goo").write_bytes(goo(BLACK, MIXED))
    with open_stack(tmp_path / "a.goo") as stack:
        assert stack.shape == (2, 10, 30) and layer_height(stack) == pytest.approx(0.05)
        levels = stack[0:2]
        assert not levels[0].any() and np.array_equal(levels[1], LEVELS)
        new = np.concatenate([levels[::-1], np.random.default_rng(0).integers(0, 256, (1, 10, 30), np.uint8)])
        names = tuple(f"{k}.png" for k in range(3))
        with writing(tmp_path / "b.goo", names, source=stack) as writer:
            writer.write(0, new)
    data = (tmp_path / "b.goo").read_bytes()
    assert data[:195_310] == goo(BLACK)[:195_310] and data.endswith(b"\0\0\0\x07\0\0\0DLP\0")
    with open_stack(tmp_path / "b.goo") as stack:
        assert stack.shape == (3, 10, 30) and np.array_equal(stack[0:3], new)
        said = [struct.unpack_from(">fff", definition, 2) for definition, _, _ in stack.file.layers]  # type: ignore
    assert said == [pytest.approx((100, 0.05, 2.5)), pytest.approx((100, 0.1, 3.5)), pytest.approx((100, 0.15, 3.5))]


def test_blocks_that_are_written_last_first_keep_their_order(tmp_path: Path) -> None:
    (tmp_path / "a.goo").write_bytes(goo(*[BLACK] * 40))
    new = np.arange(40, dtype=np.uint8)[:, None, None] + np.zeros((40, 10, 30), np.uint8)
    names = tuple(f"{k}.png" for k in range(40))
    with open_stack(tmp_path / "a.goo") as stack, writing(tmp_path / "b.goo", names, source=stack) as writer:
        writer.write(32, new[32:])  # a correction runs from the last block to the first
        writer.write(0, new[:32])
    with open_stack(tmp_path / "b.goo") as stack:
        assert np.array_equal(stack[0:40], new)


def test_long_runs_are_packed_in_few_bytes(tmp_path: Path) -> None:
    (tmp_path / "a.goo").write_bytes(goo(bytes([0x20, 0x4E, 0x20]), rows=400, columns=800))
    with open_stack(tmp_path / "a.goo") as stack, writing(tmp_path / "b.goo", ("1.png",), source=stack) as writer:
        writer.write(0, np.full((1, 400, 800), 255, np.uint8))
    with open_stack(tmp_path / "b.goo") as stack:
        assert (stack[0:1] == 255).all()
    assert len((tmp_path / "b.goo").read_bytes()) < 195_477 + 100


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (goo(MIXED)[:-30], "ends or is damaged at layer 0 of 1"),
        (goo(MIXED[:-2]), "layer 0 has 295 pixels; expected 300"),
        (goo(MIXED[:-1]), "layer 0 has 0 pixels; expected 300"),
        (goo(MIXED).replace(MIXED, MIXED[:-1] + b"\x08"), "check sum of layer 0 is wrong"),
        (goo(), "has 0 layers"),
        (b"CTB" + bytes(300_000), "is not a .goo file of version 3"),
    ],
)
def test_damaged_goo_files_are_refused_with_the_cause(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.goo").write_bytes(data)
    with pytest.raises(SliceError, match=said), open_stack(tmp_path / "a.goo") as stack:
        _ = stack[0:1]


def test_goo_needs_the_settings_of_a_goo(tmp_path: Path) -> None:
    with (
        pytest.raises(StorageError, match=r"would lack the printer settings of a \.goo file"),
        writing(tmp_path / "a.goo", ("1.png",)),
    ):
        pass
    (tmp_path / "a.pwmx").write_bytes(bytes(100))
    with pytest.raises(SliceError, match="export pictures from the slicer"):
        open_stack(tmp_path / "a.pwmx")


@pytest.mark.parametrize(
    ("beside", "height"),
    [
        ({"preview.png": "RGB", "preview_cropping.png": "RGB", "run.gcode": ";fileName:a\n;layerHeight:0.05\n"}, 0.05),
        ({"preview.png": "RGB", "3d.png": "RGB", "plate.json": "{}"}, None),
        ({"thumbnail/thumbnail400x400.png": "RGB"}, None),
        ({"config.ini": "layerHeight = 0.025\n", "thumbnail/thumbnail800x480.png": "RGB"}, 0.025),
    ],
)
def test_previews_are_no_slices(beside: dict[str, str], height: float | None, tmp_path: Path) -> None:
    def picture(mode: str, level: int) -> bytes:
        made = io.BytesIO()
        Image.new(mode, (290, 290) if mode == "RGB" else (12, 10), level).save(made, "PNG")
        return made.getvalue()

    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, said in beside.items():
            archive.writestr(name, picture("RGB", 9) if said == "RGB" else said)
        for number in (1, 2, 3):
            archive.writestr(f"{number}.png", picture("L", number))
    with open_stack(tmp_path / "a.zip") as stack:
        assert stack.names == ("1.png", "2.png", "3.png") and layer_height(stack) == height
        assert stack[0:3].reshape(3, -1).max(axis=1).tolist() == [1, 2, 3]
