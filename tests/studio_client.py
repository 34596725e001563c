"""A client of Studio, and a small job."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.studio.server import Studio

BOAT = """\
# A boat of few voxels.
[target]
shape = "boat"     # bundled
height = "6 mm"
pitch = "250 um"

[beam]
pitch = "250 um"

[turntable]
angles = 40

[vial]
radius = "12.4 mm"
wall = "1.0 mm"
resin_index = 1.49962
wall_index = 1.473
absorption = "0.05 1/mm"

[solve]
iterations = 12

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""


@dataclass
class Client:
    """Requests of a program that has the token."""

    studio: Studio

    def raw(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes, Any]:
        """Status, body and headers."""
        line = http.client.HTTPConnection("127.0.0.1", self.studio.port, timeout=120)
        given = {"Authorization": f"Bearer {self.studio.token}"} | {k.replace("_", "-"): v for k, v in headers.items()}
        if body is not None and not isinstance(body, bytes):
            body, given = json.dumps(body).encode(), {"content-type": "application/json"} | given
        line.request(method, path if path.startswith("/static") or path == "/" else f"/api/v1{path}", body, given)
        answer = line.getresponse()
        return answer.status, answer.read(), answer.headers

    def __call__(self, method: str, path: str, body: Any = None, status: int = 200) -> Any:
        found, data, _ = self.raw(method, path, body)
        assert found == status, (found, data[:500])
        return json.loads(data)

    def arrays(self, path: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and numbers of a binary answer."""
        status, data, headers = self.raw("GET", path)
        assert status == 200, data[:500]
        found, at = {}, 0
        for said in json.loads(headers["x-arrays"]):
            values = np.frombuffer(data, said["dtype"], int(np.prod(said["shape"])), at).reshape(said["shape"])
            found[said["name"]], at = values, at + values.nbytes + -values.nbytes % 4
        assert at == len(data)
        return found, json.loads(headers["x-meta"])

    def ended(self, task: dict[str, Any], until: Callable[[dict[str, Any]], bool] | None = None) -> dict[str, Any]:
        """A task once it has ended, or fulfills a condition."""
        for _ in range(3000):
            now = self("GET", f"/tasks/{task['id']}")
            if now["state"] in ("done", "failed", "cancelled") or (until is not None and until(now)):
                return now
            time.sleep(0.1)
        raise AssertionError(f"still {now['state']}: {self.raw('GET', '/tasks/' + task['id'] + '/log')[1].decode()}")
