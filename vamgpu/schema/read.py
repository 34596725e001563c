"""Components from tables: from job files, with units, and from manifests, without."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import signature
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError, create_model
from pydantic import Field as Described
from pydantic_core import core_schema

from vamgpu.errors import BadInput
from vamgpu.schema.noun import GIVEN, fields_of, quantity_in
from vamgpu.schema.quantities import PLAIN
from vamgpu.schema.registry import as_known, families_of, family, find, remedy
from vamgpu.schema.section import Listed, Section
from vamgpu.schema.write import ARRAY

MOST_SHOWN = 200  # number of characters shown of an invalid value


EXPECTED = {
    "tuple_type": "a list in brackets, such as [1, 2]",
    "list_type": "a list in brackets, such as [1, 2]",
    "float_type": "a number without quotes",
    "int_type": "a whole number without quotes",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "dict_type": "a table",
}
"""Type of pydantic's error → the expected value, in words of a file."""
NOUN_WORD = "kind"
NOUN = "noun"  # stands for ``$ref`` until all components are defined; see `vamgpu.schema.explain.json_schema`


class Nouns:
    """Type of a component's key, for pydantic. If ``without`` or ``beside`` is set, it reads a `Partial`."""

    given: tuple[tuple[str, str | None], ...]  # (family, kind) of accepted components; None accepts a whole family
    without: tuple[str, ...]  # fields whose values come from elsewhere
    beside: dict[str, tuple[Any, Any]]  # type and default of keys that are not fields

    def __init__(
        self, choices: Iterable[tuple[str, str | None]], without: tuple[str, ...] = (),
        beside: Mapping[str, tuple[Any, Any]] | None = None,
    ) -> None:  # fmt: skip
        self.given, self.without, self.beside = tuple(choices), without, dict(beside or {})

    @property
    def choices(self) -> tuple[tuple[str, str], ...]:
        """(family, kind) of every component allowed here, including those registered later."""
        every = ((name, family(name).nouns if kind is None else (kind,)) for name, kind in self.given)
        return tuple((name, kind) for name, kinds in every for kind in kinds)

    @property
    def word(self) -> str:
        """The key that names the kind."""
        return next((family(name).word for name, _ in self.given), NOUN_WORD)

    def model(self, table: Mapping[str, Any]) -> type[BaseModel]:
        """The pydantic model of a table; raises `BadInput`."""
        model = model_of(self.chosen(table), self.without)
        others: dict[str, Any] = self.beside
        return create_model(model.__name__, __base__=model, **others) if others else model

    def others(self) -> type[BaseModel]:
        """The model of keys that are not fields of the component."""
        others: dict[str, Any] = self.beside
        return create_model("Others", __base__=Section, **others)

    def chosen(self, table: Mapping[str, Any]) -> type[Any]:
        """The class that a table describes; raises `BadInput`."""
        kinds = {kind: name for name, kind in self.choices}
        defaults = [family(name).default for name in dict.fromkeys(kinds.values())]
        word = self.word
        usual = next(iter(kinds)) if len(kinds) == 1 else next((kind for kind in defaults if kind in kinds), None)
        kind = table.get(word, usual)
        if kind is None:
            raise BadInput(f"{word} is missing; add {word} = one of {', '.join(kinds)}")
        if not isinstance(kind, str):
            raise BadInput(f"{word} is {kind!r}; expected one of {', '.join(kinds)}")
        kind = as_known(kind, kinds)
        if kind not in kinds:
            what = " or ".join(dict.fromkeys(kinds.values()))
            named = what if word == NOUN_WORD else word
            raise BadInput(f"no {named} {kind!r}; expected one of {', '.join(kinds)}{remedy(what, kind, kinds)}")
        return find(kinds[kind], kind)

    def having(self, key: str) -> list[str]:
        """Kinds whose tables contain a key."""
        found = ((kind, model_of(find(name, kind), self.without)) for name, kind in self.choices)
        return [kind for kind, model in found if key in model.model_fields]

    def read(self, table: Any, info: Any = None) -> Any:
        """A component; raises the errors that pydantic collects."""
        context = getattr(info, "context", None) or {}
        if not isinstance(table, Mapping):
            if not isinstance(table, (str, int, float, list, type(None))):
                return table  # already a component: the default of a field
            raise ValueError("expected a table")
        cls = self.chosen(table)
        fields = {key: value for key, value in table.items() if key != self.word}
        values = self.model(table).model_validate(fields, context=context)
        if isinstance(values, cls):
            return values  # a component that is a `Section` itself
        given = {name: getattr(values, name) for name in values.model_fields_set if name not in self.beside}
        given |= {name: context[name] for name in GIVEN if name in context and name in signature(cls).parameters}
        if self.beside and not self.without:
            cls(**given)  # its own errors, at the table in the file
        if self.without or self.beside:
            return Partial(cls, given, {name: getattr(values, name) for name in self.beside})
        return cls(**given)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        if self.without or self.beside:
            return self.model({}).model_json_schema()
        refs = [{NOUN: f"{name}.{kind}"} for name, kind in self.choices]
        if len(refs) == 1:
            return refs[0]
        usual = {kind for name, kind in self.choices if family(name).default == kind}
        said = [ref if kind in usual else {"allOf": [ref, {"required": [self.word]}]}
                for ref, (_, kind) in zip(refs, self.choices, strict=True)]  # fmt: skip
        return {"anyOf": said}


