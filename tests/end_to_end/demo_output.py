"""What `make demo` prints at a terminal of 80 columns.

`PYTHONPATH=tests python -m end_to_end.demo_output` puts it into the README.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import tempfile
from pathlib import Path

from terminal import at_terminal

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
_BLOCK = re.compile(r"(<!-- demo: begin -->\n).*?(<!-- demo: end -->)", re.DOTALL)


def commands() -> list[str]:
    """The `roomtables` commands of the Makefile's demo, as a user would type them."""
    run = subprocess.run(
        ["make", "--dry-run", "--always-make", "--no-print-directory", "demo"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    joined = run.stdout.replace("\\\n", " ")
    found = re.findall(r"^\.venv/bin/(roomtables .*)$", joined, re.MULTILINE)
    return [re.sub(r" +", " ", command) for command in found]


def demo_output() -> str:
    """The commands and their output; times are left out, as no two runs share them."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for command in commands():
            words = shlex.split(command.replace(".venv/demo-tables", folder))
            shown = at_terminal(80, *words[1:], cwd=ROOT)
            if shown.code:
                raise RuntimeError(f"{command} exited {shown.code}: {shown.stderr}")
            said = re.sub(r", \d+\.\d s$", "", shown.terminal.rstrip(), flags=re.MULTILINE)
            lines += [f"$ {command}", *said.replace(folder, ".venv/demo-tables").splitlines(), ""]
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def in_readme() -> str:
    """The block as the README has it."""
    found = _BLOCK.search(README.read_text(encoding="utf-8"))
    return found.group(0) if found else ""


def as_block(text: str) -> str:
    """The block as the README should have it."""
    return f"<!-- demo: begin -->\n```console\n{text}```\n<!-- demo: end -->"


if __name__ == "__main__":
    readme = README.read_text(encoding="utf-8")
    README.write_text(readme.replace(in_readme(), as_block(demo_output())), encoding="utf-8")
