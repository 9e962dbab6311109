"""`--labels` means the same in every command: a name, a folder, or the folder one is in."""

import pytest
from click.testing import CliRunner

from roomtables.cli import main
from tiny_tables import build_tables


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    build_tables(folder)
    (folder / "rooms.jsonl").write_text(
        '{"room_id": "1", "room": "kitchen", "objects": ["oven"]}\n'
    )
    return folder


@pytest.mark.parametrize("labels", ["flat", ".", "../flat", "{site}/flat"])
@pytest.mark.parametrize(
    "command",
    [
        "status",
        "misses",
        "sql from(objects)",
        "classify bed --offline",
        "evaluate {site}/rooms.jsonl --offline",
        "labels check bed",
        "export -o {tmp}/packed.tar.gz",
    ],
)
def test_every_command_finds_the_tables(site, tmp_path, monkeypatch, command, labels):
    monkeypatch.chdir(site / "flat")
    words = [
        word.format(site=site, tmp=tmp_path) for word in f"{command} --labels {labels}".split()
    ]
    found = CliRunner().invoke(main, [*words, "--tables", str(site / "tables")])
    assert found.exit_code == 0, found.stderr
    assert found.stdout


def test_labels_show_reads_published_ones_too(site, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["labels", "show", "flat", "--tables", str(site / "tables"), "--format", "csv"]
    by_name = CliRunner().invoke(main, command).stdout
    monkeypatch.chdir(site / "flat")
    by_folder = CliRunner().invoke(main, ["labels", "show", ".", "--format", "csv"]).stdout
    assert by_name == by_folder
    assert "refrigerator" in by_name
