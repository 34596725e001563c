"""Draw the README's picture: the mesh of the demo's boat, and beside it the print that its frames make.

python profiling/print_picture.py docs/print.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from profiling.gallery.render import rendered
from vamgpu.jobs.demo import demo
from vamgpu.metrics.surface_distance import iso_solid

SIDE = 400
"""Pixels along an edge of either half."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="the PNG file to write")
    out = parser.parse_args().out
    with TemporaryDirectory(prefix="vamgpu-picture-") as place:
        proof = demo(place).proven.proof
        assert proof.solid is not None
        slabs = list(proof.fine(proof.operator.grid.inscribed_radius))
        dose = np.concatenate([slab.dose.numpy() for slab in slabs], axis=2)
        printed = iso_solid(dose, slabs[0].pitch, proof.solid_from)
    from matplotlib.image import imsave

    imsave(out, np.concatenate([rendered(each, SIDE) for each in (proof.solid, printed)], axis=1).clip(0.0, 1.0))


if __name__ == "__main__":
    main()
