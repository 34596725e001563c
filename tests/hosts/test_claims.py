"""Page, terminal and record of each rig of docs/rigs claim only what a machine answered for."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import needs
import pytest
from chances import NAMES, RIGS, RigStand

from vamgpu.errors import BadInput, DeviceError, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.lightcrafter import LightCrafter
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import VirtualPort
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.panel import Panel
from vamgpu.hosts.panel import server as panels
from vamgpu.hosts.player.machines import MirrorMachines, StageMachines, VideoMachines, inspect, within_travel
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import Board, PrintState, Snapshot
from vamgpu.hosts.rig import carry_out

ASKED = {"controller": "ask", "stage": "_exchange", "lens": "ask", "mirrors": "call", "projector": "ask"}
"""Machine → the method of its driver by which it answers."""


class Answers:
    """A print whose machines are listened to: which answered while the light was on, and the page's fields then."""

    def __init__(self, name: str, place: Path) -> None:
        self.stand, self.board = RigStand(name, place), Board(job="part.vam")
        self.answered, self.after, self.during = set[str](), set[str](), Snapshot()
        for machine, method in ASKED.items():
            found: Any = getattr(self.stand.stand.machines, machine, None)
            for each in found if isinstance(found, list) else [found]:
                if hasattr(each, method):
                    self._listen(machine, each, method)
        show = self.board.show

        def shown(**fields: object) -> None:
            show(**fields)
            now = self.board.now
            self.during = now if now.light and now.slot > 20 and not self.during.light else self.during

        self.board.show = shown  # type: ignore[method-assign]
        state = carry_out(self.stand.planned, self.stand.stand.machines, self.stand.run, self.board)[0]
        assert state is PrintState.COMPLETE and self.during.light

    def _listen(self, machine: str, driver: Any, method: str) -> None:
        ask = getattr(driver, method)

        def asked(*arguments: Any, **named: Any) -> Any:
            answer = ask(*arguments, **named)
            (self.answered if self.board.now.light else self.after if self.during.light else set[str]()).add(machine)
            return answer

        setattr(driver, method, asked)

    @property
    def claims(self) -> dict[str, dict[str, Any]]:
        """The table in the record, by what it is about."""
        return {one["about"]: one for one in read_run(self.stand.run).asked["guarantees"]}


