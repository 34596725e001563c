"""Reading stacks of slices: order, numbers, sizes, depths, and files that are damaged or dangerous."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vamgpu.curethrough.images import encode
from vamgpu.curethrough.mesh_stack import MeshStack
from vamgpu.curethrough.names import following, natural, ordered
from vamgpu.curethrough.stack import ZipStack, layer_height, open_stack
from vamgpu.errors import SliceError, SliceWarning, TargetTooLarge
from vamgpu.targets import shapes
from vamgpu.targets.solid import Solid


def levels(slices: int = 12, rows: int = 9, columns: int = 14) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (slices, rows, columns), dtype=np.uint8)


def folder(path: Path, stack: np.ndarray, ending: str = ".png", first: int = 1) -> Path:
    path.mkdir()
    for k, picture in enumerate(stack):
        (path / f"part_{k + first}{ending}").write_bytes(encode(picture, ending))
    return path


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("ending", [".png", ".tif", ".TIFF"])
def test_folders_are_read_in_natural_order(tmp_path: Path, ending: str) -> None:
    wanted = levels()
    with open_stack(folder(tmp_path / "s", wanted, ending)) as stack:
        assert stack.shape == wanted.shape and stack.names[8:10] == (f"part_9{ending}", f"part_10{ending}")
        np.testing.assert_array_equal(stack[0:12], wanted)
        np.testing.assert_array_equal(stack[5:9], wanted[5:9])
        np.testing.assert_array_equal(stack[0:5], wanted[:5])
        np.testing.assert_array_equal(stack[3:], wanted[3:])
        assert stack[12:40].shape == stack[32:12].shape == (0, 9, 14)


def test_blocks_from_the_last_to_the_first(tmp_path: Path) -> None:
    wanted = levels(75, 3, 4)
    with open_stack(folder(tmp_path / "s", wanted)) as stack:
        for start, stop in ((64, 75), (32, 64), (0, 32)):
            np.testing.assert_array_equal(stack[start:stop], wanted[start:stop])


def test_zips_and_sl1_files(tmp_path: Path) -> None:
    wanted = levels(11)
    layers = {f"job{k:05d}.png": encode(picture, ".png") for k, picture in enumerate(wanted)}
    shuffled = dict(reversed(layers.items()))
    deeper = {f"all/{name}": data for name, data in shuffled.items()} | {"__MACOSX/all/._job00000.png": b"x"}
    extra = {"config.ini": b"layerHeight = 0.05\nnumFast = 11\n", "thumbnail/big.png": layers["job00000.png"]}
    for name, files in (("a.zip", shuffled), ("b.zip", deeper), ("c.sl1", shuffled | extra)):
        with open_stack(zipped(tmp_path / name, files)) as stack:
            np.testing.assert_array_equal(stack[0:11], wanted)
            assert layer_height(stack) == (0.05 if name == "c.sl1" else None)


def test_one_bit_and_gray_in_color_are_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    bits, gray = rng.random((5, 6)) < 0.5, rng.integers(0, 256, (5, 6), dtype=np.uint8)
    (tmp_path / "one").mkdir()
    Image.fromarray(bits).save(tmp_path / "one" / "s1.png")
    (tmp_path / "color").mkdir()
    Image.fromarray(gray).convert("RGB").save(tmp_path / "color" / "s1.png")
    with open_stack(tmp_path / "one") as stack:
        np.testing.assert_array_equal(stack[0:1][0], np.where(bits, 255, 0))
    with open_stack(tmp_path / "color") as stack:
        np.testing.assert_array_equal(stack[0:1][0], gray)
    tinted = np.stack([gray, gray, gray ^ 1], axis=-1)
    Image.fromarray(tinted).save(tmp_path / "color" / "s1.png")
    with open_stack(tmp_path / "color") as stack, pytest.raises(SliceError, match="colored"):
        stack[0:1]


def test_missing_and_misnumbered_slices_are_named(tmp_path: Path) -> None:
    place = folder(tmp_path / "s", levels())
    (place / "part_7.png").rename(tmp_path / "away.png")
    (place / "part_4.png").unlink()
    with pytest.raises(SliceError, match=r"10 slices numbered 1 to 12: missing 4, 7; export"):
        open_stack(place)
    with pytest.raises(SliceError, match=r"number 3 occurs more than once \(a3.png, a03.png\)"):
        ordered(["a3.png", "a03.png", "a4.png"], "x")
    with pytest.raises(SliceError, match=r"'cover.png' is not named like 'a1.png'"):
        ordered(["a1.png", "a2.png", "cover.png"], "x")
    with pytest.raises(SliceError, match="holds no slices"):
        ordered([], "x")
    with pytest.warns(SliceWarning, match="first slice is number 5"):
        assert ordered(["a6.png", "a5.png"], "x") == ("a5.png", "a6.png")
    assert sorted(["b10", "b9", "B1"], key=natural) == ["B1", "b9", "b10"]


def test_names_go_on_counting() -> None:
    names = ("v2_008.png", "v2_009.png")
    assert following(names[-1], 2, names) == ("v2_010.png", "v2_011.png")
    assert following("in/s9.tif", 1, ("in/s8.tif", "in/s9.tif")) == ("in/s10.tif",)


def test_mixed_sizes_and_depths_are_refused(tmp_path: Path) -> None:
    place = folder(tmp_path / "s", levels())
    (place / "part_5.png").write_bytes(encode(levels(1, 9, 15)[0], ".png"))
    with pytest.raises(SliceError, match=r"part_5.png' is 8-bit gray of 15 × 9 pixels, but 'part_1.png' is .* 14 × 9"):
        open_stack(place)
    Image.fromarray(np.zeros((9, 14), bool)).save(place / "part_5.png")
    with pytest.raises(SliceError, match="1-bit gray"):
        open_stack(place)
    for ending in (".png", ".tif"):
        deep = tmp_path / f"deep{ending}"
        deep.mkdir()
        Image.fromarray(np.full((9, 14), 4000, np.uint16)).save(deep / f"a1{ending}")
        with pytest.raises(SliceError, match="16 bits per pixel; expected 8"):
            open_stack(deep)
    mixed = folder(tmp_path / "t", levels(3), ".tif")
    (mixed / "part_2.tif").write_bytes(encode(levels(1, 9, 15)[0], ".tif"))
    with open_stack(mixed) as stack, pytest.raises(SliceError, match="part_2.tif' is 15 × 9 pixels, others are 14 × 9"):
        stack[0:3]


@pytest.mark.parametrize("keep", [20, 60, -30, -5])
def test_a_picture_that_is_cut_off_is_refused(tmp_path: Path, keep: int) -> None:
    place = folder(tmp_path / "s", levels())
    file = place / "part_3.png"
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(SliceError, match=r"part_3.png' is cut off after \d+ bytes"), open_stack(place) as stack:
        stack[0:12]


def test_damaged_pictures_are_refused(tmp_path: Path) -> None:
    place = folder(tmp_path / "s", levels())
    data = bytearray((place / "part_3.png").read_bytes())
    data[60] ^= 1
    (place / "part_3.png").write_bytes(data)
    with open_stack(place) as stack, pytest.raises(SliceError, match="part_3.png' is damaged: its check sum"):
        stack[0:12]
    (place / "part_3.png").write_bytes(b"hello")
    with pytest.raises(SliceError, match=r"part_3.png' cannot be read"):
        open_stack(place)
    tiffs = folder(tmp_path / "t", levels(3), ".tif")
    data = (tiffs / "part_2.tif").read_bytes()
    (tiffs / "part_2.tif").write_bytes(data[: len(data) // 2])
    with open_stack(tiffs) as stack, pytest.raises(SliceError, match="part_2.tif' cannot be read"):
        stack[0:3]


def test_a_picture_of_monstrous_size_is_refused(tmp_path: Path) -> None:
    place = folder(tmp_path / "s", levels(1))
    data = bytearray((place / "part_1.png").read_bytes())
    data[16:24] = struct.pack(">II", 200_000, 200_000)
    (place / "part_1.png").write_bytes(data)
    with pytest.raises(SliceError, match="200000 × 200000 pixels"):
        open_stack(place)


@pytest.mark.parametrize("name", ["../a1.png", "x/../../a1.png", "/etc/a1.png", "C:/a1.png", "..\\a1.png"])
def test_zips_that_climb_out_are_refused(tmp_path: Path, name: str) -> None:
    picture = encode(levels(1)[0], ".png")
    path = zipped(tmp_path / "evil.zip", {"a0.png": picture, name: picture})
    with pytest.raises(SliceError, match="would be unpacked outside its folder"):
        open_stack(path)


def test_zips_with_links_and_cut_off_zips_are_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("a1.png")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as archive:
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(SliceError, match="is a link"):
        ZipStack(tmp_path / "link.zip")
    files = {f"a{k}.png": encode(picture, ".png") for k, picture in enumerate(levels())}
    whole = zipped(tmp_path / "whole.zip", files).read_bytes()
    (tmp_path / "half.zip").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SliceError, match="cut off or no zip"):
        open_stack(tmp_path / "half.zip")
    at = whole.index(files["a5.png"]) + 70
    (tmp_path / "bad.zip").write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(SliceError, match="a5.png': .*damaged"), open_stack(tmp_path / "bad.zip") as stack:
        stack[0:12]


def test_pictures_in_several_folders_of_a_zip_are_refused(tmp_path: Path) -> None:
    picture = encode(levels(1)[0], ".png")
    with pytest.raises(SliceError, match="pictures in 2 folders"):
        open_stack(zipped(tmp_path / "two.zip", {"a/1.png": picture, "b/2.png": picture}))
    with pytest.raises(SliceError, match="there is nothing at"):
        open_stack(tmp_path / "nowhere")
    (tmp_path / "text.txt").write_text("no zip")
    with pytest.raises(SliceError, match="neither a folder nor a file"):
        open_stack(tmp_path / "text.txt")


@pytest.mark.parametrize("ending", [".png", ".tif"])
def test_what_is_encoded_reads_back_elsewhere(ending: str) -> None:
    for picture in levels(3, 31, 17):
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(encode(picture, ending)))), picture)


def wedge() -> Solid:
    """A prism, 3 × 2 × 2 mm, whose top falls towards +x."""
    corners = [(0, 0, 0), (3, 0, 0), (3, 2, 0), (0, 2, 0), (0, 0, 2), (0, 2, 2)]
    faces = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (3, 5, 2), (0, 4, 5), (0, 5, 3), (1, 2, 5), (1, 5, 4)]
    return Solid(np.array(corners, float), np.array(faces, np.int32), "wedge")


def test_a_mesh_is_sliced_alike_in_blocks_and_whole(processor: str) -> None:
    stack = MeshStack(wedge(), 0.1, 0.05, device=processor)
    assert stack.shape == (40, 24, 34)
    whole = stack[0:40]
    np.testing.assert_array_equal(np.concatenate([stack[0:13], stack[13:32], stack[32:40]]), whole)
    assert stack[40:64].shape == stack[64:40].shape == (0, 24, 34), "nothing lies beyond the last slice"
    volume = whole.sum(dtype=np.float64) / 255 * 0.1**2 * 0.05
    assert volume == pytest.approx(6.0, rel=2e-3)
    assert whole[0, 5, 20] == whole[30, 5, 4] == 255 and whole[30, 5, 20] == 0, "the first slice is the lowest"


def test_rows_run_down_and_a_mesh_beyond_the_pixels_is_refused() -> None:
    solid = shapes.build("boat").placed(height=3.0)
    stack = MeshStack(solid, 0.2, 0.2, (60, 40), "numpy")
    assert stack.shape[1:] == (40, 60)
    moved = Solid(solid.vertices + (0.0, 1.0, 0.0), solid.faces, "moved")
    rows = [part[0:2].sum(axis=(0, 2)) @ np.arange(40) / part[0:2].sum()
            for part in (stack, MeshStack(moved, 0.2, 0.2, (60, 40), "numpy"))]  # fmt: skip
    assert rows[1] - rows[0] == pytest.approx(-5.0, abs=1e-9)
    with pytest.raises(TargetTooLarge, match=r"move it, or use more or larger pixels"):
        MeshStack(solid, 0.2, 0.2, (6, 40), "numpy")
