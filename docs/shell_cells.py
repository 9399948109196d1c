"""The cell magic ``%%sh`` of the kernels that execute the pages: one output, in its order.

That of IPython prints standard error after standard output, and in pieces.
"""

import os
import subprocess

from IPython.core.magic import register_cell_magic


@register_cell_magic
def sh(line: str, cell: str) -> None:
    """Run the commands of a cell; an exit code other than 0 is an error."""
    environment = {name: text for name, text in os.environ.items() if name != "FORCE_COLOR"}
    done = subprocess.run(
        ["sh", "-e", "-c", cell],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment | {"PYTHONUNBUFFERED": "1", "NO_COLOR": "1"},
    )
    print(done.stdout)
    done.check_returncode()