@dataclass(frozen=True)
class Partial:
    """A component without some fields; call it with them to get the component. beside: other keys of its table."""

    cls: type[Any]
    given: dict[str, Any]
    beside: dict[str, Any]

    def __call__(self, **others: Any) -> Any:
        """The component; raises `BadInput`."""
        return self.cls(**self.given, **others)


def noun(
    *names: str, kind: str | None = None, without: tuple[str, ...] = (),
    beside: Mapping[str, tuple[Any, Any]] | None = None,
) -> Nouns:  # fmt: skip
    """Any component of some families, or of one kind, as ``film: Annotated[Film, noun("film")]`` in a `Section`."""
    return Nouns(((name, kind) for name in names), without, beside)


@cache
def model_of(cls: type[Any], without: tuple[str, ...] = ()) -> type[BaseModel]:
    """A pydantic model of a component's fields; fields that a file cannot write are None, or omitted."""
    if issubclass(cls, Section):
        return cls
    found: dict[str, Any] = {}
    for field in fields_of(cls):
        kind = in_files(field.kind)
        kind = NoneType if kind is None and field.default is None else kind
        if kind is not None and field.name not in without:
            described = Annotated[kind, Described(description=field.doc)] if field.doc else kind
            found[field.name] = (described, ... if field.required else field.default)
    return create_model(cls.__name__, __base__=Section, __doc__=cls.__doc__, **found)


def in_files(kind: Any) -> Any:
    """A field's type in the form that pydantic reads; None if files do not write it."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return kind if quantity_in(kind) is not None else in_files(parts[0])
    if _is_array(kind):
        return Annotated[Any, Kept()]
    if origin in (Union, UnionType):
        known = [in_files(part) for part in parts if part is not NoneType and not _is_array(part)]
        kept = _joined([part for part in known if part is not None])
        return None if kept is None else (kept | None if NoneType in parts else kept)
    if origin is Sequence:
        return in_files(tuple[parts[0], ...])  # type: ignore[valid-type]
    if origin is tuple:
        inner = tuple(part if part is Ellipsis else in_files(part) for part in parts)
        return None if None in inner else Annotated[tuple[inner], Listed]  # type: ignore[valid-type]
    if origin is Literal or kind in (str, int, float, bool):
        return kind
    if origin in (list, Iterable) or not isinstance(kind, type):
        return None
    choices = families_of(kind)
    return Annotated[Any, Nouns(choices)] if choices else None


def _is_array(kind: Any) -> bool:
    """Whether a field holds an array, or a number for a uniform one; a field that may be a list does not count."""
    if get_origin(kind) in (Union, UnionType):
        parts = [part for part in get_args(kind) if part is not NoneType]
        return any(map(_is_array, parts)) and all(part is float or _is_array(part) for part in parts)
    origin = get_origin(kind) or kind
    if hasattr(origin, "__value__"):  # NDArray from Python 3.12 and NumPy 2.5 on
        return _is_array(origin.__value__)
    return origin is np.ndarray


def _joined(kinds: list[Any]) -> Any:
    """A union of types. All components in it become one choice, and messages then name what is expected."""
    nouns = [part for kind in kinds for part in getattr(kind, "__metadata__", ()) if isinstance(part, Nouns)]
    plain = [kind for kind in kinds if not any(isinstance(part, Nouns) for part in getattr(kind, "__metadata__", ()))]
    if nouns:
        plain.append(Annotated[Any, Nouns(choice for part in nouns for choice in part.given)])
    lists = [kind for kind in plain if get_origin(get_args(kind)[0] if get_args(kind) else None) is tuple]
    if lists and len(plain) > 1:
        return Annotated[Any, OneOrMany(next(kind for kind in plain if kind not in lists), lists[0])]
    words = [kind for kind in plain if get_origin(kind) is Literal]
    if words and len(plain) > 1:
        return Annotated[Any, OneOrMany(next(kind for kind in plain if kind not in words), words[0], str)]
    return Union[tuple(plain)] if plain else None  # noqa: UP007


@dataclass(frozen=True, eq=False)
class OneOrMany:
    """The type of a key that holds a value, or a list or a word; errors refer to what was written."""

    one: Any
    many: Any
    form: Any = (list, tuple)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        one, many = (TypeAdapter(kind, config=Section.model_config) for kind in (self.one, self.many))

        def read(value: Any, info: Any) -> Any:
            if self.form is str and isinstance(value, str) and re.fullmatch(r"[-+\d.e]+", value):
                raise ValueError("expected a number without quotes: remove them")
            return (many if isinstance(value, self.form) else one).validate_python(value, context=info.context)

        return core_schema.with_info_plain_validator_function(read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [TypeAdapter(kind).json_schema() for kind in (self.one, self.many)]}


class Kept:
    """Type of an array field; job folders save the array beside the manifest, and job files cannot write it."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"type": "object", "properties": {ARRAY: {"type": "string"}}}

    def read(self, value: Any, info: Any) -> Any:
        """An array, or a number; raises the errors that pydantic collects."""
        context = info.context or {}
        if value is None or not context.get("plain"):
            if isinstance(value, (np.ndarray, NoneType)):
                return value  # the default of a field
            raise ValueError("expected an array, which is made in Python and kept in job folders")
        if isinstance(value, Mapping) and set(value) == {ARRAY}:
            if "arrays" not in context:
                raise ValueError("expected the arrays of its job folder; open that folder")
            return context["arrays"](value[ARRAY])
        if isinstance(value, (int, float)):
            return float(value)
        array = np.asarray(value if isinstance(value, list) else None)
        if array.dtype.kind not in "biuf":
            raise ValueError("expected numbers, or the name of an array")
        return array


