"""LeRobot: what `save_pretrained` and a data set's `meta/` say. Formats: huggingface/lerobot v0.3 to v0.6."""
