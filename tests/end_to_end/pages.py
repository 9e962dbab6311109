"""The pages' blocks: what runs, what it should print, and writing that anew.

    python tests/end_to_end/pages.py --write                    # all pages
    python tests/end_to_end/pages.py --write --slow docs/accuracy.md

A `console` block holds commands behind `$ ` (a `\\` at a line's end goes on) and what they print,
where a line `…` stands for any lines. A `python` block runs by itself; a `text` block behind it is
what it prints. An `sql` block is asked by the command of the page's comment `<!-- sql: … -->`. A
comment in front of a block says when it runs: `<!-- slow -->`, only with the slow tests;
`<!-- data -->`, only where real test data is. `sh` is what cannot run here: see not_run.toml.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import tomllib

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from end_to_end.page_output import as_shown, matches
from end_to_end.page_shell import ROOT, Shell, pages

PAGES = [
    "README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
    "tables/README.md",
    "src/roomtables/models/household-lm/README.md",
    "pipeline/household_lm/README.md",
    "pipeline/household_lm/names/README.md",
]
RUN = ("console", "python", "sql")
# What a reader reads: no block of these is a command.
SHOWN = ("text", "ini", "yaml", "toml", "json", "csv", "cpp", "crontab")
NOT_RUN = Path(__file__).with_name("not_run.toml")

_BLOCK = re.compile(
    r"(?:^<!-- (?P<when>[a-z, ]+) -->\n)?^```(?P<kind>[^\n]*)\n(?P<text>.*?)^```\n"
    r"(?:\n```text\n(?P<output>.*?)^```\n)?",
    re.MULTILINE | re.DOTALL,
)
_SQL = re.compile(r"^<!-- sql: (.*) -->$", re.MULTILINE)
_COMMAND = re.compile(r"^\$ ((?:.*\\\n)*.*)\n?", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; ``output`` is the `text` block behind one that has none inside."""

    page: str
    line: int
    kind: str
    text: str
    output: str | None
    when: tuple[str, ...]

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"

    def commands(self) -> list[tuple[str, str]]:
        """A console block's commands, and what each should print."""
        if not self.text.startswith("$ "):
            raise ValueError(f"{self.where}: a console block begins with a command behind `$ `")
        found = list(_COMMAND.finditer(self.text))
        ends = [*(match.start() for match in found[1:]), len(self.text)]
        return [
            (match[1], self.text[match.end() : end]) for match, end in zip(found, ends, strict=True)
        ]

    def runs(self, slow: bool, data: bool) -> bool:
        """Whether it is to run: with slow ones or without, with real test data or without."""
        allowed = {"slow": slow, "data": data}
        return self.kind in RUN and all(allowed.get(word, True) for word in self.when)


def blocks(page: str) -> list[Block]:
    """The blocks of a page, in order."""
    return [
        _block(page, match) for match in _BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))
    ]


def _block(page: str, match: re.Match[str]) -> Block:
    when = tuple(word.strip() for word in (match["when"] or "").split(",") if word.strip())
    line = match.string.count("\n", 0, match.start("kind")) + 1
    return Block(page, line, match["kind"], match["text"], match["output"], when)


def faults_of(block: Block) -> list[str]:
    """What is wrong with a block before it runs."""
    found = []
    if block.kind not in (*RUN, *SHOWN, "sh"):
        found.append(f"{block.where}: nobody knows how to check a block of kind {block.kind!r}")
    if block.kind == "console" and not any(output.strip() for _, output in block.commands()):
        found.append(f"{block.where}: a console block shows what its commands print")
    if block.kind == "sql" and block.output is None:
        found.append(f"{block.where}: a query shows what it prints, in a `text` block behind it")
    if unknown := set(block.when) - {"slow", "data"}:
        found.append(f"{block.where}: `<!-- {', '.join(unknown)} -->` is neither slow nor data")
    return found


def reasons() -> list[dict[str, str]]:
    """Why each `sh` block does not run: its page, how it begins, and the reason."""
    return tomllib.loads(NOT_RUN.read_text(encoding="utf-8"))["block"]


def data_here() -> bool:
    """Whether real test data lies where the pages' `DATA` says."""
    return (Path(os.environ.get("ROOMTABLES_SHARED", ROOT / "shared")) / "data").is_dir()


def run_page(
    page: str, shell: Shell, slow: bool = False, write: bool = False, root: Path = ROOT
) -> list[tuple[str, str, str]]:
    """Run a page's blocks in order; returns (where and what, shown, printed) of what differs.

    With ``write`` the page is given what its commands print, where it shows another thing.
    """
    text = (root / page).read_text(encoding="utf-8")
    sql = _SQL.search(text)
    wrong: list[tuple[str, str, str]] = []

    def anew(match: re.Match[str]) -> str:
        block = _block(page, match)
        if not block.runs(slow, data_here()):
            return match[0]
        asked = _asked(block, sql[1] if sql else "roomtables sql", shell.folder)
        outputs = [_ran(shell, block, command, shown, wrong) for command, shown in asked]
        if block.kind == "console":
            pairs = zip(asked, outputs, strict=True)
            inside = "".join(f"$ {command}\n{output}" for (command, _), output in pairs)
            return match[0].replace(f"\n{block.text}```", f"\n{inside}```")
        if block.output is None:
            return match[0]
        return match[0].replace(f"```text\n{block.output}```", f"```text\n{outputs[0]}```")

    written = _BLOCK.sub(anew, text)
    if write and written != text:
        (root / page).write_text(written, encoding="utf-8")
    return wrong


def _asked(block: Block, sql: str, folder: Path) -> list[tuple[str, str]]:
    """The commands that a block comes to, and what the page shows of each."""
    if block.kind == "console":
        return block.commands()
    if block.kind == "sql":
        return [(f"{sql} {shlex.quote(block.text.strip())}", block.output or "")]
    script = folder / ".block.py"
    script.write_text(block.text, encoding="utf-8")
    return [(f"python {script}", block.output or "")]


def _ran(
    shell: Shell, block: Block, command: str, shown: str, wrong: list[tuple[str, str, str]]
) -> str:
    """What the page should show of a command: what it shows, if that is what is printed."""
    printed, stderr, code = shell.run(command)
    if code and not re.search(r"^error: |^Error: ", shown, re.MULTILINE):
        wrong.append((f"{block.where}: `{command}` exits {code}", shown, printed))
    elif not matches(shown, printed, stderr):
        wrong.append((f"{block.where}: `{command}`", shown, printed))
    else:
        return shown
    return as_shown(printed, shown)


def _run_all(
    names: list[str], folder: Path, slow: bool, write: bool, say: Callable[[str], None]
) -> int:
    """Run pages; returns how many commands printed another thing than their page shows."""
    count = 0
    with pages(folder) as made:
        for page in names:
            with made.shell(page.replace("/", "-"), page != "README.md") as shell:
                wrong = run_page(page, shell, slow, write)
            for what, shown, printed in wrong:
                say(f"{what}\n--- the page shows\n{shown}--- it prints\n{printed}")
            count += len(wrong)
    return count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", default=PAGES)
    parser.add_argument("--write", action="store_true", help="put what is printed into the pages")
    parser.add_argument("--slow", action="store_true", help="run slow blocks, too")
    parser.add_argument("--folder", type=Path, help="where `make demo` was run by a run before")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        count = _run_all(options.pages, folder, options.slow, options.write, print)
    print(f"{count} {'written' if options.write else 'to write'}")
    return 0 if options.write else min(count, 1)


if __name__ == "__main__":
    sys.exit(main())
