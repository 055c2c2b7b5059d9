"""The tests under several Pythons: ``nox``, or ``nox -s tests-3.12`` for one of them.

The engine is a Boost.Python extension, and a system has Boost.Python for its own Python only. Where
there is one, the whole suite runs; for the other Pythons, the parts that need no engine.
"""

import os

import nox

nox.options.error_on_missing_interpreters = False

TORCH = os.environ.get("TORCH", "torch==2.13.0").split()
EXTRAS = "football,density,analysis,test,release"
TESTS_WITHOUT_ENGINE = (
    "advantages",
    "cell_convolution",
    "checkpoint",
    "config",
    "density",
    "density_controls",
    "density_figures",
    "density_passes",
    "fresh_install",
    "interrupt",
    "models",
    "results",
    "run_groups",
    "seeds",
    "statsbomb",
    "update",
    "wheel",
)


@nox.session(python=["3.10", "3.11", "3.12"])
def tests(session: nox.Session) -> None:
    """The test suite, or the parts of it that need no engine where none can be compiled."""
    session.install(*TORCH)
    session.install("-e", f".[{EXTRAS}]")
    engine = compiled_engine(session)
    if engine:
        session.install("--no-deps", engine)
        session.run("pytest", *session.posargs)
    else:
        session.warn(f"no Boost.Python for Python {session.python}: tests without the engine")
        modules = [f"tests/test_{name}.py" for name in TESTS_WITHOUT_ENGINE]
        session.run("pytest", *modules, *session.posargs)


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
    return last_line if last_line.endswith(".whl") else ""
