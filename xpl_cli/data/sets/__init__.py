"""The dataset interface, independent of the format: episodes with columns, cameras and instructions."""
