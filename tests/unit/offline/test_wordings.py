"""Tables of several templates that name the room first, scored behind the room by a real model."""

from __future__ import annotations

import numpy as np
import pytest

from roomtables import RoomTables, build
from roomtables.errors import ConfigError
from roomtables.offline.plan import plan
from support import small_space, write_space

FRAMES = ["Things found in {room}: {objects}.", "In {room} you see {objects}."]


def test_what_is_scored_and_the_templates_are_part_of_a_build(tmp_path) -> None:
    options = {
        "labels": str(write_space(tmp_path, small_space())),
        "tables": tmp_path / "t",
        "k": 2,
    }
    whole = build(**options, template=FRAMES)
    foreseen = plan(**options, template=FRAMES, scored="after_room", exact=True)
    assert "scored sentence → after_room" in {stage.why for stage in foreseen.stages}
    ends = build(**options, template=FRAMES, scored="after_room")
    assert ends.sentences_scored == whole.sentences_scored == foreseen.sentences_to_score
    assert not build(**options, template=FRAMES, scored="after_room").published
    assert build(**options, template=FRAMES).sentences_scored == 0


def test_the_model_asked_online_gives_what_a_build_writes(tmp_path) -> None:
    options = {"labels": str(write_space(tmp_path, small_space())), "k": 2}
    options |= {"template": FRAMES, "scored": "after_room"}
    build(**options, tables=tmp_path / "held")
    build(**options, tables=tmp_path / "none", combinations="none")
    held = RoomTables.open(tmp_path / "held", "small", offline=True).classify(["sink", "bed"])
    asked = RoomTables.open(tmp_path / "none", "small").classify(["sink", "bed"])
    assert (held.answered_by, asked.answered_by) == ("table", "lm")
    found, expected = (list(answer.probabilities.values()) for answer in (asked, held))
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("template", "says"),
    [
        (["A room with {objects} is {room}."], "names the room last"),
        (["In {room} {objects}."], "no word between"),
        ([FRAMES[0], FRAMES[0]], "comes? twice|there twice"),
    ],
)
def test_templates_that_do_not_fit_are_refused(tmp_path, template, says) -> None:
    with pytest.raises(ConfigError, match=says):
        build(tables=tmp_path / "t", template=template, scored="after_room")
    assert not (tmp_path / "t").exists()
