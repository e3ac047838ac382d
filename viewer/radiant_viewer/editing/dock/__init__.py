"""The docks in which a plan is changed and its loads are shown."""
