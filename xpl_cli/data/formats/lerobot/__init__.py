"""LeRobot datasets, v2.1 (one file per episode) and v3.0 (files of many episodes): parquet, MP4 and JSON."""
