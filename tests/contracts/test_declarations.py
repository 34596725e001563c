"""The one declaration of a kernel against what the OpenCL compiler and Warp say of its siblings."""

from __future__ import annotations

import pyopencl as cl
import pytest
import warp as wp

from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.backend.warp import TYPES, sibling
from vamgpu.kernels.catalog import FOLDER, concepts, kernels, markdown
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table

C_NAMES = {"float32": "float", "int32": "int", "uint8": "uchar", "uint32": "uint", "int64": "long"}

every_kernel = pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)


@pytest.mark.parametrize("concept", concepts())
def test_a_concept_has_three_siblings(concept: str) -> None:
    for ending in (".py", ".cl", "_warp.py"):
        assert (FOLDER / f"{concept}{ending}").exists()


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
def test_the_opencl_sibling_takes_the_declared_arguments(kernel: Kernel, opencl_device: Device) -> None:
    assert isinstance(opencl_device, OpenclDevice)
    compiled = opencl_device.compile(kernel, opencl_device.lanes_for(8), cached=False)
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


def test_the_readme_lists_every_kernel_as_declared() -> None:
    assert (FOLDER / "README.md").read_text(encoding="utf-8").endswith(markdown() + "\n")
