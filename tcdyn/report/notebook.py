"""A result in a notebook: its words, its table and the picture that tells most of it."""

from __future__ import annotations

from calibration.errors import InputError
from calibration.result import Result
from tcdyn.compensate.record import Compensated
from tcdyn.plots.pick import draw
from tcdyn.plots.style import figure
from tcdyn.report.page import figure_data_uri


def card_html(result: Result) -> str:
    """The result's own card with its picture, where it has one that needs nothing else.

    >>> from tcdyn.chain import Chain
    >>> card_html(Chain([0.6, 0.1])).count("<img")
    1
    """
    picture, (ax,) = figure(height_in=3.6)
    try:
        draw(result, ax, **({"logged": None} if isinstance(result, Compensated) else {}))
    except (InputError, TypeError):  # no picture of it, or one that needs more than the result
        return result._repr_html_()
    return f'{result._repr_html_()}<img src="{figure_data_uri(picture, 90)}" alt="{type(result).__name__}">'
