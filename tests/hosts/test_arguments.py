"""What is no number, no machine or no path is told as such, with what was wanted; never by accident deep inside."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceError, JobError, WrongDevice
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.records.record import RunFolder
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.rig import check, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.config import parse_rig
from vamgpu.hosts.rigs.preflight import judged, measure, preflight
from vamgpu.hosts.safety.interlock import Budget, Lease, OverDose
from vamgpu.hosts.schedules.limits import HdmiTiming, LensTiming, MirrorTiming, powers
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.timing import SECOND, Cadence, exact, nanoseconds, whole
from vamgpu.hosts.schedules.video import vial
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

ODD: Any = None
SPEED = r"expected an angular speed in deg/s, °/s, rpm, rad/s, not 'mm/s': write it like .40 deg/s"
HUGE = 10**400
MIRRORS = MirrorTiming()
WEB: dict[str, Any] = {"poses": 5, "advance": 1, "speed": 1, "engines": MIRRORS, "lens": LensTiming(), "focus": (1, 2)}
TURNED: dict[str, Any] = {"images": 36, "speed": 40, "engines": MIRRORS}
VIAL: dict[str, Any] = {"images": 360, "speed": 40, "display": HdmiTiming()}
NUMBERS = (None, "1", float("nan"), float("inf"), HUGE, -1, 1j, [1], b"1")
COUNTED = (*NUMBERS, 0, 0.5, True)


def cases() -> list[tuple[Callable[..., Any], dict[str, Any], str, Any]]:
    """What is called, with what that is right, and which argument is wrong how."""
    wrong: list[tuple[Callable[..., Any], dict[str, Any], str, tuple[Any, ...]]] = []
    for make, right, count in ((web, WEB, "poses"), (turned, TURNED, "images"), (vial, VIAL, "images")):
        wrong += [(make, right, count, COUNTED), (make, right, "speed", (*NUMBERS, 0, 1e-310, 1e308))]
        wrong += [(make, right, "power", (None, "1", 1.1, -0.1, float("nan"), (), (0.5, None), HUGE, True))]
    for make, right in ((web, WEB), (turned, TURNED)):
        wrong += [(make, right, "engines", (None, 1, (), (None,), "mirrors", HdmiTiming()))]
        wrong += [(make, right, "bits", (None, "8", [8], 8.5)), (make, right, "on", ("1", float("inf"), -1, 0, 1e9))]
    wrong += [
        (web, WEB, "lens", ("lens", 1)),
        (web, WEB, "focus", (None, (1, None), ("a", "b"), (float("nan"), 1.0), 3.0)), (web, WEB, "advance", NUMBERS),
        (turned, TURNED, "turns", COUNTED), (vial, VIAL, "turns", COUNTED), (web, WEB, "poses", (10**14,)),
        (vial, VIAL, "display", (None, MIRRORS)),
        (LensTiming, {}, "settle", (None, "1", -1, [1, 2], [None], [[None]], [], float("inf"), HUGE, 1e9)),
        (LensTiming, {}, "frame_bytes", COUNTED), (LensTiming, {}, "baud", COUNTED),
        (LensTiming, {}, "latency", NUMBERS),
        (MirrorTiming, {}, "frame", (None, {}, 1, {"8": 1}, {8: None}, {8: 0}, {0.5: 1}, [8])),
        (MirrorTiming, {}, "dark", NUMBERS), (MirrorTiming, {}, "memory", NUMBERS),
        (MirrorTiming, {}, "row_bytes", ("1", 0, -1, 0.5)), (MirrorTiming, {}, "pixels", (None, (1,), (0, 1))),
        (HdmiTiming, {}, "bits", (None, "8", 5, [8], 7.5, True)), (HdmiTiming, {}, "refresh", (*NUMBERS, 0)),
        (HdmiTiming, {}, "exposures", (None, (), (1e-3,), (None,) * 8, 1e-3)), (HdmiTiming, {}, "dark", NUMBERS),
        (HdmiTiming, {}, "latency", (*NUMBERS, 0.5)), (HdmiTiming, {}, "pixels", (None, (1,), (0, 1), "ab")),
        (Cadence, {}, "period", (None, "1", 0, 0.5, float("inf"))),
        (Lease, {"clock": VirtualClock(), "renew": print}, "length", (*COUNTED, SECOND // 1000)),
        (Budget, {}, "limit", (None, "1", float("inf"), float("nan"), 0, -1)),
    ]  # fmt: skip
    return [(make, right, name, value) for make, right, name, values in wrong for value in values]


def test_every_wrong_value_is_told() -> None:
    for make, right, name, value in cases():
        with pytest.raises(BadInput) as told:
            make(**(right | {name: value}))
            pytest.fail(f"{make.__name__}({name}={value!r}) is taken")
        assert type(told.value) is BadInput and "; " in str(told.value) and len(str(told.value)) < 300, told.value


def test_numbers_of_numpy_are_numbers() -> None:
    assert exact("x", np.int64(40)) == 40 and exact("x", np.float32(0.5)) == Fraction(1, 2)  # pyright: ignore
    assert exact("x", np.float64(0.1)) == Fraction(1, 10) == exact("x", 0.1)
    assert whole("x", np.uint8(200)) == 200 and type(whole("x", np.uint8(200))) is int  # pyright: ignore
    assert nanoseconds("x", np.int32(3)) == 3 * SECOND, "beyond the 32 bits that it came in"  # pyright: ignore
    plain = web(5, advance=1, speed=0.5, engines=MIRRORS, lens=LensTiming(0.25), focus=(1.0, 2.0), power=0.5)
    given: dict[str, Any] = {"poses": np.int64(5), "advance": np.int64(1), "speed": np.float32(0.5)}
    settle: Any = np.float32(0.25)
    given |= {"engines": [MIRRORS], "lens": LensTiming(settle), "focus": np.array([1.0, 2.0]), "power": np.float32(0.5)}
    other = web(**given)
    for name in ("command", "light", "on", "frame", "focus", "power"):
        assert np.array_equal(getattr(plain, name), getattr(other, name))
    assert powers(1, 2) == (1.0, 1.0) and powers(np.array([0.5, 0.25])) == (0.5, 0.25)  # pyright: ignore


def test_a_budget_gives_no_light_back() -> None:
    budget = Budget(1.0)
    budget.spend(0.75, SECOND)
    for power, on_time in ((-1.0, SECOND), (1.0, -SECOND), (float("nan"), SECOND), ("1", SECOND), (1.0, ODD)):
        with pytest.raises(BadInput):
            budget.spend(power, on_time)  # pyright: ignore
        with pytest.raises(BadInput):
            budget.allows(power, on_time)  # pyright: ignore
    assert budget.spent == 0.75
    budget.spend(0.0, 0)
    with pytest.raises(OverDose):
        budget.spend(0.5, SECOND)


@pytest.fixture
def job(tmp_path: Path) -> Path:
    images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    return save_frames(tmp_path / "part.vam", frames).path


def test_plans_want_a_rig_and_paths(job: Path) -> None:
    rig = read_rig("emulated")
    for other in (None, "lab.toml", rig.setup):
        with pytest.raises(BadInput, match="expected a rig from read_rig"):
            plan(job, other, turns=1)  # type: ignore[arg-type]
    for jobs in (None, 7, (job, None), [b"part"]):
        with pytest.raises(BadInput, match="expected"):
            plan(jobs, rig, turns=1)  # type: ignore[arg-type]
    for speed in (float("nan"), True, [1], HUGE, 1e308, 1e-308):
        with pytest.raises(BadInput):
            plan(job, rig, speed=speed, turns=1)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=SPEED):
        plan(job, rig, speed="40 mm/s", turns=1)
    for speed in ("9 rpm", "9rpm", "54 deg/s", "54 °/s", "54", 54, f"{0.3 * np.pi:.12f} rad/s"):
        assert float(plan(job, rig, speed=speed, turns=1).schedule.speed) == pytest.approx(54.0, rel=1e-9)
    for turns in (None, 0, 1.5, "1"):
        with pytest.raises(BadInput, match="turns"):
            plan(job, rig, turns=turns)  # type: ignore[arg-type]
    assert len(plan([job], rig, speed=np.float32(40), turns=np.int64(2)).schedule) == 72  # type: ignore[arg-type]


def test_rigs_want_a_path(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    for path in (None, 5, b"lab.toml", "la\0b", tmp_path / "latin.toml", tmp_path):
        with pytest.raises(JobError, match="expected a TOML file, or the word emulated"):
            read_rig(path)  # type: ignore[arg-type]
    with pytest.raises(JobError, match="expected the text"):
        parse_rig(ODD)


def test_machines_are_checked_for_their_number_and_their_time(job: Path) -> None:
    planned = plan((job, job), read_rig("emulated"), turns=1)
    machines = rehearsal(planned).machines
    for seconds in (None, "1", float("inf"), 0, -1):
        with pytest.raises(BadInput, match="seconds"):
            check(planned, machines, seconds)  # type: ignore[arg-type]
    one = replace(machines, mirrors=machines.mirrors[:1])  # type: ignore[union-attr]
    with pytest.raises(WrongDevice, match="plan is for 2 mirrors, 1 were opened"):
        check(planned, one)
    assert check(planned, machines) is not None


def test_a_look_at_the_wires_wants_something_to_look_at(job: Path) -> None:
    planned = plan(job, read_rig("emulated"), turns=1)
    with pytest.raises(BadInput, match="got 0 mirrors"):
        judged(planned.schedule, [], VirtualClock())
    for seconds in (None, "1", float("inf")):
        with pytest.raises(BadInput, match="seconds"):
            measure(lambda frames: None, np.zeros((1, 9), np.uint8), VirtualClock(), seconds)  # type: ignore[arg-type]
    for wrong in ({"measured": None}, {"measured": "1"}, {"bits": None}, {"batch": 0}, {"depth": 0.5}):
        with pytest.raises(BadInput, match="expected"):
            preflight(planned.schedule, MIRRORS, **({"measured": 1e6} | wrong))  # type: ignore[arg-type]


def test_a_panel_is_told_where_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[socket.socket] = []

    class Kept(socket.socket):
        def __init__(self, *rest: Any) -> None:
            super().__init__(*rest)
            opened.append(self)

    monkeypatch.setattr(socket, "socket", Kept)
    wrong = {
        "host": (None, 7), "port": ("8521", None, 70000, -1, 80.5, HUGE, True), "token": (12345, b"0" * 16, "short"),
        "board": (None, "board"),
    }  # fmt: skip
    for name, values in wrong.items():
        for value in values:
            with pytest.raises(BadInput, match=f"the panel's {name}"):
                Panel(**({"board": Board(), "page": False} | {name: value}))
    assert not opened
    for host in ("256.1.1.1", "a\0b", "a" * 100):
        with pytest.raises(DeviceError, match="another host or port"):
            Panel(Board(), host)
    assert opened and all(each.fileno() < 0 for each in opened), "none is left open"


def test_a_folder_is_not_made_for_what_it_cannot_keep(tmp_path: Path) -> None:
    place, endless = tmp_path / "run", {}
    endless["again"] = endless
    keepless = ({"at": place}, None, 7, {(1, 2): 3}, endless)
    for asked, rig in [(asked, "") for asked in keepless] + [({}, None), ({}, "\ud800")]:
        with pytest.raises(BadInput, match="cannot store the request"):
            RunFolder.begin(place, asked, rig)  # type: ignore[arg-type]
        assert not place.exists()
    with pytest.raises(BadInput, match="expected a path"):
        RunFolder.begin(ODD, {}, "")
    RunFolder.begin(place, {"job": "boat"}, "").close()
