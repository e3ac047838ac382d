"""Machines that train one model together: views of each per step, what a step costs, the choice."""
