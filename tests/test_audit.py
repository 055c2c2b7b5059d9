"""The audit of installed packages, by the real pip-audit against a service of the tests' own."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytest.importorskip("pip_audit")

SCRIPT = Path(__file__).parent.parent / "scripts" / "audit.py"
FLAW = {
    "id": "MADE-UP-1",
    "affected": [
        {
            "package": {"name": "made-up", "ecosystem": "PyPI"},
            "versions": ["1.0"],
            "ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "1.1"}]}],
        }
    ],
}


def load_script():
    spec = importlib.util.spec_from_file_location("audit", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextlib.contextmanager
def service(answer):
    """A vulnerability service in the layout of osv.dev; without an answer it never gives one."""
    ended = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            if answer is None:
                ended.wait(30)
                return
            content = json.dumps(answer).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/v1/query"
    finally:
        ended.set()
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def audit(tmp_path):
    """Audits a directory of installed packages that holds one."""
    package = tmp_path / "site" / "made_up-1.0.dist-info"
    package.mkdir(parents=True)
    package.joinpath("METADATA").write_text("Metadata-Version: 2.1\nName: made-up\nVersion: 1.0\n")

    def run(address, *arguments):
        options = ["--path", tmp_path / "site", "--cache-dir", tmp_path / "cache"]
        options += ["-s", "osv", "--osv-url", address, *arguments]
        return subprocess.run(
            [sys.executable, SCRIPT, *options], capture_output=True, text=True, timeout=60
        )

    return run


def test_a_known_vulnerability_fails_and_is_named_with_the_remedy(audit):
    with service({"vulns": [FLAW]}) as address:
        done = audit(address)
        assert (done.returncode, done.stdout) == (1, "")
        assert "made-up 1.0 has MADE-UP-1, fixed in 1.1. Upgrade it, or list the id" in done.stderr
        assert audit(address, "--ignore-vuln", "MADE-UP-1").returncode == 0


def test_nothing_known_is_said(audit):
    with service({}) as address:
        done = audit(address)
    assert (done.returncode, done.stdout) == (
        0,
        "audit: no known vulnerability in 1 of 1 packages\n",
    )


def test_a_service_that_is_not_there_or_does_not_answer_is_skipped_with_one_line(audit):
    with service({}) as gone:
        pass
    started = time.monotonic()
    with service(None) as silent:
        for address in (gone, silent):
            done = audit(address, "--timeout", "1")
            assert (done.returncode, done.stderr) == (0, "")
            assert done.stdout.startswith("audit: skipped, the vulnerability service can't be")
            assert done.stdout.count("\n") == 1
    assert time.monotonic() - started < 50


def test_a_wrong_option_is_no_missing_service(audit):
    done = audit("http://127.0.0.1:9", "--no-such-option")
    assert done.returncode == 1
    assert "pip-audit failed" in done.stderr


def test_a_mirror_that_knows_no_package_is_no_clean_bill(capsys):
    package = {"name": "made-up", "skip_reason": "Dependency not found on PyPI"}
    assert load_script()._tell([package]) == 0
    assert capsys.readouterr().out == (
        "audit: skipped, the vulnerability service knows none of 1 packages\n"
    )


def test_the_list_of_ignored_ids_has_comments():
    assert load_script().ignored_ids("# why\nA-1  # reason\n\n B-2\n") == ["A-1", "B-2"]
