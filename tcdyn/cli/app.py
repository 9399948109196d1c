"""The command ``tcdyn``: every stage from the command line, one clear sentence and exit code 2 for bad input."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")  # small matrices only: a thread pool costs more than it gives

import typer  # noqa: E402
from typer.core import TyperGroup  # noqa: E402

from calibration.errors import InputError  # noqa: E402

# name: (module, attribute, is a sub-app, one line of help) in the order of the work; loaded only when called
COMMANDS: dict[str, tuple[str, str, bool]] = {
    "demo": ("tcdyn.cli.demo", "demo", False),
    "simulate": ("tcdyn.cli.simulate", "app", True),
    "rig": ("tcdyn.cli.rig", "rig", False),
    "calibrate": ("tcdyn.cli.calibrate", "calibrate", False),
    "record": ("tcdyn.cli.record", "app", True),
    "identify": ("tcdyn.cli.identify", "identify", False),
    "compensate": ("tcdyn.cli.compensate", "compensate", False),
    "beta": ("tcdyn.cli.beta", "beta", False),
    "campaign": ("tcdyn.cli.campaign", "campaign", False),
    "design": ("tcdyn.cli.design", "design", False),
    "verify": ("tcdyn.cli.verify", "verify", False),
}


class LazyCommands(TyperGroup):
    """Commands are imported when they are called, so that ``tcdyn --help`` answers at once."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in COMMANDS:
            return None
        module, attribute, is_app = COMMANDS[cmd_name]
        found = getattr(import_module(module), attribute)
        if is_app:
            group = typer.main.get_command(found)
            group.name = cmd_name
            return group
        single = typer.Typer(add_completion=False)
        single.command(name=cmd_name)(found)
        return typer.main.get_command(single)


app = typer.Typer(
    cls=LazyCommands,
    no_args_is_help=True,
    help="Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate beta.",
    epilog="A first run: tcdyn demo",
)


def _version(show: bool) -> None:
    if show:
        import tcdyn

        typer.echo(f"tcdyn {tcdyn.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate beta."""


def run(command: Callable[[], Any]) -> int:
    """Call ``command``; bad input becomes one sentence on standard error and exit code 2."""
    try:
        result = command()
    except InputError as problem:
        print(f"tcdyn: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("tcdyn: stopped; nothing half-written was kept", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 0
    return result if isinstance(result, int) else 0


def main() -> None:
    """Entry point of the ``tcdyn`` command."""
    sys.exit(run(lambda: app(standalone_mode=True)))


if __name__ == "__main__":
    main()
