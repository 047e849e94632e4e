"""Plain tables to checked models, and the words that tell a user which key to mend.

The rig file, scene files and the settings of every driver go through here, so that a wrong key reads the
same everywhere: file, line, place, and the nearest right name.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from thermacq.errors import DeviceFault
from thermacq.toml_lines import line_of

_Model = TypeVar("_Model", bound=BaseModel)


def check_settings(model: type[_Model], settings: Mapping[str, Any], device: str) -> _Model:
    """Turn a driver's settings into its model; for use in ``configure``.

    Parameters
    ----------
    model
        Pydantic model of the settings, with ``extra="forbid"``.
    settings
        What the rig file says.
    device
        Name of the device in the rig.

    Raises
    ------
    DeviceFault
        A key is unknown or a value impossible; names the key and the nearest right one.
    """
    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        raise DeviceFault(
            device, "configure", "; ".join(sentence for _, sentence in _findings(error, model))
        ) from None


def explain(
    error: ValidationError, model: type[BaseModel], origin: str, text: str = "", inside: tuple[str, ...] = ()
) -> str:
    """Turn a validation error into lines for the user.

    Parameters
    ----------
    error
        What pydantic found.
    model
        The model that was validated against.
    origin
        Name of the file for the user.
    text
        TOML text, to find line numbers in; empty when there is none.
    inside
        Place in the text of the table that was validated, e.g. ``("cameras", "left", "settings")``.
    """
    lines = []
    for place, sentence in _findings(error, model):
        number = line_of(text, [*inside, *place])
        where = f"{origin}, line {number}" if number else origin
        within = f"{'.'.join(inside)}: " if inside else ""
        lines.append(f"{where}: {within}{sentence}")
    return "\n".join(lines)


def _findings(error: ValidationError, model: type[BaseModel]) -> Iterator[tuple[list[str], str]]:
    """Place of each error, and a sentence that says what is wrong and the nearest right name."""
    for item in error.errors():
        place = [str(part) for part in item["loc"] if part != "[key]"]
        name, kind = ".".join(place), item["type"]
        if kind == "extra_forbidden":
            known = _keys_at(model, item["loc"][:-1])
            near = difflib.get_close_matches(place[-1], known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(known) or 'nothing'}"
            yield place, f"unknown key '{name}'; {hint}"
        elif kind == "missing":
            yield place, f"'{name}' is missing"
        elif kind in ("dict_type", "model_type"):
            yield place, f"{name}: must be a table, not {_short(item['input'])}"
        else:
            message = item["msg"].removeprefix("Value error, ")
            message = message[0].lower() + message[1:]
            yield place, f"{name}: {message}, not {_short(item['input'])}" if name else message


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _keys_at(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    """Keys allowed at a place of a model."""
    reached: list[Any] = [model]
    for part in place:
        reached = [inner for annotation in reached for inner in _step_into(annotation, part)]
    return [key for kind in reached if _is_model(kind) for key in kind.model_fields]


def _step_into(annotation: Any, part: int | str) -> list[Any]:
    """Annotations behind one key: a field of a model, or the values of a mapping or list."""
    if _is_model(annotation):
        field = annotation.model_fields.get(str(part))
        return [field.annotation] if field else []
    arguments = get_args(annotation)
    if get_origin(annotation) in (Union, UnionType):
        return [inner for argument in arguments for inner in _step_into(argument, part)]
    return list(arguments[-1:])


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
