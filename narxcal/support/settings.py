"""Read tables and stored values by their types, TOML files, and say what is wrong in words."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from narxcal.support.errors import ConfigError, ModelError, did_you_mean

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

T = TypeVar("T")

# To build one takes six times as long as to read by it.
_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}
OPEN = "?"  # stands for a value that is still to be filled in


class Section(BaseModel):
    """One table of a TOML configuration: immutable, and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def parse(
        cls,
        table: Mapping[str, Any],
        file: str | PathLike[str] | None = None,
        options: Mapping[str, str] | None = None,
    ) -> Self:
        """Validate `table`; the first thing wrong becomes a `ConfigError` that names the key.

        `options` are the keys whose values came from a command line, by what was typed there.
        """
        try:
            return cls.model_validate(dict(table))
        except ValidationError as error:
            typed = (options or {}).get(_key(error))
            if typed is not None:
                raise ConfigError(f"{typed}: {_problem_and_value(error)}") from None
            raise _explain(cls, error, file) from None
        except ConfigError as error:  # from a validator, which has no file
            raise ConfigError(
                error.problem, file=error.file or file, channel=error.channel, hint=error.hint
            ) from None


def read_stored(kind: type[T], stored: object, part: str) -> T:
    """Read a dataclass from JSON-able values by the types of its fields.

    Entries that it does not have are passed over; whole numbers stand for fractions, nothing else
    is converted. Raises `ModelError` naming the `part` of the file and the entry.
    """
    try:
        text = json.dumps(stored, allow_nan=False)
        adapter = _ADAPTERS.get(kind) or _ADAPTERS.setdefault(kind, TypeAdapter(kind))
        found: T = adapter.validate_json(text, strict=True)
    except ValidationError as error:
        first, key = _first(error), _key(error)
        missing = first["type"] == "missing"
        problem = f" has no '{key}'" if missing else f", '{key}': {_problem_and_value(error)}"
    except (TypeError, ValueError, RecursionError) as error:
        problem = f": {error}"
    else:
        return found
    raise ModelError(f"the part '{part}'{problem}", hint="The bundle was altered; train it again")


def read_toml(file: Path, schema: str) -> dict[str, Any]:
    """Read a TOML file whose key `schema` has to be this; raises `ConfigError`."""
    try:
        text = file.read_text(encoding="utf-8-sig")
        table = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=file) from None
    except UnicodeDecodeError:
        raise ConfigError("expected a TOML file, found no text in UTF-8", file=file) from None
    except (ValueError, RecursionError) as error:  # also for a number too long, nesting too deep
        raise ConfigError(f"not TOML: {error}", file=file) from None
    if table.get("schema") != schema:
        found = repr(table["schema"]) if "schema" in table else "nothing"
        raise ConfigError(
            f"expected schema = '{schema}', found {found}",
            file=file,
            hint="Write it as the first line",
        )
    if key := _open_key(table):
        line, comment = _question(text)
        raise ConfigError(
            f"line {line}: '{key}' is still to be filled in{comment}",
            file=file,
            hint=f'Put a value in the place of "{OPEN}"',
        )
    return table


