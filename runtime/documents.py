"""The files a user hands us: read with one clear line for what is wrong, written whole or not at all."""

import difflib
import json
import math
import os
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Identifier = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]*(_[a-z0-9]+)*$", max_length=40)]

Vector = TypeVar("Vector", bound=tuple[float, ...])


def _has_unit_length(vector: Vector) -> Vector:
    if not math.isclose(math.hypot(*vector), 1.0, abs_tol=1e-9):
        raise ValueError("wanted a unit vector")
    return vector


UnitVector = Annotated[Vector, AfterValidator(_has_unit_length)]  # UnitVector[tuple[Number, Number, Number]]

TEMPORARY_SUFFIX = ".clikgen-tmp"


class BadInput(ValueError):
    """What the user gave cannot be used; the message is one line that says where, what was wanted and got."""


def choices(got: str, valid: Iterable[str]) -> str:
    """The tail of an error line: the nearest valid name, if one is near, and all of them."""
    names = sorted(valid)
    near = difflib.get_close_matches(got, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return f"{hint}valid choices: {', '.join(names) or '(none)'}"


class Document(BaseModel):
    """A table of a user's file: immutable, and an unknown key is an error that names the valid ones."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _keys_are_known(cls, data: Any) -> Any:
        for key in data if isinstance(data, Mapping) else ():
            if key not in cls.model_fields:
                raise PydanticCustomError(
                    "unknown_key",
                    "unknown key '{key}'; {choices}",
                    {"key": str(key), "choices": choices(str(key), cls.model_fields)},
                )
        return data

    @classmethod
    def parse(cls, data: Mapping[str, Any], source: str) -> Self:
        """Validate `data`, read from `source`.

        Raises BadInput, one line: source, key, what was wanted, what was got.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise BadInput(f"{source}: {_first_complaint(error)}") from None


def _first_complaint(error: ValidationError) -> str:
    """The first thing that is wrong, as `key: wanted, got`, and how many more there are."""
    problem, *others = _own_problems(error.errors(include_url=False))
    key = ".".join(str(part) for part in problem["loc"])
    message = " ".join(problem["msg"].removeprefix("Value error, ").split())
    more = f" (and {len(others)} more)" if others else ""
    where = f"{key}: " if key else ""
    if problem["type"] in ("missing", "unknown_key") or isinstance(problem["input"], Mapping):
        return f"{where}{message}{more}"
    got = repr(problem["input"])
    return f"{where}{message}, got {got if len(got) <= 60 else got[:57] + '...'}{more}"


def _own_problems(problems: Sequence[Any]) -> list[Any]:
    """Without those of pydantic's making: an array that is too short only because one of its entries is wrong."""
    wrong = [problem["loc"] for problem in problems]

    def follows(problem: Any) -> bool:
        loc = problem["loc"]
        return problem["type"] == "too_short" and any(other[: len(loc)] == loc and other != loc for other in wrong)

    return [problem for problem in problems if not follows(problem)]


def read_toml(path: Path) -> dict[str, Any]:
    """The table that a TOML file holds; raises BadInput when it cannot be read or parsed."""
    return _parse_toml(read_text(path), str(path))


def _parse_toml(text: str, source: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{source}: not valid TOML: {error}") from None


def parse_toml_value(text: str, source: str) -> Any:
    """The TOML value written in `text` (a number, string, array, ...); raises BadInput."""
    return _parse_toml(f"value = {text}", f"{source}, in {text!r}")["value"]


def read_text(path: Path) -> str:
    """The text of a UTF-8 file; raises BadInput when it is missing or unreadable."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


def make_folder(folder: Path) -> Path:
    """Create `folder` and its parents where they lack; raises BadInput when that is not allowed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{folder}: cannot make this folder: {error.strerror}") from None
    return folder


def write_atomically(path: Path, content: bytes) -> None:
    """Replace `path` by `content` in one rename: a reader, or an interruption, meets the old file or the new.

    Raises BadInput when the folder cannot be written to.
    """
    commit_all({path: content})


def commit_all(contents: Mapping[Path, bytes]) -> None:
    """Write every file beside its place first, then rename them in order: all or, on an error, none.

    Raises BadInput when a folder cannot be written to; nothing has changed then.
    """
    staged: dict[Path, Path] = {}
    try:
        for path, content in contents.items():
            make_folder(path.parent)
            handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY_SUFFIX)
            staged[path] = Path(temporary)
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            staged[path].chmod(0o644)
        for path, temporary_path in staged.items():
            temporary_path.replace(path)
    except OSError as error:
        raise BadInput(f"{error.filename or 'output'}: cannot be written: {error.strerror}") from None
    finally:
        for temporary_path in staged.values():
            temporary_path.unlink(missing_ok=True)


def json_text(document: Any) -> str:
    """The one JSON layout of this project: two spaces, keys in their order, a newline at the end."""
    return json.dumps(document, indent=2, allow_nan=False) + "\n"
