"""Large Parquet files are told from others by their sizes and by pages sampled throughout."""

import json

import pytest

from roomtables.errors import StoreError
from roomtables.storage.samples import SAMPLES, check_parquet, write_samples
from roomtables.storage.versions import MANIFEST, Version
from support import made_manifest

LARGE = 3 << 20


@pytest.fixture
def version(tmp_path):
    folder = tmp_path / "000001-0123abcd"
    folder.mkdir()
    content = bytes(range(256)) * (LARGE // 256)
    (folder / "scores.parquet").write_bytes(content)
    (folder / "small.parquet").write_bytes(b"PAR1 small")
    write_samples(folder)
    (folder / MANIFEST).write_bytes(made_manifest(folder).to_bytes())
    return Version.open(folder)


def flip(path, place):
    with path.open("r+b") as file:
        file.seek(place)
        value = file.read(1)
        file.seek(place)
        file.write(bytes([value[0] ^ 1]))


def test_what_is_as_written_passes(version):
    check_parquet(version)
    check_parquet(version, verify=True)


@pytest.mark.parametrize("place", [0, LARGE - 1])
def test_a_change_in_a_sampled_page_is_found(version, place):
    flip(version.path / "scores.parquet", place)
    with pytest.raises(StoreError, match=r"scores\.parquet is damaged"):
        check_parquet(version)


def test_a_change_between_the_samples_is_found_where_all_is_read(version):
    flip(version.path / "scores.parquet", 6000)
    check_parquet(version)
    with pytest.raises(StoreError, match=r"scores\.parquet is damaged"):
        check_parquet(version, verify=True)


def test_where_the_samples_are_damaged_all_is_read(version):
    path = version.path / SAMPLES
    samples = json.loads(path.read_text())
    samples["scores.parquet"]["sample_sha256"] = "0" * 64
    path.write_text(json.dumps(samples))
    check_parquet(version)
    flip(version.path / "scores.parquet", 6000)
    with pytest.raises(StoreError, match=r"scores\.parquet is damaged"):
        check_parquet(version)


@pytest.mark.parametrize("name", ["scores.parquet", "small.parquet"])
def test_a_file_that_is_cut_or_gone_is_found(version, name):
    path = version.path / name
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(StoreError, match="is damaged"):
        check_parquet(version)
    path.unlink()
    with pytest.raises(StoreError, match="is damaged"):
        check_parquet(version)
