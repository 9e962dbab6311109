"""The queries of docs/sql.md and their output; run as a script, it writes the output in."""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from roomtables import RoomTables, build
from roomtables.cli.common import render
from roomtables.rooms import read_room_lines
from roomtables.storage.views import connect, select
from sql_fixtures import save_evaluation

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "sql.md"
HOUSE = ROOT / "src" / "roomtables" / "examples" / "house.jsonl"
_QUERY = re.compile(r"```sql\n(.*?)\n```\n(?:\n```text\n(.*?)```\n)?", re.DOTALL)


def queries(page: str) -> list[tuple[str, str]]:
    """Each query of the page, and the output that it shows."""
    return [(query, output or "") for query, output in _QUERY.findall(page)]


def answers(asked: list[str]) -> list[str]:
    """What the queries print, on what the page's commands make with the embedded model."""
    with tempfile.TemporaryDirectory() as folder:
        for reduction in ("mean", "sum"):
            build(tables=folder, labels="mpcat40", combinations=str(HOUSE), reduction=reduction)
        tables = RoomTables.open(folder, "mpcat40", offline=True)
        for objects in (["toilet", "sofa"], ["bed", "sink"]):
            tables.classify(objects)
        evaluated = [
            (room.room_id, room.truth[0], tables.classify(room.objects).room)
            for room in read_room_lines(HOUSE)
        ]
        save_evaluation(tables.version, "house", evaluated)
        with connect(Path(folder), tables.version) as connection:
            return [_printed(*select(connection, query)) for query in asked]


def _printed(columns: list[str], rows: list[tuple[object, ...]]) -> str:
    records = [dict(zip(columns, row, strict=True)) for row in rows]
    return re.sub(r" +$", "", render(records, "table", columns), flags=re.MULTILINE)


def main() -> int:
    page = PAGE.read_text(encoding="utf-8")
    found = iter(answers([query for query, _ in queries(page)]))
    page = _QUERY.sub(lambda m: f"```sql\n{m[1]}\n```\n\n```text\n{next(found)}```\n", page)
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
