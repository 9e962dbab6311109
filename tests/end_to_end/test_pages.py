"""The pages' blocks run as written, in order, after `make demo`, and print what the pages show."""

import re
from pathlib import Path

import pytest

from end_to_end.page_output import as_shown, matches
from end_to_end.page_shell import ROOT, Shell, pages
from end_to_end.pages import PAGES, Block, blocks, data_here, faults_of, reasons, run_page

RUNNING = [page for page in PAGES if any(block.runs(False, data_here()) for block in blocks(page))]
SLOW = [page for page in PAGES if any("slow" in block.when for block in blocks(page))]


@pytest.fixture(scope="session")
def made_pages(tmp_path_factory):
    for needed in ("torch", "matplotlib", "yaml"):
        pytest.importorskip(needed)
    with pages(tmp_path_factory.mktemp("pages")) as made:
        yield made


@pytest.mark.parametrize("page", RUNNING)
def test_a_page_does_what_it_says(page, made_pages):
    _check(page, made_pages, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW)
def test_a_page_with_its_slow_blocks_does_what_it_says(page, made_pages):
    _check(page, made_pages, slow=True)


def _check(page, made_pages, slow):
    with made_pages.shell(page.replace("/", "-"), activated=page != "README.md") as shell:
        wrong = run_page(page, shell, slow)
    said = "".join(
        f"\n{what}\n--- the page shows\n{shown}--- it prints\n{printed}"
        for what, shown, printed in wrong
    )
    again = f"python tests/end_to_end/pages.py --write {'--slow ' * slow}{page}"
    assert not wrong, f"{said}\nIf that is right: {again}"


def test_the_readme_shows_the_floor_plan_that_its_command_draws(made_pages):
    with made_pages.shell("floor-plan", activated=True) as shell:
        shell.run(
            "roomtables show src/roomtables/examples/apartment.json --offline -o apartment.svg"
        )
        drawn, shown = (
            re.findall(r">([^<>\n]+)</text>", path.read_text())
            for path in (shell.folder / "apartment.svg", ROOT / "docs" / "apartment.svg")
        )
    assert any("bathroom" in text for text in drawn)
    assert shown == drawn, "run `make pictures`"


@pytest.mark.parametrize("page", PAGES)
def test_every_block_can_be_checked(page):
    found = blocks(page)
    assert [fault for block in found for fault in faults_of(block)] == []
    fences = re.findall(r"^ *```", (ROOT / page).read_text(), re.MULTILINE)
    outputs = [block for block in found if block.output is not None]
    assert len(fences) == 2 * len(found) + 2 * len(outputs), "a block is indented, or has no end"


def test_what_cannot_run_has_one_reason_each_and_every_reason_a_block():
    listed = [(entry["page"], entry["begins"]) for entry in reasons()]
    shells = [block for page in PAGES for block in blocks(page) if block.kind == "sh"]
    for block in shells:
        found = [begins for page, begins in listed
                 if page == block.page and block.text.startswith(begins)]  # fmt: skip
        assert len(found) == 1, f"{block.where}: give a reason in tests/end_to_end/not_run.toml"
    assert len(listed) == len(shells), "a reason in not_run.toml is of no block"
    assert all(len(entry["reason"]) > 3 for entry in reasons())


@pytest.mark.parametrize(
    ("kind", "text", "output", "word"),
    [
        ("bash", "ls\n", None, "kind 'bash'"),
        ("", "ls\n", None, "kind ''"),
        ("console", "$ ls\n", None, "shows what its commands print"),
        ("sql", "select 1\n", None, "shows what it prints"),
    ],
)
def test_a_block_that_nobody_could_check_is_a_fault(kind, text, output, word):
    (fault,) = faults_of(Block("page.md", 3, kind, text, output, ()))
    assert word in fault
    assert "page.md:3" in fault


def test_cron_starts_what_the_timer_starts():
    page = (ROOT / "docs" / "nightly.md").read_text()
    (started,) = re.findall(r"^ExecStart=(.*)$", page, re.MULTILINE)
    (line,) = re.findall(r"^30 2 \* \* \* .*$", page, re.MULTILINE)
    assert f" {started} " in line
    assert (ROOT / "docs" / "examples" / Path(started.split()[0]).name).is_file()


@pytest.fixture
def page(tmp_path):
    """Runs a page of this text in a bare shell; returns what differs, and the text as written."""

    def run(text):
        (tmp_path / "page.md").write_text(text)
        shell = Shell(tmp_path, {"PATH": "/usr/bin:/bin"})
        try:
            wrong = run_page("page.md", shell, write=True, root=tmp_path)
        finally:
            shell.close()
        return wrong, (tmp_path / "page.md").read_text()

    return run


def test_a_page_that_is_right_stays_as_it_is(page):
    text = "A page.\n\n```console\n$ word=one\n$ echo $word \\\n    two\none two\n```\n"
    assert page(text) == ([], text)


def test_what_a_page_shows_wrongly_is_named_and_written_anew(page):
    shown = "```console\n$ echo one\ntwo\n$ echo four >&2\n```\n"
    wrong, written = page(shown)
    assert [(what, old) for what, old, _ in wrong] == [
        ("page.md:1: `echo one`", "two\n"),
        ("page.md:1: `echo four >&2`", ""),
    ]
    assert written == "```console\n$ echo one\none\n$ echo four >&2\nfour\n```\n"


def test_queries_are_asked_by_the_command_that_the_page_names(page):
    text = "<!-- sql: printf 'asked: %s\\n' -->\n```sql\nselect 'a'\n```\n\n```text\n?\n```\n"
    _, written = page(text)
    assert written == text.replace("?", "asked: select 'a'")


def test_a_command_that_fails_is_wrong_unless_its_error_is_shown(page):
    ((what, _, _),) = page("```console\n$ echo so; false\nso\n```\n")[0]
    assert what.endswith("exits 1")
    assert page("```console\n$ echo error: so; false\nerror: so\n```\n")[0] == []


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("published 000001-0123abcd, 12.3 s", "published 000001-99fe0000, 4.0 s"),
        ("saved 2026-01-02T03:04:05+00:00", "saved 2027-11-12T13:14:15+00:00"),
        ("bytes       123", "bytes  1250"),
        ("p\n-----\n0.849", "p\n----\n0.85"),
        ("first\n…\nlast", "first\nsecond\nthird\nlast"),
    ],
)
def test_what_no_two_runs_share_is_left_out(shown, printed):
    assert matches(f"{shown}\n", f"{printed}\n")


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("bathroom", "bedroom"),
        ("523 rooms", "522 rooms"),
        ("000001-0123abcd", "000002-0123abcd"),
        ("0.849", "0.83"),
        ("-3.2", "3.2"),
        ("one", "one\ntwo"),
        ("first\n…\nlast", "first\nsecond"),
    ],
)
def test_what_differs_differs(shown, printed):
    assert not matches(f"{shown}\n", f"{printed}\n")


def test_lines_of_stderr_may_stand_anywhere_but_must_stand():
    assert matches("a\nwarning\nb\n", "warning\na\nb\n", stderr="warning\n")
    assert not matches("a\nb\n", "warning\na\nb\n", stderr="warning\n")
    assert not matches("b\nwarning\na\n", "warning\na\nb\n", stderr="warning\n")


def test_an_ellipsis_stays_where_a_page_is_written_anew():
    assert as_shown("1\n2\n3\n4\n", "a\n…\nb\n") == "1\n…\n4\n"
    assert as_shown("1\n2\n", "a\n…\nb\n") == "1\n2\n"
