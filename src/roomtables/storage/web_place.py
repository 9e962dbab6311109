"""A place on a plain web server, which is only read: by Python's own client, from a byte on.

fsspec's asks a server that knows no ranges for the second megabyte in vain, and calls whatever
fails a missing file.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn
from urllib.parse import quote, unquote, urlsplit

from roomtables.errors import InputError, StoreError
from roomtables.storage.place import CHUNK, Patience, paced, shown, tried

if TYPE_CHECKING:
    from http.client import HTTPResponse

_KEPT = "/%:@!$&'()*+,;=~"  # in the path of a URL, besides letters and digits


class WebPlace:
    """Files below a URL of ``http://`` or ``https://``."""

    def __init__(self, url: str, patience: Patience) -> None:
        self._url, self._patience = shown(url), patience
        parts = urlsplit(url)
        try:
            known = bool(parts.hostname) and parts.port != 0
        except ValueError:  # no number
            known = False
        if not known:
            raise InputError(f"{self._url} names no server; a URL is like https://host/tables")
        netloc = parts.netloc.rpartition("@")[2]
        self._base = f"{parts.scheme.lower()}://{netloc}{quote(parts.path, _KEPT).rstrip('/')}"
        login = f"{unquote(parts.username or '')}:{unquote(parts.password or '')}"
        self._login = "" if login == ":" else base64.b64encode(login.encode()).decode()

    def read(self, name: str, start: int = 0) -> Iterator[bytes]:
        where, patience = f"{self._url}/{name}", self._patience
        response = tried(lambda: self._get(name, start), where, patience.seconds)
        if response is None:
            return
        with closing(response):
            skip = start if response.status == 200 else 0  # a server that knows no ranges
            sent = re.match(r"bytes (\d{1,18})-", response.headers.get("Content-Range") or "")
            if start and not skip and (sent is None or int(sent[1]) != start):
                raise StoreError(f"{where}: the server sends another part than was asked for")
            for chunk in paced(_chunks(response, where, patience.seconds), where, patience):
                yield chunk[skip:]
                skip = max(skip - len(chunk), 0)

    def _get(self, name: str, start: int) -> HTTPResponse | None:
        """The answer to a request for a file from a byte on; ``None`` where it ends before."""
        from urllib.error import HTTPError
        from urllib.request import Request, build_opener

        from roomtables.storage.web_redirects import SafeRedirects

        request = Request(f"{self._base}/{quote(name)}")
        request.add_header("Accept-Encoding", "identity")
        request.add_header("Cache-Control", "no-cache")
        if start:
            request.add_header("Range", f"bytes={start}-")
        if self._login:
            request.add_unredirected_header("Authorization", f"Basic {self._login}")
        try:
            response: HTTPResponse = build_opener(SafeRedirects).open(
                request, timeout=self._patience.seconds
            )
            return response
        except HTTPError as error:
            error.close()
            if error.code in {404, 410}:
                raise FileNotFoundError(name) from error
            if error.code == 416:
                return None
            raise

    def size(self, name: str) -> int | None:
        self._refuse()

    def write(self, name: str, source: Path | bytes) -> None:
        self._refuse()

    def names(self, folder: str) -> list[str]:
        self._refuse()

    def age(self, name: str) -> float:
        self._refuse()

    def remove(self, name: str) -> None:
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise StoreError(
            f"{self._url} is a web server, from which tables can only be pulled; for anything else "
            "name the folder that it serves, as file:///…"
        )


def _chunks(response: HTTPResponse, where: str, seconds: float) -> Iterator[bytes]:
    """The content of an answer, as it comes.

    Raises
    ------
    StoreError
        It ends before its length, or nothing comes for so many seconds.
    """
    left = -1 if response.length is None else response.length
    while chunk := tried(lambda: response.read1(CHUNK), where, seconds, 1):
        left -= len(chunk)
        yield chunk
    if left > 0:
        raise StoreError(f"{where} is cut: {left:,} bytes are missing; try again later")
