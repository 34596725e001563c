"""Films of machines: read back as these machines read them, and by the import."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.errors import BadInput, StorageError
from vamgpu.jobs.foreign.importing import found_in
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.printing.export import Canvas, export
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.machine_films import MACHINES, export_for

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text("utf-8").partition("## Films for machines")[2]
CARD = re.compile(
    r"turn at +(?P<rpm>\S+) rpm = (?P<speed>\S+) deg/s, one turn in (?P<turn>\S+) s\n"
    r"light +(?P<turns>\d+) turns? of (?P<frames>\d+) frames?, (?P<rate>\S+) frames per second, (?P<light>\S+) s\n"
    r"dark +(?:(?P<before>\d+) turns? \(\S+ s\) before, (?P<after>\d+) turns? \(\S+ s\) after|none in the files)\n"
    r"image +(?P<columns>\d+) x (?P<rows>\d+) pixels"
)


def plain_frames(angles: int = 12, gray: GrayCurve = GrayCurve.linear()) -> Frames:
    levels = np.random.default_rng(1).integers(0, 256, (angles, 21, 13), np.uint8)
    return Frames.from_bytes(levels, "numpy", bits=8, gray=gray, scale=1.0, columns=13)


def packed(bits: int = 8) -> Frames:
    plan: Any = type("Plan", (), {"sinogram": vam.open_device("numpy").upload(np.ones((4, 5, 6))), "operator": None})()
    return vam.pack(plan, bits=bits)


def played(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """The time [s] and the RGB of each image."""
    import av

    with av.open(str(path)) as film:
        for frame in film.decode(video=0):
            yield float(frame.time or 0.0), frame.to_ndarray(format="rgb24")


def decoded(path: Path) -> tuple[np.ndarray, float]:
    """Images in RGB, and their rate."""
    times, images = zip(*played(path), strict=True)
    return np.stack(images), (len(times) - 1) / (times[-1] - times[0])


def numbers_of(card: Path) -> dict[str, float]:
    found = CARD.search(card.read_text("utf-8"))
    assert found is not None, card.read_text("utf-8")
    return {name: float(value or 0) for name, value in found.groupdict().items()}


@pytest.mark.parametrize(("channel", "lit"), [("blue", 2), ("red", 0), (None, None)])
def test_opencal_gets_its_speed_by_name_and_a_film_that_ends_dark(
    channel: str | None, lit: int | None, tmp_path: Path
) -> None:
    frames = plain_frames()
    canvas = Canvas((64, 40), offset=(3, -2), rotation=90.0, flip_r=True, repeats=2)
    film, card = export_for(
        "opencal", frames, tmp_path, "part", rpm=9, canvas=canvas, dark=(5.0, 10.0), channel=channel
    )
    assert (film.name, card.name) == ("part_9rpm.mp4", "part_9rpm.txt")
    images, rate = decoded(film)
    assert rate == pytest.approx(9 * 12 / 60, rel=1e-3) and images.shape == (12 * (1 + 2 + 2), 40, 64, 3)
    assert images[:12].max() == images[-24:].max() == 0 and images[12:36].min(0).max() > 0
    top, left = (40 - 13) // 2 + 2, (64 - 21) // 2 + 3
    drawn = images[12:, top : top + 13, left : left + 21]
    expected = np.rot90(frames.gray_levels()[:, :, ::-1], 1, (1, 2))
    if lit is not None:
        assert np.array_equal(drawn[:12, ..., lit], expected)
        assert images[..., [k for k in range(3) if k != lit]].max() == 0
    back = read_pictures(film, Layout()).light.transpose(0, 2, 1)[:, ::-1]
    assert np.abs(back - frames.irradiance().numpy().transpose(0, 2, 1)[:, ::-1]).mean() < (
        0.01 if lit is None else 1e-6
    )
    said = card.read_text()
    assert "turn at     9 rpm = 54 deg/s, one turn in 6.66667 s" in said
    assert "levels      gray curve: linear in light\n" in said
    assert "2 turns of 12 frames, 1.8 frames per second, 13.3333 s" in said
    assert "1 turn (6.66667 s) before, 2 turns (13.3333 s) after" in said


@pytest.mark.parametrize(
    ("gray", "said"),
    [
        (GrayCurve.gamma(2.2), "half of full light at level 186"),
        (GrayCurve.linear(0.02), "linear in light, black level 2 % of full light"),
        (GrayCurve((0, 100, 255), (1.0, 5.0, 10.0)), "half of full light at level 100, black level 10 % of full light"),
    ],
)
def test_a_card_is_plain_text_with_one_turn_in_the_singular(gray: GrayCurve, said: str, tmp_path: Path) -> None:
    frames = plain_frames(3, gray)
    for machine in ("opencal", "lightcrafter"):
        _, card = export_for(machine, frames, tmp_path, "part", rpm=9, canvas=Canvas((64, 40)))
        text = card.read_text("utf-8")
        assert f"levels      gray curve: {said}\n" in text and "light       1 turn of 3 frames, " in text
        assert not re.search(r"\b1 (turns|times|frames)\b|[{}\[\]]", text)


def test_tvam_code_s_own_loop_shows_the_light(tmp_path: Path) -> None:
    """Loading as the program does: patterns / max · 255, 768 × 1024, rows along r."""
    frames = plain_frames(gray=GrayCurve.gamma(2.2, black=0.0))
    made, card = export_for("tvam-code", frames, tmp_path, "part", rpm=10.0, canvas=Canvas(repeats=4))
    with np.load(made) as held:
        assert held.files == ["patterns"]
        images = held["patterns"] / np.max(held["patterns"]) * 255
    assert images.shape == (12, 768, 1024)
    light = frames.gray(frames.gray_levels())
    drawn = images[:, 377 : 377 + 13, 501 : 501 + 21]
    assert np.abs(drawn - 255 * light.transpose(0, 2, 1) / light.max()).max() <= 0.51
    assert images.sum() == drawn.sum()
    back = read_pictures(made, Layout()).light[:, :13, 1:]  # odd frames lie half a pixel off the middle
    assert np.abs(back / back.max() - frames.irradiance().numpy() / light.max()).max() < 0.003
    np.savez(tmp_path / "other.npz", images=images)
    with pytest.raises(BadInput, match=r"holds images; expected an array patterns \[angle, row, column\]"):
        read_pictures(tmp_path / "other.npz", Layout())
    said = card.read_text()
    assert f"python tvam_code.py -p {made.name} -v 60 -n 4" in said and "dark        none in the files" in said
    with pytest.raises(BadInput, match=r"turns at 20 rpm at most: use 20 rpm or less"):
        export_for("tvam-code", frames, tmp_path, "b", rpm=21)


def test_tvam_code_reads_a_folder_of_images_alone_and_so_do_we(tmp_path: Path) -> None:
    frames = plain_frames(gray=GrayCurve.gamma(2.2, black=0.0))
    made, card = export_for("tvam-code-images", frames, tmp_path, "part", rpm=10.0)
    single, _ = export_for("tvam-code", frames, tmp_path, "other", rpm=10.0)
    assert f"python tvam_code.py -p {made.name} -v 60 -n 1" in card.read_text() and card.parent == tmp_path
    # as the program reads a folder: every file in it, in the order of names, as gray levels
    images = np.stack([np.asarray(Image.open(file).convert("L")) for file in sorted(made.iterdir())])
    with np.load(single) as held:
        assert images.shape == (12, 768, 1024) and np.array_equal(images, held["patterns"])
    asked = Layout(tvam_code=True)
    whole = read_pictures(single, asked)
    for number, image in enumerate(images):  # dimmer: the program makes the brightest pixel full on
        Image.fromarray(image // 2).save(made / f"{number:04d}.png")
    back = read_pictures(made, asked)
    assert whole.notes == back.notes == () and back.full is None and back.light.shape == whole.light.shape
    assert np.abs(back.light / back.light.max() - whole.light).max() < 0.005
    for number, image in enumerate(images):  # 1024 × 768 images are turned by the program
        Image.fromarray(image.T.copy()).save(made / f"{number:04d}.png")
    assert np.array_equal(read_pictures(made, asked).light, whole.light)
    for file in made.iterdir():
        Image.fromarray(np.full((700, 1024), 9, np.uint8)).save(file)
    with pytest.raises(BadInput, match="expected 768 × 1024 or 1024 × 768"):
        read_pictures(made, asked)
    with pytest.raises(BadInput, match="--for is for images, but 'config.json' is a file of another program"):
        found_in(Path("config.json"), layout=asked)


@pytest.mark.parametrize("black", [0.0, 0.2])
def test_tvam_code_s_card_says_how_much_brighter_its_levels_are(black: float, tmp_path: Path) -> None:
    levels = np.full((12, 21, 13), 20, np.uint8)
    levels[3, 10, 5] = 153
    frames = Frames.from_bytes(levels, "numpy", bits=8, gray=GrayCurve.linear(black), scale=1.0, columns=13)
    made, card = export_for("tvam-code", frames, tmp_path, "part", rpm=10.0)
    found = re.search(r"brightest pixel, which has (\S+) of full light: (\S+) times", card.read_text())
    assert found is not None
    share, factor = float(found[1]), float(found[2])
    with np.load(made) as held:
        assert share * held["patterns"].max() == pytest.approx(153, abs=0.5)
        assert held["patterns"][0, 384, 512] == pytest.approx(20 * factor, abs=0.51)
    assert "gray curve" not in card.read_text()


def test_a_lightcrafter_gets_three_frames_an_image(tmp_path: Path) -> None:
    frames = plain_frames()
    made, card = export_for("lightcrafter", frames, tmp_path, "part", rpm=30, canvas=Canvas(repeats=5))
    files = sorted(made.iterdir())
    assert len(files) * 3 == 12 == numbers_of(card)["frames"] and numbers_of(card)["after"] == 0
    images = np.stack([np.asarray(Image.open(file)) for file in files])
    assert images.shape[1:] == (1140, 912, 3)
    planes = images[:, 559 : 559 + 21, 449 : 449 + 13][..., [1, 0, 2]].transpose(0, 3, 1, 2).reshape(-1, 21, 13)
    assert np.array_equal(planes, frames.gray_levels())
    assert "in this order, 5 times" in card.read_text() and "dark        none in the files" in card.read_text()
    with pytest.raises(BadInput, match="got 13 frames per turn; expected a multiple of 3.*solve with 15 angles"):
        export_for("lightcrafter", plain_frames(13), tmp_path, "b", rpm=30)
    assert not (tmp_path / "b-lightcrafter").exists()


@pytest.mark.parametrize("machine", ["opencal", "rotary"])
def test_a_film_ends_dark_unless_asked(machine: str, tmp_path: Path) -> None:
    canvas = Canvas((32, 30), repeats=2)
    film, card = export_for(machine, plain_frames(), tmp_path, "part", rpm=12, canvas=canvas, channel="blue")
    images, _ = decoded(film)
    assert images[-1].max() == 0 and images[-12 * 2 - 1].max() > 0 and images[12 - 1].max() == 0
    assert len(images) == 12 * (1 + 2 + 2) and numbers_of(card)["after"] == 2
    film, _ = export_for(machine, plain_frames(), tmp_path, "b", rpm=12, canvas=canvas, dark=(0, 1e-3), channel="red")
    images, _ = decoded(film)
    assert len(images) == 12 * 3 and images[0].max() > 0 and images[-12:].max() == 0


@pytest.mark.slow
def test_cards_and_page_tell_what_the_files_hold(tmp_path: Path) -> None:
    """The commands of the page, and one for each other machine, in sizes of the machines."""
    levels = np.random.default_rng(1).integers(1, 256, (24, 90, 60), np.uint8)
    frames = Frames.from_bytes(levels, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=60)
    save_frames(tmp_path / "boat.vam", frames)
    sizes = {name: (int(x), int(y)) for name, x, y in re.findall(r"^\| `(\S+)` \|.* (\d+) × (\d+)", PAGE, re.MULTILINE)}
    assert sizes.keys() == MACHINES.keys()
    commands = [line.partition("#")[0] for line in PAGE.splitlines() if line.startswith("vam export")]
    commands += [
        f"vam export boat.vam --for {name} --out . --rpm 12 --repeats 3" for name in ("rotary", "lightcrafter")
    ]
    for number, command in enumerate(commands):
        words = shlex.split(command)[1:]
        asked = dict(zip(words[2::2], words[3::2], strict=True))
        out = tmp_path / str(number)
        out.mkdir()
        assert main([{"boat.vam": str(tmp_path / "boat.vam"), ".": str(out)}.get(word, word) for word in words]) == 0
        made, said = next(each for each in out.iterdir() if each.suffix != ".txt"), numbers_of(*out.glob("*.txt"))
        assert (said["columns"], said["rows"]) == sizes[asked["--for"]]
        assert said["turns"] == int(asked["--repeats"]) and said["rpm"] == float(asked["--rpm"]) == said["speed"] / 6
        assert said["light"] == pytest.approx(said["turns"] * said["turn"], rel=1e-5)
        assert said["rate"] * said["turn"] == pytest.approx(24, rel=1e-5) and said["frames"] == 24
        if made.suffix == ".mp4":
            assert (said["before"], said["after"]) == (np.ceil(5 / said["turn"]), np.ceil(10 / said["turn"]))
            compare(made, said, levels, {"blue": 2}.get(asked.get("--channel", "")))
        elif made.suffix == ".npz":
            with np.load(made) as held:
                assert held["patterns"].shape == (24, *sizes[asked["--for"]])
        else:
            images = [np.asarray(Image.open(file)) for file in made.iterdir()]
            assert {each.shape for each in images} == {(*sizes[asked["--for"]][::-1], 3)} and 3 * len(images) == 24


def compare(film: Path, said: dict[str, float], levels: np.ndarray, channel: int | None) -> None:
    """Assert that each image of a film is what its card says at its time and angle."""
    rows, columns, turn, count = int(said["rows"]), int(said["columns"]), int(said["frames"]), 0
    top, left = (rows - levels.shape[1]) // 2, (columns - levels.shape[2]) // 2
    for number, (time, image) in enumerate(played(film)):
        assert image.shape == (rows, columns, 3) and time == pytest.approx(number / said["rate"], abs=1e-3)
        lit, count = said["before"] <= number // turn < said["before"] + said["turns"], count + 1
        drawn = image[top:, left:][: levels.shape[1], : levels.shape[2]].astype(int)
        assert lit == bool(image.any()) and np.count_nonzero(image.any(2)) <= (1.1 if lit else 0) * levels[0].size
        if lit and channel is not None:
            assert np.array_equal(drawn[..., channel], levels[number % turn])
        elif lit:
            assert np.abs(drawn - levels[number % turn][..., None]).mean() < 3
    assert count == turn * (said["before"] + said["turns"] + said["after"]) and not image.any()


def test_a_rotary_film_keeps_to_the_projector_s_rate(tmp_path: Path) -> None:
    made, card = export_for("rotary", plain_frames(), tmp_path, "part", rpm=12.5, canvas=Canvas((16, 24)))
    assert decoded(made)[1] == pytest.approx(2.5) and "film ends in the dark" in card.read_text()
    with pytest.raises(BadInput, match=r"12 frames per turn at 301 rpm are 60\.2 images per second; .* use 300 rpm"):
        export_for("rotary", plain_frames(), tmp_path, "b", rpm=301)


@pytest.mark.parametrize(
    ("machine", "options", "said"),
    [
        ("printer", {}, "no machine 'printer'; expected one of opencal"),
        ("opencal", {"rpm": 9.5}, "expected a whole number"),
        ("opencal", {"rpm": 0}, "rpm"),
        ("opencal", {"dark": (-1.0, 0.0)}, "seconds of dark"),
        ("opencal", {"dark": (5.0, 0.0)}, r"dark is \(5.0, 0.0\); expected seconds above 0 after the last turn"),
        ("rotary", {"dark": (0.0, 0.0)}, "a film that ends lit continues to cure"),
        ("tvam-code", {"dark": (5.0, 10.0)}, "expected none: the files for tvam-code hold one turn"),
        ("lightcrafter", {"dark": (0.0, 1.0)}, "expected none: the files for lightcrafter hold one turn"),
        ("opencal", {"channel": "violet"}, "expected one of red, green, blue"),
        ("opencal", {"canvas": Canvas((4, 4))}, "do not fit a canvas of 4 × 4"),
    ],
)
def test_films_that_no_machine_shows_are_refused(
    machine: str, options: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match=said):
        export_for(machine, plain_frames(), tmp_path, "a", **{"rpm": 9.0, **options})
    assert not list(tmp_path.iterdir())


def test_angles_that_a_film_has_not_are_refused(tmp_path: Path) -> None:
    frames = packed()
    half = Frames(frames.images, 8, frames.gray, 1.0, frames.columns, motion=vam.Turntable.arc(4, span=np.pi))
    with pytest.raises(BadInput, match="expected equal angles and times over a full turn"):
        export_for("opencal", half, tmp_path, "a", rpm=9)


def test_a_keystone_draws_each_point_where_the_homography_puts_it() -> None:
    """One lit block, whose middle is looked for where the projective map of the four corners puts it."""
    levels = np.zeros((1, 60, 80), np.uint8)
    levels[0, 18:25, 50:57] = 255
    frames = Frames.from_bytes(levels, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=80)
    corners = ((4.0, 2.0), (75.0, 6.0), (70.0, 55.0), (8.0, 50.0))
    image = next(Canvas(keystone=corners).images(frames)).astype(float)
    row, column = (float((image * axis).sum() / image.sum()) for axis in np.indices(image.shape))

    def basis(points: Any) -> np.ndarray:
        p = np.concatenate([np.array(points, float).T, np.ones((1, 4))])
        return p[:, :3] * np.linalg.solve(p[:, :3], p[:, 3])

    home = basis(corners) @ np.linalg.inv(basis(((0, 0), (79, 0), (79, 59), (0, 59))))
    x, y, w = home @ (53.0, 21.0, 1.0)
    assert (column, row) == (pytest.approx(x / w, abs=0.1), pytest.approx(y / w, abs=0.1))
    same = next(Canvas(keystone=((0, 0), (79, 0), (79, 59), (0, 59))).images(frames))
    assert np.abs(same.astype(int) - levels[0]).max() <= 1
    with pytest.raises(BadInput, match="no three are on a line"):
        next(Canvas(keystone=((0, 0), (1, 0), (2, 0), (0, 9))).images(frames))
    with pytest.raises(BadInput, match="four corners"):
        Canvas(keystone=((0, 0), (1, 0)))  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadInput, match="1 bit have no keystone"):
        next(Canvas(keystone=corners).images(packed(bits=1)))


def test_a_canvas_comes_back_by_import_but_not_a_keystone(tmp_path: Path) -> None:
    frames = plain_frames()
    for number, canvas in enumerate((Canvas((50, 44), (4, -3), 270.0, flip_z=True, dark=(2, 3)), Canvas(flip_r=True))):
        folder = export(frames, tmp_path / f"png{number}", canvas=canvas)
        assert np.allclose(read_pictures(folder, Layout()).light, frames.irradiance().numpy(), atol=1e-6)
    corners = ((1, 0), (49, 0), (49, 43), (0, 43))
    folder = export(frames, tmp_path / "bent", canvas=Canvas((50, 44), keystone=corners))
    with pytest.raises(BadInput, match="or have a keystone"):
        read_pictures(folder, Layout())


def test_the_command_writes_a_machine_s_films(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_frames(tmp_path / "boat.vam", plain_frames())
    job, out = str(tmp_path / "boat.vam"), str(tmp_path)
    words = shlex.split('--rpm 6 --repeats 2 --keystone "0,3 31,0 31,29 0,27" --canvas 32x30 --dark 0 1')
    assert main(["export", job, "--for", "opencal", "--out", out, *words]) == 0
    assert decoded(tmp_path / "boat_6rpm.mp4")[0].shape == (36, 30, 32, 3)
    assert main(["export", job, "--for", "opencal", "--out", out]) == 1 and "lacks --rpm" in capsys.readouterr().err
    assert main(["export", job, "--mp4", f"{out}/b.mp4", "--rpm", "9", "--fps", "24"]) == 1
    assert "both give the speed of videos: leave one of them out" in capsys.readouterr().err
    assert main(["export", job, "--npz", f"{out}/a.npz", "--canvas", "32x30"]) == 1
    assert "expected no canvas" in capsys.readouterr().err
    with pytest.raises(StorageError, match="exists"):
        export_for("opencal", plain_frames(), tmp_path, "boat", rpm=6)
