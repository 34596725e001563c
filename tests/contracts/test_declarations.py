"""The one declaration of a kernel against what the OpenCL compiler and Warp say of its siblings."""

from __future__ import annotations

import pyopencl as cl
import pytest
import warp as wp

from vamgpu.backend import open_device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.backend.warp import TYPES, sibling
from vamgpu.kernels.catalog import FOLDER, bytes_per_item, concepts, declared, kernels, readme
from vamgpu.kernels.mask import mask_bytes
from vamgpu.kernels.planes import split_planes
from vamgpu.kernels.rebin import rebin_rays
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table
from vamgpu.kernels.update import apply_penalty, linear

C_NAMES = {"float32": "float", "int32": "int", "uint8": "uchar", "uint32": "uint", "int64": "long"}

every_kernel = pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)


@pytest.mark.parametrize("concept", concepts())
def test_a_concept_has_three_siblings_unless_all_are_written_from_its_definition(concept: str) -> None:
    pointwise = all(kernel.pointwise for kernel in declared(concept))
    for ending in (".cl", "_warp.py"):
        assert (FOLDER / f"{concept}{ending}").exists() != pointwise


def opencl_types(spec: Field | Table | Scalar) -> set[str]:
    """Spellings the OpenCL compiler may report for an argument."""
    if isinstance(spec, Scalar):
        return {C_NAMES[spec.dtype]}
    if isinstance(spec, Field):
        return {"float*"}
    name = C_NAMES[spec.dtype]
    last = spec.axes[-1]
    return {f"{name}*", f"{name}{last}*"} if last.isdigit() else {f"{name}*"}


@every_kernel
def test_the_opencl_sibling_takes_the_declared_arguments(
    kernel: Kernel, processor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device, build = open_device(processor), cl.Program.build
    quick = ["-cl-opt-disable"]  # nothing is run
    monkeypatch.setattr(cl.Program, "build", lambda self, options, **more: build(self, [*options, *quick], **more))
    assert isinstance(device, OpenclDevice)
    compiled = device.compile(kernel, device.lanes_for(8), cached=False)
    reported_names = [str(compiled.get_arg_info(i, cl.kernel_arg_info.NAME)) for i in range(compiled.num_args)]
    names = [name.removeprefix("_cl_") for name in reported_names]  # PoCL renames what collides with a built-in
    assert names == [*kernel.arguments, *(f"n_{axis}" for axis in kernel.axes)]
    for index, (name, spec) in enumerate(kernel.arguments.items()):
        reported = str(compiled.get_arg_info(index, cl.kernel_arg_info.TYPE_NAME)).replace(" ", "")
        assert reported in opencl_types(spec), name


@every_kernel
def test_the_warp_sibling_takes_the_declared_arguments(kernel: Kernel) -> None:
    arguments = sibling(kernel).adj.args  # pyright: ignore[reportAttributeAccessIssue]
    assert [argument.label for argument in arguments] == [*kernel.arguments, *(f"n_{axis}" for axis in kernel.axes)]
    for argument in arguments[: len(kernel.arguments)]:
        spec = kernel.arguments[argument.label]
        if isinstance(spec, Scalar):
            assert argument.type in (TYPES[spec.dtype], {"float32": float, "int32": int}.get(spec.dtype))
        elif isinstance(spec, Field):
            assert argument.type.dtype is wp.vec4 and argument.type.ndim in (2, 4)
        else:
            assert argument.type.dtype is TYPES[spec.dtype] and argument.type.ndim == len(spec.axes)


@every_kernel
def test_the_definition_says_what_it_computes(kernel: Kernel) -> None:
    assert kernel.definition.__doc__
    assert kernel.over in kernel.arguments
    assert any(getattr(spec, "writes", False) for spec in kernel.arguments.values())


def test_the_readme_is_what_the_catalog_writes() -> None:
    assert (FOLDER / "README.md").read_text(encoding="utf-8") == readme(), "run python -m vamgpu.kernels.catalog"


def test_bytes_per_item_follow_the_declaration() -> None:
    sizes = {
        kernel.name: (bytes_per_item(kernel, written=False), bytes_per_item(kernel, written=True))
        for kernel in (linear, apply_penalty, rebin_rays, mask_bytes, split_planes)
    }
    assert sizes == {
        "linear": ("8", "4"),
        "apply_penalty": ("8", "4 + *parts*"),
        "rebin_rays": ("4·column/r + *rays*", "4"),
        "mask_bytes": ("1 + *mask*", "1"),
        "split_planes": ("*images* + *masks* + *chosen*", "8·row·width/strip + 4"),
    }


def test_sizes_belong_to_the_caller() -> None:
    """They are found once for the same shapes."""
    shapes: dict[str, tuple[int, ...]] = {name: (2, 3, 4) for name in ("x", "y", "out")}
    linear.sizes(shapes).clear()
    assert linear.sizes(shapes) == {"i": 2, "j": 3, "z": 4}
