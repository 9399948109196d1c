"""``python -m tcdyn``: the command line where the script ``tcdyn`` is not on the path."""

from tcdyn.cli.start import command

if __name__ == "__main__":
    command()
