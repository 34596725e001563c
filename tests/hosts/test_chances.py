"""Random deaths and stalls on each rig of docs/rigs: dark, nothing is lit twice, and nothing is missing untold."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from chances import NAMES, RIGHTLY, Life, RigStand, acts, ended

from vamgpu.errors import BadInput
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import DEFAULT_LENGTH
from vamgpu.hosts.schedules.timing import SECOND

SEEDS = [pytest.param(seed, marks=() if seed == 11 else pytest.mark.slow) for seed in range(7, 12)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_random_stalls_are_dark_and_told(name: str, seed: int, tmp_path: Path) -> None:
    count, _ = acts(name)
    stand, chance = RigStand(name, tmp_path), random.Random(seed)
    stalls = []

    def stall() -> None:
        began = stand.clock.now()
        stand.clock.sleep(round(chance.uniform(0.02, 1.0) * SECOND))
        stalls.append((began, stand.last))

    life = Life(happens={chance.randrange(1, count): stall for _ in range(3)})
    state = ended(stand, life, unattended=3)
    record, found = stand.told()
    assert stalls and state.ended and record.state is state and not stand.shines()
    assert (state is PrintState.COMPLETE) is (found.complete and state is not PrintState.ERROR)
    stand.is_as_told(found)
    if stand.leased:
        assert state is not PrintState.ERROR or not len(record.shown), "no print is lost"
        assert all(last <= began + DEFAULT_LENGTH for began, last in stalls), "dark within the lease"
    elif stand.mirrors:
        last = max(until - began for began, until in stalls)
        assert last <= stand.ahead, "dark once the frames are over that the mirrors hold"
    elif state is PrintState.ERROR and len(record.shown):
        assert "has used" in record.message, "a screen repeats its last frame until the budget of light is spent"


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", NAMES)
def test_random_deaths_are_dark_and_told(name: str, seed: int, tmp_path: Path) -> None:
    count, rare = acts(name)
    stand, chance = RigStand(name, tmp_path), random.Random(seed)
    deaths, state, refused = 0, None, ""
    hosts = chance.choice((2, 4))
    while state is None and not refused:
        moment = chance.choice(rare) if not deaths and chance.random() < 0.3 else chance.randrange(1, count)
        life = Life(moment if deaths < hosts - 1 else None, chance.random() < 0.5)
        try:
            state = stand.hosts(life)
        except BadInput as error:
            refused = str(error)
        if life.dead:
            deaths, died = deaths + 1, stand.clock.now()
            stand.abandoned(chance.random() < 0.5)
            assert not stand.shines() or not (stand.mirrors or stand.leased), "a screen repeats its last frame"
            if stand.leased:
                assert stand.last <= died + DEFAULT_LENGTH, "dark within the lease"
            elif stand.mirrors:
                assert stand.last <= died + stand.ahead, "dark once the frames are over that the mirrors hold"
    assert deaths and (not refused or any(word in refused for word in RIGHTLY)), refused
    if not stand.run.exists():
        assert not stand.got().any()
        return
    record, found = stand.told()
    lacking = {one["about"] for one in record.asked["guarantees"] if not one["holds"]}
    assert ("lease" in lacking) is not stand.leased, "what may stay on is in the record"
    last = None if state is not None else record.shown["frame"][-1:]
    stand.is_as_told(found, last)
    if state is not None:
        assert record.state is state is (PrintState.COMPLETE if found.complete else PrintState.INCOMPLETE)
    elif not stand.leased:
        assert "another host" in refused or "start again" in refused
