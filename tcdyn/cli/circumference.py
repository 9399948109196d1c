"""Command ``tcdyn rig circumference``: circumferential temperature of the disks, and the press fit.

The field of the synthetic rig is :mod:`tcdyn.simulate.field`, the press fit
:mod:`tcdyn.rig.press_fit`. Test: ``tests/cli/test_circumference_command.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from tcdyn.cli.common import (
    OptionalPicture,
    Picture,
    Reporter,
    RigFile,
    check_picture,
    options_from_docstring,
    save_picture,
)
from tcdyn.cli.simulate import DrawnRig, SimulatedTest
from tcdyn.core.options import Options, option
from tcdyn.rig.disk import DISKS

if TYPE_CHECKING:
    import numpy as np

    from tcdyn.rig.disk import DiskSetup

app = typer.Typer(
    name="circumference",
    help="Circumferential temperature of the disks, and their press fit.",
    no_args_is_help=True,
    add_completion=False,
)


@app.command("simulate")
@options_from_docstring
def simulate_circumference(
    picture: Picture, *, options: SimulatedTest, drawn: DrawnRig, reporter: Reporter
) -> None:
    """Draw the temperature of the synthetic disks at the end of the load.

    The picture shows it over radius, width and angle.

    `tcdyn rig beta --report` draws the same for a measured test.

    Example: tcdyn rig circumference simulate --picture disks.png --test D4 --uneven slow:0.5@30
    """
    from tcdyn.plots.circumferential import circumferential_figure
    from tcdyn.rig.rigfile import load_rig
    from tcdyn.simulate.ehl import EhlOptions
    from tcdyn.simulate.field import disk_fields
    from tcdyn.simulate.truth import draw_truth

    check_picture(picture, [drawn.rig], reporter.overwrite)
    truth = draw_truth(drawn.seed, load_rig(drawn.rig)).with_uneven(options.bore_contacts_by_disk)
    disks = disk_fields(options.test, drawn.seed, truth, EhlOptions(beta=options.beta))
    save_picture(circumferential_figure([disks[d] for d in DISKS]), picture)
    numbers = {
        d: {"surface_degC": _range(disks[d].surface_degC), "seen_degC": disks[d].reading_degC}
        for d in DISKS
    }
    reporter.json(lambda: {"picture": picture, **numbers})
    for d in DISKS:
        low, high = numbers[d]["surface_degC"]
        reporter.text(f"{d} disk: running surface {low:.1f} to {high:.1f} degC round the shaft")
    reporter.files(picture=picture)


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of the press fit.

    Attributes
    ----------
    disk
        fast or slow (default: each with a stated fit)
    """

    disk: str | None = option(None, "Two-disk rig", choices=DISKS)


@app.command("fit")
@options_from_docstring
def fit_circumference(
    rig: RigFile = None,
    picture: OptionalPicture = None,
    *,
    options: FitOptions,
    reporter: Reporter,
) -> None:
    """Compute the press fit that rig.toml states: pressure (6.1) and conductance (6.2).

    The picture shows both around the bore.

    Table fit, or slow.fit for one disk, states interference_um (diametral), hardness_GPa,
    roughness_um, slope and conductivity_W_mK of the joint, keyways = [{ angle_deg = 40, width_mm =
    6, share = 0.1 }] and patches = [{ from_deg = 100, to_deg = 160, share = 0.2 }]. If it is
    stated, `tcdyn simulate ehl`, `tcdyn rig circumference simulate` and `tcdyn rig beta` use it.

    Example: tcdyn rig circumference fit --rig rig.toml --disk slow --picture fit.png
    """
    from functools import partial

    from tcdyn.plots.circumferential import draw_press_fit
    from tcdyn.plots.style import panel_figure
    from tcdyn.rig.rigfile import load_rig

    check_picture(picture, [rig], reporter.overwrite)
    rig_settings = load_rig(rig)
    setups = [rig_settings.disk_setup(d) for d in DISKS if options.disk in (None, d)]
    stated = [s for s in setups if s.press_fit.is_specified] or setups[:1]
    numbers = {s.name: _fit_numbers(s) for s in stated}
    if picture is not None:
        draws = [partial(draw_press_fit, s) for s in stated]
        rows = len(stated)
        figure = panel_figure(*draws, rows=rows, width_in=7.0, height_in=3.2 * rows)
        save_picture(figure, picture)
    reporter.json(lambda: {"picture": picture, **numbers})
    for name, x in numbers.items():
        reporter.text(
            f"{name} disk: pressure {x['pressure_MPa']:.1f} MPa; conductance "
            f"{1e-3 * x['bearing_W_m2K']:.2f} kW/m2K where the fit bears, "
            f"{1e-3 * x['mean_W_m2K']:.2f} in the mean; of that mean the first harmonic is "
            f"{x['first']['share']:.3f} at {x['first']['angle_deg']:.0f} degrees, the second "
            f"{x['second']['share']:.3f} at {x['second']['angle_deg']:.0f}"
        )
    reporter.files(picture=picture)


def _fit_numbers(setup: DiskSetup) -> dict[str, Any]:
    """Numbers of the press fit of rig.toml for the JSON result.

    Its pressure [MPa], the conductance where it bears and on average [W/m2K], and share of the mean
    and angle of the greatest conductance [deg] of the first and second harmonic.
    """
    from tcdyn.rig.contact import press_fit_conductance
    from tcdyn.rig.press_fit import amplitude_and_angle, harmonics

    pressure, bearing = press_fit_conductance(setup)
    shares = harmonics(setup.press_fit.sectors(1e3 * setup.bore_radius_m), 2)
    harmonic_numbers = {}
    for n in (1, 2):
        amplitude, angle_deg = amplitude_and_angle(shares, n)
        harmonic_numbers[n] = {"share": amplitude, "angle_deg": angle_deg}
    mean = bearing * float(shares[0].real)
    return {
        "pressure_MPa": 1e-6 * pressure,
        "bearing_W_m2K": bearing,
        "mean_W_m2K": mean,
        "first": harmonic_numbers[1],
        "second": harmonic_numbers[2],
    }


def _range(x: np.ndarray) -> tuple[float, float]:
    """Smallest and largest value."""
    return float(x.min()), float(x.max())
