"""What a flight plan means in the air: whole lines, time, batteries, resolution and overlap."""
