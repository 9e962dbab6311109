"""The commands that faults are injected into, where they start, and what must be there afterwards.

A new command that writes is a line in ``COMMANDS``.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow.parquet as pq

import roomtables.lm
from roomtables import RoomTables, build
from roomtables.cli import main as command_line
from roomtables.labels import LabelSpace
from roomtables.offline import (  # noqa: F401  (once, before the forks)
    builder,
    model,
    plan,
    scoring,
    upkeep,
)
from roomtables.storage.checked import last_checked
from roomtables.storage.miss_log import FOLDER
from roomtables.storage.misses import Misses
from roomtables.storage.score_cache import SentenceCache
from roomtables.storage.versions import MANIFEST, SpaceFolder
from support import HashScorer, write_space

SPACE = LabelSpace.named("home", ["bed", "sink", "stove", "toilet"], ["bathroom", "kitchen"])
MISSED = ["bed", "sink", "stove"]
_TOLERANCE = 1e-9
# What differs from run to run in the names of files that are being written.
_SCRATCH = re.compile(r"(?<=[.-])([0-9a-z_]{8}|\d+)(?=/|\.|$)")
# It says to people which process holds it.
_LOCK = ".build-lock"
# What may lie in a tables folder after `gc`, besides the files of whole versions.
_KEPT = (
    r"labels/.*",
    r"tables/\.build-lock",
    r"tables/home/(CURRENT|CHECKED)",
    r"tables/home/databases/[0-9a-f]{16}\.json",
    r"tables/home/misses/(taken\.json|robot\.jsonl)",
    r"tables/scores/[^/]+/part-[0-9a-f]{16}\.parquet",
    r"out/tables\.tar\.zst",
    r"out/rooms\.duckdb",
)


@dataclass(frozen=True)
class Site:
    """The folder that a command works in: label space, tables, output, temporary files."""

    root: Path

    @property
    def tables(self) -> Path:
        return self.root / "tables"

    @property
    def archive(self) -> Path:
        return self.root / "out" / "tables.tar.zst"

    @property
    def database(self) -> Path:
        return self.root / "out" / "rooms.duckdb"

    def make(self) -> None:
        for name in ("out", "tmp"):
            (self.root / name).mkdir(parents=True)
        write_space(self.root / "labels", SPACE)

    @contextmanager
    def entered(self) -> Iterator[Callable[[Sequence[str]], Any]]:
        """The command line, as it runs here, with a model made up of hashes."""
        # Else Python tries the folder first, by a file of its own.
        tempfile.tempdir = str(self.root / "tmp")
        scoring.PART_SENTENCES = 20  # so that a build writes several parts
        model.EMBEDDED_MODEL = "none"  # else a build runs it from its ONNX file
        roomtables.lm.identify = lambda *args, **settings: "hash@1"
        roomtables.lm.load_scorer = lambda *args, **settings: HashScorer()
        yield command_line

    def run(self, args: Sequence[str]) -> None:
        """Run a command that must succeed, in this process."""
        with self.entered() as main:
            main(args, standalone_mode=False)

    def build(self, **options: Any) -> None:
        scoring.PART_SENTENCES = 20
        settings = {"labels": str(self.root / "labels" / SPACE.name), "scorer": HashScorer()}
        build(tables=self.tables, **settings | options)

    def space(self) -> SpaceFolder:
        return SpaceFolder(self.tables, SPACE.name)

    def read(self, published: bool) -> None:
        """Open and classify, as a reader does; where nothing is published there is none."""
        if published:
            opened = RoomTables.open(self.tables, SPACE.name, offline=True, note_misses=False)
            assert opened.deciding(rule="pooled").classify(["bed"]).room
            opened.deciding(rule="query").classify(["bed"])

    def contents(self) -> dict[str, Any]:
        """All rows of the published tables, the scores and the archive, by name."""
        version = self.space().current()
        version.verify()
        found: dict[str, Any] = {"misses": Misses.read(version.path.parent / FOLDER).open}
        found["checked"] = last_checked(version) is not None
        found |= {
            path.name: sorted(map(repr_row, pq.read_table(path, use_threads=False).to_pylist()))
            for path in version.path.glob("*.parquet")
        }
        found |= {path.name: np.load(path).tolist() for path in version.path.rglob("*.npy")}
        for folder in sorted((self.tables / "scores").glob("*")):
            rows = duckdb.sql(f"from ({SentenceCache(self.tables, folder.name).select()})")
            found[folder.name] = sorted(rows.fetchall())
        if self.archive.exists():
            found["archive"] = self.archive.read_bytes()
        if self.database.exists():
            found["database"] = self.database_rows()
        return found

    def state(self) -> str:
        """A digest of every file's name and bytes, less what says which process wrote it."""
        lines = []
        for path in self.root.rglob("*"):
            name = _SCRATCH.sub("*", str(path.relative_to(self.root)))
            held = path.is_file() and path.name != _LOCK
            digest = hashlib.sha256(path.read_bytes()).hexdigest() if held else ""
            lines.append(f"{name} {path.lstat().st_mode} {digest}")
        return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()

    def database_rows(self) -> dict[str, list[Any]]:
        """What a client reads of the published version; other views read what is there, too."""
        with duckdb.connect(str(self.database), read_only=True) as client:
            for view in ("version_changes", "sentence_scores", "miss_coverage"):
                client.execute(f"select count(*) from {view}").fetchall()
            return {
                view: client.execute(f"from {view} order by all").fetchall()
                for view in ("decision", "entropy", "query_scores")
            }


