"""The report's stem map, and a card for each tree with its photographs."""
