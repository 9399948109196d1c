"""The committed logs of the behaviour suite: a small simulated campaign, its temperatures rounded
to 0.01 degC.

``python -m tests.behaviour.logs`` simulates the logs again and writes them; a test compares them
with the simulator.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import parquet

from tcdyn.simulate.campaign import simulate_campaign
from tcdyn.simulate.ehl import EhlOptions

FOLDER = Path(__file__).parent / "data"
SEED = 3
TESTS = ("B3", "D4")
OPTIONS = EhlOptions(load_on_s=30.0, unload_s=230.0, duration_s=245.0)
SCALE = b"steps per unit"
STEPS = {
    "degC": 100,
    "s": 1_000_000,
    "N": 1000,
    "rpm": 10,
    "": 1,
}  # per unit of a column, by the ending of its name


def steps_of(column: str) -> int:
    """How many steps one unit of a column has in the committed files."""
    _, _, ending = column.rpartition("_")
    return STEPS.get(ending, 1)


def pack(frame: pd.DataFrame, path: Path) -> None:
    """Write a log as whole numbers of steps, which compress well."""
    columns = {
        name: np.rint(frame[name].to_numpy() * steps_of(name)).astype(np.int32) for name in frame
    }
    scales = json.dumps({name: steps_of(name) for name in frame})
    table = pa.table(columns).replace_schema_metadata({SCALE: scales.encode()})
    encoding = dict.fromkeys(frame, "DELTA_BINARY_PACKED")
    parquet.write_table(
        table,
        path,
        compression="zstd",
        compression_level=19,
        use_dictionary=False,
        column_encoding=encoding,
    )


def unpack(path: Path) -> pd.DataFrame:
    """A committed log in its own units."""
    table = parquet.read_table(path)
    scales = json.loads(table.schema.metadata[SCALE])
    return pd.DataFrame(
        {name: table[name].to_numpy() / scales[name] for name in table.column_names}
    )


def simulated(folder: Path) -> dict[str, Path]:
    """Simulate the campaign into ``folder``; its logs by name."""
    files = simulate_campaign(folder, SEED, TESTS, ehl_options=OPTIONS)
    logs = {f"oven_{disk}": path for disk, path in files.ovens.items()}
    logs |= {
        f"plunge_{disk}_{k}": path
        for disk, paths in files.plunges.items()
        for k, path in enumerate(paths, 1)
    }
    return logs | {f"ehl_{name}": path for name, path in files.ehl.items()} | {"rig": files.rig}


def write_logs(folder: Path) -> dict[str, Path]:
    """Write the committed logs as CSV, and rig file and records beside them; paths by name."""
    paths = {}
    for packed in sorted(FOLDER.glob("*.parquet")):
        path = folder / f"{packed.stem}.csv"
        unpack(packed).to_csv(path, index=False)
        paths[packed.stem] = path
    for other in (*FOLDER.glob("*.toml"), *FOLDER.glob("*.json")):
        path = folder / other.name
        path.write_bytes(other.read_bytes())
        paths[other.name.partition(".")[0]] = path
    return paths


def main() -> None:
    """Write the committed logs anew; ``python -m tests.behaviour.store records`` makes the records
    beside them."""
    with tempfile.TemporaryDirectory() as folder:
        for name, path in simulated(Path(folder)).items():
            if path.suffix == ".toml":
                (FOLDER / "rig.toml").write_bytes(path.read_bytes())
            else:
                pack(pd.read_csv(path), FOLDER / f"{name}.parquet")


if __name__ == "__main__":
    main()
