"""Tables of a report: numbers on the right and unbroken, words on the left, sentences wide enough to read."""

from __future__ import annotations

import pandas as pd

from tcdyn.report.page import table_html


def test_cells_are_set_by_what_they_hold() -> None:
    html = table_html(
        pd.DataFrame(
            {
                "way": ["speed law", "joint fit"],
                "β [1]": ["0.710 ± 0.009", ""],
                "h": [745.88532, float("nan")],
                "why": ["the log is truncated: copy the file again", "a < b & c"],
            }
        )
    )
    assert '<td class="words">speed law</td><td class="number">0.710 ± 0.009</td><td class="number">745.89</td>' in html
    assert '<td class="number"></td><td class="prose">a &lt; b &amp; c</td>' in html
    assert '<th class="prose">why</th>' in html
