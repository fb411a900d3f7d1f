"""LeRobot: checkpoints of `save_pretrained`, and `meta/` of datasets. Formats: huggingface/lerobot v0.3 to v0.6."""
