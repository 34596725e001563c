"""Streams of tiles in, frames out: what fits, what does not, and what stays valid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slanted import BEAM, EDGE, SECTION, WINDOW, Slanted, part, stream, tiled

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, ShapeMismatch, StorageError, TileError
from vamgpu.geometry import Beam
from vamgpu.losses import Band, VoxelLoss
from vamgpu.methods import BCLP, LBFGS, Descent, optimize
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.printing.focus import FocusMasks
from vamgpu.web import WebGrid
from vamgpu.webs.layout import SegmentLayout
from vamgpu.webs.store import WebFolder
from vamgpu.webs.stream import Stream

LONG = 10 * WINDOW


def images(job: Stream) -> np.ndarray:
    return np.concatenate([segment.images for segment in job])


def test_every_pose_that_meets_the_web_has_one_frame() -> None:
    job = stream(tiled(part(LONG)), core=2.0)
    segments = list(job)
    assert [segment.number for segment in segments] == list(range(len(segments)))
    assert [segment.first for segment in segments] == [k * 2 * WINDOW for k in range(len(segments))]
    assert sum(len(segment.images) for segment in segments) == WINDOW - 1 + LONG
    assert [segment.last for segment in segments] == [False] * (len(segments) - 1) + [True]
    assert len({segment.scale for segment in segments}) == 1
    assert segments[0].frames.shape == (2 * WINDOW, *BEAM.pixels[::-1])


def test_every_segment_lowers_its_loss() -> None:
    """Segments with something to print; the best light of a segment is never worse than what it began with."""
    found = [segment.loss for segment in stream(part(LONG), core=2.0) if segment.target.any()]
    assert len(found) >= 5 and all(last < 0.95 * first for first, last in found)


def test_tiles_may_be_of_any_thickness() -> None:
    target = part(LONG)
    cuts = np.split(target, np.sort(np.random.default_rng(0).choice(np.arange(1, LONG), 9, replace=False)))
    assert np.array_equal(images(stream(cuts, core=2.0)), images(stream(target, core=2.0)))


def test_functions_are_sampled_along_the_web() -> None:
    def bar(l: np.ndarray, rho: np.ndarray, z: np.ndarray) -> np.ndarray:  # noqa: E741 - the web's axis
        return np.abs(np.sin(2.0 * l + 0.0 * rho + 0.0 * z)) - 0.5

    segments = list(stream(bar, length=LONG * EDGE, core=3.0))
    target = np.concatenate([segment.target for segment in segments])
    assert target.shape == (LONG, *SECTION)
    l = (np.arange(LONG) + 0.5) * EDGE  # noqa: E741
    inside = np.abs(np.sin(2.0 * l)) - 0.5 < -2.0 * EDGE
    assert (target[inside] == 255).all()
    assert (target[np.abs(np.sin(2.0 * l)) - 0.5 > 2.0 * EDGE] == 0).all()


def test_a_function_without_a_length_is_refused() -> None:
    with pytest.raises(BadInput, match="length"):
        list(stream(lambda along, rho, z: along + rho + z))


@pytest.mark.slow
def test_a_stream_that_ends_early_keeps_what_was_written(tmp_path: Path) -> None:
    target, place = part(LONG), tmp_path / "web.vam"
    with pytest.raises(TileError, match=r"end after 150 columns \(15 mm\); expected 240 \(24 mm\)"):
        stream(tiled(target[:150]), length=LONG * EDGE, core=2.0).write(place)
    kept = WebFolder.open(place)
    kept.verify()
    assert kept.frames == 2 * 2 * WINDOW and not kept.complete
    whole = stream(tiled(target), length=LONG * EDGE, core=2.0).write(place)
    assert whole.complete
    assert np.array_equal(whole.read("frames", 0, whole.frames), images(stream(target, core=2.0)))


def test_an_array_that_is_too_short_is_refused_and_leaves_room_for_one_that_is_not(tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    with pytest.raises(TileError, match="an array longer along l"):
        stream(part(150), length=LONG * EDGE, core=2.0).write(place)
    assert stream(part(LONG), length=LONG * EDGE, core=2.0).write(place).complete


@dataclass
class Tile:
    """An array that knows its voxels."""

    values: np.ndarray
    pitch: float | tuple[float, ...]

    def numpy(self) -> np.ndarray:
        return self.values


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (np.zeros((10, 6, 5)), r"column 200 \(20 mm\) has shape \(10, 6, 5\); expected \[l, 6, 4\]"),
        (np.zeros((6, 4)), r"has shape \(6, 4\)"),
        pytest.param(np.zeros((0, 6, 4)), r"has shape \(0, 6, 4\)", marks=pytest.mark.slow),
        pytest.param(
            Tile(np.zeros((10, 6, 4)), 0.2),
            r"has voxels of 0.2 × 0.2 × 0.2 mm, the web of 0.1 × 0.1 × 0.1 mm",
            marks=pytest.mark.slow,
        ),
        pytest.param(np.full((10, 6, 4), 1.5), r"reaches from 1.5 to 1.5; expected fractions", marks=pytest.mark.slow),
        pytest.param(np.full((10, 6, 4), np.nan), r"reaches from nan", marks=pytest.mark.slow),
        pytest.param(np.full((10, 6, 4), "a"), r"holds <U1", marks=pytest.mark.slow),
        pytest.param(Tile(np.zeros((10, 6, 4)), (0.1, 0.1)), r"has voxels of 0.1 × 0.1 mm", marks=pytest.mark.slow),
        pytest.param(None, r"has shape \(\)", marks=pytest.mark.slow),
    ],
)
def test_a_tile_that_does_not_fit_ends_the_stream_there(odd: object, said: str, tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    with pytest.raises(TileError, match=said):
        stream([*tiled(part(200)), odd], core=2.0).write(place)
    WebFolder.open(place).verify()
    assert WebFolder.open(place).frames == 3 * 2 * WINDOW
    assert list(stream([Tile(part(60), EDGE)], core=2.0))


OWN = VoxelLoss(lambda dose: np.maximum(0.0, dose - 0.7) ** 2, lambda dose: np.exp(-6.0 * dose))
LOCAL = ["bclp", "cal", "penalty", "lbfgs", OWN + 0.1 * Band.thresholds(0.7, 0.9), Descent(OWN, momentum=0.5)]


def pieces(method: Any, core: float, longer: float = 1.0) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Light of a web by steps so many times longer, and the losses of its segments that print."""
    job = stream(part(LONG), method=method, core=core, iterations=15)
    solver: Any = job.solver  # of methods that step by a pace
    solver.pace = replace(solver.pace, step=longer * solver.step)
    own = slice(job.layout.overlap, None)
    cut = [(solver.buffer().numpy()[own][: len(segment.images)], segment) for segment in job]
    losses = [segment.loss for _, segment in cut if segment.target.any()]
    return np.concatenate([light for light, _ in cut]), losses


