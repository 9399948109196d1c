"""The library inside other programs: pools, threads, asyncio, notebooks, strict interpreters.

The same numbers come out everywhere, and nothing remains afterwards. The tests themselves run in
the workers of pytest-xdist. ``test_parallel.py`` has worker processes that the library starts.
"""

from __future__ import annotations

import asyncio
import gc
import locale
import logging
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_info

import tcdyn
from tcdyn.sensors import specified_sensor

ROOT = Path(__file__).parents[2]
# Growth of the resident memory in 500 calls that counts as none [MB]; 0.02 in 500 calls after 250
# (measured in 1500), while caches of libraries grow by 13 in the first 250.
NO_GROWTH_MB = 1.0
CALLS_TO_FILL_CACHES = 250
STRICT = """
import threading, warnings
from tests.core.test_embedding import numbers
threads = threading.active_count()
print(repr(numbers()))
assert threading.active_count() == threads
"""


def numbers() -> list[float]:
    """Numbers of one call each: fit, smoother, compensated frame, file read and written."""
    t = 0.1 * np.arange(120)
    heater = np.where((t > 2) & (t < 7), 1.0, 0.0)
    chain = tcdyn.Chain(0.8)
    reading = chain.response(heater, 0.1, "zoh") + 0.01 * np.sin(37.0 * t)
    fitted = tcdyn.fit((heater, reading, 0.1), "P1", noise="white", baseline="none")
    slow = pd.Series(20 + np.sin(0.3 * t) + 0.01 * np.sin(37.0 * t), pd.Index(t, name="time_s"))
    smoothed = tcdyn.smooth(slow, None, chain)
    probe = specified_sensor("probe", ["T_degC"], [(0.8, 0.1)])
    done = tcdyn.compensate_frame(slow.rename("T_degC"), probe)
    return [
        fitted.identified.theta["Tp1"],
        float(smoothed.temperature[60, 0]),
        float(done["T_degC"].iloc[60]),
    ]


def as_dicts(results: dict[str, Any]) -> dict[str, Any]:
    """The results as plain data, computed where this is called."""
    return {name: result.to_dict() for name, result in results.items()}


@pytest.mark.e2e
@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_pool_of_every_start_method_gives_the_same_numbers_and_takes_all_results(
    method: str, quick_results: dict[str, Any]
) -> None:
    expected = numbers()
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply(numbers) == expected
        assert pool.apply(as_dicts, (quick_results,)) == as_dicts(quick_results)
    assert multiprocessing.active_children() == []


def state_of_process(folder: Path) -> dict[str, Any]:
    """What a program would notice if a library changed it; ``folder``: of temporary files."""
    stop_signals = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    return {
        "environment": dict(os.environ),
        "working directory": os.getcwd(),
        "temporary files": sorted(os.listdir(folder)),
        "threads": {thread.name for thread in threading.enumerate()},
        "children": {child.pid for child in multiprocessing.active_children()},
        "signals": [signal.getsignal(s) for s in stop_signals if s is not None],
        "warnings": list(warnings.filters),
        "floating point errors": np.geterr(),
        "printing of arrays": np.get_printoptions(),
        "random numbers": (random.getstate(), str(np.random.get_state(legacy=False))),  # noqa: NPY002
        "locale": locale.setlocale(locale.LC_ALL),
        "time zone": time.tzname,
        "recursion limit": sys.getrecursionlimit(),
        "logging": (logging.root.level, list(logging.root.handlers)),
        "hooks": (sys.excepthook, sys.displayhook, sys.stdout, sys.stderr),
        "garbage collector": (gc.isenabled(), gc.get_threshold()),
        "import path": (list(sys.path), list(sys.meta_path)),
        "BLAS": [(lib["filepath"], lib["num_threads"]) for lib in threadpool_info()],
        "matplotlib": {key: value for key, value in mpl.rcParams.items() if key != "backend"},
        "open figures": plt.get_fignums(),
    }


def test_calls_change_nothing_in_their_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Environment, signals, warnings, random numbers, locale and so on, as ``state_of_process``."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    first = numbers()  # imports
    before = state_of_process(tmp_path)
    assert numbers() == first
    after = state_of_process(tmp_path)
    assert {key for key in before if before[key] != after[key]} == set()


def test_threads_give_the_same_numbers() -> None:
    expected = numbers()
    environment = dict(os.environ)
    with ThreadPoolExecutor(3) as threads:
        results = [threads.submit(numbers) for _ in range(3)]
        assert [result.result() for result in results] == [expected] * 3
    assert dict(os.environ) == environment


@pytest.mark.e2e
def test_a_notebook_gives_the_same_numbers_and_nothing_remains(tmp_path: Path) -> None:
    """Its kernel runs an event loop, in which the cells are executed."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    cells = [
        "from tests.core.test_embedding import numbers, state_of_process\n"
        "first = numbers()\n"
        f"folder = {str(tmp_path)!r}\n"
        "before = state_of_process(folder)",
        "assert numbers() == first\n"
        "after = state_of_process(folder)\n"
        "changed = {key for key in before if before[key] != after[key]}",
        "print([repr(first), sorted(changed)])",
        "import asyncio\n"
        "print(await asyncio.gather(*[asyncio.to_thread(numbers) for _ in range(2)]))",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(c) for c in cells])
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": ROOT}})
    client.execute()
    printed = [
        "".join(output.get("text", "") for output in cell["outputs"]) for cell in notebook.cells
    ]
    expected = numbers()
    assert printed[2] == f"{[repr(expected), []]}\n"
    assert printed[3] == f"{[expected, expected]}\n"


@pytest.mark.e2e
def test_tasks_of_asyncio_give_the_same_numbers() -> None:
    async def two() -> list[list[float]]:
        return await asyncio.gather(asyncio.to_thread(numbers), asyncio.to_thread(numbers))

    before = threading.active_count()
    assert asyncio.run(two()) == [numbers()] * 2
    assert threading.active_count() == before


@pytest.mark.e2e
def test_interpreter_in_development_mode_with_warnings_as_errors_is_silent() -> None:
    """Development mode reports unclosed files, among others."""
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error", "-c", STRICT],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == repr(numbers())


@pytest.mark.long
@pytest.mark.study
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="counts by /proc")
def test_500_calls_leave_neither_memory_nor_descriptors_nor_threads(tmp_path: Path) -> None:
    t = 0.1 * np.arange(120)
    table = pd.DataFrame({"time_s": t, "u": np.where(t > 2, 1.0, 0.0)})
    table["y"] = tcdyn.Chain(0.8).response(table["u"].to_numpy(), 0.1, "zoh")
    table.to_csv(tmp_path / "log.csv", index=False)

    def call() -> None:
        data = tcdyn.identification.from_csv(tmp_path / "log.csv", input="u", output="y")
        fitted = tcdyn.fit(data, "P1", noise="white", baseline="none")
        fitted.plot()
        specified_sensor("probe", ["y"], [(0.8, 0.1)]).write(tmp_path / "probe.sensor.json")
        tcdyn.read_sensor(tmp_path / "probe.sensor.json")

    for _ in range(CALLS_TO_FILL_CACHES):
        call()
    before = resources()
    for _ in range(500):
        call()
    after = resources()
    assert after[1:] == before[1:]
    assert after[0] - before[0] < NO_GROWTH_MB


def resources() -> tuple[float, int, int]:
    """Resident memory [MB], open descriptors and threads of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    descriptors = len(os.listdir("/proc/self/fd"))
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20, descriptors, threading.active_count()
