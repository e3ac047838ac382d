"""Structure from motion; the only package that imports pycolmap."""
