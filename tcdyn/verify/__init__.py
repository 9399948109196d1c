"""Every published number that the thesis lets us check, computed and put beside it."""

from __future__ import annotations

from tcdyn.verify.row import VerifyRow

__all__ = ["VerifyRow", "verify_rows"]


def verify_rows() -> list[VerifyRow]:
    """All rows, each computed on the spot, in the order of the thesis's chapters; a few seconds."""
    from tcdyn.verify.contact_rows import contact_rows
    from tcdyn.verify.mesh_rows import mesh_rows
    from tcdyn.verify.partition_rows import partition_rows
    from tcdyn.verify.rim_rows import rim_rows

    return [*partition_rows(), *rim_rows(), *mesh_rows(), *contact_rows()]
