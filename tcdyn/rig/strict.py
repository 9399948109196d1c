"""The pydantic configuration of strict tables: frozen, no unknown keys, no infinities."""

from pydantic import ConfigDict

STRICT = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
