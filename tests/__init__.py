"""Tests. Several test processes share the cores: one BLAS thread each, unless the caller sets
another number."""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
