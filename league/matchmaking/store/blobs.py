"""Files kept by the hash of their content: in the database, a directory or a bucket.

A blob is written once and never changed. It is hashed again when it is read, so a damaged or
swapped file is noticed.
"""

from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

import sqlalchemy as sa

from league.atomic_file import replacing
from league.errors import StoreError, explaining
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store.schema import Change, Transactional, blobs

MAX_BYTES = 64 * 1024 * 1024  # largest blob [bytes]


def _checked(content: bytes) -> bytes:
    if len(content) > MAX_BYTES:
        raise StoreError(
            f"a file of {len(content):,} bytes was given: at most {MAX_BYTES:,} are kept, "
            "make it smaller"
        )
    return content


def _verified(content: bytes | None, digest: str, where: str) -> bytes:
    if content is None:
        raise StoreError(
            f"{where} holds no file {digest[:12]}: restore it from a backup, or submit it again"
        )
    if heat_spec.digest(content) != digest:
        raise StoreError(
            f"the file {digest[:12]} in {where} is damaged (its hash differs): "
            "restore it from a backup, or submit it again"
        )
    return content


def insert_blob(change: Change, content: bytes) -> str:
    """Keep some bytes in the database and return their SHA-256."""
    digest = heat_spec.digest(_checked(content))
    row = {"digest": digest, "size": len(content), "created_s": change.now, "content": content}
    change.insert_new(blobs, row)
    return digest


class TableBlobs(Transactional):
    """Blobs in the league's own database, which transactions put there with `insert_blob`."""

    def get(self, digest: str) -> bytes:
        """Return the bytes with this SHA-256."""
        with self._database.reading() as connection:
            content = connection.scalar(sa.select(blobs.c.content).where(blobs.c.digest == digest))
        return _verified(content, digest, self._database.shown)


class FolderBlobs:
    """Blobs in a directory, or in a bucket that fsspec can reach (s3://, gs://, memory://)."""

    def __init__(self, url: str) -> None:
        """Choose the place; it is made by `check`, or when the first blob comes."""
        import fsspec

        try:
            self._files, self._root = fsspec.url_to_fs(url)
        except (ValueError, ImportError, OSError) as refusal:
            raise StoreError(
                f"the place for files {url!r} cannot be used ({refusal}): "
                "give a directory, or install the fsspec package for that kind of bucket"
            ) from refusal
        self._url = url

    def check(self) -> None:
        """Make the directory, if it is no bucket; StoreError if it cannot be made or written."""
        if "file" not in self._files.protocol:
            return
        failure = f"the place for files {self._url!r} cannot be used"
        with explaining(failure, StoreError, "give a directory that can be written"):
            Path(self._root).mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=self._root):
                pass

    def put(self, content: bytes) -> str:
        """Keep some bytes and return their SHA-256."""
        digest = heat_spec.digest(_checked(content))
        path = self._path(digest)
        with suppress(OSError):  # writing says what is wrong
            if self._files.isfile(path):
                return digest
        if "file" in self._files.protocol:
            with replacing(path, f"the file {digest[:12]}", StoreError) as file:
                file.write_bytes(content)
            return digest
        failure = f"the file {digest[:12]} cannot be kept in {self._url}"
        remedy = "give a place that can be written and has free space"
        with explaining(failure, StoreError, remedy, ValueError):
            self._files.pipe_file(path, content)  # a bucket shows an object whole or not at all
        return digest

    def get(self, digest: str) -> bytes:
        """Return the bytes with this SHA-256."""
        content = None
        failure = f"the file {digest[:12]} cannot be read from {self._url}"
        remedy = "check that the place can be reached"
        with explaining(failure, StoreError, remedy), suppress(FileNotFoundError):
            content = self._files.cat_file(self._path(digest))
        return _verified(content, digest, self._url)

    def _path(self, digest: str) -> str:
        if len(digest) != 64 or not set(digest) <= set("0123456789abcdef"):
            raise StoreError(f"{digest[:70]!r} names no file: give 64 hexadecimal digits")
        return f"{self._root}/{digest[:2]}/{digest}"
