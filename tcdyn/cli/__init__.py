"""The command line: one file for each command; it calls the workflows and prints their results."""
