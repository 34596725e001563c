"""Webs whose lamp or resin is not as planned, proved from their bytes before and after the rest was replanned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slanted import SECTION, WINDOW, Slanted, tiled

from vamgpu.errors import BadInput, ShapeMismatch, StorageError, TileError
from vamgpu.geometry import Beam
from vamgpu.live import WebDrift, WebReplanner
from vamgpu.losses.band import Band
from vamgpu.operators.web import WebProjection
from vamgpu.optics.film import Film
from vamgpu.web import Propagation, WebGrid
from vamgpu.webs.drift import gains
from vamgpu.webs.proof import WebProof, prove_web
from vamgpu.webs.store import WebFolder
from vamgpu.webs.stream import Stream

SEGMENTS, HORIZON, SINCE = 9, 4, 84
"""The plan's; those committed; the frame from which the lamp is weak, half a segment before."""
SOLID = 0.65
EDGE, BEAM = 0.1, Beam((14, SECTION[1]), 0.1)


@dataclass(frozen=True)
class Absorbing(Slanted):
    """The machine with a film: light falls by its absorption from the outer face on, as if it came straight."""

    film: Film = Film(0.6, 1.5, 1.5, absorption=1.0)

    def propagation(self, grid: WebGrid, beam: Beam) -> Propagation:
        plain = super().propagation(grid, beam)  # which has an absorption of 1 / mm
        way = 0.6 * (1.0 - (plain.rho + 0.5) / grid.shape[1])
        more = self.film.absorption * np.exp(-(self.film.absorption - 1.0) * way)
        return replace(plain, weight=plain.weight * more)


def target() -> np.ndarray:
    """Bars across the web, every second of them half as wide, [l, rho, z]."""
    l, _, z = np.meshgrid(np.arange(8 * WINDOW), *map(np.arange, SECTION), indexing="ij")  # noqa: E741
    wave = np.sin(2.0 * np.pi * l / 20.0 + 0.5 * np.sin(l / 37.0))
    return ((wave > 0.0) & ((z < 3) | (l % 40 < 20))).astype(np.float32)


def stream(**options: Any) -> Stream:
    known: dict[str, Any] = {
        "section": SECTION, "pitch": (EDGE,) * 3, "device": "numpy", "iterations": 40, "core": 1.0, "scale": 14.0,
        "overlap": 1.0, "method": Band.thresholds(0.5, 0.8, 1.2),
    }  # fmt: skip
    return Stream(tiled(target()), Absorbing(), BEAM, **known | options)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> WebFolder:
    folder = stream().write(tmp_path_factory.mktemp("plan") / "plan.vam")
    assert len(folder.segments) == SEGMENTS and not any(each.saturated for each in folder.segments)
    return folder


@cache
def weak(frames: int) -> np.ndarray:
    """What the lamp really gave."""
    return np.where(np.arange(frames) >= SINCE, 0.8, 1.0)


def proved(folder: WebFolder, gain: np.ndarray, absorption: float = 1.0) -> WebProof:
    wrap = Absorbing(film=replace(Absorbing().film, absorption=absorption))
    return prove_web(folder, "numpy", wrap=wrap, gain=gain, threshold=SOLID)


def committed(folder: WebFolder) -> bytes:
    return folder.read("frames", 0, HORIZON * WINDOW).tobytes()


def misses(proof: WebProof, first: int = HORIZON) -> float:
    """Sum of the squares by which doses from a segment on miss the band that was asked for."""
    total = 0.0
    for piece in proof.pieces(range(first, len(proof.segments))):
        part, dose = piece.target, piece.dose.astype(float)
        off = np.where(part, np.maximum(0.8 - dose, dose - 1.2), dose - 0.5)
        total += float(np.square(np.maximum(off, 0.0)).sum())
    return total


