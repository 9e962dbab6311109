"""A web server on loopback that serves a folder, and misbehaves where a test asks for it."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

DRIP_SECONDS = 0.02


@dataclass
class WebServer:
    """What is served, and how.

    Attributes
    ----------
    url : of the folder
    ranges : whether it sends a file from a byte on
    faults : what it does instead of serving what a path contains; a method of the handler's
    asked : the paths that were asked for, each with the ``Range`` or an empty text
    sent : bytes of content, of all answers
    ended : set when it stops, so that what stalls ends
    """

    root: Path
    url: str = ""
    ranges: bool = True
    faults: dict[str, Callable[[Handler, bytes], None]] = field(default_factory=dict)
    asked: list[tuple[str, str]] = field(default_factory=list)
    sent: int = 0
    ended: threading.Event = field(default_factory=threading.Event)


class Handler(BaseHTTPRequestHandler):
    """Answers GET."""

    served: WebServer

    def do_GET(self) -> None:
        self.served.asked.append((self.path, self.headers.get("Range", "")))
        path = self.served.root / self.path.lstrip("/")
        if not path.is_file():
            self.send_error(404)
            return
        content = path.read_bytes()
        with suppress(ConnectionError):
            for part, fault in self.served.faults.items():
                if part in self.path:
                    fault(self, content)
                    return
            self.serve(content)

    def serve(self, content: bytes, most: int | None = None) -> None:
        """A file, or what is asked of it; of the body so many bytes at most."""
        start = 0
        found = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range", ""))
        if found and self.served.ranges:
            start = int(found[1])
            if start >= len(content):
                self.send_error(416)
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
        else:
            self.send_response(200)
        self.head(len(content) - start)
        self.body(content[start:][:most])

    def head(self, length: int) -> None:
        self.send_header("Content-Length", str(length))
        self.end_headers()

    def body(self, content: bytes) -> None:
        self.wfile.write(content)
        self.served.sent += len(content)

    def cut(self, content: bytes) -> None:
        self.serve(content, len(content) // 3)

    def stall(self, content: bytes) -> None:
        self.serve(content, len(content) // 3)
        self.served.ended.wait()

    def stall_at_once(self, content: bytes) -> None:
        self.served.ended.wait()

    def drip(self, content: bytes) -> None:
        self.send_response(200)
        self.head(len(content))
        self._drip(content)

    def drip_in_the_head(self, content: bytes) -> None:
        self._drip(b"HTTP/1.1 200 OK\r\nX-Long: " + b"x" * 60_000)

    def _drip(self, content: bytes) -> None:
        for byte in content:
            self.wfile.write(bytes([byte]))
            if self.served.ended.wait(DRIP_SECONDS):
                return

    def fail(self, content: bytes) -> None:
        self.send_error(500)

    def miss(self, content: bytes) -> None:
        self.send_error(404)

    def forbid(self, content: bytes) -> None:
        self.send_error(403)

    def shorten(self, content: bytes) -> None:
        self.serve(content[:-2])

    def swap(self, content: bytes) -> None:
        self.serve(content[::-1])

    def send_other_part(self, content: bytes) -> None:
        self.send_response(206)
        self.send_header("Content-Range", f"bytes 1-{len(content) - 1}/{len(content)}")
        self.head(len(content) - 1)
        self.body(content[1:])

    def tell_no_length(self, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", "many")
        self.send_header("Content-Range", f"bytes {'9' * 5000}-")
        self.end_headers()
        self.body(content[:-2])

    def speak_no_http(self, content: bytes) -> None:
        self.wfile.write(b"\x00\xff" * 500)

    def redirect_elsewhere(self, content: bytes) -> None:
        self.send_response(302)
        self.send_header("Location", "ftp://127.0.0.1/tables")
        self.head(0)

    def log_message(self, *args: object) -> None:
        """Nothing."""


@contextmanager
def serving(root: Path) -> Iterator[WebServer]:
    """A server of a folder, while the block runs."""
    served = WebServer(root)
    handler = type("Serving", (Handler,), {"served": served})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    served.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield served
    finally:
        served.ended.set()
        server.shutdown()
        server.server_close()
        thread.join()