def repr_row(row: Mapping[str, Any]) -> list[Any]:
    """A row as a list that sorts: text and numbers apart, numbers last."""
    values = [row[name] for name in sorted(row)]
    texts = [str(value) for value in values if not isinstance(value, float)]
    return [*texts, *[value for value in values if isinstance(value, float)]]


def same(expected: Any, found: Any, where: str = "") -> str:
    """Where two values differ by more than the tolerance; empty where they do not."""
    if isinstance(expected, dict) and isinstance(found, dict):
        if expected.keys() != found.keys():
            return f"{where}: {sorted(expected)} are now {sorted(found)}"
        differing = (same(expected[key], found[key], f"{where}/{key}") for key in expected)
    elif isinstance(expected, list | tuple) and isinstance(found, list | tuple):
        if len(expected) != len(found):
            return f"{where}: {len(expected)} are now {len(found)}"
        pairs = enumerate(zip(expected, found, strict=True))
        differing = (same(one, other, f"{where}/{number}") for number, (one, other) in pairs)
    elif isinstance(expected, float) and isinstance(found, float):
        close = math.isclose(expected, found, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
        return "" if close else f"{where}: {expected} is now {found}"
    else:
        return (
            "" if expected == found else f"{where}: {str(expected)[:80]} is now {str(found)[:80]}"
        )
    return next((text for text in differing if text), "")


def litter(site: Site) -> list[str]:
    """Files and folders that no command leaves on purpose."""
    versions = set()
    for path in site.space().versions():
        noted = json.loads((path / MANIFEST).read_text())["files"]
        versions |= {path / name for name in [MANIFEST, *noted]}
    folders = {parent for path in versions for parent in path.parents}
    folders |= {site.root / name for name in ("labels", "labels/home", "out", "tmp")}
    scores = site.tables / "scores"
    folders |= {site.space().path / name for name in (FOLDER, "databases")}
    folders |= {scores, *scores.glob("[!.]*")}
    return sorted(
        name
        for path in site.root.rglob("*")
        if path not in versions and path not in folders
        and not re.fullmatch("|".join(_KEPT), name := str(path.relative_to(site.root)))
    )  # fmt: skip


@dataclass(frozen=True)
class Command:
    """A command that is disturbed.

    Attributes
    ----------
    line : its words; ``{labels}``, ``{tables}``, ``{archive}``, ``{database}`` are filled in
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
        return [word.format(**named) for word in words]


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
_DATABASE = "sql --tables {tables} --labels home --db {database}"
COMMANDS: Mapping[str, Command] = {
    command.name: command
    for command in (
        Command("first-build", f"{_BUILD} -k 2", _nothing, published=False),
        Command("build", f"{_BUILD} -k 3", _versions),
        Command("full-refresh", f"{_BUILD} -k 2 --full-refresh", _versions),
        Command("up-to-date", f"{_BUILD} -k 2", _versions),
        Command("misses", f"{_BUILD} --combinations misses", _misses),
        Command("compact", "compact --tables {tables}", _versions),
        Command("gc", "gc --tables {tables} --keep 1 --unused-scores", _garbage),
        Command(
            "rollback", "rollback --tables {tables} --labels home", _versions, done=_rolled_back
        ),
        Command("export", "export --tables {tables} --labels home -o {archive}", _versions),
        Command("database", _DATABASE, _versions),
        Command("database-anew", f"{_BUILD} -k 3", _versions, placed=_database, behind="/CURRENT"),
        Command("plan", "plan --exact --tables {tables} --labels {labels} -k 3", _versions),
    )
}
