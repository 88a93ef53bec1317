"""Where the cameras of a rendering stand, and what a photograph adds."""