NAMES = ["bclp", "cal", "penalty", "lbfgs", "sum", "own"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        pytest.param(method, id=name, marks=() if name in ("bclp", "lbfgs", "sum") else pytest.mark.slow)
        for method, name in zip(LOCAL, NAMES, strict=True)
    ],
)
def test_every_loss_that_is_a_sum_over_voxels_is_lowered_without_a_seam(method: Any) -> None:
    (cut, losses), (whole, _) = pieces(method, 2.0), pieces(method, 30.0)
    assert all(last < 0.9 * first for first, last in losses)
    assert np.abs(cut - whole).max() <= 1e-6 * whole.max()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::vamgpu.errors.DivergenceWarning")
def test_steps_along_a_web_have_no_ear_for_its_loss() -> None:
    """Where it rises, in one segment and not in another, they go on alike: else segments would not meet."""
    (cut, losses), (whole, _) = pieces("lbfgs", 2.0, 3.0), pieces("lbfgs", 30.0, 3.0)
    assert any(last > first for first, last in losses)
    assert np.abs(cut - whole).max() <= 1e-6 * whole.max()


def test_a_web_by_a_loss_of_ones_own_is_resumed_by_that_loss_alone(tmp_path: Path) -> None:
    def leaks(allowed: float) -> VoxelLoss:
        return VoxelLoss(lambda dose: np.maximum(0.0, dose - allowed) ** 2, lambda dose: np.exp(-6.0 * dose))

    place = tmp_path / "web.vam"
    folder = stream(part(60), method=leaks(0.7)).write(place)
    assert stream(part(60), method=leaks(0.7)).write(place) == folder
    with pytest.raises(StorageError, match="with other method"):
        stream(part(60), method=leaks(0.6)).write(place)


