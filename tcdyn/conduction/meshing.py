"""What a mesh does to the heat: the correction factors of table 3.4, and the thesis's four meshes."""

from __future__ import annotations

from tcdyn.conduction.rim import Mesh

MESHES = {"I": Mesh(9, 13), "II": Mesh(17, 27), "III": Mesh(33, 53), "IV": Mesh(65, 105)}


def correction_factor(half_width_m: float, nz: int, width_m: float) -> float:
    """Factor by which point values of the parabola (3.32) must be raised to carry the whole heat (table 3.4).

    N = 2 round(b/dz) intervals lie across the track; the trapezoidal rule then loses 1/N^2 of the parabola, so the
    factor is N^2/(N^2 - 1). The engine needs none: it gives every cell its exact integral.

    >>> [round(correction_factor(1.50e-3, nz, 9.53e-3), 4) for nz in (13, 27, 53, 105)]
    [1.0667, 1.0159, 1.0039, 1.001]
    """
    n = 2 * round(half_width_m / (width_m / (nz - 1)))
    return n**2 / (n**2 - 1)
