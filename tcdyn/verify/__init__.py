"""Every published number that the thesis lets us check, computed and put beside it."""

from __future__ import annotations

from tcdyn.verify.row import VerifyRow

__all__ = ["VerifyRow", "verify_rows"]


def verify_rows() -> list[VerifyRow]:
    """All rows, each computed on the spot, in the order of the thesis's chapters; a few seconds."""
    from tcdyn.verify.contact_rows import contact_rows, oven_rows, speed_law_rows
    from tcdyn.verify.rim_rows import closed_form_rows, field_rows, mesh_rows

    chapters = (speed_law_rows, oven_rows, closed_form_rows, field_rows, mesh_rows, contact_rows)
    return [row for chapter in chapters for row in chapter()]
