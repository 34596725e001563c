"""No module opens files but `vamgpu.storage.reading` and those beside it that decode what it opened."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from trees import tree_of

ROOT = Path(__file__).parents[2]
DECODERS = {
    "vamgpu/storage/memory.py": {"read_text"},  # what the system says of a container
    "vamgpu/storage/reading.py": {"tomllib.loads", "json.loads", "os.open"},
    "vamgpu/storage/numpy_files.py": {"np.memmap"},
    "vamgpu/storage/zips.py": {"ZipFile"},
    "vamgpu/storage/images.py": {"Image.open", "OpenEXR.File"},
    "vamgpu/storage/films.py": {"av.open"},  # of an open file
    "vamgpu/storage/atomic.py": {"os.open"},  # for locks and fsync
    "vamgpu/jobs/progress.py": {"os.open"},  # for locks
    "vamgpu/studio/workspace.py": {"os.open"},  # for a lock
    "vamgpu/targets/mesh.py": {"trimesh.load_scene"},  # of bytes
    "vamgpu/curethrough/images.py": {"Image.open"},  # of bytes
    "vamgpu/reports/style.py": {"Image.open"},  # of bytes that were drawn here
    "vamgpu/webs/store.py": {"zarr.open_array"},  # to write
    # what comes with the library, the system or a process of its own
    "vamgpu/reports/page.py": {"read_text"},
    "kernels/catalog.py": {"read_text", "json.loads"},
    "kernels/pointwise.py": {"read_text"},
    "vamgpu/__init__.py": {"read_text"},
    "vamgpu/backend/kernel_cache.py": {"read_bytes"},  # this user's own, checked by the driver
    "vamgpu/backend/opencl.py": {"read_bytes"},
    "vamgpu/studio/presets.py": {"read_text"},
    "vamgpu/studio/routes.py": {"read_bytes"},
    "vamgpu/studio/tasks.py": {"open"},  # what its processes said
    "vamgpu/studio/volumes.py": {"np.memmap"},  # of a file that it wrote
    "vamgpu/backend/opencl_platforms.py": {"read_bytes"},
    "vamgpu/jobs/bench.py": {"open"},
    "vamgpu/cli/__init__.py": {"os.open"},
    "vamgpu/cli/doctor.py": {"json.loads"},
    # machines are devices, and a run's record is opened to write
    "hosts/drivers/wire.py": {"os.open"},
    "hosts/records/record.py": {"os.open", "open"},
    "hosts/process/messages.py": {"os.open"},  # the system's sink
    "hosts/panel/routes.py": {"read_bytes"},  # what comes with the library
    "hosts/firmware/bench/bench.py": {"open"},  # a script of its own
}
READERS = {
    "read_text", "read_bytes", "tomllib.load", "tomllib.loads", "json.load", "json.loads", "os.open", "io.open",
    "np.load", "np.fromfile", "np.memmap", "np.loadtxt", "np.genfromtxt", "ZipFile", "zipfile.ZipFile", "tarfile.open",
    "Image.open", "imread", "trimesh.load", "trimesh.load_mesh", "trimesh.load_scene", "zarr.open", "zarr.open_array",
    "zarr.open_group", "open", "av.open", "OpenEXR.File", "OpenEXR.InputFile", "pickle.load", "pickle.loads",
    "pickle.Unpickler", "dill.load", "dill.loads",
}  # fmt: skip
HANDLES = ("vamgpu.storage.reading", "vamgpu.jobs.read")
FOLDERS = ("vamgpu", "kernels", "hosts")


def calls(text: str) -> set[str]:
    """Calls of a module that read files, as they are written."""
    tree, found = tree_of(text), set[str]()
    ours = {
        name.asname or name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in HANDLES
        for name in node.names
    } | {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        last = name.rpartition(".")[2]
        said = [value.value for value in (*node.args, *(key.value for key in node.keywords))
                if isinstance(value, ast.Constant)]  # fmt: skip
        writes = any(isinstance(value, str) and value[:1] in "wax" and len(value) < 4 for value in said if value)
        opens = {key.arg for key in node.keywords} & {"newline", "encoding", "buffering", "mode"} or "rb" in said
        if name in ours or name.startswith("reading.") or writes:
            continue
        found |= {name} & READERS or {last} & (READERS - {"open"}) or ({"open"} if last == "open" and opens else set())
    return found


def test_every_file_is_opened_in_one_place() -> None:
    files = [
        file
        for folder in FOLDERS
        for file in sorted((ROOT / folder).rglob("*.py"))
        if not any(part.is_symlink() for part in file.parents)
    ]
    assert len(files) > 200
    found = {file.relative_to(ROOT).as_posix(): calls(file.read_text(encoding="utf-8")) for file in files}
    odd = {name: each - DECODERS.get(name, set()) for name, each in found.items() if each - DECODERS.get(name, set())}
    assert not odd, f"read files through vamgpu.storage.reading, or name the reason here: {odd}"
    needless = {name: each - found.get(name, set()) for name, each in DECODERS.items() if each - found.get(name, set())}
    assert not needless, f"take these out of the list: {needless}"


@pytest.mark.parametrize(
    "text",
    ["open(path)", "path.open('rb')", "path.open(encoding='utf-8')", "Path(path).read_text()", "np.load(path)",
     "Image.open(path)", "zarr.open_array(path)", "trimesh.load(path)", "ZipFile(path)", "json.loads(text)",
     "pickle.loads(data)", "av.open(path)", "OpenEXR.File(path)"],
)  # fmt: skip
def test_the_rule_sees_what_it_forbids(text: str) -> None:
    assert calls(text)
    assert not calls("open(path, 'w'); path.open('wb'); Folder.open(path); Dmd.open(path, 3)")
    assert not calls("from vamgpu.storage.reading import read_text\nread_text(path)")
