"""Sentence frames: one per line of ``frames/<kind>.txt``, with slots and alternatives.

``{slot}`` is filled by the generator; ``[this|that|]`` picks one alternative, also nested.
Empty lines and lines that start with ``#`` are skipped.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

FRAMES = Path(__file__).parent / "frames"

Part = str | list["Frame"]  # literal text, "{slot}", or alternatives
Frame = list[Part]


def parse(text: str) -> Frame:
    """Parse one frame.

    Raises
    ------
    ValueError
        A bracket or brace is not closed.
    """
    frame, end = _sequence(text, 0, top=True)
    if end != len(text):
        raise ValueError(f"unbalanced ']' in frame: {text}")
    return frame


def _sequence(text: str, at: int, top: bool = False) -> tuple[Frame, int]:
    frame: Frame = []
    while at < len(text) and (top or text[at] not in "|]"):
        if text[at] == "[":
            choice, at = _alternatives(text, at + 1)
            frame.append(choice)
            continue
        match = re.match(r"\{[a-z_]+\}" if text[at] == "{" else r"[^\[\]{}|]+", text[at:])
        if not match:
            raise ValueError(f"unexpected {text[at]!r} in frame: {text}")
        frame.append(match.group())
        at += match.end()
    return frame, at


def _alternatives(text: str, at: int) -> tuple[list[Frame], int]:
    choice = []
    while True:
        frame, at = _sequence(text, at)
        choice.append(frame)
        if at >= len(text):
            raise ValueError(f"unclosed '[' in frame: {text}")
        at += 1
        if text[at - 1] == "]":
            return choice, at


Words = Callable[[str], str]


def render(frame: Frame, fill: Words, rng: random.Random, say: Words = str) -> str:
    """Fill the slots and pick the alternatives of a frame; tidy spaces and capitals.

    ``say`` may change the frame's own words.
    """
    return tidy("".join(_pieces(frame, fill, rng, say)))


def _pieces(frame: Frame, fill: Words, rng: random.Random, say: Words) -> list[str]:
    pieces: list[str] = []
    for part in frame:
        if isinstance(part, list):
            pieces += _pieces(rng.choice(part), fill, rng, say)
        else:
            pieces.append(fill(part[1:-1]) if part.startswith("{") else say(part))
    return pieces


def own_words(frame: Frame) -> set[str]:
    """Every word that a frame has of its own."""
    found: set[str] = set()
    for part in frame:
        if isinstance(part, list):
            found.update(*(own_words(option) for option in part))
        elif not part.startswith("{"):
            found.update(re.findall(r"[A-Za-z]+", part))
    return found


def tidy(text: str) -> str:
    """Single spaces, none before a stop, and a capital after each."""
    text = re.sub(r"\s+([,.;:?!])", r"\1", re.sub(r" {2,}", " ", text)).strip()
    text = re.sub(r"([.?!]['\"]?\s+['\"]?\ue000?)([a-z])", lambda m: m[1] + m[2].upper(), text)
    return re.sub(r"^(['\"]?\ue000?)([a-z])", lambda m: m[1] + m[2].upper(), text)


def slots(frame: Frame) -> set[str]:
    """Name all slots that a frame can use."""
    found: set[str] = set()
    for part in frame:
        if isinstance(part, list):
            found.update(*(slots(option) for option in part))
        elif part.startswith("{"):
            found.add(part[1:-1])
    return found


def read_lines(path: Path) -> list[str]:
    """Read a frames file, less comments and empty lines."""
    lines = (line.strip() for line in path.read_text(encoding="utf-8").splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def load_frames(kind: str) -> list[Frame]:
    """Read and parse the frames of one kind."""
    return [parse(line) for line in read_lines(FRAMES / f"{kind}.txt")]
