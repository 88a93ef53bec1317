"""The two ends of a known length, clicked in photographs: page, server, and the file that keeps the clicks."""
