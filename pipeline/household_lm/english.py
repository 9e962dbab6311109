"""Number, articles, and lists for the corpus: what a noun looks like in a sentence."""

from __future__ import annotations

import random
from collections.abc import Sequence
from functools import cache

import inflect

_ENGINE = inflect.engine()

# Heads of names that inflect cannot know to be uncountable or plural in this sense.
_MASS = frozenset(
    """art artwork bedding bread butter cardboard carpeting cat_litter cement cereal chalk cheese
    chocolate cleaner clothing clutter coal coffee concrete crockery cutlery decor decoration
    detergent dirt dishwashing dust equipment exercise_gear fabric firewood flooring flour food
    footwear fruit furniture garbage gauze gear glassware glue grass gravel greenery hair hardware
    honey ice insulation jam jelly jewelry juice junk ketchup laundry lighting linen linoleum
    litter lotion lumber luggage machinery mail makeup margarine mascara mayonnaise meat medicine
    merchandise milk mouthwash mulch mustard oil paint paper pasta pepper perfume petrol pizza
    plaster plumbing plywood pottery produce rice rubbish salt sand scaffolding seating shampoo
    shelving shrubbery signage silverware soap soda soil soup stationery steel straw string stuff
    sugar sunscreen tableware tape tea timber tinsel tiling toilet_tissue tinfoil toothpaste trash
    twine underwear upholstery varnish vegetation ventilation vinegar wallpaper water waxing wine
    wiring wood wool yarn yeast yogurt conditioner cream deodorant cologne disinfectant bleach foil
    floss foam gum gel cotton leather broccoli cauliflower celery garlic lettuce spinach asparagus
    ginger popcorn tofu hummus salsa sauce syrup cash""".split()
)
_PLURAL = frozenset(
    """blinds bleachers bongos clippers clothes dishes goggles glasses groceries headphones
    earphones jeans leggings overalls pajamas pants pliers pyjamas scissors shears shorts stairs
    steps stilts sunglasses supplies sweatpants swimming_trunks tights tongs toiletries tools toys
    trousers tweezers vegetables weights drapes binoculars earbuds bunk_beds leftovers stockings
    belongings electronics monkey_bars shutters spices trunks slacks scales tracks
    castanets nuts""".split()
)
_NOT_PLURAL = ("ss", "us", "is", "as", "os", "chess", "lens", "gas")


@cache
def number(name: str) -> str:
    """Tell whether a noun is used as ``"count"``, ``"mass"``, or ``"plural"``."""
    head = name.split(" of ")[0].split(" with ")[0].split()[-1].lower()
    full = name.replace(" ", "_").lower()
    if full in _PLURAL or head in _PLURAL:
        return "plural"
    if full in _MASS or head in _MASS:
        return "mass"
    if head.endswith("s") and not head.endswith(_NOT_PLURAL) and _ENGINE.singular_noun(head):
        return "plural"
    return "count"


@cache
def plural(name: str) -> str:
    """Give the plural form; a mass or plural noun is its own."""
    if number(name) != "count":
        return name
    for joint in (" of ", " with ", " for ", " in "):
        head, found, rest = name.partition(joint)
        if found:
            return plural(head) + joint + rest
    before, _, last = name.rpartition(" ")
    return f"{before} {_ENGINE.plural_noun(last) or last}".strip()


@cache
def with_article(name: str) -> str:
    """Put "a" or "an" before a noun that one can count, nothing before another."""
    return str(_ENGINE.a(name)) if number(name) == "count" else name


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


def noun_list(names: Sequence[str], rng: random.Random) -> tuple[str, bool]:
    """Render objects in one manner; also tell whether a verb after them is plural."""
    manner = rng.choices(["plural", "article", "mixed", "bare", "some"], [48, 28, 10, 8, 6])[0]
    words = [_noun(name, manner, rng) for name in names]
    single = len(names) == 1 and words[0] != plural(names[0]) and not words[0].startswith("some ")
    is_plural = not (single or (len(names) == 1 and number(names[0]) == "mass"))
    return listed(words, rng), is_plural


def _noun(name: str, manner: str, rng: random.Random) -> str:
    if manner == "mixed":
        manner = rng.choice(["plural", "article", "article", "some"])
    if manner == "plural":
        return plural(name)
    if manner == "bare":
        return name
    if manner == "some":
        return rng.choice(["some ", "some ", "a few " if number(name) != "mass" else "some "]) + (
            plural(name)
        )
    return with_article(name)
