"""Differentiable Gaussian rendering behind one contract."""