@pytest.fixture(scope="module", params=NAMES)
def answers(request: Any, tmp_path_factory: pytest.TempPathFactory) -> Answers:
    return Answers(request.param, tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with pytest.MonkeyPatch.context() as patch, sync_playwright() as tools:
        patch.setattr(panels, "STARTING", 200.0)
        yield needs.page(tools)


def test_each_claim_of_the_record_has_a_machine_that_answered(answers: Answers) -> None:
    for about, one in answers.claims.items():
        assert one["holds"] is (one["kind"] in ("guaranteed", "watched")) is bool(one["sensor"]), about
        assert not one["holds"] or one["sensor"] in answers.answered, f"{about}: {one['sensor']} said nothing"
    assert {"step", "display", "position", "scale", "light", "lease", "interlock", "lamp"} <= set(answers.claims)
    assert ("lens" in answers.claims) is ("lens" in answers.answered) is ("lens" in answers.after), "also at the end"


def test_the_terminal_shows_the_table_of_the_record(answers: Answers) -> None:
    told = dict(answers.stand.planned.lines())
    assert told["machines"].startswith("emulated")
    for about, one in answers.claims.items():
        assert told[about] == f"{one['kind']}: {one['why']}"


def test_the_board_has_values_only_of_machines_that_answered(answers: Answers) -> None:
    now, claims = answers.during, answers.claims
    assert now.rehearsed and [dict(one) for one in now.guarantees] == list(claims.values())
    assert (now.lease is not None) is claims["lease"]["holds"]
    assert (now.interlock_closed is not None) is claims["interlock"]["holds"]
    assert (now.focus is not None) is (now.lens_temperature is not None) is ("lens" in claims)


def test_the_page_draws_no_more(answers: Answers, page: Any) -> None:
    fresh = {"polled": time.monotonic() + 1e6, "renewed": answers.during.renewed and 0.01}
    board, claims = Board(**(vars(answers.during) | fresh)), answers.claims
    with Panel(board) as panel:
        page.goto(panel.url)
        by = page.get_by_test_id
        by("light").get_by_text("ON at").wait_for()
        values = {name: by(name).inner_text() for name in ("light", "position", "interlock", "lease", "dry run")}
        assert by("lens").count() == ("lens" in claims)
    assert values["dry run"].startswith("DRY RUN") and "emulated" in values["light"]
    assert ("no machine reports it" in values["light"]) is not claims["light"]["holds"]
    assert ("by counted steps" in values["position"]) is not claims["position"]["holds"]
    for about in ("interlock", "lease"):
        assert ("not there" in values[about]) is (claims[about]["kind"] == "not there"), values[about]
        assert claims[about]["holds"] or not re.search("closed|light off", values[about])


def test_a_lens_that_a_rehearsal_does_not_emulate_vouches_for_nothing(tmp_path: Path) -> None:
    from test_planning import vial

    from vamgpu.hosts.rig import plan, read_rig, rehearsal

    planned = plan(vial(tmp_path / "job.vam", images=36), read_rig("emulated"), turns=1)
    machines: Any = rehearsal(planned).machines
    assert machines.lens is None and "lens" not in dict(planned.lines())


def test_every_rig_file_is_read_here() -> None:
    assert {path.stem for path in RIGS.glob("*.toml")} == set(NAMES)


# ---- machines that are asked ---------------------------------------------------------------------------------------
def stage(machine: EmulatedStage, microsteps: float, unit: str = "deg", encoder: bool = False) -> ZaberStage:
    return ZaberStage(Wire(VirtualPort(machine, VirtualClock(), 0.02), "the stage"), microsteps, unit, encoder=encoder)


def turning(cycle: int) -> EmulatedStage:
    machine = EmulatedStage(rotary=True)
    machine.settings["limit.cycle.dist"] = cycle
    return machine


def test_microsteps_that_are_not_those_of_the_stage_are_refused() -> None:
    assert stage(turning(768_000), 768_000 / 360).turn() == 768_000
    with pytest.raises(WrongDevice, match=r"768000 microsteps per turn.*expected 4266.6667.*= 2133.33") as told:
        stage(turning(768_000), 2 * 768_000 / 360)
    stage(turning(768_000), float(str(told.value).rpartition("microsteps = ")[2]))
    assert stage(turning(0), 1234.5).turn() == 0, "a linear stage has no turn"


def test_an_encoder_of_the_file_that_is_not_there_is_refused() -> None:
    with pytest.raises(WrongDevice, match=r"has no encoder .*set encoder = false"):
        stage(turning(360_000), 1000.0, encoder=True)
    machine = turning(360_000)
    machine.encoder, machine.scale = True, 0.9
    found = stage(machine, 1000.0, encoder=True)
    machine.track.set_position(0, 10_000)
    assert found.position() == pytest.approx(9.0), "where the encoder is, not the steps"


def test_a_stage_that_tells_no_position_is_not_blamed_for_an_encoder() -> None:
    machine = turning(360_000)
    act = machine._act
    machine._act = lambda words, now: (False, "BADDATA") if words == ["get", "pos"] else act(words, now)
    with pytest.raises(DeviceRefused, match="BADDATA"):
        stage(machine, 1000.0)


def test_a_web_stays_within_the_travel_that_its_stage_tells(tmp_path: Path) -> None:
    from test_planning import web
    from test_stage_mirrors import RIG

    from vamgpu.hosts.rig import check, plan, read_rig, rehearsal
    from vamgpu.hosts.rigs.config import parse_rig

    film = web(tmp_path / "web.vam", None)
    advance = float(plan(film, read_rig("emulated"), speed=0.8).schedule.advance)
    rig = parse_rig(RIG.replace("microsteps = 1000", f"microsteps = {1000 / advance!r}"))
    planned = plan(film, rig, speed=0.8, rehearsed=True)
    stand = rehearsal(planned)
    within_travel(planned.schedule, stand.machines)
    per_mm = 1000 / advance
    stand.emulated.stage.settings |= {"limit.min": 0, "limit.max": round(30 * per_mm)}
    with pytest.raises(BadInput, match=r"the web moves from -1.6 to .* goes from 0 to 30 mm"):
        check(planned, stand.machines)


def test_a_projector_that_lost_its_video_or_its_light_is_told() -> None:
    from emulated_lightcrafter import EmulatedLightCrafter

    from vamgpu.hosts.drivers import dlpc350_protocol as dlpc350

    machine = EmulatedLightCrafter()
    box = LightCrafter(machine, pause=lambda _: None)
    box.show_video((1, 0), 8, 8333, 8333, "blue")
    box.inspect()
    box.on()
    box.inspect()
    machine.settings[dlpc350.LED_ENABLE] = b"\0"
    with pytest.raises(DeviceError, match="LEDs are off, and should be on"):
        box.inspect()
    box.on()
    machine.locked = False
    with pytest.raises(DeviceError, match="patterns do not run"):
        box.inspect()


def test_lamp_and_lens_are_asked_on_every_kind_of_rig() -> None:
    lens = SimpleNamespace(inspect=lambda: 1.25)
    kinds: tuple[Any, ...] = MirrorMachines, StageMachines, VideoMachines
    for kind in kinds:
        asked = list[str]()
        lamp = SimpleNamespace(inspect=lambda asked=asked: asked.append("lamp"))
        has = {field.name: None for field in fields(kind)} | {"lens": lens}
        machines = kind(**has | ({"lamp": lamp} if "lamp" in has else {}))
        assert inspect(machines) == {"focus": 1.25} and (asked == ["lamp"]) is ("lamp" in has)


def test_a_lamp_that_goes_out_in_the_last_half_second_is_in_the_record(tmp_path: Path) -> None:
    from test_mending import CABLE
    from test_planning import vial

    from vamgpu.hosts.rig import plan, rehearsal
    from vamgpu.hosts.rigs.config import parse_rig

    planned = plan(vial(tmp_path / "job.vam", images=36), parse_rig(CABLE), turns=2, rehearsed=True)
    machines: Any = rehearsal(planned).machines
    board, slots, lit, asked = Board(), len(planned.schedule), list[bool](), list[int]()

    def look() -> None:
        asked.append(board.now.slot)
        if lit[-1] and asked.count(slots - 2) > 1:  # it answered well half a second ago at most
            raise DeviceError("the LEDs are off, and should be on")

    machines.lamp = SimpleNamespace(on=lambda power: lit.append(True), off=lambda: lit.append(False), inspect=look)
    assert carry_out(planned, machines, tmp_path / "run", board)[0] is PrintState.INCOMPLETE
    assert "LEDs are off" in board.now.message
    (unseen,) = [event for event in read_run(tmp_path / "run").events if event["event"] == "unseen"]
    assert slots - 4 < unseen["first"] < slots == unseen["stop"]


def test_a_stage_that_is_wrong_by_two_gets_no_light(tmp_path: Path) -> None:
    stand = RigStand("vialux_zaber", tmp_path)
    machines: Any = stand.stand.machines
    stand.emulated.stage.settings["limit.cycle.dist"] *= 2
    with pytest.raises(WrongDevice, match="every angle would be wrong"):
        stand.emulated.machines(machines.microsteps)


def test_a_lens_that_dies_holds_the_print_and_is_revived(tmp_path: Path) -> None:
    stand = RigStand("roll_bench", tmp_path)
    machines: Any = stand.stand.machines
    port = machines.lens._wire.port
    events, board = list[str](), Board()
    stand.clock.sleep(0)

    class Dies:
        """Pulls the lens's plug once in the midst, and puts it back while the print is held."""

        def go_on(self, job: Any) -> bool:
            events.append(job.states.message)
            port.replug()
            machines.lens._wire.reopen()
            return len(events) < 2

    show = board.show

    def shown(**fields: object) -> None:
        show(**fields)
        if not events and board.now.light and board.now.slot == 30 and not port._unplugged:
            port.unplug()

    board.show = shown  # type: ignore[method-assign]
    state = carry_out(stand.planned, machines, stand.run, board, go_on=Dies().go_on)[0]
    run = read_run(stand.run)
    (unseen,) = [event for event in run.events if event["event"] == "unseen"]
    assert state is PrintState.INCOMPLETE and len(events) == 1 and "lens" in events[0]
    assert unseen["first"] < 31 < unseen["stop"] and len({*run.shown["slot"].tolist()}) == len(stand.planned.schedule)
    told = json.loads((stand.run / "timing.json").read_text())["light"]
    assert not told["complete"] and told["in_doubt"] == unseen["stop"] - unseen["first"]
