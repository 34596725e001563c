"""``python -m profiling.gallery``, from the top of the repository: draw the picture of one capability, or of all."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from pathlib import Path

from profiling.gallery import CATALOG, draw, names, write_index, write_page
from vamgpu.backend import open_device
from vamgpu.errors import BadInput, VamError
from vamgpu.jobs.read import toml_value


def main(arguments: list[str] | None = None) -> int:
    """Draw the entries named on the command line; without a name, list all entries."""
    parser = ArgumentParser("python -m profiling.gallery", description="Draw the picture of one capability, or of all.")
    parser.add_argument("name", nargs="?", help='which picture; "all" draws every one')
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the index and of its gallery folder")
    parser.add_argument("--device", help="where to compute; the best device here by default")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of one picture")
    parser.add_argument("--quick", action="store_true", help="small sizes, for a fast look")
    given = parser.parse_args(arguments)
    if given.name is None:
        for entry, title in CATALOG.items():
            print(f"{entry:<18}{title}")
        return 0
    try:
        _draw(given.name, given.out, given.device, given.quick, given.set)
    except VamError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _draw(name: str, out: Path, device: str | None, quick: bool, settings: list[str]) -> None:
    pairs = [setting.partition("=") for setting in settings]
    if bad := [key for key, sign, _ in pairs if not sign]:
        raise BadInput(f"--set {bad[0]}: expected key=value")
    if pairs and name == "all":
        raise BadInput("--set is for one picture; name it, such as: vial --set key=value")
    values = {key.strip(): toml_value(text.strip()) for key, _, text in pairs}
    place = open_device(device)
    for entry in names() if name == "all" else (name,):
        image, _ = write_page(draw(entry, place, quick=quick, **values), entry, out, place.name, **values)
        print(f"drew {image}")
    print(f"index {write_index(out)}")


if __name__ == "__main__":
    sys.exit(main())
