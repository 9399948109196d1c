"""Predicted response times against tables of makers.

`python -m tests.sensors.predict_study layered [SENSORS] [SEED]` prints the coverage of layered
sensors by finite volumes (``tests.sensors.layered_world``), with Hilpert's coefficients; half of
them have a gas gap of 10 to 60 um, wider than the prior.

`python -m tests.sensors.predict_study [all]` prints for each entry the value of the maker, the
prediction with its relative standard uncertainty and 95 % interval, and the share of entries
inside; with `all` the other sizes and the welded junctions of the first maker, too. The last part
compares the values in air at 2 m/s with predictions at 0.2 m/s, the speed that the page of the
maker prints.

Sources:

- SAB: sab-cable.com, "Reaction times of thermocouples and resistance thermometers". Values in water
  are of 0.2 to 0.4 m/s as VDI/VDE 3522 has it. The page prints 0.2 m/s for air, and
  electronic-sensor.de, "Sheathing thermocouple", prints the same numbers with 2 m/s.
- Temprel: temprelthermocouple.blogspot.com, 2012/04, time of two thirds of a step in water.
- ITS: Industrial Temperature Sensors, "Typical Thermocouple Response Times", column of 100 degC, in
  the data of the R package ``thermocouple`` 1.0.2; taken as times of 63.2 % in water.

The last two state no speed: 0.4 m/s (IEC 60751) to 0.9 m/s (ASTM E839), 0.65 +- 0.15 m/s.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from tcdyn.core.estimate import Estimate
from tcdyn.sensors import SensorFile, predict_sensor
from tests.sensors.layered_world import MEDIA, drawn

# Diameter [mm]: t50 and t90 [s] in water, t50 and t90 in air
SAB = {
    "insulated": {
        0.5: (0.06, 0.13, 1.8, 5.5),
        1.0: (0.15, 0.50, 3.0, 10.0),
        1.5: (0.21, 0.60, 8.0, 25.0),
        3.0: (1.20, 2.90, 23.0, 80.0),
        4.5: (2.50, 5.90, 37.0, 120.0),
        6.0: (4.00, 9.60, 60.0, 200.0),
        8.0: (7.00, 17.0, 100.0, 360.0),
    },
    "grounded": {
        0.5: (0.03, 0.10, 1.8, 6.0),
        1.0: (0.06, 0.18, 3.0, 10.0),
        1.5: (0.13, 0.40, 8.0, 25.0),
        3.0: (0.22, 0.75, 23.0, 80.0),
        4.5: (0.45, 1.60, 33.0, 110.0),
        6.0: (0.55, 2.60, 55.0, 185.0),
        8.0: (0.75, 4.60, 97.0, 310.0),
    },
}
SAB_SIZES_MM = (1.5, 3.0, 6.0)
# Diameter [mm]: time of 63.2 % [s], insulated and grounded
TEMPREL = {
    0.508: (0.03, 0.02),
    1.016: (0.13, 0.04),
    1.575: (0.40, 0.22),
    2.286: (0.68, 0.33),
    3.175: (1.10, 0.50),
    4.775: (2.30, 1.00),
    6.350: (4.10, 2.20),
}
ITS = {1.0: (0.16, 0.07), 1.5: (0.25, 0.14), 3.0: (1.0, 0.4), 6.0: (3.2, 1.6)}
SPEED_OF_SAB = {"water": "0.3+-0.06", "air": "2"}
SPEED_NOT_STATED = "0.65+-0.15"


@dataclass(frozen=True)
class Entry:
    """A value of a maker [s] and its prediction."""

    maker: str
    diameter_mm: float
    junction: str
    medium: str
    key: str
    value_s: float
    predicted: Estimate

    @property
    def is_inside(self) -> bool:
        """Whether the value is inside of the 95 % interval."""
        return self.predicted.contains(self.value_s)

    def __str__(self) -> str:
        """The entry as a row."""
        p = self.predicted
        return (
            f"{self.maker:8s}{self.diameter_mm:6.2f} mm {self.junction:10s}{self.medium:6s}"
            f"{self.key.removesuffix('_s'):5s}{self.value_s:8.3g} s  predicted {p.value:8.3g} s "
            f"+- {100 * p.u / p.value:2.0f} %  {p.low95:.3g} to {p.high95:.3g} s"
            f"{'' if self.is_inside else '  outside'}"
        )


def predicted(diameter_mm: float, junction: str, medium: str, speed: str) -> SensorFile:
    """Prediction for an entry."""
    return predict_sensor(diameter_mm, medium, junction=junction, speed_m_s=speed)


def sab_entries(junction: str, sizes_mm: tuple[float, ...], air_speed: str = "2") -> list[Entry]:
    """Entries of the first maker."""
    out = []
    for d in sizes_mm:
        values = SAB[junction][d]
        for medium, speed, pair in (
            ("water", SPEED_OF_SAB["water"], values[:2]),
            ("air", air_speed, values[2:]),
        ):
            times = predicted(d, junction, medium, speed).times["*"]
            out += [
                Entry("SAB", d, junction, medium, key, value, times[key])
                for key, value in zip(("t50_s", "t90_s"), pair)
            ]
    return out


def other_entries() -> list[Entry]:
    """Entries of the two other makers."""
    out = []
    for maker, table in (("Temprel", TEMPREL), ("ITS", ITS)):
        for d, values in table.items():
            for junction, value in zip(("insulated", "grounded"), values):
                times = predicted(d, junction, "water", SPEED_NOT_STATED).times["*"]
                out.append(Entry(maker, d, junction, "water", "t632_s", value, times["t632_s"]))
    return out


def print_entries(title: str, entries: list[Entry]) -> None:
    """Print entries and how many of them are inside."""
    inside = sum(entry.is_inside for entry in entries)
    largest = max(entry.predicted.u / entry.predicted.value for entry in entries)
    print(*entries, sep="\n")
    print(
        f"{title}: {inside} of {len(entries)} inside ({100 * inside / len(entries):.0f} %), "
        f"largest u {100 * largest:.0f} %\n",
        flush=True,
    )


def report(with_all: bool) -> None:
    """Print the tables."""
    required = sab_entries("insulated", SAB_SIZES_MM)
    others = other_entries()
    print_entries("SAB, insulated, 1.5 to 6 mm", required)
    print_entries("Temprel and ITS", others)
    if with_all:
        rest_mm = tuple(d for d in SAB["insulated"] if d not in SAB_SIZES_MM)
        rest = sab_entries("insulated", rest_mm) + sab_entries("grounded", tuple(SAB["grounded"]))
        print_entries("SAB, other sizes and welded", rest)
        inside = [entry.is_inside for entry in (*required, *others, *rest)]
        print(f"all: {sum(inside)} of {len(inside)} inside\n")
    slow = [e for e in sab_entries("insulated", SAB_SIZES_MM, "0.2") if e.medium == "air"]
    print_entries("the same values in air, predicted at 0.2 m/s", slow)


def report_layered(sensors: int = 60, seed: int = 352) -> None:
    """Print how often times of sensors by finite volumes are inside, with and without a gap."""
    for medium in MEDIA:
        rng = np.random.default_rng(seed)
        rows = []
        for _ in range(sensors):
            made = drawn(rng, medium)
            probe = predict_sensor(1e3 * made.diameter_m, medium, speed_m_s=made.speed_m_s)
            estimates = [probe.lag_s, *probe.times["*"].values()]
            inside = [e.contains(v) for e, v in zip(estimates, made.truth())]
            rows.append([made.gap_m > 0, *inside])
        table = np.array(rows)
        for has_gap, name in ((False, "without a gap"), (True, "with a gap")):
            covered = 100 * table[table[:, 0] == has_gap, 1:].mean(axis=0)
            print(f"{medium}, {name}: lag, t50, t63.2, t90 inside {covered.round()} %", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["layered"]:
        report_layered(*[int(word) for word in sys.argv[2:]])
    else:
        report(sys.argv[1:] == ["all"])
