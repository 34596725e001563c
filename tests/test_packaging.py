"""What is shipped, against what is on the disk."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from functools import partial
from importlib import import_module
from pathlib import Path

import jinja2
import pytest
import yaml

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
    """What is part of a package; what stands beside the sketch is data."""
    ours = name.startswith(("vamgpu/", "kernels/", "hosts/")) and not name.startswith("hosts/firmware/")
    return ours and not (ROOT / name).is_symlink()


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


def test_a_public_name_comes_from_the_module_that_type_checkers_read() -> None:
    import vamgpu

    tree = ast.parse((ROOT / "vamgpu" / "__init__.pyi").read_text("utf-8"))
    told = [(each, node.module) for node in tree.body if isinstance(node, ast.ImportFrom) for each in node.names]
    assert [alias.asname for alias, _ in told] == vamgpu.__all__[:-1]
    for alias, module in told:
        if alias.name != "live":  # the package of that name stands for the function
            assert getattr(vamgpu, alias.name) is getattr(import_module(str(module)), alias.name)


def copied(names: list[str], copy: Path) -> Path:
    """The repository without what is not shipped, so that nothing is left in it by a build."""
    for name in names:
        place = copy / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            place.symlink_to((ROOT / name).readlink())
        elif shipped(name) or "/" not in name:
            place.write_bytes((ROOT / name).read_bytes())
    return copy


def test_a_wheel_holds_every_file(tmp_path: Path) -> None:
    names = tracked()
    copy = copied(names, tmp_path / "copy")
    script = f"from setuptools import build_meta; build_meta.build_wheel({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", script], cwd=copy, capture_output=True, text=True, check=True)
    held = set(zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist())
    wanted = {name if name.startswith("vamgpu/") else f"vamgpu/{name}" for name in names if shipped(name)}
    assert wanted <= held
    assert {name for name in held if ".dist-info/" not in name} == wanted


def built_sdist(tmp_path: Path) -> Path:
    """An sdist of all that is tracked."""
    copy = tmp_path / "whole"
    for name in tracked():
        place = copy / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            place.symlink_to((ROOT / name).readlink())
        else:
            place.write_bytes((ROOT / name).read_bytes())
    script = f"from setuptools import build_meta; build_meta.build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", script], cwd=copy, capture_output=True, text=True, check=True)
    return next(tmp_path.glob("*.tar.gz"))


def test_an_sdist_holds_only_the_library(tmp_path: Path) -> None:
    with tarfile.open(built_sdist(tmp_path)) as archive:
        held = {member.name.partition("/")[2] for member in archive if member.isfile()}
    linked = {name for name in held if (ROOT / name.split("/")[0] / (name.split("/") + [""])[1]).is_symlink()}
    wanted = {name for name in tracked() if shipped(name) and not name.startswith(("vamgpu/kernels", "vamgpu/hosts"))}
    assert wanted <= held and not linked
    beside = {name for name in held - wanted if not name.startswith("hosts/firmware/") and ".egg-info/" not in name}
    assert beside == {"LICENSE", "MANIFEST.in", "PKG-INFO", "README.md", "pyproject.toml", "setup.cfg"}


def runs(python: str) -> bool:
    """Whether there is such a Python here, and not just a name that points nowhere."""
    return shutil.which(python) is not None and subprocess.run([python, "-V"], capture_output=True).returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("python", ["python3.11", "python3.12", "python3.13", "python3.14"])
def test_an_sdist_installs_into_an_empty_environment(python: str, tmp_path: Path) -> None:
    if not runs(python):
        pytest.skip(f"no {python} here")
    place = tmp_path / "empty"
    subprocess.run([python, "-m", "venv", str(place)], check=True)
    pip = [str(place / "bin" / "pip"), "install", "-q", "--no-compile"]
    subprocess.run([*pip, str(built_sdist(tmp_path))], check=True)
    script = (
        "import vamgpu as vam, numpy as np; print(vam.__file__)\n"
        "A = vam.Projection(vam.Grid((8, 8, 4), 0.1), vam.Beam((8, 4), 0.1), vam.Turntable(6), device='numpy')\n"
        "assert A.dot_test() < 1e-12"
    )
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    run = partial(subprocess.run, cwd=tmp_path, env=clean, capture_output=True, text=True, check=True)
    assert str(place) in run([str(place / "bin" / "python"), "-c", script]).stdout
    assert "solve" in run([str(place / "bin" / "vam"), "--help"]).stdout


def test_the_recipe_for_conda_is_what_the_project_says() -> None:
    text = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)
    recipe = yaml.safe_load(environment.from_string(text).render(environ={}, PYTHON="python"))
    assert recipe["package"] == {"name": "vamgpu", "version": __import__("vamgpu").__version__}
    renamed = {"matplotlib": "matplotlib-base"}
    wanted = {
        re.sub(r"^[a-z0-9-]+", lambda m: renamed.get(m[0], m[0]), one) for one in PROJECT["project"]["dependencies"]
    }
    asked = {one.replace(" ", "") for one in recipe["requirements"]["run"]}
    assert asked == wanted | {"python" + PROJECT["project"]["requires-python"]}
    assert {one.replace(" ", "") for one in recipe["requirements"]["host"]} >= set(PROJECT["build-system"]["requires"])
    (entry,) = recipe["build"]["entry_points"]
    assert entry.replace(" ", "") == "vam=" + PROJECT["project"]["scripts"]["vam"]
    assert set(recipe["test"]["imports"]) <= set(PROJECT["tool"]["setuptools"]["packages"])


def test_dir_lists_public_names_alone() -> None:
    import vamgpu

    assert vamgpu.Grid  # loads a module, which becomes an attribute
    assert dir(vamgpu) == sorted(vamgpu.__all__)
