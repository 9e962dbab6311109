"""Inflection of one label: its plural, its singular, its article (inflect does the work).

Whatever asks inflect raises MissingExtraError where it is not installed.
"""

from __future__ import annotations

import logging
import re
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

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


@cache
def can_inflect() -> bool:
    """Whether inflect is installed; where it is not, one warning says which extra brings it."""
    found = find_spec("inflect") is not None
    if not found:
        log.warning(
            "names that no table has stay unknown, for want of their plurals; "
            "run `pip install 'roomtables[robot]'`"
        )
    return found


@cache
def _engine() -> inflect.engine:
    # Seconds to import (typeguard): only where a plural or an article is derived.
    with needing("deriving a plural or an article"):
        import inflect

    return inflect.engine()


def _ask(question: str, label: str) -> str | None:
    """What inflect answers, or ``None`` where it has no answer for such a word."""
    ask: Any = getattr(_engine(), question)
    answer = ask(label)
    return answer if isinstance(answer, str) and answer else None


@cache
def pluralise(label: str) -> str:
    """The plural that stands in a sentence: ``chests of drawers``, ``shelves``, ``clothes``."""
    if not _is_name(label) or _last_word(label) in _UNINFLECTED or singular(label) is not None:
        return label
    return _ask("plural_noun", label) or label


@cache
def singular(label: str) -> str | None:
    """The singular of a label that is a plural (``shelves`` → ``shelf``), else ``None``."""
    last_word = _last_word(label)
    if not _is_name(label) or last_word in _UNINFLECTED | _ENDS_IN_S:
        return None
    if re.search(r"(ss|us|is)$", last_word):
        return None
    found = _ask("singular_noun", label)
    return found if found != label else None


@cache
def article(label: str) -> str:
    """``a`` or ``an``: ``a utility room``, ``an office``."""
    if not _is_name(label):
        return "a"
    return (_ask("a", label) or "a").split(" ", 1)[0]


def _last_word(label: str) -> str:
    return label.rsplit(" ", 1)[-1].casefold()


def _is_name(label: str) -> bool:
    return len(label) <= _MAX_NAME_LENGTH and bool(re.fullmatch(r"[^\W\d_][\w '\-]*", label))
