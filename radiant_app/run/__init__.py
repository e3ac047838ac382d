"""The main job: sources, plan, dealing, what is predicted and promised."""
