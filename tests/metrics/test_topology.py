"""Bodies, holes and cavities of shapes whose numbers are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label
from skimage.measure import euler_number

from vamgpu.metrics.body_changes import body_changes
from vamgpu.metrics.runs import runs_of
from vamgpu.metrics.topology import Topology
from vamgpu.metrics.topology import topology as labeled

X, Y, Z = np.mgrid[:70, :40, :40] - np.array([34.5, 19.5, 19.5])[:, None, None, None]


def topology(mask: np.ndarray) -> Topology:
    return labeled(runs_of(mask))


def test_a_ring_has_a_hole_and_a_shell_a_cavity() -> None:
    ring = topology(np.hypot(np.hypot(X, Y) - 13, Z) < 4)
    assert (ring.bodies, ring.holes.tolist(), ring.cavities) == (1, [1], 0)
    r = np.sqrt(X**2 + Y**2 + Z**2)
    nested = topology(((r < 18) & (r > 12)) | (r < 6))
    assert (nested.bodies, nested.holes.tolist(), nested.cavities) == (2, [0, 0], 1)
    assert nested.cavity_size.tolist() == [np.count_nonzero((r <= 12) & (r >= 6))]


def test_cavities_belong_to_the_body_around_them() -> None:
    """The first of two bodies is hollow: counted for the other, its cavity would be a hole there."""
    first, other = (np.maximum(np.maximum(np.abs(X - x), np.abs(Y)), np.abs(Z)) for x in (-18, 18))
    found = topology(((first < 9) & (first > 4)) | (other < 9))
    assert (found.bodies, found.cavities, found.holes.tolist()) == (2, 1, [0, 0])


def test_holes_belong_to_the_body_that_has_them() -> None:
    """Across the planes where slabs meet."""
    bar = (np.abs(Y) < 8) & (np.abs(Z) < 4)
    for x in (-24, -2.5, 24):
        bar &= np.hypot(X - x, Y) >= 3
    found = topology(bar & (np.abs(X - 10) > 2))
    assert found.bodies == 2 and found.holes.tolist() == [2, 1]


def test_noise_agrees_with_the_euler_number_of_scikit_image() -> None:
    mask = np.random.default_rng(0).random((40, 21, 22)) > 0.5
    found = topology(mask)
    assert found.bodies - found.holes.sum() + found.cavities == euler_number(mask, connectivity=1)
    assert (found.holes >= 0).all() and found.size.sum() == mask.sum()


@pytest.mark.parametrize("share", [0.88, 0.92, 0.95])
def test_cavities_of_noise_are_those_that_scipy_finds(share: float) -> None:
    """Voids lead out in every direction, some of them by a corner alone."""
    mask = np.random.default_rng(3).random((24, 23, 22)) < share
    voids: Any = label(~mask, np.ones((3, 3, 3)))
    rim = np.ones_like(mask)
    rim[1:-1, 1:-1, 1:-1] = False
    wanted = np.bincount(voids[0].ravel())[np.setdiff1d(np.arange(1, voids[1] + 1), voids[0][rim])]
    assert wanted.size > 10 and sorted(topology(mask).cavity_size) == sorted(wanted)


def test_a_body_that_grazes_another_is_not_merged_with_it() -> None:
    """One print is too wide by a voxel and touches the other body's place, not its print."""
    part, printed = (np.zeros((20, 9, 9), bool) for _ in range(2))
    part[2:8, 2:7, 2:7] = part[9:15, 2:7, 2:7] = True
    printed[2:10, 2:7, 2:7] = printed[11:15, 2:7, 2:7] = True
    found = body_changes(topology(part), topology(printed), 1.0)
    assert (found.bodies_lost, found.bodies_merged, found.bodies_broken, found.bodies_extra) == (0, 0, 0, 0)
    assert not body_changes(topology(part), topology(part & False), 1.0).none


def test_thin_volumes_are_labeled_too() -> None:
    """Every other voxel, where pieces are as many as can be; each void at the end is open."""
    for shape in ((1, 1, 9), (3, 3, 3), (1, 5, 7), (2, 9, 1), (5, 1, 1)):
        mask = (np.indices(shape).sum(axis=0) % 2).astype(bool)
        found = topology(mask)
        assert (found.bodies, found.cavities) == (np.count_nonzero(mask), 0) and not found.holes.any()


def test_an_empty_volume_has_nothing() -> None:
    found = topology(np.zeros((4, 4, 4), bool))
    assert (found.bodies, found.cavities, found.holes.size) == (0, 0, 0)


def test_specks_that_sampling_breaks_off_are_no_bodies() -> None:
    """Seven voxels beside 125,000 are none, of the part or its print; eight are one, and seven beside a small part."""
    for edge, speck, bodies in ((50, 7, 1), (50, 8, 2), (10, 7, 2)):
        part = np.zeros((edge + 12, edge + 4, edge + 4), bool)
        part[2 : 2 + edge, 2 : 2 + edge, 2 : 2 + edge] = True
        printed = part.copy()
        part[edge + 5, 2, 2 : 2 + speck] = True
        found = body_changes(topology(part), topology(printed), 1.0)
        assert (found.bodies, found.bodies_lost) == (bodies, bodies - 1) and found.none == (bodies == 1)
        printed[edge + 1 : edge + 6, 2, 2 : 2 + speck] = True
        assert body_changes(topology(part), topology(printed), 1.0).bodies_merged == bodies - 1
        printed[3, 2, 2 : 3 + speck] = printed[2, 3, 2 : 3 + speck] = printed[2, 2, 2 + speck] = False
        assert body_changes(topology(part), topology(printed), 1.0).bodies_broken == bodies - 1
