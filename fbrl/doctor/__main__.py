"""The process in which one check runs: ``python -m fbrl.doctor NAME``."""

from __future__ import annotations

import json
import os
import sys

from fbrl.doctor import CHECKS, RESULT_MARKER, Check, CheckError


def _answer(check: Check) -> dict[str, str]:
    try:
        return {"status": "ok", "detail": check.function(), "remedy": ""}
    except CheckError as error:
        return {"status": error.status, "detail": error.detail, "remedy": error.remedy}
    except Exception as error:
        # What an error was raised from names the missing thing; its own words say what to do.
        cause = error.__cause__ or error
        detail = f"{type(cause).__name__}: {' '.join(str(cause).split())}"
        return {"status": "fail", "detail": detail, "remedy": check.remedy}


if __name__ == "__main__":
    _check = next(check for check in CHECKS if check.name == sys.argv[1])
    print(f"\n{RESULT_MARKER}{json.dumps(_answer(_check))}", flush=True)
    # Some graphics drivers crash while the process is taken down, after the answer.
    os._exit(0)
