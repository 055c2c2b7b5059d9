"""Looks for known vulnerabilities in the packages that are installed, with pip-audit.

``make lint`` runs it. The exit status is 1 if a vulnerability is known that is not listed in
scripts/audit-ignore.txt. Where the service that knows them can't be reached, one line says so and
the exit status is 0. Arguments are handed to pip-audit, such as ``-s osv`` for another service.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

IGNORED = Path(__file__).with_name("audit-ignore.txt")

SECONDS_PER_REQUEST = 10
SECONDS = 180

# requests' exceptions, which pip-audit lets through, and its own words for some of them.
_UNREACHABLE = re.compile(
    r"(ConnectionError|ProxyError|Timeout|SSLError|Could not connect|not redirecting|ServiceError)"
)


def main(arguments: Sequence[str]) -> int:
    """Audits, prints what was found and returns the exit status."""
    ignored = ignored_ids(IGNORED.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        command = [
            *(sys.executable, "-m", "pip_audit", "--format", "json", "--output", str(report)),
            *("--skip-editable", "--progress-spinner", "off"),
            *("--timeout", str(SECONDS_PER_REQUEST)),
            *(part for name in ignored for part in ("--ignore-vuln", name)),
            *arguments,
        ]
        said = _run(command)
        if report.is_file():
            return _tell(json.loads(report.read_text(encoding="utf-8"))["dependencies"])
    reason = said.strip().splitlines()[-1] if said.strip() else f"no answer within {SECONDS} s"
    if said.strip() and not _UNREACHABLE.search(said):
        print(f"audit: pip-audit failed: {reason}", file=sys.stderr)
        return 1
    print(f"audit: skipped, the vulnerability service can't be reached ({reason[:160]})")
    return 0


def ignored_ids(text: str) -> list[str]:
    """The ids of a list with one a line and, behind a #, why it does no harm here."""
    return [name for line in text.splitlines() if (name := line.partition("#")[0].strip())]


def _run(command: Sequence[str]) -> str:
    """What the command says on standard error; nothing where its time is over."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # With the processes that it starts, so that none of them is left behind.
        start_new_session=True,
    )
    try:
        return process.communicate(timeout=SECONDS)[1]
    except subprocess.TimeoutExpired:
        return ""
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def _tell(packages: Sequence[dict[str, Any]]) -> int:
    known = [package for package in packages if "skip_reason" not in package]
    if packages and not known:
        # A mirror of the index may answer, but have none of the service's pages.
        print(f"audit: skipped, the vulnerability service knows none of {len(packages)} packages")
        return 0
    found = [(package, flaw) for package in known for flaw in package["vulns"]]
    for package, flaw in found:
        fixed = ", ".join(flaw["fix_versions"]) or "no version yet"
        print(
            f"audit: {package['name']} {package['version']} has {flaw['id']}, fixed in {fixed}. "
            f"Upgrade it, or list the id in scripts/{IGNORED.name} with the reason.",
            file=sys.stderr,
        )
    if not found:
        print(f"audit: no known vulnerability in {len(known)} of {len(packages)} packages")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
