"""Kernels whose samples do not depend on each other: their OpenCL and Warp versions are written from the definition.

Such a definition assigns to names and to its fields, ``out[...] = …``. It may use arithmetic, squares, comparisons,
``& | ~``, functions of NumPy that `NUMPY` lists, tables along one axis of its fields or the first two, the functions
below, functions of its own file (their statements are copied to each call), and loops ``for _ in range(…)``, which
``if np.all(…): break`` may end. All fields are read before any is written: outputs may be inputs.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from types import FunctionType
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from vamgpu.errors import KernelError
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table, Tiling

Parts = Annotated[np.ndarray, Table("float32", ("part",), writes=True)]
CPU = Tiling(major=1, minor=0)
PARTIAL = Tiling(major=32, minor=1)
"""What a GPU's item owns in kernels with partial results."""


def disc(n_i: int, n_j: int, reach: float) -> np.ndarray:
    """Boolean (n_i, n_j): samples at most ``reach`` samples from the middle."""
    i, j = (np.arange(n) - 0.5 * (n - 1) for n in (n_i, n_j))
    return i[:, None] ** 2 + j[None, :] ** 2 <= reach**2


def near_axis(field: np.ndarray, reach: float) -> np.ndarray:
    """Boolean (n_i, n_j, 1): samples of a field at most ``reach`` samples from the z axis."""
    return disc(field.shape[0], field.shape[1], reach)[:, :, None]


