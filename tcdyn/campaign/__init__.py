"""All tests of one rig as one measurement: what they share is solved for once, so that differences and trends are known
far better than levels (design, section 13). Imported when asked for: the analysis of one test needs little of it."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tcdyn.campaign.compress import compressed, kept_of
    from tcdyn.campaign.kept import KeptTest, checked, rig_fingerprint
    from tcdyn.campaign.posterior import Posterior, solve
    from tcdyn.campaign.result import JoinedCampaign, joined

_HOMES = {
    "JoinedCampaign": "result",
    "KeptTest": "kept",
    "Posterior": "posterior",
    "checked": "kept",
    "compressed": "compress",
    "joined": "result",
    "kept_of": "compress",
    "rig_fingerprint": "kept",
    "solve": "posterior",
}
__all__ = [
    "JoinedCampaign",
    "KeptTest",
    "Posterior",
    "checked",
    "compressed",
    "joined",
    "kept_of",
    "rig_fingerprint",
    "solve",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """The names of this room, asked for already or not."""
    return sorted(__all__)
