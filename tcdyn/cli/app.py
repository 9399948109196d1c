"""The command ``tcdyn``: every stage from the command line, one clear sentence and exit code 2 for bad input."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from typing import Any

for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")  # small matrices only: a thread pool costs more than it gives

import typer  # noqa: E402
from typer.core import TyperCommand, TyperGroup  # noqa: E402

from calibration.errors import InputError, printable  # noqa: E402
from tcdyn.version import __version__  # noqa: E402

# name: (module, attribute, what it does), in the order of the work; a module is imported when its command is called
COMMANDS: dict[str, tuple[str, str, str]] = {
    "demo": ("tcdyn.cli.simulate", "demo", "The main job on a simulated campaign, with the truth beside every answer."),
    "simulate": ("tcdyn.cli.simulate", "app", "Write logs of the synthetic rig, their truth beside them."),
    "round": ("tcdyn.cli.around", "app", "The temperature round the synthetic disks, drawn."),
    "rig": ("tcdyn.cli.record", "rig", "Check a rig file and print every key with the value in force."),
    "transducer": ("tcdyn.cli.record", "transducer", "Gain and zero of a load cell from dead weights."),
    "spot": ("tcdyn.cli.record", "spot", "What leaves a running surface, from a heated spot, for the rig file."),
    "calibrate": ("tcdyn.cli.calibrate", "calibrate", "Oven and plunge logs of a disk to its record."),
    "record": ("tcdyn.cli.record", "app", "Show, compare and check the records of calibrated disks."),
    "identify": ("tcdyn.cli.identify", "identify", "Dynamics between any two columns, with validation."),
    "response": ("tcdyn.cli.identify", "response", "Dynamics from a measured frequency response."),
    "sensor": ("tcdyn.cli.sensor", "app", "The lag of any thermocouple: stated, by plunge, pair, current or noise."),
    "compensate": ("tcdyn.cli.compensate", "compensate", "Undo static errors and lag of every logged thermocouple."),
    "follow": ("tcdyn.cli.follow", "follow", "Compensate a log while it grows, row by row."),
    "beta": ("tcdyn.cli.beta", "beta", "Heat partition of one EHL log by every way, cross-checked."),
    "campaign": ("tcdyn.cli.beta", "campaign", "Heat partition of many EHL logs, in one table and its figures."),
    "design": ("tcdyn.cli.design", "design", "What a planned test can tell of the lags, before it is run."),
    "hole": ("tcdyn.cli.calibrate", "hole", "How much later cemented thermocouples answer than clamped ones."),
    "verify": ("tcdyn.cli.verify", "verify", "Every published number that can be checked, side by side."),
}


EPILOG = (
    "A first run: tcdyn demo\n\n"
    "Exit codes: 0 done; 1 done, and something asks to be looked at (a log that failed, a record with doubts, a "
    "published number that differs); 2 bad input, said in one sentence; 70 an internal error, to be reported; 130 "
    "stopped with Ctrl-C.\n\n"
    "Words go to standard output, progress and what was noticed (note, look, refuse) to standard error; --json prints "
    "the result for scripts. Colour only on terminals; NO_COLOR=1 takes it away."
)


def load_command(name: str) -> Any:
    """Import the command's module and give its click command."""
    module, attribute, _ = COMMANDS[name]
    found = getattr(import_module(module), attribute)
    if not isinstance(found, typer.Typer):
        single = typer.Typer(add_completion=False)
        single.command(name=name)(found)
        found = single
    command = typer.main.get_command(found)
    command.name = name
    return command


MOVED = {"compensate": "follow"}  # options that went from one command to another
USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]  # typer brings its own click, without a public name


class LazyCommand(TyperCommand):
    """Stands for a command in lists; the real one is loaded when a context for it is made."""

    def make_context(self, info_name: Any, args: Any, parent: Any = None, **extra: Any) -> Any:
        """The context of the real command."""
        command = load_command(str(self.name))
        command.add_help_option = args[:1] == [] or args[0] not in getattr(command, "commands", ())  # as for the root
        try:
            return command.make_context(info_name, args, parent=parent, **extra)
        except USAGE_ERROR as problem:
            many = [p.opts[0] for p in command.params if getattr(p, "multiple", False)]
            if many and "unexpected extra argument" in str(getattr(problem, "message", "")):
                each = " or ".join(f"{option} A {option} B" for option in many)
                problem.message += f"\nSeveral values of one option: {each}"  # type: ignore[attr-defined]
            new, option = MOVED.get(str(self.name), ""), getattr(problem, "option_name", None)
            if new and option in {name for p in load_command(new).params for name in p.opts}:
                problem.message += f"\n{option} belongs to another command now: tcdyn {new}"  # type: ignore[attr-defined]
            raise


