"""The test programme and the simulator of the rig, which shares no solver with any fit.

The package makes synthetic logs with known true values (``tcdyn simulate`` and the tests use them).
It imports ``tcdyn.core``, ``tcdyn.io`` and ``tcdyn.rig`` only, and no estimator imports it: an
error in a shared solver would be invisible in the tests. The import contracts in ``pyproject.toml``
check both; ``tests/test_contracts.py`` shows that they work. Any change of a draw or of an equation
changes the committed logs of ``tests/behaviour``.
"""
