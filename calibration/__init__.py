"""The disk, its log files, and what each channel reads when nothing changes."""