@pytest.mark.slow
def test_a_lamp_that_is_weak_from_half_way_on_is_made_up_for(plan: WebFolder, tmp_path: Path) -> None:
    gain = weak(plan.frames)
    nominal, unchanged = proved(plan, np.ones(plan.frames)), proved(plan, gain)
    new = WebReplanner(stream(), WebDrift(0.8, SINCE), iterations=6).write(tmp_path / "new.vam", plan, HORIZON)
    live = proved(new, gain)
    assert committed(new) == committed(plan)
    assert nominal.iou == 1.0 and [each.iou < 0.9 for each in unchanged.segments] == 3 * [False] + 5 * [True]
    assert live.iou == 1.0
    behind = HORIZON  # the segment before it lies in the window that was open when the weak lamp was found
    assert live.segments[behind - 1].window > 0.2
    assert misses(live, behind - 1) < 0.1 * misses(unchanged, behind - 1)
    for then, now in zip(nominal.segments[behind:], live.segments[behind:], strict=True):
        assert now.window > 0.97 * then.window
    assert new.read("frames", HORIZON * WINDOW, new.frames).mean() > plan.read(
        "frames", HORIZON * WINDOW, plan.frames
    ).mean() / 0.82  # fmt: skip


@pytest.mark.slow
def test_another_absorption_is_made_up_for(plan: WebFolder, tmp_path: Path) -> None:
    gain, found = weak(plan.frames), {}
    for name, believed in (("live", 1.4), ("blind", 1.0)):
        drift = WebDrift(0.8, SINCE, believed)
        new = WebReplanner(stream(), drift, iterations=6).write(tmp_path / name, plan, HORIZON)
        found[name] = proved(new, gain, 1.4)
    live, blind, unchanged = (misses(each) for each in (found["live"], found["blind"], proved(plan, gain, 1.4)))
    assert live < 0.2 * blind and live < 0.9 * unchanged  # a weak lamp makes up for most of the absorption here
    # the folder knows the light its frames were made for
    clear = prove_web(found["live"].folder, "numpy", wrap=Absorbing(film=replace(Absorbing().film, absorption=1.4)))
    assert np.array_equal(clear.counts, found["live"].counts)


@pytest.mark.parametrize("step", [0.5, *(pytest.param(step, marks=pytest.mark.slow) for step in (1.0, 1.5))])
def test_what_committed_frames_deliver_is_their_dose_alone(tmp_path: Path, step: float) -> None:
    wrap = Absorbing(advance=step * EDGE)
    job = replace(stream(iterations=1), wrap=wrap)
    plan = job.write(tmp_path / "plan.vam")
    replanner, horizon = WebReplanner(job, WebDrift(0.8, SINCE)), len(plan.segments) // 2
    start, stop = replanner.open_window(horizon)
    grid, first = WebGrid((plan.columns, *SECTION), EDGE), -float(job.layout.lead * job.layout.step)
    A = WebProjection(grid, BEAM, wrap, "numpy", poses=plan.frames, start=first)
    light = plan.details["frames"]["scale"] * plan.read("frames", 0, plan.frames)[:, ::-1].transpose(0, 2, 1) / 255.0
    light *= weak(plan.frames)[:, None, None]
    light[horizon * job.layout.core :] = 0.0
    dose = np.asarray(A.T(A.device.upload(light.astype(np.float32))))
    np.testing.assert_allclose(replanner.delivered(plan, horizon), dose[start:stop], atol=1e-5)
    assert not dose[stop:].any() and dose[start:stop].any()
    light[: horizon * job.layout.core], light[horizon * job.layout.core :] = 0.0, 1.0
    assert not np.asarray(A.T(A.device.upload(light.astype(np.float32))))[:start].any(), "nothing later lights those"


