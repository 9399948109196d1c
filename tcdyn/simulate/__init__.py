"""The test programme, and a synthetic rig whose truth is known, with a solver of its own: none is shared with a fit."""
