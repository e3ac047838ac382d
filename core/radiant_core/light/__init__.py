"""The light of photographs: a gain per photograph and channel, a vignetting per camera."""
