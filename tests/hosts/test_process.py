"""A process of its own holds the light: mirrored, found again, stopped, and survived by nobody's light."""

from __future__ import annotations

import dataclasses
import gc
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from multiprocessing import Pipe
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.process import messages
from vamgpu.hosts.process.messages import LIVE
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.process.service import ServedBoard, Service
from vamgpu.hosts.process.watch import LightProcessLost, Watch, attached, may_begin, started, watched
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board, PrintState, Snapshot, WrongState
from vamgpu.hosts.rigs.config import parse_rig, read_rig
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.reading import parse_json

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are stopped by signals of POSIX")
FORBIDDEN = {"nicegui", "matplotlib", "trimesh", "scipy", "uvicorn", "fastapi", "skimage", "rich", "cyclopts"}


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A vial of 36 frames."""
    images = np.random.default_rng(0).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    return save_frames(tmp_path / "part.vam", frames).path


def test_a_folder_from_elsewhere_contacts_no_other_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(messages.os.path, "exists", lambda place: asked.append(place) or True)
    own = r"\\.\pipe\pyc-1-0-a"
    for place in (r"\\host\pipe\a", r"\\.\pipe\..\UNC\host\a", r"\\.\UNC\host\a", own):
        (tmp_path / LIVE).write_text(json.dumps({"address": place}))
        assert messages.running(tmp_path) is (place == own)
    assert asked == [own]
    with pytest.raises(StorageError, match="expected the name of a socket"):
        Watch({"address": r"\\host\pipe\a", "key": "00", "pid": 5}, Board())


def order(job: Path, turns: int = 1, **rest: Any) -> PrintOrder:
    """A rehearsal that keeps pace, patient with a busy machine."""
    rig = read_rig("emulated", ["safety.lease=1 s"])
    given: dict[str, Any] = {"speed": 180.0, "unattended": 50, "page": True, **rest}
    return PrintOrder.of((job,), rig, job.parent / "run", turns=turns, **given)


def until(what: Callable[[], Any], watch: Watch) -> None:
    """Wait for something that comes before the print's end."""
    while not what():
        assert not watch.wait(0.01), (watch.end, watch.board.now)


def ended(watch: Watch) -> dict[str, Any]:
    return watched(watch, lambda name, text: None, None)


def lit(watch: Watch) -> None:
    until(lambda: watch.board.now.light and watch.board.now.slot > 0, watch)


@pytest.mark.slow
def test_a_print_in_another_process_is_mirrored_and_recorded(job: Path) -> None:
    board, told = Board(job="part"), list[str]()
    with started(order(job), board) as watch:
        watch.viewed(watch.order.planned())
        lit(watch)
        live = parse_json((job.parent / "run" / LIVE).read_bytes())
        assert live["pid"] == watch.pid != os.getpid()
        assert (job.parent / "run" / LIVE).stat().st_mode & 0o077 == 0, "only this user may stop it"
        with pytest.raises(BadInput, match="--attach"):
            may_begin(job.parent / "run")
        until(lambda: board.now.preview is not None, watch)
        end = watched(watch, lambda name, text: told.append(name), None)
    assert end["state"] == board.now.state.value == "complete" and told == ["preflight"]
    assert (board.now.job, board.now.slot, board.now.slots, board.now.light) == ("part", 35, 36, False)
    assert end["levels"][0].shape == (36, 6, 10)
    run = read_run(job.parent / "run")
    process = next(event for event in run.events if event["event"] == "process")
    assert all(process[name] for name in ("schedule", "memory", "garbage")) and len(run.shown) == 36
    assert not (job.parent / "run" / LIVE).exists()
    may_begin(job.parent / "run")
    with pytest.raises(StorageError, match="no process prints"):
        attached(job.parent / "run", Board())


