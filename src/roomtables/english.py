"""Inflection of one label: its plural, its singular, its article.

inflect does the work. What it answered for the names of the built-in label spaces is kept in
``inflections.csv``, so that those need no inflect. For other names it must be installed:
MissingExtraError where it is not.
"""

from __future__ import annotations

import csv
import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from roomtables.errors import needing

if TYPE_CHECKING:
    import inflect

log = logging.getLogger(__name__)

# Nouns that name a mass, or whose form is the plural already; the last word of a label decides.
_UNINFLECTED = frozenset(
    [
        "bread",
        "cheese",
        "clothes",
        "clothing",
        "cutlery",
        "equipment",
        "furniture",
        "glassware",
        "jewelry",
        "laundry",
        "lettuce",
        "lighting",
        "linen",
        "luggage",
        "machinery",
        "pants",
        "paper",
        "rice",
        "scissors",
        "seating",
        "shelving",
        "shorts",
        "silverware",
        "soap",
        "trousers",
        "water",
        "wine",
    ]
)
# Singulars that a rule for plurals would cut short; words in -ss, -us and -is are never cut.
_ENDS_IN_S = frozenset(["atlas", "bus", "canvas", "christmas", "gas", "lens", "news", "pancreas"])
# Longer than the name of any thing: not worth inflecting, and slow to try.
_MAX_NAME_LENGTH = 100


class Forms(NamedTuple):
    """A name's plural, its singular where the name is a plural itself (else empty), its article."""

    plural: str
    singular: str
    article: str


NOTED = Path(__file__).with_name("inflections.csv")


def pluralise(label: str) -> str:
    """The plural that stands in a sentence: ``chests of drawers``, ``shelves``, ``clothes``."""
    return _forms(label).plural


def singular(label: str) -> str | None:
    """The singular of a label that is a plural (``shelves`` → ``shelf``), else ``None``."""
    return _forms(label).singular or None


def article(label: str) -> str:
    """``a`` or ``an``: ``a utility room``, ``an office``."""
    return _forms(label).article


def inflect_anew(label: str) -> Forms:
    """A name's forms as inflect answers now, whatever is noted."""
    if not _is_name(label):
        return Forms(label, "", "a")
    one = _singular(label)
    uninflected = one or _last_word(label) in _UNINFLECTED
    plural = label if uninflected else _ask("plural_noun", label) or label
    return Forms(plural, one, (_ask("a", label) or "a").split(" ", 1)[0])


@cache
def _forms(label: str) -> Forms:
    return _noted().get(label) or inflect_anew(label)


@cache
def _noted() -> dict[str, Forms]:
    with NOTED.open(encoding="utf-8", newline="") as lines:
        rows = csv.reader(lines)
        next(rows)
        return {name: Forms(*forms) for name, *forms in rows}


def _singular(label: str) -> str:
    last_word = _last_word(label)
    if last_word in _UNINFLECTED | _ENDS_IN_S or re.search(r"(ss|us|is)$", last_word):
        return ""
    found = _ask("singular_noun", label)
    return found if found and found != label else ""


def can_inflect(label: str) -> bool:
    """Whether a name's forms are known, or can be derived: all are where inflect is installed.

    Where it is not, one warning says which extra brings it.
    """
    return label in _noted() or not _is_name(label) or _is_installed()


@cache
def _is_installed() -> bool:
    found = find_spec("inflect") is not None
    if not found:
        log.warning(
            "names that no table has stay unknown, for want of their plurals; "
            "run `pip install 'roomtables[robot]'`"
        )
    return found


@cache
def _engine() -> inflect.engine:
    with needing("deriving a plural or an article"), _types_unchecked():
        import inflect

    return inflect.engine()


@contextmanager
def _types_unchecked() -> Iterator[None]:
    """Spare inflect the checks of its arguments' types while it is imported.

    typeguard compiles each of its functions anew for them: 4 seconds of the processor instead of
    0.2. What is asked here are strings that are not empty, which is what they check.
    """
    try:
        package: Any = import_module("typeguard")  # inflect's dependency, none of roomtables'
    except ImportError:  # inflect may do without, one day
        yield
        return
    checked = package.typechecked
    package.typechecked = lambda function: function
    try:
        yield
    finally:
        package.typechecked = checked


def _ask(question: str, label: str) -> str | None:
    """What inflect answers, or ``None`` where it has no answer for such a word."""
    ask: Any = getattr(_engine(), question)
    answer = ask(label)
    return answer if isinstance(answer, str) and answer else None


def _last_word(label: str) -> str:
    return label.rsplit(" ", 1)[-1].casefold()


def _is_name(label: str) -> bool:
    return len(label) <= _MAX_NAME_LENGTH and bool(re.fullmatch(r"[^\W\d_][\w '\-]*", label))
