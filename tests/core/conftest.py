"""Results of all kinds that need no campaign."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

import tcdyn
from tests.identify.identify_cases import static_gain


def by_class(instances: list[Any]) -> dict[str, Any]:
    """Results by the name of their class."""
    return {type(result).__name__: result for result in instances}


@pytest.fixture(scope="session")
def quick_results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Results that need no campaign, by class name."""
    from calibration.transducers import fit_bearing_friction, fit_transducer
    from tcdyn.campaign.interchange import compare_maps
    from tcdyn.identification import (
        bode_band,
        fit_function,
        predict,
        spectral_estimate,
        step_band,
        validate,
    )
    from tcdyn.sensors import compare_sensors, sensor_history, specified_sensor
    from tcdyn.sensors.touch import find_touches
    from tcdyn.smoothing import proper_inverse, report_inverse
    from tcdyn.workflows.compensate_table import compensate_table
    from tcdyn.workflows.follow import follow

    chain = tcdyn.Chain((0.6, 0.1), conditioning=tcdyn.Conditioning(4.0, 2))
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([25.0, 75.0], 40), 20)
    y = chain.response(u, 0.1, "zoh") + rng.normal(0, 0.1, len(u))
    data = tcdyn.IOData.from_arrays(u, y, 0.1, hold="zoh", output_units=["degC"])
    fitted = tcdyn.fit(data, "P1")
    folder = tmp_path_factory.mktemp("quick")
    t = 0.1 * np.arange(100)
    slow = 20 + np.sin(0.3 * t) + rng.normal(0, 0.01, len(t))
    table = pd.DataFrame({"time_s": t, "T_degC": slow})
    table.to_csv(folder / "log.csv", index=False)
    sensor = specified_sensor("probe", ["T_degC"], [(0.7, 0.1)])
    time_s = np.arange(0.0, 30.0, 0.1)
    measured = [
        specified_sensor("probe", ["T_degC"], [(lag_s, 0.02)]).model_copy(
            update={"method": "noise"}
        )
        for lag_s in (0.7, 0.71, 0.8)
    ]
    dates = ["2025-01-01", "2025-04-01", "2025-07-01"]
    touch = np.where((time_s > 10) & (time_s < 12), 5.0, 0.0)
    touched = np.column_stack([touch, 0.1 * touch]) + rng.normal(0, 0.01, (len(time_s), 2))
    junctions = {"a": 60.0, "b": 61.0, "c": 63.0, "d": 64.0, "e": 66.0, "f": 67.0}
    maps = {"slow": dict(junctions)}
    return by_class(
        [
            tcdyn.load_rig(),
            chain,
            tcdyn.smooth(slow, 0.1, chain, lag_covariance=np.array([[0.01]])),
            report_inverse(proper_inverse(chain, 0.1, 1.0), 0.1),
            data,
            fitted,
            fitted.identified,
            tcdyn.compare(data, ["P1", "P1D"]),
            validate(fitted),
            fitted.tune(),
            step_band(fitted.identified),
            bode_band(fitted.identified),
            spectral_estimate(data),
            predict(fitted, data),
            fit_function(data, static_gain, {"gain": 0.9}),
            sensor,
            sensor_history(measured, dates=dates),
            compare_sensors(measured[1:]),
            find_touches(time_s, touched, ["T1", "T2"]),
            compensate_table(folder / "log.csv", [sensor], folder / "out.csv"),
            follow(folder / "log.csv", [sensor], folder / "followed.csv", idle_s=0.0),
            compare_maps(maps, maps, ("slow_a", "slow_c")),
            fit_transducer([0.1, 0.2, 0.31, 0.15, 0.25], [0, 100, 200, 0, 100], [1, 1, 1, 2, 2]),
            fit_bearing_friction([100.0, 200, 300, 400], [1.0, 2.1, 2.9, 4.0], [500.0] * 4),
        ]
    )
