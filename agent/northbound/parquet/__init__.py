"""An archive of Parquet files in a folder, parted by rig and day."""
