"""The command line: one file for each command.

A command reads its options, calls a workflow and prints the result; it computes nothing. The
docstring of a command is its ``--help`` text, so it has no numpydoc sections: the help of each
option documents the parameter. Modules of other layers are imported inside the functions, so that
``tcdyn --help`` starts quickly. ``app`` collects the commands, ``common`` has what they share.
Tests: ``tests/cli``.
"""
