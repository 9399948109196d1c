"""What ``import tcdyn`` offers, and that it is quick to offer it."""

import subprocess
import sys

import tcdyn


def test_every_public_name_is_there_with_a_docstring() -> None:
    for name in tcdyn.__all__:
        thing = getattr(tcdyn, name)
        assert name == "__version__" or thing.__doc__


def test_import_brings_no_heavy_library() -> None:
    """Counted rather than timed: none of the slow libraries is loaded by the import alone."""
    heavy = "numpy scipy pandas control matplotlib pydantic"
    code = f"import sys, tcdyn; print([m for m in {heavy.split()} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"
