"""The tests under several Pythons: ``nox``, or ``nox -s tests-3.12`` for one of them."""

import os

import nox

nox.options.error_on_missing_interpreters = False

TORCH = os.environ.get("TORCH", "torch==2.13.0").split()
EXTRAS = "football,density,analysis,ray,test,release"

# Tests call pip, which environments that uv makes do not have.
nox.options.default_venv_backend = "virtualenv"


@nox.session(python=["3.10", "3.11", "3.12", "3.13", "3.14"])
def tests(session: nox.Session) -> None:
    """The test suite with the newest versions."""
    session.install(*TORCH)
    session.install(compiled_engine(session))
    session.install("-e", f".[{EXTRAS}]")
    session.run("pytest", *session.posargs)


def compiled_engine(session: nox.Session) -> str:
    """The path of the engine's wheel for the session's Python."""
    output = session.run(
        "scripts/setup.sh",
        "--engine-wheel",
        env={"PYTHON": f"python{session.python}", "PATH": os.environ["PATH"]},
        external=True,
        silent=True,
    )
    return str(output).strip().rpartition("\n")[2]
