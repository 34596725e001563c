"""The command line of every task; a task does what a person could type."""

from __future__ import annotations

import re
from itertools import chain, count
from pathlib import Path
from typing import Any

from vamgpu.jobs.curethrough import CurethroughJob
from vamgpu.jobs.keys import toml_of
from vamgpu.jobs.web import is_web_folder
from vamgpu.studio.workspace import JOB, PROOF, RESULT, Refused, Workspace, kind_of, record_of

ENDINGS = {"png": "-png", "tiff": ".tiff", "npz": ".npz", "mp4": ".mp4", "drtvam": "-drtvam"}
"""Format of an export → end of its name."""
FOUND = ".orientations.json"  # end of the name of a file with orientations


class Command:
    """A task's command line in the workspace, and what it makes. progress: its progress is recorded beside it."""

    def __init__(self, workspace: Workspace, request: dict[str, Any]) -> None:
        self._workspace = workspace
        self.request: dict[str, Any] = request
        self.kind: str = str(request["kind"])
        self.job: str | None = request.get("job")
        self.result: str | None = request.get("result")
        self.rig: str | None = request.get("rig")
        self.run: str | None = None
        self.made: list[str] = []
        self.progress: str | None = None
        self.arguments: list[str] = getattr(self, f"_{'run' if self.rig else self.kind}")(request)

    @property
    def lane(self) -> str:
        """Tasks of one lane run one after another."""
        own = self.kind in ("export", "rehearse")
        return self.kind if own else f"print {self.rig}" if self.rig else f"device {self.request.get('device') or ''}"

    def uses(self) -> set[str]:
        """Names in the workspace that must stay while it runs."""
        return {name for name in (self.job, self.result, self.rig, self.run, *self.made) if name}

    def _solve(self, asked: dict[str, Any]) -> list[str]:
        job = self._workspace.existing(asked["job"], JOB)
        fresh = ["--overwrite"] if asked["fresh"] else []
        if kind_of(job) == "slices":
            place = self._workspace.place(CurethroughJob.read(job).beside().name)
            self.result, page = place.name, f"{place.stem}.html"
            if place.exists() and not fresh:
                raise Refused(409, f"{self.result} exists; ask for a fresh correction to replace it")
            self.made, self.progress = [self.result, page], page
            return ["curethrough", "correct", job.name, "--out", self.result, "--report", page, *fresh,
                    *self._settings(asked, "correct")]  # fmt: skip
        self.result = job.with_suffix(RESULT).name
        place = self._workspace.folder / self.result
        state = "interrupted" if fresh or not record_of(place).is_file() else self._workspace.state(place)[0]
        if state != "interrupted":
            raise Refused(409, f"{self.result} is {state}; ask for a fresh solution to replace it")
        self.made, self.progress = [self.result], self.result
        return ["solve", job.name, "--out", self.result, "--slices", *fresh, *self._settings(asked, "solve")]

    @staticmethod
    def _settings(asked: dict[str, Any], table: str) -> list[str]:
        """Keys of a job that a task replaces."""
        settings = asked.get("set", {}) | ({f"{table}.device": asked["device"]} if asked["device"] else {})
        return [*chain.from_iterable(("--set", f"{key}={toml_of(value)}") for key, value in settings.items())]

    def _model(self, asked: dict[str, Any]) -> list[str]:
        job = self._workspace.existing(asked["job"], JOB)
        self.made = [f"{job.stem}-model.html"]
        self.progress = self.made[0]
        return ["curethrough", "model", job.name, "--report", self.made[0], *self._settings(asked, "correct")]

    def _prove(self, asked: dict[str, Any]) -> list[str]:
        given = self._proof("", asked)
        page = f"{Path(asked['result']).stem}.html"
        self.made = list(dict.fromkeys([*self.made, page]))
        return [*given, "--report", page, *(["--tolerances"] if asked["tolerances"] else [])]

    def _expose(self, asked: dict[str, Any]) -> list[str]:
        off = {name: amount for name, amount in asked["off"].items() if amount}
        if not off:
            raise Refused(400, "got no error of the machine; expected axis, spread, absorption or dose with an amount")
        words = (re.sub(r"[^A-Za-z0-9.]+", "", amount.replace("-", "minus")) for amount in off.values())
        slug = "-".join(f"{name}-{word}" for name, word in zip(off, words, strict=True))
        pairs = chain.from_iterable(("--off", f"{name}={amount}") for name, amount in off.items())
        return [*self._proof(f".off-{slug[:30]}", asked), *pairs]

    def _proof(self, mark: str, asked: dict[str, Any]) -> list[str]:
        place = self._workspace.existing(asked["result"], RESULT)
        device = ["--device", asked["device"]] if asked["device"] else []
        if is_web_folder(place):
            self.progress = f"{place.stem}.html"
            self.made = [self.progress]
            return ["prove", place.name, *device]
        self.progress = f"{place.stem}{mark}{PROOF}"
        self.made = [self.progress]
        return ["prove", place.name, "--save", self.progress, "--overwrite", *device]

    def _orient(self, asked: dict[str, Any]) -> list[str]:
        job = self._workspace.existing(asked["job"], JOB)
        self.made = [job.stem + FOUND]
        self.progress = self.made[0]
        device = ["--device", asked["device"]] if asked["device"] else []
        return ["orient", job.name, "--out", self.made[0], "--count", str(asked["count"]), "--overwrite", *device]

    def _export(self, asked: dict[str, Any]) -> list[str]:
        place, how = self._workspace.existing(asked["result"], RESULT), asked["format"]
        self.made = [place.stem + ENDINGS[how]]
        if (self._workspace.folder / self.made[0]).exists() and not asked["overwrite"]:
            raise Refused(409, f"{self.made[0]} exists; allow to overwrite it")
        more = [each for key in ("canvas", "fps") if asked[key] is not None for each in (f"--{key}", str(asked[key]))]
        return ["export", place.name, f"--{how}", self.made[0], *more,
                *(["--overwrite"] if asked["overwrite"] else [])]  # fmt: skip

    def _run(self, asked: dict[str, Any]) -> list[str]:
        """A print or a rehearsal."""
        place = self._workspace.existing(asked["result"], RESULT)
        if asked["rig"] != "emulated":
            self._workspace.existing(asked["rig"], JOB)
        dry = self.kind == "rehearse"
        if not dry and asked["confirm"] != place.name:
            raise Refused(400, f"got {asked['confirm']!r} as confirmation; expected {place.name!r}")
        ending = ".dry-run" if dry else ".run"
        names = (place.stem + number + ending for number in chain([""], (f"-{each}" for each in count(2))))
        self.run = next(name for name in names if not (self._workspace.folder / name).exists())
        self.made, self.progress = [self.run], self.run
        more = [each for key in ("speed", "turns") if asked[key] is not None for each in (f"--{key}", str(asked[key]))]
        how = ["--dry-run"] if dry else ["--panel", *(["--anyway"] if asked["anyway"] else [])]
        live = ["--live"] if asked["live"] else []
        return ["print", place.name, "--rig", asked["rig"], "--out", self.run, *how, *live, *more]


def newest(workspace: Workspace, names: list[str]) -> float:
    """Time of the last change of what a task made [s]; 0 if something is missing."""
    made = [workspace.folder / name for name in names]
    made = [record_of(path) if path.suffix in (RESULT, PROOF) else path for path in made]
    return min((path.stat().st_mtime if path.exists() else 0.0 for path in made), default=0.0)
