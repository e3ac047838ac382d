"""One training of several machines: photographs stay, the gradients of every step are summed."""
