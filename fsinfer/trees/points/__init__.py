"""Points selected, thinned, indexed and summed."""
