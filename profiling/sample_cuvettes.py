"""Images and readings of cuvettes, for a first try of ``vam calibrate scatter``.

``python profiling/sample_cuvettes.py cuvettes`` follows single photons of a resin with 0.6 events per mm, g = 0.85 and
an absorption of 0.05 /mm through three cuvettes, and writes a folder with three images and ``cuvettes.toml``. The
photons are those of a program of the tests that shares nothing with the fit.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "physics"))
from cuvettes import ACCEPTANCE, BEAM, GLASS, HOLE, PIXEL, PORT, RESIN, SCREEN, WALL, WIDTH, Liquid, measured

HEAD = f"""[cuvette]
width = "{WIDTH} mm"
wall = "{WALL} mm"
resin_index = {RESIN}
wall_index = {GLASS}
beam = "{BEAM} mm"
acceptance = "{ACCEPTANCE} rad"
port = "{PORT} mm"
screen = "{SCREEN} mm"
pixel = "{PIXEL} mm"
hole = "{HOLE} mm"
dark = 100.0
"""


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("folder", type=Path, help="a new folder")
    options.add_argument("--liquid", type=float, nargs=3, default=(0.6, 0.85, 0.05), help="μ_s, g and absorption")
    options.add_argument("--thickness", type=float, nargs="+", default=(0.6, 1.5, 3.4), help="of the resin [mm]")
    options.add_argument("--photons", type=int, default=250_000)
    given, rng = options.parse_args(), np.random.default_rng(0)
    given.folder.mkdir(parents=True)
    text = HEAD
    for thickness in given.thickness:
        found = measured(thickness, Liquid(*given.liquid), given.photons, rng)
        Image.fromarray(found["image"]).save(given.folder / f"{thickness:g}mm.tif")
        text += f'\n[[sample]]\nthickness = "{thickness} mm"\ncollimated = {found["collimated"]:.5f}\n'
        text += f'total = {found["total"]:.5f}\nimage = "{thickness:g}mm.tif"\n'
    (given.folder / "cuvettes.toml").write_text(text, encoding="utf-8")
    print(f"wrote {given.folder}; read it with: vam calibrate scatter {given.folder / 'cuvettes.toml'}")


if __name__ == "__main__":
    main()
