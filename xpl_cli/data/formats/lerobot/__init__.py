"""LeRobot's datasets, v2.1 (files by episode) and v3.0 (files of many episodes): parquet, MP4 and JSON."""