def test_what_couples_a_web_is_refused() -> None:
    for method, said in (
        (BCLP(p=3.0, q=1.0, weight=np.ones((60, *SECTION))), "weights of single voxels|q is 1.0 with p = 3.0"),
        (BCLP(weight=np.ones((60, *SECTION))), "an endless web cannot have weights of single voxels"),
        (VoxelLoss(np.square, np.sqrt, weight=np.ones((60, *SECTION))), "weights of single voxels"),
        (LBFGS(efficiency=0.1), "efficiency is 0.1: its penalty depends on all light"),
        (OWN**0.5, "a power of a sum couples all of its voxels"),
        ("osmo", r"OSMO\(.*scales its light by the dose of the whole web"),
        ("recipe", "scales its light by the dose of the whole web"),
        ("fbp", "scales its light by the dose of the whole web"),
        ("magic", "there are default"),
    ):
        with pytest.raises(BadInput, match=said):
            stream(part(60), method=method)


def test_bad_numbers_are_refused() -> None:
    for options in (
        {"iterations": 0}, {"core": 0.0}, {"overlap": -1.0}, {"overlap": float("nan")}, {"scale": 0.0},
        {"length": -1.0}, {"pitch": (0.1, 0.1)}, {"section": 6}, {"gray": "linear"},
    ):  # fmt: skip
        with pytest.raises(BadInput, match=next(iter(options))):
            list(stream(part(60), **options))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="section"):
        stream(part(60), section=None)
    with pytest.raises(BadInput, match="expected a Roller"):
        Stream(part(60), "roller", BEAM)  # type: ignore[arg-type]


def test_steps_that_never_meet_columns_are_refused_with_a_pitch_that_does() -> None:
    with pytest.raises(BadInput, match="ratio of whole numbers up to 64") as error:
        SegmentLayout.of(100, 2**-0.5)
    better = float(str(error.value).split("pitch along l of ")[1].split(" times")[0])
    assert SegmentLayout.of(100, 2**-0.5 / better).step.denominator <= 64


@pytest.mark.slow
@pytest.mark.parametrize("step", [pytest.param(0.5, marks=pytest.mark.slow), 1.5, 2.0])
def test_steps_of_other_lengths_than_a_column(step: float) -> None:
    target = part(LONG)
    options = {"section": SECTION, "pitch": (EDGE,) * 3, "device": "numpy", "iterations": 8}
    jobs = [Stream(target, Slanted(advance=step * EDGE), BEAM, core=core, **options) for core in (2.0, 30.0)]  # type: ignore[arg-type]
    cut, whole = (images(job) for job in jobs)
    assert len(whole) == jobs[1].layout.frames(LONG)
    assert cut.shape == whole.shape
    assert jobs[0].layout.core < len(whole) <= jobs[1].layout.core
    # one scale is that of the first segment, the other that of all, so that levels differ by that ratio
    scales = [next(job.segments()).scale for job in jobs]
    assert np.abs(cut * (scales[0] / scales[1]) - whole)[cut < 255].max() <= 2.0


def test_the_scale_is_a_quantile_of_the_first_frames_alone(fast_device: Device) -> None:
    job = stream(tiled(part(200)), core=1.0, device=fast_device)
    segment = next(iter(job))
    own = job.solver.buffer().numpy()[job.layout.overlap :][: len(segment.images)]  # type: ignore[union-attr]
    lit = np.sort(own[own > 0])
    assert segment.scale == pytest.approx(lit[min(lit.size - 1, int(0.9999 * lit.size))], rel=3e-7)


def test_an_empty_beginning_needs_a_scale() -> None:
    target = np.concatenate([np.zeros((8 * WINDOW, *SECTION), np.float32), part(60)])
    with pytest.raises(TileError, match="scale"):
        list(stream(target, core=2.0))
    segments = list(stream(target, core=2.0, scale=1.0))
    assert not segments[0].images.any() and segments[-1].images.any()


def test_focus_planes_are_kept_beside_the_frames(tmp_path: Path) -> None:
    masks = FocusMasks.around(BEAM, 0.4, 0.6, bins=3)
    folder = stream(part(60), lens=masks).write(tmp_path / "web.vam")
    focus = folder.details["frames"]["focus"]
    assert focus["planes"] == list(masks.planes)
    assert np.array_equal(np.array(focus["bin"]), np.argmax(masks.masks, axis=0))


ROLLER = Roller(1.0, Film(0.5, 1.49, 1.33, 0.2), np.radians(3.0), legs=0.3)


