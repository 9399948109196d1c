"""The rig: ``rig.toml``, disks, contact, columns of logs, checks, records, and static lines.

``rigfile`` and ``tables`` read ``rig.toml``; ``disk`` is one disk in SI units; ``log`` reads logs
(with ``opened_log``, ``columns``, ``clean_columns``, ``check_columns``, ``check_kind`` and
``oven_log``; times and readings are decided by ``tcdyn.series``); ``record`` is the result of a
calibration; ``contact``, ``press_fit``, ``steel`` and ``static_line`` hold the physics that belongs
to the rig.
The tests are in ``tests/rig``, and for the physics in ``tests/partition`` and ``tests/simulate``.
"""
