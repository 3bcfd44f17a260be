"""Mutations of valid input: of trees, such as JSON and messages, and of bytes."""

from __future__ import annotations

import copy
import re
from typing import Any

import numpy as np

HOSTILE: tuple[Any, ...] = (
    float("nan"),
    float("inf"),
    -1e308,
    5e-324,
    -0.0,
    -1,
    0,
    2**63,
    10**400,
    True,
    None,
    "",
    "\x00",
    "../../etc/passwd",
    "ü" * 70_000,
    b"\xff",
    [],
    {},
    [[0.0] * 3] * 3,
)
"""Values that replace any other value."""
_WORDS = (
    b"nan",
    b"inf",
    b"-1e999",
    b"0",
    b"9" * 5000,
    b"0x" + b"f" * 9000,
    b"[" * 3000,
    b"{" * 3000,
    b"\x00",
    b"\xff\xfe",
    b'"',
    b"\n",
    b"<!ENTITY a 'b'>",
    b"<a>" * 3000,
)
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE]-?\d+)?")


def mutated(tree: Any, rng: np.random.Generator, hostile: tuple[Any, ...] = HOSTILE) -> Any:
    """A copy of a tree of dicts, lists and scalars with a few changed nodes."""
    root = [copy.deepcopy(tree)]
    for _ in range(int(rng.geometric(0.6))):
        holder, key = _place(root, rng)
        match int(rng.integers(6)):
            case 0 | 1:
                holder[key] = copy.deepcopy(hostile[int(rng.integers(len(hostile)))])
            case 2:
                holder[key] = _nested(int(rng.integers(1, 100)))
            case 3 if holder is not root:
                del holder[key]
            case 4 if isinstance(holder, dict):
                holder[f"{key}x"] = holder.pop(key)
            case 4 if isinstance(holder, list):
                holder.extend([copy.deepcopy(holder[key])] * int(rng.integers(1, 300)))
            case _ if isinstance(holder[key], int | float) and abs(holder[key]) < 1e300:
                holder[key] = holder[key] * float(rng.normal()) * 10.0 ** int(rng.integers(-3, 12))
    return root[0]


def _place(root: list[Any], rng: np.random.Generator) -> tuple[Any, Any]:
    """A random container of the tree, and one of its keys."""
    holder, key = root, 0
    while isinstance(holder[key], dict | list) and len(holder[key]) and rng.random() < 0.8:
        holder = holder[key]
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = keys[int(rng.integers(len(keys)))]
    return holder, key


def _nested(depth: int) -> Any:
    tree: Any = 0.0
    for _ in range(depth):
        tree = [tree]
    return tree


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with changes: bytes are replaced, removed or repeated, and words are inserted."""
    for _ in range(int(rng.geometric(0.5))):
        at = int(rng.integers(len(data) + 1))
        end = min(len(data), at + int(rng.integers(1, 200)))
        word = _WORDS[int(rng.integers(len(_WORDS)))]
        numbers = list(_NUMBER.finditer(data, at, min(at + 2000, len(data))))
        match int(rng.integers(6)):
            case 0:
                data = data[:at] + rng.bytes(end - at) + data[end:]
            case 1:
                flipped = bytes(byte ^ (1 << int(rng.integers(8))) for byte in data[at : at + 1])
                data = data[:at] + flipped + data[at + 1 :]
            case 2:
                data = data[:at] + data[end:]
            case 3:
                data = data[:end] + data[at:]
            case 4 if numbers:
                data = data[: numbers[0].start()] + word + data[numbers[0].end() :]
            case _:
                data = data[:at] + word + data[at:]
    return data
