"""Files kept by the hash of their content: in a folder, in memory's bucket, in the database."""

from __future__ import annotations

import os

import pytest
from fsspec.implementations.memory import MemoryFileSystem

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import blobs, store
from league.matchmaking.store.blobs import FolderBlobs
from tests.matchmaking import leagues


class Table:
    """The table of files of a league."""

    def __init__(self, league):
        self.league, self.get = league, league.blobs.get

    def put(self, content):
        with self.league._writing() as change:
            return blobs.insert_blob(change, content)


@pytest.fixture(params=["folder", "bucket", "table"])
def kept(request, tmp_path):
    if request.param == "folder":
        yield FolderBlobs(str(tmp_path / "files"))
    elif request.param == "bucket":
        yield FolderBlobs(f"memory://{tmp_path.name}")
    else:
        with leagues.founded(str(tmp_path / "league.db"), entries=0) as league:
            yield Table(league)


def test_bytes_come_back_by_their_hash(kept):
    digest = kept.put(b"weights")
    assert digest == heat_spec.digest(b"weights")
    assert kept.put(b"weights") == digest
    assert kept.get(digest) == b"weights"


def test_bytes_that_are_not_kept_are_missed(kept):
    with pytest.raises(StoreError, match="holds no file 000000000000: restore it"):
        kept.get("0" * 64)


def test_too_many_bytes_are_refused(kept, monkeypatch):
    monkeypatch.setattr(blobs, "MAX_BYTES", 10)
    with pytest.raises(StoreError, match="a file of 11 bytes was given: at most 10"):
        kept.put(b"x" * 11)


def test_a_damaged_file_is_found_out(tmp_path):
    kept = FolderBlobs(str(tmp_path))
    digest = kept.put(b"weights")
    (tmp_path / digest[:2] / digest).write_bytes(b"weight5")
    with pytest.raises(StoreError, match=f"the file {digest[:12]} in .* is damaged"):
        kept.get(digest)


@pytest.mark.parametrize("name", ["../../etc/passwd", "", "G" * 64, "a" * 63])
def test_a_name_that_is_no_hash_leads_nowhere(tmp_path, name):
    with pytest.raises(StoreError, match="give 64 hexadecimal digits"):
        FolderBlobs(str(tmp_path)).get(name)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(StoreError, match="give a place that can be written"):
        FolderBlobs(str(tmp_path / "taken")).put(b"weights")
    assert os.listdir(tmp_path) == ["taken"]


def test_a_file_that_cannot_be_read_is_refused_with_the_systems_reason(tmp_path):
    kept = FolderBlobs(str(tmp_path))
    digest = heat_spec.digest(b"weights")
    (tmp_path / digest[:2] / digest).mkdir(parents=True)
    with pytest.raises(StoreError, match=r"cannot be read from .* \(Is a directory\): check that"):
        kept.get(digest)


def test_a_bucket_that_cannot_be_reached_is_named(monkeypatch):
    def unreachable(*_: object) -> None:
        raise OSError(113, "No route to host")

    kept = FolderBlobs("memory://far")
    for name in ("isfile", "pipe_file", "cat_file"):
        monkeypatch.setattr(MemoryFileSystem, name, unreachable)
    with pytest.raises(StoreError, match=r"be kept in memory://far \(No route to host\)"):
        kept.put(b"weights")
    with pytest.raises(StoreError, match=r"be read from memory://far \(No route to host\)"):
        kept.get("0" * 64)


def test_a_directory_that_cannot_be_made_is_refused_before_there_is_a_league(tmp_path):
    (tmp_path / "a").write_text("a file")
    url, folder = f"sqlite:///{tmp_path}/league.db", tmp_path / "a" / "files"
    with pytest.raises(StoreError, match=r"files' cannot be used .*: give a directory that can be"):
        store.create(url, blobs=str(folder)).close()
    assert not (tmp_path / "league.db").exists()


def test_an_unknown_kind_of_bucket_is_refused():
    with pytest.raises(StoreError, match="cannot be used"):
        FolderBlobs("nosuch://bucket")
