"""What a set of demonstrations is, whatever its format: episodes with columns of numbers, cameras and sentences."""
