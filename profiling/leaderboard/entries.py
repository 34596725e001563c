"""The programs that are compared: each runs as a process of its own, from its own installation."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from profiling.common import HERE

PEERS = Path(os.environ.get("VAM_LEADERBOARD", ".peers"))
"""Folder of the environments that peers/leaderboard.sh makes."""
CORES = 2
"""Threads of every entry."""
RESULT = "result.json"
"""File of a finished run, in its folder."""


@dataclass(frozen=True)
class Entry:
    """A program with a method.

    Args:
        label: Of its row.
        script: Module or file that solves a case.
        method: Its argument.
        home: Its environment in `PEERS`; our own if empty.
        settings: Where its settings are from.
    """

    label: str
    script: str
    method: str
    home: str = ""
    settings: str = "its defaults"

    def run(self, case: Path, out: Path, options: tuple[str, ...] = ()) -> dict[str, Any]:
        """Facts of its run, with processor seconds of the process; {"missing": why} if it has none.

        An earlier run in the same folder is not repeated.
        """
        if (out / RESULT).exists():
            return json.loads((out / RESULT).read_text(encoding="utf-8"))
        python = str(PEERS / self.home / "bin" / "python") if self.home else sys.executable
        script = [str(HERE / "peers" / self.script)] if self.home else ["-m", self.script]
        command = [python, *script, str(case), str(out), "--method", self.method, *options]
        paths = os.pathsep.join([str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(CORES))
        out.mkdir(parents=True, exist_ok=True)
        with open(out / "log.txt", "w", encoding="utf-8") as log:
            try:
                process = subprocess.Popen(
                    command, stdout=log, stderr=subprocess.STDOUT, env=os.environ | threads | {"PYTHONPATH": paths}
                )
            except OSError as error:
                return {"missing": f"{error}; see profiling/peers/leaderboard.sh"}
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            return {"missing": (out / "log.txt").read_text(errors="replace").strip().splitlines()[-1:]}
        facts = json.loads((out / "run.json").read_text(encoding="utf-8"))
        facts["whole_s"] = round(used.ru_utime + used.ru_stime, 1)
        (out / RESULT).write_text(json.dumps(facts), encoding="utf-8")
        return facts


EXAMPLES = "those of its examples"
ENTRIES = {
    "ours": Entry("vamgpu, default", "profiling.leaderboard.ours", "default"),
    "ours-limited": Entry(
        "vamgpu, as soon as the fastest", "profiling.leaderboard.ours", "limited", "", "exposure_limit"
    ),
    "ours-lbfgs": Entry("vamgpu, L-BFGS", "profiling.leaderboard.ours", "lbfgs"),
    "recipe": Entry("automatic exposure, by vamgpu", "profiling.leaderboard.ours", "recipe", "", "those of its paper"),
    "vamtoolbox-osmo": Entry("VAMToolbox, OSMO", "vamtoolbox_frames.py", "OSMO", "vamtoolbox", EXAMPLES),
    "vamtoolbox-pm": Entry("VAMToolbox, PM", "vamtoolbox_frames.py", "PM", "vamtoolbox", EXAMPLES),
    "vamtoolbox-cal": Entry("VAMToolbox, CAL", "vamtoolbox_frames.py", "CAL", "vamtoolbox", EXAMPLES),
    "vamtoolbox-bclp": Entry("VAMToolbox, BCLP", "vamtoolbox_frames.py", "BCLP", "vamtoolbox", EXAMPLES),
    "leap": Entry("LEAP, VAM.py", "leap_frames.py", "VAM", "leap"),
    "drtvam": Entry("Dr.TVAM", "drtvam_frames.py", "default", "drtvam"),
    "drtvam-fine": Entry("Dr.TVAM, ¾ voxels", "drtvam_frames.py", "fine", "drtvam", "voxels as wide as ours"),
    "drtvam-surface": Entry("Dr.TVAM, surface-aware", "drtvam_frames.py", "surface-aware", "drtvam", EXAMPLES),
}
