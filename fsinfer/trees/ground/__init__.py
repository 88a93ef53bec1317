"""The ground under the trees."""
