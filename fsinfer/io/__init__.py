"""Files read and written: images, clouds, PFM, CSV; nothing here knows what a stage is."""