class LazyCommands(TyperGroup):
    """Commands are imported when they are called, so that ``tcdyn --help`` answers at once."""

    def __init__(self, **settings: Any) -> None:
        stand_ins = {name: LazyCommand(name=name, help=COMMANDS[name][2]) for name in COMMANDS}
        super().__init__(**{**settings, "commands": stand_ins})


INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h
_ROOT_ASKED = sys.argv[1:2] == [] or sys.argv[1] not in COMMANDS  # else its options only keep a command waiting
app = typer.Typer(
    cls=LazyCommands,
    no_args_is_help=True,
    add_completion=_ROOT_ASKED,
    add_help_option=_ROOT_ASKED,  # typer brings pydantic to tell that it was not given
    help="Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate beta.",
    epilog=EPILOG,
    pretty_exceptions_enable=False,  # run() reports them
)


def _version(show: bool) -> None:
    if show:
        typer.echo(f"tcdyn {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate beta."""


def _said(problem: BaseException) -> str:
    """What the machine refused, in words."""
    words = {MemoryError: "not enough memory; give a shorter log", RecursionError: "nested too deeply to be read"}
    words |= {OverflowError: f"a number beyond all bounds ({problem})"}
    reason = " ".join(str(getattr(problem, "strerror", None) or problem).split())
    return next((said for kind, said in words.items() if isinstance(problem, kind)), f"the system refused ({reason})")


def _interrupted(problem: BaseException | None) -> bool:
    """Whether it was Ctrl-C, which typer ends with its code, and a library that is imported makes another error of."""
    ended = isinstance(problem, KeyboardInterrupt) or (isinstance(problem, SystemExit) and problem.code == 130)
    return ended or (problem is not None and _interrupted(problem.__cause__ or problem.__context__))


def _internal_error(problem: BaseException) -> int:
    """Print the traceback and one sentence on standard error; return the exit code."""
    import traceback

    traceback.print_exception(problem)
    print(
        f"tcdyn: internal error ({type(problem).__name__}): this is a fault in tcdyn {__version__}, not in your input; "
        "please report it in the project's issue tracker with the lines above, the command and, if you can, its input",
        file=sys.stderr,
    )
    return INTERNAL_ERROR


def run(command: Callable[[], Any]) -> int:
    """Call ``command``; bad input becomes one sentence on standard error and exit code 2.

    Any other exception is an internal error: its traceback and one sentence on standard error, and exit code 70.
    """
    try:
        result = command()
    except InputError as problem:
        from tcdyn.cli.common import in_options

        print(f"tcdyn: {printable(in_options(str(problem), problem.parameters))}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except (Exception, KeyboardInterrupt, SystemExit) as problem:  # nobody nearer has words
        if _interrupted(problem):
            print("tcdyn: stopped; nothing half-written was kept", file=sys.stderr)
            return 130
        if isinstance(problem, SystemExit):
            raise
        if not isinstance(problem, (OSError, MemoryError, RecursionError, OverflowError, ImportError)):
            return _internal_error(problem)
        place = f"{printable(str(problem.filename))}: " if isinstance(problem, OSError) and problem.filename else ""
        print(f"tcdyn: {place}{_said(problem)}; nothing half-written was kept", file=sys.stderr)
        return 2
    return result if isinstance(result, int) else 0


class _Later:
    """Finds modules that are read with their first use: scipy takes over every public name of numpy, these among them,
    whose import takes a tenth of a short command's time and which no command uses."""

    names = ("numpy.f2py", "numpy.testing")

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None, target: Any = None) -> ModuleSpec | None:
        """The spec of one of ``names``; others are found in the usual way."""
        spec = PathFinder.find_spec(name, path) if name in cls.names else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def main() -> None:
    """The command that ``sys.argv`` asks for; ends with SystemExit."""
    sys.exit(run(lambda: app(standalone_mode=True)))


def command() -> None:
    """``main`` as all that a process does: what the process holds goes back to the system at once when it ends."""
    status: Any = INTERNAL_ERROR

    def leave() -> None:
        with suppress(AttributeError, OSError, ValueError):  # an output that takes nothing is told of in the usual way
            sys.stdout.flush()
            sys.stderr.flush()
            if isinstance(status, int):
                os._exit(status)

    atexit.register(leave)  # the first is called last
    gc.set_threshold(1_000_000)  # to look for circles after each 700 new objects took a tenth of a second; few exist
    sys.meta_path.insert(0, _Later)
    try:
        main()
    except (SystemExit, KeyboardInterrupt) as asked:
        status = getattr(asked, "code", 130) or 0
        raise
    except Exception as problem:  # of run itself
        _internal_error(problem)
        sys.exit(INTERNAL_ERROR)


if __name__ == "__main__":
    command()
