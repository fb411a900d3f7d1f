"""What a model sees and says, on one page and in one picture."""
