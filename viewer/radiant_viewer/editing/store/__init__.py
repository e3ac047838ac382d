"""The files of an edited plan: its edits, and the plan as `radiant plan` writes it."""
