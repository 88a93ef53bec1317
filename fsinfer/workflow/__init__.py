"""The order of the stages, what is done already, and single stages; the only place that knows both."""