def in_toml(value: object) -> str:
    """TOML of a text, number or boolean, or a list of them: but for one letter its JSON."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _open_key(table: Mapping[str, Any]) -> str:
    """Path to the first value that is still to be filled in; "" for none."""
    waiting: list[tuple[str, Any]] = [("", table)]
    while waiting:  # no recursion: tables may be nested deeper than Python's stack
        at, value = waiting.pop()
        if isinstance(value, Mapping):
            inner = [(f"{at}.{name}".lstrip("."), each) for name, each in value.items()]
            waiting += reversed(inner)
        elif value == OPEN or (isinstance(value, list) and OPEN in value):
            return at
    return ""


def _question(text: str) -> tuple[int, str]:
    """Number of the first line with an open value, and the comment on it."""
    lines = text.splitlines()
    asks = (k for k, each in enumerate(lines) if OPEN in each.partition("#")[0])
    line = next(asks, 0)
    comment = lines[line].rpartition("#")[2] if "#" in lines[line] else ""
    return line + 1, f": {comment.strip()}" if comment else ""


def _explain(
    section: type[BaseModel], error: ValidationError, file: str | PathLike[str] | None
) -> ConfigError:
    first, key = _first(error), _key(error)
    path = key.split(".")
    if first["type"] == "extra_forbidden":
        return ConfigError(f"unknown key '{key}'", file=file, hint=_hint(section, path))
    if first["type"] == "missing":
        return ConfigError(f"key '{key}' is missing", file=file, hint="Add it")
    if not key:  # of the table as a whole
        return ConfigError(_problem(error), file=file)
    return ConfigError(f"key '{key}': {_problem_and_value(error)}", file=file)


def _hint(section: type[BaseModel], path: list[str]) -> str:
    """Say where the last key of `path` belongs, or which key it may be misspelt for."""
    tables = [f"[{table}]" for table in _tables_with(path[-1], section) if table]
    if tables:
        return f"It is a key of {' and of '.join(tables)}"
    return did_you_mean(path[-1], _known_keys(section, path[:-1]), "Known keys:", cutoff=0.5)


def _tables_with(key: str, section: type[BaseModel], at: str = "") -> Iterator[str]:
    """Tables of a configuration, as `logs.derive`, that have `key`."""
    if key in _keys(section):
        yield at
    for name, field in section.model_fields.items():
        nested = _section_in(field.annotation)
        if nested:
            yield from _tables_with(key, nested, f"{at}.{name}" if at else name)


# Where a value may be of several types, pydantic names each in the path to what is wrong.
_TYPE = re.compile(
    r"constrained-\w+|(literal|list|tuple|dict|nullable|function-\w+)\[.*\]|bool|int|float|str"
)


def _first(error: ValidationError) -> ErrorDetails:
    """What is wrong first; of a list that may also be one word, the entry that is wrong."""
    first, *others = error.errors()
    inside = f"{_path(first['loc'])}."
    return next((each for each in others if _path(each["loc"]).startswith(inside)), first)


def _key(error: ValidationError) -> str:
    """Path to what is wrong first."""
    return _path(_first(error)["loc"])


def _path(loc: Sequence[int | str]) -> str:
    return ".".join(str(part) for part in loc if not _TYPE.fullmatch(str(part)))


def _expected(error: ValidationError) -> str:
    """What pydantic says of the first value that is wrong; of several types what each expects."""
    first = _first(error)
    at = _path(first["loc"])
    found = dict.fromkeys(each["msg"] for each in error.errors() if _path(each["loc"]) == at)
    if len(found) < 2:
        return first["msg"].removeprefix("Value error, ")
    words = [each.removeprefix("Input should be ").partition(", unable")[0] for each in found]
    return f"Input should be {' or '.join(words)}"


def _problem(error: ValidationError) -> str:
    first = _first(error)
    if first["type"] in ("model_type", "dict_type"):
        return "expected a table of keys"
    if first["type"] in ("tuple_type", "list_type"):
        return "expected a list"
    if first["type"] == "too_short":
        return f"expected a list of at least {first['ctx']['min_length']}"
    return _expected(error)


def _problem_and_value(error: ValidationError) -> str:
    first = _first(error)
    if first["type"] == "value_error" and isinstance(first["input"], dict):
        return _problem(error)  # of several keys of a table, and it names them
    return f"{_problem(error)}, found {_shown(first['input'])}"


def _shown(value: object) -> str:
    try:
        return repr(value)[:80]
    except ValueError:  # Python prints no number of more than 4300 digits
        return "a number too long to print"


def _known_keys(section: type[BaseModel], path: list[str]) -> list[str]:
    """Keys of the (possibly nested) section that `path` leads to."""
    for part in path:
        field = section.model_fields.get(part)
        nested = field and _section_in(field.annotation)
        if nested:
            section = nested
    return sorted(_keys(section))


def _keys(section: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in section.model_fields.items()]


def _section_in(annotation: Any) -> type[BaseModel] | None:
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None
