"""From scene units to the plot: z up, ground near zero, metres."""
