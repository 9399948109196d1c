"""Files in the layouts of many loggers, each with a reader that is independent of tcdyn.

The layouts follow public descriptions (``SOURCES``); no file and no text is copied. Every file
holds the closed forms ``first_degC`` and, mostly, ``second_degC``, rounded to 0.01 in the unit of
the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from nptdms import ChannelObject, TdmsFile, TdmsWriter
from numpy.typing import NDArray
from pyarrow import parquet as pq

Array = NDArray[np.float64]
Reading = tuple[Array, list[Array]]

ROWS = 40
K = np.arange(ROWS)

# family: page that describes its layout
SOURCES = {
    "Campbell Scientific TOA5": "https://help.campbellsci.com/loggernet-manual/ln_manual/"
    "campbell_scientific_file_formats/toa5.htm",
    "Onset HOBOware": "https://rdrr.io/github/nicholas512/LoggerReadR/man/"
    "detect_hoboware_configuration.html",
    "Keysight 34970A, DAQ970A": "https://www.easymanua.ls/keysight/34972a/manual?p=186",
    "Hioki LR8431": "https://www.easymanua.ls/hioki/lr8431-20/manual?p=166",
    "Yokogawa DX, CX": "https://www.manualsdir.com/manuals/360233/"
    "yokogawa-button-operated-dx2000-button-operated-dx1000.html?page=347",
    "Fluke 2680A": "https://www.manualslib.com/manual/1211909/Fluke-2680a.html?page=245",
    "Graphtec GL": "https://github.com/HaralDev/GraphtecPython",
    "Pico PicoLog": "https://github.com/dgbowl/yadg",
    "National Instruments LVM": "https://www.ni.com/en/support/documentation/supplemental/06/"
    "specification-for-the-labview-measurement-file---lvm-.html",
    "National Instruments TDMS": "https://nptdms.readthedocs.io/en/stable/reading.html",
    "LabJack": "https://support.labjack.com/docs/3-4-ljlogger-u12-datasheet",
    "Siemens": "https://github.com/JakubVonkomer/PySimaticTrends",
    "Beckhoff TwinCAT Scope": "https://infosys.beckhoff.com/content/1033/te13xx_tc3_scopeview/"
    "6193063051.html",
    "Panasonic FPWIN": "https://infohub.industry.panasonic.eu/data/fpwin/en/topics/"
    "t-0000014608.html",
    "IDEC HG": "http://38.142.81.21:8001/manual/idec/high-performance-series/manual-english/"
    "page-882.html",
    "akYtec MSD200": "http://88.208.23.73:8080/en/manual/akytec/msd200/"
    "msd200_user-manual_2887626-24.html",
    "Sensormetrix Neon": "http://88.208.23.73:8080/en/manual/sensormetrix/neon-100/1244129?page=25",
    "dydaqlog": "https://meas.dydaqlog.de/static/html_Dokumentation/MEAS_FORMAT.html",
    "Thorlabs TSP01": "https://www.easymanua.ls/thorlabs/tsp01/manual/733381?p=15",
    "Schneider Electric": "https://filedn.eu/l6oFb0aAwOAyRLLaUMiUmzz/CE_HELP/fre/rtus/"
    "rtus_D-SE-0004789.htm",
    "Innovyze standard logger": "https://help.autodesk.com/cloudhelp/2026/ENU/INFOAMAN-Help/files/"
    "GUID-CB6DAE4E-E1D0-4154-AA1A-88A536C67997.htm",
    "ThingSpeak": "https://www.mathworks.com/help/thingspeak/readdata.html",
    "InfluxDB": "https://docs.influxdata.com/influxdb/cloud/reference/syntax/annotated-csv/",
    "Grafana": "https://github.com/grafana/grafana/pull/4041",
    "openSenseMap": "https://github.com/sensebox/OER/issues/11",
    "Joulescope": "https://github.com/jetperch/pyjoulescope_ui/issues/231",
    "Microchip Data Visualizer": "https://onlinedocs.microchip.com/oxy/GUID-4FF3C687-0C30-4D21-82D0"
    "-5AE401E8BE9D-en-US-11/GUID-6D2B490A-A171-4C9F-8F48-68438016B07D.html",
    "MCHobby SBK": "https://wiki.mchobby.be/index.php?diff=31728&oldid=31727&title=SBK-CSV-File",
    "Ansys Twin Builder": "https://ansyshelp.ansys.com/public/Views/Secured/Electronics/v251/en/"
    "Subsystems/TwinBuilder/Content/CSVFileFormat.htm",
    "HeaterMeter": "https://github.com/CapnBry/HeaterMeter/issues/47",
    "MATLAB": "https://www.mathworks.com/help/matlab/ref/writetimetable.html",
    "R": "https://search.r-project.org/CRAN/refmans/utils/html/write.table.html",
    "Excel": "https://rdrr.io/github/Ostluft/rOstluft/man/save_excel_csv.html",
    "Apache Parquet": "https://arrow.apache.org/docs/python/parquet.html",
}


def first_degC() -> Array:
    """A first-order step by 60 K, one time constant in nine rows."""
    return np.round(20 + 60 * (1 - np.exp(-K / 9)), 2)


def second_degC() -> Array:
    """A wave of 5 K about 25 degC."""
    return np.round(25 + 5 * np.sin(K / 6), 2)


@dataclass(frozen=True)
class LoggerFile:
    """One file of a family.

    Attributes
    ----------
    family, case
        Family, and what is special about the file.
    write
        Writes the file into a folder, and returns its path.
    read
        Independent reader: times since the first row (N,) [s], and columns (N,) [degC].
    columns
        Names of these columns in the file.
    time_unit, couple, cold
        What the user states on the command line.
    refusal
        Pattern of the error, if the file must be refused.
    interval_u
        Relative error of the interval that is allowed: of a clock with few decimals only.
    """

    family: str
    case: str
    write: Callable[[Path], Path]
    read: Callable[[Path], Reading]
    columns: tuple[str, ...] = ("T1",)
    time_unit: str | None = None
    couple: str = ""
    cold: float | str = 0.0
    refusal: str = ""
    interval_u: float = 0.0

    @property
    def name(self) -> str:
        """Family and case."""
        return f"{self.family}: {self.case}"


def stamps(form: str, step_s: float = 1.0, start: str = "2021-11-26 09:59:50") -> list[str]:
    """Stamps of all rows in a form of strftime, in which ``{ms}`` is the milliseconds."""
    out = []
    for k in K:
        moment = datetime.fromisoformat(start) + timedelta(seconds=float(k) * step_s)
        text = moment.strftime(form)
        out.append(text.replace("{ms}", f"{moment.microsecond // 1000:03}"))
    return out


def number(value: float, decimal: str = ".", digits: int = 2) -> str:
    """A number with this decimal mark."""
    return f"{value:.{digits}f}".replace(".", decimal)


def lines_of(separator: str, *columns: Sequence[Any], decimal: str = ".") -> list[str]:
    """One line a row; numbers have two decimals, words stay as they are."""
    lines = []
    for cells in zip(*columns, strict=True):
        texts = [c if isinstance(c, str) else number(float(c), decimal) for c in cells]
        lines.append(separator.join(texts))
    return lines


def text_file(
    lines: Sequence[str], encoding: str = "utf-8", end: str = "\n", name: str = "log.csv"
) -> Callable[[Path], Path]:
    """Writer of a text file."""

    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes((end.join(lines) + end).encode(encoding))
        return path

    return write


def same(values: Array) -> Array:
    return values


def from_degF(values: Array) -> Array:
    return (values - 32) / 1.8


def from_K(values: Array) -> Array:
    return values - 273.15


def by_pandas(
    time: int | list[int],
    values: Sequence[int],
    form: str = "",
    seconds: float = 1.0,
    convert: Callable[[Array], Array] = same,
    clean: Callable[[str], str] | None = None,
    **options: Any,
) -> Callable[[Path], Reading]:
    """Reader with pandas.read_csv and explicit options.

    Parameters
    ----------
    time, values
        Indices of the columns; two columns of time are joined by a space.
    form
        Form of the stamps for pandas.to_datetime; without it times are numbers.
    seconds
        Seconds per unit of a time of numbers.
    convert
        Conversion to degrees Celsius.
    clean
        Change of each cell of text before it is read as a number.
    options
        Of pandas.read_csv.
    """

    def read(path: Path) -> Reading:
        frame = pd.read_csv(path, header=None, skipinitialspace=True, **options)
        indices = [time] if isinstance(time, int) else time
        columns = [frame.iloc[:, k] for k in indices]
        if form:
            texts = columns[0].astype(str)
            for column in columns[1:]:
                texts = texts + " " + column.astype(str)
            moments = pd.to_datetime(texts, format=form, utc="%z" in form)
            times_s = (moments - moments.iloc[0]).dt.total_seconds().to_numpy(float)
        else:
            numbers = columns[0]
            if clean is not None and not pd.api.types.is_numeric_dtype(numbers):
                numbers = numbers.map(clean).astype(float)
            times_s = (numbers.to_numpy(float) - float(numbers.iloc[0])) * seconds
        out = []
        for k in values:
            column = frame.iloc[:, k]
            if clean is not None and not pd.api.types.is_numeric_dtype(column):
                column = column.astype(str).map(clean)
            out.append(convert(pd.to_numeric(column, errors="coerce").to_numpy(float)))
        return times_s, out

    return read


def by_csv(
    skip: int,
    separator: str,
    seconds_of: Callable[[list[str]], float],
    values_of: Callable[[list[str]], list[float]],
    encoding: str = "utf-8",
) -> Callable[[Path], Reading]:
    """Reader in plain Python: it splits each line of the first ``ROWS`` below ``skip`` lines."""

    def read(path: Path) -> Reading:
        lines = path.read_text(encoding).splitlines()[skip : skip + ROWS]
        rows = [[cell.strip().strip('"') for cell in line.split(separator)] for line in lines]
        times = np.array([seconds_of(row) for row in rows])
        values = np.array([values_of(row) for row in rows]).T
        return times - times[0], list(values)

    return read


def refused(_: Path) -> Reading:
    """No values: the file must be refused."""
    return np.empty(0), []


T1 = first_degC()
T2 = second_degC()
F1 = np.round(1.8 * T1 + 32, 2)
F2 = np.round(1.8 * T2 + 32, 2)
NUMBERS = [str(k) for k in K]
FILES: list[LoggerFile] = []


def add(family: str, case: str, lines: Sequence[str], read: Any, **rest: Any) -> None:
    """Add a text file to ``FILES``."""
    text_options = {key: rest.pop(key) for key in ("encoding", "end", "file") if key in rest}
    if "file" in text_options:
        text_options["name"] = text_options.pop("file")
    FILES.append(LoggerFile(family, case, text_file(lines, **text_options), read, **rest))


def _campbell() -> None:
    family = "Campbell Scientific TOA5"
    top = '"TOA5","kiln","CR1000","1031","CR1000.Std.32","CPU:kiln.CR1","4062","Table1"'

    def head(names: str, units: str, processing: str) -> list[str]:
        return [top, names, units, processing]

    time = [f'"{s}"' for s in stamps("%Y-%m-%d %H:%M:%S")]
    add(
        family,
        "four header rows",
        head(
            '"TIMESTAMP","RECORD","TC_Avg(1)","TC_Avg(2)"',
            '"TS","RN","Deg C","Deg C"',
            '"","","Avg","Avg"',
        )
        + lines_of(",", time, NUMBERS, T1, T2),
        by_pandas(0, [2, 3], "%Y-%m-%d %H:%M:%S", skiprows=4),
        columns=("TC_Avg(1)", "TC_Avg(2)"),
        end="\r\n",
        file="log.dat",
    )
    fine = [f'"{s[:-2]}"' for s in stamps("%Y-%m-%d %H:%M:%S.{ms}", 0.1)]
    words = [f"{t:.2f}" if k not in (7, 8) else '"NAN"' for k, t in enumerate(T1)]
    add(
        family,
        "ten rows a second, and NAN in quotes",
        head('"TIMESTAMP","RECORD","TC1"', '"TS","RN","C"', '"","","Smp"')
        + lines_of(",", fine, NUMBERS, words),
        by_pandas(0, [2], "%Y-%m-%d %H:%M:%S.%f", skiprows=4),
        columns=("TC1",),
    )
    add(
        family,
        "Fahrenheit, as wide as the first line",
        head(
            '"TIMESTAMP","RECORD","BattV","PTemp","TC1","TC2","RH","Flag"',
            '"TS","RN","Volts","Deg C","Deg F","Deg F","%",""',
            '"","","Min","Smp","Smp","Smp","Smp","Smp"',
        )
        + lines_of(",", time, NUMBERS, 0 * T1 + 12.9, T2, F1, F2, 0 * T1 + 41, NUMBERS),
        by_pandas(0, [4, 5], "%Y-%m-%d %H:%M:%S", convert=from_degF, skiprows=4),
        columns=("TC1", "TC2"),
    )
    night = [f'"{s}"' for s in stamps("%Y-%m-%d %H:%M:%S", 900.0, "2021-12-31 20:00:00")]
    add(
        family,
        "a row every 15 minutes through New Year",
        head('"TIMESTAMP","TC1"', '"TS","Deg C"', '"","Avg"') + lines_of(",", night, T1),
        by_pandas(0, [1], "%Y-%m-%d %H:%M:%S", skiprows=4),
        columns=("TC1",),
    )


def _hobo() -> None:
    family = "Onset HOBOware"
    title = '"Plot Title: kiln"'
    serial = "(LGR S/N: 2043, SEN S/N: 2043, LBL: door)"
    american = stamps("%m/%d/%y %I:%M:%S %p", 60.0)
    number_of = [str(k + 1) for k in K]
    add(
        family,
        "names with commas in quotes, 12-hour clock",
        [
            title,
            f'"#","Date Time, GMT+02:00","Temp, °C {serial}"',
            *lines_of(",", number_of, american, T1),
        ],
        by_pandas(1, [2], "%m/%d/%y %I:%M:%S %p", skiprows=2),
        columns=(f"Temp, °C {serial}",),
        encoding="utf-8-sig",
    )
    add(
        family,
        "Fahrenheit in the middle of a name",
        [
            title,
            f'"#","Date Time, GMT-05:00","Temp, °F {serial}","Intensity, lum/ft² {serial}"',
            *lines_of(",", number_of, american, F1, 0 * T1),
        ],
        by_pandas(1, [2], "%m/%d/%y %I:%M:%S %p", convert=from_degF, skiprows=2),
        columns=(f"Temp, °F {serial}",),
    )
    add(
        family,
        "date and time in two columns, semicolons, decimal comma",
        [
            "#;Date;Time, GMT+01:00;Temp, °C",
            *lines_of(
                ";", number_of, stamps("%d-%m-%Y", 60.0), stamps("%H:%M:%S", 60.0), T1, decimal=","
            ),
        ],
        by_pandas(
            [1, 2],
            [3],
            "%d-%m-%Y %H:%M:%S",
            sep=";",
            decimal=",",
            skiprows=1,
            encoding="cp1252",
        ),
        columns=("Temp, °C",),
        encoding="cp1252",
    )
    events = ["" if k else "Logged" for k in K]
    ends = ["" if k < ROWS - 1 else "Logged" for k in K]
    add(
        family,
        "columns of events",
        [
            title,
            f'"#","Date Time, GMT+02:00","Temp, °C {serial}","Host Connected","End Of File"',
            *lines_of(",", number_of, american, T1, events, ends),
        ],
        by_pandas(1, [2], "%m/%d/%y %I:%M:%S %p", skiprows=2),
        columns=(f"Temp, °C {serial}",),
    )
    thousands = [f'"{1000 + 10 * t:,.2f}"' for t in T1]
    add(
        family,
        "thousands separated by commas, in quotes",
        [title, '"#","Date Time","Temp (°C)"', *lines_of(",", number_of, american, thousands)],
        by_pandas(1, [2], "%m/%d/%y %I:%M:%S %p", skiprows=2, thousands=","),
        columns=("Temp (°C)",),
    )
    spaces = [f"{900 + 10 * t:,.2f}".replace(",", " ").replace(".", ",") for t in T1]
    add(
        family,
        "thousands separated by spaces, decimal comma",
        ["#\tDate Time\tTemp (°C)", *lines_of("\t", number_of, american, spaces)],
        by_pandas(1, [2], "%m/%d/%y %I:%M:%S %p", sep="\t", skiprows=1, decimal=",", thousands=" "),
        columns=("Temp (°C)",),
    )
    add(
        family,
        "saved again by a spreadsheet: minutes only",
        [
            "#,Date Time,Temp (°C)",
            *lines_of(",", number_of, stamps("%m/%d/%Y %H:%M", 300.0, "2021-11-26 09:40:00"), T1),
        ],
        by_pandas(1, [2], "%m/%d/%Y %H:%M", skiprows=1),
        columns=("Temp (°C)",),
    )


def _instruments() -> None:
    """Bench instruments and recorders."""
    family = "Keysight 34970A, DAQ970A"
    sweeps = [str(k + 1) for k in K]
    colon = stamps("%m/%d/%Y %H:%M:%S:{ms}", 0.5)
    add(
        family,
        "milliseconds behind a colon",
        ["Sweep #,Time,Chan 201 (C),Chan 202 (C)", *lines_of(",", sweeps, colon, T1, T2)],
        by_pandas(1, [2, 3], "%m/%d/%Y %H:%M:%S:%f", skiprows=1),
        columns=("Chan 201 (C)", "Chan 202 (C)"),
    )
    codes = ["+9.90000000E+37" if k in (5, 20) else f"{t:+.8E}" for k, t in enumerate(T1)]
    add(
        family,
        "overload as 9.9E+37",
        [
            "Scan,Time,101 <oven> (C),Alarm 101",
            *lines_of(",", sweeps, colon, codes, ["0" for _ in K]),
        ],
        by_pandas(1, [2], "%m/%d/%Y %H:%M:%S:%f", convert=_without_overload, skiprows=1),
        columns=("101 <oven> (C)",),
    )
    add(
        family,
        "volts",
        [
            "Sweep #,Time,Chan 201 (VDC),Chan 202 (C)",
            *lines_of(",", sweeps, colon, T1 * 0 + 1.23, T2),
        ],
        by_pandas(1, [3], "%m/%d/%Y %H:%M:%S:%f", skiprows=1),
        columns=("Chan 202 (C)",),
    )
    family = "Hioki LR8431"
    block = [
        '"File name","WAVE0001.CSV","V 1.00"',
        '"Title comment",""',
        '"Trigger Time","\'21-11-26 09:59:50"',
        '"Ch","Mode","Range","Comment","Scaling","Ratio","Offset"',
        '"CH-1","Tc","2000 C","","Off","-","-"',
        '"CH-2","Tc","2000 C","","Off","-","-"',
        '"ALM","Alarm","","",',
    ]
    seconds = [f"{0.1 * k:.9E}" for k in K]
    readings = [[f" {t:.5E}" for t in values] for values in (T1, T2)]
    add(
        family,
        "block of settings, times in the E format",
        [*block, '"Time","CH-1[C]","CH-2[C]","ALM-CH1",']
        + [line + "," for line in lines_of(",", seconds, *readings, [" 0" for _ in K])],
        by_pandas(0, [1, 2], skiprows=8),
        columns=("CH-1[C]", "CH-2[C]"),
    )
    add(
        family,
        "a row every ten seconds",
        [
            *block,
            '"Time","CH-1[C]","Event"',
            *lines_of(",", [f"{10 * k:.9E}" for k in K], readings[0], ["0" for _ in K]),
        ],
        by_pandas(0, [1], skiprows=8),
        columns=("CH-1[C]",),
        time_unit="s",
    )
    family = "Yokogawa DX, CX"
    slashes = stamps("%Y/%m/%d %H:%M:%S", 2.0)
    add(
        family,
        "tabs, tags and units above the rows",
        [
            "YREC",
            "Manual Sample Data\tVersion 1.02.00",
            "Model\tDX2000",
            "Language Code\tshift-JIS",
            "File Status\tComplete",
            "Serial No.\tS5A1",
            "Ch\t0001\t0002",
            "Tag\tOven\tBath",
            "Unit\tC\tC",
            *lines_of("\t", slashes, T1, T2),
        ],
        by_pandas(0, [1, 2], "%Y/%m/%d %H:%M:%S", sep="\t", skiprows=9),
        columns=("Oven", "Bath"),
        end="\r\n",
    )
    padded = [[f"{t:8.2f}" for t in values] for values in (T1, T2)]
    quoted_head = [
        '"MANUAL SAMPLE DATA"',
        '"Model Serial No.:","12A338617       "',
        '"File Header:","kiln            "',
    ]
    names = ['"CH/TAG","CH01            ","CH02            "', '"UNIT","C     ","C     "']
    rows = lines_of(",", slashes, *padded)
    add(
        family,
        "commas, names padded with spaces",
        [*quoted_head, *names, *rows],
        by_pandas(0, [1, 2], "%Y/%m/%d %H:%M:%S", skiprows=5),
        columns=("CH01", "CH02"),
    )
    add(
        family,
        "the header again in the middle",
        [*quoted_head, *names, *rows[:20], *names, *rows[20:]],
        refused,
        columns=("CH01",),
        refusal="row|time",
    )
    family = "Fluke 2680A"
    block = ['"kiln.csv"', '"11/26/2021 09:59:50"', '"two couples"', "3"]
    fluke = stamps("%m/%d/%Y %H:%M:%S.{ms}", 0.25)
    add(
        family,
        "number of columns, channels, units",
        [*block, '"Date/Time","0101","0102"', '"","C","C"', *lines_of(",", fluke, T1, T2)],
        by_pandas(0, [1, 2], "%m/%d/%Y %H:%M:%S.%f", skiprows=6),
        columns=("0101", "0102"),
    )
    broken = ["+9.0E+9" if k in (11, 12, 30) else f"{t:.2f}" for k, t in enumerate(T1)]
    add(
        family,
        "an open thermocouple as 9.0E+9",
        [*block, '"Date/Time","0101","0102"', '"","C","C"', *lines_of(",", fluke, broken, T2)],
        by_pandas(0, [1, 2], "%m/%d/%Y %H:%M:%S.%f", convert=_without_overload, skiprows=6),
        columns=("0101", "0102"),
    )
    family = "Graphtec GL"
    block = [
        "Vendor,GRAPHTEC Corporation",
        "Model,GL240",
        "Sampling interval,100ms",
        "Total data points,40",
        "Start time,2021-11-26,09:59:50",
        "AMP Settings",
        "CH,Signal name,Input,Range,Filter,Span",
        'CH1, " CH 1",TEMP,TC_K,5,70.000000,20.000000,degC',
        'CH2, " CH 2",TEMP,TC_K,5,70.000000,20.000000,degC',
        "Logic/Pulse,Off",
        "Data",
        "Number,Date&Time,ms,CH1,CH2,Alarm1-10,AlarmOut",
        "NO.,Time,ms,degC,degC,A1234567890,A1234",
    ]
    whole = stamps("%Y/%m/%d %H:%M:%S", 0.1)
    parts = [str(100 * (k % 10)) for k in K]
    alarm = ["LLLLLLLLLL" for _ in K]
    output = ["LLLL" for _ in K]
    read_ms = by_csv(
        len(block),
        ",",
        lambda row: (
            datetime.strptime(row[1], "%Y/%m/%d %H:%M:%S").timestamp() + 1e-3 * float(row[2])
        ),
        lambda row: [float(row[3]), np.nan if "B" in row[4] else float(row[4])],
    )
    add(
        family,
        "milliseconds in a column of their own",
        block + lines_of(",", sweeps, whole, parts, T1, T2, alarm, output),
        read_ms,
        columns=("CH1", "CH2"),
    )
    burnt = [" BURNOUT" if k > 30 else f"{t:+9.2f}" for k, t in enumerate(T2)]
    add(
        family,
        "the word BURNOUT",
        block + lines_of(",", sweeps, whole, parts, T1, burnt, alarm, output),
        read_ms,
        columns=("CH1", "CH2"),
    )
    family = "Pico PicoLog"
    iso = stamps("%Y-%m-%dT%H:%M:%S-07:00", 2.0)
    add(
        family,
        "no name above the stamps",
        ['"","Oven Ave. (C)","Bath Ave. (C)"', *lines_of(",", [f'"{s}"' for s in iso], T1, T2)],
        by_pandas(0, [1, 2], "%Y-%m-%dT%H:%M:%S%z", skiprows=1),
        columns=("Oven Ave. (C)", "Bath Ave. (C)"),
    )
    add(
        family,
        "degree sign, blanks before the first value of a slow channel",
        [
            ",Oven Last (°C),Bath Last (°C)",
            *lines_of(",", iso, T1, ["" if k % 4 else f"{t:.2f}" for k, t in enumerate(T2)]),
        ],
        by_pandas(0, [1, 2], "%Y-%m-%dT%H:%M:%S%z", skiprows=1),
        columns=("Oven Last (°C)", "Bath Last (°C)"),
    )
    family = "Thorlabs TSP01"
    missing = ["--.---" for _ in K]
    add(
        family,
        "minus signs instead of a value",
        [
            "Time [s]\tTemperature[°C]\tTH1[°C]\tRemarks",
            *lines_of("\t", [str(k) for k in K], T1, missing, ["" for _ in K]),
        ],
        by_pandas(0, [1], sep="\t", skiprows=1),
        columns=("Temperature[°C]",),
    )


def _without_overload(values: Array) -> Array:
    return np.where(np.abs(values) > 1e6, np.nan, values)


def _controllers() -> None:
    """Controllers and panels."""
    family = "Siemens"
    iso = stamps("%Y-%m-%d %H:%M:%S", 1.0)
    days = [f"{1e6 * (44526.41655 + k / 86400):.6f}" for k in K]
    add(
        family,
        "panel: a column of names, and days in Time_ms",
        [
            '"VarName"\t"TimeString"\t"VarValue"\t"Validity"\t"Time_ms"',
            *lines_of(
                "\t", ['"Oven"' for _ in K], [f'"{s}"' for s in iso], T1, ["1" for _ in K], days
            ),
        ],
        by_pandas(1, [2], "%Y-%m-%d %H:%M:%S", sep="\t", skiprows=1),
        columns=("VarValue",),
        file="Data_log0.txt",
    )
    german = stamps("%d.%m.%Y %H:%M:%S", 10.0)
    add(
        family,
        "trend with a block of text above it, decimal comma",
        [
            "Anlage;Ofen 3",
            "Geräteadresse;0.2.150",
            "Abfrageintervall;10",
            "Zeitstempel;Vorlauf [°C];Rücklauf [°C]",
            *lines_of(";", german, T1, T2, decimal=","),
        ],
        by_pandas(
            0,
            [1, 2],
            "%d.%m.%Y %H:%M:%S",
            sep=";",
            decimal=",",
            skiprows=4,
            encoding="cp1252",
        ),
        columns=("Vorlauf [°C]", "Rücklauf [°C]"),
        encoding="cp1252",
        end="\r\n",
    )
    family = "Beckhoff TwinCAT Scope"
    ms = [str(250 * k) for k in K]
    add(
        family,
        "milliseconds, and a last row EOF",
        ["Name\tOven", "File\tscope.csv", "", "Time [ms]\tOven", *lines_of("\t", ms, T1), "EOF"],
        by_csv(4, "\t", lambda row: 1e-3 * float(row[0]), lambda row: [float(row[1])]),
        columns=("Oven",),
    )
    family = "Panasonic FPWIN"
    date = stamps("%Y/%m/%d", 1.0)
    clock = stamps("%H:%M:%S", 1.0)
    add(
        family,
        "numbers as names, then names, comments and units",
        [
            "Date,Time,1,2",
            ",,oven,bath",
            ",,COM1,COM1",
            ",,DT100,DT101",
            ",,degC,degC",
            *lines_of(",", date, clock, T1, T2),
        ],
        by_pandas([0, 1], [2, 3], "%Y/%m/%d %H:%M:%S", skiprows=5),
        columns=("1", "2"),
    )
    family = "IDEC HG"
    add(
        family,
        "stamps with a space before them, in quotes",
        [
            '"Project Name","Kiln","V4.50","English"',
            '"File Type","Data Log Data"',
            "",
            '"Channel No.","1"',
            '"Title Font","English"',
            "",
            '"Sampling Time","Data001","Data002"',
            *lines_of(",", [f'" {s}"' for s in stamps("%m/%d/%Y %H:%M:%S", 5.0)], T1, T2),
        ],
        by_csv(
            7,
            ",",
            lambda row: datetime.strptime(row[0].strip(), "%m/%d/%Y %H:%M:%S").timestamp(),
            lambda row: [float(row[1]), float(row[2])],
        ),
        columns=("Data001", "Data002"),
    )
    family = "akYtec MSD200"
    add(
        family,
        "empty fields of channels that are off",
        [
            "Time;Oven;;;Bath;;",
            *lines_of(
                ";", stamps("%H:%M:%S"), T1, *([["" for _ in K]] * 2), T2, *([["" for _ in K]] * 2)
            ),
        ],
        by_pandas(0, [1, 4], "%H:%M:%S", sep=";", skiprows=1),
        columns=("Oven", "Bath"),
    )
    add(
        family,
        "a clock that passes midnight",
        ["Time;Oven", *lines_of(";", stamps("%H:%M:%S", 1.0, "2021-11-26 23:59:45"), T1)],
        by_csv(
            1,
            ";",
            lambda row: (
                float(row[0][6:]) + 60 * float(row[0][3:5]) + 3600 * ((float(row[0][:2]) + 1) % 24)
            ),
            lambda row: [float(row[1])],
        ),
        columns=("Oven",),
    )
    family = "Sensormetrix Neon"
    add(
        family,
        "no header",
        lines_of(
            ",",
            stamps("%d-%m-%Y", 60.0),
            stamps("%H:%M:%S", 60.0),
            ["L" for _ in K],
            [f"{t:+07.2f}" for t in T1],
            ["L" for _ in K],
            [f"{t:+07.2f}" for t in T2],
        ),
        refused,
        columns=("T1",),
        refusal="no header row",
    )
    family = "dydaqlog"
    epoch = [str(1637920790000 + 500 * k) for k in K]
    add(
        family,
        "descriptions and units, epoch and local time, milliseconds apart",
        [
            "Sequence number;Time Code;Local Date;Local Time;Milliseconds;Data quality;TC1;TC2",
            "number;since 1970;date;time;part;not used;oven;bath",
            ";ms;;;ms;;°C;°C",
            *lines_of(
                ";",
                NUMBERS,
                epoch,
                stamps("%d.%m.%Y", 0.5),
                stamps("%H:%M:%S", 0.5),
                [str(500 * (k % 2)) for k in K],
                ["0" for _ in K],
                T1,
                T2,
            ),
        ],
        by_pandas(1, [6, 7], seconds=1e-3, sep=";", skiprows=3),
        columns=("TC1", "TC2"),
    )
    family = "Schneider Electric"
    add(
        family,
        "a separator at the end of each line",
        ["Date;plc.oven;plc.bath;"]
        + [line + ";" for line in lines_of(";", stamps("%Y-%m-%d %H:%M:%S"), T1, T2)],
        by_pandas(0, [1, 2], "%Y-%m-%d %H:%M:%S", sep=";", skiprows=1),
        columns=("plc.oven", "plc.bath"),
    )
    family = "Innovyze standard logger"
    add(
        family,
        "no column of time",
        [
            '"text","Title: kiln"',
            '"ch",1,"temperature","C"',
            '"ch",2,"temperature","C"',
            '"time",26/11/21,09:59,15.0,"min",40',
            *lines_of(",", T1, T2),
        ],
        refused,
        columns=("T1",),
        refusal="no time column|header",
    )


def _national_instruments() -> None:
    family = "National Instruments LVM"

    def lvm(
        head: dict[str, str], segment: list[str], names: str, rows: list[str], separator: str = "\t"
    ) -> list[str]:
        top = ["LabVIEW Measurement", *[f"{k}{separator}{v}" for k, v in head.items()]]
        return [*top, "***End_of_Header***", "", *segment, "***End_of_Header***", names, *rows]

    head = {
        "Writer_Version": "2",
        "Reader_Version": "2",
        "Separator": "Tab",
        "Decimal_Separator": ".",
        "Multi_Headings": "No",
        "X_Columns": "One",
        "Time_Pref": "Relative",
        "Date": "2021/11/26",
        "Time": "09:59:50.5",
    }
    x = [f"{0.2 * k:.6f}" for k in K]
    add(
        family,
        "one column X",
        lvm(
            head,
            ["Channels\t2", "Samples\t40\t40", "X0\t0.0\t0.0", "Delta_X\t0.2\t0.2"],
            "X_Value\tOven\tBath\tComment",
            [line + "\t" for line in lines_of("\t", x, T1, T2)],
        ),
        by_pandas(0, [1, 2], sep="\t", skiprows=18),
        columns=("Oven", "Bath"),
        file="log.lvm",
        end="\r\n",
    )
    add(
        family,
        "a column X for each channel",
        lvm(
            {**head, "X_Columns": "Multi"},
            ["Channels\t2", "X0\t0.0\t\t0.0", "Delta_X\t0.2\t\t0.2"],
            "X_Value\tOven\tX_Value\tBath\tComment",
            lines_of("\t", x, T1, x, T2),
        ),
        by_pandas(0, [1, 3], sep="\t", skiprows=17),
        columns=("Oven", "Bath"),
        file="log.lvm",
    )
    add(
        family,
        "no column X",
        lvm(
            {**head, "X_Columns": "No"},
            ["Channels\t1", "X0\t0.0", "Delta_X\t0.2"],
            "X_Value\tOven\tComment",
            ["\t" + line for line in lines_of("\t", T1)],
        ),
        lambda path: (
            0.2 * K,
            [pd.read_csv(path, sep="\t", skiprows=17, header=None)[1].to_numpy(float)],
        ),
        columns=("Oven",),
        file="log.lvm",
    )
    add(
        family,
        "decimal comma, semicolons",
        lvm(
            {**head, "Separator": "Semicolon", "Decimal_Separator": ","},
            ["Channels;1", "X0;0,0", "Delta_X;0,2"],
            "X_Value;Oven;Comment",
            lines_of(";", [v.replace(".", ",") for v in x], T1, decimal=","),
            ";",
        ),
        by_pandas(0, [1], sep=";", decimal=",", skiprows=17),
        columns=("Oven",),
        file="log.lvm",
    )
    family = "National Instruments TDMS"
    start = np.datetime64("2021-11-26T09:59:50.000000")

    def tdms(*channels: ChannelObject) -> Callable[[Path], Path]:
        def write(folder: Path) -> Path:
            path = folder / "log.tdms"
            with TdmsWriter(path) as writer:
                writer.write_segment(channels)
            return path

        return write

    def track(group: str, name: str, values: Array, **properties: Any) -> ChannelObject:
        given = {"wf_increment": 0.1, "wf_start_time": start, "wf_start_offset": 0.0, **properties}
        return ChannelObject(group, name, values, properties=given)

    def read_tracks(*paths: str) -> Callable[[Path], Reading]:
        def read(path: Path) -> Reading:
            file = TdmsFile.read(path)
            channels = [file[p.split("/")[0]][p.split("/")[1]] for p in paths]
            times = channels[0].time_track()
            return times - times[0], [np.asarray(c[:], float) for c in channels]

        return read

    for case, file, names, reader in (
        (
            "a time track on each channel",
            tdms(track("Log", "Oven", T1), track("Log", "Bath", T2)),
            ("Oven", "Bath"),
            read_tracks("Log/Oven", "Log/Bath"),
        ),
        (
            "one name in two groups",
            tdms(track("Raw", "Oven", T1), track("Scaled", "Oven", F1)),
            ("Raw/Oven",),
            read_tracks("Raw/Oven"),
        ),
        (
            "single precision, unit in the properties",
            tdms(track("Log", "Oven", T1.astype(np.float32), unit_string="°C")),
            ("Oven",),
            read_tracks("Log/Oven"),
        ),
        (
            "stamps in a channel",
            tdms(
                ChannelObject(
                    "Log", "Time", start + (K * 500).astype("timedelta64[ms]").astype("<m8[us]")
                ),
                ChannelObject("Log", "Oven", T1),
            ),
            ("Oven",),
            lambda path: (
                0.5 * K,
                [np.asarray(TdmsFile.read(path)["Log"]["Oven"][:], float)],
            ),
        ),
    ):
        FILES.append(LoggerFile(family, case, file, reader, columns=names))
    FILES.append(
        LoggerFile(
            family,
            "one name in two groups, asked for without its group",
            tdms(track("Raw", "Oven", T1), track("Scaled", "Oven", F1)),
            refused,
            columns=("Oven",),
            refusal="Raw/Oven",
        )
    )


def _parquet() -> None:
    family = "Apache Parquet"

    def parquet(columns: dict[str, Any]) -> Callable[[Path], Path]:
        def write(folder: Path) -> Path:
            pq.write_table(pa.table(columns), folder / "log.parquet")
            return folder / "log.parquet"

        return write

    moments = pd.date_range("2021-10-31 01:59:40", periods=ROWS, freq="s", tz="Europe/Berlin")

    def read(time: str, seconds: float | None) -> Callable[[Path], Reading]:
        def reading(path: Path) -> Reading:
            table = pq.read_table(path)
            times = table[time].to_pandas()
            since = times - times.iloc[0]
            if seconds is None:
                times_s = since.dt.total_seconds().to_numpy(float)
            else:
                times_s = seconds * since.to_numpy(float)
            return times_s, [table["T1"].to_pandas().to_numpy(float)]

        return reading

    for case, columns, reader in (
        ("stamps with a time zone", {"timestamp": moments, "T1": T1}, read("timestamp", None)),
        (
            "durations",
            {"elapsed": pa.array(K * 250_000, pa.duration("us")), "T1": T1},
            read("elapsed", None),
        ),
        ("milliseconds as integers", {"Time [ms]": K * 250, "T1": T1}, read("Time [ms]", 1e-3)),
        (
            "stamps as text",
            {"datetime": stamps("%Y-%m-%dT%H:%M:%SZ"), "T1": T1.astype(np.float32)},
            lambda path: (K.astype(float), [pq.read_table(path)["T1"].to_numpy().astype(float)]),
        ),
    ):
        FILES.append(LoggerFile(family, case, parquet(columns), reader))


def _cloud() -> None:
    """Data bases, web services and programs."""
    family = "ThingSpeak"
    add(
        family,
        "UTC behind the stamps",
        [
            "created_at,entry_id,field1,field2",
            *lines_of(",", stamps("%Y-%m-%d %H:%M:%S UTC", 15.0), NUMBERS, T1, T2),
        ],
        by_pandas(0, [2, 3], "%Y-%m-%d %H:%M:%S UTC", skiprows=1),
        columns=("field1", "field2"),
    )
    before = stamps("%Y-%m-%dT%H:%M:%S+02:00", 15.0, "2021-10-31 02:55:00")[:20]
    after = stamps("%Y-%m-%dT%H:%M:%S+01:00", 15.0, "2021-10-31 01:55:00")[20:]
    add(
        family,
        "offset that changes with daylight saving time",
        ["created_at,entry_id,field1", *lines_of(",", before + after, NUMBERS, T1)],
        by_pandas(0, [2], "%Y-%m-%dT%H:%M:%S%z", skiprows=1),
        columns=("field1",),
    )
    family = "InfluxDB"
    zulu = stamps("%Y-%m-%dT%H:%M:%SZ", 2.0)
    notes = [
        "#group,false,false,true,true,false,false,true,true",
        "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,"
        "string",
        "#default,mean,,,,,,,",
        ",result,table,_start,_stop,_time,_value,_field,_measurement",
    ]

    def flux(table: int, values: Array) -> list[str]:
        start = ["2021-11-26T00:00:00Z" for _ in K]
        stop = ["2021-11-27T00:00:00.5Z" for _ in K]
        return lines_of(
            ",",
            ["" for _ in K],
            ["" for _ in K],
            [str(table) for _ in K],
            start,
            stop,
            zulu,
            values,
            ["oven" for _ in K],
            ["tc" for _ in K],
        )

    add(
        family,
        "annotations, and words in other columns",
        notes + flux(0, T1),
        by_pandas(5, [6], "%Y-%m-%dT%H:%M:%SZ", skiprows=4),
        columns=("_value",),
        end="\r\n",
    )
    add(
        family,
        "two tables one after the other",
        notes + flux(0, T1) + flux(1, T2),
        refused,
        columns=("_value",),
        refusal="backward",
    )
    family = "Grafana"
    iso = stamps("%Y-%m-%dT%H:%M:%S.000Z", 60.0)
    add(
        family,
        "semicolons, points, stamps with Z",
        ["Time;oven;bath", *lines_of(";", iso, T1, T2)],
        by_pandas(0, [1, 2], "%Y-%m-%dT%H:%M:%S.%fZ", sep=";", skiprows=1),
        columns=("oven", "bath"),
    )
    plain = stamps("%Y-%m-%d %H:%M:%S", 60.0)
    add(
        family,
        "the unit in each cell",
        ['"Time","oven"', *lines_of(",", [f'"{s}"' for s in plain], [f'"{t:.2f} °C"' for t in T1])],
        by_pandas(
            0, [1], "%Y-%m-%d %H:%M:%S", clean=lambda text: text.replace(" °C", ""), skiprows=1
        ),
        columns=("oven",),
    )
    epoch = [str(1637920790000 + 500 * k) for k in K]
    add(
        family,
        "milliseconds since 1970, the unit stated by the user",
        ['"Time","oven"', *lines_of(",", epoch, T1)],
        by_pandas(0, [1], seconds=1e-3, skiprows=1),
        columns=("oven",),
        time_unit="ms",
    )
    add(
        family,
        "milliseconds since 1970 without a unit",
        ['"Time","oven"', *lines_of(",", epoch, T1)],
        refused,
        columns=("oven",),
        refusal="time_unit=ms",
    )
    add(
        family,
        "a first line for spreadsheets",
        [
            "sep=,",
            '"Time","oven °F"',
            *lines_of(",", [f'"{s}"' for s in plain], [f'"{t:.2f}"' for t in F1]),
        ],
        by_pandas(0, [1], "%Y-%m-%d %H:%M:%S", convert=from_degF, skiprows=2),
        columns=("oven °F",),
    )
    family = "openSenseMap"
    quoted = [f'"{s[:-3]}.561Z"' for s in stamps("%Y-%m-%dT%H:%M:%S  0", 1.0)]
    add(
        family,
        "every cell in quotes",
        ['"createdAt","value"', *lines_of(",", quoted, [f'"{t:.2f}"' for t in T1])],
        by_pandas(0, [1], "%Y-%m-%dT%H:%M:%S.%fZ", skiprows=1),
        columns=("value",),
    )
    family = "Joulescope"
    add(
        family,
        "the header as a comment",
        [
            "#time,current,oven",
            *lines_of(",", [f"{0.5 * k:.1f}" for k in K], [f"{-0.0006 * k:.6g}" for k in K], T1),
        ],
        by_pandas(0, [2], skiprows=1),
        columns=("oven",),
    )
    add(
        family,
        "stamps without marks",
        [
            "#utc,current,oven",
            *lines_of(
                ",", stamps("%Y%m%dT%H%M%S.{ms}Z", 0.5), [f"{-0.0006 * k:.6g}" for k in K], T1
            ),
        ],
        by_pandas(0, [2], "%Y%m%dT%H%M%S.%fZ", skiprows=1),
        columns=("oven",),
    )
    family = "Microchip Data Visualizer"
    add(
        family,
        "seconds since the program began",
        [
            "timestamp,demo_uint8,demo_float",
            *lines_of(",", [f"{1019.643276 + 0.1 * k:.6f}" for k in K], NUMBERS, T1),
        ],
        by_pandas(0, [2], skiprows=1),
        columns=("demo_float",),
    )
    family = "MCHobby SBK"
    add(
        family,
        "day first, spaces after the commas",
        ['"iter","datetime","Pression Atmosphérique (hectopascal)","Temperature (Celsius)"']
        + [
            f"{k},{s}, 990.92, {t:.2f}"
            for k, s, t in zip(K, stamps("%d/%m/%Y %H:%M:%S", 1.0, "2021-01-13 23:59:50"), T1)
        ],
        by_pandas(1, [3], "%d/%m/%Y %H:%M:%S", skiprows=1),
        columns=("Temperature (Celsius)",),
    )
    family = "Ansys Twin Builder"
    add(
        family,
        "name and unit in quotes",
        [
            '"Time [ms]", "Oven.T [K]", "C1.I [uA]"',
            *lines_of(",", [f"{20.0 * k:g}" for k in K], T1 + 273.15, T2),
        ],
        by_pandas(0, [1], seconds=1e-3, convert=from_K, skiprows=1),
        columns=("Oven.T [K]",),
    )
    family = "HeaterMeter"
    add(
        family,
        "seconds since 1970, no header",
        lines_of(",", [str(1553424480 + 60 * k) for k in K], ["nan" for _ in K], T1),
        refused,
        columns=("T1",),
        refusal="no header row",
    )
    family = "LabJack"
    add(
        family,
        "seconds since 1904",
        [
            "Time\tv0\ty0",
            *lines_of("\t", [f"{3720751190 + 0.5 * k:.3f}" for k in K], ["0.1" for _ in K], T1),
        ],
        by_pandas(0, [2], sep="\t", skiprows=1),
        columns=("y0",),
        file="data.dat",
    )


def _mathematics() -> None:
    """Programs of analysis and spreadsheets."""
    family = "MATLAB"
    add(
        family,
        "durations with their unit in each cell",
        ["RowTimes,Reading1", *lines_of(",", [f"{0.5 * k:g} sec" for k in K], T1)],
        by_pandas(0, [1], clean=lambda text: text.removesuffix(" sec"), skiprows=1),
        columns=("Reading1",),
    )
    add(
        family,
        "names of months, bars between columns",
        [
            "Timestamps|Oven",
            *lines_of("|", stamps("%d-%b-%Y %H:%M:%S", 60.0, "2021-02-28 23:40:00"), T1),
        ],
        by_pandas(0, [1], "%d-%b-%Y %H:%M:%S", sep="|", skiprows=1),
        columns=("Oven",),
    )
    add(
        family,
        "days, hours, minutes and seconds",
        ["Time,Oven", *lines_of(",", [f"01:{k // 60 + 3:02}:{k % 60:02}:00" for k in 2 * K], T1)],
        by_csv(
            1,
            ",",
            lambda row: 3600 * float(row[0][3:5]) + 60 * float(row[0][6:8]),
            lambda row: [float(row[1])],
        ),
        columns=("Oven",),
    )
    family = "R"
    tenths = [number(0.1 * k, ",", 1) for k in K]
    add(
        family,
        "write.csv2: row names, decimal comma, NA",
        [
            '"";"t";"T1"',
            *lines_of(
                ";",
                [f'"{k + 1}"' for k in K],
                tenths,
                ["NA" if k == 9 else number(t, ",") for k, t in enumerate(T1)],
            ),
        ],
        by_pandas(1, [2], sep=";", decimal=",", skiprows=1),
    )
    add(
        family,
        "write.table: a header without the row names",
        ['"t" "T1"', *lines_of(" ", [f'"{k + 1}"' for k in K], [f"{0.1 * k:.1f}" for k in K], T1)],
        by_pandas(1, [2], sep=" ", skiprows=1),
    )
    add(
        family,
        "write.csv: stamps in quotes",
        ['"time","T1"', *lines_of(",", [f'"{s}"' for s in stamps("%Y-%m-%d %H:%M:%S")], T1)],
        by_pandas(0, [1], "%Y-%m-%d %H:%M:%S", skiprows=1),
    )
    family = "Excel"
    add(
        family,
        "German: day.month.year, minutes, decimal comma",
        [
            "Datum;Temperatur °C",
            *lines_of(";", stamps("%d.%m.%Y %H:%M", 120.0, "2021-11-26 23:00:00"), T1, decimal=","),
        ],
        by_pandas(0, [1], "%d.%m.%Y %H:%M", sep=";", decimal=",", skiprows=1, encoding="cp1252"),
        columns=("Temperatur °C",),
        encoding="cp1252",
        end="\r\n",
    )
    add(
        family,
        "French: seconds, line break in a quoted name",
        ['"Temps (s)";"Température', '(°C)"', *lines_of(";", tenths, T1, decimal=",")],
        by_pandas(0, [1], sep=";", decimal=",", skiprows=1),
        columns=("Température (°C)",),
        encoding="utf-8-sig",
    )
    add(
        family,
        "Spanish: date and time apart, day first",
        [
            "Fecha;Hora;Horno (°C)",
            *lines_of(
                ";",
                stamps("%d/%m/%Y", 1.0, "2021-03-12 23:59:50"),
                stamps("%H:%M:%S", 1.0, "2021-03-12 23:59:50"),
                T1,
                decimal=",",
            ),
        ],
        by_pandas([0, 1], [2], "%d/%m/%Y %H:%M:%S", sep=";", decimal=",", skiprows=1),
        columns=("Horno (°C)",),
    )
    add(
        family,
        "Unicode text: UTF-16 and tabs",
        [
            "Zeit [min]\tOfen [K]",
            *lines_of("\t", [number(0.5 * k, ",", 1) for k in K], T1 + 273.15, decimal=","),
        ],
        by_pandas(
            0,
            [1],
            seconds=60.0,
            convert=from_K,
            sep="\t",
            decimal=",",
            skiprows=1,
            encoding="utf-16",
        ),
        columns=("Ofen [K]",),
        encoding="utf-16",
    )
    swiss = [f"{990 + t:,.2f}".replace(",", "'") for t in T1]
    add(
        family,
        "Swiss: apostrophes between thousands",
        ["Zeit [s];Ofen [°C]", *lines_of(";", [f"{0.5 * k:.1f}" for k in K], swiss)],
        by_pandas(0, [1], sep=";", thousands="'", skiprows=1),
        columns=("Ofen [°C]",),
    )
    add(
        family,
        "decimal commas in quotes between commas",
        [
            "time,T1",
            *lines_of(",", [f'"{v}"' for v in tenths], [f'"{number(t, ",")}"' for t in T1]),
        ],
        by_pandas(0, [1], decimal=",", skiprows=1),
    )
    add(
        family,
        "a stopwatch of minutes and seconds",
        ["Time,T1", *lines_of(",", [f"{k // 60:02}:{k % 60:02}.5" for k in 2 * K], T1)],
        by_csv(
            1,
            ",",
            lambda row: 60 * float(row[0][:2]) + float(row[0][3:]),
            lambda row: [float(row[1])],
        ),
    )
    add(
        family,
        "days since 1900 without a unit",
        ["Time,T1", *lines_of(",", [f"{44526.4 + k / 86400:.9f}" for k in K], T1)],
        refused,
        refusal="time_unit=days",
    )
    add(
        family,
        "notes below the rows",
        ["Time [s],T1", *lines_of(",", NUMBERS, T1), "", "Notes", "checked by AB"],
        by_csv(1, ",", lambda row: float(row[0]), lambda row: [float(row[1])]),
    )


_campbell()
_hobo()
_instruments()
_controllers()
_national_instruments()
_parquet()
_cloud()
_mathematics()
