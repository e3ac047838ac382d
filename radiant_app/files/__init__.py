"""Files that users write or keep: run folders, events, systems, profiles, constraints, batches."""
