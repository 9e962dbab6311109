"""The commands that faults are injected into, and where they start.

A new command that writes is a line in ``COMMANDS``.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fault_site import SPACE, Site
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.pulling import pull
from roomtables.storage.pushing import push
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.sent_misses import send_misses
from support import HashScorer

MISSED = ["bed", "sink", "stove"]


@dataclass(frozen=True)
class Command:
    """A command that is disturbed.

    Attributes
    ----------
    line : its words; ``{labels}``, ``{tables}``, ``{archive}``, ``{database}`` and ``{url}`` are
        filled in
    prepare : makes what it starts from
    published : whether tables are published before
    done : whether it has taken effect already, where it cannot be run twice
    placed : makes what cannot be moved, where the command is to run
    behind : the first call that is disturbed is that on a path which ends so: what comes before is
        another command's
    """

    name: str
    line: str
    prepare: Callable[[Site], None]
    published: bool = True
    done: Callable[[Site], bool] | None = None
    placed: Callable[[Site], None] | None = None
    behind: str = ""

    def args(self, site: Site) -> list[str]:
        words = self.line.split()
        named = {"tables": site.tables, "archive": site.archive, "database": site.database}
        named["labels"] = site.root / "labels" / SPACE.name
        return [word.format(**named, url=site.url) for word in words]


def _nothing(site: Site) -> None:
    """An empty folder."""


def _versions(site: Site) -> None:
    for k in (1, 2):
        site.build(k=k)


def _misses(site: Site) -> None:
    site.build(k=3, combinations="none")
    folder = site.space().path / FOLDER
    folder.mkdir()
    line = {"source": "proxy", "objects": MISSED, "asked": "2026-01-01T00:00:00+00:00"}
    (folder / "robot.jsonl").write_text(json.dumps(line) + "\n")


def _pushed(site: Site) -> None:
    """A version that is pushed, and a newer one that is not, and that was found up to date."""
    site.build(k=1)
    push(site.tables, SPACE.name, site.url)
    for _ in range(2):
        site.build(k=2)


def _at_a_place(site: Site) -> None:
    """A place with tables, and no tables here."""
    for _ in range(2):
        site.build(k=2)
    push(site.tables, SPACE.name, site.url)
    shutil.rmtree(site.tables)


def _pulled(site: Site) -> None:
    """A version that was pulled, and a newer one at the place."""
    site.build(k=1)
    push(site.tables, SPACE.name, site.url)
    robot = site.root / "robot"
    pull(robot, SPACE.name, site.url)
    site.build(k=2)
    push(site.tables, SPACE.name, site.url)
    shutil.rmtree(site.tables)
    robot.rename(site.tables)


def _misses_at_a_place(site: Site) -> None:
    """Misses that a robot sent, and tables that lack them."""
    _misses(site)
    send_misses(site.tables, SPACE.name, site.url)
    shutil.rmtree(site.space().path / FOLDER)


def _garbage(site: Site) -> None:
    """An old version, a model not in use, and what killed processes leave."""
    site.build(k=1, scorer=HashScorer("hash@2"))
    site.build(k=2)
    space, scores = site.space().path, site.tables / "scores" / "hash@1"
    shutil.copytree(site.space().current().path, space / ".staging-1")
    for aside in (space / ".CURRENT.77.tmp", space / ".CURRENT.0123abcd.tmp", scores / ".77.tmp"):
        aside.write_bytes(b"half")
    run = SentenceCache(site.tables, "hash@1").run_folder()
    shutil.copytree(scores, run.folder, ignore=shutil.ignore_patterns(".*"))


def _database(site: Site) -> None:
    """A database, which builds write anew: it holds absolute paths."""
    site.run(Command("", _DATABASE, _nothing).args(site))


def _rolled_back(site: Site) -> bool:
    return site.space().current().path == site.space().versions()[0]


_BUILD = "build --tables {tables} --labels {labels}"
_MISSES = f"{_BUILD} --combinations misses"
_PULL = "pull {url} --tables {tables} --labels home"
_PUSH = "push {url} --tables {tables} --labels home"
_DATABASE = "sql --tables {tables} --labels home --db {database}"
COMMANDS: Mapping[str, Command] = {
    command.name: command
    for command in (
        Command("first-build", f"{_BUILD} -k 2", _nothing, published=False),
        Command("build", f"{_BUILD} -k 3", _versions),
        Command("full-refresh", f"{_BUILD} -k 2 --full-refresh", _versions),
        Command("up-to-date", f"{_BUILD} -k 2", _versions),
        Command("misses", _MISSES, _misses),
        Command("misses-from", f"{_MISSES} --misses-from {{url}}", _misses_at_a_place),
        Command("compact", "compact --tables {tables}", _versions),
        Command("gc", "gc --tables {tables} --keep 1 --unused-scores", _garbage),
        Command(
            "rollback", "rollback --tables {tables} --labels home", _versions, done=_rolled_back
        ),
        Command("export", "export --tables {tables} --labels home -o {archive}", _versions),
        Command("database", _DATABASE, _versions),
        Command("database-anew", f"{_BUILD} -k 3", _versions, placed=_database, behind="/CURRENT"),
        Command("plan", "plan --exact --tables {tables} --labels {labels} -k 3", _versions),
        Command("push", _PUSH, _pushed),
        Command("push-misses", f"{_PUSH} --misses", _misses),
        Command("pull", _PULL, _pulled),
        Command("first-pull", _PULL, _at_a_place, published=False),
    )
}
