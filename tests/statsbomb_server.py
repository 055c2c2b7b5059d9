"""A local server of files in the layout of StatsBomb's open data, with faults to order."""

from __future__ import annotations

import threading
import time
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

FILES = Path(__file__).parent / "data" / "open-data"


class StatsBombServer:
    """Serves the made-up files.

    Attributes:
        requests: how often each path was asked for.
        faults: what the next answers to a path are: a status, "truncated", "empty", "slow" or
            "dropped".
        most_at_once: the largest number of requests that were being answered at one time.
    """

    def __init__(self) -> None:
        self.requests: Counter[str] = Counter()
        self.faults: dict[str, list[int | str]] = {}
        self.most_at_once = 0
        self._at_once = 0
        self._lock = threading.Lock()
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # its base class's name
                server._answer(self)

            def log_message(self, *arguments: object) -> None:
                pass

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._http.server_port}"
        threading.Thread(target=self._http.serve_forever, args=(0.01,), daemon=True).start()

    def close(self) -> None:
        self._http.shutdown()
        self._http.server_close()

    def _answer(self, handler: BaseHTTPRequestHandler) -> None:
        path = handler.path.lstrip("/")
        with self._lock:
            self.requests[path] += 1
            self._at_once += 1
            self.most_at_once = max(self.most_at_once, self._at_once)
            faults = self.faults.get(path)
            fault = faults.pop(0) if faults else None
        try:
            self._send(handler, path, fault)
        except (BrokenPipeError, ConnectionResetError):
            pass  # the client has given up, as it should
        finally:
            with self._lock:
                self._at_once -= 1

    def _send(self, handler: BaseHTTPRequestHandler, path: str, fault: int | str | None) -> None:
        file = FILES / path
        time.sleep(0.02)
        if fault == "slow":
            time.sleep(1.0)
        if fault == "dropped":
            handler.connection.close()
            return
        if isinstance(fault, int) or not file.is_file():
            handler.send_error(fault if isinstance(fault, int) else 404)
            return
        body = file.read_bytes()
        if fault == "truncated":
            body = body[: len(body) // 2]
        if fault == "empty":
            body = b"[]"
        handler.send_response(200)
        handler.send_header("Content-Length", str(len(body)))
        handler.end_headers()
        handler.wfile.write(body)
