"""The way of frames from a device to the mirrors: the right bytes, in order, bounded, black where they are late."""

from __future__ import annotations

import threading
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, DeviceError, ShapeMismatch, TimingInfeasible, VamError, WrongDevice
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.frames.buffers import Batch, BufferRing, pinned_buffers
from vamgpu.hosts.frames.lateness import VialLatePolicy, WebLatePolicy
from vamgpu.hosts.frames.packer import DevicePacker, PlanePacker
from vamgpu.hosts.frames.upload import FrameMemory, UploadQueue
from vamgpu.hosts.player.controller_mirrors import PREROLL
from vamgpu.hosts.rigs.preflight import MARGIN, Residence, fits, measure, preflight
from vamgpu.hosts.schedules.clock import Clock, RealClock
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import web
from vamgpu.printing.focus import FocusMasks
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

LINEAR = GrayCurve.linear()


class Mirrors(FrameMemory):
    """Room for two batches; ``trigger`` shows the next frame."""

    def __init__(self, batches: int = 2) -> None:
        self.taken: list[np.ndarray] = []
        self.pending: list[int] = []
        self.triggers, self.batches = 0, batches

    def room(self, frames: int = 2, name: bytes | None = None) -> bool:
        done, kept = self.triggers, []
        for size in self.pending:
            if done >= size:
                done -= size
                self.triggers -= size
                continue
            kept.append(size)
        self.gone = getattr(self, "gone", 0) + sum(self.pending) - sum(kept)
        self.pending = kept
        return len(kept) < self.batches

    def put(self, planes: np.ndarray, name: bytes | None = None) -> None:
        assert self.room()
        self.pending.append(len(planes))
        self.taken += [frame.copy() for frame in planes]

    def shown(self) -> int:
        self.room()
        return self.gone + self.triggers

    def trigger(self, count: int = 1) -> None:
        self.triggers += count

    def keep(self, name: bytes) -> bool:
        return False

    def again(self, name: bytes, frames: int) -> None:
        raise AssertionError("nothing is kept")

    def cancel(self) -> None: ...

    def close(self, hung: bool = False) -> None: ...


class Numbered:
    """Frames of one byte, their own number + 1."""

    bits = 8

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        return (1 + numbers).astype(np.uint8)[:, None, None]

    def frame(self, number: int) -> np.ndarray:
        return self.planes(np.array([number]))[0]


def numbered(count: int) -> PlanePacker:
    return PlanePacker(Numbered(), (1, 1), count)


