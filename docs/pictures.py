"""Draw the picture of README: ``python docs/pictures.py`` writes ``docs/compensated.png``."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tcdyn import Chain, smooth

OUT = Path(__file__).parent / "compensated.png"


def main() -> None:
    """The log of README's quick start: logged, compensated with its 95 % interval, and true."""
    time_s = np.arange(0.0, 900.0)
    since_opening_s = np.clip(time_s - 300, 0, None)
    gas_degC = 850 - 120 * (1 - np.exp(-since_opening_s / 15)) * np.exp(-since_opening_s / 200)
    noise_K = np.random.default_rng(1).normal(0, 0.3, len(time_s))
    logged_degC = Chain(25).response(gas_degC, dt_s=1) + noise_K
    result = smooth(logged_degC, 1.0, Chain(25), lag_covariance=[[1.0]])
    compensated_degC = result.temperature[:, 0]
    half_width_K = 1.96 * result.sd[:, 0]

    # Large type: the picture must be readable at a width of 400 pixels.
    plt.rcParams["font.size"] = 11
    figure, ax = plt.subplots(figsize=(5.2, 3.0), layout="constrained")
    ax.plot(time_s, logged_degC, color="0.55", linewidth=2, label="logged")
    low_degC = compensated_degC - half_width_K
    high_degC = compensated_degC + half_width_K
    ax.fill_between(time_s, low_degC, high_degC, color="tab:blue", alpha=0.3, linewidth=0)
    ax.plot(time_s, compensated_degC, color="tab:blue", linewidth=1.5, label="compensated, 95 %")
    ax.plot(time_s, gas_degC, "k:", linewidth=1.5, label="true")
    ax.set_xlim(250, 600)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("temperature [°C]")
    ax.legend(frameon=False, loc="lower right")
    figure.savefig(OUT, dpi=160)


if __name__ == "__main__":
    main()
