"""The mapped lookup is bit for bit what the tables hold, and a wrong file is never read."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roomtables import RoomTables, build
from roomtables.errors import StoreError
from roomtables.labels import LabelSpace
from roomtables.offline.combinations import all_combinations
from roomtables.online.ranks import ABSENT, ScoreRows
from roomtables.storage import lookup
from roomtables.storage.lookup import Lookup, SourceArrays, pack_keys
from roomtables.storage.lookup_writer import LookupSettings, ScoreChunks, write_lookup
from roomtables.storage.manifest import Manifest
from roomtables.storage.versions import SpaceFolder
from support import HashScorer, made_manifest, small_space, write_space

SETTINGS = LookupSettings(3, ("{objects} {room}",), "sentence", "sum", "proxy", "query", 0.5, 3.0)


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of two label spaces of one shape, and two versions of the first."""
    root = tmp_path_factory.mktemp("lookup")
    counts = root / "counts.csv"
    counts.write_text("object,room,count\nbed,bedroom,3\nsink,kitchen,2\n", encoding="utf-8")
    for name in ("small", "other"):
        labels = str(write_space(root / "labels", small_space(name)))
        build(tables=root / "tables", scorer=HashScorer(), labels=labels, counts=counts)
    labels = str(root / "labels" / "small")
    build(tables=root / "tables", scorer=HashScorer("b@2"), labels=labels, counts=counts)
    return root / "tables"


@pytest.fixture
def tables(published: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(published, tmp_path / "tables"))


def current(tables: Path, labels: str = "small") -> Path:
    return SpaceFolder(tables, labels).current().path


def test_scores_are_bit_for_bit_those_of_the_table(published: Path) -> None:
    opened = RoomTables.open(published, "small").lookup
    table = pq.read_table(current(published) / "query_scores.parquet").to_pylist()
    for source, arrays in opened.sources.items():
        rows = [row for row in table if row["source"] == source]
        np.testing.assert_array_equal(arrays.keys, np.array([r["key"] for r in rows], np.uint64))
        rooms = [room.label for room in opened.rooms if room.predicted]
        expected = np.array([[r[room] for room in rooms] for r in rows], np.float32)
        np.testing.assert_array_equal(
            np.asarray(arrays.scores).view(np.uint32), expected.view(np.uint32)
        )


def swap(*names: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        contents = [(folder / name).read_bytes() for name in names]
        for name, content in zip(names, reversed(contents), strict=True):
            (folder / name).write_bytes(content)

    return change


def cut(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-1])


