"""Whether a command prints what its page shows, but for what no two runs or processors share."""

from __future__ import annotations

import re

# Times, dates, what is derived from a file's bytes, and how many those are.
_VARIES = re.compile(
    r"\b\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}(?:\.\d+)?(?:\+00:00|Z)?"
    r"|\b[\d,]+(?:\.\d+)? (?:s|ms|min|h|seconds|minutes|hours)\b(?: ago| old)?"
    r"|\b(?:bytes|age_hours) +[\d.]+"
    r"|(?<=-)[0-9a-f]{8}\b"
    r"|\b[0-9a-f]{16,64}\b"
    r"|\b[\d,.]+ sentences (?:a|/) ?s(?:econd)?\b"
)
_NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")
_REST = "…"


def matches(shown: str, printed: str, stderr: str = "") -> bool:
    """Whether a page shows what was printed; a line `…` of the page stands for any lines.

    Lines of ``stderr`` may stand anywhere: how two streams mix is another thing in every run.
    """
    if _in_order(shown, printed):
        return True
    apart = [_without(text, stderr) for text in (shown, printed)]
    return apart[0] is not None and apart[1] is not None and _in_order(apart[0], apart[1])


def _without(text: str, stderr: str) -> str | None:
    """A text without the lines of another, each once; None where it has not all of them."""
    lines = text.splitlines(keepends=True)
    for said in stderr.splitlines():
        found = [line for line in lines if _same(line, said)]
        if not found:
            return None
        lines.remove(found[0])
    return "".join(lines)


def _in_order(shown: str, printed: str) -> bool:
    before, rest, after = shown.partition(f"{_REST}\n")
    lines = printed.splitlines()
    if not rest:
        return _same(shown, printed)
    first, last = len(before.splitlines()), len(after.splitlines())
    if len(lines) < first + last:
        return False
    return _same(before, "\n".join(lines[:first])) and _same(
        after, "\n".join(lines[len(lines) - last :])
    )


def as_shown(printed: str, shown: str) -> str:
    """What a page should show from now on: as many lines about its `…` as it had."""
    text = "".join(f"{line.rstrip()}\n" for line in printed.splitlines())
    before, rest, after = shown.partition(f"{_REST}\n")
    first, last = len(before.splitlines()), len(after.splitlines())
    lines = text.splitlines(keepends=True)
    if not rest or len(lines) <= first + last:
        return text
    return "".join([*lines[:first], f"{_REST}\n", *lines[len(lines) - last :]])


def _same(shown: str, printed: str) -> bool:
    shown, printed = (_VARIES.sub("@", text) for text in (shown, printed))
    if _words(shown) != _words(printed):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True)
    return all(_close(ours, theirs) for ours, theirs in pairs)


def _words(text: str) -> list[str]:
    """What is not a number; columns are as wide as their widest number, and rules as columns."""
    text = _NUMBER.sub("#", text)
    lines = [re.sub(r"[ ─-]+", " ", line).strip() for line in text.strip().splitlines()]
    return lines


def _close(shown: str, printed: str) -> bool:
    """Whole numbers are equal; of others another processor may round the last digits otherwise."""
    if "." not in shown and "." not in printed:
        return shown == printed
    ours, theirs = (float(text.replace(",", "")) for text in (shown, printed))
    unit = 10.0 ** -len(shown.partition(".")[2].partition("e")[0])
    return abs(ours - theirs) <= max(1.01 * unit, 0.01 * abs(ours))
