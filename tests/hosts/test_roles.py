"""Roles of a rig: what may fill them, what a combination guarantees, old spellings, and parts from outside."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import carry_out, plan, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig
from vamgpu.hosts.rigs.guarantees import accepted, driver_of, guarantees
from vamgpu.jobs.keys import keys_of, reference
from vamgpu.schema import registry

HEAD = '[rig]\nname = "lab"\nmachine = "vial"\n'
BOX = '[controller]\nport = "/dev/ttyACM0"\n'
ALP = '[display]\ndriver = "alp"\nlibrary = "libalp.so"\n'
VIDEO = '[display]\ndriver = "video"\n'
ZABER = '[motion]\ndriver = "zaber"\nport = "/dev/ttyUSB0"\nmicrosteps = 1000\n'
STEPPER = '[motion]\ndriver = "stepper"\nmicrosteps = 80.0\n'
MOTOR = '[motion]\ndriver = "controller"\nmicrosteps = 80.0\n'
FREE, STAGE = '[clock]\ndriver = "free"\n', '[clock]\ndriver = "stage"\n'
SHINES = '[light]\ndriver = "display"\n'


def rig(*tables: str) -> RigConfig:
    return parse_rig(HEAD + "".join(tables))


def lacking(config: RigConfig, speed: float = 40.0) -> set[str]:
    return {one.about for one in guarantees(config.setup, speed).lacking}


BELIEVED = {"lamp", "scale"}  # of the rigs below, unless a sensor tells


def test_what_each_combination_guarantees() -> None:
    door, shows = {"lease", "interlock", "light"}, {"display"}
    for tables, clock, without in (
        ((BOX, MOTOR, ALP), "controller", BELIEVED | {"position"}),
        ((BOX, MOTOR, ALP, '[[feedback]]\ndriver = "encoder"\ncounts = 100.0\n'), "controller", {"lamp"}),
        ((BOX, ZABER, VIDEO), "vblank", {"lamp", "position"} | shows),
        ((BOX, ZABER + "encoder = true\n", ALP), "stage", {"lamp"}),
        ((BOX, ZABER.replace("zaber", "standa"), VIDEO), "vblank", BELIEVED | {"position"} | shows),
        ((ZABER, ALP), "stage", {"lamp", "position"} | door),
        ((STEPPER, VIDEO, FREE), "free", BELIEVED | {"step", "position"} | door | shows),
        ((STEPPER, VIDEO, FREE, '[[feedback]]\ndriver = "index"\npin = 4\n'), "free", {"lamp"} | door | shows),
        ((BOX, STEPPER, VIDEO, FREE), "free", BELIEVED | {"step", "position"} | shows),
    ):
        found = rig(*tables)
        assert driver_of(found.setup.clock) == clock and lacking(found) == without, tables


@pytest.mark.parametrize("part", [MOTOR, STEPPER, ZABER.replace("zaber", "standa")])
def test_a_motor_that_tells_no_microsteps_needs_them_in_the_file(part: str) -> None:
    bare = "".join(line for line in part.splitlines(keepends=True) if "microsteps" not in line)
    with pytest.raises(JobError, match="microsteps is missing; add microsteps"):
        rig(BOX, bare, VIDEO, '[clock]\ndriver = "free"\n')


def test_drift_follows_from_the_clocks() -> None:
    config = rig(STEPPER + "tolerance = 30.0\n", VIDEO + "tolerance = 95.0\n", FREE)
    found = guarantees(config.setup, 40.0)
    assert found.drift == pytest.approx(0.3), "125 ppm of 2400 deg"
    assert "drifts 0.3 deg per minute" in str(found.lacking[0]) and "set drift = 0.3" in str(found.lacking[0])
    assert guarantees(config.setup, 20.0).drift == pytest.approx(0.15)


@pytest.mark.parametrize("speed", [40.0, 41.0, 44.0, 7.3])
def test_who_accepts_the_drift_that_was_told_has_accepted_it(speed: float) -> None:
    told = str(guarantees(rig(STEPPER, VIDEO, FREE).setup, speed).lacking[0]).split("drift = ")[1].split(" ")[0]
    config = rig(STEPPER, VIDEO, FREE, f"[safety]\ndrift = {told}\n")
    assert float(told) == pytest.approx(0.006 * speed, rel=0.1) and accepted(config.setup, speed, "deg")


def test_drift_must_be_accepted(job: Path) -> None:
    with pytest.raises(BadInput, match=r"drifts 0.24 deg per minute .* accepts 0.2; give .* or set drift = 0.24"):
        plan(job, rig(STEPPER, VIDEO, FREE, "[safety]\ndrift = 0.2\n"), rehearsed=True, turns=1, speed=40)
    planned = plan(job, rig(STEPPER, VIDEO, FREE, "[safety]\ndrift = 0.25\n"), rehearsed=True, turns=1)
    told = dict(planned.lines())["step"]
    assert "believed: " in told and "drifts" in told and "[safety] accepts 0.25" in told and "set drift" not in told


@pytest.mark.parametrize(
    ("kind", "meant"),
    [
        ("Arduino", "text"),
        ("esp32", "text"),
        ("pololu", "tic"),
        ("raspberry pi", "stepper"),
        ("zabr", "zaber"),
        ("cnc", ""),
    ],
)
def test_a_driver_that_does_not_exist_names_those_that_do(kind: str, meant: str) -> None:
    ended = rf"did you mean '{meant}'" if meant else "correct the name"
    with pytest.raises(JobError, match=rf"motion: no driver '{kind}'; expected one of controller, zaber.*: {ended}"):
        rig(MOTOR.replace("controller", kind), VIDEO)
    with pytest.raises(JobError, match=r"display: no driver 'hdmi'; .*did you mean 'video' \(A projector on a video"):
        rig(MOTOR, VIDEO.replace("video", "hdmi"))


@pytest.mark.parametrize(
    ("table", "key", "number", "hint"),
    [
        ("display", "frame_time", "5", "5 ms"),
        ("display", "frame_time", "0.004", "0.004 s"),
        ("lens", "settle", "5", "5 ms"),
        ("safety", "lease", "0.25", "0.25 s"),
        ("safety", "lease", "250", "250 ms"),
        ("safety", "resume", "30", "30 s"),
        ("calibration", "warn_after", "90", "90 d"),
        ("feedback", "exposure", "5", "5 ms"),
        ("light", "irradiance", "65", "65 mW/cm2"),
    ],
)
def test_a_number_without_a_unit_is_shown_with_one_that_its_key_may_have(
    table: str, key: str, number: str, hint: str
) -> None:
    drivers = {"lens": 'driver = "optotune"\nport = "/dev/x"\n', "feedback": 'driver = "camera"\nproducer = "x.cti"\n'}
    tables = {table: f"[{table}]\n{drivers.get(table, '')}"} | {"display": ALP}
    for given, unit in ((number, "with its unit in quotes"), (f'"{number}"', "without a unit")):
        with pytest.raises(JobError, match=rf'{key}: got .*{unit}.*: write it like "{hint}"'):
            rig(BOX, MOTOR, *(text + f"{key} = {given}\n" if name == table else text for name, text in tables.items()))


def test_keys_of_lists_are_counted_from_one() -> None:
    double = VIDEO.replace("[display]", "[[display]]")
    with pytest.raises(
        JobError, match=r"\[\[display\]\] 2, size, value 1: .*\n.*line 14: \[\[display\]\] 2, refresh: "
    ):
        rig(BOX, ZABER, double, double, "refresh = 60\nsize = [-1, 2]\n")
    with pytest.raises(JobError, match=r"display.size, value 2: got 'a'"):
        rig(BOX, ZABER, VIDEO, 'size = [1, "a"]\n')
    with pytest.raises(JobError, match=r"\[\[display\]\] 1, library is missing; add library = … to \[\[display\]\] 1"):
        rig(BOX, ZABER, '[[display]]\ndriver = "alp"\n')
    with pytest.raises(JobError, match=r"display.library is missing; add library = … to \[display\]$"):
        rig(BOX, ZABER, '[display]\ndriver = "alp"\n')


def test_the_remedy_of_a_position_that_is_not_measured_is_accepted() -> None:
    remedies = {
        'add [[feedback]] with driver = "index" and its pin': '[[feedback]]\ndriver = "index"\npin = 17\n',
        'add [[feedback]] with driver = "encoder" or "index"': '[[feedback]]\ndriver = "index"\n',
        "set encoder = true if the stage has one, or use one that has": "encoder = true\n",
    }
    tic = '[motion]\ndriver = "tic"\nmicrosteps = 9.0\n'
    for tables in ((STEPPER, VIDEO), (BOX, MOTOR, ALP), (ZABER, ALP), (tic, VIDEO)):
        free = (FREE, "[safety]\ndrift = 1.0\n") if STEPPER in tables else ()
        (position,) = (one for one in guarantees(rig(*tables, *free).setup, 40.0) if one.about == "position")
        assert position.kind == "believed"
        if tic in tables:
            assert "feedback" not in position.remedy, "no sensor at a Tic is read"
            continue
        more = remedies[position.remedy]
        better = rig(*tables, *free, more) if more[0] == "[" else rig(tables[0] + more, *tables[1:])
        assert [one.kind for one in guarantees(better.setup, 40.0) if one.about == "position"] == ["watched"]


@pytest.mark.parametrize("power", [50.0, 500.0, -2.0, 4.0])
def test_a_lens_focuses_at_a_power_that_it_has(power: float) -> None:
    tables = BOX, MOTOR, ALP
    lens = '[lens]\ndriver = "optotune"\nport = "/dev/x"\n'
    with pytest.raises(JobError, match=rf"lens.axis: got {power:g}.*; .*expected") as refused:
        rig(*tables, f"{lens}axis = {power}\n")
    assert ("-1.5 to 3.5 dpt" in str(refused.value)) == (abs(power) <= 50)
    with pytest.raises(JobError, match=r"lens.highest: got 80"):
        rig(*tables, f"{lens}highest = 80.0\n")
    assert rig(*tables, f"{lens}axis = 3.5\n").setup.lens.axis == 3.5  # type: ignore[union-attr]


def test_combinations_that_cannot_be_are_told() -> None:
    lens = '[lens]\ndriver = "optotune"\nport = "/dev/x"\n'
    for tables, why in (
        ((MOTOR, ALP), r"motion: driver .controller.: expected a table \[controller\]"),
        ((ZABER, ALP, '[light]\ndriver = "controller"\n'), r"light: .*expected a table \[controller\]"),
        ((STEPPER, ALP), "a .stepper. has no trigger output; use a stage that has one"),
        ((ZABER.replace("zaber", "standa"), ALP), "a .standa. has no trigger output"),
        ((ZABER, ALP, FREE), "mirrors of the display .alp. wait for triggers"),
        ((BOX, ZABER, ALP, '[clock]\ndriver = "controller"\n'), "the controller's own motor"),
        ((STEPPER, VIDEO), "does not report it; add .*index"),
        ((ZABER, VIDEO, STAGE), "a video cable has no trigger input"),
        ((ZABER, ALP, lens), "controlled_by"),
        ((BOX, MOTOR, ALP, SHINES), "the controller gates it"),
        ((BOX, ZABER, VIDEO.replace("video", "vidoe")), "did you mean 'video'"),
        ((BOX, ZABER, ALP, '[clock]\ndriver = 3\n'), "driver is 3; expected one of controller"),
    ):  # fmt: skip
        with pytest.raises(JobError, match=why):
            rig(*tables)


def test_poses_must_be_whole_microsteps(job: Path) -> None:
    with pytest.raises(BadInput, match=r"an angle is 21333.3 microsteps .*: solve the job with angles = 32 in"):
        plan(job, rig(ZABER.replace("1000", "2133.3333333333335"), ALP), rehearsed=True, turns=1)


@pytest.mark.parametrize(
    ("old", "new"), [("projector", "display"), ("stage", "motion"), ("camera", "feedback"), ("photodiode", "feedback")]
)
def test_tables_of_the_version_before_are_refused_with_todays(old: str, new: str) -> None:
    with pytest.raises(JobError, match=rf"\[{old}\] is a table of version 0.2; expected \[{new}\]"):
        parse_rig(HEAD + BOX + ALP + f'[{old}]\ndriver = "x"\n')


def test_parts_that_are_left_out_are_those_that_the_others_suggest() -> None:
    setup = parse_rig(HEAD + BOX + ALP, ["motion.microsteps=80"]).setup
    assert [driver_of(part) for part in (setup.motion, setup.light, setup.clock)] == ["controller"] * 3
    setup = rig(ZABER, ALP).setup
    assert [driver_of(part) for part in (setup.light, setup.clock)] == ["display", "stage"]


def test_the_command_tells_roles_and_guarantees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(HEAD + STEPPER + VIDEO + FREE)
    assert main(["rig", "check", str(file), "--speed", "20"]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "motion stepper" in told and "drifts 0.12 deg per minute" in told and "accepts drift = 0" in told
    file.write_text(HEAD + BOX + MOTOR + ALP)
    assert main(["rig", "check", str(file)]) == 0
    assert "250 ms after" in capsys.readouterr().out
    lift = '[lift]\ndriver = "zaber"\nport = "/dev/{}"\nmicrosteps = 8063\n'
    file.write_text(HEAD + BOX + MOTOR + ALP + lift.format("ttyUSB7"))
    assert main(["rig", "check", str(file)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "lift zaber" in told and "part believed: the lift counts its steps, 8063 microsteps per mm" in told
    controller = rig(BOX, MOTOR, ALP).setup.controller
    assert controller is not None and controller.port is not None
    with pytest.raises(JobError, match="lift.port: is that of another machine"):
        rig(BOX, MOTOR, ALP, lift.format("x").replace("/dev/x", controller.port))


TOYS = '''
"""A stage and a lens of another maker."""

from vamgpu.hosts.rigs.roles import LensPart, StagePart


class ToyStage(StagePart):
    """A stage made of wood.

    teeth: of its gear.
    """

    triggers = True
    teeth: int = 12

    def open(self, unit):
        raise NotImplementedError


class ToyLens(LensPart):
    """A lens made of water.

    drops: of it.
    """

    drops: int = 3
'''
ENTRIES = "[vamgpu.nouns]\nrig_motion.toy = toy_parts:ToyStage\nrig_lens.water = toy_parts:ToyLens\n"


@pytest.fixture
def toys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package that names two parts, installed."""
    site = tmp_path / "site"
    info = site / "toy_parts-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "toy_parts.py").write_text(TOYS, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-parts\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text(ENTRIES, encoding="utf-8")
    monkeypatch.syspath_prepend(str(site))
    before = {name: dict(one.nouns) for name, one in registry.FAMILIES.items()}
    registry.installed.cache_clear()
    yield
    for name, nouns in before.items():
        registry.FAMILIES[name].nouns.clear()
        registry.FAMILIES[name].nouns.update(nouns)
    registry.installed.cache_clear()
    sys.modules.pop("toy_parts", None)


@pytest.mark.usefixtures("toys")
def test_parts_from_outside_are_read_told_and_rehearsed(job: Path, tmp_path: Path) -> None:
    config = rig('[motion]\ndriver = "toy"\nteeth = 9\nmicrosteps = 1000\n', ALP)
    motion: Any = config.setup.motion
    assert (driver_of(motion), motion.teeth) == ("toy", 9)
    planned = plan(job, config, rehearsed=True, turns=1)
    stand = rehearsal(planned)
    assert carry_out(planned, stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    assert stand.monitor.verdict().greatest < 1e-6
    lens: Any = rig(BOX, MOTOR, ALP, '[lens]\ndriver = "water"\ndrops = 5\nlowest = -2.0\n').setup.lens
    assert (lens.drops, lens.lowest) == (5, -2.0)
    assert [key.name for key in keys_of("rig_motion.toy")][-1] == "teeth" and "### rig_lens.water" in reference()
    with pytest.raises(JobError, match=r"line \d+: motion.teth: .*did you mean 'teeth'"):
        rig('[motion]\ndriver = "toy"\nteth = 9\n', ALP)
