"""Mangled bytes, tokens and values."""

import datetime
import json
import re
from typing import Any

import numpy as np

BYTES = (
    b"\0",
    b"\x1b[2J",
    b"\x07",
    b"\xff",
    b"\xc3",
    b"\xef\xbb\xbf",
    b"\r\n",
    b"\t",
    b"'",
    b'"',
    b"[",
    b"]",
    b"=",
    b"#",
    b"\\",
    b".",
    b"-",
    b"9",
    b"e",
    b" ",
    b"\n",
    b"{",
    b",",
    b"\xe2\x80\xae",
)
NUMBERS = (
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "1e9999",
    "9" * 30,
    "9" * 5000,
    "0x7fffffffffffffff",
    "9223372036854775808",
    "1_0",
    "0.1",
    "1e-9",
    "1e30",
    "1e19",
    "4.5",
    "16777217",
    "2147483648",
)
ODD = (
    True,
    False,
    "",
    " ",
    [],
    {},
    [[]],
    {"a": {"b": 1}},
    [1, "a"],
    "a\0b",
    "\x1b[31mred\x1b[0m",
    "\u202eevil",
    "x" * 3000,
    "$x^2$",
    "\\frac{",
    "../../x",
    "naïve",
    "é",
    None,
    datetime.date(2003, 10, 28),
    datetime.time(3, 2),
    [1e308, 1e308],
    [0] * 2000,
    "4 4 s",
    "4",
    "s",
    "4 s s",
    "nan s",
    "inf s",
    "4,5 s",
    "\uff14 s",
    "4 s # a",
    "4 lightyear",
    "(4 s)",
    "4 s / 0",
    "1e308 s",
    "-4 s",
    "4 s(1/0)",
    "4 s(9e9)",
    "4 s9999",
    "[4 s",
    "[4, 5] s",
    "[[4]] s",
    "[] s",
    "[,] s",
    "4 mag",
    "4 dex",
    "4 %",
    "4 km/s",
    "None",
    "True",
    "4j s",
    "4s4",
    "4 4",
    "--4 s",
    "4 -s",
    "1/3 s",
    "4 1/s",
)


ODD_QUANTITIES = (
    "4 4 {unit}",
    "2 {old}",
    "{old} 2",
    "{old} {old}",
    "{old} / 2",
    "{old} * 3",
    "({old})",
    "-{old}",
    "+{old}",
    "{old}.",
    " {old} ",
    "{old}\n",
    "{old} # x",
    "{old}e3",
    "1e3{old}",
    "{old} rad / rad",
    "{old} 10",
    "{old} 10(3)",
    "{old}, {old}",
    "1 {unit}",
    "4e0 {unit}",
    "4e 4 {unit}",
    "4 k{unit}",
    "{unit}",
    "{unit} 4",
    "4 {unit} {unit}",
    "4 {unit}2",
    "4 {unit}(1)",
    "4{unit}",
    "4 {unit} / {unit}",
    "1/3 {unit}",
    "4_0 {unit}",
    "0x10 {unit}",
    "4j {unit}",
    "[4] {unit}",
    "[4 5] {unit}",
    "[4, 5] {unit} / 2",
    "[4, [5]] {unit}",
    "[4, 5, ] {unit}",
    "[4, 4 {unit}] {unit}",
)


def pick(rng: np.random.Generator, items: Any) -> Any:
    """One of several, unchanged in type."""
    return items[int(rng.integers(len(items)))]


def mangled_bytes(raw: bytes, rng: np.random.Generator, changes: int = 3) -> bytes:
    """Bytes with one to some places changed, removed, doubled or cut off."""
    data = bytearray(raw)
    for _ in range(int(rng.integers(1, changes + 1))):
        if not data:
            break
        place = int(rng.integers(len(data)))
        length = int(min(len(data) - place, 2 ** rng.integers(0, 8)))
        action = int(rng.integers(7))
        if action == 0:
            data[place] ^= 1 << int(rng.integers(8))
        elif action == 1:
            data[place] = int(rng.integers(256))
        elif action == 2:
            del data[place : place + length]
        elif action == 3:
            data[place:place] = data[place : place + length]
        elif action == 4:
            data[place:place] = pick(rng, BYTES)
        elif action == 5:
            data[place : place + length] = bytes(rng.integers(0, 256, length, dtype=np.uint8))
        else:
            del data[place + length :]
    return bytes(data)


_TOKEN = re.compile(r"[A-Za-z_]+|[0-9.]+(?:e-?[0-9]+)?|[^\sA-Za-z0-9]|\n")


def mangled_tokens(text: str, rng: np.random.Generator, changes: int = 2) -> str:
    """Text with one or more tokens or lines doubled, dropped, swapped or replaced."""
    for _ in range(int(rng.integers(1, changes + 1))):
        tokens = list(_TOKEN.finditer(text))
        if len(tokens) < 2:
            break
        one, other = (tokens[int(place)] for place in rng.integers(len(tokens), size=2))
        lines = text.splitlines(keepends=True)
        line, place = int(rng.integers(len(lines))), int(rng.integers(len(lines) + 1))
        action = int(rng.integers(8))
        if action == 0:
            text = text[: one.start()] + text[one.end() :]
        elif action == 1:
            text = text[: one.end()] + one[0] + text[one.end() :]
        elif action == 2:
            text = text[: one.start()] + other[0] + text[one.end() :]
        elif action == 3:
            text = text[: one.start()] + pick(rng, NUMBERS) + text[one.end() :]
        elif action == 4:
            text = "".join(lines[:line] + lines[line + 1 :])
        elif action == 5:
            text = "".join(lines[:place] + [lines[line]] + lines[place:])
        elif action == 6:
            text = text[: one.end()] + " " + other[0] + text[one.end() :]
        else:
            text = text[: one.start()] + one[0].swapcase() + text[one.end() :]
    return text


def toml(value: Any) -> str:
    """A value in TOML's inline form; numbers in `NUMBERS` are quoted as they stand by giving `Raw`."""
    if isinstance(value, Raw):
        return value.text
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return ""
    if isinstance(value, str):
        plain = "".join(
            c if " " <= c != "\x7f" and not 0xD800 <= ord(c) < 0xE000 else f"\\u{ord(c):04x}" for c in value
        )
        quoted = plain.replace('"', '\\"') if "\\u" in plain else value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{quoted}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {toml(item)}' for key, item in value.items())}}}"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)


class Raw:
    """Text that stands in the file as it is."""

    def __init__(self, text: str):
        self.text = text


def scene_text(content: dict[str, Any], prefix: str = "") -> str:
    """A scene's content as TOML: plain keys first, then sections."""
    plain = {key: item for key, item in content.items() if not isinstance(item, dict)}
    lines = [f"{_key(key)} = {toml(item)}" for key, item in plain.items()]
    parts = ["\n".join(lines)] if lines else []
    for key, item in content.items():
        if isinstance(item, dict):
            name = f"{prefix}{_key(key)}"
            parts.append(f"[{name}]\n{scene_text(item, f'{name}.')}")
    return "\n\n".join(parts)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)