def test_a_killed_run_goes_on_to_the_same_bytes_and_can_be_replanned_again(plan: WebFolder, tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(done: int, of: int | None) -> None:
        if done == HORIZON + 2:
            raise Stop

    def replanner() -> WebReplanner:
        return WebReplanner(stream(), WebDrift(0.8, SINCE), iterations=6)

    alone = replanner().write(tmp_path / "alone.vam", plan, HORIZON)
    with pytest.raises(Stop):
        replanner().write(tmp_path / "killed.vam", plan, HORIZON, progress=stop)
    assert len(replanner().write(tmp_path / "killed.vam", plan, HORIZON, count=1).segments) == HORIZON + 2
    assert len(replanner().write(tmp_path / "killed.vam", plan, HORIZON, count=3).segments) == HORIZON + 3
    again = replanner().write(tmp_path / "killed.vam", plan, HORIZON)
    again.verify()
    assert again.complete and again.segments == alone.segments
    with pytest.raises(StorageError, match="replanned with other settings"):
        WebReplanner(stream(), WebDrift(0.9, SINCE), iterations=6).write(tmp_path / "killed.vam", plan, HORIZON)
    # the lamp is replaced: what was planned for 0.8 starts the light of 1.0 where it was, not a quarter brighter
    later = HORIZON + 2
    drifts = (WebDrift(0.8, SINCE), WebDrift(1.0, later * WINDOW))
    back = WebReplanner(stream(), drifts, iterations=6).write(tmp_path / "back.vam", again, later)
    live = proved(back, gains(drifts, 0, back.frames))
    assert live.iou == 1.0 and live.segments[-1].window > 0.3
    losses = [each.loss[0] for each in back.segments[later:]]
    assert max(losses) < 2.0 * max(each.loss[1] for each in alone.segments[later:])


def test_segments_that_were_sent_one_by_one_are_a_plan_with_the_one_behind_them(
    plan: WebFolder, tmp_path: Path
) -> None:
    """A planner that has time for one segment each, and missed one: the plan's own is shown there."""
    shown: tuple[WebFolder, ...] = (plan,)
    for horizon in (HORIZON, HORIZON + 1, HORIZON + 3):
        replanner = WebReplanner(stream(), WebDrift(0.8, SINCE), iterations=4)
        new = replanner.write(tmp_path / f"{horizon}.vam", shown, horizon, count=1)
        assert len(new.segments) == horizon + 1 and not new.complete
        shown = (new, plan)
    sent = [WebFolder.open(tmp_path / f"{horizon}.vam") for horizon in (HORIZON, HORIZON + 1, HORIZON + 3)]
    missed = slice((HORIZON + 2) * WINDOW, (HORIZON + 3) * WINDOW)
    assert np.array_equal(sent[2].read("frames", missed.start, missed.stop), plan.read("frames", missed.start,
                                                                                       missed.stop))  # fmt: skip
    for segment, folder in ((HORIZON, sent[0]), (HORIZON + 1, sent[1])):
        span = segment * WINDOW, (segment + 1) * WINDOW
        assert np.array_equal(sent[2].read("frames", *span), folder.read("frames", *span))
    live = proved(sent[2], weak(sent[2].frames))
    ious = [each.iou for each in live.segments]
    assert ious[:5] == [1.0] * 5, "up to where the segment that was missed lights columns too"
    assert min(ious[5:7]) > 0.9 > max(each.iou for each in proved(plan, weak(plan.frames)).segments[5:7])


def test_no_pixel_is_brighter_than_the_lamp(plan: WebFolder) -> None:
    scale = plan.details["frames"]["scale"]
    job, seen = stream(), []
    replanner = WebReplanner(job, WebDrift(0.4, SINCE), iterations=3)
    solve = replanner.stream.solver.solve
    replanner.stream.solver.solve = lambda *args: (  # type: ignore[method-assign]
        seen.append(float((found := solve(*args))[0].numpy().max())), found
    )[1]  # fmt: skip
    segment = next(replanner.segments(plan, HORIZON))
    assert seen == [pytest.approx(0.4 * scale, rel=1e-5)] and segment.saturated > 0
    assert segment.scale == pytest.approx(0.4 * scale) and segment.number == HORIZON


def test_nonsense_is_refused(plan: WebFolder, tmp_path: Path) -> None:
    for values in ({"gain": float("nan")}, {"gain": 0.0}, {"absorption": -1.0}, {"since": -1}, {"since": 1.5}):
        with pytest.raises(BadInput):
            WebDrift(**values)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="no film that absorbs"):
        WebReplanner(replace(stream(), wrap=Slanted()), WebDrift(absorption=1.1))
    replanner = WebReplanner(stream(), WebDrift(0.8, SINCE))
    with pytest.raises(BadInput, match="horizon of 10 segments"):
        next(replanner.segments(plan, 10))
    with pytest.raises(BadInput, match="delivered dose"):
        next(replanner.segments(plan, HORIZON, delivered=np.full((23, *SECTION), np.nan)))
    with pytest.raises(StorageError, match="the plan itself"):
        replanner.write(plan.path, plan, HORIZON)
    with pytest.raises(ShapeMismatch, match="one for each frame"):
        prove_web(plan, "numpy", wrap=Slanted(), gain=np.ones(3))
    other = stream()
    other.tiles = tiled(1.0 - target())
    with pytest.raises(TileError, match="differ from those"):
        next(WebReplanner(other, WebDrift(0.8, SINCE)).segments(plan, HORIZON))
