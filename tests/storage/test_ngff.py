"""Job folders tell viewers of OME-Zarr 0.5 where their voxels are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from needs import optional

import vamgpu as vam
from vamgpu.storage.folder import Entry, Folder, write_folder

PITCH, PIXEL = 0.25, 0.3


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("ome")
    part = np.zeros((12, 14, 6))
    part[4:8, 5:9, 1:4] = 1.0
    target = vam.Target.from_array(part, pitch=PITCH, name="block")
    A = vam.Projection(target.grid, vam.Beam((16, 6), PIXEL), vam.Turntable(12), device="numpy")
    plan = vam.optimize(A, target, iterations=3)
    frames = vam.pack(plan)
    vam.simulate(A, frames, target).save(place / "proof.vam")
    plan.save(place / "plan.vam")
    frames.save(place / "frames.vam")
    return {name: place / f"{name}.vam" for name in ("plan", "frames", "proof")}


@pytest.mark.parametrize(
    ("name", "images"),
    [("plan", ["target", "frames"]), ("frames", ["target", "frames"]), ("proof", ["dose", "target", "frames"])],
)
def test_a_folder_follows_the_rules_of_the_format(name: str, images: list[str], folders: dict[str, Path]) -> None:
    group = zarr.open_group(folders[name], mode="r", zarr_format=3)
    said: Any = dict(group.attrs)["ome"]
    assert said["version"] == "0.5" and [image["name"] for image in said["multiscales"]] == images
    for image in said["multiscales"]:
        (dataset,) = image["datasets"]
        array: Any = group[dataset["path"]]
        names = [axis["name"] for axis in image["axes"]]
        kinds = [axis["type"] for axis in image["axes"]]
        assert 2 <= array.ndim == len(names) <= 5 and tuple(names) == array.metadata.dimension_names
        assert 2 <= kinds.count("space") <= 3 and kinds == sorted(kinds, key=lambda kind: kind == "space")
        assert all(axis.get("unit") == "millimeter" for axis in image["axes"] if axis["type"] == "space")
        first, second = dataset["coordinateTransformations"]
        assert (first["type"], second["type"]) == ("scale", "translation")
        assert len(first["scale"]) == len(second["translation"]) == array.ndim


def test_voxels_and_pixels_lie_where_they_are(folders: dict[str, Path]) -> None:
    said: Any = zarr.open_group(folders["proof"], mode="r", zarr_format=3).attrs["ome"]
    placed = {image["name"]: [step.get("scale") or step["translation"] for step in
                              image["datasets"][0]["coordinateTransformations"]]
              for image in said["multiscales"]}  # fmt: skip
    assert placed["dose"] == placed["target"] == [[PITCH] * 3, [-1.375, -1.625, -0.625]]
    assert placed["frames"][0] == [1.0, PIXEL, PIXEL] and placed["frames"][1] == pytest.approx([0.0, -0.75, -2.25])


def test_a_validator_of_the_format_agrees(folders: dict[str, Path]) -> None:
    yaozarrs = optional("yaozarrs", "the format is checked by its own models too: pip install yaozarrs")
    for folder in folders.values():
        text = json.loads((folder / "zarr.json").read_text(encoding="utf-8"))
        yaozarrs.validate_ome_object(text["attributes"])


def test_arrays_that_are_no_pictures_say_nothing(tmp_path: Path) -> None:
    write_folder(tmp_path / "a", {"light": Entry(np.ones((2, 3)), ("i", "j"))}, inputs={}, details={}, device="x")
    assert "ome" not in zarr.open_group(tmp_path / "a", mode="r", zarr_format=3).attrs
    Folder.open(tmp_path / "a").verify()