def from_version_before(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        before = min(folder.parent.parent.glob("0*"))
        shutil.copy(before / "lookup" / name, folder / name)

    return change


def whole_lookup_of_the_version_before(folder: Path) -> None:
    before = min(folder.parent.parent.glob("0*"))
    shutil.rmtree(folder)
    shutil.copytree(before / "lookup", folder)


def whole_version_of_another_label_space(folder: Path) -> None:
    other = current(folder.parents[2], "other")
    shutil.rmtree(folder.parent)
    shutil.copytree(other, folder.parent)


def manifest_of_another_label_space(folder: Path) -> None:
    shutil.copy(current(folder.parents[2], "other") / "manifest.json", folder.parent)


def other_settings_in_the_manifest(folder: Path) -> None:
    path = folder.parent / "manifest.json"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"rule": "query"', '"rule": "pooled"'), encoding="utf-8")


def edited_index(folder: Path) -> None:
    text = (folder / "lookup.json").read_text(encoding="utf-8")
    (folder / "lookup.json").write_text(text.replace("bathroom", "bedrooms"), encoding="utf-8")


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize(
    "damage",
    [
        cut("proxy.scores.npy"), cut("proxy.keys.npy"), cut("lookup.json"),
        cut("proxy.entropy.npy"), swap("proxy.scores.npy", "ground_truth.scores.npy"),
        swap("proxy.ranks.npy", "ground_truth.ranks.npy"),
        swap("proxy.entropy.npy", "ground_truth.entropy.npy"),
        from_version_before("proxy.scores.npy"), from_version_before("lookup.json"),
        from_version_before("proxy.room_logits.npy"), whole_lookup_of_the_version_before,
        whole_version_of_another_label_space, manifest_of_another_label_space,
        other_settings_in_the_manifest, edited_index,
        lambda folder: (folder / "proxy.keys.npy").unlink(),
        lambda folder: (folder / "proxy.scores.npy").write_bytes(b""),
        shutil.rmtree,
    ],
)  # fmt: skip
def test_a_wrong_file_is_an_error_and_never_a_wrong_label(
    tables: Path, damage: Callable[[Path], None], sampled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sampled:  # as large files are
        monkeypatch.setattr(lookup, "SMALL_BYTES", 0)
    damage(current(tables) / "lookup")
    with pytest.raises(StoreError, match="run `roomtables build") as caught:
        RoomTables.open(tables, "small")
    assert "\n" not in str(caught.value)


def test_files_that_are_sampled_answer_as_those_read_whole(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = RoomTables.open(published, "small").lookup.sources["proxy"]
    monkeypatch.setattr(lookup, "SMALL_BYTES", 0)
    mapped = RoomTables.open(published, "small", verify=True).lookup.sources["proxy"]
    for name in ("entropy", "ranks", "room_logits", "bias", "keys", "scores"):
        np.testing.assert_array_equal(getattr(mapped, name), getattr(whole, name))
    assert not mapped.scores.flags.writeable


def test_a_flipped_bit_anywhere_is_found_when_asked_to_verify(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lookup, "SMALL_BYTES", 0)
    monkeypatch.setattr(lookup, "_PAGE", 1)
    about = write(tmp_path / "lookup", np.zeros((40, 3), np.float32))
    path = tmp_path / "lookup" / "proxy.scores.npy"
    content = bytearray(path.read_bytes())
    found = 0
    for place in range(128, len(content), 7):
        content[place] ^= 1
        path.write_bytes(content)
        with pytest.raises(StoreError, match="not the file"):
            Lookup.open(tmp_path / "lookup", about, verify=True)
        try:
            Lookup.open(tmp_path / "lookup", about)
        except StoreError:
            found += 1
        content[place] ^= 1
    assert 0 < found < len(range(128, len(content), 7))


def test_a_version_removed_while_open_answers_on(tables: Path) -> None:
    opened = RoomTables.open(tables, "small", offline=True)
    before = opened.classify(["sink", "bed"]).as_json()
    shutil.rmtree(tables)
    assert opened.classify(["bed", "sink"]).as_json() == before


def test_a_mapped_version_removed_while_open_answers_on(
    tables: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lookup, "SMALL_BYTES", 0)
    test_a_version_removed_while_open_answers_on(tables)


def small_arrays(labels: LabelSpace) -> dict[str, np.ndarray]:
    objects = len(labels.objects)
    return {
        "entropy": np.arange(objects, dtype=float),
        "ranks": np.arange(1, objects + 1),
        "room_logits": np.zeros((objects, len(labels.rooms))),
        "bias": np.zeros(len(labels.predicted_rooms)),
    }


def write(folder: Path, scores: np.ndarray, keys: np.ndarray | None = None) -> Manifest:
    """A lookup folder, and a manifest that lists its files."""
    labels = small_space()
    keys = np.arange(1, len(scores) + 1, dtype=np.uint64) if keys is None else keys

    def chunks() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for start in range(0, len(scores), 7):
            yield keys[start : start + 7], scores[start : start + 7]

    source = (small_arrays(labels), ScoreChunks(40, 3, chunks()))
    write_lookup(folder, labels, SETTINGS, {"proxy": source})
    return made_manifest(folder.parent)


@pytest.mark.parametrize("order", [[5, 4], [12, 13], [0, 39]])
def test_keys_out_of_order_are_refused(tmp_path: Path, order: list[int]) -> None:
    keys = np.arange(1, 41, dtype=np.uint64)
    keys[order] = keys[order[::-1]]
    with pytest.raises(StoreError, match="not sorted"):
        write(tmp_path / "lookup", np.zeros((40, 3), np.float32), keys)


def test_rows_that_are_missing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="hold 39 rows, not 40"):
        write(tmp_path / "lookup", np.zeros((39, 3), np.float32))


def test_a_lookup_that_was_not_finished_has_no_index(tmp_path: Path) -> None:
    def interrupted() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        yield np.array([1], np.uint64), np.zeros((1, 3), np.float32)
        raise KeyboardInterrupt

    source = (small_arrays(small_space()), ScoreChunks(2, 3, interrupted()))
    with pytest.raises(KeyboardInterrupt):
        write_lookup(tmp_path / "lookup", small_space(), SETTINGS, {"proxy": source})
    assert not (tmp_path / "lookup" / "lookup.json").exists()


@given(objects=st.integers(1, 9), k=st.integers(1, 4), data=st.data())
def test_rows_are_found_in_full_and_in_sparse_tables(
    objects: int, k: int, data: st.DataObject
) -> None:
    ranks = all_combinations(objects, k)
    every = ranks[np.argsort(pack_keys(ranks, k))]
    held = np.array(data.draw(st.lists(st.booleans(), min_size=len(every), max_size=len(every))))
    for kept in (np.ones(len(every), bool), held):
        keys = pack_keys(every[kept], k)
        scores = np.arange(len(keys), dtype=np.float32)[:, np.newaxis]
        empty = np.zeros(0)
        arrays = SourceArrays(empty, np.zeros(objects, np.int32), empty, empty, keys, scores)
        rows = ScoreRows(arrays, k, None)
        expected = np.where(kept, np.cumsum(kept) - 1, ABSENT)
        np.testing.assert_array_equal(rows.find_many(every), expected)
        found = [rows.find([rank for rank in row if rank]) for row in every.tolist()]
        assert found == expected.tolist()


def test_ranks_near_the_key_limit_are_found() -> None:
    """A search that turned 64-bit keys into floats would miss these."""
    top = (1 << 21) - 1
    ranks = np.array(
        [[top - 3, top - 2, top - 1], [top - 3, top - 2, top], [top - 2, top - 1, top]]
    )
    keys = pack_keys(ranks, 3)
    scores = np.zeros((3, 1), np.float32)
    arrays = SourceArrays(
        np.zeros(0), np.zeros(top, np.int32), np.zeros(0), np.zeros(0), keys, scores
    )
    rows = ScoreRows(arrays, 3, None)
    assert [rows.find(row) for row in ranks.tolist()] == [0, 1, 2]
    assert rows.find([top - 3, top - 1, top]) == ABSENT
    assert rows.find_many(ranks).tolist() == [0, 1, 2]
