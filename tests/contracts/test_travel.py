"""Parts that travel during a print, on every device: transposes, machine frames exposed one by one, laws, refusals."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import shift
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.operators.follow import followed
from vamgpu.optics.outer_resin import outer_resin
from vamgpu.optics.rising_beams import Inclined
from vamgpu.storage.turntable import described, turntable_from
from vamgpu.units import Pa_s, kg_m3

ANGLES, PITCH = 4, 0.1
GRID, BEAM = vam.Grid((8, 8, 12), PITCH), vam.Beam((12, 16), PITCH)
VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.49962, wall_index=1.473, absorption=0.5)
STEPS = PITCH * np.array([[0.0], [-1.0], [-2.0], [-4.0]])
SINKING = -0.37 * np.linspace(0.0, 1.0, 3 * ANGLES).reshape(3, ANGLES)
RISING = PITCH * np.arange(-8, 9, 2)[:, None]
SPHERE: dict[str, Any] = {"density_difference": 20 * kg_m3, "viscosity": 1 * Pa_s, "diameter": 10.0}
PATHS = {
    "sinks": vam.Travel(SINKING),
    "sinks, not followed": vam.Travel(SINKING, follow=False),
    "helix": vam.Travel.helix(ANGLES, 0.23, height=16 * PITCH, rows=6, pitch=PITCH),
    "aside": vam.Travel(SINKING, x=[[0.03], [-0.12], [0.2]], y=0.07),
}


def projection(travel: vam.Travel, device: Device | str, vessel: vam.Vial | None = None) -> vam.Projection:
    motion = vam.Turntable(ANGLES, dwell=[1.0, 2.0, 0.5, 1.0], lit_share=0.0, travel=travel)
    return vam.Projection(GRID, BEAM, motion, vessel, device)


@pytest.mark.parametrize("name", PATHS)
def test_the_transpose_is_exact_and_devices_agree(device: Device, name: str) -> None:
    vessel = None if name == "aside" else VIAL
    A, reference = projection(PATHS[name], device, vessel), projection(PATHS[name], "numpy", vessel)
    assert A.dot_test() <= 1e-6 and transpose_gap(A, most=60) <= 3e-6
    light = np.random.default_rng(0).random(A.range.shape)
    wanted = reference.T(light)
    assert np.abs(A.T(light) - wanted).max() <= 1e-5 * np.abs(wanted).max()


def patterns(rows: int = BEAM.pixels[1]) -> np.ndarray:
    """Smooth light of every angle, dark at the rims."""
    z, r = (np.arange(n) - 0.5 * (n - 1) for n in (rows, BEAM.pixels[0]))
    phase = np.linspace(0.0, 4.0, ANGLES)[:, None, None]
    waves = 1.0 + np.sin(0.7 * z + phase) * np.cos(0.5 * r[:, None] + phase)
    return waves * np.exp(-((z / 4.0) ** 2) - (r[:, None] / 3.0) ** 2)


def one_by_one(frames: vam.Frames, travel: vam.Travel) -> np.ndarray:
    """Dose in the part, as the mean over the turns: each frame exposes a larger grid at rest, moved to the part."""
    light, away = frames.irradiance("numpy").numpy(), 18
    grid = vam.Grid((8 + 2 * away, 8 + 2 * away, 12 + 2 * away), PITCH)
    still = vam.Projection(grid, vam.Beam((light.shape[1], light.shape[2]), PITCH),
                           vam.Turntable(ANGLES, lit_share=0.0), device="numpy")  # fmt: skip
    dose = np.zeros(GRID.shape)
    for number, image in enumerate(light):
        turn, angle = divmod(number, ANGLES)
        alone = np.zeros(still.range.shape)
        alone[angle] = image
        place = [np.broadcast_to(each, (travel.turns, ANGLES))[turn, angle] for each in (travel.x, travel.y, travel.up)]
        moved = shift(still.T(alone), -np.array(place) / PITCH, order=1)
        dose += moved[away:-away, away:-away, away:-away] / travel.turns
    return dose


MACHINE: dict[str, tuple[vam.Travel, dict[str, object]]] = {
    "sinks by whole pixels": (vam.Travel(STEPS), {}),
    "mirrored, one bit": (vam.Travel(STEPS), {"bits": 1, "flip_z": True, "flip_r": True}),
    "not followed": (vam.Travel(STEPS, follow=False), {}),
    "three images tall": (vam.Travel(RISING, rows=6), {}),
    "off the axis": (vam.Travel(STEPS, x=3 * PITCH), {}),
}


@pytest.mark.parametrize("name", MACHINE)
def test_frames_of_all_turns_give_the_dose_of_the_patterns(name: str) -> None:
    travel, options = MACHINE[name]
    motion = vam.Turntable(ANGLES, lit_share=0.0, travel=travel)
    A = vam.Projection(GRID, BEAM, motion, device="numpy")
    frames = vam.pack(A, patterns(), dither="round", **options)  # type: ignore[arg-type]
    machine = frames.followed(BEAM)
    assert machine.shape[0] == travel.turns * ANGLES and machine.motion == vam.Turntable(ANGLES, lit_share=0.0)
    wanted, got = one_by_one(machine, travel), A.T(frames.irradiance("numpy").numpy())
    lit = GRID.cylinder()
    most = 2e-3 if name == "off the axis" else 1e-6  # between pixels, light is interpolated
    assert np.abs(got - wanted)[lit].max() <= most * wanted[lit].max()


def test_resin_beside_the_part_gets_the_light_that_misses_it() -> None:
    """Not followed, a part that has sunk by two pixels gets the light of two rows farther up."""
    small = vam.Grid((6, 6, 8), PITCH)
    doses = []
    for travel, light in (
        (vam.Travel([[-2 * PITCH]], follow=False), patterns()),
        (None, np.pad(patterns(), ((0, 0), (0, 0), (2, 0)))[..., :-2]),
    ):
        motion = vam.Turntable(ANGLES, lit_share=0.0, travel=travel)
        resin = outer_resin(vam.Projection(small, BEAM, motion, VIAL))
        assert len(resin) == 2 and all(each.dot_test() <= 1e-6 for each in resin)
        doses.append([each.T(light) for each in resin])
    for moved, wanted in zip(*doses, strict=True):
        assert np.abs(moved - wanted).max() <= 1e-5 * wanted.max() and np.abs(wanted).max() > 0


def test_every_row_of_a_helix_is_lit_in_equally_many_turns() -> None:
    path = followed(vam.Turntable(ANGLES, travel=PATHS["helix"]), BEAM)
    assert path is not None and path.lit is not None and path.repeats == 2
    assert (path.lit.sum(axis=0) == 2).all() and np.abs(path.left).max() <= 0.5
    shown = np.arange(16) - path.whole[..., 1, None]
    assert ((shown >= 0) & (shown < 6))[path.lit].all()


def test_rounding_loses_no_turn_of_a_helix() -> None:
    """An image of 16 rows that moves by 5 shows every row 3 times; a part of 40 rows passes it in 11 turns."""
    path = vam.Travel.helix(ANGLES, 0.05, height=0.4, rows=16, pitch=0.01)
    found = followed(vam.Turntable(ANGLES, travel=path), vam.Beam((12, 40), 0.01))
    assert found is not None and (found.repeats, path.turns) == (3, 11)


def test_frames_of_all_turns_take_little_more_memory_than_their_bytes() -> None:
    motion = vam.Turntable(ANGLES, travel=vam.Travel(STEPS.repeat(6, axis=0) / 10))
    beam = vam.Beam((256, 256), PITCH / 10)
    frames = vam.Frames.from_bytes(np.full((ANGLES, 256, 32), 0xA5, np.uint8), "numpy", bits=1, scale=1.0, columns=256,
                                   gray=vam.GrayCurve.linear(), motion=motion)  # fmt: skip
    tracemalloc.start()
    try:
        machine = frames.followed(beam)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert machine.shape == (24 * ANGLES, 264, 256) and peak <= 2.5 * machine.nbytes


def test_frames_of_all_turns_stay_within_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    A = projection(vam.Travel(STEPS), "numpy")
    frames = vam.pack(A, patterns(), dither="round")
    monkeypatch.setenv("VAMGPU_MEMORY", "1 KB")
    with pytest.raises(OutOfMemory, match="frames of 4 turns"):
        frames.followed(BEAM)


def test_a_fraction_of_a_pixel_moves_light_as_its_formula() -> None:
    """A pattern that is a Gaussian in z, seen by a part that sinks by 0.3 pixel, is that Gaussian 0.3 pixel higher."""
    z = np.arange(16) - 7.5
    doses = []
    for up in (0.0, -0.3):
        A = vam.Projection(
            GRID, BEAM, vam.Turntable(1, lit_share=0.0, travel=vam.Travel([[up * PITCH]])), device="numpy"
        )
        light = np.exp(-0.5 * ((z - (0.0 if up else 0.3)) / 3.0) ** 2) * np.ones((1, 12, 1))
        doses.append(A.T(light))
    assert np.abs(doses[0] - doses[1])[2:-2, 2:-2].max() <= 1e-3 * doses[0].max()


def test_laws() -> None:
    # 5 mm in radius, 20 kg/m³ denser, in 1 Pa·s: 1.09 mm/s
    path = vam.Travel.sinking(2, 4, 10.0, **SPHERE, start=5.0)
    seconds = 10.0 * np.arange(8).reshape(2, 4) / 4
    assert np.allclose(path.up, -1.0896 * np.maximum(seconds - 5.0, 0.0), rtol=1e-4)
    same = vam.Travel.sinking(
        2, 4, 10.0, density_difference="20 kg/m3", viscosity="1000 mPa s", diameter="1 cm", start="5 s"
    )
    assert np.allclose(same.up, path.up)
    floats = vam.Travel.sinking(2, 4, 10.0, **{**SPHERE, "density_difference": "-20 kg/m3"}, start=5.0)
    assert np.allclose(floats.up, -np.array(path.up)) and np.max(floats.up) > 0
    measured = vam.Travel.through([0.0, 2.0, 12.0], [0.1, 0.1, -0.4], 2, 2, 8.0)
    assert np.allclose(measured.up, [[0.1, 0.0], [-0.2, -0.4]])


def test_an_off_axis_volume_in_a_vial_is_a_part_of_a_larger_one() -> None:
    """A grid beside the axis of a refracting vial gets the dose of the same voxels of a grid about the axis."""
    motion, beam = vam.Turntable(12, lit_share=0.0), vam.Beam((40, 6), 0.05, spread=0.0)
    vial = vam.Vial(radius=1.1, wall=0.05, resin_index=1.5, wall_index=1.47, absorption=0.3)
    wide = vam.Oblique(vam.Grid((28, 28, 4), 0.05), beam, motion, vial, device="numpy")
    small = vam.Oblique(vam.Grid((8, 8, 4), 0.05), beam, motion, vial, vam.Wobble.circle(0.3, 0.0, motion), "numpy")
    light = np.random.default_rng(2).random(wide.range.shape)
    whole, part = wide.T(light), small.T(light)
    here = whole[16:24, 10:18]
    assert np.abs(part - here)[GRID.cylinder()].max() <= 2e-3 * here.max()


def test_a_path_comes_back_from_a_manifest() -> None:
    for travel in PATHS.values():
        motion = vam.Turntable(ANGLES, travel=travel)
        assert turntable_from(described(motion)) == motion != vam.Turntable(ANGLES)
    assert not vam.Turntable(ANGLES, travel=PATHS["sinks"]).is_even


MOVES = vam.Turntable(ANGLES, lit_share=0.0, travel=PATHS["aside"])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: vam.Travel([0.0, 1.0]), r"shape \(2,\).*\(turns, angles\)"),  # type: ignore[list-item]
        (lambda: vam.Travel([[np.nan]]), "not finite"),
        (lambda: vam.Travel([[0.0, 1.0], [2.0]]), "Travel up is"),
        (lambda: vam.Travel([["a"]]), "Travel up is"),  # type: ignore[list-item]
        (lambda: vam.Travel([[0.0]], x=np.zeros((1, 0))), r"x has shape \(1, 0\)"),
        (lambda: vam.Travel([[0.0]], follow="no"), "follow is 'no'; expected True"),  # type: ignore[arg-type]
        (lambda: vam.Travel.through(["a"], [0.0], 2, 4, 1.0), "times .* expected a list"),  # type: ignore[list-item]
        (lambda: vam.Travel.through([0.0], [0.0], 2, 0, 1.0), "angles is 0"),
        (lambda: vam.Travel.sinking(2.5, 4, 6.0, **SPHERE), "turns is 2.5; expected a whole number"),  # type: ignore[arg-type]
        (lambda: vam.Travel.helix(0, 0.2, height=1.6, rows=6, pitch=0.1), "angles is 0"),
        (lambda: vam.Travel.helix(4, 0.2, height=-1.0, rows=6, pitch=0.1), r"height \[mm\] is -1"),
        (lambda: vam.Turntable(4, travel="x"), "travel is 'x'; expected a Travel"),  # type: ignore[arg-type]
        (lambda: vam.Wobble(["a"]), "Wobble across is"),  # type: ignore[list-item]
        (lambda: vam.Tiles(projection(PATHS["sinks"], "numpy"), 8), "Tiles got a part that moves"),
        (lambda: vam.Travel([[0.0]], x=[[1.0], [2.0]]), r"x has shape \(2, 1\)"),
        (lambda: vam.Travel([[0.0]], follow=False, rows=4), "follow=True"),
        (lambda: vam.Travel.through([1.0, 0.0], [0.0, 1.0], 2, 4, 1.0), "rising times"),
        (lambda: vam.Travel.through([0.0, 1.0], [0.0, 1.0], 10**12, 360, 1.0), "frames; expected at most 1,000,000"),
        (lambda: vam.Travel.through([0.0, 1.0], [0.0, 0.1], 3, 12, 6.0), "from 0 to 1 s; expected 0 to 17.5 s"),
        (lambda: vam.Travel.helix(12, 0.2, height=1.2, rows=7, pitch=0.2), "is 1.4 mm high, and patterns 1.2"),
        (lambda: vam.Travel.helix(4, 1e-9, height=1.6, rows=6, pitch=0.1), "a larger rise"),
        (lambda: projection(vam.Travel([[0.0]], rows=17), "numpy"), "image of 17 rows, and the beam has 16"),
        (lambda: vam.Travel.helix(4, 0.7, height=1.6, rows=6, pitch=0.1), "rises 0.7 mm.*6 rows are 0.5 mm"),
        (lambda: vam.Turntable(3, travel=PATHS["sinks"]), "has 4 angles, and the turntable 3"),
        (lambda: projection(vam.Travel([[2.0]]), "numpy"), "2 mm along z"),
        (lambda: projection(vam.Travel([[0.0], [0.1]], rows=6), "numpy"), "never passes the image of 6 rows"),
        (lambda: projection(PATHS["aside"], "numpy", VIAL), "sideways.*Oblique with a Wobble"),
        (lambda: vam.Oblique(GRID, BEAM, MOVES, Inclined(elevation=0.2), device="numpy"), "expected one at rest"),
        (lambda: vam.TracedProjection(GRID, BEAM, MOVES, device="numpy"), "expected one at rest"),
        (lambda: vam.RingProjection(GRID, BEAM, MOVES, device="numpy"), "rings do not follow"),
        (lambda: projection(PATHS["sinks"], "numpy").of_poses([0]), "expected one at rest"),
        (lambda: projection(vam.Travel([[0.0]], x=0.5), "numpy").motion.chosen([0]), "expected one at rest"),
    ],
)  # fmt: skip
def test_bad_input_is_named(wrong: Callable[[], object], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        wrong()


def test_a_part_far_aside_is_refused_while_frames_are_lit_on_the_way() -> None:
    with pytest.raises(BadInput, match="pixels while a frame is lit"):
        vam.Projection(GRID, BEAM, vam.Turntable(8, travel=vam.Travel([[0.0]], x=0.3)), device="numpy")
    vam.Projection(GRID, BEAM, vam.Turntable(360, travel=vam.Travel([[0.0]], x=0.3)), device="numpy")
