"""Films: sharp frames that move on by the same step, with the positions of an SRT beside them."""
