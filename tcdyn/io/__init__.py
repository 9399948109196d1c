"""Readers of logs (text, LVM, TDMS, Parquet), time columns, checksums, and atomic writing.

``read.open_table`` opens a file of any format as a :class:`tcdyn.io.table.Table`; ``write`` writes
logs and texts. Nothing here knows a rig: names of columns and kinds of logs are in ``tcdyn.rig``.
Guarded by ``tests/io``.
"""
