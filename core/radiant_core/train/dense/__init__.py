"""Dense points by matching photographs, without learnt weights."""