def test_the_process_imports_nothing_that_draws_or_serves(job: Path) -> None:
    code = (
        "import json, sys\n"
        "import vamgpu.hosts.process.__main__\n"
        "from vamgpu.hosts.process.order import PrintOrder, printed\n"
        "from vamgpu.hosts.rig import rehearsal\n"
        "from vamgpu.hosts.records.state import Board\n"
        "order = PrintOrder.parse(json.loads(sys.argv[1]))\n"
        "planned = order.planned()\n"
        "end = printed(order, planned, rehearsal(planned), Board(), told=lambda *_: None, go_on=lambda _: False)\n"
        "print(end['state'], *{name.partition('.')[0] for name in sys.modules})\n"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    asked = [sys.executable, "-c", code, json.dumps(asdict(order(job)))]
    state, *modules = subprocess.run(asked, env=env, capture_output=True, check=True, text=True).stdout.split()
    assert state == "complete" and not FORBIDDEN & set(modules)


def test_the_process_of_a_real_print_loads_no_emulator() -> None:
    code = (
        "import sys\nimport vamgpu.hosts.process.__main__\n"
        "print(*(name for name in sys.modules if name.startswith('vamgpu.hosts.emulators')))\n"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    asked = [sys.executable, "-c", code]
    told = subprocess.run(asked, env=env, capture_output=True, check=True, text=True).stdout.split()
    assert not told


@pytest.mark.slow
def test_buttons_of_a_page_that_came_later_act_there_and_their_errors_come_back(job: Path) -> None:
    with started(order(job, turns=20, page=False), Board()) as watch:
        lit(watch)
        with attached(job.parent / "run", board := Board()) as later:
            until(lambda: "resume" in board.buttons, later)
            with pytest.raises(WrongState, match="only a paused or held"):
                board.buttons["resume"]()
            board.buttons["pause"]()
            until(lambda: board.now.state is PrintState.PAUSED and board.now.deadline, later)
            board.buttons["resume"]()
            until(lambda: board.now.state is PrintState.PRINTING, later)
            assert board.now.deadline is None
            board.buttons["cancel"]()
            assert ended(watch)["state"] == "cancelled"
    assert read_run(job.parent / "run").state is PrintState.CANCELLED


def test_a_stop_is_dark_and_cancels(job: Path) -> None:
    with started(order(job, turns=50), board := Board()) as watch:
        lit(watch)
        board.stop("pressed")
        assert ended(watch)["state"] == "cancelled"
    run = read_run(job.parent / "run")
    assert (run.state, run.message) == (PrintState.CANCELLED, "pressed")


def test_a_stop_waits_for_no_full_pipe_and_no_button_that_hangs() -> None:
    service, stops, hanging, leave = served(), list[str](), threading.Event(), threading.Event()

    def hang() -> None:
        hanging.set()
        leave.wait(60)

    service.board.on_stop(stops.append)
    service.board.button("pause", hang)
    live = json.loads(service.live)
    deaf: Any = Client(live["address"], authkey=bytes.fromhex(live["key"]))
    messages.send(deaf, {"do": "watch"})  # and reads nothing
    service.board.show(preview=np.zeros((4000, 4000), np.uint8))
    with Watch(live, board := Board()) as watch:
        until(lambda: "pause" in board.buttons, watch)
        press = threading.Thread(target=board.buttons["pause"])
        press.start()
        hanging.wait(60)
        board.stop("pressed")
        assert stops == ["pressed"] and press.is_alive()
        leave.set()
        press.join(60)
        deaf.close()
        service.close({"state": "cancelled"})
        assert ended(watch) == {"state": "cancelled"}


@pytest.mark.slow
def test_a_process_that_hangs_is_ended_by_a_stop(job: Path) -> None:
    with started(order(job, turns=50), board := Board()) as watch:
        lit(watch)
        os.kill(watch.pid, signal.SIGSTOP)
        with pytest.raises(LightProcessLost, match="did not answer"):
            board.stop("pressed")
        with pytest.raises(LightProcessLost, match="lease switches the light off"):
            ended(watch)


@pytest.mark.slow
def test_a_process_that_dies_leaves_a_print_that_is_held(job: Path) -> None:
    with started(order(job, turns=50), board := Board()) as watch:
        lit(watch)
        os.kill(watch.pid, signal.SIGKILL)
        with pytest.raises(LightProcessLost, match="lease switches the light off.*--resume"):
            ended(watch)
    assert board.now.state is PrintState.HELD and not board.now.light
    assert read_run(job.parent / "run").state is PrintState.PRINTING, "the folder tells what the process knew"
    with pytest.raises(StorageError, match="--resume"):
        attached(job.parent / "run", Board())


@pytest.mark.slow
def test_a_print_outlives_its_parent_and_is_found_again(job: Path) -> None:
    code = (
        "import json, os, signal, sys\n"
        "from vamgpu.hosts.process.order import PrintOrder\n"
        "from vamgpu.hosts.process.watch import started\n"
        "from vamgpu.hosts.records.state import Board\n"
        "board = Board()\n"
        "watch = started(PrintOrder.parse(json.loads(sys.argv[1])), board)\n"
        "while not (board.now.light and board.now.slot):\n"
        "    watch.wait(0.01)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    asked = order(job, turns=3)
    parent = subprocess.run([sys.executable, "-c", code, json.dumps(asdict(asked))], env=env, check=False)
    assert parent.returncode == -signal.SIGKILL
    with attached(asked.folder, board := Board()) as watch:
        assert watch.order == asked and ended(watch)["state"] == "complete"
    run = read_run(asked.folder)
    assert run.state is PrintState.COMPLETE and len(run.shown) == 108 and board.now.slot == 107


def test_errors_before_the_light_come_back_as_they_are(job: Path) -> None:
    with started(order(job / "none"), Board()) as watch, pytest.raises(StorageError, match="is not a job"):
        ended(watch)


def test_whether_a_lease_closes_the_light_depends_on_who_gates_it(job: Path) -> None:
    box = '[rig]\nname = "lab"\nmachine = "vial"\n[controller]\nport = "/dev/none"\n[display]\ndriver = "video"\n'
    box += '[motion]\ndriver = "zaber"\nport = "/dev/none"\n'
    for light, leased in (("controller", True), ("display", False)):
        rig = parse_rig(f'{box}[light]\ndriver = "{light}"\n')
        asked = PrintOrder.of((job,), rig, job.parent / "run")
        assert asked.leased is leased


def test_a_process_that_fails_leaves_another_ones_address(tmp_path: Path) -> None:
    (tmp_path / LIVE).write_text("{}")
    service = Service(PrintOrder.of((Path("part"),), read_rig("emulated"), tmp_path))
    service.close({"error": "StorageError", "why": "the folder exists"})
    assert (tmp_path / LIVE).exists(), "of the process that prints there"


def served() -> Service:
    return Service(PrintOrder.of((Path("part"),), read_rig("emulated"), Path("nowhere"), asks=True))


def test_who_watches_is_asked_whether_a_held_print_goes_on() -> None:
    service, said = served(), list[bool]()
    assert not service.go_on(), "nobody watches"
    with Watch(json.loads(service.live), board := Board()) as watch:
        service.board.show(state=PrintState.HELD, message="a door")
        until(lambda: board.now.state is PrintState.HELD, watch)
        watch.answer(False)  # to a question that nobody asked yet
        asking = threading.Thread(target=lambda: said.append(service.go_on()))
        asking.start()
        while asking.is_alive():
            watch.answer(True)
            asking.join(0.05)
        service.board.button("cancel", lambda: None)
        asking = threading.Thread(target=lambda: said.append(service.go_on()))
        asking.start()
        while asking.is_alive():
            watch.press("cancel")
            asking.join(0.05)
        service.close({"state": "held"})
        assert said == [True, False] and ended(watch) == {"state": "held"}


def test_no_garbage_is_collected_in_the_light(tmp_path: Path) -> None:
    board, seen = ServedBoard(tmp_path, ""), dict[PrintState, bool]()
    try:
        for state in (PrintState.PRINTING, PrintState.HELD, PrintState.PRINTING, PrintState.COMPLETE):
            board.show(state=state)
            seen[state] = gc.isenabled()
    finally:
        gc.enable()
    assert seen == {PrintState.PRINTING: False, PrintState.HELD: True, PrintState.COMPLETE: True}


def test_snapshots_cross_with_every_field() -> None:
    here, there = Pipe()
    fields = {field.name: getattr(Snapshot(), field.name) for field in dataclasses.fields(Snapshot)}
    fields |= {"state": PrintState.HELD, "preview": np.arange(6, dtype=np.uint8).reshape(2, 3), "focus": float("inf")}
    messages.send(here, {"fields": fields, "many": [fields["preview"], np.float64(0.5), None]})
    got = messages.receive(there)
    made = Snapshot(**got["fields"])
    for name, value in fields.items():
        np.testing.assert_array_equal(getattr(made, name), value)
        assert type(getattr(made, name)) is type(value)
    assert got["many"][1:] == (0.5, None) and np.array_equal(got["many"][0], fields["preview"])


@pytest.mark.parametrize(
    "text", ["", "[]", '{"address": 3, "key": "00", "pid": 4}', '{"address": "/nowhere", "key": "00", "pid": 4}']
)
def test_what_a_folder_says_of_its_process_may_be_wrong(tmp_path: Path, text: str) -> None:
    (tmp_path / LIVE).write_text(text)
    with pytest.raises(StorageError):
        attached(tmp_path, Board())


def test_no_message_is_code() -> None:
    here, there = Pipe()
    for body in ({"kind": "Popen", "value": "id"}, {"array": "O", "shape": [1]}, {"kind": "Print"}):
        here.send_bytes(json.dumps({"arrays": 0, "body": {"a": body}}).encode())
        with pytest.raises((ValueError, KeyError)):
            messages.receive(there)
