"""Structure from motion: the only package that knows pycolmap."""
