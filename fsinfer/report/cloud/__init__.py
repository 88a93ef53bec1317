"""The report's viewer of the cloud, and pictures of clouds and depth maps."""
