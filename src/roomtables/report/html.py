"""HTML without a template engine: escaped text, tables, and cells coloured by their number."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from roomtables.wording import percent

STYLE = """
:root { color-scheme: light; --line: #d8dde3; --ink: #1c2733; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); margin: 0 auto; max-width: 1180px;
  padding: 0 24px 64px; }
h1 { font-size: 28px; margin: 32px 0 4px; } h2 { font-size: 20px; margin: 40px 0 6px; }
p { max-width: 78ch; margin: 6px 0 12px; overflow-wrap: anywhere; }
nav a { margin-right: 14px; } a { color: #2257a8; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 8px; text-align: left; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { font-weight: 600; background: #fff; } td.n { text-align: right; }
.scroll { overflow: auto; max-height: 82vh; border: 1px solid var(--line); border-radius: 6px; }
.heat td, .heat th { padding: 0 4px; height: 21px; font-size: 12px; border: 0;
  white-space: nowrap; }
.heat td { min-width: 25px; text-align: center; }
.heat thead th { position: sticky; top: 0; z-index: 2; height: 128px; vertical-align: bottom; }
.heat thead th span { writing-mode: vertical-rl; transform: rotate(180deg); }
.heat tbody th { position: sticky; left: 0; z-index: 1; text-align: right; font-weight: 400; }
.heat thead th:first-child { left: 0; z-index: 3; }
.bar { position: relative; min-width: 170px; } .bar i { position: absolute; inset: 4px auto 4px 0;
  background: #bcd3f2; border-radius: 2px; } .bar b { position: relative; font-weight: 400;
  padding-left: 4px; }
.columns { display: grid; gap: 0 32px;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); }
.columns > div { min-width: 0; }
.wide { overflow-x: auto; }
svg { max-width: 100%; height: auto; }
@media (max-width: 600px) {
  body { padding: 0 12px 48px; } nav a { display: inline-block; padding: 4px 0; }
  table { font-size: 13px; } th { font-size: 12px; } th, td { padding: 3px; }
  .bar { min-width: 64px; }
  #about td { overflow-wrap: anywhere; }
}
@media (hover: none) { .heat td:hover::after { content: attr(title); position: fixed; left: 12px;
  bottom: 12px; z-index: 9; padding: 6px 10px; border: 1px solid var(--line); border-radius: 6px;
  background: #fff; color: var(--ink); font-size: 14px; } }
"""


def page(title: str, sections: Sequence[tuple[str, str, str]]) -> str:
    """A whole page: sections are (anchor, heading, body as HTML)."""
    links = " ".join(f'<a href="#{anchor}">{escape(head)}</a>' for anchor, head, _ in sections)
    bodies = "\n".join(
        f'<section id="{anchor}"><h2>{escape(head)}</h2>\n{body}</section>'
        for anchor, head, body in sections
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1><nav>{links}</nav>\n{bodies}\n</body></html>\n"
    )


def paragraph(text: str) -> str:
    """A paragraph of escaped text, in which no line begins with a percent sign."""
    return f"<p>{escape(text).replace(' %', '&nbsp;%')}</p>\n"


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; numbers stand to the right, :class:`Bar` cells are drawn.

    On a narrow screen cells break their lines, and what is wider still scrolls by itself.
    """
    heads = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "\n".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    whole = f"<table><thead><tr>{heads}</tr></thead><tbody>\n{lines}\n</tbody></table>"
    return f'<div class="wide">{whole}</div>\n'


class Bar(float):
    """A share from 0 to 1, shown as a bar with its percentage."""


def _cell(value: object) -> str:
    if isinstance(value, Bar):
        bar = f'<i style="width:{100 * value:.1f}%"></i><b>{percent(value)}</b>'
        return f'<td class="bar">{bar}</td>'
    if isinstance(value, int | float):
        text = f"{value:,}" if isinstance(value, int) else f"{value:.3f}"
        return f'<td class="n">{text}</td>'
    return f"<td>{escape(str(value))}</td>"


def heat_map(
    corner: str,
    columns: Sequence[str],
    rows: Iterable[tuple[str, Sequence[float]]],
    count: bool = False,
) -> str:
    """A table of shares from 0 to 1 as colours; both its heads stay in sight when it scrolls.

    With ``count`` the cells are whole numbers, coloured by their share of the row.
    """
    heads = "".join(f"<th><span>{escape(name)}</span></th>" for name in columns)
    lines = []
    for name, values in rows:
        total = sum(values) if count else 1.0
        cells = "".join(_heat(v, v / total if total else 0.0, count, name, c)
                        for v, c in zip(values, columns, strict=True))  # fmt: skip
        lines.append(f"<tr><th>{escape(name)}</th>{cells}</tr>")
    body = "\n".join(lines)
    return (
        f'<div class="scroll"><table class="heat"><thead><tr><th>{escape(corner)}</th>{heads}</tr>'
        f"</thead><tbody>\n{body}\n</tbody></table></div>\n"
    )


def _heat(value: float, share: float, count: bool, row: str, column: str) -> str:
    """A cell from white to blue; the square root keeps small shares visible."""
    depth = max(0.0, min(1.0, share)) ** 0.5
    red, green, blue = (round(255 - depth * (255 - end)) for end in (24, 78, 146))
    ink = ";color:#fff" if depth > 0.6 else ""
    text = str(int(value)) if count and value else f"{100 * value:.0f}" if value >= 0.095 else ""
    shown = f"{int(value)} rooms" if count else f"{value:.4f}"
    title = escape(f"{row}, {column}: {shown}", quote=True)
    return f'<td style="background:rgb({red},{green},{blue}){ink}" title="{title}">{text}</td>'
