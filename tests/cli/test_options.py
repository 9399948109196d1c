"""The commands are alike: the same options, a help that teaches, exit codes as told, colour on
terminals only."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from tcdyn.cli.app import app
from tcdyn.cli.common import Reporter, as_option, options_from_docstring
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warning
from tcdyn.core.options import PANELS, Options, option
from tcdyn.rig.log import read_log
from tests.cli.test_main_job import tcdyn
from tests.conftest import Campaign

LONG = {
    "demo",
    "rig calibrate",
    "rig beta",
    "compensate",
    "view",
}  # several stages, each worth a line with --verbose
KIND = re.compile(
    r"^list\[|^<class '|'>$|\]$| \| None"
)  # a repeated or optional value is of the same kind


def commands(group: Any = None, words: str = "") -> dict[str, typer.core.TyperCommand]:
    """Every command of the help, by the words that call it."""
    if group is None:
        group = typer.main.get_command(app)
    found = {}
    for name, command in group.commands.items():
        path = f"{words} {name}".strip()
        if isinstance(command, typer.core.TyperGroup):
            found |= commands(command, path)
        else:
            found[path] = command
    return found


ALL = commands()


def options(name: str) -> set[str]:
    return {option for parameter in ALL[name].params for option in parameter.opts}


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        (["identifi"], "identify"),
        (["rig", "callibrate"], "calibrate"),
        (["rig", "record", "chek"], "check"),
    ],
)
def test_a_mistyped_command_is_told_the_one_that_was_meant(
    typed: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tcdyn(*typed) == 2
    assert f"'{meant}'" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(ALL))
def test_options_are_the_same_everywhere(name: str) -> None:
    assert {"--json", "--quiet", "-q", "--strict"} <= options(name)
    assert ("--verbose" in options(name)) == (name in LONG)
    assert all(p.help for p in ALL[name].params if p.opts[0].startswith("--")), (
        "an option without a word"
    )


@pytest.mark.parametrize("name", sorted(ALL))
def test_help_has_an_example_whose_options_exist(name: str) -> None:
    text = ALL[name].help or ""
    example = re.search(r"Example: (tcdyn .+)", text, re.S)
    assert example
    shown = set(re.findall(r"(?<=\s)--[\w-]+", example.group(1)))
    assert example.group(1).startswith(f"tcdyn {name}") or name == "rig holes"
    known = options(name) | (options("simulate hole") if name == "rig holes" else set())
    assert shown <= known


def _kind_of(parameter: Any) -> str:
    """Kind of the values of an option, in old and in new versions of Typer."""
    if not hasattr(parameter, "type_descriptor"):
        return str(parameter.type.name.split()[0])
    return KIND.sub("", str(parameter.type_descriptor.annotation))


def test_an_option_has_one_meaning_in_all_commands() -> None:
    """One kind of value and one short name; what names columns is repeated, not a list."""
    kinds: dict[str, set[str]] = {}
    short_names: dict[str, set[str]] = {}
    for command in ALL.values():
        for parameter in command.params:
            long_name = parameter.opts[0]
            if not long_name.startswith("--"):
                continue
            kinds.setdefault(long_name, set()).add(_kind_of(parameter))
            for short in parameter.opts[1:]:
                short_names.setdefault(short, set()).add(long_name)
            help_text = parameter.help or ""
            assert "separated by" not in help_text, long_name
    several = {name: kind for name, kind in kinds.items() if len(kind) > 1}
    assert several == {}
    assert {short: names for short, names in short_names.items() if len(names) > 1} == {}


@dataclass(frozen=True)
class Limits(Options):
    """Limits.

    Attributes
    ----------
    limit_K
        largest error,
        without {window_s}
    kinds
        kind of error
    """

    limit_K: float = option(0.5, "Advanced", low=0, high=1)
    kinds: Sequence[str] = option(
        (), "Model", name="kind", short="-k", choices=("a", "b"), takes=list[str]
    )


def _command(log: Path, refine: bool = True, *, options: Limits) -> None:
    """Do nothing.

    Parameters
    ----------
    log
        log to
        read
    refine
        refine it
    """
    print(options.stated)


def test_options_have_the_names_of_parameters_and_the_help_of_the_docstring() -> None:
    one = typer.Typer()
    one.command()(options_from_docstring(_command))
    command = typer.main.get_command(one)
    log, kinds, limit, refine = command.params[:4]
    assert command.help == "Do nothing."
    assert log.param_type_name == "argument"
    assert "log to read" in CliRunner().invoke(one, ["--help"]).output
    assert (limit.opts, limit.default) == (["--limit-K"], 0.5)
    assert limit.help == "largest error, without --window-s"
    assert kinds.opts == ["--kind", "-k"]
    assert (refine.opts, refine.secondary_opts) == (["--refine"], ["--no-refine"])


@pytest.mark.parametrize(
    ("words", "stated"),
    [
        ([], "{}"),
        (["--limit-K", "0.5"], "{}"),  # the default
        (["--limit-K", "0", "-k", "a", "--kind", "b"], "{'limit_K': 0.0, 'kinds': ['a', 'b']}"),
    ],
)
def test_a_command_gets_the_dataclass_of_its_options(words: list[str], stated: str) -> None:
    one = typer.Typer()
    one.command()(options_from_docstring(_command))
    assert CliRunner().invoke(one, ["a.csv", *words]).output.strip() == stated


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--limit-K", "2"], "limit_K is 2; expected 0 to 1"),
        (["--kind", "c"], "kinds is 'c'; expected a or b"),
    ],
)
def test_a_command_checks_its_options_when_it_is_called(words: list[str], message: str) -> None:
    one = typer.Typer()
    one.command()(options_from_docstring(_command))
    problem = CliRunner().invoke(one, ["a.csv", *words]).exception
    assert isinstance(problem, InputError)
    assert str(problem) == message


@pytest.mark.parametrize("name", sorted(ALL))
def test_every_option_has_its_group_in_the_help(name: str) -> None:
    groups = {
        parameter.opts[0]: parameter.rich_help_panel
        for parameter in ALL[name].params
        if parameter.opts[0].startswith("--") and parameter.opts[0] != "--help"
    }
    assert {option: panel for option, panel in groups.items() if panel not in PANELS} == {}


def test_a_parameter_that_the_docstring_does_not_describe_is_an_error() -> None:
    def command(log: Path) -> None:
        """Do nothing."""

    with pytest.raises(KeyError, match="log"):
        options_from_docstring(command)


def test_help_keeps_its_brackets() -> None:
    """Rich takes [word] for markup and swallows it: units are capital or stand in words."""
    for name, command in ALL.items():
        for text in (command.help, *(getattr(p, "help", "") for p in command.params)):
            assert not re.search(r"\[[a-z/@#]", text or ""), name


def call(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "OMP_NUM_THREADS": "1", **environment}
    command = [sys.executable, "-m", "tcdyn", *map(str, words)]
    return subprocess.run(
        command, capture_output=True, text=True, env=env, check=False, timeout=120
    )


@pytest.mark.e2e
def test_exit_codes_are_those_that_help_tells(tmp_path: Path, campaign: Campaign) -> None:
    told = call("--help").stdout
    for code in ("0 done", "1 no result", "2 bad input", "130 stopped"):
        assert code in " ".join(told.replace("│", " ").split())
    assert tcdyn("rig", "check", "--quiet") == 0
    assert tcdyn("rig", "check", tmp_path / "absent.toml") == 2
    assert tcdyn("no-such-command") == 2
    assert tcdyn("rig", "record", "check", tmp_path / "absent.disk.json") == 2
    doubtful = json.loads(campaign.record_paths["fast"].read_text(encoding="utf-8"))
    doubtful["created"] = "2999-01-01T00:00:00+00:00"
    path = tmp_path / "future.disk.json"
    path.write_text(json.dumps(doubtful), encoding="utf-8")
    assert tcdyn("rig", "record", "check", path) == 0
    assert tcdyn("rig", "record", "check", path, "--strict") == 1


@pytest.mark.e2e
def test_no_colour_where_nobody_sees_it(campaign: Campaign) -> None:
    for words in (("--help",), ("rig", "record", "show", campaign.record_paths["fast"])):
        said = call(*words)
        assert said.returncode == 0
        assert "\x1b" not in said.stdout + said.stderr


@pytest.mark.e2e
def test_an_error_is_one_line_on_standard_error() -> None:
    said = call("rig", "check", "absent.toml")
    assert (said.returncode, said.stdout) == (2, "")
    assert said.stderr.count("\n") == 1
    assert said.stderr.startswith("tcdyn: absent.toml: no such file")


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("line", "offered"),
    [("tcdyn rig cal", "calibrate"), ("tcdyn rig calibrate --imm", "--immersion")],
)
def test_the_shell_completes_commands_and_their_options(line: str, offered: str) -> None:
    environment = {
        "_TCDYN_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(line.count(" ")),
    }
    code = "from tcdyn.cli.app import app; app(prog_name='tcdyn')"
    env = {**os.environ, **environment}
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=env, check=False
    )
    assert said.stdout.split() == [offered]


def test_simulate_prints_json_and_one_line_without_blanks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tcdyn("simulate", "oven", "--out", tmp_path / "oven.csv") == 0
    assert capsys.readouterr().out.startswith("wrote ")
    assert tcdyn("simulate", "oven", "--out", tmp_path / "oven.csv", "--json") == 0
    assert json.loads(capsys.readouterr().out)["rows"] == len(pd.read_csv(tmp_path / "oven.csv"))


def test_record_commands_print_json(campaign: Campaign, capsys: pytest.CaptureFixture[str]) -> None:
    fast = campaign.record_paths["fast"]
    assert tcdyn("rig", "record", "diff", fast, fast, "--json") == 0
    assert json.loads(capsys.readouterr().out)["sentence"].startswith("No significant drift")
    code = tcdyn("rig", "record", "check", fast, "--json", "--strict")
    found = json.loads(capsys.readouterr().out)
    assert found["sound"] == (code == 0) == (not found["doubts"])


@pytest.fixture(scope="module")
def slow_plunge(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plunge of the fast disk, every 30th sample of it, so that its curves are quickly found."""
    frame = pd.read_csv(campaign.files.plunges["fast"][0])
    path = tmp_path_factory.mktemp("plunge") / "P1.csv"
    frame.iloc[::30].to_csv(path, index=False)
    return path


