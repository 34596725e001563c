"""Build what the page of Studio takes from npm: three.js cut to what the page calls, and its typeface.

``python -m profiling.studio_assets [FOLDER]``, with npm installed. The texts of the licenses stand beside the files.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

STATIC = Path(__file__).resolve().parent.parent / "vamgpu" / "studio" / "static"
PACKAGES = {"three": "0.187.0", "esbuild": "0.28.2", "@fontsource-variable/inter": "5.2.8"}
CALLED = [
    "AmbientLight",
    "ArrowHelper",
    "BufferAttribute",
    "BufferGeometry",
    "Color",
    "CylinderGeometry",
    "DirectionalLight",
    "DoubleSide",
    "BackSide",
    "Group",
    "HemisphereLight",
    "Line",
    "LineBasicMaterial",
    "LineDashedMaterial",
    "LineLoop",
    "LineSegments",
    "Matrix4",
    "Mesh",
    "MeshBasicMaterial",
    "MeshStandardMaterial",
    "OrthographicCamera",
    "PerspectiveCamera",
    "PlaneGeometry",
    "Quaternion",
    "Raycaster",
    "Scene",
    "Vector2",
    "Vector3",
    "WebGLRenderer",
]
"""Names of three.js that the page imports; the bundle holds these and what they need."""
CONTROLS = ("OrbitControls", "TransformControls")


def entry() -> str:
    """The module that the bundle starts from."""
    lines = [f'export {{ {", ".join(CALLED)} }} from "three";']
    lines += [f'export {{ {name} }} from "three/addons/controls/{name}.js";' for name in CONTROLS]
    return "\n".join(lines)


def build(static: Path = STATIC) -> list[Path]:
    """Write the bundle, the typeface and their licenses; return their paths."""
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        (work / "package.json").write_text(json.dumps({"private": True, "dependencies": PACKAGES}))
        (work / "entry.js").write_text(entry())
        subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund"], cwd=work, check=True)
        options = ["--bundle", "--minify", "--format=esm", "--legal-comments=inline", "--log-level=warning"]
        subprocess.run(["npx", "esbuild", "entry.js", *options, "--outfile=three.js"], cwd=work, check=True)
        modules = work / "node_modules"
        inter = modules / "@fontsource-variable" / "inter"
        made = {
            "three.js": work / "three.js",
            "three.LICENSE.txt": modules / "three" / "LICENSE",
            "inter.woff2": inter / "files" / "inter-latin-wght-normal.woff2",
            "inter.LICENSE.txt": inter / "LICENSE",
        }
        return [Path(shutil.copyfile(source, static / name)) for name, source in made.items()]


if __name__ == "__main__":
    for path in build(Path(sys.argv[1]) if len(sys.argv) > 1 else STATIC):
        print(f"wrote {path.name}: {path.stat().st_size / 1000:.0f} kB")
