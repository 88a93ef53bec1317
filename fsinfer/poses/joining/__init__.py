"""Parts of a torn walk put together: what may tie them, the place that it gives, and what speaks for it."""
