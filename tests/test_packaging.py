"""What is shipped, against what is on the disk."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = {"vamgpu.kernels": "kernels", "vamgpu.hosts": "hosts"}


def tracked() -> list[str]:
    """Files of the repository, ignored ones left out."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.splitlines() if (ROOT / name).exists()]


def module_of(folder: str) -> str:
    """Dotted name of the package a folder of the repository is."""
    dotted = folder.replace("/", ".")
    return dotted if dotted.startswith("vamgpu") else f"vamgpu.{dotted}"


def shipped(name: str) -> bool:
    return name.startswith(("vamgpu/", "kernels/", "hosts/")) and not (ROOT / name).is_symlink()


def test_the_package_list_is_what_is_on_the_disk() -> None:
    on_disk = {module_of(name.rsplit("/", 1)[0]) for name in tracked() if shipped(name) and name.endswith(".py")}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == on_disk


def test_kernels_and_hosts_stand_beside_the_package_and_are_linked_into_it() -> None:
    mapped = PROJECT["tool"]["setuptools"]["package-dir"]
    for package, folder in FOLDERS.items():
        assert mapped[package] == folder
        link = ROOT / "vamgpu" / folder
        assert link.is_symlink() and link.resolve() == ROOT / folder


def test_the_command_is_what_the_project_says() -> None:
    module, name = PROJECT["project"]["scripts"]["vam"].split(":")
    assert callable(getattr(__import__(module, fromlist=[name]), name))


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = ("pyopencl", "warp", "trimesh", "scipy", "skimage", "matplotlib", "zarr", "pydantic", "av", "PIL")
    script = f"import sys, vamgpu; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    import vamgpu

    for name in vamgpu.__all__:
        assert getattr(vamgpu, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        _ = vamgpu.nonsense  # type: ignore[attr-defined]


def test_type_checkers_are_told_of_the_same_names() -> None:
    import vamgpu

    stub = (ROOT / "vamgpu" / "__init__.pyi").read_text(encoding="utf-8")
    told = {(name, module) for module, names in re.findall(r"^from (\S+) import ([^(\n]+|\([^)]*\))", stub, re.M)
            for name in re.findall(r"(\w+) as \1", names)}  # fmt: skip
    assert told == set(vamgpu._PUBLIC.items())  # pyright: ignore[reportAttributeAccessIssue]


def test_a_wheel_holds_every_file(tmp_path: Path) -> None:
    """Built from a copy, so that nothing is left in the repository."""
    names = tracked()
    copy = tmp_path / "copy"
    for name in names:
        place = copy / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            place.symlink_to((ROOT / name).readlink())
        elif shipped(name) or "/" not in name:
            place.write_bytes((ROOT / name).read_bytes())
    script = f"from setuptools import build_meta; build_meta.build_wheel({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", script], cwd=copy, capture_output=True, text=True, check=True)
    held = set(zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist())
    wanted = {name if name.startswith("vamgpu/") else f"vamgpu/{name}" for name in names if shipped(name)}
    assert wanted <= held
    assert {name for name in held if ".dist-info/" not in name} == wanted
