"""Requests that Studio must refuse: from other pages, with odd names, sizes and types, and half of one."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from studio_client import BOAT, Client

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.panel import half_open
from vamgpu.studio import answers, routes
from vamgpu.studio.server import Studio

API = "/api/v1"
SOLVE = {"kind": "solve", "job": "boat.toml"}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    lab = tmp_path_factory.mktemp("outside") / "lab"
    lab.mkdir()
    (lab.parent / "secret.toml").write_text("[target]\nshape = 'boat'\n")
    (lab.parent / "secret.stl").write_text("solid\n")
    (lab / "boat.toml").write_text(BOAT)
    (lab / "link.toml").symlink_to(lab.parent / "secret.toml")
    (lab / "link.vam").symlink_to(lab.parent)
    (lab / ".hidden.toml").write_text(BOAT)
    return lab


@pytest.fixture(scope="module")
def client(place: Path) -> Iterator[Client]:
    with pytest.MonkeyPatch.context() as patch, Studio(place) as studio:
        patch.setattr(studio.engine.tasks, "_start", lambda task: None)  # nothing here may start a program
        yield Client(studio)


def whole(place: Path) -> dict[str, bytes]:
    """Every file in and around the workspace that a request could have changed."""
    return {
        str(each.relative_to(place.parent)): each.read_bytes()
        for each in place.parent.rglob("*") if each.is_file() and "lock" not in each.name
    }  # fmt: skip


def asked(client: Client, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
    line = http.client.HTTPConnection("127.0.0.1", client.studio.port, timeout=60)
    line.putrequest(method, path, skip_host="Host" in headers)
    if body is not None and "Content-Length" not in headers:
        headers["Content-Length"] = str(len(body))
    for name, value in headers.items():
        line.putheader(name, value)
    line.endheaders(body)
    answer = line.getresponse()
    return answer.status, answer.read()


PATHS = ["/", f"{API}/workspace", f"{API}/tasks", f"{API}/jobs/boat.toml", f"{API}/events", "/print/state",
         "/static/page.js", f"{API}/results/boat.vam/report"]  # fmt: skip
POSTS = [f"{API}/tasks", f"{API}/jobs/edit", "/print/stop", "/print/press/start", f"{API}/print/attach"]
ORIGINS = [
    "http://evil.example",
    "https://localhost",
    "http://127.0.0.1:1",
    "null",
    "http://127.0.0.1.evil.example",
    "",
]
HOSTS = ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "", "a" * 300]


@pytest.mark.parametrize("path", [*PATHS, *POSTS])
@pytest.mark.parametrize("token", ["", "Bearer ", "Bearer wrong", "Basic dG9rZW4=", "Bearer \xff"])
def test_nobody_gets_in_without_the_token(client: Client, path: str, token: str) -> None:
    method = "POST" if path in POSTS else "GET"
    status, body = asked(client, method, path, b"{}" if method == "POST" else None, Authorization=token)
    assert status == 403 and b"boat" not in body


@pytest.mark.parametrize("path", [*PATHS[:5], *POSTS])
@pytest.mark.parametrize("origin", ORIGINS)
def test_pages_of_other_sites_are_refused_even_with_the_token(client: Client, path: str, origin: str) -> None:
    token = f"Bearer {client.studio.token}"
    method = "POST" if path in POSTS else "GET"
    status, _ = asked(client, method, path, b"{}" if method == "POST" else None, Authorization=token, Origin=origin)
    assert status == 403


@pytest.mark.parametrize("path", [PATHS[1], PATHS[2], POSTS[0], POSTS[2]])
@pytest.mark.parametrize("host", HOSTS)
def test_names_that_were_rebound_to_this_machine_are_refused(client: Client, path: str, host: str) -> None:
    token = f"Bearer {client.studio.token}"
    status, _ = asked(client, "POST" if path in POSTS else "GET", path, Authorization=token, Host=host)
    assert status in (400, 403)


NAMES = ["../secret.toml", "..%2fsecret.toml", "%2e%2e/secret.toml", "....//secret.toml", "..\\secret.toml",
         "..%5csecret.toml", "%00.toml", "boat.toml%00.stl", ".hidden.toml", "link.toml", "/etc/passwd",
         "%2fetc%2fpasswd", "C:%5Csecret.toml", "a" * 300 + ".toml", "secret.toml", "..", ".", "%20", "boat.toml%20",
         "-rf.toml", "~root.toml", "b%C3%B6at.toml", "%252e%252e%252fsecret.toml", ".studio",
         "file:%2f%2fsecret.toml"]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", "/jobs/{}"), ("DELETE", "/jobs/{}"), ("GET", "/jobs/{}/scene"), ("GET", "/parts/{}"),
     ("DELETE", "/results/{}"), ("GET", "/results/{}/report"), ("GET", "/exports/{}"), ("GET", "/rigs/{}"),
     ("GET", "/tasks/{}/log")],
)  # fmt: skip
def test_no_name_leads_out_of_the_workspace(client: Client, place: Path, method: str, path: str, name: str) -> None:
    before = whole(place)
    status, body, _ = client.raw(method, path.format(name))
    assert 300 <= status < 500 and b"shape = 'boat'" not in body and b"root:" not in body
    assert whole(place) == before


BODIES: list[tuple[str, str, Any]] = [
    ("POST", "/tasks", SOLVE | {"job": "../secret.toml"}),
    ("POST", "/tasks", SOLVE | {"job": "link.toml"}),
    ("POST", "/tasks", SOLVE | {"job": "--help.toml"}),
    ("POST", "/tasks", SOLVE | {"job": ["boat.toml"]}),
    ("POST", "/tasks", SOLVE | {"job": None}),
    ("POST", "/tasks", SOLVE | {"fresh": "yes"}),
    ("POST", "/tasks", SOLVE | {"more": 1}),
    ("POST", "/tasks", SOLVE | {"set": {"solve.device=x --out": 1}}),
    ("POST", "/tasks", SOLVE | {"set": {"solve.iterations": {"a": 1}}}),
    ("POST", "/tasks", SOLVE | {"set": {"a" * 999: 1}}),
    ("POST", "/tasks", SOLVE | {"kind": "shell"}),
    ("POST", "/tasks", {"kind": "export", "result": "boat.vam", "format": "exe"}),
    ("POST", "/tasks", {"kind": "export", "result": "boat.vam", "format": "png", "canvas": "1x1 --rig x"}),
    ("POST", "/tasks", {"kind": "export", "result": "link.vam", "format": "png"}),
    ("POST", "/tasks", {"kind": "model", "job": "../secret.toml"}),
    ("POST", "/tasks", {"kind": "orient", "job": "boat.toml", "count": 10**9}),
    ("POST", "/tasks", {"kind": "orient", "job": "boat.toml", "count": 1.5}),
    ("POST", "/tasks", {"kind": "expose", "result": "boat.vam", "off": {}}),
    ("POST", "/tasks", {"kind": "print", "result": "boat.vam", "rig": "emulated", "confirm": ""}),
    ("POST", "/tasks", {"kind": "rehearse", "result": "boat.vam", "rig": "../../rig.toml"}),
    ("POST", "/tasks", []),
    ("POST", "/tasks", "solve"),
    ("POST", "/tasks", None),
    ("PUT", "/jobs/boat.toml", {"text": "a"}),
    ("PUT", "/jobs/boat.toml", {"text": "a", "etag": "b"}),
    ("PUT", "/jobs/boat.toml", {"text": 1, "etag": "b"}),
    ("PUT", "/jobs/boat.vam", {"text": "a"}),
    ("PUT", "/jobs/..%2fboat.toml", {"text": "a"}),
    ("PUT", "/jobs/link.toml", {"text": "a"}),
    ("PUT", "/jobs/big.toml", {"text": "a" * 1_000_001}),
    ("POST", "/jobs", {"name": "../boat"}),
    ("POST", "/jobs", {"name": "boat"}),
    ("POST", "/jobs", {"name": "x", "part": "../secret.stl"}),
    ("POST", "/jobs", {"name": "x", "vial": "none"}),
    ("POST", "/jobs", {"name": "x", "height": "-5 mm"}),
    ("POST", "/jobs", {"name": "x", "height": "5,5 mm"}),
    ("POST", "/jobs/boat.toml/copy", {"name": "../x"}),
    ("POST", "/jobs/edit", {"text": "", "set": {"../x": 1}}),
    ("POST", "/jobs/edit", {"text": "[a", "set": {"a.b": 1}}),
    ("POST", "/jobs/edit", {"text": "a = 1", "set": {"a.b": 1}}),
    ("POST", "/presets", {"family": "vials", "name": "x", "set": {}}),
    ("POST", "/presets", {"family": "../x", "name": "x", "set": {"a.b": 1}}),
    ("POST", "/print/attach", {"run": "../lab"}),
    ("POST", "/print/attach", {"run": "boat.toml"}),
    ("POST", "/print/attach", {"run": "link.vam"}),
]


@pytest.mark.parametrize(("method", "path", "body"), BODIES)
def test_bodies_that_are_wrong_change_nothing(client: Client, place: Path, method: str, path: str, body: Any) -> None:
    before = whole(place)
    data = json.dumps(body).encode()
    status, found, _ = client.raw(method, path, data, content_type="application/json")
    assert 400 <= status < 500 and json.loads(found)["error"]["message"], found
    assert whole(place) == before


QUERIES = ["/jobs/boat.toml?x=1", "/jobs/boat.toml/mesh?most=0", "/jobs/boat.toml/mesh?most=1e9",
           "/jobs/boat.toml/mesh?most=200&most=300", "/results/boat.vam/slice?index=-1",
           "/results/boat.vam/slice?index=1&axis=w", "/results/boat.vam/volume?most=100000",
           "/results/boat.vam/volume?dtype=object", "/results/boat.vam/exposure?dose=nan",
           "/results/boat.vam/exposure?dose=-1", "/results/boat.vam?proof=../x.proof", "/compare?a=boat.vam",
           "/rigs/emulated?speed=inf", "/runs/..%2flab/report.html", "/runs/lab/state.json", "/tasks/1", "/nothing",
           "/presets?a=1", "/schema?kind=rig", "/stacks/boat.toml", "/stacks/..%2fsecret.toml", "/stacks/link.toml",
           "/stacks/boat.toml/slice?index=0", "/stacks/boat.toml/slice?index=0&of=../x",
           "/stacks/boat.toml/report?of=x", "/results/boat.vam/frame?index=0&plane=-1"]  # fmt: skip


@pytest.mark.parametrize("path", QUERIES)
def test_queries_that_are_wrong_are_refused(client: Client, path: str) -> None:
    status, found, _ = client.raw("GET", path)
    assert 400 <= status < 500 and json.loads(found)["error"]["message"]


@pytest.mark.parametrize("kind", ["", "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_forms_of_other_pages_are_refused(client: Client, kind: str) -> None:
    assert client.raw("POST", "/tasks", json.dumps(SOLVE).encode(), content_type=kind)[0] == 415


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b'{"a": 1e999}', b'{"text": "\\ud800"}'])
def test_bodies_that_are_no_json_are_refused(client: Client, data: bytes) -> None:
    assert client.raw("POST", "/jobs/check", data, content_type="application/json")[0] == 400


@pytest.mark.parametrize("method", ["PUT", "PATCH", "DELETE", "TRACE", "OPTIONS", "CONNECT"])
@pytest.mark.parametrize("path", ["/", f"{API}/workspace", f"{API}/tasks"])
def test_other_methods_are_refused(client: Client, method: str, path: str) -> None:
    status, _ = asked(client, method, path, Authorization=f"Bearer {client.studio.token}")
    assert status in (400, 404, 405)


@pytest.mark.parametrize(
    ("path", "length", "status"),
    [("/parts?name=a.stl", 10**12, 413), ("/jobs/check", 10**9, 413), ("/parts?name=a.exe", 3, 400),
     ("/parts?name=..%2fa.stl", 3, 400), ("/parts?name=a.stl&x=1", 3, 400), ("/parts", 3, 400),
     ("/parts?name=link.toml", 3, 400)],
)  # fmt: skip
def test_uploads_are_refused_before_they_are_read(
    client: Client, place: Path, path: str, length: int, status: int
) -> None:
    before = whole(place)
    headers = {"Content-Length": str(length), "Content-Type": "application/json"}
    found, _ = asked(client, "POST", API + path, b"abc", Authorization=f"Bearer {client.studio.token}", **headers)
    assert found == status and whole(place) == before


@pytest.mark.parametrize("data", [b"", b"solid", b"\0" * 84, b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 50, b"PK\3\4"])
@pytest.mark.parametrize("ending", ["stl", "3mf", "ply", "obj"])
def test_files_that_are_no_mesh_are_not_kept(client: Client, place: Path, data: bytes, ending: str) -> None:
    before = whole(place)
    status, found, _ = client.raw("POST", f"/parts?name=odd.{ending}", data)
    assert status in (400, 422) and whole(place) == before
    assert b"odd." in found and b"zero-size" not in found


@pytest.mark.parametrize("start", [b"", b"GET /api/v1/work", b"GET / HTTP/1.1\r\nHost: localhost\r\n", b"\x16\x03\x01"])
def test_half_open_connections_are_closed(client: Client, start: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(half_open, "PATIENCE", 0.2)
    with socket.create_connection(("127.0.0.1", client.studio.port), timeout=60) as line:
        line.sendall(start)
        end = time.monotonic() + 60.0
        answered = b""
        while (data := line.recv(4096)) and time.monotonic() < end:
            answered += data
    assert not data and (not answered or b" 400 " in answered)


def test_a_body_that_stops_is_refused(client: Client, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "SILENCE", 0.2)
    before = whole(place)
    token = f"Bearer {client.studio.token}"
    for path, kind in (("/parts?name=slow.stl", "model/stl"), ("/jobs/check", "application/json")):
        headers = {"Content-Length": "100", "Content-Type": kind}
        assert asked(client, "POST", API + path, b"{", Authorization=token, **headers)[0] == 408
    assert whole(place) == before


def test_a_body_without_a_length_is_cut_off_at_the_limit(
    client: Client, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "MOST_BYTES", 1000)
    before = whole(place)
    line = http.client.HTTPConnection("127.0.0.1", client.studio.port, timeout=60)
    headers = {"Authorization": f"Bearer {client.studio.token}", "Transfer-Encoding": "chunked"}
    pieces = (b"x" * 400 for _ in range(4))
    line.request("POST", f"{API}/parts?name=long.stl", pieces, headers, encode_chunked=True)
    assert line.getresponse().status == 413 and whole(place) == before


def test_only_this_machine_is_served_and_only_once(place: Path, client: Client) -> None:
    with pytest.raises(BadInput, match="only this machine may use it"):
        Studio(place, host="0.0.0.0")
    with pytest.raises(StorageError, match="another Studio serves"):
        Studio(place)
    assert client("GET", "/tasks")["tasks"] == []


def test_the_page_of_a_browser_gets_a_cookie_and_strict_headers(client: Client) -> None:
    studio = client.studio
    line = http.client.HTTPConnection("127.0.0.1", studio.port, timeout=60)
    line.request("GET", f"/?token={studio.token}")
    answer = line.getresponse()
    answer.read()
    cookie = answer.getheader("set-cookie") or ""
    assert "HttpOnly; SameSite=Strict" in cookie
    status, body = asked(client, "GET", f"{API}/workspace", Cookie=cookie.partition(";")[0])
    assert status == 200 and json.loads(body)["opened"] is None
    _, _, headers = client.raw("GET", "/workspace")
    assert "default-src 'none'" in headers["content-security-policy"] and headers["cache-control"] == "no-store"
    assert headers["x-content-type-options"] == "nosniff" and headers["cross-origin-resource-policy"] == "same-origin"


def test_the_address_for_a_browser_admits_it_once(client: Client) -> None:
    given = client.studio.url_once().partition("?")[2]
    assert client.studio.token not in given
    status, _ = asked(client, "GET", f"{API}/workspace", Authorization=f"Bearer {given.partition('=')[2]}")
    assert status == 403
    assert [asked(client, "GET", f"/?{given}")[0] for _ in range(2)] == [200, 403]
