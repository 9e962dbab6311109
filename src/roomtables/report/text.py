"""Names from anywhere as text in a picture: every SVG well-formed, no dollar sign mathematics."""

from __future__ import annotations

import re

# C0 but the line end, DEL and C1, bidi overrides, lone surrogates, and what XML forbids.
_UNFIT = re.compile(
    "(?!\n)[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


def drawn(text: str) -> str:
    """The text as matplotlib draws it as it stands; a sign that cannot be drawn is ``�``."""
    return _UNFIT.sub("\ufffd", text).replace("$", r"\$")