@pytest.mark.e2e
def test_compensate_prints_json(
    campaign: Campaign, slow_plunge: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = slow_plunge.with_name("done.csv")
    words = ("compensate", slow_plunge, "--record", campaign.record_paths["fast"], "--out", out)
    assert tcdyn(*words, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["out"] == str(out)
    assert len(found["disks"]["fast"]["channels"]) == 6
    assert tcdyn(*words, "--verbose", "--strict") == 1  # at 2.5 Hz
    said = capsys.readouterr().err
    assert re.search(r"\d\.\d s  done", said)
    assert "P1.csv: column time_s: sampled at 2.5 Hz" in said


@pytest.mark.e2e
def test_noise_only_takes_the_noise_and_leaves_the_lag(
    campaign: Campaign, slow_plunge: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Against the log whose static lines alone are applied: the smoother passes through its noise,
    unshifted."""
    out = slow_plunge.with_name("smooth.csv")
    record = campaign.record_paths["fast"]
    assert (
        tcdyn(
            "compensate",
            slow_plunge,
            "--record",
            record,
            "--method",
            "noise-only",
            "--json",
            "--out",
            out,
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert set(found["channels"]) == set("abcdef")
    assert "lag left in" in found["metadata"]["method"]
    assert not any(c.endswith("_u_K") for c in pd.read_csv(out))  # nothing is told of the disk
    line = campaign.records["fast"].static["e"]
    static = pd.read_csv(slow_plunge)["e_degC"].to_numpy() * line.gain + line.offset
    smooth = read_log(out, "immersion", allow_compensated=True).frame
    late = (
        smooth["time_s"].to_numpy() > smooth["time_s"].iloc[-1] - 60.0
    )  # away from the knee of the entry
    apart = smooth["e_degC"].to_numpy()[late] - static[late]
    rough = abs(pd.Series(static[late]).diff().diff()).mean()
    assert abs(pd.Series(smooth["e_degC"].to_numpy()[late]).diff().diff()).mean() < 0.2 * rough
    assert (
        abs(apart.mean()) < 3 * apart.std() / len(apart) ** 0.5
    )  # a lag of 0.7 s at 0.1 K/s would be 0.07 K
    assert tcdyn("compensate", out, "--record", record) == 2  # its static lines are applied already
    assert (
        tcdyn(
            "compensate",
            slow_plunge,
            "--record",
            record,
            "--method",
            "noise-only",
            "--report",
            "x.html",
        )
        == 2
    )


@pytest.mark.e2e
def test_noise_only_needs_static_lines_and_nothing_else_of_a_record(
    campaign: Campaign, slow_plunge: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record calibrated in the oven alone, a rig file with another filter; and each doubt is told
    once."""
    record = campaign.records["fast"].model_copy(update={"chain": None})
    (tmp_path / "fast.disk.json").write_text(record.to_json(), encoding="utf-8")
    (tmp_path / "rig.toml").write_text("[conditioning]\ncutoff_Hz = 10.0\n", encoding="utf-8")
    words = [
        "compensate",
        slow_plunge,
        "--record",
        tmp_path / "fast.disk.json",
        "--rig",
        tmp_path / "rig.toml",
    ]
    assert tcdyn(*words, "--out", tmp_path / "lag.csv") == 2
    assert "holds no chain" in capsys.readouterr().err
    frame = pd.read_csv(slow_plunge)
    frame.loc[100:120, "e_degC"] = frame.loc[100, "e_degC"]  # stuck
    frame.to_csv(tmp_path / "stuck.csv", index=False)
    words[1] = tmp_path / "stuck.csv"
    assert tcdyn(*words, "--method", "noise-only", "--out", tmp_path / "smooth.csv") == 0
    said = "".join(capsys.readouterr())
    assert said.count("e: stuck or saturated") == 1


@pytest.mark.e2e
def test_a_wildcard_behind_a_repeatable_option_is_refused() -> None:
    done = call(
        "rig", "calibrate", "--disk", "fast", "--oven", "o.csv", "--immersion", "P1.csv", "P2.csv"
    )
    assert done.returncode == 2
    assert "unexpected extra argument" in done.stderr


def test_a_simulated_campaign_does_not_overwrite_a_rig_file_of_yours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "rig.toml"
    own.write_text("[disk]\nwidth_mm = 9.6\n", encoding="utf-8")
    assert tcdyn("simulate", "campaign", "--out", tmp_path) == 2
    assert "another --out" in capsys.readouterr().err
    assert own.read_text(encoding="utf-8") == "[disk]\nwidth_mm = 9.6\n"


def test_files_of_another_kind_are_named_as_what_they_are(
    campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, log = campaign.record_paths["fast"], campaign.files.ehl["B3"]
    for words, said in (
        (
            ("rig", "beta", record, "--record", record),
            "a record or result by its ending; expected a log",
        ),
        (
            ("rig", "beta", log, "--record", log),
            "give the *.disk.json that `tcdyn rig calibrate` wrote",
        ),
        (
            ("rig", "beta", log, "--record", record, "--rig", record),
            "`tcdyn rig check > rig.toml` writes one",
        ),
        (
            ("rig", "campaign", log.parent, "--record", record, "--out", tmp_path / "r"),
            "name its files, such as",
        ),
    ):
        assert tcdyn(*words) == 2
        assert said in capsys.readouterr().err


@pytest.mark.e2e
def test_noise_from_before_the_filter_is_planned_with_as_white_noise_as_strong_at_low_frequency(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Two poles at 4 Hz leave 8.5 % of the variance at 75 Hz: 0.03 K before them count as 0.103
    K."""
    plans = []
    for noise in (("--noise-K", "0.04", "--noise-before-K", "0.03"), ("--noise-K", "0.1105")):
        assert tcdyn("rig", "design", "--bath-degC", "110", *noise, "--json") == 0
        plans.append(re.sub(r'"[^"]*"', "", capsys.readouterr().out))
    before, white = ([float(x) for x in re.findall(r"\d+\.\d+", plan)] for plan in plans)
    assert before == pytest.approx(white, rel=5e-3)
    assert len(before) > 5


@pytest.mark.parametrize(
    ("command", "option", "values"),
    [
        ("identify data.csv --input u --output y", "--cutoff-Hz", "0 -1 nan inf"),
        ("identify data.csv --input u --output y", "--gain", "0 nan inf"),
        ("identify data.csv --input u --output y", "--held-out", "0 1 nan"),
        ("rig design", "--lag-s", "0 -1 nan"),
        ("rig design", "--rate-Hz", "0.5 inf nan"),
        ("rig design", "--duration-s", "5 inf"),
        ("rig design", "--noise-K", "0 nan"),
        ("rig design", "--noise-before-K", "-1 nan"),
        ("rig design", "--entry-u-s", "0 -1 inf"),
        ("rig design", "--power-W", "0 nan"),
        ("rig design", "--bath-degC", "nan 5000"),
        ("rig design", "--disk", "foo"),
        ("rig holes data.csv", "--depth-mm", "0 nan"),
        ("simulate immersion --out x.csv", "--duration-s", "5 inf nan"),
        ("simulate ehl --out x.csv", "--beta", "-0.1 nan"),
        ("simulate ehl --out x.csv", "--brake-s", "0 -3 nan"),
        ("simulate ehl --out x.csv", "--unloading-s", "0 -1 11 nan"),
        ("simulate ehl --out x.csv", "--again", "0.2 0.2@ nan@1 0.2@0 0@1 x@y"),
    ],
)
def test_a_number_that_cannot_be_is_refused_in_one_sentence(
    command: str, option: str, values: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for value in values.split():
        assert tcdyn(*command.split(), option, value) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"tcdyn: {option} is ")
        assert "expected" in said
        assert said.count("\n") == 1


def test_a_lag_shorter_than_the_conditioning_s_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert tcdyn("rig", "design", "--lag-s", "0.05") == 2
    assert (
        "at least 0.0896 s, since the conditioning alone lags by 0.0796 s"
        in capsys.readouterr().err
    )


def test_a_finding_names_the_command_s_options_and_keeps_its_other_words(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = warning("record.drift", correlation=0.8)
    assert (
        found.sentence
        == "The residuals drift (correlation with time 0.80): fit with baseline=trend."
    )
    findings = [found, warning("from_file", text="D4: the baseline=trend of a file")]
    assert Reporter().report("D4", findings)
    assert capsys.readouterr().err == (
        "warning: D4: The residuals drift (correlation with time 0.80): fit with --baseline "
        "trend.\n"
        "warning: D4: the baseline=trend of a file\n"
    )


def test_an_option_is_put_for_a_parameter_and_not_into_a_path() -> None:
    problem = InputError(
        "holds a rig.toml of yours",
        where="{out}/my_output",
        remedy="give another {out}",
        parameters={"out": None},
    )
    assert str(problem) == "{out}/my_output: holds a rig.toml of yours; give another out"
    assert (
        problem.message(as_option)
        == "{out}/my_output: holds a rig.toml of yours; give another --out"
    )
    assert problem.at("elsewhere").message(as_option) == problem.message(as_option)


@pytest.mark.long
@pytest.mark.e2e
def test_uneven_bores_are_asked_for_by_disk_and_told_beside_the_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "B3.csv"
    assert (
        tcdyn(
            "simulate",
            "ehl",
            "--out",
            out,
            "--uneven",
            "0.3@90",
            "--uneven",
            "fast:0.5@30",
            "--clean",
        )
        == 0
    )
    told = json.loads((tmp_path / "B3.truth.json").read_text())["unevenness"]
    assert [told[d]["contact"] for d in ("fast", "slow")] == [
        {"amplitude": 0.5, "angle_deg": 30.0},
        {"amplitude": 0.3, "angle_deg": 90.0},
    ]
    assert set(told["slow"]["first_K"]) == set("abcdef")
    for wrong, words in (
        ("half", "expected amplitude@degrees"),
        ("1.5@0", "0 (even) to 1"),
        ("left:0.5@0", "fast or slow"),
        ("0.5@nan", "360 degrees"),
    ):
        capsys.readouterr()
        assert tcdyn("simulate", "ehl", "--out", out, "--uneven", wrong) == 2
        assert words in capsys.readouterr().err
