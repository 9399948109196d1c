"""Self-contained HTML reports.

``page`` renders sections to one HTML file without further files; every other module makes the
sections of one kind of page from a result. No module computes an estimate: texts, tables and
figures come from the result, ``tcdyn.workflows`` and ``tcdyn.plots``. The commands write the pages.
Tests: ``tests/report``.
"""
