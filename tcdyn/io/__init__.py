"""Reading logs (text, LVM, TDMS, Parquet), time columns, and writing files atomically."""
