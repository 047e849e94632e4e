"""Where a key stands in TOML text, at any depth; the standard reader keeps no line numbers."""

from __future__ import annotations

import re
import tomllib
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

_TOKEN = re.compile(
    r"""
    (?P<skip>[ \t\r]+|\#[^\n]*)
    |(?P<scalar>\"\"\"(?:\\.|[^\\])*?\"{3,5}|'''.*?'{3,5}|"(?:\\.|[^"\\])*"|'[^']*'|[^][{}=,"'\#\s]+)
    |(?P<mark>[][{}=,\n])
    """,
    re.VERBOSE | re.DOTALL,
)


class _Token(NamedTuple):
    kind: str
    text: str
    line: int


_Tokens: TypeAlias = deque[_Token]
_Path: TypeAlias = tuple[str, ...]


def line_of(text: str, place: Sequence[str]) -> int:
    r"""Line of a key, or of the innermost table around it that is written down; 0 when none is.

    Parameters
    ----------
    text
        Valid TOML.
    place
        The key and the tables around it, outermost first; elements of arrays by their index.

    Examples
    --------
    >>> line_of("[a]\nb = {c = 1, d = 2}", ["a", "b", "d"])
    2
    """
    wanted = tuple(place)
    depth, nearest = 0, 0
    for path, line in _paths(text):
        if path[: len(wanted)] == wanted:
            return line
        if depth < len(path) and wanted[: len(path)] == path:
            depth, nearest = len(path), line
    return nearest


def _paths(text: str) -> Iterator[tuple[_Path, int]]:
    """Every key and table of a document with its line, in order."""
    tokens = _tokenize(text)
    table: _Path = ()
    elements: dict[_Path, int] = {}
    while tokens:
        first = tokens[0]
        if first.text == "\n":
            tokens.popleft()
        elif first.text == "[":
            table = _header(tokens, elements)
            yield table, first.line
        else:
            yield from _assignment(tokens, table)


def _tokenize(text: str) -> _Tokens:
    tokens: _Tokens = deque()
    line = 1
    for match in _TOKEN.finditer(text):
        if match.lastgroup != "skip":
            tokens.append(_Token(match.lastgroup or "", match[0], line))
        line += match[0].count("\n")
    return tokens


def _key(tokens: _Tokens) -> _Path:
    """Parts of a dotted key; the standard reader undoes the quotes."""
    written = ""
    while tokens and tokens[0].kind == "scalar":
        written += tokens.popleft().text
    parts: list[str] = []
    value: Any = tomllib.loads(f"{written} = 0")
    while value:
        part, value = next(iter(value.items()))
        parts.append(part)
    return tuple(parts)


def _header(tokens: _Tokens, elements: dict[_Path, int]) -> _Path:
    """Path of ``[table]`` or ``[[array of tables]]``; `elements` counts the tables of each array."""
    brackets = 0
    while tokens[0].text == "[":
        tokens.popleft()
        brackets += 1
    parts = _key(tokens)
    for _ in range(brackets):
        tokens.popleft()
    path: _Path = ()
    for depth, part in enumerate(parts, start=1):
        path = (*path, part)
        if depth == len(parts) and brackets == 2:
            elements[path] = elements.get(path, 0) + 1
        if path in elements:
            path = (*path, str(elements[path] - 1))
    return path


def _assignment(tokens: _Tokens, table: _Path) -> Iterator[tuple[_Path, int]]:
    line = tokens[0].line
    path = table + _key(tokens)
    tokens.popleft()
    yield path, line
    yield from _value(tokens, path)


def _value(tokens: _Tokens, path: _Path) -> Iterator[tuple[_Path, int]]:
    opening = tokens.popleft()
    if opening.text not in ("[", "{"):
        while tokens and tokens[0].kind == "scalar":  # a date and its time
            tokens.popleft()
        return
    element = 0
    while tokens[0].text not in ("]", "}"):
        if tokens[0].text in (",", "\n"):
            tokens.popleft()
        elif opening.text == "{":
            yield from _assignment(tokens, path)
        else:
            yield (*path, str(element)), tokens[0].line
            yield from _value(tokens, (*path, str(element)))
            element += 1
    tokens.popleft()
