"""The rim of a disk: modal solution, Crank-Nicolson reference, and closed forms."""
