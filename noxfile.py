"""The tests under several Pythons: ``nox``, or ``nox -s tests-3.12`` for one of them.

The engine is a Boost.Python extension, and a system has Boost.Python for its own Python only. Where
there is one, the whole suite runs; under the other Pythons, what asks for the engine is skipped.
"""

import os

import nox

nox.options.error_on_missing_interpreters = False

TORCH = os.environ.get("TORCH", "torch==2.13.0").split()
EXTRAS = "football,density,analysis,ray,test,release"

# Tests call pip, which environments that uv makes do not have.
nox.options.default_venv_backend = "virtualenv"


@nox.session(python=["3.10", "3.11", "3.12"])
def tests(session: nox.Session) -> None:
    """The test suite with the newest versions."""
    session.install(*TORCH)
    session.install("-e", f".[{EXTRAS}]")
    test(session)


def test(session: nox.Session) -> None:
    """Runs the tests, with the engine where the system has Boost.Python for this Python."""
    engine = compiled_engine(session)
    if engine:
        session.install("--no-deps", engine)
    else:
        session.warn("no engine for Python %s: tests that ask for it are skipped", session.python)
    session.run("pytest", *session.posargs)


def compiled_engine(session: nox.Session) -> str:
    """The path of gfootball's wheel for the session's Python, or nothing."""
    output = session.run(
        "scripts/setup.sh",
        "--engine-wheel",
        env={"PYTHON": f"python{session.python}", "PATH": os.environ["PATH"]},
        external=True,
        silent=True,
        success_codes=[0, 1],
    )
    last_line = str(output).strip().rpartition("\n")[2]
    if last_line.endswith(".whl"):
        return last_line
    session.log(str(output).strip())
    return ""
