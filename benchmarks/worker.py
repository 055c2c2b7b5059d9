"""One measurement in a fresh process: reads what to measure, writes what came out.

``python -m benchmarks.worker RESULT`` reads JSON with ``function``, ``arguments`` and
``single_core`` from its standard input and writes the function's figures as JSON to the file.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path


def main() -> None:
    """Measures and writes the figures."""
    request = json.load(sys.stdin)
    if request["single_core"]:
        # Before NumPy and PyTorch count the cores that they may use.
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    module, name = request["function"].split(":")
    figures = getattr(importlib.import_module(module), name)(**request["arguments"])
    Path(sys.argv[1]).write_text(json.dumps(figures), encoding="utf-8")


if __name__ == "__main__":
    main()
