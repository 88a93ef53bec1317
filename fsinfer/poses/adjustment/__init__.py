"""The last adjustment with what a phone changes from photo to photo: focal length, principal point, rolling shutter."""
