"""Pictures of names from anywhere: they are drawn, and every SVG is well-formed."""

from xml.etree import ElementTree

import pytest

from roomtables.report.floor_plan import draw
from roomtables.report.text import drawn
from roomtables.scenes.scene import Box, Scene, SceneObject, SceneRoom

pytest.importorskip("matplotlib")
HOSTILE = [
    "\x1b]0;x\x07", "\x00", "\x9b2J", "\u202eabc", "\ufffe", "\udcff", "$\\frac$", "a$b$c",
    "</text><script>alert(1)</script>", "]]>",
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:Glyph")
@pytest.mark.parametrize("suffix", [".svg", ".html", ".png"])
def test_names_from_anywhere_are_drawn(tmp_path, suffix):
    rooms = [
        SceneRoom(f"R{name}", (SceneObject("O", name, (0.0, 0.0, 0.0)),), truth=(name,),
                  box=Box((4.0 * number, 0.0, 0.0), (4.0 * number + 3, 4.0, 3.0)))
        for number, name in enumerate(HOSTILE)
    ]  # fmt: skip
    path = tmp_path / f"plan{suffix}"
    # A title is made safe alike for all formats.
    for name in HOSTILE if suffix == ".svg" else HOSTILE[-2:]:
        draw(Scene(name, rooms), {room.room_id: (room.truth[0], 0.5) for room in rooms}, path)
    if suffix == ".png":
        assert path.read_bytes().startswith(b"\x89PNG")
        return
    text = path.read_text(encoding="utf-8")
    picture = text[text.index("<svg") : text.index("</svg>") + 6]
    tags = {element.tag.rpartition("}")[2] for element in ElementTree.fromstring(picture).iter()}
    assert "text" in tags
    assert "script" not in tags
    assert "<script>" not in text
    assert "a$b$c" in picture  # no mathematics


def test_what_can_be_drawn_stays():
    assert drawn("Küche\n寝室") == "Küche\n寝室"
    assert drawn("\x1b[31mred\u202e") == "�[31mred�"
