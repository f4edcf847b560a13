"""The trade of speed for accuracy: measured in a study, and used to choose how to render."""
