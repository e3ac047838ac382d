"""What the folder of a run, a training or a plan holds for the eye."""
