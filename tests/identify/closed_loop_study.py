"""Recognition rates of closed loops and of open ones: ``python closed_loop_study.py [SAMPLES]
[SEEDS]``."""

from __future__ import annotations

import sys

import numpy as np
from closed_loop_cases import OPEN_LOOPS, closed_loop_record, open_loop_record

from tcdyn.identification.closed_loop import closed_loop

CONTROLLERS = ("P", "PI", "PID", "filtered PI", "clipped PI", "cascade", "thermostat")
DITHERS = (0.0, 1e-4, 1e-2, 0.1, 1.0)  # in standard deviations of the input without dither


def main(samples: int, seeds: int) -> None:
    """Print the share of the records that are recognised, in per cent."""
    print(
        f"{samples} samples, {seeds} seeds; dither {DITHERS} of the controller's output variation"
    )
    settings = [
        (c, {"delayed": d, "noise": n})
        for c in CONTROLLERS
        for d in (False, True)
        for n in (0.02, 0.3)
    ]
    settings += [(c, {"set_point": s}) for c in ("PI", "filtered PI") for s in ("steps", "ramp")]
    settings += [("PI", {"step": step, "disturbance": 3.0}) for step in (0.1, 0.3, 1.0)]
    for controller, options in settings:
        shares = []
        for dither in DITHERS:
            n_recognised = 0
            for seed in range(seeds):
                plain = closed_loop_record(controller, samples=samples, seed=seed, **options)
                sd = dither * float(np.std(plain.runs[0].u))
                record = closed_loop_record(
                    controller, samples=samples, seed=seed, dither=sd, **options
                )
                n_recognised += bool(closed_loop(record))
            shares.append(f"{100 * n_recognised / seeds:4.0f}")
        print(f"{controller:12s}", " ".join(shares), options)
    for kind in OPEN_LOOPS:
        n_recognised = sum(
            bool(closed_loop(open_loop_record(kind, samples=samples, seed=seed)))
            for seed in range(seeds)
        )
        print(f"{kind:32s}", f"{100 * n_recognised / seeds:4.0f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
