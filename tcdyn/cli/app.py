"""The command ``tcdyn``: its subcommands, exit codes, and the handling of errors.

:mod:`tcdyn.cli.start`, the entry point, calls :func:`main`. A new command is added to ``app``.
The exit codes are part of the interface (``EPILOG``, manual). Tests: ``tests/cli/test_status.py``
and ``tests/cli/test_internal_error.py``.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any

import typer

from tcdyn.cli import circumference, debug, record, sensor, simulate
from tcdyn.cli.beta import beta, campaign
from tcdyn.cli.calibrate import calibrate, holes
from tcdyn.cli.common import as_option
from tcdyn.cli.compensate import compensate
from tcdyn.cli.design import design
from tcdyn.cli.follow import follow
from tcdyn.cli.history import compare, history
from tcdyn.cli.identify import identify, response
from tcdyn.cli.inspect import inspect
from tcdyn.cli.stop_signals import stop_signals
from tcdyn.cli.streams import message_stream, result_stream
from tcdyn.cli.tune import tune
from tcdyn.cli.verify import verify
from tcdyn.cli.view import view
from tcdyn.core.errors import InputError, printable
from tcdyn.version import __version__

# Texts of ``tcdyn --help``.
DESCRIPTION = (
    "Thermocouple dynamics and heat partition: calibrate disks, compensate logged traces, estimate "
    "beta."
)
EPILOG = (
    "A first run: tcdyn demo\n\n"
    "Exit codes: 0 done, also with warnings; 1 no result to be trusted (for example the "
    "recommended estimate is not reported, a log of a campaign failed, or a published number "
    "differs), and with --strict any warning; 2 bad input, with a message that says what to do; "
    "70 an internal error, please report it with the file of --debug; 130 stopped, for example "
    "with Ctrl-C.\n\n"
    "Results go to standard output, progress and findings (info, warning, error) to standard "
    "error; --json prints the result for scripts. Terminals get colour; NO_COLOR=1 switches it off."
)


BAD_INPUT = 2  # as click for wrong options
INTERNAL_ERROR = 70  # EX_SOFTWARE of sysexits.h
STOPPED = 130  # 128 + SIGINT, as shells report it
REPEATED_INTERRUPT_S = 0.01  # after an interrupt that Python could not raise
# exceptions that the operating system or the size of the input causes
SYSTEM_ERRORS = (OSError, MemoryError, RecursionError, OverflowError, ImportError)

app = typer.Typer(
    no_args_is_help=True,
    help=DESCRIPTION,
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,  # run() reports exceptions
)
# Groups of commands in the help, in this order.
ANY_THERMOCOUPLE = "Any thermocouple"
IDENTIFICATION = "Identification"
TWO_DISK_RIG = "Two-disk rig"
TOOLS = "Tools"

rig = typer.Typer(
    no_args_is_help=True,
    help="Calibrate the disks of a two-disk rig and estimate the heat partition beta.",
)
RIG_COMMANDS = {
    "check": record.check_rig,
    "transducer": record.transducer,
    "line": record.line,
    "calibrate": calibrate,
    "beta": beta,
    "campaign": campaign,
    "design": design,
    "holes": holes,
}
for name, function in RIG_COMMANDS.items():
    rig.command(name)(function)
rig.add_typer(record.app, name="record")
rig.add_typer(circumference.app, name="circumference")

sensor.app.command("history")(history)
sensor.app.command("compare")(compare)
app.add_typer(sensor.app, name="sensor", rich_help_panel=ANY_THERMOCOUPLE)
app.command("compensate", rich_help_panel=ANY_THERMOCOUPLE)(compensate)
app.command("follow", rich_help_panel=ANY_THERMOCOUPLE)(follow)
app.command("inspect", rich_help_panel=ANY_THERMOCOUPLE)(inspect)
app.command("view", rich_help_panel=ANY_THERMOCOUPLE)(view)
app.command("identify", rich_help_panel=IDENTIFICATION)(identify)
app.command("response", rich_help_panel=IDENTIFICATION)(response)
app.command("tune", rich_help_panel=IDENTIFICATION)(tune)
app.add_typer(rig, name="rig", rich_help_panel=TWO_DISK_RIG)
app.command("demo", rich_help_panel=TOOLS)(simulate.demo)
app.add_typer(simulate.app, name="simulate", rich_help_panel=TOOLS)
app.command("verify", rich_help_panel=TOOLS)(verify)


def _version(show: bool) -> None:
    """Print the version and exit, with ``--version``."""
    if show:
        typer.echo(f"tcdyn {__version__}")
        raise typer.Exit


@app.callback(help=DESCRIPTION)
def _root(
    version: bool = typer.Option(
        False, "--version", "-V", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    """Options of ``tcdyn`` itself."""


def run(command: Callable[[], Any]) -> int:
    """Call ``command`` and return the exit code of the process.

    Parameters
    ----------
    command
        The application, or a function without arguments.

    Returns
    -------
    code
        Exit code.

    Notes
    -----
    Bad input and errors of the operating system print one line on standard error and give exit code
    2. Ctrl-C gives 130, a closed pipe at the output 0. Any other exception is an internal error: it
    prints its traceback and one line on standard error, and gives exit code 70.
    """
    debug.is_on.set(False)
    try:
        code = _exit_code(command)
        sys.stdout.flush()  # an output that cannot be written is reported here
    except InputError as problem:
        print(f"tcdyn: {printable(problem.message(as_option))}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:
        return 0
    except (Exception, KeyboardInterrupt) as problem:
        if any(isinstance(cause, KeyboardInterrupt) for cause in _causes(problem)):
            code = STOPPED
        elif isinstance(problem, SYSTEM_ERRORS):
            print(
                f"tcdyn: {_system_error(problem)}; nothing half-written was kept", file=sys.stderr
            )
            return BAD_INPUT
        else:
            return _internal_error(problem)
    if code == STOPPED:
        print("tcdyn: stopped; nothing half-written was kept", file=sys.stderr)
    return code


def _exit_code(command: Callable[[], Any]) -> int:
    """The exit code that ``command`` returns or exits with.

    Parameters
    ----------
    command
        As of :func:`run`.

    Returns
    -------
    code
        0 where the command returns or exits without a number.
    """
    try:
        result = command()
    except SystemExit as exit_:
        causes = list(_causes(exit_))
        if any(isinstance(cause, KeyboardInterrupt) for cause in causes):
            return STOPPED
        if any(isinstance(cause, BrokenPipeError) for cause in causes):
            return 0  # typer would exit with 1
        result = exit_.code
    return result if isinstance(result, int) else 0


def _causes(problem: BaseException | None) -> Iterator[BaseException]:
    """``problem``, its cause, and so on.

    A library may turn Ctrl-C, or a closed pipe, into another exception.
    """
    while problem is not None:
        yield problem
        problem = problem.__cause__ or problem.__context__


def _system_error(problem: Exception) -> str:
    """Message for an error that the operating system or the size of the input causes."""
    if isinstance(problem, MemoryError):
        return "not enough memory; give a shorter log"
    if isinstance(problem, RecursionError):
        return "nested too deeply to be read"
    if isinstance(problem, OverflowError):
        return f"a number beyond all bounds ({problem})"
    reason = problem.strerror if isinstance(problem, OSError) else None
    text = f"the system refused ({' '.join(str(reason or problem).split())})"
    if isinstance(problem, OSError) and problem.filename:
        return f"{printable(str(problem.filename))}: {text}"
    return text


def _internal_error(problem: BaseException) -> int:
    """Print the traceback and one line on standard error; return the exit code.

    With ``--debug`` the line names a file with the traceback, the command and the versions.
    """
    traceback.print_exception(problem)
    content = "the lines above, the command"
    advice = "; --debug writes a file for it"
    if debug.is_on.get():
        try:
            content = str(debug.write_error_file(problem))
            advice = ""
        except OSError as refusal:
            advice = f"; --debug could not write a file ({refusal.strerror})"
    print(
        f"tcdyn: internal error ({type(problem).__name__}): this is a fault in tcdyn "
        f"{__version__}, "
        f"not in your input; please report it in the project's issue tracker with {content} "
        f"and, if you can, its input{advice}",
        file=sys.stderr,
    )
    return INTERNAL_ERROR


def _stop_as_with_ctrl_c() -> None:
    """Let signals to stop end a command as Ctrl-C does, so that no worker process remains.

    A signal that is ignored, as SIGHUP under ``nohup``, stays ignored.
    """
    for number in stop_signals():
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def _repeat_lost_interrupt(lost: sys.UnraisableHookArgs) -> None:
    """Interrupt again where Python cannot raise KeyboardInterrupt, as in a call of a C library.

    It would print a traceback, and the command would go on. Within this function it cannot be
    raised either, so a thread interrupts a little later.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        again = threading.Timer(REPEATED_INTERRUPT_S, _thread.interrupt_main)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(lost)


def main() -> None:
    """Run the command of ``sys.argv``; ends with SystemExit."""
    _stop_as_with_ctrl_c()
    sys.unraisablehook = _repeat_lost_interrupt
    sys.stderr = message_stream(sys.stderr)
    sys.stdout = result_stream(sys.stdout)
    code = run(app)
    try:
        sys.stdout.flush()
    except OSError:
        # run() has reported it; Python would report it again at exit (Python manual, module signal,
        # "Note on SIGPIPE")
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)
