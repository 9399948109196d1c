"""The commands, one file each; words and numbers on a terminal, nothing computed here."""
