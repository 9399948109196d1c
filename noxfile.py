"""The tasks that people and CI run; `nox -l` lists them."""

import tomllib
from pathlib import Path

import nox

nox.options.sessions = ["lint", "test"]
nox.options.reuse_existing_virtualenvs = True


@nox.session
def test(session: nox.Session) -> None:
    """The default tests, about three minutes."""
    session.install(".[test]")
    session.run("python", "-m", "pytest", "-n", "auto", *session.posargs)


@nox.session
def lowest(session: nox.Session) -> None:
    """The default tests with the lowest version of every dependency, all together.

    The test tools are the newest ones, without import-linter, which needs a newer rich. Old
    libraries warn about newer ones that they use, which is no fault here.
    """
    with Path("pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    tools = [
        tool
        for tool in project["optional-dependencies"]["test"]
        if not tool.startswith("import-linter")
    ]
    lower_bounds = [bounds.partition(",")[0] for bounds in project["dependencies"]]
    lowest_versions = [bound.replace(">=", "==") for bound in lower_bounds]
    session.install(".", *tools, *lowest_versions)
    session.run(
        "python", "-m", "pytest", "-n", "auto", "-W", "ignore::DeprecationWarning", *session.posargs
    )


@nox.session
def e2e(session: nox.Session) -> None:
    """Whole commands, damaged input, the behaviour suite, figures."""
    session.install(".[test]")
    session.run("python", "-m", "pytest", "-n", "auto", "-m", "e2e", *session.posargs)


@nox.session
def study(session: nox.Session) -> None:
    """Monte Carlo studies of coverage, and mutations of the source."""
    session.install(".[test]")
    session.run("python", "-m", "pytest", "-n", "auto", "-m", "study", *session.posargs)


@nox.session
def coverage(session: nox.Session) -> None:
    """Line and branch coverage of the three packages."""
    session.install("-e", ".[test]")
    session.run(
        "python",
        "-m",
        "pytest",
        "-n",
        "auto",
        "-m",
        "e2e or not study",
        "--cov",
        "--cov-report=term-missing:skip-covered",
        *session.posargs,
    )


@nox.session
def lint(session: nox.Session) -> None:
    """Style, types and import contracts."""
    session.install(".[lint]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("mypy")
    session.run("lint-imports")


@nox.session
def docs(session: nox.Session) -> None:
    """The manual into docs/_build: its pages and examples are executed."""
    session.install(".[docs]")
    session.run("sphinx-build", "-W", "--keep-going", "-n", "-q", "-j", "2", "docs", "docs/_build")


@nox.session
def benchmarks(session: nox.Session) -> None:
    """Ratios against named baselines in the same run."""
    session.install(".[test,bench]")
    for name in session.posargs or ("conduction", "identify", "compensate", "plunge"):
        session.run("python", "-m", f"tests.benchmarks.{name}")


@nox.session
def demo(session: nox.Session) -> None:
    """The main job on a simulated campaign."""
    session.install(".")
    session.run("tcdyn", "demo", *session.posargs)
