"""The doctor finds a working installation whole and names what is wrong with a broken one."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import needs_engine

from fbrl import doctor
from fbrl.cli.doctor import main
from fbrl.doctor import (
    CHECKS,
    RENDERING,
    Check,
    CheckError,
    CheckResult,
    check_engine,
    check_packages,
    check_rendering,
    run_check,
)

CHECK = {check.name: check for check in CHECKS}
COMMAND = [sys.executable, "-c", "import sys; from fbrl.cli.doctor import main; sys.exit(main())"]


def shadow_engine(directory: Path, source: str) -> str:
    """Puts a module of the engine's name before the real one; returns its PYTHONPATH."""
    package = directory / "fbrl_engine"
    package.mkdir()
    (package / "__init__.py").write_text(source)
    return str(directory)


@needs_engine
def test_a_working_installation_passes_and_its_report_is_json() -> None:
    process = subprocess.run([*COMMAND, "--json", "--no-render"], capture_output=True, text=True)
    assert process.returncode == 0, process.stdout + process.stderr
    report = json.loads(process.stdout)
    assert report["ok"] is True
    # A machine with a GPU and a CPU-only torch earns a warning, and is no broken installation.
    statuses = {check["name"]: check["status"] for check in report["checks"]}
    device = statuses.pop("torch and device")
    assert device in {"ok", "warn"}
    assert statuses == {name: "ok" for name in CHECK if name not in {RENDERING, "torch and device"}}
    assert all(bool(c["remedy"]) == (c["status"] != "ok") for c in report["checks"])


def test_a_broken_engine_fails_with_a_remedy_and_hides_nothing_else(tmp_path: Path) -> None:
    path = shadow_engine(tmp_path, "raise ImportError('libm.so.6: cannot open [it]')")
    process = subprocess.run(
        [*COMMAND, "--json", "--no-render"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert process.returncode == 1
    report = json.loads(process.stdout)
    assert report["ok"] is False
    checks = {check["name"]: check for check in report["checks"]}
    assert checks["engine import"]["status"] == "fail"
    assert checks["engine import"]["detail"] == "ImportError: libm.so.6: cannot open [it]"
    assert "make setup" in checks["engine import"]["remedy"]
    assert checks["match step"]["status"] == "fail"
    assert checks["densities"]["status"] == checks["TensorBoard"]["status"] == "ok"


def test_a_crash_of_the_interpreter_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)"
    monkeypatch.setenv("PYTHONPATH", shadow_engine(tmp_path, source))
    result = run_check(CHECK["engine import"])
    assert result.status == "fail"
    assert "SIGSEGV" in result.detail
    assert result.remedy


def test_a_hang_is_ended_at_the_time_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", shadow_engine(tmp_path, "import time\ntime.sleep(600)"))
    result = run_check(replace(CHECK["engine import"], time_limit=2.0))
    assert (result.status, result.detail) == ("fail", "no answer within 2 s")
    assert result.seconds < 30


def test_a_failure_of_what_training_does_not_need_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", shadow_engine(tmp_path, "raise ImportError('no EGL')"))
    result = run_check(replace(CHECK["engine import"], needed=False))
    assert result.status == "warn"
    assert result.remedy
    assert doctor.installation_works([result])


def test_a_module_in_the_working_directory_is_not_taken_for_a_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.version_info < (3, 11):
        pytest.skip("Python 3.10 cannot be told to leave the working directory out")
    (tmp_path / "torch.py").write_text("raise RuntimeError('not torch')")
    monkeypatch.chdir(tmp_path)
    assert run_check(CHECK["torch and device"]).status != "fail"


def test_an_engine_of_a_newer_system_is_to_be_compiled_on_this_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = 'raise ImportError("libc.so.6: version `GLIBC_2.99\' not found (required by it)")'
    monkeypatch.setenv("PYTHONPATH", shadow_engine(tmp_path, source))
    result = run_check(CHECK["engine import"])
    assert result.status == "fail"
    assert "GLIBC_2.99" in result.detail
    assert "compiled on a newer system" in result.remedy


def test_an_engine_of_another_python_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", shadow_engine(tmp_path, "from fbrl_engine import _native"))
    result = run_check(CHECK["engine import"])
    assert result.status == "fail"
    assert f"isn't for CPython {platform.python_version()}" in result.detail
    assert "make engine-wheel" in result.remedy


def test_gfootball_installed_over_the_engine_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "2.10.2")
    with pytest.raises(CheckError, match=r"gfootball 2\.10\.2 is installed too") as error:
        check_engine()
    assert "pip uninstall -y gfootball" in error.value.remedy
    assert "--force-reinstall" in error.value.remedy


def test_without_the_renderer_only_videos_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CheckError, match="fbrl-engine-render isn't installed") as error:
        check_rendering()
    assert error.value.status == "warn"


def test_a_package_of_a_version_that_does_not_fit_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "0.1" if name == "torchrl" else real(name)
    )
    with pytest.raises(CheckError, match=r"^torchrl 0\.1 is not [^,]*(,<|,>)[^,]*$"):
        check_packages()


def test_the_table_shows_details_and_remedies_word_for_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = [
        CheckResult("engine import", "fail", "cannot open [shared] object", "run `make setup`"),
        CheckResult("densities", "ok", "fine"),
    ]
    monkeypatch.setattr("fbrl.cli.doctor.run_checks", lambda checks: iter(results))
    assert main([]) == 1
    output = capsys.readouterr().out
    assert "cannot open [shared] object" in output
    assert "Remedy: run `make setup`" in output


def test_an_unknown_option_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ending:
        main(["--nonsense"])
    assert ending.value.code == 2
    assert "--nonsense" in capsys.readouterr().err


def test_an_interruption_is_one_line_and_exit_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(check: Check) -> CheckResult:
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "run_check", interrupted)
    with pytest.raises(SystemExit) as ending:
        main(["--json"])
    assert ending.value.code == 130
    assert capsys.readouterr().err == "fbrl-doctor: interrupted\n"
