"""Contact mechanics, kinematics, the test programme, and a synthetic rig whose truth is known.

``contact``, ``kinematics``, ``interference`` and ``programme`` are plain geometry and facts; they load no
simulator. ``campaign``, ``ehl``, ``plunge`` and ``oven`` simulate with a solver of their own: nothing of that is
shared with the fits.
"""
