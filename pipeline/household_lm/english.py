"""Number, articles, and lists: the forms of the corpus's nouns.

Plurals and articles are those of ``roomtables.english``, so that the corpus spells a noun as
the scored sentences do; uncountable nouns, which no rule finds, are listed here.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import cache

from roomtables.english import article, pluralise, singular

# The last word, or the whole name, of what is not counted.
_MASS_WORDS = """
art artwork baggage bedding bleach bread broccoli butter carpeting celery cereal chalk cheese
chocolate clothing coffee cologne cream cutlery decor decoration deodorant detergent dirt
ear_protection equipment fabric fertilizer firewood floss flooring flour foil food footwear fruit
furniture garbage garlic gear gel gift_wrap ginger glassware glue grass gravel ground greenery hair
hair_conditioner hardware honey ice incense insulation jam jewellery jewelry juice ketchup laundry
lettuce lighting linen litter lotion luggage lumber machinery mail makeup meat medicine merchandise
milk modeling_clay mouthwash mustard oil paint paper pasta pepper perfume popcorn pottery produce
rice rubbish salsa salt sandpaper sauce seating shampoo sheet_music shelving shrubbery signage
silverware soap soda soil soup spinach stationery steam straw sugar sunscreen syrup tableware tape
tea toothpaste trash underwear vegetation vinegar wallpaper water wax wine wood wool yarn yeast
yogurt
"""
_COUNTED_WORDS = "bell_pepper drinking_straw measuring_tape pizza ice_cream_maker"
# Plurals whose singular inflect does not see, or that have none.
_PLURAL_WORDS = "clothes glasses scissors stairs shears pants jeans pliers"
_DETERMINERS = ("some ", "some ", "several ", "many ", "the ", "old ", "new ", "two ", "various ")
_MASS = frozenset(_MASS_WORDS.split())
_NOT_MASS = frozenset(_COUNTED_WORDS.split())
_PLURAL = frozenset(_PLURAL_WORDS.split())


@cache
def number(name: str) -> str:
    """Tell whether a noun is used as ``"count"``, ``"mass"``, or ``"plural"``."""
    head = name.split(" of ")[0].split()[-1]
    whole = name.replace(" ", "_")
    if whole not in _NOT_MASS and (whole in _MASS or head in _MASS):
        return "mass"
    return "plural" if head in _PLURAL or singular(head) is not None else "count"


def plural(name: str) -> str:
    """Give the plural form: ``chests of drawers``, ``shelves``, ``clothes``."""
    return pluralise(name)


def with_article(name: str) -> str:
    """Put "a" or "an" before a noun that one can count, nothing before another."""
    return f"{article(name)} {name}" if number(name) == "count" else name


def listed(items: Sequence[str], rng: random.Random) -> str:
    """Join items as people do: with and without the Oxford comma, "as well as", or no link."""
    if len(items) == 1:
        return items[0]
    head, last = list(items[:-1]), items[-1]
    link = rng.choices(
        [", and ", " and ", ", ", " as well as ", " and also ", " plus "], [44, 32, 9, 7, 4, 4]
    )[0]
    if len(items) == 2:
        return head[0] + (" and " if link in (", and ", ", ") else link) + last
    if link == " and " and rng.random() < 0.08:
        return " and ".join(items)
    return ", ".join(head) + link + last


Mark = Callable[[int, str, str], str]  # index, form, noun: the noun, perhaps marked


def noun_list(
    names: Sequence[str], rng: random.Random, mark: Mark | None = None
) -> tuple[str, bool]:
    """Render objects in one manner; also tell whether a verb after them is plural."""
    manner = rng.choices(["plural", "article", "mixed", "bare", "some"], [46, 25, 10, 7, 12])[0]
    words, plain = [], []
    for index, name in enumerate(names):
        before, form, noun = _noun(name, manner, rng)
        plain.append(before + noun)
        words.append(before + (mark(index, form, noun) if mark else noun))
    is_plural = len(names) > 1 or number(names[0]) == "plural" or plain[0] == plural(names[0])
    return listed(words, rng), is_plural and not (len(names) == 1 and number(names[0]) == "mass")


def _noun(name: str, manner: str, rng: random.Random) -> tuple[str, str, str]:
    """Give what stands before a noun, the form that it takes, and the noun in that form."""
    if manner == "mixed":
        manner = rng.choice(["plural", "article", "article", "some"])
    if manner == "article":
        before = with_article(name).removesuffix(name)
        return before, before.strip(), name
    if manner == "bare" or (number(name) == "mass" and rng.random() < 0.5):
        return "", "bare", name
    before = "" if manner == "plural" else rng.choice(_DETERMINERS)
    return before, "plural", plural(name)
