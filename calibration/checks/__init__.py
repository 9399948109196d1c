"""What must hold for the columns of a log."""
