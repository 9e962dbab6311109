"""What a shell completes beside options and choices: label spaces, and versions of their tables.

``_ROOMTABLES_COMPLETE=bash_source roomtables`` prints what a shell needs for it.
"""

from __future__ import annotations

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from roomtables.config import builtin_labels
from roomtables.errors import RoomtablesError
from roomtables.storage.spaces import find_space, published_labels


def complete_labels(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Label spaces that are published or built in, else folders."""
    kinds = dict.fromkeys(builtin_labels(), "built in")
    kinds |= dict.fromkeys(published_labels(_tables(ctx)), "published")
    names = [name for name in sorted(kinds) if name.startswith(incomplete)]
    found = [CompletionItem(name, help=kinds[name]) for name in names]
    return found or [CompletionItem(incomplete, type="dir")]


def complete_versions(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Versions of the label space in use, newest first."""
    try:
        versions = find_space(_tables(ctx), ctx.params.get("labels")).versions()
    except (RoomtablesError, OSError):
        return []  # a shell has no place for what is wrong
    names = [path.name for path in reversed(versions)]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _tables(ctx: click.Context) -> Path:
    return Path(ctx.params.get("tables") or "tables")
