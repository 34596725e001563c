"""From an upload to a rehearsed print, through the server and the command line that it starts."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from studio_client import BOAT, Client

from vamgpu.metrics import surface_judgement, thin_regions
from vamgpu.printing import judgement
from vamgpu.printing import proof as proofs
from vamgpu.printing.proof_folder import load_proof
from vamgpu.studio.server import Studio
from vamgpu.targets import shapes

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
COARSE = BOAT.replace("250 um", "400 um")


def test_upload_solve_cancel_go_on_verdict_export_rehearse(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = tmp_path / "lab"
    mesh = shapes.build("boat").save(tmp_path / "part.stl").read_bytes()
    part = client("POST", "/parts?name=part.stl", mesh, 201)
    assert part["triangles"] == len(shapes.build("boat").faces) and part["doubts"] == []
    text = COARSE.replace('shape = "boat"', 'mesh = "part.stl"').replace("iterations = 12", "iterations = 100000")
    assert client("PUT", "/jobs/part.toml", {"text": text}, 200)["errors"] == []

    task = client("POST", "/tasks", {"kind": "solve", "job": "part.toml"}, 201)
    seen = client.ended(task, lambda now: bool(now["progress"] and now["progress"]["slices"]))
    assert seen["state"] == "running" and seen["progress"]["stage"] == "light" and seen["history"]["window"]
    arrays, _ = client.arrays(f"/tasks/{task['id']}/slice")
    assert arrays["dose"].shape == arrays["target"].shape and arrays["dose"].max() > 0 and arrays["target"].max() == 255
    assert client("GET", "/workspace")["jobs"][1]["state"] == "running"
    assert client.raw("DELETE", "/jobs/part.toml")[0] == 409
    client("POST", f"/tasks/{task['id']}/cancel")
    stopped = client.ended(task)
    assert stopped["state"] == "cancelled" and stopped["resumable"], stopped
    before = stopped["history"]["iteration"][-1]
    assert client("GET", "/results/part.vam")["state"] == "interrupted"

    client("PUT", "/jobs/part.toml", {"text": text, "etag": "0" * 16}, 409)
    etag = client("GET", "/jobs/part.toml")["etag"]
    client("PUT", "/jobs/part.toml", {"text": text.replace("100000", str(before + 20)), "etag": etag})
    again = client("POST", f"/tasks/{task['id']}/resume", status=201)
    done = client.ended(again)
    assert done["state"] == "done" and done["history"]["iteration"][-1] == before + 20, done
    prove = next(each for each in client("GET", "/tasks")["tasks"] if each["kind"] == "prove")
    assert client.ended(prove)["state"] == "done"

    result = client("GET", "/results/part.vam")
    proof = load_proof(lab / "part.proof", "numpy")
    monkeypatch.setattr(judgement, "judge_surface", surface_judgement.judge_surface)  # at as many points as the page
    monkeypatch.setattr(proofs, "unjudged", thin_regions.unjudged)
    assert result["verdict"]["sentence"] == proof.verdict.sentence and result["state"] == "proved"
    assert result["scores"]["window"] == pytest.approx(proof.scores.window)
    slice_, meta = client.arrays("/results/part.vam/slice?of=dose&axis=z&index=10")
    dose = proof.dose.numpy()[:, :, 10] / proof.scores.threshold
    np.testing.assert_allclose(slice_["values"], dose.T[::-1], rtol=1e-6)
    assert meta["place"] == pytest.approx(proof.operator.grid.axes()[2][10])
    usual = client("GET", "/results/part.vam/exposure?dose=1")
    assert (usual["missing"], usual["excess"]) == (proof.scores.missing, proof.scores.excess)
    counts, _ = client.arrays("/results/part.vam/histogram?bins=64")
    assert (counts["inside"].sum(), counts["outside"].sum()) == (proof.scores.in_voxels, proof.scores.out_voxels)
    volume, scale = client.arrays("/results/part.vam/volume?dtype=float16")
    np.testing.assert_allclose(volume["values"], proof.dose.numpy().T / proof.scores.threshold, rtol=1e-3, atol=1e-6)
    assert scale["full"] == 1.0
    surface, _ = client.arrays("/results/part.vam/surface?of=printed")
    assert len(surface["positions"]) == len(surface["deviation"]) > 100 and surface["indices"].max() < len(
        surface["positions"]
    )
    for path in ("frame?index=3", "sinogram"):
        status, data, headers = client.raw("GET", f"/results/part.vam/{path}")
        assert status == 200 and headers["content-type"] == "image/png" and data.startswith(b"\x89PNG")
    status, page, headers = client.raw("GET", "/results/part.vam/report")
    assert status == 200 and b"Print proof" in page and "sandbox" in headers["content-security-policy"]

    task = client("POST", "/tasks", {"kind": "expose", "result": "part.vam",
                                     "off": {"dose": "-5 %", "axis": "100 um"}}, 201)  # fmt: skip
    assert client.ended(task)["state"] == "done"
    off = client("GET", "/results/part.vam")["exposed"][0]["proof"]
    moved = client("GET", f"/results/part.vam?proof={off}")["scores"]
    assert moved["threshold"] == pytest.approx(proof.scores.threshold / 0.95, rel=1e-4)
    assert moved["window"] != result["scores"]["window"]

    task = client("POST", "/tasks", {"kind": "export", "result": "part.vam", "format": "npz"}, 201)
    assert client.ended(task)["made"] == ["part.npz"]
    assert client.raw("GET", "/exports/part.npz")[1] == (lab / "part.npz").read_bytes()
    rig = client("GET", "/rigs/emulated")
    assert rig["emulated"] and rig["refused"] == "" and {each["about"] for each in rig["guarantees"]} >= {"light"}
    task = client("POST", "/tasks", {"kind": "rehearse", "result": "part.vam", "rig": "emulated", "turns": 1}, 201)
    rehearsed = client.ended(task)
    assert rehearsed["run"] == "part.dry-run" and (lab / "part.dry-run" / "run.json").is_file(), rehearsed
    assert [run["name"] for run in client("GET", "/runs")["runs"]] == ["part.dry-run"]
    assert rehearsed["progress"]["share"] == 1.0
    assert [stage["stage"] for stage in rehearsed["progress"]["stages"]] == ["plan", "print"]
    assert client("POST", "/print/attach", {"run": "part.dry-run"})["run"] == "part.dry-run"


def test_a_task_outlives_the_server(tmp_path: Path) -> None:
    (tmp_path / "boat.toml").write_text(COARSE, encoding="utf-8")
    with Studio(tmp_path) as studio:
        client = Client(studio)
        asked = {"kind": "solve", "job": "boat.toml", "prove": False}
        task = client("POST", "/tasks", asked | {"set": {"solve.iterations": 100000}}, 201)
        waiting = client("POST", "/tasks", {"kind": "orient", "job": "boat.toml", "count": 1}, 201)
        client.ended(task, lambda now: bool(now["progress"] and now["progress"]["iteration"]))
        pid = json.loads((tmp_path / ".studio" / "tasks" / f"{task['id']}.json").read_text())["pid"]
    os.kill(pid, 0)  # it lives
    with Studio(tmp_path) as studio:
        client = Client(studio)
        assert client("GET", f"/tasks/{task['id']}")["state"] == "running"
        client("POST", f"/tasks/{task['id']}/cancel")
        assert client.ended(task)["resumable"]
        found = client.ended(waiting)
        assert found["state"] == "done" and found["orientations"][0]["rank"] == 1, found