def look_up(dose: np.ndarray, samples: np.ndarray, start: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples at a dose, interpolated linearly and continued beyond the ends, and the increase to the next."""
    position = (dose - start) * density
    cell = np.clip(np.floor(position), 0, len(samples) - 2).astype(int)
    rise = samples[cell + 1] - samples[cell]
    return samples[cell] + rise * (position - cell), rise


def cyclic(table: np.ndarray, field: np.ndarray) -> np.ndarray:
    """The table's number for each of a field's major samples, again from the first after the last."""
    return np.resize(table, len(field))[:, None, None]


def _fold(parts: np.ndarray, values: np.ndarray, combine: np.ufunc, identity: float) -> None:
    parts[...] = identity
    parts[0] = combine.reduce(values, axis=None, initial=identity)


def add_up(parts: np.ndarray, values: np.ndarray) -> None:
    """Σ parts = Σ values."""
    _fold(parts, values, np.add, 0.0)


def keep_least(parts: np.ndarray, values: np.ndarray) -> None:
    """Least of parts = least of values."""
    _fold(parts, values, np.minimum, np.inf)


def keep_most(parts: np.ndarray, values: np.ndarray) -> None:
    """Greatest of parts = greatest of values."""
    _fold(parts, values, np.maximum, -np.inf)


FOLDS: dict[Any, tuple[int, str, float]] = {
    add_up: (0, "add", 0.0), keep_least: (1, "minimum", math.inf), keep_most: (2, "maximum", -math.inf),
}  # fmt: skip
"""A function for partial results → its number in ``across_vectors``, its operation, and what changes nothing."""


def pointwise(over: str) -> Callable[[Callable[..., None]], Kernel]:
    """Declare the decorated NumPy definition as a kernel that is written for all devices from it."""

    def declare(definition: Callable[..., None]) -> Kernel:
        declared = Kernel(definition, over, cpu=CPU, pointwise=True)
        return Kernel(definition, over, cpu=CPU, gpu=PARTIAL if _parts(declared) else Tiling(), pointwise=True)

    return declare


Language: TypeAlias = dict[str, str]
OPENCL: Language = {
    "literal": "(Vector)({0}f)", "infinity": "(Vector)(INFINITY)", "scalar": "(Vector)({0})",
    "declare": "Vector {0} = {1};", "declare condition": "Lanes {0} = {1};",
    "change": "{0} = {1};", "load": "Vector {1} = LOAD({0} + at);", "store": "STORE({0} + at, {1});",
    "loop": "for (int {0} = 0; {0} < {1}; {0}++) {{", "leave": "if (all({0})) break;", "close": "}}",
    "where": "select({2}, {1}, {0})", "maximum": "fmax({0}, {1})", "minimum": "fmin({0}, {1})", "exp": "exp({0})",
    "clip": "fmin(fmax({0}, {1}), {2})", "log": "log({0})", "sqrt": "sqrt({0})", "abs": "fabs({0})",
    "power": "raised({0}, {1})", "and": "({0} & {1})", "or": "({0} | {1})", "not": "(~{0})", "add": "({0} + {1})",
    "even": "(Lanes)(all({0} {2} {1}) ? -1 : 0)", "uneven": "({0} {2} {1})", "yes": "(Lanes)(-1)", "no": "(Lanes)(0)",
    "near": "if (disc_distance(i, j, n_i, n_j) <= {0} * {0}) {{", "far": "}} else {{", "table i": "(Vector)({0}[i])",
    "table j": "(Vector)({0}[j])", "table ij": "(Vector)({0}[i * n_j + j])", "cyclic": "(Vector)({0}[i % n_{1}])",
    "table z": "slices_of({0}, ITEM_Z + v * WIDTH, n_z)", "parts": "{0}_part[v]", "real": "REAL_LANES",
    "look up": "Vector {5}, {4} = look_up({0}, {1}, n_{6}, {2}, {3}, &{5});",
}  # fmt: skip
WARP: Language = {
    "literal": "{0}", "infinity": "wp.inf", "scalar": "float({0})", "declare": "{0} = {1}",
    "declare condition": "{0} = {1}", "change": "{0} = {1}", "load": "{1} = {0}_four[k]", "store": "{0}_four[k] = {1}",
    "loop": "for {0} in range({1}):", "leave": "if {0}: break", "close": "", "where": "wp.where({0}, {1}, {2})",
    "maximum": "wp.max({0}, {1})", "minimum": "wp.min({0}, {1})", "exp": "wp.exp({0})",
    "clip": "wp.min(wp.max({0}, {1}), {2})", "log": "wp.log({0})", "sqrt": "wp.sqrt({0})", "abs": "wp.abs({0})",
    "power": "raised({0}, {1})", "and": "({0} and {1})", "or": "({0} or {1})", "not": "(not {0})",
    "add": "({0} + {1})", "uneven": "({0} {2} {1})", "yes": "True", "no": "False", "parts": "{0}_part",
    "near": "if disc_distance(i, j, n_i, n_j) <= {0} * {0}:", "far": "else:", "cyclic": "{0}[i % n_{1}]",
    "table i": "float({0}[i])", "table j": "float({0}[j])", "table ij": "float({0}[i, j])",
    "table z": "{0}[wp.min(z + k, n_z - 1)]", "real": "z + k < n_z",
    "look up": "{4}, {5} = look_up({0}, {1}, {2}, {3})",
}  # fmt: skip
"""How the versions write what definitions have. In OpenCL, conditions on numbers that lanes share become branches."""
OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitAnd: "and", ast.BitOr: "or", ast.Lt: "<",
    ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.NotEq: "!=", ast.Eq: "==",
}  # fmt: skip
NUMPY = {"where": 3, "maximum": 2, "minimum": 2, "exp": 1, "clip": 3, "log": 1, "sqrt": 1, "abs": 1, "power": 2}
"""NumPy's functions that definitions may call, and how many arguments they have."""
PLACES = {
    "i": r"\[:, None, None\]",
    "j": r"\[(None, )?:, None\]",
    "ij": r"\[:, :, None\]",
    "z": r"(\[(None, ){0,2}:\])?",
}
"""Subscripts that tables need, by their axes."""
NUMBERS = {"float32": "float", "int32": "int"}
"""Types of arguments in both languages."""
MADE = re.compile(r"\w+_\d+")
"""Names that the writer gives."""
RESERVED = re.compile(
    r"v|i|j|k|z|at|end|j_end|slab|part|tile|lane|wp|n_\w+|\w+_(four|part|\d+)|[A-Z]\w*|_\w*|float|int|"
    r"(look_up|raised|slices_of|across_vectors|disc_distance|part_index|all|select|f?abs|f?max|f?min|exp|log|sqrt)"
)
"""Names that arguments cannot have because the versions use them."""


class Value(NamedTuple):
    """An expression in the language, and whether it is a condition."""

    text: str
    condition: bool = False


@dataclass(eq=False)
class Scope:
    """Names that statements see: values and functions of the definition, and what its file has."""

    known: dict[str, Any]
    file: dict[str, Any]
    fields: tuple[str, ...] = ()
    """Fields that may be written here."""
    before: frozenset[str] = frozenset()
    """What had a name before the loop: it changes, while all else gets a new name."""

    def __getitem__(self, name: str) -> Any:
        return self.known[name] if name in self.known else self.file.get(name)


@dataclass
class Writer:
    """Statements of a definition in a language."""

    kernel: Kernel
    language: Language
    lines: list[str] = field(default_factory=list)
    folds: dict[str, tuple[int, str, float]] = field(default_factory=dict)
    """Of each argument with partial results."""
    scalars: dict[str, Value] = field(default_factory=dict)
    """Numbers among the arguments, which all samples share."""
    near: str = ""
    depth: int = 0
    names: int = 0

    def line(self, form: str, *given: object) -> None:
        """Add a line."""
        self.lines.append("    " * self.depth + self.language[form].format(*given))

    def new(self, name: str) -> str:
        """A name that nothing has."""
        self.names += 1
        return f"{name.strip('_')}_{self.names}"

    def named(self, name: str, value: Value) -> Value:
        """A new name for a value."""
        found = Value(self.new(name), value.condition)
        self.line("declare condition" if value.condition else "declare", found.text, value.text)
        return found

    def whole(self) -> None:
        """Everything that is done to a sample; twice where it depends on whether the sample is near the axis."""
        if "reach" not in self.kernel.arguments:
            self.sample()
            return
        for self.near, form in (("yes", "near"), ("no", "far")):
            self.line(form, "reach")
            self.depth += 1
            self.sample()
            self.depth -= 1
        self.line("close")

    def sample(self) -> None:
        """Read the fields, write the statements of the definition, and store the fields."""
        writes = _fields(self.kernel, "writes")
        scope, self.folds = Scope(self.arguments(), self.kernel.definition.__globals__, tuple(writes)), {}
        for name in _fields(self.kernel, "reads"):
            scope.known[name] = Value(self.new(name))
            self.line("load", name, scope.known[name].text)
        self.block(_tree(self.kernel.definition).body, scope)
        missing = {*writes} - scope.known.keys() | {*_parts(self.kernel)} - self.folds.keys()
        self.require(not missing, f"{', '.join(missing)} without a value")
        for name in writes:
            self.line("store", name, scope.known[name].text)

    def arguments(self) -> dict[str, Any]:
        """Values of numbers, and tables."""
        for name, spec in self.kernel.arguments.items():
            fits = not isinstance(spec, Field) or spec.axes == _axes(self.kernel)
            self.require(fits and spec.dtype in NUMBERS and not RESERVED.fullmatch(name), f"the argument {name}")
            if isinstance(spec, Scalar):
                self.scalars[name] = Value(self.language["scalar"].format(name))
        return self.scalars | {name: spec for name, spec in self.kernel.arguments.items() if isinstance(spec, Table)}

    def block(self, statements: Iterable[ast.stmt], scope: Scope) -> list[Value]:
        """Write statements; what they return."""
        for statement in statements:
            match statement:
                case ast.Expr(ast.Constant()):
                    pass
                case ast.FunctionDef(name=name):
                    scope.known[name] = (statement, scope)
                case ast.Assign([target], value):
                    self.assign(target, self.values(value, scope), scope)
                case ast.AugAssign(target, op, value) if _field(target) in scope.fields:
                    name = ast.Name(_field(target))
                    values = self.values(ast.BinOp(name, op, value), scope)
                    self.assign(ast.Subscript(name, ast.Constant(...)), values, scope)
                case ast.For(ast.Name("_"), ast.Call(ast.Name("range"), [count]), body, []):
                    self.loop(count, body, scope)
                case ast.If(ast.Call(function, [test], []), [ast.Break()], []) if _numpy(function, scope) == "all":
                    done = self.value(test, scope)
                    self.require(done.condition, statement)
                    self.line("leave", done.text)
                case ast.Expr(ast.Call(ast.Name(name), [ast.Name(parts), values], [])) if scope[name] in FOLDS:
                    self.require(parts in _parts(self.kernel) and not (scope.before or parts in self.folds), statement)
                    self.fold(parts, FOLDS[scope[name]], self.numeric(values, scope))
                case ast.Return(ast.expr() as value) if not scope.before:
                    return self.values(value, scope)
                case _:
                    self.require(False, statement)
        return []

    def loop(self, count: ast.expr, body: list[ast.stmt], scope: Scope) -> None:
        """Repeat statements; names that they give first are gone afterwards."""
        times = count.value if isinstance(count, ast.Constant) else scope[ast.unparse(count)]
        self.require(isinstance(times, int), count)
        scope.known["_"] = None
        outer, scope.before = scope.before, frozenset(scope.known)
        self.line("loop", self.new("turn"), times)
        self.depth += 1
        self.block(body, scope)
        self.depth -= 1
        self.line("close")
        scope.known = {name: scope.known[name] for name in scope.before}
        scope.before = outer

    def fold(self, parts: str, how: tuple[int, str, float], values: Value) -> None:
        """Combine a sample's values with the partial result of this item."""
        self.folds[parts], (_, operation, identity) = how, how
        real = self.language["where"].format(self.language["real"], values.text, self.number(identity))
        before = self.language["parts"].format(parts)
        self.line("change", before, self.language[operation].format(before, real))

    def assign(self, target: ast.expr, values: list[Value], scope: Scope) -> None:
        """Give values to names and fields, all at once; in a loop, names from before it change."""
        targets = target.elts if isinstance(target, ast.Tuple) else [target]
        self.require(len(targets) == len(values), target)
        if scope.before and len(values) > 1:
            values = [self.named("next", value) for value in values]
        for one, value in zip(targets, values, strict=True):
            name, old = _field(one), scope.known.get(_field(one))
            field = name in scope.fields
            fits = isinstance(one, ast.Subscript) == field and not (field and value.condition)
            self.require(fits and name.isidentifier(), one)
            if name in scope.before:
                if not (isinstance(old, Value) and MADE.fullmatch(old.text) and old.condition == value.condition):
                    raise self.refused(one)
                self.line("change", old.text, value.text)
            else:
                scope.known[name] = self.named(name, value)

    def values(self, node: ast.expr, scope: Scope) -> list[Value]:
        """The values of an expression: several of a tuple, or of a function that returns one."""
        if isinstance(node, ast.Tuple):
            return [value for one in node.elts for value in self.values(one, scope)]
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self.call(node, scope)
        return [self.value(node, scope)]

    def value(self, node: ast.expr, scope: Scope) -> Value:
        """The value of an expression."""
        match node:
            case ast.Constant(int() | float() as number) if not isinstance(number, bool):
                return Value(self.number(number))
            case ast.Attribute(attr="inf") if _numpy(node, scope):
                return Value(self.number(math.inf))
            case ast.Name(name) | ast.Subscript(ast.Name(name)):
                return self.read(node, name, scope)
            case ast.BinOp(left, ast.Pow(), ast.Constant(2)):
                base = self.named("base", self.numeric(left, scope)).text
                return Value(f"({base} * {base})")
            case ast.BinOp(left, ast.BitAnd() | ast.BitOr() as op, right):
                return self.function(node, OPERATORS[type(op)], [left, right], scope)
            case ast.BinOp(left, op, right) | ast.Compare(left, [op], [right]) if type(op) in OPERATORS:
                sides = [self.numeric(side, scope).text for side in (left, right)]
                compares = isinstance(node, ast.Compare)
                form = "even" if compares and all(side.startswith("(Vector)") for side in sides) else "uneven"
                return Value(self.language[form].format(*sides, OPERATORS[type(op)]), compares)
            case ast.UnaryOp(ast.Invert(), operand):
                return self.function(node, "not", [operand], scope)
            case ast.UnaryOp(ast.USub(), operand):
                return Value(f"(-{self.numeric(operand, scope).text})")
            case ast.IfExp(test, body, other):
                chosen = ast.Compare(test, [ast.NotEq()], [ast.Constant(0)])
                return self.function(node, "where", [chosen, body, other], scope)
            case ast.Call(ast.Attribute() as called, given, []) if len(given) == NUMPY.get(_numpy(called, scope)):
                return self.function(node, called.attr, given, scope)
            case ast.Call(ast.Name()):
                values = self.call(node, scope)
                self.require(len(values) == 1, node)
                return values[0]
            case _:
                raise self.refused(node)

    def numeric(self, node: ast.expr, scope: Scope) -> Value:
        """The value of an expression that is no condition."""
        value = self.value(node, scope)
        self.require(not value.condition, node)
        return value

    def read(self, node: ast.expr, name: str, scope: Scope) -> Value:
        """What a name stands for; a table if the subscript puts its axes where the fields have them."""
        found, axes, subscript = scope[name], _axes(self.kernel), ast.unparse(node)[len(name) :]
        if isinstance(found, Table):
            form = "".join("ijz"[axes.index(axis)] if axis in axes else "?" for axis in found.axes)
            fits = form in PLACES and re.fullmatch(PLACES[form], subscript)
            self.require(bool(fits) and (form, found.dtype) != ("z", "int32"), node)
            return Value(self.language[f"table {form}"].format(name))
        self.require(isinstance(found, Value | int | float) and subscript in ("", "[...]"), node)
        return found if isinstance(found, Value) else Value(self.number(found))

    def function(self, node: ast.expr, name: str, given: list[ast.expr], scope: Scope) -> Value:
        """A function of numbers that the language has; & | ~, and where's first argument, are of conditions."""
        values = [self.value(one, scope) for one in given]
        kinds, last = [value.condition for value in values], values[-1].condition
        logic = name in ("and", "or", "not")
        self.require(kinds == ([True, last, last] if name == "where" else [logic] * len(kinds)), node)
        names = [scope[one.id] for one in ast.walk(given[-1]) if isinstance(one, ast.Name)]
        shared = all(isinstance(one, int | float) or one in self.scalars.values() for one in names)
        self.require(shared or name != "power", node)
        return Value(self.language[name].format(*(one.text for one in values)), last)

    def call(self, node: ast.Call, scope: Scope) -> list[Value]:
        """What a function of this file, of the definition or of its file returns."""
        function, given = scope[ast.unparse(node.func)], node.args
        if function in (near_axis, cyclic, look_up) and not node.keywords:
            return self.special(node, function, given, scope)
        if isinstance(function, FunctionType):
            function = _tree(function), Scope({}, function.__globals__)
        if type(function) is not tuple or node.keywords:
            raise self.refused(node)
        tree, outside = function
        self.require(len(tree.args.args) == len(given) and not tree.decorator_list, node)
        inside = Scope(dict(outside.known), outside.file)
        for parameter, one in zip(tree.args.args, given, strict=True):
            value = self.value(one, scope)
            inside.known[parameter.arg] = value if value in self.scalars.values() else self.named(parameter.arg, value)
        return self.block(tree.body, inside)

    def special(self, node: ast.Call, function: Any, given: list[ast.expr], scope: Scope) -> list[Value]:
        """What a function of this file returns; its table and numbers are arguments of the kernel."""
        numbers = [self.value(one, scope) for one in given[1 if function is near_axis else 2 :]]
        names = [name for one in numbers for name, value in self.scalars.items() if value == one]
        if function is near_axis and names == ["reach"]:
            return [Value(self.language[self.near], condition=True)]
        table = ast.unparse(given[0 if function is cyclic else 1])
        spec = scope[table]
        fits = isinstance(spec, Table) and len(spec.axes) == 1 and spec.dtype == "float32"
        self.require(fits and len(names) == len(numbers), node)
        if function is cyclic:
            return [Value(self.language["cyclic"].format(table, spec.axes[0]))]
        place = self.named("place", self.numeric(given[0], scope)).text
        found = self.new("found"), self.new("rise")
        self.line("look up", place, table, *names, *found, spec.axes[0])
        return [Value(name) for name in found]

    def require(self, holds: bool, what: ast.AST | str) -> None:
        """Raise what is raised at something that cannot be written, unless it can."""
        if not holds:
            raise self.refused(what)

    def refused(self, what: ast.AST | str) -> KernelError:
        """What is raised at something that cannot be written."""
        return KernelError(
            f"{self.kernel.name}: pointwise kernels cannot have "
            f"{what if isinstance(what, str) else ast.unparse(what)!r}; kernels/pointwise.py says what they may have; "
            f"or declare it with @kernel and write {self.kernel.concept}.cl and {self.kernel.concept}_warp.py"
        )

    def number(self, number: float) -> str:
        """A number in the language."""
        if math.isinf(number):
            return f"({'-' if number < 0 else ''}{self.language['infinity']})"
        return self.language["literal"].format(repr(float(number)))


def _tree(function: Callable[..., Any]) -> ast.FunctionDef:
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(tree, ast.FunctionDef)
    return tree


def _field(target: ast.expr) -> str:
    """The field of ``field[...]``; else the text of what is assigned to."""
    return ast.unparse(target).removesuffix("[...]")


def _numpy(node: ast.expr, scope: Scope) -> str:
    """The name of something of NumPy, else nothing."""
    match node:
        case ast.Attribute(ast.Name(module), name) if scope[module] is np:
            return name
    return ""


def _axes(kernel: Kernel) -> tuple[str, ...]:
    return kernel.arguments[kernel.over].axes  # type: ignore[union-attr]


def _parts(kernel: Kernel) -> list[str]:
    """Arguments with partial results."""
    return [name for name, spec in kernel.arguments.items() if getattr(spec, "axes", ()) == ("part",)]


def _fields(kernel: Kernel, which: str) -> list[str]:
    """Fields that it ``reads`` or ``writes``."""
    return [name for name, spec in kernel.arguments.items() if isinstance(spec, Field) and getattr(spec, which)]


def opencl(kernel: Kernel) -> str:
    """The OpenCL version of a kernel: its file, or for pointwise kernels what is written from the definition."""
    if not kernel.pointwise:
        return kernel.source.read_text("utf-8")
    writer, parts, (major, minor, _) = Writer(kernel, OPENCL), _parts(kernel), _axes(kernel)
    writer.whole()
    kinds = {name: "__global float *" if spec.writes else "ARRAY " if isinstance(spec, Field) else
             f"__global const {NUMBERS[spec.dtype]} *restrict "  # not so fields, which may be the one that is written
             for name, spec in kernel.arguments.items() if not isinstance(spec, Scalar)}  # fmt: skip
    kinds |= {name: f"{NUMBERS[spec.dtype]} " for name, spec in kernel.arguments.items() if isinstance(spec, Scalar)}
    arguments = [kinds[name] + name for name in kernel.arguments] + [f"int n_{axis}" for axis in kernel.axes]
    lines = [f'#include "pointwise.h"\nFIELD_KERNEL {kernel.name}({", ".join(arguments)}) {{']
    lines += [f"const int n_i = n_{major}, n_j = n_{minor};"] if major != "i" else []
    lines.append("OWN_PART;" if parts else "if (!MINE) return;")
    for name in parts:
        nothing = writer.number(writer.folds[name][2])
        lines.append(f"Vector {name}_part[VECTORS]; EACH_VECTOR {name}_part[v] = {nothing};")
    lines += ["EACH_VECTOR_AT {", *writer.lines, "}"]
    lines += [f"{name}[part] = across_vectors({name}_part, {writer.folds[name][0]});" for name in parts]
    return "\n".join([*lines, "}", ""])


def warp(kernel: Kernel) -> str:
    """The Warp version of a pointwise kernel."""
    writer, parts, (major, minor, _) = Writer(kernel, WARP), _parts(kernel), _axes(kernel)
    writer.whole()
    kinds = {name: "Vectors" if isinstance(spec, Field) else NUMBERS[spec.dtype] if isinstance(spec, Scalar) else
             f"wp.array(dtype={NUMBERS[spec.dtype]}, ndim={len(spec.axes)})"
             for name, spec in kernel.arguments.items()}  # fmt: skip
    arguments = [f"{name}: {kind}" for name, kind in kinds.items()] + [f"n_{axis}: int" for axis in kernel.axes]
    reads, writes = _fields(kernel, "reads"), _fields(kernel, "writes")
    body = [f"{name}_four = {name}[slab, i, j, lane]" for name in reads]
    body += [f"{name}_four = wp.vec4()" for name in writes if name not in reads]
    body += ["for k in range(4):", *(f"    {line}" for line in writer.lines)]
    body += [f"{name}[slab, i, j, lane] = {name}_four" for name in writes]
    lanes = f"{kernel.over}.shape[3]"
    lines = [f"def {kernel.name}({', '.join(arguments)}):", f"slab, {'tile' if parts else 'i'}, j, lane = wp.tid()"]
    lines += [f"z = 4 * (slab * {lanes} + lane)"]
    lines += [f"n_i, n_j = n_{major}, n_{minor}"] if major != "i" else []
    if parts:
        lines += [f"{name}_part = float({writer.number(writer.folds[name][2])})" for name in parts]
        lines += ["for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):"]
        body = [f"    {line}" for line in body] + [f"part = part_index(slab, tile, j, lane, n_i, n_j, {lanes})"]
    return "\n    ".join([*lines, *body, *(f"{name}[part] = {name}_part" for name in parts)]) + "\n"
