"""The report: one self-contained page about published tables, and rooms if there are any."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from roomtables.evaluation import Evaluation, evaluate
from roomtables.evaluation.judging import room_list
from roomtables.evaluation.statistics import area_under_risk, expected_calibration_error
from roomtables.online.classifier import RoomTables
from roomtables.online.decision import Decision
from roomtables.report import html
from roomtables.report.html import Bar
from roomtables.rooms import Room
from roomtables.storage.views import connect, select
from roomtables.wording import counts, percent

_SHOWN = 15
_SIGNATURES = 6
_PACKAGES = ("roomtables", "numpy", "duckdb", "pyarrow", "torch", "transformers")

Section = tuple[str, str, str]


def report(tables: RoomTables, rooms: Iterable[Room] | str | Path | None = None) -> str:
    """The page as HTML; with ``rooms`` also accuracy, confusion, coverage and calibration.

    Raises
    ------
    InputError
        A file of room lines is malformed, or no room is left to evaluate.
    MissingExtraError
        There are rooms, and matplotlib, which draws their calibration, is not installed.
    """
    connection = connect(tables.version.path.parents[1], tables.version)
    try:
        sections = [_about(tables), *_knowledge(tables, connection)]
    finally:
        connection.close()
    if rooms is not None:
        sections += _results(tables, room_list(rooms))
    return html.page(f"roomtables: {tables.version.manifest.labels}", sections)


def _about(tables: RoomTables) -> Section:
    manifest = tables.version.manifest
    decision, settings = tables.decision, manifest.settings
    combinations = ", ".join(f"{n:,} for {name}" for name, n in manifest.combinations.items())
    rows: list[tuple[str, object]] = [
        ("label space", manifest.labels),
        ("version", f"{tables.version.name}, published {manifest.created.isoformat()}"),
        ("objects, rooms, predicted rooms",
         f"{manifest.objects}, {manifest.rooms}, {manifest.predicted_rooms}"),
        ("scores from", manifest.scorer_id),
        ("query sentences from", manifest.query_scorer_id or "no model"),
        *((f"model: {key}", value) for key, value in sorted(manifest.model.items()) if value),
        ("sentence", " | ".join(settings.template)),
        ("scored, reduction, k", f"{settings.scored}, {settings.reduction}, {settings.k}"),
        ("combinations held", combinations or "none"),
        ("decision", _decision_text(decision)),
        *((f"installed: {name}", found) for name in _PACKAGES if (found := _installed(name))),
        ("python", platform.python_version()),
    ]  # fmt: skip
    return "about", "What this is", html.table(("", ""), rows)


def _decision_text(decision: Decision) -> str:
    return (
        f"rule {decision.rule}, source {decision.source}, "
        f"λ {decision.prior_weight:g}, γ {decision.evidence_power:g}"
    )


def _installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _knowledge(tables: RoomTables, connection: Any) -> list[Section]:
    """What the tables know: the heat map, the objects, the rooms; of the source in use."""
    source = tables.decision.source
    return [
        ("objects", "Which objects tell most", _objects(connection, source)),
        ("rooms", "What each room is recognised by", _signatures(connection, source)),
        ("map", "p(room | object)", _map(connection, source)),
    ]


def _objects(connection: Any, source: str) -> str:
    _, rows = select(
        connection,
        "select object, entropy_nats, room, p_room_given_object from informative_objects "
        f"where source = '{source}' order by rank",
    )
    cells = [(name, entropy, room, Bar(p)) for name, entropy, room, p in rows]
    head = ("object", "entropy (nats)", "speaks for", "p(room | object)")
    few = min(_SHOWN, len(cells))
    return (
        '<div class="columns"><div>'
        + html.paragraph(f"The {few} most informative of {len(cells)}:")
        + html.table(head, cells[:few])
        + "</div><div>"
        + html.paragraph(f"The {few} least informative:")
        + html.table(head, cells[::-1][:few])
        + "</div></div>"
    )


def _signatures(connection: Any, source: str) -> str:
    _, rows = select(
        connection,
        "select room, string_agg(object || ' ' || printf('%+.1f', lift_nats), ', ' order by rank) "
        f"from room_signatures where source = '{source}' and rank <= {_SIGNATURES} "
        "group by room order by room",
    )
    return html.paragraph(
        "The number is the lift in nats: how much likelier the object makes the room than the "
        "label space's objects do on average."
    ) + html.table(("room", "objects"), rows)


def _map(connection: Any, source: str) -> str:
    _, rows = select(
        connection,
        "select object, list(room order by room), list(p_room_given_object order by room), "
        "any_value(entropy_nats) from cooccurrence join entropy using (source, object) "
        f"where source = '{source}' group by object, rank order by rank",
    )
    columns: Sequence[str] = rows[0][1] if rows else ()
    return html.paragraph(
        "In percent, most informative object first; point at a cell, or tap it, for the exact "
        "number. After each object its entropy in nats."
    ) + html.heat_map(
        "object", columns, ((f"{name} {entropy:.2f}", shares) for name, _, shares, entropy in rows)
    )


def _results(tables: RoomTables, rooms: Sequence[Room]) -> list[Section]:
    from roomtables.report.plots import calibration_figure, rendered

    found = evaluate(rooms, tables)
    picture = rendered(calibration_figure([found]), "svg").decode()
    drawn = picture[picture.index("<svg") :]
    calibration = html.paragraph(
        f"Expected calibration error {expected_calibration_error(found.reliability()):.3f}; mean "
        f"risk over coverage {area_under_risk(found.risk_coverage()):.3f}. Left: how often an "
        "answer is right against how probable it was said to be. Right: the share wrong when only "
        "the surest rooms are answered."
    )
    return [
        ("accuracy", "Accuracy", _accuracy(found, tables.decision)),
        ("confusion", "Confusion", _confusion(found)),
        ("coverage", "Coverage", _coverage(found)),
        ("calibration", "Knowing when it does not know", calibration + drawn),
    ]


def _accuracy(found: Evaluation, decision: Decision) -> str:
    interval, baselines = found.statistics()["accuracy_interval"], found.baselines()
    headline = html.paragraph(
        f"{found.correct} of {found.rooms} rooms right: {percent(found.accuracy)} (95 % interval "
        f"{percent(interval['low'])} to {percent(interval['high'])}), "
        f"macro {percent(found.macro_accuracy)}, "
        f"right among the top 3 {percent(found.top_3_accuracy)}; always the most frequent room "
        f"{percent(baselines['majority'])}, a uniform guess {percent(baselines['uniform'])}. "
        f"Decided by {_decision_text(decision)}."
    )
    return headline + html.table(
        ("room", "rooms", "right", "accuracy", "no answer", "backed off"),
        (
            (
                room,
                row["rooms"],
                row["correct"],
                Bar(row["accuracy"]),
                row["unanswered"],
                row["backed_off"],
            )
            for room, row in found.per_room().items()
        ),
    )


def _coverage(found: Evaluation) -> str:
    return html.paragraph(
        f"Answered by: {counts(found.as_json()['answered_by'])}; backed off to rule pooled: "
        f"{found.backed_off}; unanswered, counted as wrong: {counts(found.unanswered)}; left out: "
        f"{counts(found.skipped)}. Names that no table knows: {_unknown(found)}."
    )


def _unknown(found: Evaluation) -> str:
    names = {name for judged in found.judged for name in judged.prediction.unknown_objects}
    some = ", ".join(sorted(names)[:_SHOWN])
    return f"{len(names)} ({some}{', …' if len(names) > _SHOWN else ''})" if names else "none"


def _confusion(found: Evaluation) -> str:
    cells = {(row["room"], row["predicted"] or "unanswered"): row["rooms"]
             for row in found.confusion()}  # fmt: skip
    truths = sorted({truth for truth, _ in cells})
    answers = sorted({answer for _, answer in cells})
    return html.paragraph(
        "True label down, answer across; rooms, coloured by share of the row."
    ) + (
        html.heat_map(
            "true label",
            answers,
            ((truth, [float(cells.get((truth, a), 0)) for a in answers]) for truth in truths),
            count=True,
        )
    )
