"""What requests may contain; anything else is refused with the key that is wrong."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, RootModel

Name = Annotated[str, Field(min_length=1, max_length=80)]
Text = Annotated[str, Field(max_length=1_000_000)]
Short = Annotated[str, Field(max_length=200)]
Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+){0,7}$", max_length=200)]
Scalar = bool | int | float | Annotated[str, Field(max_length=2000)]
Listed = list[Scalar | list[Scalar | list[Scalar]]]
Values = Annotated[dict[Key, Scalar | Annotated[Listed, Field(max_length=10_000)]], Field(max_length=200)]


class Strict(BaseModel):
    """A request: no unknown keys, no conversion."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Query(BaseModel):
    """The query of a request, whose values are text."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", allow_inf_nan=False)


class Check(Strict):
    text: Text


class Save(Check):
    etag: Short | None = None


class Edit(Check):
    set: Values = {}
    remove: Annotated[list[Key], Field(max_length=200)] = []


class NewJob(Strict):
    name: Name
    part: Name | None = None
    height: Short | None = None
    vial: Short | None = None
    projector: Short | None = None
    resin: Short | None = None


class Copy(Strict):
    name: Name


class Preset(Strict):
    family: Literal["vials", "projectors", "resins"]
    name: Name
    source: Short = ""
    set: Annotated[Values, Field(min_length=1)]


class Attach(Strict):
    run: Name


class Device(Strict):
    device: Short | None = None


class Solve(Device):
    kind: Literal["solve"]
    job: Name
    prove: bool = True
    fresh: bool = False
    set: Values = {}


class Model(Device):
    kind: Literal["model"]
    job: Name


class Prove(Device):
    kind: Literal["prove"]
    result: Name
    tolerances: bool = False


class Off(Strict):
    axis: Short | None = None
    spread: Short | None = None
    absorption: Short | None = None
    dose: Short | None = None


class Expose(Device):
    kind: Literal["expose"]
    result: Name
    off: Off


class Orient(Device):
    kind: Literal["orient"]
    job: Name
    count: Annotated[int, Field(ge=1, le=500)] = 20


class Export(Strict):
    kind: Literal["export"]
    result: Name
    format: Literal["png", "tiff", "npz", "mp4", "drtvam"]
    canvas: Annotated[str, Field(pattern=r"^\d{1,5}[x×]\d{1,5}$")] | None = None
    fps: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    overwrite: bool = False


class Rehearse(Strict):
    kind: Literal["rehearse"]
    result: Name
    rig: Name
    speed: Annotated[str, Field(pattern=r"^[0-9.]+( ?[a-z/]+)?$", max_length=20)] | None = None
    turns: Annotated[int, Field(ge=1, le=100_000)] | None = None
    live: bool = False


class Print(Rehearse):
    kind: Literal["print"]  # type: ignore[assignment]
    anyway: bool = False
    confirm: Name


AnyTask = Solve | Model | Prove | Expose | Orient | Export | Rehearse | Print


class Task(RootModel[Annotated[AnyTask, Field(discriminator="kind")]]):
    """One of the tasks, by its kind."""


class Looked(Query):
    proof: Name | None = None


class Slice(Looked):
    of: Literal["dose", "target", "printed"] = "dose"
    axis: Literal["x", "y", "z"] = "z"
    index: Annotated[int, Field(ge=0, le=100_000)]
    dose: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0


class Volume(Looked):
    of: Literal["dose", "target"] = "dose"
    most: Annotated[int, Field(ge=8, le=256)] = 128
    dtype: Literal["uint8", "float16"] = "uint8"


class Bins(Looked):
    bins: Annotated[int, Field(ge=8, le=4096)] = 256


class Exposure(Looked):
    dose: Annotated[float, Field(gt=0.0, le=1000.0)] = 1.0


class Surface(Exposure):
    of: Literal["printed", "target", "stray"] = "printed"


class Frame(Query):
    index: Annotated[int, Field(ge=0, le=10_000_000)]
    plane: Annotated[int, Field(ge=0, le=1000)] | None = None


class StackSlice(Query):
    of: Literal["before", "after"] = "before"
    index: Annotated[int, Field(ge=0, le=10_000_000)]


class StackReport(Query):
    of: Literal["model", "correct"] = "correct"


class Sinogram(Query):
    row: Annotated[int, Field(ge=0, le=100_000)] | None = None


class Triangles(Query):
    most: Annotated[int, Field(ge=100, le=1_000_000)] = 120_000


class Upload(Query):
    name: Name
    overwrite: bool = False


class Compare(Query):
    a: Name
    b: Name


class Kind(Query):
    kind: Literal["vial", "web", "slices"] = "vial"


class Speed(Query):
    speed: Annotated[float, Field(gt=0.0, le=1e6)] | None = None


class Nothing(Query):
    """No query."""