# ---- sources -----------------------------------------------------------------------------------------------
def frames_of(device: Device, bits: int, columns: int = 77) -> Frames:
    rng = np.random.default_rng(bits)
    width = columns if bits == 8 else -(-columns // 8)
    images = rng.integers(0, 256, (5, 9, width), dtype=np.uint8)
    if bits == 1:
        images = np.packbits(np.unpackbits(images, axis=2, count=columns), axis=2)
    return Frames(device.upload(images, table=True), bits=bits, gray=LINEAR, scale=1.0, columns=columns)


@pytest.mark.parametrize("bits", [1, 8])
def test_planes_put_together_are_the_frames(device: Device, bits: int) -> None:
    frames = frames_of(device, bits)
    masks = FocusMasks(77, 0.1, 3.5, (-3.0, -2.0, -1.0))
    source = DevicePacker.of(frames, masks=masks, row_bytes=16, batch=4)
    assert source.shape == (bits, 9, 16) and source.frames == 15
    out = pinned_buffers(1, (4, *source.shape), device)[0]
    source.read(np.array([7, -1, 2]), out)
    pixels = np.unpackbits(out, axis=-1)
    weights = 2 ** np.arange(bits - 1, -1, -1)
    levels = (pixels * weights[:, None, None]).sum(axis=1)
    wanted = np.zeros((4, 9, 128), np.int64)
    wanted[0, :, :77] = frames.levels()[2] * masks.of_frames(frames)[1]
    wanted[2, :, :77] = frames.levels()[0] * masks.of_frames(frames)[2]
    assert np.array_equal(levels, wanted)


def test_focus_planes_share_out_every_pixel_once(device: Device) -> None:
    frames, masks = frames_of(device, 8), FocusMasks(77, 0.1, 3.5, (-3.0, -2.0, -1.0))
    source = DevicePacker.of(frames, masks=masks, batch=3)
    out = pinned_buffers(1, (3, *source.shape))[0]
    source.read(np.arange(6, 9), out)
    assert not (out[0] & out[1]).any() and not (out[1] & out[2]).any()
    whole = DevicePacker.of(frames, batch=3)
    alone = pinned_buffers(1, (3, *whole.shape))[0]
    whole.read(np.array([2]), alone)
    assert np.array_equal(out[0] | out[1] | out[2], alone[0]) and not alone[1:].any()


@pytest.mark.parametrize("bits", [1, 8])
def test_small_frames_go_to_the_middle(device: Device, bits: int) -> None:
    frames = frames_of(device, bits)
    source = DevicePacker.of(frames, row_bytes=16, batch=1, size=(12, 93))
    out = pinned_buffers(1, (1, *source.shape))[0]
    source.read(np.array([3]), out)
    shown = np.packbits(np.unpackbits(out[0], axis=-1), axis=0, bitorder="big")  # planes to levels
    levels = np.zeros((12, 128), np.uint8)
    levels[1:10, 8:85] = frames.levels()[3]
    assert np.array_equal(shown[0] >> (8 - bits), levels)
    with pytest.raises(WrongDevice, match="77 pixels, the mirrors 12 × 64"):
        DevicePacker.of(frames, size=(12, 64))


def test_a_source_refuses_what_it_has_not() -> None:
    frames = Frames.from_bytes(np.zeros((2, 4, 64), np.uint8), "numpy", bits=8, gray=LINEAR, scale=1.0, columns=64)
    with pytest.raises(BadInput, match="row_bytes"):
        DevicePacker.of(frames, row_bytes=12)
    source = DevicePacker.of(frames, batch=2)
    with pytest.raises(BadInput, match="there are 2"):
        source.read(np.array([2]), np.zeros((2, *source.shape), np.uint8))
    with pytest.raises(ShapeMismatch):
        source.read(np.array([0]), np.zeros((1, *source.shape), np.uint8))
    with pytest.raises(BadInput, match="frames 0 to 2"):
        UploadQueue(source, np.array([0, 1, 2]), Mirrors(), VirtualClock())


# ---- ring --------------------------------------------------------------------------------------------------
@given(st.lists(st.booleans(), max_size=60), st.integers(2, 5))
def test_a_ring_keeps_order_and_never_holds_more_than_it_may(steps: list[bool], capacity: int) -> None:
    ring, wrote, read = BufferRing(pinned_buffers(capacity, (1, 1))), 0, 0
    for fill in steps:
        if fill:
            buffer = ring.claim()
            assert (buffer is None) == (wrote - read == capacity)
            if buffer is not None:
                buffer[0] = wrote % 251
                ring.commit(Batch(wrote, buffer))
                wrote += 1
        else:
            head = ring.head()
            assert (head is None) == (wrote == read)
            if head is not None:
                assert head.first == read and head.frames[0, 0] == read % 251
                ring.release()
                read += 1
    assert ring.fill == wrote - read


def test_a_closed_ring_lets_everybody_go() -> None:
    ring = BufferRing(pinned_buffers(2, (1, 1)))
    waiting = threading.Thread(target=lambda: ring.head(1e6), daemon=True)
    waiting.start()
    ring.close()
    waiting.join()
    assert ring.claim() is None
    with pytest.raises(BadInput):
        ring.release()
    with pytest.raises(BadInput):
        BufferRing(pinned_buffers(1, (1, 1)))


def test_buffers_lie_on_pages_of_their_own_and_are_used_again() -> None:
    made = pinned_buffers(3, (2, 8, 5, 7))
    assert all(each.ctypes.data % 4096 == 0 and each.flags.c_contiguous and each.flags.writeable for each in made)
    mirrors, seen = Mirrors(), set()
    feed = UploadQueue(numbered(40), np.arange(40), mirrors, VirtualClock(), batch=4, depth=3)
    while not feed.done:
        feed.pump()
        head = feed.ring.head()
        seen.add(head.frames.ctypes.data if head else 0)
        mirrors.trigger(4)
    assert len(seen - {0}) <= 3


# ---- feed --------------------------------------------------------------------------------------------------
@given(st.lists(st.integers(0, 9), max_size=80), st.integers(1, 5), st.integers(2, 4), st.integers(0, 60))
@settings(deadline=None)
def test_frames_arrive_once_and_in_order(triggers: list[int], batch: int, depth: int, count: int) -> None:
    order = np.arange(count)[::-1].copy()
    mirrors = Mirrors()
    feed = UploadQueue(numbered(count), order, mirrors, VirtualClock(), batch=batch, depth=depth)
    for number in triggers:
        feed.pump()
        assert feed.uploaded - mirrors.shown() <= 2 * batch and feed.made - feed.uploaded <= depth * batch
        mirrors.trigger(min(number, feed.uploaded - mirrors.shown()))
    got = np.array(mirrors.taken, np.int64).ravel()
    assert np.array_equal(got, order[: feed.uploaded] + 1)


def test_it_is_primed_when_mirrors_and_ring_are_full() -> None:
    mirrors = Mirrors()
    feed = UploadQueue(numbered(100), np.arange(100), mirrors, VirtualClock(), batch=5, depth=4)
    assert not feed.primed
    feed.pump()
    assert feed.primed and feed.uploaded == 10 and feed.made == 30 and not feed.done
    short = UploadQueue(numbered(3), np.arange(3), Mirrors(), VirtualClock(), batch=5)
    short.pump()
    assert short.primed and short.done


def test_a_late_frame_is_black_and_never_comes_after_its_slot() -> None:
    mirrors, clock = Mirrors(), VirtualClock()
    feed = UploadQueue(numbered(12), np.arange(12), mirrors, clock, batch=4, depth=2)
    feed.make()
    feed.upload()
    clock.sleep(7)
    assert [feed.black(), mirrors.shown()] == [4, 0]
    mirrors.trigger(4)
    assert feed.black() == 5
    mirrors.trigger(2)
    clock.sleep(5)
    while not feed.done:
        feed.pump()
        mirrors.trigger(feed.uploaded - mirrors.shown())
    shown = np.array(mirrors.taken).ravel().tolist()
    assert shown == [1, 2, 3, 4, 0, 0, 7, 8, 9, 10, 11, 12]
    assert feed.late == {4, 5}
    assert (np.diff(feed.arrived) >= 0).all()


def test_threads_bring_the_same(clock: Clock | None = None) -> None:
    count = 300
    mirrors = Mirrors(batches=1000)
    feed = UploadQueue(numbered(200), np.arange(count) % 200, mirrors, clock or RealClock(), batch=8, depth=3)
    feed.start()
    waited = threading.Event()
    while not feed.done:
        feed.check()
        waited.wait(0.001)
    feed.stop()
    assert feed.done and np.array_equal(np.array(mirrors.taken).ravel(), np.arange(count) % 200 + 1)


def test_what_a_thread_fails_with_is_raised_where_the_print_runs() -> None:
    class Broken(Numbered):
        def planes(self, numbers: np.ndarray) -> np.ndarray:
            raise ZeroDivisionError("no frames today")

    feed = UploadQueue(PlanePacker(Broken(), (1, 1), 4), np.arange(4), Mirrors(), RealClock())
    feed.start()
    for thread in threading.enumerate():
        if thread.name == "frames pack":
            thread.join()
    with pytest.raises(VamError, match="no frames today"):
        feed.check()
    feed.stop()


# ---- under-run ---------------------------------------------------------------------------------------------
@given(st.lists(st.integers(0, 200), min_size=1, max_size=40))
def test_a_web_bears_two_lost_poses_in_any_window(steps: list[int]) -> None:
    policy, poses = WebLatePolicy(window=360, allowed=2), np.cumsum(steps)
    for number, pose in enumerate(poses):
        lost = {int(p) for p in poses[: number + 1] if p > pose - 360}
        assert policy.drop(int(pose)) == (len(lost) > 2)


@given(st.integers(2, 12), st.sets(st.integers(0, 60)))
def test_a_vial_repeats_every_frame_once_and_bears_less_than_a_turn_in_a_row(images: int, poses: set[int]) -> None:
    policy, row = VialLatePolicy(images), 0
    for pose in sorted(poses):
        row = row + 1 if pose - 1 in poses else 1
        assert policy.drop(pose) == (row >= images)
    assert policy.pending_repeats() == Counter(pose % images for pose in poses)
    assert not policy.pending_repeats(), "asking settles it"


@given(st.integers(2, 12), st.lists(st.integers(0, 40)), st.lists(st.integers(41, 60)))
def test_black_that_never_came_is_not_counted(images: int, came: list[int], never: list[int]) -> None:
    """Nor does it matter that several focus planes of a pose were black."""
    for make in (lambda: VialLatePolicy(images), lambda: WebLatePolicy(window=30, allowed=2)):
        policy, other = make(), make()
        for pose in sorted(came):
            assert policy.drop(pose) is other.drop(pose)
        for pose in sorted(never):
            policy.drop(pose)
        for pose in sorted(never, reverse=True):
            policy.undo_drop(pose)
        assert policy.pending_repeats() == other.pending_repeats()
        assert policy.drop(61) is other.drop(61) and policy.pending_repeats() == other.pending_repeats()


# ---- preflight ---------------------------------------------------------------------------------------------
def test_preflight_chooses_where_frames_live_or_refuses_with_numbers() -> None:
    mirrors = MirrorTiming(memory=31069)
    long = web(7639, advance=0.0785398, speed=0.8, engines=mirrors, focus=())
    short = web(3000, advance=0.0785398, speed=0.8, engines=mirrors, focus=())
    assert preflight(short, mirrors, 1e6).residence is Residence.RESIDENT
    found = preflight(long, mirrors, 400e6, batch=16, depth=8)
    assert found.residence is Residence.STREAMED and found.planes == (7639 + PREROLL) * 8
    assert found.demand == pytest.approx(0.8 / 0.0785398 * 8 * 1080 * 256)
    assert found.freeze == pytest.approx(16 * 0.0785398 / 0.8) and found.stall == pytest.approx(9 * found.freeze)
    assert preflight(long, mirrors, 1e6, bits=1).residence is Residence.RESIDENT
    with pytest.raises(TimingInfeasible, match="MB/s") as refused:
        preflight(long, mirrors, 20e6)
    slower = web(7639, advance=0.0785398, speed=refused.value.speed, engines=mirrors)
    assert 20e6 / (slower.rate * mirrors.nbytes(8)) == pytest.approx(MARGIN)
    assert refused.value.limit == "data link"
    with pytest.raises(TimingInfeasible, match="smaller batches"):
        preflight(long, mirrors, 1e9, memory=100)


def test_bandwidth_is_what_the_clock_says() -> None:
    clock = VirtualClock()
    speed = measure(lambda frames: clock.sleep(frames.nbytes * 4), np.zeros((8, 1000), np.uint8), clock, 2.0)
    assert speed == pytest.approx(250e6)
    with pytest.raises(BadInput):
        measure(lambda frames: None, np.zeros(0, np.uint8), clock)


def test_a_job_for_other_mirrors_is_refused() -> None:
    fits((1080, 1920), 1080, 1920)
    with pytest.raises(WrongDevice, match="1140 × 912"):
        fits((1080, 1920), 1140, 912)
    assert issubclass(WrongDevice, DeviceError)
