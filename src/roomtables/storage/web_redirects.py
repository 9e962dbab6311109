"""Redirects of a web server that are followed: none from ``https://`` to what is less safe."""

from __future__ import annotations

from http.client import HTTPMessage
from typing import IO
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request

from roomtables.errors import StoreError
from roomtables.storage.place import shown


class SafeRedirects(HTTPRedirectHandler):
    """To ``https://``, and from ``http://`` to ``http://``."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> Request | None:
        if urlsplit(newurl).scheme not in {"https", req.type}:
            raise StoreError(
                f"{shown(req.full_url)} redirects to another protocol than {req.type}://"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)