def read(
    name: str, table: Mapping[str, Any], *, units: bool = True, device: Any = None,
    arrays: Callable[[str], np.ndarray] | None = None,
) -> Any:  # fmt: skip
    """The component of a family that a table describes; `write` or a user wrote the table. Raises `BadInput`."""
    context: dict[str, Any] = {} if units else dict(PLAIN)
    if device is not None:
        context["device"] = device
    if arrays is not None:
        context["arrays"] = arrays
    nouns = Nouns([(name, None)])
    try:
        return nouns.read(table, SimpleNamespace(context=context))
    except ValidationError as error:
        said = (f"{name}.{key_in_words(entry['loc'], table)}{complaint(entry)}" for entry in error.errors())
        raise BadInput("\n".join(said)) from error


def key_in_words(key: Iterable[str | int], data: Any) -> str:
    """A key of a file's data as its reader sees it: ``[[display]] 1, size, value 2``."""
    said, names, value, parts = [], [], data, tuple(key)
    for number, part in enumerate(parts):
        if not isinstance(part, int):
            names.append(part)
            value = value.get(part) if isinstance(value, Mapping) else None
        elif isinstance(value, (list, tuple)):  # otherwise a table that may be one or several
            value = value[part] if part < len(value) else None
            table = ".".join(names)
            if isinstance(value, Mapping) or not all(isinstance(each, int) for each in parts[number + 1 :]):
                said.append(f"[[{table}]] {part + 1}")
            else:
                said += [table, f"value {part + 1}"]
            names = []
    return ", ".join(each for each in (*said, ".".join(names)) if each)


def complaint(entry: Any, remedy: str = "add it") -> str:
    """Text of pydantic's error, without the name of the key: the value, what was expected, and the remedy."""
    if entry["type"] in ("missing", "too_long", "too_short") and isinstance(entry["input"], (list, tuple)):
        return f": got {_short(entry['input'])}; expected a list of {_length(entry)} values: correct the list"
    if entry["type"] == "missing":
        return f" is missing; {remedy}"
    if entry["type"] == "extra_forbidden":
        return ": unknown key; correct or remove it"
    got = "" if isinstance(entry["input"], (dict, BaseModel)) else f" got {_short(entry['input'])};"
    said = entry["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    said = EXPECTED.get(entry["type"], said)
    if entry["type"] == "tuple_type" and isinstance(entry["input"], str):
        said = f'a list in brackets: ["{entry["input"]}"]'
    if entry["type"] in ("tuple_type", "list_type") and isinstance(entry["input"], dict):
        said = f"tables, one or several: write [[{entry['loc'][-1]}]] in place of [{entry['loc'][-1]}]"
    return f":{got} {said if entry['type'] == 'value_error' else f'expected {said}; correct the value'}"


def _length(entry: Any) -> str:
    """Expected length of a list, if the error contains it."""
    if entry["type"] == "missing":
        return f"at least {entry['loc'][-1] + 1}"
    context = entry.get("ctx", {})
    return f"at most {context['max_length']}" if "max_length" in context else f"at least {context.get('min_length', 1)}"


def _short(value: Any) -> str:
    """A value as readable text; the beginning of a long one."""
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def nouns_in(annotation: Any, metadata: Iterable[Any] = ()) -> Nouns | None:
    """The components that a key's table may be; None if it is a section."""
    own = next((part for part in metadata if isinstance(part, Nouns)), None)
    inner = (nouns_in(part, getattr(part, "__metadata__", ())) for part in get_args(annotation))
    return own or next((found for found in inner if found is not None), None)


def model_in(annotation: Any, metadata: Iterable[Any] = (), table: Any = None) -> type[BaseModel] | None:
    """The model of a key's table, a section or a component; None if it has none."""
    nouns = next((part for part in metadata if isinstance(part, Nouns)), None)
    if nouns is None and isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if isinstance(table, list):  # the first one represents all
        table = table[0] if table else {}
    if nouns is not None:
        try:
            return nouns.model(table if isinstance(table, Mapping) else {})
        except BadInput:
            return None
    inner = (model_in(part, getattr(part, "__metadata__", ()), table) for part in get_args(annotation))
    return next((found for found in inner if found is not None), None)
