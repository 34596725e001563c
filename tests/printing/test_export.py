"""Frames in job folders and in exported files: every bit comes back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from full_disk import files_of_at_most
from small_print import some_frames

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.printing.export import Canvas, export
from vamgpu.printing.folder import load_frames, save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.folder import Entry


@pytest.mark.parametrize("bits", [8, 1])
def test_frames_come_back_with_their_light(device: Device, tmp_path: Path, bits: int) -> None:
    frames = some_frames(device, bits)
    beside = {"target": Entry(np.ones((2, 2)), ("x", "y"))}
    save_frames(tmp_path / "a.vam", frames, inputs={"height": 12.0}, arrays=beside)
    back = load_frames(tmp_path / "a.vam", device)
    assert (back.bits, back.columns, back.scale) == (frames.bits, frames.columns, frames.scale)
    assert back.gray == frames.gray and back.settings == frames.settings
    assert np.array_equal(back.images.numpy(), frames.images.numpy())
    assert np.array_equal(back.irradiance().numpy(), frames.irradiance().numpy())


def test_one_flipped_bit_of_a_job_is_refused(tmp_path: Path) -> None:
    frames = some_frames("numpy", bits=1)
    save_frames(tmp_path / "a.vam", frames)
    import zarr

    array = zarr.open_array(tmp_path / "a.vam" / "frames", mode="r+")
    array[3, 4, 1] = int(array[3, 4, 1]) ^ 0b00010000  # type: ignore[arg-type]
    with pytest.raises(StorageError, match="SHA-256"):
        load_frames(tmp_path / "a.vam", "numpy")


def test_garbled_descriptions_are_refused(tmp_path: Path) -> None:
    save_frames(tmp_path / "a.vam", some_frames("numpy"))
    file = tmp_path / "a.vam" / "manifest.json"
    text = file.read_text(encoding="utf-8")
    for old, new in (('"dither": "round"', '"dither": "?"'), ('"bits": 8', '"bits": 3'), ('"gray"', '"grey"')):
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(StorageError, match="manifest"):
            load_frames(tmp_path / "a.vam", "numpy")


def test_names_of_the_frames_own_are_taken(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="choose other names"):
        save_frames(tmp_path / "a.vam", some_frames("numpy"), arrays={"frames": Entry(np.ones(3), ("x",))})


@pytest.mark.parametrize("bits", [8, 1])
def test_png_stack(tmp_path: Path, bits: int) -> None:
    from PIL import Image

    frames = some_frames("numpy", bits)
    folder = export(frames, tmp_path / "png")
    files = sorted(folder.glob("*.png"))
    assert [file.name for file in files[:2]] == ["frame_0000.png", "frame_0001.png"] and len(files) == 12
    opened = [Image.open(file) for file in files]
    assert {image.mode for image in opened} == {"L" if bits == 8 else "1"}
    assert np.array_equal(np.stack([np.asarray(image.convert("L")) for image in opened]), frames.gray_levels())
    assert json.loads((folder / "frames.json").read_text(encoding="utf-8"))["scale"] == frames.scale


@pytest.mark.parametrize("bits", [8, 1])
def test_tiff_pages(tmp_path: Path, bits: int) -> None:
    import tifffile

    frames = some_frames("numpy", bits)
    with tifffile.TiffFile(export(frames, tmp_path / "a.tiff")) as file:
        assert len(file.pages) == 12
        assert np.array_equal(file.asarray(), frames.gray_levels())
        assert json.loads(file.pages[0].tags["ImageDescription"].value)["bits"] == bits  # type: ignore[union-attr]


@pytest.mark.parametrize("bits", [8, 1])
def test_npz_needs_no_pickle(tmp_path: Path, bits: int) -> None:
    frames = some_frames("numpy", bits)
    with np.load(export(frames, tmp_path / "a.npz"), allow_pickle=False) as data:
        assert np.array_equal(data["images"], frames.images.numpy())
        assert np.array_equal(data["curve"], frames.gray.table(bits))
        assert data["scale"] == frames.scale and data["flat_field"].shape == (21, 13)
        assert json.loads(str(data["description"]))["settings"]["shift"] == [0.5, -1.25]


@pytest.mark.parametrize("bits", [8, 1])
def test_films_keep_every_bit(tmp_path: Path, bits: int) -> None:
    import av

    frames = some_frames("numpy", bits)
    with av.open(str(export(frames, tmp_path / "a.mp4", fps=24))) as film:
        assert film.streams.video[0].average_rate == 24
        decoded = [frame.to_ndarray(format="gray") for frame in film.decode(video=0)]
    assert np.array_equal(np.stack(decoded), frames.gray_levels())


def test_exports_are_refused_with_a_reason(tmp_path: Path) -> None:
    frames = some_frames("numpy")
    with pytest.raises(BadInput, match="PNG folder"):
        export(frames, tmp_path / "a.gif")
    with pytest.raises(BadInput, match="frames per second"):
        export(frames, tmp_path / "a.mp4", fps=0)
    export(frames, tmp_path / "a.npz")
    with pytest.raises(StorageError, match="exists"):
        export(frames, tmp_path / "a.npz")
    export(frames, tmp_path / "a.npz", overwrite=True)
    export(frames, tmp_path / "png")
    with pytest.raises(StorageError, match="is a folder"):
        export(frames, tmp_path / "png", overwrite=True)
    export(frames, tmp_path / "B.NPZ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["B.NPZ", "a.npz", "png"]


@pytest.mark.parametrize("ending", ["", ".tif", ".npz", ".mp4"])
def test_a_full_disk_leaves_no_export_behind(tmp_path: Path, ending: str) -> None:
    grain = np.random.default_rng(0).integers(0, 256, (3, 256, 256), np.uint8)
    frames = Frames.from_bytes(grain, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=256)
    with files_of_at_most(30_000), pytest.raises(StorageError, match="beyond what the system allows"):
        export(frames, tmp_path / f"a{ending}")
    assert not list(tmp_path.iterdir())


def test_a_film_for_players_is_yuv420p_and_nearly_the_same(tmp_path: Path) -> None:
    import av

    from vamgpu.storage.films import read_film

    frames = some_frames("numpy")
    with av.open(str(export(frames, tmp_path / "a.mp4", players=True))) as film:
        context = film.streams.video[0].codec_context
        assert (context.pix_fmt, context.width, context.height) == ("yuv420p", 14, 22)
        assert context.profile in ("High", "Main", "Constrained Baseline")
    levels, remark = read_film(tmp_path / "a.mp4")
    off = levels[:, :21, :13].astype(int) - frames.gray_levels()
    assert np.abs(off).mean() < 1.5 and np.abs(off).max() <= 12 and json.loads(remark)["columns"] == 13
    with pytest.raises(BadInput, match="players read videos"):
        export(frames, tmp_path / "b", players=True)


def test_a_canvas_places_frames_and_repeats_them(tmp_path: Path) -> None:
    from PIL import Image

    frames = some_frames("numpy")
    levels = frames.gray_levels()
    folder = export(frames, tmp_path / "png", canvas=Canvas((64, 40), offset=(5, -3), repeats=2, flip_r=True))
    files = sorted(folder.glob("*.png"))
    assert len(files) == 24
    image = np.asarray(Image.open(files[13]))
    top, left = (40 - 21) // 2 + 3, (64 - 13) // 2 + 5
    assert np.array_equal(image[top : top + 21, left : left + 13], levels[1, :, ::-1])
    assert image.sum() == levels[1].sum() and image.shape == (40, 64)
    turned = list(Canvas(rotation=90.0).images(frames))
    assert np.array_equal(turned[0], np.rot90(levels[0]))
    with pytest.raises(BadInput, match="do not fit a canvas of 16 × 16"):
        export(frames, tmp_path / "b", canvas=Canvas((16, 16)))
    with pytest.raises(BadInput, match="no canvas"):
        export(frames, tmp_path / "b.npz", canvas=Canvas())


def test_a_small_rotation_turns_the_light_and_not_its_levels() -> None:
    frames = some_frames("numpy")
    shares = [frames.gray(image) - frames.gray.black for image in (next(Canvas(rotation=1.5).images(frames)),
                                                                  frames.gray_levels()[0])]  # fmt: skip
    assert shares[0].sum() == pytest.approx(shares[1].sum(), rel=0.05)
    with pytest.raises(BadInput, match="1 bit"):
        next(Canvas(rotation=1.5).images(some_frames("numpy", bits=1)))


def test_no_folders_are_made_at_odd_places(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="does not exist; make it"):
        export(some_frames("numpy"), tmp_path / "od" / "a.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("wrong", [{"size": (0, 3)}, {"repeats": 0}, {"rotation": float("nan")}, {"offset": 3}])
def test_a_canvas_that_is_none_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="canvas"):
        Canvas(**wrong)