def test_a_tunable_lens_follows_the_film_of_a_roller(tmp_path: Path) -> None:
    beam = ROLLER.beam(0.12, 4)
    options = {"length": 12.0, "iterations": 3, "device": "numpy"}
    job = Stream(lambda along, rho, z: 0.2 - rho + 0 * (along + z), ROLLER, beam, lens=TunableLens(bins=3), **options)  # type: ignore[arg-type]
    masks = FocusMasks.around(beam, 1.0, 0.5, bins=3)
    assert job.masks == masks
    focus = job.write(tmp_path / "web.vam").details["frames"]["focus"]
    assert focus["planes"] == list(masks.planes) and sorted(set(focus["bin"])) == [0, 1, 2]


def test_layers_fill_a_film_that_is_not_a_whole_number_of_pixels() -> None:
    job = Stream(part(60), ROLLER, ROLLER.beam(0.12, 4), device="numpy")
    assert job.grid.shape == (1, 4, 4)
    assert job.grid.edges == pytest.approx((ROLLER.advance, 0.125, 0.12), rel=1e-12)
    assert Stream(part(60), ROLLER, ROLLER.beam(0.3, 4), device="numpy").grid.shape == (1, 2, 4)


def test_a_lens_that_cannot_be_used_is_refused() -> None:
    beam = ROLLER.beam(0.12, 4)
    with pytest.raises(BadInput, match="got 3 as lens; expected a TunableLens, FocusMasks"):
        Stream(part(60), ROLLER, beam, lens=3)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="of a Roller, but Slanted is not one"):
        stream(part(60), lens=TunableLens())
    with pytest.raises(BadInput, match="bins is 90"):
        Stream(part(60), ROLLER, beam, lens=TunableLens(bins=90))
    with pytest.raises(BadInput, match="the lens reaches 5 to 5.001 dpt"):
        Stream(part(60), ROLLER, beam, lens=TunableLens(powers=(5.0, 5.001)))
    with pytest.raises(ShapeMismatch, match=f"for 7 columns; expected {beam.pixels[0]}"):
        Stream(part(60), ROLLER, beam, lens=FocusMasks.around(Beam((7, 4), 0.12), 1.0, 0.5))


def test_a_folder_of_another_web_is_not_resumed(tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    first = stream(part(60)).write(place)
    assert stream(part(60)).write(place) == first
    with pytest.raises(StorageError, match="holds another web, with other method"):
        stream(part(60), iterations=9).write(place)
    with pytest.raises(StorageError, match="exists"):
        stream(part(60)).write(place, resume=False)
    with pytest.raises(StorageError, match="with other target"):
        stream(part(60, seed=3)).write(place)
    assert stream(part(60), iterations=9).write(place, overwrite=True).complete


def test_other_tiles_are_not_mixed_into_a_web(tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    with pytest.raises(TileError, match="end after"):
        stream(tiled(part(150)), length=LONG * EDGE, core=2.0).write(place)
    with pytest.raises(TileError, match="columns 48 to 95 of the tiles differ"):
        stream(tiled(part(LONG, seed=1)), length=LONG * EDGE, core=2.0).write(place)
    WebFolder.open(place).verify()


@pytest.mark.parametrize("method", ["osmo", "lbfgs", "cal"])
def test_every_method_works_on_a_web(method: str) -> None:
    A = WebProjection(WebGrid((60, *SECTION), EDGE), BEAM, Slanted(), "numpy")
    plan = optimize(A, part(60), method=method, iterations=6)
    assert plan.sinogram.shape == A.range.shape
    dose, inside = plan.dose().numpy(), part(60) >= 0.5
    assert dose[inside].mean() > 1.5 * dose[~inside].mean()
    assert plan.history[-1].loss < plan.history[-3].loss
    with pytest.raises(BadInput, match="the operator of 0.1 × 0.1 × 0.1 mm"):
        optimize(A, _Pitched(part(60)), method=method)


class _Pitched:
    def __init__(self, values: np.ndarray) -> None:
        self.values, self.shape = values, values.shape
        self.grid = WebGrid(values.shape, 0.2)  # type: ignore[arg-type]


def test_a_web_without_a_segment_keeps_no_other_from_its_place(tmp_path: Path) -> None:
    place = tmp_path / "web.vam"
    with pytest.raises(TileError):
        stream([np.ones((4, 4))]).write(place)
    assert not WebFolder.open(place).segments
    folder = stream(tiled(part(60)), iterations=3).write(place)
    assert folder.complete and folder.details["method"]["iterations"] == 3
