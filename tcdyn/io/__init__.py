"""Files of loggers: readers of text, LVM, TDMS and Parquet, columns of time, and files written atomically."""
