"""Flight lists as flight planners open them: DJI WPML (KMZ), QGroundControl .plan, KML."""
