"""What the folder of a run, a training or a plan holds, as views, figures, layers and pictures."""
