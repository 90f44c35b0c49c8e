"""Damage and malice: what becomes of a valid file, decided by a seeded generator so that it can be made again."""

from __future__ import annotations

import copy
import io
import json
import random
import re
import zipfile
from typing import Any

from dipc_gym.safety import intact

TOKENS = (
    *(b"", b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-320", b"9" * 400, b"\0", b"\xff\xfe", b"\n" * 500, b"[" * 3000),
    *(
        b"../../escaped",
        b"/etc/passwd",
        b"{}",
        b"null",
        b'"',
        b"<",
        b"&x;",
        b"]]>",
        b",,,,",
        b"\r",
        b" ",
        b"0x10",
        b"1_0",
    ),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 10**12, 10**400, 1e308, -1e308, 1e-320, float("nan"), float("inf")),
    *(
        "",
        "x",
        "../../escaped",
        "/etc/passwd",
        "a\0b",
        "\ud800",
        "$x^",
        "y" * 5000,
        "nan",
        [],
        {},
        [[]],
        [None],
        [1e300] * 3,
    ),
)
NUMBERS = ("nan", "inf", "-1", "0", "1e300", "1e-300", "1e9", "-1e9", "", "x", "0 0 0", "1 2 3 4 5 6 7 8", "1e-9")


def octets(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut, doubled or put in."""
    text = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(text) + 1)
        until = min(len(text), at + rng.choice((1, 4, 40, 4000)))
        kind = rng.randrange(6)
        if kind == 0 and text:
            text[at % len(text)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del text[at:until]
        elif kind == 2:
            text[at:at] = text[at:until]
        elif kind == 3:
            text[at:until] = rng.choice(TOKENS)
        elif kind == 4:
            text[at:at] = rng.choice(TOKENS)
        elif rng.random() < 0.2:
            del text[at:]
    return bytes(text)


def tree(data: bytes, rng: random.Random, value: Any = None) -> bytes:
    """A JSON text with a value, name or entry changed; where it carries a digest, now and then with the right one."""
    root = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 3))):
        places: list[tuple[Any, Any]] = []
        _collect(root, places)
        if not places:
            break
        holder, key = rng.choice(places)
        other, theirs = rng.choice(places)
        kind = rng.randrange(6)
        if kind == 0:
            del holder[key]
        elif kind == 1:
            holder[key] = json.loads(json.dumps(other[theirs])) if theirs in _keys(other) else None
        elif kind == 2 and isinstance(holder, dict):
            holder[rng.choice(("../../escaped", "", "extra", "schema"))] = holder.pop(key)
        elif kind == 3 and isinstance(holder[key], list):
            holder[key] = holder[key] * rng.choice((0, 2, 50))
        elif kind == 4 and value is not None:
            holder[key] = copy.deepcopy(value)  # into itself, at the next turn, it would never end
        else:
            holder[key] = copy.deepcopy(rng.choice(VALUES))  # which the next turn may change
    if isinstance(root, dict) and intact.DIGEST in root and rng.random() < 0.7:
        try:
            root = intact.signed(root)
        except (ValueError, RecursionError, TypeError):
            del root[intact.DIGEST]
    text = json.dumps(root)
    return text.encode("utf-8", errors="surrogatepass")


def _keys(holder: Any) -> Any:
    return holder if isinstance(holder, dict) else range(len(holder))


def _collect(value: Any, places: list[tuple[Any, Any]]) -> None:
    for key in list(_keys(value)) if isinstance(value, dict | list) else []:
        places.append((value, key))
        if len(places) < 2000:
            _collect(value[key], places)


def markup(data: bytes, rng: random.Random) -> bytes:
    """An XML text with an attribute changed, or an element gone, doubled or moved."""
    text = data.decode()
    for _ in range(rng.choice((1, 1, 2))):
        attributes = list(re.finditer(r'([\w:]+)="([^"]*)"', text))
        elements = list(re.finditer(r"<\w+[^<>]*/>", text))
        kind = rng.randrange(5)
        if kind <= 2 and attributes:
            one = rng.choice(attributes)
            words = one[2].split()
            if kind == 0 and words:
                words[rng.randrange(len(words))] = rng.choice(NUMBERS)
                new = " ".join(words)
            else:
                new = rng.choice((*NUMBERS, rng.choice(attributes)[2], "../../escaped", "y" * 3000))
            text = f"{text[: one.start(2)]}{new}{text[one.end(2) :]}"
        elif elements:
            one, place = rng.choice(elements), rng.choice(elements)
            if kind == 3:
                text = text[: one.start()] + text[one.end() :]
            else:
                text = text[: place.start()] + one[0] + text[place.start() :]
    return text.encode()


def archive(data: bytes, rng: random.Random) -> bytes:
    """A zip with a part damaged, renamed, gone or doubled, or its bytes themselves."""
    if rng.random() < 0.4:
        return octets(data, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        names = old.namelist()
        chosen = rng.choice(names)
        for name in names:
            content = old.read(name)
            if name == chosen:
                kind = rng.randrange(5)
                if kind == 0:
                    continue
                if kind == 1:
                    name = rng.choice(("../../escaped", "/etc/escaped", "x", name.upper()))
                elif kind == 2 and content[:1] == b"{":
                    content = tree(content, rng)
                elif kind == 3:
                    content = content * rng.choice((2, 100))
                else:
                    content = octets(content, rng)
            new.writestr(name, content)
    return out.getvalue()
