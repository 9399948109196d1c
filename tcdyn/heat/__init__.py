"""The rim of a disk: modal solution, Crank-Nicolson reference, and closed forms.

Import from the modules; this package exports no names. ``rim`` has the geometry and the basis of
lags, ``modal`` the solution that the fits use, ``nonuniform`` the same for a coefficient that
varies in z, ``flux`` the heat flux across the track, ``engine`` temperatures and fields of one
test, and ``reference`` independent solutions to compare with. The tests are in ``tests/heat``.
"""
