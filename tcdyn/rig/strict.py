"""What ``rig.toml`` may state beyond the thesis's own model, as its section 8.3 recommends."""

from pydantic import ConfigDict

STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
