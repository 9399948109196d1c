"""Dips of one sensor at one flow: lag, percent times and chain of one further dip.

``tcdyn.sensors.dips`` uses it. ``python -m tests.sensors.dips_study`` checks the coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.law import FlowLaw
from tcdyn.core.estimate import Estimate
from tcdyn.sensors.dip_flows import FlowEffects, chain_at, law_of_chain
from tcdyn.sensors.file import SHARES, SensorFile, lag_and_times
from tcdyn.sensors.random_effects import RandomEffects, random_effects, with_one_spread


@dataclass(frozen=True)
class MovedDip:
    """A dip as it would be at the flow of the result; without flows the dip itself.

    Attributes
    ----------
    lag
        The lag [s].
    times
        The percent times in the order of ``SHARES`` [s].
    chain
        The chain, with the filter.
    follows
        Whether the chain can follow a flow.
    split_u_s
        Change of the largest lag that the film required beside the change of the whole lag [s].
    """

    lag: Estimate
    times: tuple[Estimate, ...]
    chain: Chain
    follows: bool = False
    split_u_s: float = 0.0

    @property
    def relative_u(self) -> float:
        """Relative standard uncertainty of the lag."""
        return self.lag.u / self.lag.value


@dataclass(frozen=True)
class PooledDips:
    """Lag and percent times of one further dip.

    Attributes
    ----------
    lag
        The lag, at the flow of the result if there are several.
    times
        The percent times by the keys of ``SHARES``.
    chain
        Chain with this lag, of the dip with the smallest relative uncertainty.
    best
        Number of this dip.
    split_u_s
        Standard uncertainty of the largest lag of the chain from the film [s].
    law
        The law of the chain; None: none, or the chain cannot have one.
    """

    lag: RandomEffects
    times: dict[str, Estimate]
    chain: Chain
    best: int
    split_u_s: float = 0.0
    law: FlowLaw | None = None


def moved_dip(dip: SensorFile, effects: FlowEffects | None, number: int) -> MovedDip:
    """Move a dip to the flow at which the result holds.

    Parameters
    ----------
    dip
        The dip.
    effects
        Posterior of the law of the lag; None: all dips are at one flow.
    number
        Number of the dip.

    Notes
    -----
    The lag follows the law. The film is part of the largest lag of the chain, and each percent time
    has the factor that the chain gives. Of a chain with a slow path all times are scaled.
    """
    lag = Estimate(**dip.fit["lag_s"])
    times = tuple(dip.times[dip.columns[0]].values())
    chain = dip.chains[0]
    if effects is None:
        return MovedDip(lag, times, chain)
    filter_lag_s = chain.conditioning.lag_s
    ratio = 1 / float(effects.law.factor(effects.flows.values[number]))
    moved = chain_at(chain, ratio, effects.law.inner_share)
    if moved is None:
        scaled = tuple(time.scaled(ratio) for time in times)
        return MovedDip(lag.scaled(ratio), scaled, _scale_times(chain, ratio))
    before = lag_and_times(replace(chain, conditioning=NO_CONDITIONING))[1:]
    after = lag_and_times(replace(moved, conditioning=NO_CONDITIONING))[1:]
    scaled = tuple(t.scaled(r) for t, r in zip(times, (after / before).tolist()))
    change_s = (chain.lag_s - filter_lag_s) * (ratio - 1)
    split_u_s = abs(max(moved.taus_s) - max(chain.taus_s) - change_s)
    return MovedDip(lag.scaled(ratio), scaled, moved, True, split_u_s)


def pool_moved(
    moved: Sequence[MovedDip], common_u_s: float, effects: FlowEffects | None
) -> PooledDips:
    """Combine lags, percent times and chains.

    Parameters
    ----------
    moved
        The dips at the flow of the result.
    common_u_s
        Standard uncertainty that all dips share [s].
    effects
        Posterior of the law of the lag; None: all dips are at one flow.
    """
    quantities, common = quantities_of(moved, common_u_s)
    if effects is None:
        lag, *times = with_one_spread(quantities, common)
        u_of_law = 0.0
    else:
        # only of the lag is it known how it follows a flow
        lag = effects.lag_at(effects.flows.at)
        times = [
            random_effects(one, common_u=u, spread=lag)
            for one, u in zip(quantities[1:], common[1:])
        ]
        u_of_law = effects.lag_u_of_law
    further = [time.next_estimate() for time in times]
    follows = effects is not None and any(dip.follows for dip in moved)
    possible = [k for k, dip in enumerate(moved) if dip.follows == follows]
    k = min(possible, key=lambda k: moved[k].relative_u)
    chain = moved[k].chain
    lag_s = lag.next_estimate().value
    chain = _scale_times(chain, lag_s / (chain.lag_s - chain.conditioning.lag_s))
    law = law_of_chain(effects.law, chain) if effects is not None and follows else None
    of_share = [time.with_error(u_of_law * time.value) for time in further]
    by_share = dict(zip(SHARES, of_share))
    return PooledDips(lag, by_share, chain, k, moved[k].split_u_s, law)


def quantities_of(
    dips: Sequence[MovedDip], common_u_s: float
) -> tuple[list[list[Estimate]], list[float]]:
    """Lag and percent times of the dips, and the relative uncertainty of each that dips share.

    Parameters
    ----------
    dips
        The dips.
    common_u_s
        Standard uncertainty of the lag that all dips share [s]; of a percent time it is at most
        that of the time in a dip.
    """
    lags = [dip.lag for dip in dips]
    times = [list(each) for each in zip(*(dip.times for dip in dips))]
    common_s = [common_u_s, *(min(common_u_s, max(e.u for e in one)) for one in times)]
    quantities = [lags, *times]
    means_s = [float(np.mean([each.value for each in one])) for one in quantities]
    return quantities, [u_s / mean_s for u_s, mean_s in zip(common_s, means_s)]


def _scale_times(chain: Chain, factor: float) -> Chain:
    """The chain with all its times multiplied by ``factor``; its filter stays."""
    pair = chain.pair and (factor * chain.pair[0], chain.pair[1])
    return replace(
        chain,
        taus_s=tuple(factor * tau for tau in chain.taus_s),
        zero_s=factor * chain.zero_s,
        delay_s=factor * chain.delay_s,
        cement_s=factor * chain.cement_s,
        pair=pair,
    )
