"""Valid input made wrong: types swapped, keys dropped, numbers enormous, surrogates, noise."""

from __future__ import annotations

import json
from copy import deepcopy
from random import Random
from typing import Any

_HUGE = "an integer of five thousand digits"
WRONG = [
    None, True, False, -1, 0, 1, 2**31, 2**63, 2**64, 10**30, 1.5, -0.0, 1e308, float("nan"),
    float("inf"), _HUGE, "", " ", "x", "a;b", "\x00", "\x1b[2J", "\ud800", "😀", "x" * 20_000, "-1",
    [], {}, [[]], [None], ["\ud800"], [1, 2, 3], {"a": 1}, {"": None}, {"\ud800": 1},
    "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "2001-99-99", "../x", "/etc/passwd",
]  # fmt: skip
CELLS = [
    "", " ", "-1", "0", "1", "nan", "inf", "-inf", "1e999", "-3.5e38", "9" * 400, "9" * 5000, "1.5",
    "x", "\x00", "\ufeff", '"', "'", "a|b", "a,b", "true", "maybe", "é", "😀", "\x1b[2J",
    "x" * 20_000, "-2147483649", "18446744073709551616",
]  # fmt: skip
_BYTES = [
    b"\x00", b"\xff", b"\xfe\xff", b"\n", b"\r", b'"', b"{", b"[" * 300, b"]", b",",
    b"\xed\xa0\x80", b"9" * 5000, b"&a", b"*a", b"<<: *a\n", b"!!int x", b"\xdd\xff\xff\xff\xff",
    b"\xef\xbb\xbf",
]  # fmt: skip


def changed_bytes(content: bytes, random: Random) -> bytes:
    """Some bytes replaced, put in, taken out or doubled; now and then nothing but noise."""
    if random.random() < 0.05:
        return random.randbytes(random.randrange(200))
    content = bytes(content)
    for _ in range(random.randint(1, 4)):
        at = random.randrange(len(content) + 1)
        end = at + random.choice([0, 1, 2, 4, 8, 40])
        middle = random.choice([b"", content[at:end] * 2, random.randbytes(4), *_BYTES])
        content = content[:at] + middle + content[end:]
    return content[: random.randrange(len(content) + 1)] if random.random() < 0.1 else content


def changed_value(value: Any, random: Random) -> Any:
    """A JSON value with one to three places changed: swapped, dropped, doubled, nested."""
    value = deepcopy(value)
    for _ in range(random.randint(1, 3)):
        places = list(_places(value))
        if not places:
            return deepcopy(random.choice(WRONG))
        inside, key = random.choice(places)
        match random.randrange(8):
            case 0:
                del inside[key]
            case 1 if isinstance(inside, dict):
                inside[random.choice(["x", "\ud800", "", "type"])] = inside.pop(key)
            case 2:
                _, other = random.choice(places)
                inside[key] = deepcopy(random.choice([at[k] for at, k in places if k == other]))
            case 3:
                inside[key] = [inside[key]]
            case 4:
                for _ in range(random.choice([3, 150])):
                    inside[key] = random.choice([[inside[key]], {"a": inside[key]}])
            case _:
                inside[key] = deepcopy(random.choice(WRONG))
    return value


def _places(value: Any) -> Any:
    """Every place of a value: what it lies in, and under which key."""
    keys = (
        range(len(value)) if isinstance(value, list) else value if isinstance(value, dict) else ()
    )
    for key in list(keys):
        yield value, key
        yield from _places(value[key])


def as_json(value: Any) -> bytes:
    """A value as a hostile writer would write it: with NaN, halves of pairs and long integers."""
    return json.dumps(value).replace(json.dumps(_HUGE), "9" * 5000).encode()


def changed_cells(lines: list[str], separator: str | None, random: Random) -> bytes:
    """Lines of cells with some cells replaced, dropped or doubled, and some lines moved."""
    rows = [line.split(separator) for line in lines]
    for _ in range(random.randint(1, 4)):
        row = random.choice(rows)
        at = random.randrange(len(row) + 1)
        match random.randrange(6):
            case 0:
                del row[at : at + 1]
            case 1:
                rows.insert(random.randrange(len(rows)), list(row))
            case 2:
                rows.remove(row)
                rows = rows or [[""]]
            case _:
                row[at : at + 1] = [random.choice(CELLS)]
    text = "\n".join((separator or " ").join(row) for row in rows)
    return text.encode("utf-8", "surrogatepass")
