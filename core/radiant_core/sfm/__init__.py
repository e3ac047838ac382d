"""Structure from motion; the only place that knows pycolmap."""
