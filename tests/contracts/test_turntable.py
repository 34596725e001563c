"""What a turntable is made of, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vamgpu import Turntable
from vamgpu.errors import BadInput
from vamgpu.units import deg


def test_even_poses_are_the_number_of_their_angles() -> None:
    even = Turntable(360)
    assert even.poses == pytest.approx(2 * np.pi * np.arange(360) / 360) and even.is_even and even.angles == 360
    listed = Turntable(even.poses, lit_share=1.0)
    assert listed == even == Turntable.arc(360, 2 * np.pi) and hash(listed) == hash(even)
    assert Turntable(even.poses) == even.stepped
    assert Turntable(360, dwell=np.full(360, 7.0)) == even and (even.times == 1).all()
    assert Turntable(even.poses + 1e-6) != even and not Turntable(even.poses + 0.1).is_even


def test_measured_angles_keep_their_order_and_their_times() -> None:
    motion = Turntable(np.array([10, 350, 20]) * deg, dwell=[1, 2, 3])
    assert motion.angles == 3 and motion.poses == pytest.approx(np.array([10, 350, 20]) * deg)
    assert motion.times == pytest.approx([0.5, 1.0, 1.5]) and not motion.is_even
    assert motion != Turntable(np.array([10, 350, 20]) * deg) and not Turntable(3, dwell=[1, 2, 3]).is_even
    assert str(motion) == "3 measured, from 10° to 350°, each lit 0.5 to 1.5 times the mean, at rest while lit"
    assert repr(motion) == "Turntable(angles=[0.1745, 6.109, 0.3491], dwell=[0.5, 1, 1.5])"
    assert repr(Turntable.arc(90, np.pi, lit_share=0)) == "Turntable(angles=[0, 0.03491, 0.06981, …, 3.107])"


def test_an_arc_has_no_direction_twice() -> None:
    assert Turntable.arc(4, np.pi).poses == pytest.approx(np.array([0, 45, 90, 135]) * deg)
    assert Turntable.arc(3, 120 * deg, start=-60 * deg).poses == pytest.approx(np.array([-60, -20, 20]) * deg)


def test_parts_of_a_turn_keep_the_times_of_the_turn() -> None:
    motion = Turntable(4, dwell=[1, 1, 3, 3])
    assert motion.chosen([2, 3]).times == pytest.approx([1.5, 1.5])
    assert motion.chosen([2, 3]).poses == pytest.approx(motion.poses[2:])
    assert motion.chosen([0]).times == pytest.approx([0.5]) and Turntable(4).chosen(range(4)) == Turntable(4)


def test_parts_of_a_turn_keep_its_arcs() -> None:
    motion = Turntable(8, lit_share=0.5)
    assert motion.arcs == pytest.approx(np.full(8, np.pi / 8)) and not motion.stepped.arcs.any()
    assert motion.chosen([0, 3, 4]).arcs == pytest.approx(np.full(3, np.pi / 8))
    uneven = Turntable(np.array([0, 10, 30]) * deg, lit_share=1.0)
    assert uneven.arcs == pytest.approx(np.array([10, 15, 20]) * deg) and not Turntable([0.0, 0.1]).arcs.any()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Turntable(8, lit_share=1.5), r"lit_share is 1\.5; expected 0 \(at rest"),
        (lambda: Turntable(0), "is 0; expected a positive integer"),
        (lambda: Turntable(range(360)), r"from 0 to 359 rad; expected one turn \(2π\) .*units\.deg"),
        (lambda: Turntable([0.0, np.nan]), "1 numbers that are not finite"),
        (lambda: Turntable([]), "at least one"),
        (lambda: Turntable([0.0, "x"]), "expected a list of numbers"),  # type: ignore[list-item]
        (lambda: Turntable(3, dwell=[1, 2]), "has 2 times, .* expected 3, one above 0 for each angle"),
        (lambda: Turntable(3, dwell=[1, 0, 2]), "the least 0; .* leave out angles that are never lit"),
        (lambda: Turntable(2, dwell=[1, np.inf]), "not finite"),
        (lambda: Turntable.arc(5, 180.0), "span is 180 rad; expected at most 2π"),
        (lambda: Turntable.arc(5, 0.0), "expected a finite number > 0"),
    ],
)
def test_what_is_no_turntable_is_refused(make: Callable[[], Turntable], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        make()
